"""The one call that gives a program the store of compiled programs and the flag."""

from __future__ import annotations

import atexit
import logging
import os
import sys
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from jaxalign.compilation import folder, probe
from jaxalign.compilation.entries import Entries
from jaxalign.compilation.flags import add_fast_loops, add_quick_compilation

__all__ = ["configure", "reloads", "store"]

_LOG = logging.getLogger("jaxalign")
_kept: Path | None = None
_entries: Entries | None = None


def configure(cache: str | os.PathLike[str] | Literal[False] | None = None, *, flags: bool = True) -> Path | None:
    """Keep compiled programs on disk between processes, and have XLA compile quickly and run loops fast on a CPU.

    It changes settings of JAX and ``XLA_FLAGS`` for the whole process and its children: call it in a program, not in a
    library, and before JAX runs anything. Calling it again is harmless.

    The store is bounded (512 MB, the longest unused goes first), safe with several processes at once, and for this
    user alone: who writes there could run code as the user, so a folder that others may write to is not used. Programs
    are kept apart by processor, XLA flags and versions of JAX. On a new kind of machine they are written only, and as
    it ends the process finds out whether they can be loaded there at all; where they cannot, nothing is kept.

    Args:
        cache: folder of the store; None: what the environment variable ``JAXALIGN_CACHE`` says (``off`` or a folder),
            else ``jaxalign`` in the user's cache folder; False: none. A store that JAX has been given already is left
            alone.
        flags: whether to set flags of XLA (small loops as one call, quick compilation); without effect where JAX has
            run already, and none that the user has set. They change results in the last bits.

    Returns:
        The folder where programs are kept; None: nowhere. A folder that was asked for and cannot be used is told in one
        line of the logger ``jaxalign``; nothing is raised.
    """
    import jax

    global _kept
    if flags and not _started():
        add_fast_loops()
        add_quick_compilation(version("jaxlib"))
    if cache is False:
        return None
    given = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if given not in (None, str(_kept)):
        return None
    root = folder.chosen() if cache is None else Path(cache)
    if root is None:
        return None
    try:
        place = folder.opened(folder.opened(root) / _subfolder())
    except folder.Unusable as error:
        if cache is not None or os.environ.get("JAXALIGN_CACHE"):
            _LOG.warning("jaxalign: compiled programs are not kept: %s", error)
        return None
    known = probe.verdict(place)
    if known is False or (place != _kept and not _installed(place, readable=known is True)):
        return None
    if known is None and place != _kept:
        atexit.register(probe.settle, place)
    _kept = place
    return place


def reloads() -> bool | None:
    """Whether this kind of machine loads the programs that it has stored; None: not known, or nothing is kept."""
    root = folder.chosen()
    return None if root is None else probe.verdict(root / _subfolder())


def store() -> Entries | None:
    """What compiled programs are kept in, while they are."""
    import jax

    enabled = jax.config.jax_enable_compilation_cache  # pyright: ignore[reportAttributeAccessIssue]
    return _entries if enabled else None


def _subfolder() -> str:
    return folder.subfolder(version("jax"), version("jaxlib"))


def _started() -> bool:
    """Whether XLA has read its flags."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    begun = getattr(bridge, "backends_are_initialized", None)
    return begun is not None and begun()


def _installed(place: Path, readable: bool) -> bool:
    """Whether JAX has taken our store: the function by which it makes its own is the one thing here not public."""
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    global _entries
    try:
        from jax._src import compilation_cache as hidden

        usual = hidden.get_file_cache
    except (ImportError, AttributeError):
        return False

    entries = Entries(place, readable)

    def opened(path: str) -> Any:
        return (entries, path) if path == str(place) else usual(path)

    compilation_cache.reset_cache()
    hidden.get_file_cache = opened
    jax.config.update("jax_compilation_cache_dir", str(place))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    jax.config.update("jax_persistent_cache_enable_xla_caches", "none")
    _entries = entries
    # A program that does not load is compiled again: nobody need know.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache entry")
    return True
