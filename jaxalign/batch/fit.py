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
from jaxalign.batch.figures import Beliefs, Layout, applied, beliefs, least_figures, on_the_line
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
    "fit_step",
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
