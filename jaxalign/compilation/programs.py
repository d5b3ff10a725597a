"""Functions compiled once for a machine: a process that finds one stored neither traces nor lowers it.

JAX's own store spares XLA. To know what to look for there, JAX first traces and lowers the function, which for a large
one takes longer than all that a command computes. Here a compiled function is found by what it is given, by the
settings of JAX and by the text of this library.
"""

from __future__ import annotations

import hashlib
import io
import logging
import pickle
import re
import threading
from collections import defaultdict
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache, update_wrapper
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np
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


class _Memory(dict[str, bytes]):
    """In place of a store, for one process."""

    hidden = staticmethod(nullcontext)

    def put(self, key: str, value: bytes) -> None:
        self[key] = value


class Program(Generic[P, R]):
    """A function for the host, compiled as ``equinox.filter_jit`` does: arrays are arguments, all else is fixed.

    It is no more than that inside traced code, where nothing is kept (:func:`jaxalign.compilation.configure`), where
    JAX has been told to look for errors, and with classes from elsewhere, whose text may change unseen.

    Args:
        function: pure.
        options: of XLA's compiler.
        shared: it is called on several devices: also where nothing is kept it is compiled for one of them, and the
            others have the same program. Threads that call it wait for each other's compilation.
    """

    def __init__(self, function: Callable[P, R], options: dict[str, Any] | None = None, shared: bool = False):
        self._function, self._options = function, options
        of_jax: dict[str, Any] = {"compiler_options": options} if options else {}
        self._usual = eqx.filter_jit(function, **of_jax)
        self._ready: dict[Any, Callable[[list[Any]], Any] | None] = {}
        self._memory = _Memory() if shared else None
        self._alone = threading.Lock()
        self._locks: dict[str, threading.Lock] = defaultdict(threading.Lock)
        update_wrapper(self, function)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function, compiled for such arguments."""
        store = self._memory if settings.store() is None else settings.store()
        if store is None or any(getattr(jax.config, name) for name in _ERRORS):
            return self._usual(*args, **kwargs)
        everything, given = jax.tree.flatten((args, kwargs))
        leaves = [x for x in everything if eqx.is_array(x)]
        device = None if any(isinstance(x, Tracer) for x in leaves) else _device(leaves)
        if device is None:
            return self._usual(*args, **kwargs)
        kinds = tuple(  # for a small program this takes as long as to run it
            (x.shape, x.dtype, getattr(x, "weak_type", False), _committed(x)) if eqx.is_array(x) else x
            for x in everything
        )
        key = (given, kinds, *(getattr(jax.config, name) for name in _WATCHED))
        try:
            hash(key)
        except TypeError:
            return self._usual(*args, **kwargs)  # it says what is wrong
        try:
            ready = self._ready[device, key]
        except KeyError:
            ready = self._made(store, key, leaves, args, kwargs, device)
            with self._alone:
                while len(self._ready) >= _MOST:
                    self._ready.pop(next(iter(self._ready)))
                self._ready[device, key] = ready
        return self._usual(*args, **kwargs) if ready is None else ready(leaves)

    def _made(self, store: Any, key: Any, leaves: list[Any], args: Any, kwargs: Any, device: Any) -> Any:
        """From the store, or for it; None where it cannot be found again."""
        name = f"{self._function.__module__}.{self._function.__qualname__}"
        where = f"{device.platform} {device.device_kind} {self._options}"
        text = "\n".join((_library() or "", name, *map(repr, key), _settings(), where))
        if not _library() or not _covered(key) or re.search(r" at 0x[0-9a-f]", text):
            return None
        entry = f"host-{self._function.__name__}-{hashlib.sha256(text.encode()).hexdigest()}"
        with self._alone:
            lock = self._locks[entry]
        with lock:
            memory = {} if self._memory is None else self._memory
            found = _loaded(memory.get(entry) or store.get(entry), len(leaves), device)
            if found is not None:
                return found
            with store.hidden():  # XLA writes only half of what it has itself read
                made, numbered, others = _compiled(self._function, leaves, (args, kwargs), self._options)
            try:
                data = _serialized(made, numbered, others, device)
            except Exception as error:  # of any kind, also of XLA: it computes all the same
                _LOG.debug("jaxalign: %s is not kept: %s", name, error)
            else:
                if _digest() == _library():  # what runs is what can be read
                    store.put(entry, data)
                if self._memory is not None:  # a first process writes only
                    self._memory.put(entry, data)
            return _callable(made, numbered, others)


def _compiled(function: Any, leaves: list[Any], given: Any, options: Any) -> tuple[Any, Any, Any]:
    """The executable, of flat arguments and results, and what the results are: a tree with their numbers, the rest."""
    made = []
    arguments, rest = eqx.partition(given, eqx.is_array)
    structure = jax.tree.structure(arguments)

    def flat(leaves: list[Any]) -> list[Any]:
        args, kwargs = eqx.combine(structure.unflatten(leaves), rest)
        arrays, others = eqx.partition(function(*args, **kwargs), eqx.is_array)
        out, tree = jax.tree.flatten(arrays)
        made[:] = [tree.unflatten(range(len(out))), others]
        return out

    flat.__name__ = flat.__qualname__ = function.__name__
    return jax.jit(flat, compiler_options=options).lower(leaves).compile(), *made


def _serialized(executable: Any, numbered: Any, others: Any, device: Any) -> bytes:
    from jax.experimental.serialize_executable import serialize

    return pickle.dumps((serialize(executable)[0], device.id, numbered, others))


def _loaded(data: bytes | None, count: int, device: Any) -> Any:
    """What was stored, ready to call on a device; None where there is nothing or XLA does not take it."""
    from jax.experimental.serialize_executable import deserialize_and_load

    if data is None:
        return None
    taken = jax.tree.structure((([0] * count,), {}))
    try:
        program, number, numbered, others = pickle.loads(data)
        results = jax.tree.structure([0] * len(jax.tree.leaves(numbered)))
        load = deserialize_and_load if number == device.id else _loaded_elsewhere
        executable = load(program, taken, results, execution_devices=[device])
    except Exception:  # of any kind, also of XLA: as if it were not there
        return None
    return _callable(executable, numbered, others)


def _loaded_elsewhere(program: bytes, taken: Any, results: Any, execution_devices: list[Any]) -> Any:
    """As JAX's ``deserialize_and_load``, on another device than that which the program was compiled for.

    JAX has no public way, and no promise that this one stays: where anything is missing the device compiles for itself.
    """
    from jax._src import compiler
    from jax.experimental import serialize_executable

    (device,) = execution_devices
    options = compiler.get_compile_options(1, 1, np.array([[device.id]]), backend=device.client)

    class Reader(serialize_executable._JaxPjrtUnpickler):
        def persistent_load(self, pid: Any) -> Any:
            if pid[0] == "exec":
                return self.backend.deserialize_executable(pid[1], self.execution_devices, options)
            return device if pid[0] == "device" else super().persistent_load(pid)

    unloaded, kinds, no_kwargs = Reader(io.BytesIO(program), device.client, [device]).load()
    loaded = unloaded.load()
    if loaded.xla_executable.local_devices() != [device]:
        raise RuntimeError("it stayed with its device")
    return jax.stages.Compiled(loaded, [], taken.unflatten(kinds), results, no_kwargs=no_kwargs)


def _callable(executable: Any, numbered: Any, others: Any) -> Callable[[list[Any]], Any]:
    tree = jax.tree.structure(numbered)
    if not jax.tree.leaves(others):
        return lambda leaves: tree.unflatten(executable(leaves))
    return lambda leaves: eqx.combine(tree.unflatten(executable(leaves)), others)


def _committed(x: Any) -> bool:
    """Whether it must stay on its device; so must what is computed of it."""
    return isinstance(x, jax.Array) and getattr(x, "committed", False)


def _device(leaves: list[Any]) -> Any:
    """The one device that the arrays want; None if there are several."""
    committed = [x.devices() for x in leaves if _committed(x)]
    wanted = set().union(*committed)
    if not wanted:
        chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
        return chosen if isinstance(chosen, jax.Device) else jax.local_devices(backend=chosen)[0]
    return wanted.pop() if len(wanted) == 1 else None


def _settings() -> str:
    """All settings of JAX that may change what is compiled."""
    given = sorted(jax.config.values.items())
    values = {name: getattr(jax.config, name, value) for name, value in given if not _NO_MATTER.match(name)}
    return repr(values)


def _digest() -> str | None:
    """Of the text of this library and of what makes its trees; None where there is no text to read."""
    root = Path(__file__).resolve().parents[1]
    made, paths = hashlib.sha256(version("equinox").encode()), sorted(root.rglob("*.py"))
    try:
        for path in paths:
            made.update(f"{path.relative_to(root)}\0{path.stat().st_size}\0".encode())
            made.update(path.read_bytes())
    except OSError:
        return None
    return made.hexdigest() if paths else None


_library = cache(_digest)
_library()  # of what is being imported, not of what it is edited to


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
