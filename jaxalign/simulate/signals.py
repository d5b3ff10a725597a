"""Scalar signals of time, from which trajectories are composed: sums of sines, smooth steps, linear ramps.

Each is an `eqx.Module` whose numbers are array leaves, a pure elementwise function of the time, and
differentiable in the time (the body rate comes from `jax.jvp`) and in its numbers. Signals add with ``+``.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.errors import UserError
from jaxalign.simulate.arguments import leaf

__all__ = ["AbstractSignal", "Constant", "Ramps", "Sines", "Steps", "Sum"]


class AbstractSignal(eqx.Module):
    """A scalar function of time."""

    @abstractmethod
    def __call__(self, t: Any) -> Any:
        """Value at the times t (s), elementwise."""

    @property
    def breaks(self) -> tuple[Any, ...]:
        """Times (s) at which the slope jumps: they must fall on boundaries between IMU samples."""
        return ()

    def __add__(self, other: AbstractSignal) -> Sum:
        return Sum((self, other))


class Constant(AbstractSignal):
    """A constant."""

    value: Float[Array, ""]

    def __init__(self, value: Any = 0.0):
        self.value = leaf(value, "Constant.value")

    def __call__(self, t: Any) -> Any:
        """Value at the times t (s)."""
        return jnp.zeros_like(t) + self.value


class Sum(AbstractSignal):
    """Several signals added."""

    terms: tuple[AbstractSignal, ...]

    def __call__(self, t: Any) -> Any:
        """Value at the times t (s)."""
        return sum(term(t) for term in self.terms)

    @property
    def breaks(self) -> tuple[Any, ...]:
        """Times (s) at which the slope of any term jumps."""
        return tuple(b for term in self.terms for b in term.breaks)


def _columns(what: str, **columns: Any) -> tuple[Array, ...]:
    """Vectors of one length, from numbers or lists."""
    arrays = [jnp.atleast_1d(leaf(value, f"{what}.{name}")) for name, value in columns.items()]
    longest = max(a.size for a in arrays)
    for name, a in zip(columns, arrays, strict=True):
        if a.ndim > 1 or a.size not in (1, longest):
            raise UserError(f"{what}.{name}: expected one number or {longest} of them, got shape {a.shape}")
    return tuple(jnp.broadcast_to(a, (longest,)) for a in arrays)


class Sines(AbstractSignal):
    """``mean + sum amplitude sin(2 pi frequency t + phase)``.

    Attributes:
        mean: in the unit of the signal.
        amplitude: (k,), in the unit of the signal.
        frequency: (k,), Hz.
        phase: (k,), rad.
    """

    mean: Float[Array, ""]
    amplitude: Float[Array, " k"]
    frequency: Float[Array, " k"]
    phase: Float[Array, " k"]

    def __init__(self, amplitude: Any, frequency: Any, phase: Any = 0.0, mean: Any = 0.0):
        self.mean = leaf(mean, "Sines.mean")
        self.amplitude, self.frequency, self.phase = _columns(
            "Sines", amplitude=amplitude, frequency=frequency, phase=phase
        )

    def __call__(self, t: Any) -> Any:
        """Value at the times t (s)."""
        value = jnp.zeros_like(t) + self.mean
        for a, f, p in zip(self.amplitude, self.frequency, self.phase, strict=True):
            value = value + a * jnp.sin(2 * jnp.pi * f * t + p)
        return value


class Steps(AbstractSignal):
    """``start + sum size (1 + tanh((t - centre) / width)) / 2``: smooth steps, infinitely differentiable.

    Attributes:
        start: value long before the first step.
        size: (k,), in the unit of the signal.
        centre: (k,), s.
        width: (k,), s.
    """

    start: Float[Array, ""]
    size: Float[Array, " k"]
    centre: Float[Array, " k"]
    width: Float[Array, " k"]

    def __init__(self, size: Any, centre: Any, width: Any, start: Any = 0.0):
        self.start = leaf(start, "Steps.start")
        leaf(width, "Steps.width", low=1e-6)
        self.size, self.centre, self.width = _columns("Steps", size=size, centre=centre, width=width)

    def __call__(self, t: Any) -> Any:
        """Value at the times t (s)."""
        value = jnp.zeros_like(t) + self.start
        for size, centre, width in zip(self.size, self.centre, self.width, strict=True):
            value = value + size / 2 * (1.0 + jnp.tanh((t - centre) / width))
        return value


class Ramps(AbstractSignal):
    """``start + sum rate clip(t - begin, 0, end - begin)``: linear between the break points, continuous.

    The slope jumps at the break points. The quadrature of the generator samples strictly inside the IMU
    samples, so increments are exact as long as the breaks fall on boundaries between samples.

    Attributes:
        start: value before the first ramp.
        rate: (k,), in the unit of the signal per s.
        begin: (k,), s.
        end: (k,), s.
    """

    start: Float[Array, ""]
    rate: Float[Array, " k"]
    begin: Float[Array, " k"]
    end: Float[Array, " k"]

    def __init__(self, rate: Any, begin: Any, end: Any, start: Any = 0.0):
        self.start = leaf(start, "Ramps.start")
        self.rate, self.begin, self.end = _columns("Ramps", rate=rate, begin=begin, end=end)

    def __call__(self, t: Any) -> Any:
        """Value at the times t (s)."""
        value = jnp.zeros_like(t) + self.start
        for rate, begin, end in zip(self.rate, self.begin, self.end, strict=True):
            value = value + rate * jnp.clip(t - begin, 0.0, end - begin)
        return value

    @property
    def breaks(self) -> tuple[Any, ...]:
        """Times (s) at which the slope jumps."""
        return tuple(np.unique(np.concatenate([np.asarray(self.begin), np.asarray(self.end)])).tolist())
