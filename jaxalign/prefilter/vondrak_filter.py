"""Vondrak's filter: one number to choose, exact on quadratics, for any spacing and any weights.

The smoothed values s minimise ``F + S / theta`` with F the mean weighted square of y - s and S the mean square of the
third derivative of s. For equal spacing the gain is ``1 / (1 + (2 sin(pi f dt) / dt)^6 / theta)`` in the interior, that
of a third-order Butterworth run forth and back. Weighted sums of y, t y and t^2 y are preserved exactly, so a mean of
filtered data is the mean of the data; the first and last samples are hardly filtered (the response at twice the cut-off
is 0.99 at sample 0, 0.14 after a quarter of the period 1 / cut-off): never use one of them as a vector.

Source: the Vondrak paper (19)-(24) in Vondrak's own normalisation; as printed (22)-(23) lack it, which moves the
cut-off by dt^(-1/6). (24) is the limit of the gain for small f dt.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxalign.errors import UserError
from jaxalign.parametrization import tunable
from jaxalign.precision import require_x64
from jaxalign.prefilter.banded import smooth
from jaxalign.prefilter.base import AbstractPrefilter, Frame

__all__ = ["Vondrak", "cutoff_from_theta", "gain", "theta_from_cutoff", "vondrak"]


def theta_from_cutoff(cutoff: Any, gain: Any = 0.5) -> Any:
    """The smoothing factor theta (s^-6) whose gain at a frequency (Hz) is ``gain`` (default 0.5: -6 dB)."""
    return (2 * jnp.pi * cutoff) ** 6 * gain / (1.0 - gain)


def cutoff_from_theta(theta: Any, gain: Any = 0.5) -> Any:
    """The frequency (Hz) at which a smoothing factor (s^-6) has that gain."""
    return (theta * (1.0 - gain) / gain) ** (1 / 6) / (2 * jnp.pi)


def gain(frequency: Any, dt: Any, theta: Any) -> Any:
    """Exact gain in the interior of an evenly spaced record; (24) of the paper is its limit for small f dt."""
    return 1.0 / (1.0 + (2 * jnp.sin(jnp.pi * frequency * dt) / dt) ** 6 / theta)


class Vondrak(AbstractPrefilter):
    """Vondrak's filter by its cut-off frequency; the smoothing factor is (2 pi cutoff)^6 (:func:`theta_from_cutoff`).

    float64 is good to cutoff x dt = 1e-4; below, rounding shows.

    Attributes:
        cutoff: frequency (Hz) of gain 0.5.
        frame: in which the specific force is filtered: inertial (the gyros turn it into b at the start and back; right
            on a base that rocks) or body (axis by axis as measured).

    Source: the Vondrak paper, section 4; its cut-off is 0.5 Hz.
    """

    cutoff: Float[Array, ""] = tunable(0.5, unit="Hz", bounds=(1e-3, 100.0))
    frame: Frame = eqx.field(static=True, default="inertial")

    @property
    def theta(self) -> Any:
        """Smoothing factor, s^-6."""
        return theta_from_cutoff(self.cutoff)

    def __call__(self, x: Float[Array, "samples axes"], dt: float) -> Float[Array, "samples axes"]:
        """The filtered record; differentiable in it and in the cut-off."""
        n = x.shape[0]
        t, p = jnp.arange(n, dtype=jnp.float64) * dt, jnp.ones(n, jnp.float64)
        return jax.vmap(smooth, (None, 1, None, None), 1)(t, x, p, self.theta)

    def response(self, frequency: Any, dt: float) -> Any:
        """Gain at frequencies (Hz): exact in the interior."""
        return gain(frequency, dt, self.theta)


def vondrak(
    t: Float[ArrayLike, " n"],
    y: Float[ArrayLike, "*shape"],
    cutoff: Any = 0.5,
    *,
    theta: Any = None,
    weights: Float[ArrayLike, " n"] | None = None,
) -> Float[Array, "*shape"]:
    """Smooth a record with any spacing, any weights and missing samples.

    Pure; differentiable in the data, the weights and the cut-off (not in the times), and vmappable. Inside traced code
    only the length can be checked; concrete input is checked whole.

    Args:
        t: times, s, increasing.
        y: the data, (n,) or (n, axes); a sample with a NaN in it gets weight zero (all its axes).
        cutoff: frequency of gain 0.5, Hz.
        theta: smoothing factor, s^-6, instead of the cut-off.
        weights: of the samples, >= 0, dimensionless; default 1.

    Returns:
        Smoothed values at all the times, also of missing samples.

    Raises:
        UserError: fewer than four samples, or three with a weight; times or weights that are not finite; times that
            do not increase; negative weights; a cut-off or theta that is not positive; infinite data; float32.
    """
    require_x64({"t": t, "y": y, "weights": weights})
    t, y = jnp.asarray(t, jnp.float64), jnp.asarray(y, jnp.float64)
    p = jnp.ones(t.shape) if weights is None else jnp.asarray(weights, jnp.float64)
    if t.ndim != 1 or y.ndim not in (1, 2) or y.shape[:1] != t.shape or p.shape != t.shape:
        raise UserError(
            f"vondrak: times {t.shape}, data {y.shape}, weights {p.shape}: give (n,) times, (n,) or (n, axes) data "
            "and (n,) weights"
        )
    if len(t) < 4:
        raise UserError(f"vondrak: {len(t)} samples: third derivatives need at least four")
    bad = ~jnp.isfinite(y).reshape(len(t), -1).all(axis=1)
    _check(t, y, p, "theta" if theta is not None else "cutoff", cutoff if theta is None else theta)
    p = jnp.where(bad, 0.0, p)
    y = jnp.where(jnp.isfinite(y), y, 0.0)
    theta = jnp.asarray(theta_from_cutoff(cutoff) if theta is None else theta, jnp.float64)
    columns = y.reshape(len(t), -1)
    return _columns(t, columns, p, theta).reshape(y.shape)


_columns = jax.jit(jax.vmap(smooth, (None, 1, None, None), 1))


def _check(t: Any, y: Any, p: Any, name: str, number: Any) -> None:
    """Refuse bad concrete input; tracers pass."""
    if not isinstance(number, Tracer) and not (np.ndim(number) == 0 and np.isfinite(number) and number > 0):
        unit = "s^-6" if name == "theta" else "Hz"
        raise UserError(f"vondrak: {name} = {number}: must be one positive, finite number ({unit})")
    if not isinstance(t, Tracer):
        times = np.asarray(t)
        if not np.isfinite(times).all():
            raise UserError(f"vondrak: time number {int(np.flatnonzero(~np.isfinite(times))[0])} is not finite")
        if (np.diff(times) <= 0).any():
            at = int(np.flatnonzero(np.diff(times) <= 0)[0])
            raise UserError(
                f"vondrak: times must increase, but number {at + 1} ({times[at + 1]:g} s) follows {times[at]:g} s: "
                "sort the record, merge samples of one time"
            )
    if isinstance(p, Tracer) or isinstance(y, Tracer):
        return
    weights, data = np.asarray(p), np.asarray(y).reshape(len(p), -1)
    if not np.isfinite(weights).all() or (weights < 0).any():
        at = int(np.flatnonzero(~(np.isfinite(weights) & (weights >= 0)))[0])
        raise UserError(f"vondrak: weight number {at} is {weights[at]}: weights are finite and not negative")
    if np.isinf(data).any():
        raise UserError(f"vondrak: sample number {int(np.flatnonzero(np.isinf(data).any(axis=1))[0])} is infinite")
    known = int(((weights > 0) & np.isfinite(data).all(axis=1)).sum())
    if known < 3:
        raise UserError(f"vondrak: only {known} samples have a weight: a quadratic needs at least three")
