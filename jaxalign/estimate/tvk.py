"""The K matrix as the state of a Kalman filter (VO-TVK)."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.arguments import check_choice
from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.direction_noise import NOISES, Noise, check_noise, direction_information
from jaxalign.estimate.eigenproblem import dominant_eigenvector
from jaxalign.linear import solve_covariance
from jaxalign.observe import AbstractObserve, Context, Pair
from jaxalign.parametrization import tunable
from jaxalign.solution import Status
from jaxalign.vector import Vec3, where

__all__ = ["KMatrixFilter"]


class _State(eqx.Module):
    x: Float[Array, " 9"]
    p: Float[Array, "9 9"]
    started: Bool[Array, ""]
    singular: Bool[Array, ""]


class KMatrixFilter(AbstractEstimate):
    """The nine free elements of a traceless K, measured by dK of each pair, in a Kalman filter with a 9x9 gain.

    ``R = s^2 (Lambda Lambda^T + kappa I)`` with s^2 the variance of the direction. Without kappa
    R has rank 3, P + R is singular after the first update, and the filter stops: ``Status.SINGULAR`` from there on, and
    no attitude (one direction does not make any). The model itself (K constant) is inconsistent: each dK depends on
    its direction, and only a gain that is nearly a scalar keeps the true attitude an eigenvector. Without noise the
    heading errs by 8 deg at kappa = 0.01, 0.06 deg at 1. Nor do the nine elements turn as a whole: another mounting of
    the same unit gives another heading, by several degrees in Huang's scenario. A pair's weight divides its R.

    Attributes:
        kappa: the regularisation, ours; zero as printed (the recipe ``vo_tvk_as_published``).
        variance: s^2 with ``measurement_noise="constant"``, rad^2.
        prior_variance: variance of the elements of K before the second pair (the first one starts it).
        measurement_noise: of the directions, "physical" (2 sd^2 / |alpha|^2; default) or "constant".

    Source: Huang (34)-(64); x0 is the first dK (56); P0 and R are not given there.
    """

    kappa: Float[Array, ""] = tunable(1.0, unit="1", bounds=(0.0, 1e4))
    variance: Float[Array, ""] = tunable(0.01, unit="rad^2", bounds=(1e-12, 10.0))
    prior_variance: Float[Array, ""] = tunable(1.0, unit="1", bounds=(1e-12, 1e6))
    measurement_noise: Noise = eqx.field(static=True, default="physical")

    def __check_init__(self):
        check_choice("estimate.measurement_noise", self.measurement_noise, NOISES)

    def check(self, observe: AbstractObserve) -> None:
        """The physical noise is that of two velocities."""
        check_noise(self.measurement_noise, observe)

    def init(self, coupled: bool) -> Any:
        """Nothing measured."""
        no = jnp.zeros((), bool)
        return _State(jnp.zeros(9), jnp.zeros((9, 9)), no, no)

    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Measure K with one pair."""
        s = state
        lambda_ = _sensitivity(pair.alpha.unit())
        y = lambda_ @ pair.beta.unit().array
        information = weight * direction_information(self.measurement_noise, self.variance, context, pair)
        some = information > 0
        variance = 1.0 / jnp.where(some, information, 1.0)
        r = variance * (lambda_ @ lambda_.T + self.kappa * jnp.eye(9))
        transposed, regular = solve_covariance(jnp.where(some, s.p + r, jnp.eye(9)), s.p)
        gain = transposed.T
        rest = jnp.eye(9) - gain
        moved = _State(s.x + gain @ (y - s.x), rest @ s.p @ rest.T + gain @ r @ gain.T, s.started, s.singular)
        first = _State(y, self.prior_variance * jnp.eye(9), jnp.ones((), bool), s.singular)
        usable = some & s.started & ~s.singular
        new = where(usable & regular, moved, where(some & ~s.started, first, s))
        return _State(new.x, new.p, new.started, s.singular | (usable & ~regular))

    def readout(self, state: Any, context: Context) -> Readout:
        """Largest eigenvector of K."""
        k11, k12, k13, k14, k22, k23, k24, k33, k34 = (state.x[i] for i in range(9))
        k44 = -(k11 + k22 + k33)
        # The paper's quaternion has its scalar last.
        found = dominant_eigenvector((k44, k14, k24, k34, k11, k12, k13, k22, k23, k33))
        positive = found.value > 0
        gap = jnp.where(positive, found.gap / jnp.where(positive, found.value, 1.0), 0.0)
        bit = jnp.where(state.singular, int(Status.SINGULAR), 0)
        return where(state.started, Readout.of_gap(found.vector, gap, bit), Readout.nothing())


def _sensitivity(r: Vec3) -> Float[Array, "9 3"]:
    """Lambda: the nine elements of dK are ``Lambda mu``, linear in the body vector mu. Source: Huang (51)."""
    o = jnp.zeros_like(r.x)
    rows = (
        (r.x, -r.y, -r.z),
        (r.y, r.x, o),
        (r.z, o, r.x),
        (o, r.z, -r.y),
        (-r.x, r.y, -r.z),
        (o, r.z, r.y),
        (-r.z, o, r.x),
        (-r.x, -r.y, r.z),
        (r.y, -r.x, o),
    )
    return jnp.stack([jnp.stack(row) for row in rows])
