"""Functions compiled once for a machine: a process that finds one stored neither traces nor lowers it.

JAX's own store spares XLA. To know what to look for there, JAX first traces and lowers the function, which for a large
one takes longer than all that a command computes. Here a compiled function is found by what it is given, by the
settings of JAX and by the text of this library.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
import re
from collections.abc import Callable
from functools import cache, update_wrapper
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import equinox as eqx
import jax
from jax.core import Tracer

from jaxalign.compilation import settings

__all__ = ["Program"]

_LOG = logging.getLogger("jaxalign")
_MOST = 64  # compiled functions that one of these holds
_WATCHED = ("jax_enable_x64", "jax_default_device", "jax_numpy_dtype_promotion", "jax_default_matmul_precision")
_ERRORS = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_enable_checks", "jax_check_tracer_leaks")
_NO_MATTER = re.compile("jax_compilation_cache|jax_enable_compilation|jax_persistent_cache|jax_log|jax_traceback")
_COVERED = {"jaxalign", "equinox", "jax", "jaxlib", "numpy"}
_PLAIN = (str, bytes, int, float, complex, type(None))


P = ParamSpec("P")
R = TypeVar("R")


class Program(Generic[P, R]):
    """A function for the host, compiled as ``equinox.filter_jit`` does: arrays are arguments, all else is fixed.

    It is no more than that inside traced code, where nothing is kept (:func:`jaxalign.compilation.configure`), where
    JAX has been told to look for errors, and with classes from elsewhere, whose text may change unseen.
    """

    def __init__(self, function: Callable[P, R]):
        self._function = function
        self._usual = eqx.filter_jit(function)
        self._ready: dict[Any, Callable[[list[Any]], Any] | None] = {}
        update_wrapper(self, function)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function, compiled for such arguments."""
        store = settings.store()
        if store is None or any(getattr(jax.config, name) for name in _ERRORS):
            return self._usual(*args, **kwargs)
        arrays, rest = eqx.partition((args, kwargs), eqx.is_array)
        leaves, given = jax.tree.flatten(arrays)
        if any(isinstance(x, Tracer) for x in leaves):
            return self._usual(*args, **kwargs)
        fixed, around = jax.tree.flatten(rest)
        kinds = tuple((x.shape, str(x.dtype), getattr(x, "weak_type", False)) for x in leaves)
        key = (given, kinds, around, tuple(fixed), *(getattr(jax.config, name) for name in _WATCHED))
        try:
            hash(key)
        except TypeError:
            return self._usual(*args, **kwargs)  # it says what is wrong
        if key not in self._ready:
            while len(self._ready) >= _MOST:
                self._ready.pop(next(iter(self._ready)))
            self._ready[key] = self._made(store, key, leaves, given, rest)
        ready = self._ready[key]
        return self._usual(*args, **kwargs) if ready is None else ready(leaves)

    def _made(self, store: Any, key: Any, leaves: list[Any], given: Any, rest: Any) -> Any:
        """From the store, or for it; None where it cannot be found again."""
        name = f"{self._function.__module__}.{self._function.__qualname__}"
        text = "\n".join((_library() or "", name, *map(repr, key), _settings()))
        if not _library() or not _covered(key) or re.search(r" at 0x[0-9a-f]", text):
            return None
        entry = f"host-{self._function.__name__}-{hashlib.sha256(text.encode()).hexdigest()}"
        try:
            found = _loaded(store.get(entry), len(leaves))
            if found is not None:
                return found
            with store.hidden():  # XLA writes only half of what it has itself read
                made = _compiled(self._function, leaves, given, rest)
            return _stored(store, entry, *made)
        except (TypeError, ValueError, NotImplementedError, pickle.PickleError, AttributeError) as error:
            _LOG.debug("jaxalign: %s is compiled as usual: %s", name, error)
            return None


def _compiled(function: Callable[..., Any], leaves: list[Any], given: Any, rest: Any) -> tuple[Any, Any, Any]:
    """The executable, of flat arguments and results, and what the results are: a tree with their numbers, the rest."""
    made = []

    def flat(leaves: list[Any]) -> list[Any]:
        args, kwargs = eqx.combine(given.unflatten(leaves), rest)
        arrays, others = eqx.partition(function(*args, **kwargs), eqx.is_array)
        out, tree = jax.tree.flatten(arrays)
        made[:] = [tree.unflatten(range(len(out))), others]
        return out

    flat.__name__ = flat.__qualname__ = function.__name__
    return jax.jit(flat).lower(leaves).compile(), *made


def _stored(store: Any, entry: str, executable: Any, numbered: Any, others: Any) -> Any:
    from jax.experimental.serialize_executable import serialize

    store.put(entry, pickle.dumps((serialize(executable)[0], numbered, others)))
    return _callable(executable, numbered, others)


def _loaded(data: bytes | None, count: int) -> Any:
    """What was stored, ready to call; None where there is nothing or XLA does not take it."""
    from jax.experimental.serialize_executable import deserialize_and_load

    if data is None:
        return None
    taken = jax.tree.structure((([0] * count,), {}))
    try:
        program, numbered, others = pickle.loads(data)
        results = jax.tree.structure([0] * len(jax.tree.leaves(numbered)))
        executable = deserialize_and_load(program, taken, results, execution_devices=[_device()])
    except Exception:  # of any kind, also of XLA: as if it were not there
        return None
    return _callable(executable, numbered, others)


def _callable(executable: Any, numbered: Any, others: Any) -> Callable[[list[Any]], Any]:
    tree = jax.tree.structure(numbered)
    return lambda leaves: eqx.combine(tree.unflatten(executable(leaves)), others)


def _device() -> Any:
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    return chosen if isinstance(chosen, jax.Device) else jax.devices(chosen)[0]


def _settings() -> str:
    """All settings of JAX that may change what is compiled, and the device."""
    given = sorted(jax.config.values.items())
    values = {name: getattr(jax.config, name, value) for name, value in given if not _NO_MATTER.match(name)}
    device = _device()
    return f"{values} {device.platform} {device.device_kind} {device.id}"


@cache
def _library() -> str | None:
    """A digest of the text of this library and of what makes its trees; None where there is no text to read."""
    root = Path(__file__).resolve().parents[1]
    made, paths = hashlib.sha256(version("equinox").encode()), sorted(root.rglob("*.py"))
    try:
        for path in paths:
            made.update(f"{path.relative_to(root)}\0{path.stat().st_size}\0".encode())
            made.update(path.read_bytes())
    except OSError:
        return None
    return made.hexdigest() if paths else None


def _covered(x: Any) -> bool:
    """Whether all there is in a key is plain, or of a class whose text the key covers."""
    if isinstance(x, _PLAIN):
        return type(x) in _PLAIN or type(x) is bool or _ours(type(x))
    if isinstance(x, type):
        return x in (tuple, list, dict, type(None)) or _ours(x)
    if isinstance(x, tuple | list):
        return (type(x) in (tuple, list) or _ours(type(x))) and all(map(_covered, x))
    if isinstance(x, dict):
        return all(map(_covered, x)) and all(map(_covered, x.values()))
    if isinstance(x, jax.tree_util.PyTreeDef):
        return _covered(x.node_data()) and all(map(_covered, x.children()))
    return _ours(type(x))


def _ours(kind: type) -> bool:
    return kind.__module__.partition(".")[0] in _COVERED
