"""A record fitted inside traced code: one loop over the compiled step of the fit; and rows with derivatives.

Figures, starts and windows are found without derivatives; those of a row are those of its fixed point with the figures
held.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.batch.figures import Beliefs, applied
from jaxalign.batch.fit import (
    FIT,
    HOLD,
    ROUNDS,
    ROW_STARTS,
    SETTLE,
    SETTLED,
    Fitted,
    Start,
    counted,
    fit_step,
    levels,
    opposite_headings,
    prepared,
    within_belief,
)
from jaxalign.batch.growth import LEVELS, extend
from jaxalign.batch.iterate import RowSolutions, begin_search, converged
from jaxalign.batch.modes import best_of
from jaxalign.batch.problem import Model, Problem, Readout, State
from jaxalign.epochs import Epochs
from jaxalign.inertial_unit import ImuErrors

__all__ = ["TracedFit", "causal_traced", "fit_traced", "rows_traced"]


class TracedFit(NamedTuple):
    """Of a whole record.

    Attributes:
        belief: of the figures.
        fitted: (..., L) of each start.
        read: likewise.
        level: (L,) posterior of the starts that count, minus infinity of the others.
        best: number of the best.
        ends: (10,) last epochs of the windows.
        windows: (10, ..., 2) states there, of two headings.
    """

    belief: Beliefs
    fitted: Fitted
    read: Readout
    level: Float[Array, " L"]
    best: Any
    ends: Any
    windows: State


def fit_traced(
    model: Model,
    epochs: Epochs,
    starts: tuple[Start, ...],
    imu: ImuErrors | None = None,
    centre: Any = None,
    until: Any = None,
    rounds: int = ROUNDS,
) -> TracedFit:
    """The same as :func:`jaxalign.batch.fit_on_host.fit_on_host`, with a lane for each start; no derivatives."""
    model, epochs, imu = jax.lax.stop_gradient((model, epochs, imu))
    rows = jax.tree.map(lambda x: x[:, None], epochs.rows)
    until = jnp.asarray(len(epochs) - 1 if until is None else until)
    last = jnp.full(len(starts), until)
    grown, pair = np.array([one.grown for one in starts]), opposite_headings(starts)

    def upto(lasts: Any) -> Problem:
        return Problem(rows, epochs.site, epochs.sd, lasts, jnp.max(lasts) + 1)

    whole = dataclasses.replace(epochs, rows=rows)
    belief, start, ends = prepared(model, whole, until, starts, imu, centre)
    growing, steps = LEVELS * SETTLED, LEVELS * SETTLED + SETTLED + rounds

    def body(number: Any, carry: Any) -> Any:
        at, read, windows = carry
        window = jnp.minimum(number // SETTLED, LEVELS - 1)
        end, before = ends[window], ends[jnp.maximum(window - 1, 0)]
        longer = (number < growing) & (number % SETTLED == 0) & (number > 0)
        state = jax.lax.cond(
            longer, lambda: extend(upto(last), at.state, jnp.where(grown, before, last)), lambda: at.state
        )
        at = Fitted(state, at.theta)
        grows, final = number < growing, number == steps
        problem = upto(jnp.where(grows, jnp.where(grown, end, 0), last))
        phase = jnp.where(number < growing + SETTLED, SETTLE, jnp.where(final, HOLD, FIT))
        new, read = fit_step(model, belief, problem, at, phase, final)
        stays = final | (grows & ~grown)
        new = jax.tree.map(lambda a, b: jnp.where(stays, b, a), new, at)
        kept = jax.tree.map(lambda x: x[..., jnp.array(pair)], new.state)
        windows = jax.tree.map(lambda all_of, x: jnp.where(grows, all_of.at[window].set(x), all_of), windows, kept)
        return new, read, windows

    nothing = jax.eval_shape(lambda: fit_step(model, belief, upto(last), start, jnp.asarray(FIT), jnp.asarray(True))[1])
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), nothing)
    windows = jax.tree.map(lambda x: jnp.zeros((LEVELS, *x.shape[:-1], 2), x.dtype), start.state)
    at, read, windows = jax.lax.fori_loop(0, steps + 1, body, (start, zeros, windows))
    level = levels(model, belief, at, read)
    return jax.lax.stop_gradient(TracedFit(belief, at, read, level, jnp.argmax(level), ends, windows))


def rows_traced(model: Model, epochs: Epochs, fit: TracedFit, numbers: np.ndarray, iterations: int) -> RowSolutions:
    """Rows by the fixes up to each, with the figures of the whole record; four starts each, all as lanes."""
    rows = jax.tree.map(lambda x: x[:, None], epochs.rows)
    count = len(numbers)
    last = jnp.repeat(jnp.asarray(numbers), ROW_STARTS)
    lanes = ROW_STARTS * count
    theta = jnp.broadcast_to(fit.fitted.theta[:, fit.best, None], (len(fit.fitted.theta), lanes))
    own = applied(model, _over(fit.belief, lanes), theta)
    problem = Problem(rows, epochs.site, epochs.sd, last)
    plain, alpha, beta = begin_search(own, problem)
    window = jnp.maximum(jnp.searchsorted(fit.ends, jnp.asarray(numbers), side="right") - 1, 0)

    def laid(whole: Any, begun: Any, grown: Any) -> Any:
        """(..., L), (..., 4 rows), (10, ..., 2) -> (..., 4 rows)."""
        of_whole = jnp.broadcast_to(whole[..., fit.best, None], (*whole.shape[:-1], count))
        of_rows = jnp.moveaxis(grown[window], 0, -1)  # (..., 2, rows)
        parts = [
            of_whole,
            begun.reshape(*begun.shape[:-1], count, ROW_STARTS)[..., 0],
            of_rows[..., 0, :],
            of_rows[..., 1, :],
        ]
        return jnp.stack(parts, axis=-1).reshape(*whole.shape[:-1], lanes)

    state = jax.tree.map(laid, fit.fitted.state, plain, fit.windows)
    end = jnp.minimum(fit.ends[window], numbers)
    after = jnp.stack([jnp.asarray(numbers), jnp.asarray(numbers), end, end], axis=-1).reshape(lanes)
    state = extend(problem, state, after)
    yes = jnp.ones(lanes, bool)
    state = jax.lax.stop_gradient(dataclasses.replace(state, early=yes, moving=yes))
    read = converged(own, problem, state, iterations, 1)
    level = counted(*(x.reshape(count, ROW_STARTS) for x in (read.log_likelihood, within_belief(own, read))))
    q, tilt = read.q_nb.reshape(4, count, ROW_STARTS), read.tilt.reshape(3, 3, count, ROW_STARTS)
    best, tilt = jax.vmap(best_of)(jnp.moveaxis(q, (0, 2), (2, 1)), jnp.moveaxis(tilt, (0, 1, 3), (2, 3, 1)), level)

    def chosen(x: Any) -> Any:
        x = x.reshape(*x.shape[:-1], count, ROW_STARTS)
        return jnp.take_along_axis(x, best.reshape(*[1] * (x.ndim - 2), count, 1), axis=-1)[..., 0]

    found = jax.tree.map(chosen, RowSolutions(read, alpha, beta))
    return found._replace(read=dataclasses.replace(found.read, tilt=jnp.moveaxis(tilt, 0, -1)))


def causal_traced(
    model: Model,
    epochs: Epochs,
    starts: tuple[Start, ...],
    numbers: np.ndarray,
    iterations: int,
    imu: ImuErrors | None = None,
    centre: Any = None,
) -> tuple[RowSolutions, Float[Array, "p rows"]]:
    """Rows by the fixes up to each alone, the figures too; and those. One row after the other."""
    rows = jax.tree.map(lambda x: x[:, None], epochs.rows)

    def one(number: Any) -> Any:
        fit = fit_traced(model, epochs, starts, imu, centre, number)
        own = applied(model, _over(fit.belief, 1), fit.fitted.theta[:, fit.best, None])
        problem = Problem(rows, epochs.site, epochs.sd, number[None])
        _, alpha, beta = begin_search(own, problem)
        yes = jnp.ones(1, bool)
        state = jax.tree.map(lambda x: x[..., fit.best, None], fit.fitted.state)
        read = converged(own, problem, dataclasses.replace(state, early=~yes, moving=yes), iterations, 1)
        of_starts = fit.read.q_nb.T, jnp.moveaxis(fit.read.tilt, -1, 0)
        others = best_of(*of_starts, fit.level)[1] - fit.read.tilt[..., fit.best]
        read = dataclasses.replace(read, tilt=read.tilt + others[..., None])
        return jax.tree.map(lambda x: x[..., 0], (RowSolutions(read, alpha, beta), own_figures(fit)))

    found, figures = jax.lax.map(one, jnp.asarray(numbers))
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), (found, figures))


def own_figures(fit: TracedFit) -> Float[Array, "p 1"]:
    """Those of the best start."""
    return fit.fitted.theta[:, fit.best, None]


def _over(belief: Beliefs, lanes: int) -> Beliefs:
    """What is believed of one record, in so many lanes."""

    def one(x: Any) -> Any:
        return None if x is None else jnp.broadcast_to(x[..., :1], (*x.shape[:-1], lanes))

    return dataclasses.replace(
        belief, raw=one(belief.raw), stated=one(belief.stated), rate=one(belief.rate), rate_sd=one(belief.rate_sd)
    )
