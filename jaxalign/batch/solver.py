"""The batch estimator as one step that is repeated: linearise, filter, smooth, weigh the fixes again.

All that a caller may want to vary without another compiled program is an argument: figures of the unit, the epoch up
to which fixes count, the trajectory to start from. The step is the same for each round and for the read-out.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.batch.fix import PARTS, fixes, parts_of
from jaxalign.batch.reweight import estimated, median_variance, outlier_odds, settled, weighed
from jaxalign.batch.smoother import Filtered, LinearProblem, Prior, Process
from jaxalign.batch.solve import solved
from jaxalign.batch.start import Views, misfit, robust_start
from jaxalign.batch.trajectory import (
    ACCEL,
    GYRO,
    STATES,
    TILT,
    UNKNOWN,
    VELOCITY,
    Intervals,
    Trajectory,
    by_tilt,
    mechanized,
)
from jaxalign.earth import Site
from jaxalign.epochs import Epoch
from jaxalign.inertial_unit import ImuErrors
from jaxalign.vector import Quat, Vec3

__all__ = ["LEAST_SD", "Model", "Problem", "Readout", "State", "initial_state", "linearized", "step"]

LEAST_SD = 1e-6
"""m/s: noise of an aid below which none is believed."""
_FREE = 1e3  # times the noise of a fix: nothing is known of the first velocity, and nothing lost to rounding
_LEAST = 1e-12  # weight
_NEAR = 1e-2  # standard deviations that a step moves a solution that is near


class Model(eqx.Module):
    """What is known beforehand; see :class:`jaxalign.RobustMap`. Numbers have shape () or (L,).

    Attributes:
        imu: figures of the inertial unit.
        outliers: probability of one.
        spread: standard deviation of outliers over that of the others.
        sd: (c,) or (c, L) standard deviations of the unknowns of the aid.
        fade_s: (c,) s: after so long an unknown has renewed itself; infinite for constants.
        tolerance: what a step moves a solution that has converged, in standard deviations.
        unknown: their names.
        noise: how that of the aid is found.
        aid: its kind.
    """

    imu: ImuErrors
    outliers: Any
    spread: Any
    sd: Any
    fade_s: Any
    tolerance: Any
    unknown: tuple[str, ...] = eqx.field(static=True)
    noise: str = eqx.field(static=True)
    aid: str = eqx.field(static=True)


class Problem(eqx.Module):
    """Fixes up to an epoch.

    Attributes:
        rows: of the epochs, leaves (K, L), or (K, 1) where all lanes have the same.
        site: leaves (), or (L,).
        stated: standard deviation of the aid, m/s, () or (L,).
        last: (L,) epoch up to which fixes count.
        length: epochs that count in any lane, see :func:`jaxalign.batch.rows.over_rows`; None: all, as derivatives
            need it.
    """

    rows: Epoch
    site: Site
    stated: Float[Array, "*L"]
    last: Any
    length: Any = None

    @property
    def on(self) -> Bool[Array, "K L"]:
        """Whether an epoch counts."""
        return jnp.arange(len(self.rows.dt))[:, None] <= self.last

    @property
    def used(self) -> Bool[Array, "K L"]:
        """Whether there is a fix that counts."""
        return self.rows.valid & self.on


class State(eqx.Module):
    """Between two steps.

    Attributes:
        at: trajectory.
        q_n0n: n at its epochs.
        unknowns: (c, L) of the aid.
        weight: (K, L) of each fix.
        variance: (L,) of the noise of a fix, (m/s)^2.
        times: (L,) how many times it counts.
        settled: (K, L) for a navigation aid, see :func:`jaxalign.batch.fix.fixes`; else None.
        early: (L,) the trajectory is still far off: the noise is judged by its median. While biases are still in the
            misfit a mean square would take them for noise, and keep them there.
        moving: (L,) whether it has not converged; if it has, it stays as it is, whatever other lanes do.
    """

    at: Trajectory
    q_n0n: Quat
    unknowns: Float[Array, "c L"]
    weight: Float[Array, "K L"]
    variance: Float[Array, " L"]
    times: Float[Array, " L"]
    settled: Vec3 | None
    early: Bool[Array, " L"]
    moving: Bool[Array, " L"]


class Readout(eqx.Module):
    """The solution at the last epoch that counts.

    Attributes:
        q_nb: (4, L).
        tilt: (3, 3, L) covariance of the attitude error in n, rad^2.
        gyro: (3, L) bias, rad/s.
        accel: (3, L) bias, m/s^2.
        unknowns: (c, L) of the aid.
        covariance: (n, n, L) of all errors.
        log_likelihood: (L,) but for a constant.
        residual: (3, L) noise of the last fix, m/s, n0.
        weight: (L,) of the last fix.
        aid_sd: (L,) m/s.
    """

    q_nb: Float[Array, "4 L"]
    tilt: Float[Array, "3 3 L"]
    gyro: Float[Array, "3 L"]
    accel: Float[Array, "3 L"]
    unknowns: Float[Array, "c L"]
    covariance: Float[Array, "n n L"]
    log_likelihood: Float[Array, " L"]
    residual: Float[Array, "3 L"]
    weight: Float[Array, " L"]
    aid_sd: Float[Array, " L"]


def initial_state(model: Model, problem: Problem, seen: Views) -> State:
    """From the attitude that needs no guess, by the fixes that count. Not differentiated."""
    used, stated = problem.used, jnp.maximum(problem.stated, LEAST_SD)
    lanes = used.shape[1]
    views = jax.tree.map(lambda x: jnp.broadcast_to(x, (x.shape[0], lanes)), seen)

    start, _, _ = robust_start(views.alpha, views.beta, used, LEAST_SD, model.aid)
    off = misfit(views.alpha, views.beta, start, model.aid)
    off = jnp.stack([off.x, off.y, off.z], axis=1)
    variance = median_variance(off, used, stated)
    _, weight = weighed(off, variance, used, model.outliers, model.spread)
    count = sum(PARTS[name] for name in model.unknown)
    at = views.trajectory(start)
    steady = at.velocity if model.aid == "nav" else None
    yes = jnp.ones(lanes, bool)
    state = State(at, views.q_n0n, jnp.zeros((count, lanes)), weight, variance, jnp.ones(lanes), steady, yes, yes)
    return jax.lax.stop_gradient(state)


def _prior(model: Model, state: State, stated: Any) -> Prior:
    lanes = state.variance.shape
    free = _FREE * jnp.sqrt(jnp.maximum(stated**2, jax.lax.stop_gradient(state.variance)))
    gyro, accel = (jnp.stack([b.x[0], b.y[0], b.z[0]]) for b in (state.at.gyro, state.at.accel))
    blocks = (UNKNOWN, free, model.imu.gyro_bias, model.imu.accel_bias)
    sd = [jnp.broadcast_to(jnp.asarray(x), (3, *lanes)) for x in blocks]
    unknown = model.sd if model.sd.ndim > 1 else model.sd[:, None]
    sd.append(jnp.broadcast_to(unknown, state.unknowns.shape))
    mean = jnp.concatenate([jnp.zeros((6, *lanes)), -gyro, -accel, -state.unknowns])
    return Prior(mean, jnp.concatenate(sd) ** 2)


def _process(model: Model, intervals: Intervals) -> Process:
    """White noise of an interval, of the unit and of what renews itself."""
    dt, d = intervals.dt, intervals.gained
    gyro, accel = model.imu.gyro_walk**2 * dt, model.imu.accel_walk**2 * dt
    unit = jnp.eye(3)[:, :, None]
    zero = jnp.zeros_like(dt)
    skew = jnp.stack([zero, -d[:, 2], d[:, 1], d[:, 2], zero, -d[:, 0], -d[:, 1], d[:, 0], zero], axis=1)
    skew = skew.reshape(len(dt), 3, 3, -1)
    gyro, accel = gyro[:, None, None], accel[:, None, None]
    across = -0.5 * gyro * skew
    square = jnp.sum(d * d, axis=1)[:, None, None] * unit - d[:, :, None] * d[:, None]
    velocity = gyro / 3.0 * square + accel * unit
    tilt = gyro * unit
    motion = jnp.concatenate(
        [jnp.concatenate([tilt, jnp.swapaxes(across, 1, 2)], axis=2), jnp.concatenate([across, velocity], axis=2)],
        axis=1,
    )
    fade = jnp.exp(-dt[:, None] / model.fade_s[:, None])
    unknown = model.sd if model.sd.ndim > 1 else model.sd[:, None]
    renewed = unknown**2 * (1.0 - fade**2)
    biases = jnp.zeros((len(dt), STATES - 6, dt.shape[1]))
    return Process(motion, jnp.concatenate([biases, renewed], axis=1), fade)


def linearized(model: Model, problem: Problem, state: State) -> LinearProblem:
    """The errors of the trajectory and the fixes that measure them."""
    used = problem.used
    intervals = mechanized(problem.rows, problem.site, state.at, state.q_n0n, problem.on, problem.length)
    unknowns = {name: state.unknowns[where] for name, where in parts_of(model.unknown).items()}
    velocity, dt = problem.rows.velocity, intervals.dt
    found = fixes(state.at, intervals.q_n0n, dt, velocity, used, model.aid, unknowns, state.settled)
    each = state.variance * state.times / jnp.where(used, jnp.maximum(state.weight, _LEAST), 1.0)
    prior = _prior(model, state, jnp.maximum(problem.stated, LEAST_SD))
    process = _process(model, intervals)
    variance = each[:, None] * found.variance
    return LinearProblem(intervals, process, found.gap, found.slope, variance, used, prior, problem.length)


def step(model: Model, problem: Problem, state: State, late: Any, final: Any) -> tuple[State, Readout]:
    """One Gauss-Newton step, and the solution by the linear problem that it starts from.

    Of a navigation aid the final step tells the covariance alone, with velocities that have settled: the solution is
    the trajectory that it starts from.

    Args:
        model: what is known.
        problem: fixes.
        state: from the step before.
        late: no trajectory is taken as far off any more.
        final: it is read out after this one.
    """
    if state.settled is not None:
        steady = jax.tree.map(lambda a, b: jnp.where(final, a, b), state.settled, state.at.velocity)
        state = dataclasses.replace(state, settled=steady)
    linear = linearized(model, problem, state)
    found, error, noise = solved(linear)
    used, stated = problem.used, jnp.maximum(problem.stated, LEAST_SD)
    early = state.early & jnp.logical_not(late)
    median = jax.lax.cond(jnp.any(early), lambda: median_variance(noise, used, stated), lambda: state.variance)
    judged = jnp.where(early, median, state.variance)
    good, weight = weighed(noise, judged, used, model.outliers, model.spread)
    mean, times = estimated(noise, good, stated, model.noise)
    own = jnp.stack([found.covariance[i, i] for i in range(STATES)])
    last = _at(problem, error)
    moved = jax.lax.stop_gradient(jnp.max(jnp.abs(last[:STATES]) / jnp.sqrt(own), axis=0))
    changed = jax.lax.stop_gradient(jnp.abs(mean * times / (state.variance * state.times) - 1.0))
    constant = jnp.isinf(model.fade_s)[:, None]
    at, steady = state.at.moved(error), None
    if state.settled is not None:
        variances = linear.variance[:, 0]
        gain = jax.lax.stop_gradient(jnp.swapaxes(found.gain, 1, 2))
        left = jnp.sum(linear.slope * gain, axis=(1, 2)) * variances
        steady = settled(at.velocity, left, variances, used)
    new = State(
        at,
        linear.intervals.q_n0n,
        state.unknowns + jnp.where(constant, error[0, STATES:], 0.0),
        weight,
        jnp.where(early, judged, mean),
        jnp.where(early, 1.0, times),
        steady,
        early & (moved > _NEAR),
        state.moving & (early | state.early | (moved > model.tolerance) | (changed > model.tolerance)),
    )
    new = jax.tree.map(lambda a, b: jnp.where(state.moving, a, b), new, state)
    if state.settled is not None:
        last = jnp.where(final, 0.0, last)
    return new, _read(model, problem, state, linear, found, last, _at(problem, noise))


def _at(problem: Problem, x: Any) -> Any:
    """The values (K, ..., L) of a tree at the last epoch that counts."""

    def one(x: Array) -> Array:
        index = problem.last.reshape(1, *[1] * (x.ndim - 2), -1)
        return jnp.take_along_axis(x, jnp.broadcast_to(index, (1, *x.shape[1:])), axis=0)[0]

    return jax.tree.map(one, x)


def _read(
    model: Model, problem: Problem, state: State, linear: LinearProblem, found: Filtered, error: Any, noise: Any
) -> Readout:
    """The solution from the last errors and the last noise; its covariance and likelihood from the filter."""
    at, q_n0n, used, weight = _at(problem, (state.at, linear.intervals.q_n0n, problem.used, state.weight))
    covariance = found.covariance
    q_n0b = (by_tilt(Vec3(*error[TILT])) * at.attitude).unit()
    q = (q_n0n.conjugate() * q_n0b).unit()
    turn = q_n0n.matrix
    turn = jnp.stack([jnp.stack([r.x, r.y, r.z]) for r in (turn.r0, turn.r1, turn.r2)])
    tilt = covariance[TILT, TILT]
    half = jnp.sum(tilt[:, :, None] * turn[None], axis=1)
    tilt = jnp.sum(turn[:, :, None] * half[:, None], axis=0)
    odds = outlier_odds(state.weight, problem.used, model.outliers, model.spread)
    # The first velocity is free: its prior, which follows the noise found, is taken out.
    likelihood = found.log_likelihood + 0.5 * jnp.sum(jnp.log(linear.prior.variance[VELOCITY]), axis=0) + odds
    return Readout(
        jnp.stack([q.w, q.x, q.y, q.z]),
        tilt,
        jnp.stack([at.gyro.x, at.gyro.y, at.gyro.z]) + error[GYRO],
        jnp.stack([at.accel.x, at.accel.y, at.accel.z]) + error[ACCEL],
        state.unknowns + error[STATES:],
        covariance,
        likelihood,
        noise,
        jnp.where(used, weight, 0.0),
        jnp.sqrt(state.variance * state.times),
    )
