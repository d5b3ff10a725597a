"""Tunable numbers of a method: array leaves that carry their unit and bounds, read and set by path."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxalign.errors import UserError, close_names
from jaxalign.renamed import check_renamed

__all__ = [
    "Numbers",
    "as_float64",
    "given",
    "optional_count",
    "parameters",
    "tunable",
    "tunables",
    "with_parameters",
    "words",
]

T = TypeVar("T")


def as_float64(value: Any) -> jax.Array:
    """A float64 array leaf (strongly typed: a weak type would compile once more); tracers pass."""
    if isinstance(value, jax.Array):
        return value.astype(jnp.float64)
    return jax.device_put(np.array(value, np.float64))  # jnp.asarray compiles a program for each shape


def _number(value: Any) -> jax.Array | None:
    """What a tunable field holds."""
    if value is None:
        return None
    try:
        return as_float64(value)
    except (TypeError, ValueError) as error:
        raise UserError(f"expected a number or a list of numbers, got {value!r}") from error


def tunable(default: float | None, *, unit: str, bounds: tuple[float, float], axes: bool = False) -> Any:
    """A field that is a number to tune: converted to an array leaf, so that it is traced and differentiated.

    Args:
        default: the value where none is given; None: by default there is no such number.
        unit: for people ("1", "m/s", "s", ...).
        bounds: the sensible range; setting a value outside is refused by :func:`with_parameters`.
        axes: it may also be three numbers, one per axis.
    """
    optional = default is None
    metadata = {"unit": unit, "bounds": bounds, "axes": axes, "optional": optional}
    return eqx.field(converter=_number if optional or axes else as_float64, default=default, metadata=metadata)


def given(default: Any) -> Any:
    """A static field that a recipe or the data fill in: no parameter to set."""
    return eqx.field(static=True, default=default, metadata={"given": True})


def optional_count() -> Any:
    """A static field holding a whole number or None."""
    return eqx.field(static=True, default=None, metadata={"optional": True, "integer": True})


class _Field(NamedTuple):
    """As much of a field as is asked for."""

    metadata: Mapping[str, Any]


class Numbers(eqx.Module):
    """Numbers to tune whose names are not known beforehand, set by path as the fields of a module are.

    Attributes:
        values: by name; a name may hold dots.
        specs: name, unit and bounds of each (static).
    """

    values: dict[str, jax.Array]
    specs: tuple[tuple[str, str, tuple[float, float]], ...] = eqx.field(static=True)

    @classmethod
    def of(cls, specs: Iterable[tuple[str, float, str, tuple[float, float]]], given: Numbers | None = None) -> Numbers:
        """From name, value, unit and bounds of each; values that are given already stay."""
        known = {} if given is None else given.values
        values, kept = {}, []
        for name, value, unit, bounds in specs:
            values[name] = known[name] if name in known else as_float64(value)
            kept.append((name, unit, bounds))
        return cls(values, tuple(kept))

    def __getitem__(self, name: str) -> jax.Array:
        return self.values[name]

    def fields(self) -> Iterator[tuple[str, jax.Array, _Field]]:
        """Name, value, and what there is to know of it."""
        for name, unit, bounds in self.specs:
            yield name, self.values[name], _Field({"unit": unit, "bounds": bounds})

    def with_value(self, name: str, value: Any) -> Numbers:
        """A copy with one of them set."""
        return Numbers({**self.values, name: value}, self.specs)


def _fields(module: Any, prefix: str = "") -> Iterator[tuple[str, Any, dataclasses.Field]]:
    """Every settable field of a module and its slots: (path, value, field)."""
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        path = f"{prefix}{field.name}"
        if (value is None and field.metadata.get("slot")) or field.metadata.get("given"):
            continue  # an empty slot has nothing to set, and what a recipe is built for stays
        if isinstance(value, Numbers):
            for name, number, known in value.fields():
                yield f"{path}.{name}", number, known  # pyright: ignore[reportReturnType]
        elif isinstance(value, eqx.Module):
            hidden = field.metadata.get("hides", ())
            for found in _fields(value, f"{path}."):
                own = found[0].removeprefix(f"{path}.")
                if not any(own == name or own.startswith(f"{name}.") for name in hidden):
                    yield found
        else:
            yield path, value, field


def parameters(method: Any) -> dict[str, Any]:
    """Paths and values of everything that can be set in a method, as plain Python values (JSON-ready)."""
    out = {}
    for path, value, _ in _fields(method):
        if isinstance(value, jax.Array | np.ndarray):
            value = np.asarray(value).tolist()
        out[path] = list(value) if isinstance(value, tuple) else value
    return out


def tunables(method: Any) -> dict[str, tuple[float, float]]:
    """Paths and bounds of the numbers that can be tuned: those declared by :func:`tunable`."""
    return {path: field.metadata["bounds"] for path, _, field in _fields(method) if "bounds" in field.metadata}


def _parse(path: str, text: Any, old: Any, field: dataclasses.Field) -> Any:
    """Turn a value (a string from the command line, or a Python value) into what the field holds."""

    def refuse(wish: str) -> UserError:
        return UserError(f"{path} = {text!r}: {wish}")

    value = _read(text) if isinstance(text, str) else text
    if value is None and field.metadata.get("optional"):
        return None
    if isinstance(old, bool):
        if not isinstance(value, bool):
            raise refuse("must be true or false")
        return value
    tuned = "bounds" in field.metadata or isinstance(old, jax.Array)
    if isinstance(value, Tracer) and tuned:
        return as_float64(value)  # its bounds cannot be checked
    if tuned:
        numbers, axes = _numbers(value), field.metadata.get("axes")
        shapes = ((), (3,)) if axes else (np.shape(old),)
        if numbers is None or numbers.shape not in shapes:
            of_shape = f" (array of shape {np.shape(old)})" if np.ndim(old) else ""
            raise refuse("must be a number" + (", or three, one per axis" if axes else of_shape))
        low, high = field.metadata.get("bounds", (-np.inf, np.inf))
        if not np.all((numbers >= low) & (numbers <= high)):
            raise refuse(f"outside its bounds {low:g} .. {high:g} {field.metadata.get('unit', '')}".rstrip())
        return as_float64(numbers)
    if isinstance(old, tuple):
        named = words(text)
        if named is None:
            raise refuse("must be words, with commas between them, or none")
        return named
    if isinstance(old, str):
        if not isinstance(text, str):
            raise refuse("must be a word")
        return text  # as typed: no word is a number here
    whole = isinstance(old, int) or bool(field.metadata.get("integer"))
    number = _numbers(value)
    if number is None or number.ndim or np.isnan(number):
        raise refuse("must be a whole number" if whole else "must be a number")
    if not whole:
        return float(number)
    if not float(number).is_integer() or abs(float(number)) >= 2**63:
        raise refuse("must be a whole number")
    return int(number)


def words(given: Any) -> tuple[str, ...] | None:
    """Words as typed ("latency,lever", "none") or as a list; None if they are no words."""
    if isinstance(given, str):
        read = _read(given)
        given = read if isinstance(read, list) else [] if read is None else given.split(",")
    if not isinstance(given, tuple | list) or not all(isinstance(word, str) for word in given):
        return None
    return tuple(word.strip() for word in given if word.strip())


def _read(text: str) -> Any:
    """What was typed: JSON, with true, false and none in any case; anything else is itself."""
    word = text.strip().lower()
    try:
        return json.loads({"none": "null"}.get(word, word) if word in ("true", "false", "null", "none") else text)
    except ValueError:
        return text


def _numbers(value: Any) -> np.ndarray | None:
    """The value as an array of real numbers, or None if it is no such thing."""
    try:
        array = np.asarray(value)
    except ValueError:  # ragged
        return None
    return array if array.dtype.kind in "iuf" else None


def with_parameters(method: T, values: Mapping[str, Any]) -> T:
    """A copy of a method with some fields set, by path ("weight.threshold", "observe.window", ...).

    Args:
        method: an aligner or any nest of modules.
        values: path -> value; strings are parsed as on the command line.

    Raises:
        UserError: unknown path (the nearest ones are offered), wrong type, or a number outside its bounds.
    """
    known = {path: (value, field) for path, value, field in _fields(method)}
    for path, text in values.items():
        if path not in known:
            check_renamed(path, known)
            slot = _empty_slot(method, path.split(".")[:-1])
            if slot is not None:
                raise UserError(f"{path}: there is no {slot} to set: choose one first (--{slot} NAME)")
            near = close_names(path, known) or sorted(known)
            raise UserError(f"no parameter {path!r} in this method: did you mean {', '.join(near)}?")
        old, field = known[path]
        method = _replace(method, path.split("."), _parse(path, text, old, field))
    return method


def _empty_slot(module: Any, names: list[str]) -> str | None:
    """The first of these fields, one within the other, that holds nothing; None: there is none such."""
    for name in names:
        module = vars(module).get(name, "") if hasattr(module, "__dict__") else ""
        if module is None:
            return name
    return None


def _replace(module: Any, names: list[str], value: Any) -> Any:
    """Rebuild the modules along a path, so that their own checks run on the new value."""
    if isinstance(module, Numbers):
        return module.with_value(".".join(names), value)
    head, *rest = names
    new = _replace(getattr(module, head), rest, value) if rest else value
    try:
        return dataclasses.replace(module, **{head: new})
    except UserError:
        raise
    except ValueError as error:
        raise UserError(str(error)) from error
