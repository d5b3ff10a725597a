"""A robust Kalman filter on the apparent velocity of gravity: four known functions of time per axis of b0."""

# No annotations from the future: equinox looks for abstract attributes among them, and finds none in text.
import dataclasses
from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

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

__all__ = [
    "UPPER",
    "AbstractApparentVelocityFilter",
    "ApparentVelocityFilter",
    "Covariance",
    "Innovation",
    "dot",
    "projected",
]

_SCALE = 300.0  # s; of the basis
_C3 = 2 * np.sin(EARTH_RATE * _SCALE / 2) ** 2
_C4 = EARTH_RATE * _SCALE - np.sin(EARTH_RATE * _SCALE)
# (cos wt, sin wt, t, 1) = _PUBLISHED @ (1, t/T, (1 - cos wt)/c3, (wt - sin wt)/c4)
_PUBLISHED = np.array([[1, 0, -_C3, 0], [0, EARTH_RATE * _SCALE, 0, -_C4], [0, _SCALE, 0, 0], [1, 0, 0, 0]])
_SHAPE = _PUBLISHED.T @ _PUBLISHED
UPPER = [(i, j) for i in range(4) for j in range(i, 4)]


class _State(eqx.Module):
    """Coefficients and the upper triangle of their covariance, row by row; all of shape (3,): one per axis of b0."""

    xi: tuple[Float[Array, " 3"], ...]
    p: tuple[Float[Array, " 3"], ...]
    weight: Float[Array, " 3"]  # of the last measurement
    start: Float[Array, ""]  # s, of the first velocity: the vectors are integrated since then


Covariance = dict[tuple[int, int], Any]
"""Upper triangle of the coefficients' covariance: (i, j) -> (3,), one per axis of b0."""


class Innovation(NamedTuple):
    """One measurement of the three axes of b0, side by side, before it corrects anything; each (3,).

    Attributes:
        value: measured less predicted, m/s.
        weight: Huber's.
        variance: of the aid's noise, (m/s)^2.
    """

    value: Any
    weight: Any
    variance: Any


class AbstractApparentVelocityFilter(AbstractReconstruct):
    """Fit ``beta(t) = Xi (cos wt, sin wt, t, 1)`` per axis of b0 with a robust Kalman filter, and put the fit in place.

    The basis is 1, t/T, (1 - cos wt)/c3, (wt - sin wt)/c4, which spans the same functions; the prior and the process
    noise are the published ones transformed with it (in the published basis float64 fails: its singular values are
    1.7e6 apart). A subclass says how a measurement corrects coefficients and covariance.

    Attributes:
        threshold: Huber's, in standard deviations.
        process_variance: variance that each published coefficient gains per vector.
        prior_variance: variance of each published coefficient at the start.
        drop_constant: whether to leave the constant out of the reconstructed vector.
    """

    keeps_displacement: ClassVar[bool] = False
    threshold: eqx.AbstractVar[Float[Array, ""]]
    process_variance: eqx.AbstractVar[Float[Array, ""]]
    prior_variance: eqx.AbstractVar[Float[Array, ""]]
    drop_constant: eqx.AbstractVar[bool]

    @abstractmethod
    def correct(self, p: Covariance, b: list[Any], innovation: Innovation) -> tuple[list[Any], list[Any]]:
        """Take one measurement.

        Args:
            p: covariance of the coefficients before it.
            b: the four functions of the basis at its time.
            innovation: of the measurement.

        Returns:
            What the four coefficients gain, and the upper triangle of the covariance after it, row by row.
        """

    def check(self, observe: AbstractObserve) -> None:
        """The basis is that of gravity integrated since the start."""
        if getattr(observe, "vectors", "integrated") != "integrated" or getattr(observe, "window", 0.0):
            raise UserError(
                "reconstruct: the apparent-velocity filter fits vectors integrated since the start: leave "
                "observe.window at 0 and observe.vectors at 'integrated'"
            )
        if observe.aid.needs_north:
            raise UserError(
                "reconstruct: with a navigation-frame aid the vector in b0 holds the vehicle's own velocity, which the "
                "apparent-velocity filter does not know (it misfits by metres per second): take roba, or a body aid"
            )

    def init(self) -> Any:
        """No coefficients, the prior's covariance."""
        p = tuple(jnp.full(3, self.prior_variance * _SHAPE[ij]) for ij in UPPER)
        return _State((jnp.zeros(3),) * 4, p, jnp.ones(3), jnp.zeros((), jnp.float64))

    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Pair]:
        """Consume one pair."""
        # The vector of the first velocity is zero by definition, not by measurement.
        null = ~(pair.noise_free.norm2() > 0)
        start = jnp.where(pair.valid & null, context.time, state.start)
        state, used = dataclasses.replace(state, start=start), pair.valid & ~null
        b = _basis(context.time - start)
        state = where(used, self._measured(state, b, pair.beta.array, context.sd), state)
        first = 1 if self.drop_constant else 0
        beta = where(used, Vec3.of(dot(state.xi[first:], b[first:])), pair.beta)
        return state, dataclasses.replace(pair, beta=beta, beta_without_coriolis=beta, displacement=None)

    def _measured(self, state: _State, b: list[Any], beta: Any, sd: Any) -> _State:
        """One measurement of the three axes, side by side."""
        p = {ij: x + self.process_variance * _SHAPE[ij] for ij, x in zip(UPPER, state.p, strict=True)}
        innovation, sd = beta - dot(state.xi, b), jnp.maximum(sd, 1e-9)
        size = jnp.abs(innovation)
        beyond = size > self.threshold * sd
        weight = jnp.where(beyond, self.threshold * sd / jnp.where(beyond, size, 1.0), 1.0)
        gained, new = self.correct(p, b, Innovation(innovation, weight, sd * sd))
        xi = tuple(x + g for x, g in zip(state.xi, gained, strict=True))
        return _State(xi, tuple(new), weight, state.start)


