"""A recursive estimator that may change its mind: centred sums, and the latest pairs held back and weighed again."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxalign.errors import UserError
from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.profile import CentredSums
from jaxalign.estimate.qmethod import check_whole
from jaxalign.observe import AbstractObserve, Context, Pair
from jaxalign.parametrization import tunable
from jaxalign.vector import Quat, Vec3, where

__all__ = ["Held", "RevisingWahba", "reweighted"]

_SHORT = 128
_ROUNDS = 12
_LAST = 4  # of them with a weight that falls to zero, those before with that of least absolute values
_FEW = 3.0  # pairs that an attitude and an offset fit
_MEDIAN = 1.538  # of the length of three unit normal numbers


class Held(eqx.Module):
    """Pairs whose weights are not settled: leaves with a first axis.

    Attributes:
        alpha: m/s, n0.
        beta_without_coriolis: m/s, b0.
        displacement: m, or None: see :class:`jaxalign.observe.Pair`.
        w_ie: rad/s, n0, without that axis.
        used: which of them are pairs.
    """

    alpha: Vec3
    beta_without_coriolis: Vec3
    displacement: Vec3 | None
    w_ie: Vec3
    used: Bool[Array, " n"]

    def misfit(self, attitude: Quat, w_ie_b0: Vec3) -> Vec3:
        """``alpha - C beta``."""
        beta = (
            self.beta_without_coriolis
            if self.displacement is None
            else self.beta_without_coriolis + w_ie_b0.cross(self.displacement)
        )
        return self.alpha - attitude.rotate(beta)


def _median(x: Float[Array, " n"], used: Bool[Array, " n"]) -> Any:
    """The lower median of what is used; 0 where nothing is."""
    n = x.shape[0]
    middle = (jnp.sum(used) - 1) // 2
    if n > _SHORT:
        ordered = jnp.sort(jnp.where(used, x, jnp.inf))
        return jnp.where(middle >= 0, ordered[jnp.maximum(middle, 0)], 0.0)
    # Counting all pairs of a few numbers is faster than sorting them.
    number = np.arange(n)
    below = (x < x[:, None]) | ((x == x[:, None]) & (number < number[:, None]))
    rank = jnp.sum(below & used, axis=1)
    return jnp.sum(jnp.where(used & (rank == middle), x, 0.0))


def _weights(length: Any, held: Held, least: Any, cutoff: Any, falls: Any) -> tuple[Any, Any]:
    """Weights by the lengths of misfits, and their scale (m/s per axis)."""
    scale = jnp.maximum(_median(length, held.used) / _MEDIAN, least)
    near = jnp.minimum(1.0, scale / jnp.maximum(length, scale))
    tukey = jnp.maximum(0.0, 1.0 - (length / (cutoff * scale)) ** 2) ** 2
    return jnp.where(held.used, jnp.where(falls, tukey, near), 0.0), scale


def reweighted(
    settled: CentredSums, held: Held, guess: Quat, known: Any, least: Any, cutoff: Any
) -> tuple[Readout, CentredSums, Any, Any]:
    """Solve for the attitude and the weights of the held pairs together, from scratch.

    Rounds with the weight of least absolute values, which need no start, then with Tukey's, which throws out.

    Args:
        settled: pairs whose weights stand.
        held: the others.
        guess: attitude q_n0b0 for the Coriolis term of the first round.
        known: whether to use it.
        least: noise to believe in at least, m/s per axis.
        cutoff: of Tukey's weight, times the noise.

    Returns:
        The attitude, all sums, the weights of the held pairs and their noise (m/s per axis).
    """
    w_ie, zero, number = held.w_ie, jnp.zeros((), jnp.float64), jnp.zeros((), jnp.int32)

    def solved(weight: Any, attitude: Quat, known: Any) -> tuple[Readout, CentredSums, Vec3]:
        sums = settled.plus_all(held, weight)
        at = Context(number, zero, zero, attitude, known, zero, fresh=True)
        found = sums.centred.read(at)
        return found, sums, where(found.defined, found.attitude.conjugate().rotate(w_ie), Vec3.zero())

    def step(carry: Any, turn: Any) -> Any:
        weight, attitude, known, _ = carry
        found, sums, w_ie_b0 = solved(weight, attitude, known)
        gap = held.misfit(found.attitude, w_ie_b0) - sums.offset(found.attitude, w_ie_b0)
        weight, scale = _weights(gap.norm(), held, least, cutoff, turn >= _ROUNDS - _LAST)
        return (weight, found.attitude, found.defined, scale), None

    start = (held.used * 1.0, guess, jnp.asarray(known), jnp.asarray(least) * 1.0)
    (weight, attitude, known, scale), _ = jax.lax.scan(step, start, jnp.arange(_ROUNDS))
    found, sums, _ = solved(weight, attitude, known)
    return found, sums, weight, scale


class _State(eqx.Module):
    settled: CentredSums
    held: Held
    weight: Float[Array, " n"]


class RevisingWahba(AbstractEstimate):
    """The centred q-method over all pairs, robust, with the weights of the latest ones open to revision.

    A pair's weight is not final when it comes: it is held for ``memory`` epochs, and weighed again with all other held
    ones at each read-out, from scratch; only then it goes into the sums, with the weight that it has by the attitude
    of that time. So outliers at the beginning, when there is no attitude to tell them by, are found out later, and the
    state stays of one size.

    Attributes:
        cutoff: of Tukey's weight, times the noise of a fix.
        memory: pairs held.

    Source: none of the papers.
    """

    cutoff: Float[Array, ""] = tunable(5.0, unit="1", bounds=(2.0, 50.0))
    memory: int = eqx.field(static=True, default=64)

    def __check_init__(self):
        if self.memory < 4:
            raise UserError(f"estimate.memory = {self.memory}: hold at least 4 pairs")

    def check(self, observe: AbstractObserve) -> None:
        """A sliding window has no one first velocity."""
        check_whole(observe)

    def init(self, coupled: bool) -> Any:
        """Nothing held."""
        n = self.memory
        many = jax.tree.map(lambda x: jnp.zeros(n), Vec3.zero())
        held = Held(many, many, many if coupled else None, Vec3.zero(), jnp.zeros(n, bool))
        return _State(CentredSums.zero(coupled), held, jnp.zeros(n))

    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Hold one pair; settle the one whose place it takes."""
        slot = context.index % self.memory
        held = state.held
        leaving = jax.tree.map(lambda x: x[slot], eqx.tree_at(lambda h: h.w_ie, held, None))
        leaving = dataclasses.replace(leaving, w_ie=pair.w_ie)
        settled = state.settled.plus(leaving, state.weight[slot])
        used = weight > 0

        def put(values: Any, new: Any) -> Any:
            return jax.tree.map(lambda x, y: x.at[slot].set(jnp.where(used, y, 0.0)), values, new)

        held = Held(
            put(held.alpha, pair.alpha),
            put(held.beta_without_coriolis, pair.beta_without_coriolis),
            put(held.displacement, pair.displacement),
            pair.w_ie,
            held.used.at[slot].set(used),
        )
        sums = settled.plus_all(held, state.weight.at[slot].set(0.0))
        w_ie_b0 = where(context.defined, context.attitude.conjugate().rotate(pair.w_ie), Vec3.zero())
        gap = held.misfit(context.attitude, w_ie_b0) - sums.offset(context.attitude, w_ie_b0)
        weights, _ = _weights(gap.norm(), held, context.sd, self.cutoff, sums.weight > _FEW)
        return _State(settled, held, jnp.where(context.defined, weights, held.used * 1.0))

    def readout(self, state: Any, context: Context) -> Readout:
        """Weigh all held pairs again, and solve."""
        return reweighted(state.settled, state.held, context.attitude, context.defined, context.sd, self.cutoff)[0]
