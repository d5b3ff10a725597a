"""Davenport's q-method over running sums, with or without the first velocity as an unknown."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.davenport import davenport
from jaxalign.observe import Context, Pair
from jaxalign.vector import Mat3, Vec3, where

__all__ = ["CentredWahba", "QMethod"]

# A read-out with a closed Coriolis term needs the attitude that it seeks. Starting from the last attitude, each pass
# shrinks the error by about 2 v / (g t cos(lat)): two passes from scratch leave 3e-5 deg at 60 s. Where the last
# attitude is that of the epoch before, the epochs themselves are the passes, and one is enough.
_PASSES = 2


class _Profile(eqx.Module):
    """``sum w alpha beta^T``; beta in two parts where its Coriolis term awaits the attitude."""

    fixed: Mat3
    moment: Mat3 | None
    w_ie: Vec3

    @classmethod
    def zero(cls, coupled: bool) -> _Profile:
        return cls(Mat3.zero(), Mat3.zero() if coupled else None, Vec3.zero())

    def plus(self, pair: Pair, weight: Any) -> _Profile:
        weighted = pair.alpha * weight
        moment = None if self.moment is None else self.moment + weighted.outer(pair.moment)
        return _Profile(self.fixed + weighted.outer(pair.open_beta), moment, pair.w_ie)

    def read(self, context: Context) -> Readout:
        """Solve; where beta depends on the attitude, feed it in and solve again."""
        if self.moment is None:
            return _readout(self.fixed)
        attitude, known = context.attitude, context.defined
        for _ in range(1 if context.fresh else _PASSES):
            w_ie_b0 = where(known, attitude.conjugate().rotate(self.w_ie), Vec3.zero())
            found = _readout(self.fixed + self.moment.map_rows(w_ie_b0.cross))
            attitude, known = found.attitude, found.defined
        return found


def _readout(profile: Mat3) -> Readout:
    found = davenport(profile)
    positive = found.value > 0
    return Readout(found.vector, jnp.where(positive, found.gap / jnp.where(positive, found.value, 1.0), 0.0))


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
        return _Profile.zero(coupled)

    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Add one pair."""
        if self.normalise:
            product = pair.alpha.norm() * pair.beta.norm()
            positive = product > 0
            weight = weight * jnp.where(positive, 1.0 / jnp.where(positive, product, 1.0), 0.0)
        return state.plus(pair, weight)

    def readout(self, state: Any, context: Context) -> Readout:
        """Largest eigenvector of K."""
        return state.read(context)


class _Centred(eqx.Module):
    profile: _Profile
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

    def init(self, coupled: bool) -> Any:
        """Empty sums."""
        zero = Vec3.zero()
        return _Centred(_Profile.zero(coupled), zero, zero, zero if coupled else None, zero.x)

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
        return _Profile(profile.fixed - mean.outer(state.beta), moment, profile.w_ie).read(context)
