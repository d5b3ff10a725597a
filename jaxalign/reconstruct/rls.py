"""Recursive least squares on the apparent motion of gravity: a static vehicle's force in b0 is a slow cone."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.earth import EARTH_RATE
from jaxalign.errors import UserError
from jaxalign.observe import AbstractObserve, Context, Pair
from jaxalign.parametrization import tunable
from jaxalign.reconstruct.base import AbstractReconstruct
from jaxalign.vector import Mat3, Vec3, where

__all__ = ["Rls"]

_SCALE = 300.0  # s; of the basis: the three functions are then of size one in an alignment


class _State(eqx.Module):
    coefficients: Mat3  # one row per function of the basis, m/s in b0
    covariance: Mat3


class Rls(AbstractReconstruct):
    """Fit ``beta(t) = A (cos wt, sin wt, 1)`` per axis, w the Earth rate, and put the fit in place of the vector.

    The basis is ``4 sin^2(wt/2) / (w T)^2, sin(wt) / (w T), 1`` with T = 300 s, which spans the same functions; the
    prior is that of the published basis, transformed with it (in the published one a prior of 1e12 breaks even float64,
    up to 1 deg). t is the middle of the vector's interval.

    Attributes:
        forgetting: factor by which the past fades per epoch; 1 for none. The covariance never exceeds the prior.
        prior_variance: variance of the published coefficients over that of a vector's noise; usable 1e4 to 1e10.

    Source: Xu 2017 (30)-(35).
    """

    keeps_displacement: ClassVar[bool] = False
    forgetting: Float[Array, ""] = tunable(1.0, unit="1", bounds=(0.9, 1.0))
    prior_variance: Float[Array, ""] = tunable(1e10, unit="1", bounds=(1e2, 1e11))

    def check(self, observe: AbstractObserve) -> None:
        """The basis is that of gravity itself, not of its integral."""
        if getattr(observe, "vectors", "") != "instantaneous":
            raise UserError(
                "reconstruct: the recursive least squares fit the force of a standing vehicle interval by interval: "
                "observe with GravityVectors(vectors='instantaneous'), or take ApparentVelocityFilter for velocities"
            )

    def init(self) -> Any:
        """No coefficients, the prior's covariance."""
        k = EARTH_RATE * _SCALE
        rows = Vec3(k**4 / 4, 0.0, -(k**2) / 2), Vec3(0.0, k**2, 0.0), Vec3(-(k**2) / 2, 0.0, 2.0)
        return _State(Mat3.zero(), Mat3(*(row * self.prior_variance for row in rows)))

    def update(self, state: Any, time: Any, beta: Vec3) -> Any:
        """Fit one more vector."""
        h, a = _basis(time), state.coefficients
        p = state.covariance
        projected = Vec3(p.r0.dot(h), p.r1.dot(h), p.r2.dot(h))
        gain = projected * (1.0 / (self.forgetting + h.dot(projected)))
        left = p - gain.outer(projected)  # Joseph: (I - g h^T) P (I - g h^T)^T + forgetting g g^T
        along = Vec3(left.r0.dot(h), left.r1.dot(h), left.r2.dot(h))
        rest = left - along.outer(gain) + (gain * self.forgetting).outer(gain)
        # What the memory no longer excites must not wind up beyond the prior: there, nothing is forgotten.
        faded, most = rest * (1.0 / self.forgetting), self.init().covariance
        bounded = (faded.r0.x <= most.r0.x) & (faded.r1.y <= most.r1.y) & (faded.r2.z <= most.r2.z)
        new = where(bounded, faded, rest)
        return _State(a + gain.outer(beta - self.at(state, time)), _symmetric(new))

    def at(self, state: Any, time: Any) -> Vec3:
        """The fitted vector at a time, s."""
        h, a = _basis(time), state.coefficients
        return a.r0 * h.x + a.r1 * h.y + a.r2 * h.z

    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Pair]:
        """Consume one pair."""
        middle = context.time - 0.5 * context.dt
        state = where(pair.valid, self.update(state, middle, pair.beta), state)
        beta = where(pair.valid, self.at(state, middle), pair.beta)
        return state, dataclasses.replace(pair, beta=beta, beta_without_coriolis=beta)


def _basis(time: Any) -> Vec3:
    w = EARTH_RATE
    half = jnp.sin(w * time / 2) / (w * _SCALE)
    return Vec3(4 * half * half, jnp.sin(w * time) / (w * _SCALE), jnp.ones_like(time))


def _symmetric(m: Mat3) -> Mat3:
    return Mat3(m.r0, Vec3(m.r0.y, m.r1.y, m.r1.z), Vec3(m.r0.z, m.r1.z, m.r2.z))
