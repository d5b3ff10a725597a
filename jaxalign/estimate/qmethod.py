"""Davenport's q-method over running sums, with or without the first velocity as an unknown."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.errors import UserError
from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.profile import Profile, inverse_lengths
from jaxalign.observe import AbstractObserve, Context, Pair
from jaxalign.vector import Vec3

__all__ = ["CentredWahba", "QMethod"]


class QMethod(AbstractEstimate):
    """The attitude that minimises ``sum w |alpha - C beta|^2``.

    Attributes:
        normalise: use unit vectors (equal weights), as several papers do. By default a pair counts by the product of
            its lengths, which grow with time as their directions become better known.

    Source: Davenport; Xu 2020 (21)-(22), Xu 2017 (10)-(12), Huang's q-method (normalised).
    """

    normalise: bool = eqx.field(static=True, default=False)

    def init(self, coupled: bool) -> Any:
        """Empty sums."""
        return Profile.zero(coupled)

    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Add one pair."""
        if self.normalise:
            weight = weight * inverse_lengths(pair)
        return state.plus(pair, weight)

    def readout(self, state: Any, context: Context) -> Readout:
        """Largest eigenvector of K."""
        return state.read(context)


class _Centred(eqx.Module):
    profile: Profile
    alpha: Vec3
    beta: Vec3
    moment: Vec3 | None
    weight: Float[Array, ""]


class CentredWahba(AbstractEstimate):
    """The q-method with the first velocity free: it is eliminated by subtracting the weighted means.

    The noise of the one velocity v(0) enters every published vector and rules their error (3.5 times the Cramer-Rao
    bound in yaw with a DVL). As an unknown offset of all vectors it costs a rank-one downdate of the sums; for white
    isotropic aid noise the result is the maximum-likelihood estimate. The first epoch counts as an ordinary sample.

    Source: none of the papers; the centred form of Wahba's problem (Kabsch), recursive.
    """

    def check(self, observe: AbstractObserve) -> None:
        """A sliding window has no one first velocity."""
        if getattr(observe, "window", 0.0):
            raise UserError(
                "observe.window means nothing where the first velocity is free (centred_oba): leave it at 0"
            )

    def init(self, coupled: bool) -> Any:
        """Empty sums."""
        zero = Vec3.zero()
        return _Centred(Profile.zero(coupled), zero, zero, zero if coupled else None, zero.x)

    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Add one pair."""
        return _Centred(
            state.profile.plus(pair, weight),
            state.alpha + pair.alpha * weight,
            state.beta + pair.open_beta * weight,
            None if state.moment is None else state.moment + pair.moment * weight,
            state.weight + weight,
        )

    def readout(self, state: Any, context: Context) -> Readout:
        """Largest eigenvector of the centred K."""
        positive = state.weight > 0
        mean = state.alpha * jnp.where(positive, 1.0 / jnp.where(positive, state.weight, 1.0), 0.0)
        profile = state.profile
        moment = None if state.moment is None else profile.moment - mean.outer(state.moment)
        return Profile(profile.fixed - mean.outer(state.beta), moment, profile.w_ie).read(context)
