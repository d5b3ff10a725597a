"""A record fitted on the host: the compiled step of the fit, called again and again."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

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
from jaxalign.batch.growth import extend
from jaxalign.batch.iterate import RowSolutions, begin_search, filled_rows
from jaxalign.batch.modes import best_of
from jaxalign.batch.problem import Model, Problem, Readout
from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs
from jaxalign.inertial_unit import ImuErrors

__all__ = ["HostFit", "causal_on_host", "fit_on_host", "rows_on_host"]

_ROW_ROUNDS = 12


class HostFit(NamedTuple):
    """What the starts of one record have led to; leaves have them on the last axis.

    Attributes:
        epochs: filled up, leaves of the rows (K, 1).
        belief: of the figures.
        fitted: trajectories and figures.
        read: solutions at the last epoch.
        level: (L,) logarithm of the posterior of those that count, but for a constant.
        windows: last epoch of each window, and what had been found there.
        starts: that they are of.
    """

    epochs: Epochs
    belief: Beliefs
    fitted: Fitted
    read: Readout
    level: np.ndarray
    windows: tuple[tuple[int, Fitted], ...]
    starts: tuple[Start, ...]

    @property
    def best(self) -> int:
        """The number of the best start."""
        return int(np.argmax(self.level))


def _row_begun(model: Model, belief: Beliefs, problem: Problem, theta: Any) -> Any:
    return begin_search(applied(model, belief, theta), problem)


def _row_levels(model: Model, read: Readout) -> Any:
    """Best start of each row, and the covariance of its attitude with the others in mind."""
    level = counted(read.log_likelihood.reshape(-1, ROW_STARTS), within_belief(model, read).reshape(-1, ROW_STARTS))
    q, tilt = (x.reshape(*x.shape[:-1], -1, ROW_STARTS) for x in (read.q_nb, read.tilt))
    return jax.vmap(best_of, in_axes=(0, 0, 0))(q.transpose(1, 2, 0), tilt.transpose(2, 3, 0, 1), level)


_quickly = {"xla_backend_optimization_level": 1}  # what runs once compiles faster so
_prepare, _begin, _levels = Program(prepared, _quickly), Program(_row_begun, _quickly), Program(levels, _quickly)
_modes = Program(best_of, _quickly)
_step, _extend, _best = Program(fit_step), Program(extend, _quickly), Program(_row_levels, _quickly)


def fit_on_host(
    model: Model,
    epochs: Epochs,
    starts: tuple[Start, ...],
    imu: ImuErrors | None = None,
    centre: Any = None,
    last: int | None = None,
    rounds: int = ROUNDS,
) -> HostFit:
    """Fit a record from several starts.

    Args:
        model: what is known but for the figures; ``aid_noise`` "held".
        epochs: of one log.
        starts: where to begin.
        imu: figures that are known.
        centre: see :func:`jaxalign.batch.figures.beliefs`.
        last: the last epoch whose fix counts; None: of all.
        rounds: steps in which the figures are fitted.
    """
    filled = dataclasses.replace(epochs, rows=filled_rows(epochs.rows))
    last = len(epochs) - 1 if last is None else last
    grown = np.array([one.grown for one in starts])
    belief, at, ends = _prepare(model, filled, np.asarray(last), starts, imu, centre)
    ends = np.asarray(ends)

    def upto(lasts: Any) -> Problem:
        lasts = np.asarray(lasts)
        return Problem(filled.rows, epochs.site, epochs.sd, lasts, np.max(lasts) + 1)

    def stepped(problem: Problem, at: Fitted, phase: int, final: bool = False) -> tuple[Fitted, Readout]:
        return _step(model, belief, problem, at, np.asarray(phase), np.asarray(final))

    windows = []
    for window, end in enumerate(ends):
        if window and end > ends[window - 1]:
            before = np.where(grown, ends[window - 1], last)
            at = Fitted(_extend(upto(np.full(len(starts), last)), at.state, before), at.theta)
        problem = upto(np.where(grown, end, 0))
        for _ in range(SETTLED):
            new = stepped(problem, at, SETTLE)[0]
            at = jax.tree.map(lambda a, b: np.where(grown, a, b), new, at)
        windows.append((int(end), at))
    problem = upto(np.full(len(starts), last))
    for number in range(SETTLED + rounds):
        at, _ = stepped(problem, at, SETTLE if number < SETTLED else FIT)
    _, read = stepped(problem, at, HOLD, True)
    level = np.asarray(_levels(model, belief, at, read))
    return HostFit(filled, belief, at, jax.tree.map(np.asarray, read), level, tuple(windows), starts)


def causal_on_host(
    model: Model,
    epochs: Epochs,
    starts: tuple[Start, ...],
    numbers: np.ndarray,
    imu: ImuErrors | None = None,
    centre: Any = None,
    done: Callable[[int], None] | None = None,
) -> tuple[RowSolutions, np.ndarray]:
    """Rows by the fixes up to each alone, the figures too; and those (p, rows). Each costs a fit.

    Arguments as of :func:`fit_on_host` and :func:`rows_on_host`.
    """
    found, figures = [], []
    for row in numbers:
        fit = fit_on_host(model, epochs, starts, imu, centre, int(row))
        problem = Problem(fit.epochs.rows, epochs.site, epochs.sd, np.full(len(starts), row), row + 1)
        _, alpha, beta = _begin(model, fit.belief, problem, fit.fitted.theta)
        found.append(_best_of_starts(fit, RowSolutions(fit.read, alpha, beta)))
        figures.append(np.asarray(fit.fitted.theta)[:, fit.best])
        if done is not None:
            done(1)
    return jax.tree.map(lambda *x: np.stack(x, axis=-1), *found), np.stack(figures, axis=-1)


def _best_of_starts(fit: HostFit, found: RowSolutions) -> RowSolutions:
    """Without lanes."""
    read: Any = fit.read
    tilt = _modes(np.moveaxis(read.q_nb, -1, 0), np.moveaxis(read.tilt, -1, 0), fit.level)[1]  # pyright: ignore[reportArgumentType]
    out = _lane(found, fit.best)
    return out._replace(read=dataclasses.replace(out.read, tilt=np.asarray(tilt)))


def rows_on_host(
    model: Model, fit: HostFit, numbers: np.ndarray, done: Callable[[int], None] | None = None
) -> RowSolutions:
    """Rows by the fixes up to each, with the figures of the whole record.

    Each row has four starts: the solution of the whole record, the attitude that needs no guess, and two headings of
    the window that ends before it.

    Args:
        model: as for :func:`fit_on_host`.
        fit: of the whole record.
        numbers: of the epochs to read out.
        done: told how many rows are finished, group by group.
    """
    epochs, belief, lanes = fit.epochs, fit.belief, len(fit.starts)
    theta = np.repeat(np.asarray(fit.fitted.theta)[:, [fit.best]], lanes, axis=1)
    pair = opposite_headings(fit.starts)
    ends = np.array([end for end, _ in fit.windows])
    of_group = lanes // ROW_STARTS
    groups = []
    for first in range(0, len(numbers), of_group):
        some = numbers[first : first + of_group]
        count = len(some)
        some = np.concatenate([some, np.full(of_group - count, some[-1])])
        last = np.repeat(some, ROW_STARTS)
        problem = Problem(epochs.rows, epochs.site, epochs.sd, last, np.max(last) + 1)
        plain, alpha, beta = _begin(model, belief, problem, theta)
        states, after = [], []
        for k, row in enumerate(some):
            window = max(int(np.searchsorted(ends, row, side="right")) - 1, 0)
            states += [_lane(fit.fitted.state, fit.best), _lane(plain, k * ROW_STARTS + 1)]
            states += [_lane(fit.windows[window][1].state, i) for i in pair]
            after += [row, row, min(ends[window], row), min(ends[window], row)]
        state = jax.tree.map(lambda *x: np.stack(x, axis=-1), *states)
        at = Fitted(_extend(problem, state, np.array(after)), theta)
        for number in range(SETTLED + _ROW_ROUNDS + 1):
            settles = number < SETTLED
            final = number == SETTLED + _ROW_ROUNDS or (number > SETTLED and not np.asarray(at.state.moving).any())
            phase = np.asarray(SETTLE if settles else HOLD)
            new, read = _step(model, belief, problem, at, phase, np.asarray(final))
            if final:
                break
            at = Fitted(new.state, theta) if settles else new
        groups.append(_best_rows(model, RowSolutions(read, alpha, beta), count))
        if done is not None:
            done(count)
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *groups)


def _lane(tree: Any, number: int) -> Any:
    return jax.tree.map(lambda x: np.asarray(x)[..., number], tree)


def _best_rows(model: Model, found: RowSolutions, count: int) -> RowSolutions:
    """Of the starts of each row the best, the others in mind."""
    best, tilt = (np.asarray(x) for x in _best(model, found.read))

    def chosen(x: Any) -> Any:
        x = np.asarray(x).reshape(*x.shape[:-1], len(best), ROW_STARTS)
        return np.take_along_axis(x, best.reshape(*[1] * (x.ndim - 2), len(best), 1), axis=-1)[..., :count, 0]

    out = jax.tree.map(chosen, found)
    return out._replace(read=dataclasses.replace(out.read, tilt=np.moveaxis(tilt, 0, -1)[..., :count]))
