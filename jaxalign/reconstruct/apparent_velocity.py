"""A robust Kalman filter on the apparent velocity of gravity: four known functions of time per axis of b0."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.earth import EARTH_RATE
from jaxalign.errors import UserError
from jaxalign.observe import AbstractObserve, Context, Pair
from jaxalign.parametrization import tunable
from jaxalign.reconstruct.base import AbstractReconstruct
from jaxalign.vector import Vec3, where

__all__ = ["ApparentVelocityFilter"]

_SCALE = 300.0  # s; of the basis
_C3 = 2 * np.sin(EARTH_RATE * _SCALE / 2) ** 2
_C4 = EARTH_RATE * _SCALE - np.sin(EARTH_RATE * _SCALE)
# (cos wt, sin wt, t, 1) = _PUBLISHED @ (1, t/T, (1 - cos wt)/c3, (wt - sin wt)/c4)
_PUBLISHED = np.array([[1, 0, -_C3, 0], [0, EARTH_RATE * _SCALE, 0, -_C4], [0, _SCALE, 0, 0], [1, 0, 0, 0]])
_SHAPE = _PUBLISHED.T @ _PUBLISHED
_UPPER = [(i, j) for i in range(4) for j in range(i, 4)]


class _State(eqx.Module):
    """Coefficients and the upper triangle of their covariance, row by row; all of shape (3,): one per axis of b0."""

    xi: tuple[Float[Array, " 3"], ...]
    p: tuple[Float[Array, " 3"], ...]
    weight: Float[Array, " 3"]  # of the last measurement
    start: Float[Array, ""]  # s, of the first velocity: the vectors are integrated since then


class ApparentVelocityFilter(AbstractReconstruct):
    """Fit ``beta(t) = Xi (cos wt, sin wt, t, 1)`` per axis of b0 with a robust Kalman filter, and put the fit in place.

    Huber's weight ``w = min(1, gamma / |zeta|)``, zeta the innovation over the aid's standard deviation, divides R
    inside gain and covariance. The basis is 1, t/T, (1 - cos wt)/c3, (wt - sin wt)/c4, which spans the same functions;
    the prior and the process noise are the published ones transformed with it (in the published basis float64 fails:
    its singular values are 1.7e6 apart). An outlier among the first vectors can still ruin a run: the first innovation
    is as large as the vector itself. For a standing vehicle the standard deviation is that of a step, not of the
    integrated force, so that gamma counts other units. The axes are those of b0: the result depends a little on how
    the unit is mounted.

    Attributes:
        gamma: Huber's threshold, in standard deviations.
        process: variance that each published coefficient gains per vector (printed: 1e-3 squared).
        prior: variance of each published coefficient at the start.
        drop_constant: leave the constant out of the reconstructed vector, and with it the noise of the first velocity:
            0.3 instead of 0.9 deg on clean data with process = 1e-8, at the price of outliers in the first epochs.
        as_published: (33), (36)-(39) as printed: the weight scales the innovation and leaves the covariance as if the
            measurement had been taken whole. Does not work (46 deg on clean data); for the record.

    Source: Xu 2020 (27)-(40). Deviations: as above, but for ``as_published``, which shares the basis only.
    """

    keeps_moment: ClassVar[bool] = False
    gamma: Float[Array, ""] = tunable(1.345, unit="1", bounds=(0.1, 100.0))
    process: Float[Array, ""] = tunable(1e-6, unit="1", bounds=(0.0, 1.0))
    prior: Float[Array, ""] = tunable(1e10, unit="1", bounds=(1e2, 1e11))
    drop_constant: bool = eqx.field(static=True, default=False)
    as_published: bool = eqx.field(static=True, default=False)

    def check(self, observe: AbstractObserve) -> None:
        """The basis is that of gravity integrated since the start."""
        if getattr(observe, "vectors", "integrated") != "integrated" or getattr(observe, "window", 0.0):
            raise UserError(
                "reconstruct: the apparent-velocity filter fits vectors integrated since the start: leave "
                "observe.window at 0 and observe.vectors at 'integrated'"
            )
        if observe.aid == "nav":
            raise UserError(
                "reconstruct: with a navigation-frame aid the vector in b0 holds the vehicle's own velocity, which the "
                "apparent-velocity filter does not know (it misfits by metres per second): take roba, or a body aid"
            )

    def init(self) -> Any:
        """No coefficients, the prior's covariance."""
        p = tuple(jnp.full(3, self.prior * _SHAPE[ij]) for ij in _UPPER)
        return _State((jnp.zeros(3),) * 4, p, jnp.ones(3), jnp.zeros((), jnp.float64))

    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Pair]:
        """Consume one pair."""
        # The vector of the first velocity is zero by definition, not by measurement.
        null = ~(pair.clean.norm2() > 0)
        start = jnp.where(pair.valid & null, context.time, state.start)
        state, used = dataclasses.replace(state, start=start), pair.valid & ~null
        b = _basis(context.time - start)
        state = where(used, self._measured(state, b, pair.beta.array, context.sd), state)
        first = 1 if self.drop_constant else 0
        beta = where(used, Vec3.of(_dot(state.xi[first:], b[first:])), pair.beta)
        return state, dataclasses.replace(pair, beta=beta, open_beta=beta, moment=None)

    def _measured(self, state: _State, b: list[Any], beta: Any, sd: Any) -> _State:
        """One measurement of the three axes, side by side."""
        p = {ij: x + self.process * _SHAPE[ij] for ij, x in zip(_UPPER, state.p, strict=True)}
        projected = [_dot([p[min(i, j), max(i, j)] for j in range(4)], b) for i in range(4)]
        innovation, sd = beta - _dot(state.xi, b), jnp.maximum(sd, 1e-9)
        size = jnp.abs(innovation)
        beyond = size > self.gamma * sd
        weight = jnp.where(beyond, self.gamma * sd / jnp.where(beyond, size, 1.0), 1.0)
        variance = sd * sd
        r = variance if self.as_published else variance / weight
        gain = [x / (_dot(projected, b) + r) for x in projected]
        step = innovation * weight if self.as_published else innovation
        xi = tuple(x + g * step for x, g in zip(state.xi, gain, strict=True))
        if self.as_published:
            new = tuple(p[i, j] - gain[i] * projected[j] for i, j in _UPPER)
        else:
            # Joseph: (I - G b^T) P (I - G b^T)^T + G R G^T.
            left = [[p[min(i, j), max(i, j)] - gain[i] * projected[j] for j in range(4)] for i in range(4)]
            along = [_dot(row, b) for row in left]
            new = tuple(left[i][j] - along[i] * gain[j] + r * gain[i] * gain[j] for i, j in _UPPER)
        return _State(xi, new, weight, state.start)


def _dot(a: Any, b: Any) -> Any:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _basis(time: Any) -> list[Any]:
    """The four functions at a time, s."""
    angle = EARTH_RATE * time
    half = jnp.sin(angle / 2)
    small = angle < 0.5
    square = jnp.where(small, angle, 0.0) ** 2
    series = 1 - square / 20 * (1 - square / 42 * (1 - square / 72 * (1 - square / 110 * (1 - square / 156))))
    rest = jnp.where(small, angle**3 / 6 * series, angle - jnp.sin(angle))
    return [jnp.ones_like(time), time / _SCALE, 2 * half * half / _C3, rest / _C4]
