"""REQUEST and Optimal-REQUEST: K as a running mean with a scalar gain, fixed or that of a Kalman filter."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.arguments import check_choice
from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.direction_noise import NOISES, Noise, check_noise, direction_information
from jaxalign.estimate.profile import Profile, inverse_lengths
from jaxalign.observe import AbstractObserve, Context, Pair
from jaxalign.parametrization import tunable
from jaxalign.vector import where

__all__ = ["OptimalRequest", "Request"]


class _Request(eqx.Module):
    profile: Profile
    started: Bool[Array, ""]


class Request(AbstractEstimate):
    """``K = (1 - rho) K + rho dK`` with dK of the unit vectors of one pair; the first dK starts it.

    A fixed gain forgets: the memory is some 1/rho epochs. A pair's weight scales its gain.

    Attributes:
        rho: the gain; 0.07 was best at 1 Hz in the GPS scenario of Huang.

    Source: Bar-Itzhack 1996; Huang's baseline (no propagation: K stands in inertial space).
    """

    rho: Float[Array, ""] = tunable(0.05, unit="1", bounds=(1e-6, 1.0))

    def init(self, coupled: bool) -> Any:
        """No pair yet."""
        return _Request(Profile.zero(coupled), jnp.zeros((), bool))

    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Move K towards one pair."""
        weight = weight * (pair.alpha.norm2() > 0)
        gain = jnp.where(state.started, self.rho * weight, jnp.where(weight > 0, 1.0, 0.0))
        profile = state.profile.scaled(1.0 - gain).plus(pair, gain * inverse_lengths(pair))
        return _Request(profile, state.started | (weight > 0))

    def readout(self, state: Any, context: Context) -> Readout:
        """Largest eigenvector of K."""
        return state.profile.read(context)


class _OptimalRequest(eqx.Module):
    profile: Profile
    variance: Float[Array, ""]  # trace of K's covariance
    started: Bool[Array, ""]


class OptimalRequest(AbstractEstimate):
    """REQUEST with the gain of a Kalman filter: ``rho = p / (p + tr R)``, p the variance of K.

    Without process noise the pairs end up weighted by ``1 / tr R``: with a constant R this is the q-method on unit
    vectors exactly, with the physical one (variance 1/|alpha|^2) the q-method on the vectors as they are. A pair's
    weight divides its R.

    Attributes:
        variance: of a direction per axis with ``measurement_noise="constant"``, rad^2 (tr R = 12 variance).
        process_variance: variance that K gains per vector, in the units of R: above zero the filter forgets.
        measurement_noise: "physical" (default) or "constant".

    Source: Choukroun 2004; Huang's baseline, which gives neither R nor P0: P0 = R of the first pair here.
    """

    variance: Float[Array, ""] = tunable(0.01, unit="rad^2", bounds=(1e-12, 10.0))
    process_variance: Float[Array, ""] = tunable(0.0, unit="rad^2", bounds=(0.0, 10.0))
    measurement_noise: Noise = eqx.field(static=True, default="physical")

    def __check_init__(self):
        check_choice("estimate.measurement_noise", self.measurement_noise, NOISES)

    def check(self, observe: AbstractObserve) -> None:
        """The physical noise is that of two velocities."""
        check_noise(self.measurement_noise, observe)

    def init(self, coupled: bool) -> Any:
        """No pair yet."""
        return _OptimalRequest(Profile.zero(coupled), jnp.zeros((), jnp.float64), jnp.zeros((), bool))

    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Move K towards one pair."""
        # tr R = 4 tr(Cov): 12 s^2 for an isotropic s^2, 8 s^2 where it is across the direction only.
        factor = 12.0 if self.measurement_noise == "constant" else 8.0
        information = weight * direction_information(self.measurement_noise, self.variance, context, pair) / factor
        some = information > 0
        p = state.variance + jnp.where(state.started & some, self.process_variance, 0.0)
        following = p * information / (1.0 + p * information)
        gain = jnp.where(state.started, following, jnp.where(some, 1.0, 0.0))
        first = jnp.where(some, 1.0 / jnp.where(some, information, 1.0), 0.0)
        return _OptimalRequest(
            state.profile.scaled(1.0 - gain).plus(pair, gain * inverse_lengths(pair)),
            jnp.where(state.started, p * (1.0 - gain), first),
            state.started | some,
        )

    def readout(self, state: Any, context: Context) -> Readout:
        """Largest eigenvector of K."""
        return where(state.started, state.profile.read(context), Readout.nothing())
