"""Attitude and figures together: Gauss-Newton steps alternate with steps of Fisher scoring, from several starts.

Lanes are starts of one record, or rows of it. One compiled step serves all phases: windows that grow, the fit, rows.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.aids import AbstractAid
from jaxalign.batch.figures import Beliefs, Layout, applied, beliefs, least_figures, log_prior, on_the_line
from jaxalign.batch.growth import extend, window_ends, with_gyro_bias
from jaxalign.batch.iterate import begin_search, with_heading
from jaxalign.batch.problem import LEAST_SD, Model, Problem, Readout, State
from jaxalign.batch.scoring import held_noise, score
from jaxalign.batch.solver import advance, linearize_problem, with_steady
from jaxalign.epochs import Epochs
from jaxalign.inertial_unit import ImuErrors
from jaxalign.units import UG
from jaxalign.wgs84 import EARTH_RATE, STANDARD_GRAVITY

__all__ = [
    "FIT",
    "HOLD",
    "ROUNDS",
    "ROW_STARTS",
    "SETTLE",
    "SETTLED",
    "Fitted",
    "Prepared",
    "Start",
    "counted",
    "fit_step",
    "levels",
    "opposite_headings",
    "prepared",
    "usual_starts",
    "within_belief",
]

SETTLE, FIT, HOLD = 0, 1, 2
"""Phases: the noise of the aids by the median of the misfits, other figures held; all figures fitted; all held."""
SETTLED, ROUNDS = 4, 12
"""Steps of the first phase, and of the second."""
ROW_STARTS = 4
"""Of a row: the whole record, the attitude that needs no guess, two headings of the window before it."""
_MOST_GYRO_BIAS = float(np.deg2rad(5.0))  # rad/s
_MOST_ACCEL_BIAS = 0.15e6 * UG  # no sensor of attitude has more
_BELIEF = 5.0  # deviations of an unknown
_LOOSE = 1.0  # decades: hardly anything is known of a slow error
_SLOW = (1.0, 30.0)  # times what is believed of it, to begin with
_SWAY = float(np.deg2rad(3.0))  # that a standing vehicle may have turned in all


class Fitted(eqx.Module):
    """Between two steps.

    Attributes:
        state: trajectory, unknowns and noise.
        theta: (p, L) figures.
    """

    state: State
    theta: Any


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


def within_belief(model: Model, read: Readout) -> Any:
    """(L,) whether biases are such as sensors have, and unknowns within a few deviations of what was believed.

    A likelihood leaves out what the model does not know, and then prefers a fit by a few parts in a hundred to
    any prior: a clock that is late by ten deviations is not believed for that.
    """
    gyro = jnp.max(jnp.abs(read.gyro), axis=0) <= _MOST_GYRO_BIAS
    accel = jnp.max(jnp.abs(read.accel), axis=0) <= _MOST_ACCEL_BIAS
    sd = model.sd if model.sd.ndim > 1 else model.sd[:, None]
    constant = jnp.isinf(model.fade_s)[:, None]
    far = constant & (jnp.abs(read.unknowns) > _BELIEF * sd)
    return gyro & accel & ~jnp.any(far, axis=0)


def believed(
    model: Model, epochs: Epochs, span: Any, lanes: int, imu: ImuErrors | None = None, centre: Any = None
) -> Beliefs:
    """What is believed of the figures of one record; pure.

    Of a standing vehicle the mean rate tells the bias of the gyroscopes, but for its sway, and the wandering of the
    path leaves a noise of second order.

    Args:
        model: its aids and their unknowns.
        epochs: of one log, leaves of the rows (K,) or (K, 1).
        span: s, of them.
        lanes: how many.
        imu: figures that are known.
        centre: see :func:`jaxalign.batch.figures.beliefs`.
    """
    stated = jnp.stack([jnp.maximum(jnp.sqrt(jnp.mean(jnp.square(sd))), LEAST_SD) for sd in epochs.sd])[:, None]
    raw = epochs.raw_noise
    rate = rate_sd = None
    if all(aid.implied for aid in model.aids):
        q = epochs.rows.rotation
        half = jnp.stack([jnp.sum(x) for x in (q.x, q.y, q.z)])  # of small turns
        rate = jnp.broadcast_to((2.0 * half / span)[:, None], (3, lanes))
        rate_sd = jnp.broadcast_to(_SWAY / span + EARTH_RATE, (lanes,))
        if raw is not None:
            stated = jnp.maximum(stated, STANDARD_GRAVITY * span**2 * jnp.asarray(raw)[0] ** 2)
    return beliefs(model, jnp.broadcast_to(stated, (len(stated), lanes)), raw, imu, centre, rate, rate_sd)


def first_figures(model: Model, belief: Beliefs, starts: tuple[Start, ...]) -> Float[Array, "p L"]:
    """(p, L) of each start."""
    layout = Layout.of(model)
    grown = jnp.array([one.grown for one in starts])
    theta = jnp.where(grown, on_the_line(belief, True), on_the_line(belief, False))
    for slow, noise, stated in zip(layout.slow, layout.noise, belief.stated, strict=True):
        theta = theta.at[noise].set(stated)
        if slow is not None:
            theta = theta.at[slow].add(jnp.log(jnp.array([one.slow for one in starts])))
    return theta


class Prepared(NamedTuple):
    """Where a fit begins.

    Attributes:
        belief: of the figures.
        fitted: of each start: those that grow in their first window, the others over the whole record.
        ends: (10,) last epochs of the windows.
    """

    belief: Beliefs
    fitted: Fitted
    ends: Any


def prepared(
    model: Model,
    epochs: Epochs,
    last: Any,
    starts: tuple[Start, ...],
    imu: ImuErrors | None = None,
    centre: Any = None,
) -> Prepared:
    """Belief, windows and the trajectories to begin with; pure.

    Args:
        model: what is known but for the figures; ``aid_noise`` "held".
        epochs: of one log, leaves of the rows (K, 1).
        last: the last epoch; behind it nothing.
        starts: where to begin.
        imu: figures that are known.
        centre: see :func:`jaxalign.batch.figures.beliefs`.
    """
    lanes = len(starts)
    time = jnp.cumsum(epochs.rows.dt[:, 0])
    belief = believed(model, epochs, time[last], lanes, imu, centre)
    aided = jnp.any(jnp.stack([fix.valid[:, 0] for fix in epochs.rows.fixes]), axis=0)
    ends = window_ends(time, aided, last)
    grown = jnp.array([one.grown for one in starts])
    first = jnp.where(grown, ends[0], last)
    problem = Problem(epochs.rows, epochs.site, epochs.sd, first)
    theta = first_figures(model, belief, starts)
    own = applied(model, belief, theta)
    state, _, _ = begin_search(own, problem)
    state = with_heading(state, state, jnp.array([one.turn for one in starts]), model.aids)
    if belief.rate is not None:  # the bias that the mean rate speaks for, as far as the figures allow it
        state = with_gyro_bias(state, jnp.where(grown, own.gyro_mean, 0.0))
        state = extend(problem, state, jnp.where(grown, 0, last))
    return Prepared(belief, Fitted(state, theta), ends)


def levels(model: Model, belief: Beliefs, fitted: Fitted, read: Readout) -> Float[Array, " L"]:
    """Logarithm of the posterior of what counts, but for a constant; minus infinity where it does not.

    What is within belief counts; if nothing is, all that is finite.
    """
    value = read.log_likelihood + log_prior(belief, Layout.of(model), fitted.theta)[0]
    return counted(value, within_belief(model, read))


def counted(level: Any, believable: Any) -> Any:
    """(..., n) levels of those that count along the last axis."""
    known = jnp.isfinite(level)
    good = known & believable
    return jnp.where(jnp.where(jnp.any(good, axis=-1, keepdims=True), good, known), level, -jnp.inf)


def opposite_headings(starts: tuple[Start, ...]) -> tuple[int, int]:
    """The numbers of two opposite headings that grow."""
    grown = [i for i, one in enumerate(starts) if one.grown]
    return grown[0], next(i for i in grown if starts[i].turn == np.pi)
