"""Whether programs that are stored on this machine can be loaded again.

On some processors XLA notes preferences of its compiler as features of the machine, does not find them there when it
loads, and refuses each stored program with lines on standard error that Python cannot catch. So the first process on a
new kind of machine stores only; when it ends it loads one small program, with standard error turned away, and leaves
the answer as an empty file ``accepted`` or ``rejected`` beside the programs.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

__all__ = ["settle", "verdict"]


def verdict(folder: Path) -> bool | None:
    """Whether what is stored in a folder can be loaded; None: not known yet."""
    if (folder / "rejected").exists():
        return False
    return True if (folder / "accepted").exists() else None


def settle(folder: Path) -> None:
    """Find out and leave the answer; a hundredth of a second where JAX runs already. Nothing is raised."""
    with suppress(Exception), _standard_error_away() as said:
        (folder / ("accepted" if _loaded(said) else "rejected")).touch()


def _loaded(said: IO[bytes]) -> bool:
    """Whether a program comes back from its bytes without a word."""
    import jax
    from jax.experimental.serialize_executable import deserialize_and_load, serialize

    stored = serialize(jax.jit(lambda x: 2.0 * x + 1.0).lower(1.0).compile())
    said.truncate(0)
    try:
        deserialize_and_load(*stored)
    except Exception:
        return False
    said.seek(0)
    return b"machine" not in said.read().lower()


@contextmanager
def _standard_error_away() -> Iterator[IO[bytes]]:
    """What is written to standard error, also by C++, goes to a file."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with tempfile.TemporaryFile() as said:
            os.dup2(said.fileno(), 2)
            yield said
    finally:
        os.dup2(kept, 2)
        os.close(kept)
