"""Compiled programs kept in a folder: both workers and commands share them, and the next run has them."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache

FOLDER = str(Path(__file__).resolve().parents[1] / ".pytest_cache" / "compiled")
# Imported late: the shapes of what is imported before the hook of conftest.py are not checked.
START = "from jaxalign.compilation import configure; configure(flags=False); import jax; jax.devices()"


def tried(flags: str) -> bool:
    """Whether XLA starts with these flags; the process also finds out whether what it stores can be loaded here."""
    environment = {**os.environ, "XLA_FLAGS": flags, "JAXALIGN_CACHE": FOLDER}
    return subprocess.run([sys.executable, "-c", START], env=environment, capture_output=True).returncode == 0


def use() -> None:
    """In this process and in the commands that it starts."""
    from jaxalign.compilation import configure

    os.environ["JAXALIGN_CACHE"] = FOLDER
    configure(flags=False)


@contextmanager
def unused():
    """For tests of the last bits, and of compilation itself."""

    def enabled(value: bool) -> None:
        os.environ["JAXALIGN_CACHE"] = FOLDER if value else "off"
        jax.config.update("jax_enable_compilation_cache", value)
        compilation_cache.reset_cache()

    enabled(False)
    yield
    enabled(True)
