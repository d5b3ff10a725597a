"""The numbers that are tuned: leaves of a method by path, as free numbers that respect their bounds."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.errors import UserError, close_names
from jaxalign.parametrization import as_float64, tunables

__all__ = ["Bounded", "Space", "space_of"]

_RATIO = 10.0  # of the bounds, from which a number is counted by its logarithm
_MARGIN = 1e-3  # of the range: a start on a bound is moved inside by so much
_BELOW = 1e-9  # of the start: the lower end of a positive number whose bound is zero


class Bounded(eqx.Module):
    """A number between bounds as a free one: ``x = low + (high - low) sigmoid(u)``, or the same of logarithms.

    ``u`` is scaled so that at the start ``d ln x / d u = 1`` (logarithmic), or ``d x / d u`` is a quarter of the range:
    one learning rate serves numbers of any size.

    Attributes:
        low: of the number, or of its logarithm.
        high: the same.
        centre: of the sigmoid's argument: zero is the start.
        slope: of the sigmoid's argument.
        bounds: of the number.
        log: whether the logarithm is meant.
    """

    low: Float[Array, ""] = eqx.field(converter=as_float64)
    high: Float[Array, ""] = eqx.field(converter=as_float64)
    centre: Float[Array, ""] = eqx.field(converter=as_float64)
    slope: Float[Array, ""] = eqx.field(converter=as_float64)
    bounds: tuple[Array, Array]
    log: bool = eqx.field(static=True)

    @classmethod
    def around(cls, start: float, low: float, high: float) -> Bounded:
        """With zero for the start.

        Raises:
            ValueError: the start is zero, or the number is not finite, where the logarithm is meant.
        """
        bounds = as_float64(low), as_float64(high)
        log = (low > 0 and high / low >= _RATIO) or low == 0
        if log:
            if start <= 0:
                raise ValueError("starts at zero, from where no step in its logarithm leads away")
            low, high, start = math.log(low or _BELOW * start), math.log(high), math.log(start)
        share = min(max((start - low) / (high - low), _MARGIN), 1 - _MARGIN)
        steep = share * (1 - share) * (high - low)  # of the sigmoid there
        return cls(low, high, math.log(share / (1 - share)), (1.0 if log else (high - low) / 4) / steep, bounds, log)

    def __call__(self, free: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """The number itself."""
        x = self.low + (self.high - self.low) * jax.nn.sigmoid(self.centre + self.slope * free)
        x = jnp.exp(x) if self.log else x
        return jnp.clip(x, *self.bounds)  # against rounding

    def free(self, x: Any) -> float:
        """The free number of a number within the bounds."""
        low, high = float(self.low), float(self.high)
        x = np.log(x) if self.log else np.asarray(x)
        share = np.clip((x - low) / (high - low), 1e-12, 1 - 1e-12)
        return float((np.log(share / (1 - share)) - float(self.centre)) / float(self.slope))


class Space(eqx.Module):
    """Paths of a method, and how free numbers become the method.

    Attributes:
        paths: of what is tuned.
        start: the method to start from.
        maps: path -> how its number is bounded; what has no bounds is not in it.
    """

    paths: tuple[str, ...] = eqx.field(static=True)
    start: Any
    maps: dict[str, Bounded]

    def method(self, free: Mapping[str, Any]) -> Any:
        """The method with these free numbers. Pure."""
        method = self.start
        for path in self.paths:
            value = free[path]
            if path in self.maps:
                value = self.maps[path](value)
            elif isinstance(value, eqx.Module):
                value = eqx.combine(value, _at(self.start, path))
            method = eqx.tree_at(lambda m, path=path: _at(m, path), method, value)
        return method

    @property
    def origin(self) -> dict[str, Any]:
        """The free numbers of the start."""
        out: dict[str, Any] = {}
        for path in self.paths:
            value = _at(self.start, path)
            if path in self.maps:
                out[path] = jnp.zeros(value.shape, jnp.float64)
            else:
                out[path] = eqx.filter(value, eqx.is_inexact_array)
        return out

    def values(self, free: Mapping[str, Any]) -> dict[str, float]:
        """Path -> number, for people: without the parts of the method that are no single number."""
        return {path: float(self.maps[path](free[path])) for path in self.paths if path in self.maps}


def _at(method: Any, path: str) -> Any:
    return functools.reduce(getattr, path.split("."), method)


def space_of(method: Any, paths: Sequence[str]) -> Space:
    """What is to be tuned of a method.

    Args:
        method: to start from.
        paths: of numbers declared by :func:`jaxalign.tunable` ("weight.threshold"), or of modules of the method (a
            network "weight.net", say), whose arrays are all tuned, without bounds.

    Raises:
        UserError: no path, an unknown one (the nearest are offered), one named twice, a number that starts at zero
            where steps are relative or is not set at all, or a figure with a number per axis.
    """
    known = tunables(method)
    if isinstance(paths, str):
        paths = [paths]
    if not paths:
        raise UserError(f"name a parameter to tune: {', '.join(known)}")
    maps: dict[str, Bounded] = {}
    for path in paths:
        if list(paths).count(path) > 1:
            raise UserError(f"parameter {path} is named twice")
        if path in known:
            start, (low, high) = _at(method, path), known[path]
            if start is None:
                raise UserError(f"{path} is not set: give it a positive start (--set {path}=...)")
            if start.ndim:
                numbers = ", ".join(f"{x:g}" for x in np.asarray(start).flat)
                raise UserError(f"{path} holds {numbers}, one per axis, and a single number is tuned: set one for all")
            try:
                maps[path] = Bounded.around(float(start), low, high)
            except ValueError as error:
                raise UserError(f"{path} {error}: give it a positive start (--set {path}=...)") from None
        elif not _is_module(method, path):
            near = close_names(path, known) or list(known)
            raise UserError(
                f"no parameter {path!r} to tune in this method: did you mean {', '.join(near)}?"
                if near
                else "this method has no parameters to tune"
            )
    return Space(tuple(paths), method, maps)


def _is_module(method: Any, path: str) -> bool:
    try:
        value = _at(method, path)
    except AttributeError:
        return False
    return isinstance(value, eqx.Module) and bool(jax.tree.leaves(eqx.filter(value, eqx.is_inexact_array)))
