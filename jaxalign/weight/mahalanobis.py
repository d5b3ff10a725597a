"""Weights from the Mahalanobis distance of a pair's misfit in length, judged by its own history."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.arguments import check_choice
from jaxalign.observe import Context, Pair
from jaxalign.parametrization import tunable
from jaxalign.vector import where
from jaxalign.weight.base import AbstractWeight

__all__ = ["Mahalanobis"]


class _Moments(eqx.Module):
    """Number, mean and sum of squared deviations of what has been seen, each with a share in [0, 1]."""

    count: Float[Array, ""]
    mean: Float[Array, ""]
    squares: Float[Array, ""]

    def plus(self, x: Any, share: Any) -> _Moments:
        count = self.count + share
        mean = self.mean + share * (x - self.mean) / jnp.where(share > 0, count, 1.0)
        return _Moments(count, mean, self.squares + share * (x - self.mean) * (x - mean))


class Mahalanobis(AbstractWeight):
    """Weight ``exp(-(D / delta)^exponent)`` where ``D > mean(D) + threshold sd(D)`` over the history, else one.

    ``D = |h - mu| / sqrt(Sigma)`` with ``h = |beta| - |alpha|``; mu and Sigma are those of the pairs not found
    outlying.

    Attributes:
        exponent: "exponential control" of the paper, its gamma.
        delta: scale of D.
        threshold: of the criterion, in standard deviations of D.
        gate: "hard" (default): the criterion as published, a step: the threshold has no derivative. "smooth": the pair
            is an outlier with the share ``sigmoid(sharpness (D / limit - 1))``, in its weight and in the statistics:
            for tuning.
        sharpness: of the smooth gate.
        statistics: "all" (default): every D enters its own mean and deviation, as published, so that large outliers
            mask smaller ones; "inliers": only those found inlying, which tightens by itself and locks good data out
            when h drifts (accelerometer bias): use it with a sliding window.

    h sees only errors along the vector, which is nearly vertical: outliers of a horizontal axis alone pass.

    Source: Shen 2025 (9)-(17), Appendix A. Deviations: h is the difference of the lengths, not of their squares (it
        is then stationary); the recursion of Sigma is (n-1)/n Sigma + (n-1)/n^2 (h - mu)^2, started from one
        pseudo-sample with mu = 0 and Sigma = the number of the aid's standard deviation (as the frozen reference has
        it, literally); before two distances are known their deviation is taken as delta.
    """

    looks_at_attitude: ClassVar[bool] = False
    exponent: Float[Array, ""] = tunable(4.0, unit="1", bounds=(0.5, 16.0))
    delta: Float[Array, ""] = tunable(5.0239, unit="1", bounds=(0.1, 50.0))
    threshold: Float[Array, ""] = tunable(2.0, unit="1", bounds=(0.1, 10.0))
    sharpness: Float[Array, ""] = tunable(10.0, unit="1", bounds=(0.1, 1000.0))
    statistics: Literal["all", "inliers"] = eqx.field(static=True, default="all")
    gate: Literal["hard", "smooth"] = eqx.field(static=True, default="hard")

    def __check_init__(self):
        check_choice("weight.gate", self.gate, ("hard", "smooth"))
        check_choice("weight.statistics", self.statistics, ("all", "inliers"))

    def init(self) -> Any:
        """Nothing seen; the pseudo-sample enters with the first step, which knows the aid's noise."""
        zero = jnp.zeros((), jnp.float64)
        nothing = _Moments(zero, zero, zero)
        return nothing, nothing

    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Any]:
        """Weigh one pair."""
        lengths, distances = state
        lengths = where(lengths.count > 0, lengths, _Moments(lengths.count + 1.0, lengths.mean, context.sd))
        h = pair.beta.norm() - pair.alpha.norm()
        distance = jnp.abs(h - lengths.mean) / jnp.sqrt(lengths.squares / lengths.count)
        several = distances.count > 1.5  # two, or shares of some
        variance = distances.squares / jnp.where(several, distances.count - 1.0, 1.0)
        positive = several & (variance > 0)
        deviation = jnp.where(positive, jnp.sqrt(jnp.where(positive, variance, 1.0)), 0.0)
        limit = jnp.where(several, distances.mean + self.threshold * deviation, self.threshold * self.delta)
        possible = limit > 0
        if self.gate == "hard":
            outlying = jnp.where(distance > limit, 1.0, 0.0)
        else:
            excess = distance / jnp.where(possible, limit, 1.0) - 1.0
            outlying = jnp.where(possible, jax.nn.sigmoid(self.sharpness * excess), 0.0)
        some = distance > 0
        ratio = jnp.where(some, distance / self.delta, 1.0)
        # Beyond exp(7) the weight is zero in any case, and a derivative of 0 times infinity would not be.
        power = jnp.exp(jnp.minimum(self.exponent * jnp.log(ratio), 7.0))
        weight = jnp.where(some, 1.0 - outlying * (1.0 - jnp.exp(-power)), 1.0)
        # The pair of the first epoch is null: it says nothing.
        used = pair.valid & (pair.noise_free.norm2() > 0)
        inlying = jnp.where(used, 1.0 - outlying, 0.0)
        counted = jnp.where(used, 1.0, 0.0) if self.statistics == "all" else inlying
        return (lengths.plus(h, inlying), distances.plus(distance, counted)), weight
