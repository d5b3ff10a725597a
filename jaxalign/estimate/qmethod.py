"""Davenport's q-method over running sums, with or without the first velocity as an unknown."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxalign.errors import UserError
from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.profile import CentredSums, Profile, inverse_lengths
from jaxalign.observe import AbstractObserve, Context, Pair

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


def check_whole(observe: AbstractObserve) -> None:
    """Refuse a sliding window."""
    if getattr(observe, "window", 0.0):
        raise UserError("observe.window means nothing where the first velocity is free: leave it at 0")


class CentredWahba(AbstractEstimate):
    """The q-method with the first velocity free: it is eliminated by subtracting the weighted means.

    The noise of the one velocity v(0) enters every published vector and rules their error (3.5 times the Cramer-Rao
    bound in yaw with a DVL). As an unknown offset of all vectors it costs a rank-one downdate of the sums; for white
    isotropic aid noise the result is the maximum-likelihood estimate. The first epoch counts as an ordinary sample.

    Source: none of the papers; the centred form of Wahba's problem (Kabsch), recursive.
    """

    def check(self, observe: AbstractObserve) -> None:
        """A sliding window has no one first velocity."""
        check_whole(observe)

    def init(self, coupled: bool) -> Any:
        """Empty sums."""
        return CentredSums.zero(coupled)

    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Add one pair."""
        return state.plus(pair, weight)

    def readout(self, state: Any, context: Context) -> Readout:
        """Largest eigenvector of the centred K."""
        return state.centred.read(context)
