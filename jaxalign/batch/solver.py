"""The batch estimator as one step that is repeated: linearise, filter, smooth, weigh the fixes again.

The step is the same for each round and for the read-out.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.batch.measurement import first_velocity, linearize, parts_of, steady_aid, turn_to_n0
from jaxalign.batch.pool import Pool
from jaxalign.batch.problem import LEAST_SD, AidNoise, Model, Problem, Readout, State
from jaxalign.batch.reweight import estimate_noise, median_variance, outlier_odds, steady_velocities, weigh
from jaxalign.batch.smoother import Filtered, LinearProblem, Prior, Process, cross_rows, times
from jaxalign.batch.solve import solve_linear
from jaxalign.batch.start import IntegratedVectors, misfit, robust_start
from jaxalign.batch.trajectory import (
    ACCEL,
    GYRO,
    STATES,
    TILT,
    UNKNOWN,
    VELOCITY,
    Intervals,
    NominalTrajectory,
    by_tilt,
    mechanize,
)
from jaxalign.inertial_unit import ImuErrors, by_axis
from jaxalign.vector import Quat, Vec3

__all__ = ["advance", "initial_state", "linearize_problem", "motion_noise", "prior_of", "step", "with_steady"]

_FREE = 1e3  # times the noise of a fix: nothing is known of the first velocity, and nothing lost to rounding
_LEAST = 1e-12  # weight
_KNOWN = 1e-30  # variance of what is known: nothing beside any other, and a step has something to be measured by
_FASTEST = 1e3  # m/s, where no aid tells a velocity
_NEAR = 1e-2  # standard deviations that a step moves a solution that is near


def initial_state(model: Model, problem: Problem, pool: Pool, seen: IntegratedVectors) -> State:
    """From the attitude that needs no guess, by the fixes that count. Not differentiated."""
    on = problem.on
    used, lanes = problem.used, on.shape[1]
    vectors = jax.tree.map(lambda x: jnp.broadcast_to(x, (x.shape[0], lanes)), seen)
    valid = pool.valid & on

    start, _, _ = robust_start(vectors.alpha, vectors.beta, valid, LEAST_SD, pool.axes)
    off = misfit(vectors.alpha, vectors.beta, start, pool.axes)
    off = jnp.stack([off.x, off.y, off.z], axis=1)
    noise = []
    for number, (stated, _) in enumerate(problem.deviations):
        if number in pool.members:
            variance = median_variance(off, valid, stated)
            _, weight = weigh(off, variance, valid, model.outlier_probability, model.outlier_ratio)
            weight = jnp.where(valid, weight, used[number] * 1.0)
        else:
            variance, weight = jnp.broadcast_to(stated**2, (lanes,)), used[number] * 1.0
        noise.append(AidNoise(weight, variance, jnp.ones(lanes)))
    at = vectors.trajectory(start)
    steady = None if steady_aid(model.aids) is None else at.velocity
    yes = jnp.ones(lanes, bool)
    state = State(at, vectors.q_n0n, jnp.zeros((len(model.sd), lanes)), tuple(noise), steady, yes, yes)
    return jax.lax.stop_gradient(state)


def prior_of(model: Model, problem: Problem, state: State) -> Prior:
    """Errors of the first epoch, by what is known beforehand."""
    lanes = state.moving.shape
    free = 0.0
    for aid, (stated, _), noise in zip(model.aids, problem.deviations, state.noise, strict=True):
        if aid.measures_velocity:
            free = jnp.maximum(free, jnp.maximum(stated**2, jax.lax.stop_gradient(noise.variance)))
    free = _FREE * jnp.sqrt(free) if any(aid.measures_velocity for aid in model.aids) else _FASTEST
    gyro, accel = (jnp.stack([b.x[0], b.y[0], b.z[0]]) for b in (state.at.gyro, state.at.accel))
    blocks = (UNKNOWN, free, by_axis(model.imu.gyro.bias), by_axis(model.imu.accel.bias))
    sd = [jnp.broadcast_to(jnp.asarray(x), (3, *lanes)) for x in blocks]
    unknown = model.sd if model.sd.ndim > 1 else model.sd[:, None]
    sd.append(jnp.broadcast_to(unknown, state.unknowns.shape))
    mean = jnp.concatenate([jnp.zeros((6, *lanes)), model.gyro_mean - gyro, -accel, -state.unknowns])
    return Prior(mean, jnp.concatenate(sd) ** 2 + _KNOWN)


def _wander(model: Model, dt: Any) -> Array:
    """(K, 6, L) variance that the biases gain in an interval."""
    walks = (model.imu.gyro.bias_walk, model.imu.accel.bias_walk)
    gained = [
        jnp.zeros((len(dt), 3, dt.shape[1])) if x is None else (by_axis(x) ** 2 * jnp.ones((3, 1))) * dt[:, None]
        for x in walks
    ]
    return jnp.concatenate(gained, axis=1)


def motion_noise(imu: ImuErrors, intervals: Intervals) -> Array:
    """(K, 6, 6, L) covariance of what the white noise of the unit does to tilt and velocity, n0."""
    dt, d = intervals.dt, intervals.gained
    densities = [by_axis(triad.density) for triad in (imu.gyro, imu.accel)]
    unit = jnp.eye(3)[:, :, None]
    zero = jnp.zeros_like(dt)
    skew = jnp.stack([zero, -d[:, 2], d[:, 1], d[:, 2], zero, -d[:, 0], -d[:, 1], d[:, 0], zero], axis=1)
    skew = skew.reshape(len(dt), 3, 3, -1)
    if all(len(x) == 1 for x in densities):  # one number for the three axes: the same for every attitude
        gyro, accel = ((x**2 * dt)[:, None, None] for x in densities)
        across = -0.5 * gyro * skew
        square = jnp.sum(d * d, axis=1)[:, None, None] * unit - d[:, :, None] * d[:, None]
        velocity = gyro / 3.0 * square + accel * unit
        tilt = gyro * unit
    else:
        axes = intervals.turned / jnp.where(dt > 0, jnp.sqrt(dt), 1.0)[:, None, None]
        tilt, push = (_product(axes * x**2, jnp.swapaxes(axes, 1, 2)) for x in densities)
        moment = _product(skew, tilt)
        across = -0.5 * moment
        velocity = _product(moment, jnp.swapaxes(skew, 1, 2)) / 3.0 + push
    return jnp.concatenate(
        [jnp.concatenate([tilt, jnp.swapaxes(across, 1, 2)], axis=2), jnp.concatenate([across, velocity], axis=2)],
        axis=1,
    )


def _product(a: Any, b: Any) -> Array:
    """Of matrices (K, 3, 3, L): sums that fuse."""
    return jnp.sum(a[:, :, :, None] * b[:, None], axis=2)


def _process(model: Model, intervals: Intervals) -> Process:
    """White noise of an interval, of the unit, of the biases that wander and of what renews itself."""
    dt = intervals.dt
    fade = jnp.exp(-dt[:, None] / model.fade_s[:, None])
    unknown = model.sd if model.sd.ndim > 1 else model.sd[:, None]
    renewed = unknown**2 * (1.0 - fade**2)
    return Process(motion_noise(model.imu, intervals), jnp.concatenate([_wander(model, dt), renewed], axis=1), fade)


def linearize_problem(model: Model, problem: Problem, state: State) -> LinearProblem:
    """The errors of the trajectory and the fixes that measure them."""
    on = problem.on
    intervals = mechanize(problem.rows, problem.site, state.at, state.q_n0n, on, problem.length)
    found = linearize(
        model.aids,
        model.unknown,
        problem.rows.fixes,
        state.at,
        intervals.q_n0n,
        intervals.dt,
        on,
        state.unknowns,
        state.steady,
    )
    return LinearProblem(
        intervals,
        _process(model, intervals),
        found.gap,
        found.slope,
        _variances(model, problem, state),
        found.known,
        prior_of(model, problem, state),
        problem.length,
    )


def _variances(model: Model, problem: Problem, state: State) -> Float[Array, "K m L"]:
    """Of the noise of each component, by what is thought of its fix."""
    variance = []
    for aid, (_, ratio), noise, used in zip(model.aids, problem.deviations, state.noise, problem.used, strict=True):
        each = noise.whole / jnp.where(used, jnp.maximum(noise.weight, _LEAST), 1.0)
        shape = (len(each), len(aid.components), each.shape[1])
        variance.append(jnp.broadcast_to(each[:, None] * ratio, shape))
    return jnp.concatenate(variance, axis=1)


def step(model: Model, problem: Problem, state: State, late: Any, final: Any) -> tuple[State, Readout]:
    """One Gauss-Newton step, and the solution by the linear problem that it starts from.

    With a velocity in n the final step tells the covariance alone, with velocities that have settled: the solution is
    the trajectory that it starts from.

    Args:
        model: what is known.
        problem: fixes.
        state: from the step before.
        late: no trajectory is taken as far off any more.
        final: it is read out after this one.
    """
    state = with_steady(state, final)
    return advance(model, problem, state, linearize_problem(model, problem, state), late, final)


def with_steady(state: State, final: Any) -> State:
    """With the velocities at which slopes are taken: those of the trajectory, but for the step that is read out."""
    if state.steady is None:
        return state
    steady = jax.tree.map(lambda a, b: jnp.where(final, a, b), state.steady, state.at.velocity)
    return dataclasses.replace(state, steady=steady)


def advance(
    model: Model, problem: Problem, state: State, linear: LinearProblem, late: Any, final: Any
) -> tuple[State, Readout]:
    """A step from its linear problem, see :func:`step`."""
    found, error, noise = solve_linear(linear)
    early = state.early & jnp.logical_not(late)
    judged = _judged(model, problem, state, noise, early)
    own = jnp.stack([found.covariance[i, i] for i in range(STATES)])
    last = _at(problem, error)
    moved = jax.lax.stop_gradient(jnp.max(jnp.abs(last[:STATES]) / jnp.sqrt(own), axis=0))
    changed = jnp.zeros_like(moved)
    for (_, mean, often, _), before in zip(judged, state.noise, strict=True):
        changed = jnp.maximum(changed, jax.lax.stop_gradient(jnp.abs(mean * often / before.whole - 1.0)))
    constant = jnp.isinf(model.fade_s)[:, None]
    at = state.at.moved(error)
    new = State(
        at,
        linear.intervals.q_n0n,
        state.unknowns + jnp.where(constant, error[0, STATES:], 0.0),
        tuple(
            AidNoise(weight, jnp.where(early, median, mean), jnp.where(early, 1.0, often))
            for weight, mean, often, median in judged
        ),
        _steady(model, problem, state, linear, found, at),
        early & (moved > _NEAR),
        state.moving & (early | state.early | (moved > model.tolerance) | (changed > model.tolerance)),
    )
    new = jax.tree.map(lambda a, b: jnp.where(state.moving, a, b), new, state)
    if state.steady is not None:
        last = jnp.where(final, 0.0, last)
    return new, _read(model, problem, state, linear, found, last, _at(problem, noise))


def _judged(model: Model, problem: Problem, state: State, noise: Any, early: Any) -> list[tuple[Any, Any, Any, Any]]:
    """Of each aid the weights of its fixes, the variance of its noise, how often it counts, and the early variance.

    What has been fitted is shared among the aids by how much they measure.
    """
    total = sum(jnp.sum(used, axis=0) * len(aid.components) for aid, used in zip(model.aids, problem.used, strict=True))
    out = []
    of_aids = zip(
        model.aids, parts_of(model.aids), problem.deviations, problem.used, problem.counts, state.noise, strict=True
    )
    for number, (aid, part, (stated, ratio), used, count, before) in enumerate(of_aids):
        own = noise[:, part] if isinstance(ratio, float) else noise[:, part] / jnp.sqrt(ratio)
        share = 1.0
        if len(model.aids) > 1:
            share = jnp.sum(used, axis=0) * len(aid.components) / jnp.maximum(total, 1)
        median = jax.lax.cond(
            jnp.any(early),
            lambda own=own, used=used, stated=stated, count=count: median_variance(own, used, stated, count),
            lambda before=before: before.variance,
        )
        judged = jnp.where(early, median, before.variance)
        good, weight = weigh(own, judged, used, model.outlier_probability, model.outlier_ratio, count)
        if model.aid_noise == "held":
            mean, times = model.held[number], jnp.ones_like(before.variance)
        else:
            mean, times = estimate_noise(own, good, stated, model.aid_noise, count, share)
        out.append((weight, mean, times, judged))
    return out


def _steady(
    model: Model, problem: Problem, state: State, linear: LinearProblem, found: Filtered, at: NominalTrajectory
) -> Any:
    """The velocities of a trajectory without noise, by what the fixes of an aid in n leave of it."""
    number = steady_aid(model.aids)
    if state.steady is None or number is None:
        return None
    part = parts_of(model.aids)[number]
    gain = jax.lax.stop_gradient(jnp.swapaxes(found.gain[:, :, part], 1, 2))
    variances = linear.variance[:, part.start]
    left = jnp.sum(linear.slope[:, part] * gain, axis=(1, 2)) * variances
    return steady_velocities(at.velocity, left, variances, problem.used[number])


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
    at, q_n0n, weights = _at(
        problem,
        (
            state.at,
            linear.intervals.q_n0n,
            tuple(jnp.where(used, one.weight, 0.0) for used, one in zip(problem.used, state.noise, strict=True)),
        ),
    )
    q_n0b = (by_tilt(Vec3(*error[TILT])) * at.attitude).unit()
    q = (q_n0n.conjugate() * q_n0b).unit()
    v = q_n0n.conjugate().rotate(at.velocity + Vec3(*error[VELOCITY]))
    way = _displacement(problem, linear, state.at)
    covariance = _joint(problem, state, found.covariance, q_n0n)
    odds = sum(
        outlier_odds(one.weight, used, model.outlier_probability, model.outlier_ratio)
        for one, used in zip(state.noise, problem.used, strict=True)
    )
    # The first velocity is free: its prior, which follows the noise found, is taken out.
    likelihood = found.log_likelihood + 0.5 * jnp.sum(jnp.log(linear.prior.variance[VELOCITY]), axis=0) + odds
    parts, first = tuple(noise[part] for part in parts_of(model.aids)), first_velocity(model.aids)
    return Readout(
        jnp.stack([q.w, q.x, q.y, q.z]),
        covariance[TILT, TILT],
        jnp.stack([at.gyro.x, at.gyro.y, at.gyro.z]) + error[GYRO],
        jnp.stack([at.accel.x, at.accel.y, at.accel.z]) + error[ACCEL],
        jnp.stack([v.x, v.y, v.z]),
        state.unknowns + error[STATES:],
        way,
        covariance,
        likelihood,
        parts,
        turn_to_n0(model.aids[first], parts[first], q_n0b, q_n0n),
        weights,
        tuple(jnp.sqrt(one.whole) for one in state.noise),
    )


def _displacement(problem: Problem, linear: LinearProblem, at: NominalTrajectory) -> Float[Array, "3 L"]:
    """Integral of the velocity in n up to the last epoch, by trapezoids."""
    v, dt = linear.intervals.q_n0n.conjugate().rotate(at.velocity), linear.intervals.dt

    def total(x: Any) -> Any:
        return jnp.sum(0.5 * (x[1:] + x[:-1]) * dt[1:], axis=0)

    return jnp.stack([total(v.x), total(v.y), total(v.z)])


def _joint(problem: Problem, state: State, covariance: Any, q_n0n: Quat) -> Float[Array, "n n L"]:
    """The covariance of errors in n0 (truth less nominal) as that of errors in n of the estimate.

    Where velocities have settled, the errors of the velocity are told from the turning of the rest: it is put back.
    """
    m = q_n0n.conjugate().matrix
    back = jnp.stack([jnp.stack([r.x, r.y, r.z]) for r in (m.r0, m.r1, m.r2)])
    rest = None
    if state.steady is not None:
        rest = _at(problem, state.at.velocity - state.steady)
        rest = jnp.stack([rest.x, rest.y, rest.z])

    def rows(p: Any) -> Any:
        tilt, velocity = p[TILT], p[VELOCITY]
        if rest is not None:
            velocity = velocity + cross_rows(rest, tilt)
        return jnp.concatenate([times(back, tilt), -times(back, velocity), -p[VELOCITY.stop :]])

    return rows(jnp.swapaxes(rows(covariance), 0, 1))