class ApparentVelocityFilter(AbstractApparentVelocityFilter):
    """The robust Kalman filter of the apparent velocity, repaired: the weight counts in gain and covariance.

    Huber's weight ``w = min(1, threshold / |zeta|)``, zeta the innovation over the aid's standard deviation, divides R
    inside gain and covariance. An outlier among the first vectors can still ruin a run: the first innovation is as
    large as the vector itself. For a standing vehicle the standard deviation is that of a step, not of the integrated
    force, so that the threshold counts other units. The axes are those of b0: the result depends a little on how the
    unit is mounted.

    Attributes:
        threshold: Huber's, in standard deviations.
        process_variance: variance that each published coefficient gains per vector (printed: 1e-3 squared).
        prior_variance: variance of each published coefficient at the start.
        drop_constant: leave the constant out of the reconstructed vector, and with it the noise of the first velocity:
            0.3 instead of 0.9 deg on clean data with process_variance = 1e-8, at the price of outliers in the first
            epochs.

    Source: Xu 2020 (27)-(40). Deviations: the weight, as above; the basis of the base class. The printed form is
    :class:`jaxalign.published.PrintedApparentVelocityFilter`.
    """

    threshold: Float[Array, ""] = tunable(1.345, unit="1", bounds=(0.1, 100.0))
    process_variance: Float[Array, ""] = tunable(1e-6, unit="1", bounds=(0.0, 1.0))
    prior_variance: Float[Array, ""] = tunable(1e10, unit="1", bounds=(1e2, 1e11))
    drop_constant: bool = eqx.field(static=True, default=False)

    def correct(self, p: Covariance, b: list[Any], innovation: Innovation) -> tuple[list[Any], list[Any]]:
        """R over the weight; covariance in Joseph form, (I - G b^T) P (I - G b^T)^T + G R G^T."""
        along_b, r = projected(p, b), innovation.variance / innovation.weight
        gain = [x / (dot(along_b, b) + r) for x in along_b]
        left = [[p[min(i, j), max(i, j)] - gain[i] * along_b[j] for j in range(4)] for i in range(4)]
        along = [dot(row, b) for row in left]
        new = [left[i][j] - along[i] * gain[j] + r * gain[i] * gain[j] for i, j in UPPER]
        return [g * innovation.value for g in gain], new


def projected(p: Covariance, b: list[Any]) -> list[Any]:
    """The covariance times the basis, P b."""
    return [dot([p[min(i, j), max(i, j)] for j in range(4)], b) for i in range(4)]


def dot(a: Any, b: Any) -> Any:
    """Sum of products."""
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
