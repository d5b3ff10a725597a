"""Whether programs that are stored on this machine can be loaded again: run as a program, apart from the command.

On some processors XLA notes preferences of its compiler as features of the machine, does not find them there when it
loads, and refuses each stored program with lines on standard error that Python cannot catch. The answer is an empty
file ``accepted`` or ``rejected`` in the folder of this kind of machine and version.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path

__all__ = ["accepted", "begin", "verdict"]

_HIT = "/jax/compilation_cache/cache_hits"


def verdict(folder: Path) -> bool | None:
    """Whether what is stored in a folder can be loaded; None: not known yet."""
    if (folder / "rejected").exists():
        return False
    return True if (folder / "accepted").exists() else None


def begin(folder: Path) -> threading.Thread | None:
    """Find out, beside all else that goes on: it takes a second. The thread ends with it; None: it cannot be begun."""
    if not sys.executable:
        return None
    left_out = ("JAX_COMPILATION_CACHE_DIR", "TF_CPP_MIN_LOG_LEVEL")  # it needs its own folder, and to see the errors
    environment = {key: value for key, value in os.environ.items() if key not in left_out}
    command = [sys.executable, "-P", __file__, str(folder)]

    def wait() -> None:
        nowhere = subprocess.DEVNULL
        with suppress(OSError):  # a session of its own: Ctrl-C is not for it
            subprocess.run(
                command,
                env={**environment, "JAX_PLATFORMS": "cpu"},
                stdin=nowhere,
                stdout=nowhere,
                stderr=nowhere,
                start_new_session=True,
            )

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    return thread


def accepted() -> bool | None:
    """Store a small program and load it again; None: it could not be stored. Standard error is gone after it."""
    import jax

    events: list[str] = []
    jax.monitoring.register_event_listener(lambda event, **_: events.append(event))
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
        for _ in range(2):
            jax.jit(lambda x: 2.0 * x + 1.0).lower(1.0).compile()
            jax.clear_caches()
        if not os.listdir(folder):
            return None
        said.seek(0)
        return _HIT in events and b"machine" not in said.read().lower()


if __name__ == "__main__":
    if (found := accepted()) is not None:
        (Path(sys.argv[1]) / ("accepted" if found else "rejected")).touch()
