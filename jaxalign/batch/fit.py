"""Attitude and figures together: Gauss-Newton steps alternate with steps of Fisher scoring, from several starts.

Lanes are starts of one record, or rows of it. One compiled step serves all phases: windows that grow, the fit, rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.aids import AbstractAid
from jaxalign.batch.figures import Beliefs, Layout, applied, beliefs, least_figures, log_prior, on_the_line
from jaxalign.batch.growth import extend, window_ends, with_gyro_bias
from jaxalign.batch.iterate import RowSolutions, begin_search, filled_rows, with_heading
from jaxalign.batch.modes import best_of
from jaxalign.batch.problem import LEAST_SD, Model, Problem, Readout, State
from jaxalign.batch.scoring import held_noise, score
from jaxalign.batch.solver import advance, linearize_problem, with_steady
from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs
from jaxalign.inertial_unit import ImuErrors
from jaxalign.units import UG
from jaxalign.wgs84 import EARTH_RATE, STANDARD_GRAVITY

__all__ = [
    "FIT",
    "HOLD",
    "MOST_ACCEL_BIAS",
    "MOST_GYRO_BIAS",
    "ROUNDS",
    "SETTLE",
    "SETTLED",
    "Fit",
    "Fitted",
    "Start",
    "belief_of",
    "first_figures",
    "fit_on_host",
    "fit_step",
    "rows_on_host",
    "usual_starts",
    "within_belief",
]

SETTLE, FIT, HOLD = 0, 1, 2
"""Phases: the noise of the aids by the median of the misfits, other figures held; all figures fitted; all held."""
SETTLED, ROUNDS = 4, 12
"""Steps of the first phase, and of the second."""
MOST_GYRO_BIAS = float(np.deg2rad(5.0))
MOST_ACCEL_BIAS = 0.15e6 * UG
"""rad/s and m/s^2: no sensor of attitude has more."""
_BELIEF = 5.0  # deviations of an unknown
_LOOSE = 1.0  # decades: hardly anything is known of a slow error
_SLOW = (1.0, 30.0)  # times what is believed of it, to begin with
_ROW_STARTS, _ROW_ROUNDS = 4, 12
_SWAY = float(np.deg2rad(3.0))  # that a standing vehicle may have turned in all


class Fitted(eqx.Module):
    """Between two steps.

    Attributes:
        state: trajectory, unknowns and noise.
        theta: (p, L) figures.
    """

    state: State
    theta: Float[Array, "p L"]


def fit_step(
    model: Model, belief: Beliefs, problem: Problem, fitted: Fitted, phase: Any, final: Any
) -> tuple[Fitted, Readout]:
    """One Gauss-Newton step with the figures as they are, then, where they are fitted, one step of scoring.

    Args:
        model: what is known but for the figures; ``aid_noise`` "held".
        belief: what is believed of them.
        problem: fixes.
        fitted: from the step before.
        phase: :data:`SETTLE`, :data:`FIT` or :data:`HOLD`.
        final: it is read out after this one.
    """
    layout = Layout.of(model)
    early = jnp.broadcast_to(phase == SETTLE, fitted.state.early.shape)
    moving = fitted.state.moving | (phase != HOLD)
    state = with_steady(dataclasses.replace(fitted.state, early=early, moving=moving), final)
    own = applied(model, belief, fitted.theta)
    linear = linearize_problem(own, problem, state)
    new, read = advance(own, problem, state, linear, phase != SETTLE, final)
    found = jnp.maximum(_noise_found(new, layout, fitted.theta), least_figures(belief, layout))
    theta = jax.lax.cond(
        phase == FIT,
        lambda: score(model, belief, problem, state, linear, fitted.theta)[0],
        lambda: jnp.where(phase == SETTLE, found, fitted.theta),
    )
    return Fitted(held_noise(new, layout, theta), theta), read


def _noise_found(state: State, layout: Layout, theta: Any) -> Any:
    """The figures with the noise of the aids that a state has."""
    for one, j in zip(state.noise, layout.noise, strict=True):
        theta = theta.at[j].set(0.5 * jnp.log(one.variance))
    return theta


class Start(NamedTuple):
    """Where a search begins.

    Attributes:
        grown: by windows that grow, with large biases; else by the attitude that needs no guess, with the figures that
            the raw noise speaks for.
        turn: of the heading, rad.
        slow: deviation of a slow error of the aids to begin with, in units of what is believed; 1: as believed.
    """

    grown: bool
    turn: float
    slow: float = 1.0


def usual_starts(aids: tuple[AbstractAid, ...]) -> tuple[Start, ...]:
    """Where to begin, when nothing is said: eight of them.

    The deviation of a slow error that begins small has no slope and stays small: where little is known of it, the
    search begins with a large one too.
    """
    turns = [eighths * np.pi / 4 for eighths in (0, 4, 2, 6, 1, 5, 3)]
    loose = any(one.name == "slow" and one.decades >= _LOOSE for aid in aids for one in aid.unknowns)
    if not loose:
        return (Start(False, 0.0), *(Start(True, turn) for turn in turns))
    both = (Start(grown, turn, slow) for grown, turn in ((False, 0.0), (True, 0.0), (True, np.pi)) for slow in _SLOW)
    return (*both, *(Start(True, turn) for turn in turns[2:4]))


class Fit(NamedTuple):
    """What the starts of one record have led to; leaves have them on the last axis.

    Attributes:
        fitted: trajectories and figures.
        read: solutions at the last epoch.
        posterior: (L,) logarithm, but for a constant.
        believable: (L,) whether what was found is within belief.
        windows: last epoch of each window, and what had been found there.
        starts: that they are of.
    """

    fitted: Fitted
    read: Readout
    posterior: np.ndarray
    believable: np.ndarray
    windows: tuple[tuple[int, Fitted], ...]
    starts: tuple[Start, ...]

    @property
    def level(self) -> np.ndarray:
        """(L,) posterior of the starts that count: of those within belief, if there is any."""
        known = np.isfinite(self.posterior)
        counts = known & self.believable
        return np.where(counts if counts.any() else known, self.posterior, -np.inf)

    @property
    def best(self) -> int:
        """The number of the best start."""
        return int(np.argmax(self.level))


def within_belief(model: Model, read: Readout) -> np.ndarray:
    """(L,) whether biases are such as sensors have, and unknowns within a few deviations of what was believed.

    A likelihood leaves out what the model does not know, and then prefers a fit by a few parts in a hundred to
    any prior: a clock that is late by ten deviations is not believed for that.
    """
    gyro = np.max(np.abs(np.asarray(read.gyro)), axis=0) <= MOST_GYRO_BIAS
    accel = np.max(np.abs(np.asarray(read.accel)), axis=0) <= MOST_ACCEL_BIAS
    constant = np.isinf(np.asarray(model.fade_s))
    sd = np.asarray(model.sd)[constant]
    sd = sd if sd.ndim > 1 else sd[:, None]
    far = np.abs(np.asarray(read.unknowns)[constant]) > _BELIEF * sd
    return gyro & accel & ~far.any(axis=0)


def belief_of(model: Model, epochs: Epochs, lanes: int, imu: ImuErrors | None = None, centre: Any = None) -> Beliefs:
    """What is believed of the figures of one record; host.

    Of a standing vehicle the mean rate tells the bias of the gyroscopes, but for its sway, and the wandering of the
    path leaves a noise of second order.
    """
    stated = np.array([[max(float(np.sqrt(np.mean(np.square(np.asarray(sd))))), LEAST_SD)] for sd in epochs.sd])
    raw = None if epochs.raw_noise is None else np.asarray(epochs.raw_noise)
    rate = rate_sd = None
    if all(aid.implied for aid in model.aids):
        span = float(np.asarray(epochs.rows.dt).sum())
        q = epochs.rows.rotation
        half = np.stack([np.asarray(x) for x in (q.x, q.y, q.z)])  # of small turns
        rate = np.repeat(2.0 * half.sum(axis=1, keepdims=True) / span, lanes, axis=1)
        rate_sd = np.full(lanes, _SWAY / span + EARTH_RATE)
        if raw is not None:
            stated = np.maximum(stated, STANDARD_GRAVITY * span**2 * raw[0] ** 2)
    return beliefs(model, np.repeat(stated, lanes, axis=1), raw, imu, centre, rate, rate_sd)


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


def first_figures(model: Model, belief: Beliefs, starts: tuple[Start, ...]) -> Float[Array, "p L"]:
    """(p, L) of each start."""
    layout = Layout.of(model)
    grown = np.array([one.grown for one in starts])
    theta = np.where(grown, np.asarray(on_the_line(belief, True)), np.asarray(on_the_line(belief, False)))
    for slow, noise, stated in zip(layout.slow, layout.noise, np.asarray(belief.stated), strict=True):
        theta[noise] = stated
        if slow is not None:
            theta[slow] = theta[slow] + np.log([one.slow for one in starts])
    return jnp.asarray(theta)


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
    best, tilt = _modes(q, np.moveaxis(by_row.read.tilt, (0, 1, -1), (-2, -1, -3)), level)
    best = np.asarray(best)

    def chosen(x: Any) -> Any:
        return np.take_along_axis(x, best.reshape(*[1] * (x.ndim - 2), -1, 1), axis=-1)[..., :count, 0]

    out = jax.tree.map(chosen, by_row)
    tilt = np.moveaxis(np.asarray(tilt), 0, -1)[..., :count]
    return out._replace(read=dataclasses.replace(out.read, tilt=tilt))


_modes = Program(jax.vmap(best_of))
