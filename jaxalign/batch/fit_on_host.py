"""A record fitted on the host: the compiled step of the fit, called again and again."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxalign.batch.figures import Beliefs, Layout, applied, log_prior
from jaxalign.batch.fit import (
    FIT,
    HOLD,
    ROUNDS,
    SETTLE,
    SETTLED,
    Fit,
    Fitted,
    Start,
    first_figures,
    fit_step,
    within_belief,
)
from jaxalign.batch.growth import extend, window_ends, with_gyro_bias
from jaxalign.batch.iterate import RowSolutions, begin_search, filled_rows, with_heading
from jaxalign.batch.modes import best_of
from jaxalign.batch.problem import Model, Problem, Readout
from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs

__all__ = ["fit_on_host", "rows_on_host"]

_ROW_STARTS, _ROW_ROUNDS = 4, 12
_begin = Program(begin_search, {"xla_backend_optimization_level": 1})
_step, _extend, _turn = Program(fit_step), Program(extend), Program(with_heading)


def fit_on_host(model: Model, epochs: Epochs, belief: Beliefs, starts: tuple[Start, ...], rounds: int = ROUNDS) -> Fit:
    """Fit a record from several starts.

    Args:
        model: what is known but for the figures; ``aid_noise`` "held".
        epochs: of one log.
        belief: as many lanes as there are starts.
        starts: where to begin.
        rounds: steps in which the figures are fitted.
    """
    rows, last, lanes = filled_rows(epochs.rows), len(epochs) - 1, len(starts)
    grown = np.array([one.grown for one in starts])
    dt = np.asarray(epochs.rows.dt)
    aided = np.any([np.asarray(fix.valid) for fix in epochs.rows.fixes], axis=0)
    ends = window_ends(np.cumsum(dt), aided, last)

    def upto(lasts: Any) -> Problem:
        lasts = np.asarray(lasts)
        return Problem(rows, epochs.site, epochs.sd, lasts, np.max(lasts) + 1)

    def stepped(problem: Problem, at: Fitted, phase: int, final: bool = False) -> tuple[Fitted, Readout]:
        return _step(model, belief, problem, at, np.asarray(phase), np.asarray(final))

    def kept(new: Any, old: Any) -> Any:
        return jax.tree.map(lambda a, b: np.where(grown, a, b), new, old)

    theta = first_figures(model, belief, starts)
    before = np.where(grown, ends[0], last)
    state, _, _ = _begin(applied(model, belief, theta), upto(before))
    state = _turn(state, state, np.array([one.turn for one in starts]), model.aids)
    if belief.rate is not None:  # the bias that the mean rate speaks for, as far as figures allow it
        own = np.asarray(applied(model, belief, theta).gyro_mean)
        state = with_gyro_bias(state, np.where(grown, own, 0.0))
        state = _extend(upto(before), state, np.where(grown, 0, last))
    at, windows = Fitted(state, theta), []
    for end in ends:
        until = np.where(grown, end, last)
        if (until > before).any():
            at = Fitted(_extend(upto(until), at.state, before), at.theta)
        problem = upto(np.where(grown, end, 0))
        for _ in range(SETTLED):
            at = kept(stepped(problem, at, SETTLE)[0], at)
        windows.append((int(end), at))
        before = until
    problem = upto(np.full(lanes, last))
    for number in range(SETTLED + rounds):
        at, _ = stepped(problem, at, SETTLE if number < SETTLED else FIT)
    _, read = stepped(problem, at, HOLD, True)
    prior = log_prior(belief, Layout.of(model), at.theta)[0]
    posterior = np.asarray(read.log_likelihood) + np.asarray(prior)
    return Fit(at, read, posterior, within_belief(model, read), tuple(windows), starts)


def rows_on_host(
    model: Model,
    epochs: Epochs,
    belief: Beliefs,
    fit: Fit,
    numbers: np.ndarray,
    done: Callable[[int], None] | None = None,
) -> RowSolutions:
    """Rows by the fixes up to each, with the figures of the whole record.

    Each row has four starts: the solution of the whole record, the attitude that needs no guess, and two headings of
    the window that ends before it.

    Args:
        model: as for :func:`fit_on_host`.
        epochs: likewise.
        belief: likewise.
        fit: of the whole record.
        numbers: of the epochs to read out.
        done: told how many rows are finished, group by group.
    """
    rows, lanes = filled_rows(epochs.rows), len(fit.starts)
    theta = np.repeat(np.asarray(fit.fitted.theta)[:, [fit.best]], lanes, axis=1)
    own = applied(model, belief, theta)
    grown = [i for i, one in enumerate(fit.starts) if one.grown]
    pair = [grown[0], next(i for i in grown if fit.starts[i].turn == np.pi)]
    ends = np.array([end for end, _ in fit.windows])
    of_group = lanes // _ROW_STARTS
    groups = []
    for first in range(0, len(numbers), of_group):
        some = numbers[first : first + of_group]
        count = len(some)
        some = np.concatenate([some, np.full(of_group - count, some[-1])])
        last = np.repeat(some, _ROW_STARTS)
        problem = Problem(rows, epochs.site, epochs.sd, last, np.max(last) + 1)
        plain, alpha, beta = _begin(own, problem)
        states, after = [], []
        for k, row in enumerate(some):
            window = max(int(np.searchsorted(ends, row, side="right")) - 1, 0)
            states += [_lane(fit.fitted.state, fit.best), _lane(plain, k * _ROW_STARTS + 1)]
            states += [_lane(fit.windows[window][1].state, i) for i in pair]
            after += [row, row, min(ends[window], row), min(ends[window], row)]
        state = jax.tree.map(lambda *x: np.stack(x, axis=-1), *states)
        at = Fitted(_extend(problem, state, np.array(after)), theta)
        for _ in range(SETTLED):
            at = Fitted(_step(model, belief, problem, at, np.asarray(SETTLE), np.asarray(False))[0].state, theta)
        for number in range(_ROW_ROUNDS + 1):
            final = number == _ROW_ROUNDS or (number > 0 and not np.asarray(at.state.moving).any())
            new, read = _step(model, belief, problem, at, np.asarray(HOLD), np.asarray(final))
            if final:
                break
            at = new
        groups.append(_best_rows(model, RowSolutions(read, alpha, beta), count))
        if done is not None:
            done(count)
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *groups)


def _lane(tree: Any, number: int) -> Any:
    return jax.tree.map(lambda x: np.asarray(x)[..., number], tree)


def _best_rows(model: Model, found: RowSolutions, count: int) -> RowSolutions:
    """Of the starts of each row the best, the others in mind."""
    read = found.read
    level = np.where(within_belief(model, read), np.asarray(read.log_likelihood), -np.inf)
    level = np.where(np.isfinite(level), level, -np.inf).reshape(-1, _ROW_STARTS)
    all_of_it = np.asarray(read.log_likelihood).reshape(-1, _ROW_STARTS)
    level = np.where(np.isfinite(level).any(axis=1, keepdims=True), level, all_of_it)
    by_row = jax.tree.map(lambda x: np.asarray(x).reshape(*x.shape[:-1], -1, _ROW_STARTS), found)
    q = np.moveaxis(by_row.read.q_nb, (0, -1), (-1, -2))
    best, tilt = _modes(q, np.moveaxis(by_row.read.tilt, (0, 1, -1), (-2, -1, -3)), level)  # pyright: ignore[reportArgumentType]
    best = np.asarray(best)

    def chosen(x: Any) -> Any:
        return np.take_along_axis(x, best.reshape(*[1] * (x.ndim - 2), -1, 1), axis=-1)[..., :count, 0]

    out = jax.tree.map(chosen, by_row)
    tilt = np.moveaxis(np.asarray(tilt), 0, -1)[..., :count]
    return out._replace(read=dataclasses.replace(out.read, tilt=tilt))


_modes = Program(jax.vmap(best_of))
