"""Checks of what a user hands to the simulator: one line of advice each, before any tracing."""

from __future__ import annotations

import json
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from jaxalign.errors import UserError
from jaxalign.precision import require_x64

__all__ = ["leaf", "parsed"]


def leaf(value: Any, what: str, low: float = -np.inf, high: float = np.inf) -> Array:
    """A float64 array leaf of a number or a list of numbers; concrete values are checked, traced ones pass.

    Raises:
        UserError: if a concrete value is not a number, not finite or outside ``low .. high``.
    """
    require_x64()
    if isinstance(value, str):  # NumPy would read it
        raise UserError(f"{what}: expected a number or a list of numbers, got {value!r}")
    try:
        array = jnp.asarray(value, jnp.float64)
    except (TypeError, ValueError) as error:
        raise UserError(f"{what}: expected a number or a list of numbers, got {value!r}") from error
    if isinstance(array, Tracer):
        return array
    concrete = np.asarray(array)
    if not np.all(np.isfinite(concrete)):
        raise UserError(f"{what}: must be finite, got {value!r}")
    if np.any(concrete < low) or np.any(concrete > high):
        limits = f"at least {low:g}" if np.isinf(high) else f"between {low:g} and {high:g}"
        raise UserError(f"{what}: must be {limits}, got {value!r}")
    return array


def parsed(value: Any, default: Any) -> Any:
    """A string (from a command line) where the default is not one becomes what it spells: "2", "true".

    What does not parse stays a string, for the check of the option to refuse.
    """
    if not isinstance(value, str) or isinstance(default, str):
        return value
    try:
        return json.loads(value.lower())
    except json.JSONDecodeError:
        return value
