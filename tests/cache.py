"""Compiled programs kept in a folder: both workers share them, and the next run has them."""

import os
from contextlib import contextmanager
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache

FOLDER = Path(__file__).resolve().parents[1] / ".pytest_cache" / "compiled"
MOST_BYTES = 2e9
SETTINGS = {
    "jax_compilation_cache_dir": str(FOLDER),
    "jax_persistent_cache_min_compile_time_secs": 0.1,
    "jax_persistent_cache_min_entry_size_bytes": -1,
}


def use() -> None:
    """In this process and in those that it starts."""
    for name, value in SETTINGS.items():
        os.environ[name.upper()] = str(value)
        jax.config.update(name, value)


def prune() -> None:
    """Away with the oldest programs, where there are too many."""
    files = sorted(FOLDER.glob("*"), key=lambda path: -path.stat().st_mtime)
    total = 0
    for path in files:
        total += path.stat().st_size
        if total > MOST_BYTES:
            path.unlink()


@contextmanager
def unused():
    """For tests of the last bits, and of compilation itself."""

    def enabled(value: bool) -> None:
        os.environ["JAX_ENABLE_COMPILATION_CACHE"] = str(value).lower()
        jax.config.update("jax_enable_compilation_cache", value)
        compilation_cache.reset_cache()

    enabled(False)
    yield
    enabled(True)
