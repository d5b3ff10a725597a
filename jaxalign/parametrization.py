"""Tunable numbers of a method: array leaves that carry their unit and bounds, read and set by path."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxalign.errors import UserError, close_names

__all__ = ["as_float64", "parameters", "tunable", "tunables", "with_parameters"]

T = TypeVar("T")


def as_float64(value: Any) -> jax.Array:
    """A float64 array leaf (strongly typed: a weak type would compile once more); tracers pass."""
    if isinstance(value, jax.Array):
        return value.astype(jnp.float64)
    return jax.device_put(np.array(value, np.float64))  # jnp.asarray compiles a program for each shape


def tunable(default: float, *, unit: str, bounds: tuple[float, float]) -> Any:
    """A field that is a number to tune: converted to an array leaf, so that it is traced and differentiated.

    Args:
        default: the value where none is given.
        unit: for people ("1", "m/s", "s", ...).
        bounds: the sensible range; setting a value outside is refused by :func:`with_parameters`.
    """
    return eqx.field(converter=as_float64, default=default, metadata={"unit": unit, "bounds": bounds})


def _fields(module: Any, prefix: str = "") -> Iterator[tuple[str, Any, dataclasses.Field]]:
    """Every settable field of a module and its slots: (path, value, field)."""
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        path = f"{prefix}{field.name}"
        if (value is None and field.metadata.get("slot")) or field.metadata.get("given"):
            continue  # an empty slot has nothing to set, and what a recipe is built for stays
        if isinstance(value, eqx.Module):
            hidden = field.metadata.get("hides", ())
            yield from (x for x in _fields(value, f"{path}.") if x[0].removeprefix(f"{path}.") not in hidden)
        else:
            yield path, value, field


def parameters(method: Any) -> dict[str, Any]:
    """Paths and values of everything that can be set in a method, as plain Python values (JSON-ready)."""
    out = {}
    for path, value, _ in _fields(method):
        out[path] = np.asarray(value).tolist() if isinstance(value, jax.Array | np.ndarray) else value
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
    if isinstance(value, Tracer) and isinstance(old, jax.Array):
        return as_float64(value)  # its bounds cannot be checked
    if isinstance(old, jax.Array):
        numbers = _numbers(value)
        if numbers is None or numbers.shape != old.shape:
            raise refuse("must be a number" + (f" (array of shape {old.shape})" if old.ndim else ""))
        low, high = field.metadata.get("bounds", (-np.inf, np.inf))
        if not np.all((numbers >= low) & (numbers <= high)):
            raise refuse(f"outside its bounds {low:g} .. {high:g} {field.metadata.get('unit', '')}".rstrip())
        return as_float64(numbers)
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
    """A copy of a method with some fields set, by path ("weight.gamma", "observe.window", ...).

    Args:
        method: an aligner or any nest of modules.
        values: path -> value; strings are parsed as on the command line.

    Raises:
        UserError: unknown path (the nearest ones are offered), wrong type, or a number outside its bounds.
    """
    known = {path: (value, field) for path, value, field in _fields(method)}
    for path, text in values.items():
        if path not in known:
            slot = path.partition(".")[0]
            if slot != path and vars(method).get(slot, "") is None:
                raise UserError(f"{path}: there is no {slot} to set: choose one first (--{slot} NAME)")
            near = close_names(path, known) or sorted(known)
            raise UserError(f"no parameter {path!r} in this method: did you mean {', '.join(near)}?")
        old, field = known[path]
        method = _replace(method, path.split("."), _parse(path, text, old, field))
    return method


def _replace(module: Any, names: list[str], value: Any) -> Any:
    """Rebuild the modules along a path, so that their own checks run on the new value."""
    head, *rest = names
    new = _replace(getattr(module, head), rest, value) if rest else value
    try:
        return dataclasses.replace(module, **{head: new})
    except UserError:
        raise
    except ValueError as error:
        raise UserError(str(error)) from error
