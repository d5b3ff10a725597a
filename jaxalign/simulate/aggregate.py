"""Sensor noise per interval instead of per IMU sample: the same distribution to first order, far cheaper.

White noise of the samples enters the increments of an interval linearly (to first order in the noise: 5e-8 rad after
300 s), so its sum is one six-dimensional Gaussian per interval, whose covariance the truth fixes. With R_j the attitude
at the middle of sample j, V_j = R_j dv_j its velocity increment in b at the start of the interval, and
W_j = sum_{i>j} V_i + V_j / 2 what comes after it, errors e_j, a_j of its increments give

    d(rotation) = sum R_j e_j
    d(velocity) = sum R_j a_j - sum W_j x R_j e_j

Not for what looks at single samples: prefilters, vectors at IMU rate, a disturbance that is not white, faults of the
unit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign.aids import AbstractAid, Standing
from jaxalign.epochs import Epoch, Epochs, Fix
from jaxalign.errors import UserError
from jaxalign.inertial_unit import AbstractTriadErrors
from jaxalign.preintegration import Increment, integrated, paired, preintegrate
from jaxalign.simulate.imu import Truth
from jaxalign.simulate.measurement import Scenario, aid_values, source_keys
from jaxalign.simulate.moments import covariance, moments_of, root, step_sd, turns
from jaxalign.simulate.random import blocks, each, fold, normals
from jaxalign.simulate.sensors import WANDER, draw_bias
from jaxalign.vector import Quat, Vec3

__all__ = ["Intervals", "fixes_of", "intervals_of", "measure_epochs", "observed", "sample_epochs"]

_PIECE = 24  # pairs of samples whose noise is drawn at a time
_LEAST_HZ = 50.0  # from here on two samples turn by less than a radian, at 1400 deg/s


class Intervals(eqx.Module):
    """A truth, preintegrated, and how errors of its samples enter: leaves with a first axis of M intervals.

    Attributes:
        rotation: from b at the end to b at the start.
        dvel: velocity increments, m/s.
        turned: (M, 3, 3) sum of R_j: d(rotation) by a constant error of the samples' rotations.
        moved: (M, 3, 3) sum of [W_j x] R_j: minus d(velocity) by the same, m/s.
        lever: mean of W_j, m/s.
        scatter: (M, 3, 3) sum of |U|^2 I - U U^T over the samples, U_j = W_j - lever.
        truth: it.
        samples: per interval.
    """

    rotation: Quat
    dvel: Vec3
    turned: Float[Array, "m 3 3"]
    moved: Float[Array, "m 3 3"]
    lever: Vec3
    scatter: Float[Array, "m 3 3"]
    truth: Truth
    samples: int = eqx.field(static=True)


@eqx.filter_jit
def intervals_of(truth: Truth, samples: int) -> Intervals:
    """Preintegrate a truth (once) over intervals of so many samples."""
    r, w = turns(truth, samples)
    lever = jnp.mean(w, 0)
    u = w - lever
    scatter = jnp.sum(u * u, (0, 2))[:, None, None] * jnp.eye(3) - jnp.einsum("sma,smb->mab", u, u)
    whole = preintegrate(truth.dtheta, truth.dvel, samples)
    moved = jnp.sum(jnp.cross(w[..., None, :], r.swapaxes(-1, -2)), 0).swapaxes(-1, -2)
    return Intervals(whole.rotation, whole.dvel, jnp.sum(r, 0), moved, Vec3.of(lever), scatter, truth, samples)


def measure_epochs(
    intervals: Intervals, scenario: Scenario, key: PRNGKeyArray, aids: tuple[AbstractAid, ...] | None = None
) -> Epochs:
    """Epochs of one run: noise drawn per interval, biases, aid and faults those of :func:`measure` with the same key.

    Pure: `jit` it with the intervals and the scenario as arguments.

    Args:
        intervals: the truth, preintegrated.
        scenario: of that truth.
        key: of a run; or (runs,) of them, which is several times faster than `vmap`: the leaves of ``rows`` but ``dt``
            then have the runs on their last axis.
        aids: that the epochs hold; None: all of the scenario, or that of a vehicle that stands.

    Raises:
        UserError: the scenario has a disturbance of the force, which is not white, or faults of the inertial unit.
    """
    if scenario.force is not None:
        raise UserError("a disturbed base needs noise at IMU rate: fidelity 'samples'")
    if scenario.imu_faults:
        raise UserError("faults of the inertial unit act on single IMU samples: fidelity 'samples', or use measure")
    dt, n, runs = intervals.truth.dt, intervals.samples, key.shape
    count = intervals.dvel.x.shape[0]

    every = _every(runs)
    gyro_key, accel_key, *_ = source_keys(key)
    imu = scenario.imu
    gyro, accel = (
        each(lambda k, e=e: draw_bias(e, scenario.bias, jax.random.split(k)[0]) * dt, source)
        for e, source in ((imu.gyro, gyro_key), (imu.accel, accel_key))
    )
    z = normals(fold(gyro_key, 1), 6 * count).astype(jnp.float64).reshape(6, count, *runs)
    tilt, speed, gyro, accel = (_alike if imu.alike else _apart)(intervals, scenario, key, z, gyro, accel)
    tilt = tilt + _times(every(intervals.turned), gyro)
    speed = speed + _times(every(intervals.turned), accel) - _times(every(intervals.moved), gyro)
    moved = Increment(Quat.turn(tilt) * every(intervals.rotation), every(intervals.dvel) + speed)
    return _epochs(moved, intervals.truth, scenario, key, n, aids)


def _every(runs: tuple[int, ...]) -> Callable[[Any], Any]:
    """What all runs have in common, with their axis."""
    return lambda tree: jax.tree.map(lambda x: x.reshape(*x.shape, *(1 for _ in runs)), tree)


def _alike(
    intervals: Intervals, scenario: Scenario, key: PRNGKeyArray, z: Array, gyro: Array, accel: Array
) -> tuple[Vec3, Vec3, Array, Array]:
    """White noise of each interval (rotation, velocity) of a unit with constant biases and one noise for all axes.

    Args:
        intervals: the truth.
        scenario: of it.
        key: of the runs.
        z: (6, M, *runs) unit normals.
        gyro: (3, *runs) what the biases add to each increment, rad.
        accel: likewise, m/s.

    Returns:
        Noise, and what the biases add to each increment of an interval.
    """
    dt, n, every = intervals.truth.dt, intervals.samples, _every(key.shape)
    sd_gyro, sd_accel = scenario.imu.gyro.increment_sd(dt), scenario.imu.accel.increment_sd(dt)
    tilt = Vec3(z[0], z[1], z[2]) * (sd_gyro * jnp.sqrt(float(n)))
    factor = every(root(intervals.scatter * sd_gyro**2 + n * sd_accel**2 * jnp.eye(3)))
    speed = Vec3(
        factor[0][0] * z[3],
        factor[1][0] * z[3] + factor[1][1] * z[4],
        factor[2][0] * z[3] + factor[2][1] * z[4] + factor[2][2] * z[5],
    )
    return tilt, speed - every(intervals.lever).cross(tilt), gyro, accel


def _apart(
    intervals: Intervals, scenario: Scenario, key: PRNGKeyArray, z: Array, gyro: Array, accel: Array
) -> tuple[Vec3, Vec3, Array, Array]:
    """What :func:`_alike` gives, for any unit: noise that differs between the axes, biases that wander.

    The biases that it returns have shape (3, M, *runs) where they wander: those at the start of each interval.
    """
    dt, n, every = intervals.truth.dt, intervals.samples, _every(key.shape)
    moments = moments_of(intervals.truth, n)
    factor = every(root(covariance(moments, scenario.imu, dt)))
    noise = [sum((row[k] * z[k] for k in range(1, len(row))), row[0] * z[0]) for row in factor]
    tilt, speed = Vec3(*noise[:3]), Vec3(*noise[3:])
    onto_tilt, onto_speed = every(moments.ramp[:, :3]), every(moments.ramp[:, 3:])
    gyro_key, accel_key, *_ = source_keys(key)
    steps = [
        _steps(errors, source, len(moments.ramp), n, dt)
        for errors, source in ((scenario.imu.gyro, gyro_key), (scenario.imu.accel, accel_key))
    ]
    if steps[0] is not None:
        tilt, speed = tilt + _times(onto_tilt, steps[0]), speed + _times(onto_speed, steps[0])
    if steps[1] is not None:
        speed = speed + _times(onto_tilt, steps[1])
    gyro, accel = (
        bias if step is None else bias[:, None] + jnp.cumsum(step, axis=1) - step
        for bias, step in zip((gyro, accel), steps, strict=True)
    )
    return tilt, speed, gyro, accel


def _steps(errors: AbstractTriadErrors, key: PRNGKeyArray, count: int, samples: int, dt: Any) -> Array | None:
    """(3, M, *runs) what the bias has moved at the end of each interval, as the error of an increment, rad or m/s."""
    step = step_sd(errors, dt)
    if step is None:
        return None
    z = normals(fold(key, WANDER), 3 * count).astype(jnp.float64).reshape(3, count, *key.shape)
    return z * (step * jnp.sqrt(float(samples))).reshape(3, *(1 for _ in z.shape[1:]))


def sample_epochs(
    truth: Truth,
    scenario: Scenario,
    key: PRNGKeyArray,
    samples: int,
    aids: tuple[AbstractAid, ...] | None = None,
) -> Epochs:
    """Epochs of the runs with these keys, the noise per IMU sample: those of :func:`measure` with the same keys.

    Interval by interval, so that the samples are never held: as :func:`measure` and a preintegration would have it, but
    for rounding, and several times faster for many runs. Pure.

    Args:
        truth: perfect samples.
        scenario: of that truth.
        key: of a run, or (runs,) of them, as in :func:`measure_epochs`.
        samples: per interval, at least two.
        aids: as in :func:`measure_epochs`.

    Raises:
        UserError: the scenario has a disturbance of the force or faults of the inertial unit.
    """
    if scenario.force is not None or scenario.imu_faults:
        what = "a disturbed base is" if scenario.force is not None else "faults of the inertial unit are"
        raise UserError(f"{what} measured sample by sample: use measure")
    count, dt = truth.dtheta.shape[0] // samples, truth.dt
    sources: list[tuple[Array, PRNGKeyArray, Any]] = []
    imu, kind, runs = scenario.imu, scenario.bias, key.shape
    triads = tuple(zip((imu.gyro, imu.accel), source_keys(key), strict=False))
    for errors, source in triads:
        halves = [each(lambda k, i=i: jax.random.key_data(jax.random.split(k)[i]), source) for i in (0, 1)]
        bias_key, noise_key = (jax.random.wrap_key_data(jnp.moveaxis(x, 0, -1)) for x in halves)
        bias = each(lambda k, errors=errors: draw_bias(errors, kind, k), bias_key) * dt
        sources.append((bias, noise_key, jnp.broadcast_to(errors.increment_sd(dt), (3,))))

    terms = 8 if scenario.imu_rate >= _LEAST_HZ else 14

    def interval(walked: Any, row: tuple[Array, Array, Array]) -> tuple[Any, Increment]:
        start, *exact = row
        pairs = [_wandering(x, *w, start, dt) for x, w in zip(exact, zip(triads, walked, strict=True), strict=True)]
        exact, walked = zip(*pairs, strict=True)
        if samples % 2:
            measured = (_measured(x, *source, start) for x, source in zip(exact, sources, strict=True))
            return walked, integrated(*measured)
        th, dv = (_measured_pairs(x, *source, start // 2) for x, source in zip(exact, sources, strict=True))
        return walked, paired(th[0], dv[0], th[1], dv[1], terms)

    th, dv = (x[: count * samples].reshape(count, samples, 3) for x in (truth.dtheta, truth.dvel))
    starts = 3 * samples * jnp.arange(count, dtype=jnp.uint32)
    still = tuple(None if errors.bias_walk is None else jnp.zeros((3, *runs)) for errors, _ in triads)
    return _epochs(jax.lax.scan(interval, still, (starts, th, dv))[1], truth, scenario, key, samples, aids)


def _wandering(
    exact: Array, triad: tuple[AbstractTriadErrors, PRNGKeyArray], walked: Any, start: Array, dt: Any
) -> tuple[Array, Any]:
    """Samples (samples, 3, *runs) of an interval with what the bias has moved since the start of the run.

    Args:
        exact: (samples, 3).
        triad: its errors, and keys.
        walked: (3, *runs) before the interval; None: the bias is constant.
        start: the first number of the steps.
        dt: of a sample, s.

    Returns:
        They, and ``walked`` after the interval.
    """
    errors, key = triad
    step, shape = step_sd(errors, dt), exact.shape
    exact = exact.reshape(*shape, *(1 for _ in key.shape))
    if step is None:
        return exact, walked
    z = normals(fold(key, WANDER), 3 * len(exact), start).astype(jnp.float64).reshape(*shape, *key.shape)
    steps = z * step.reshape(3, *(1 for _ in key.shape))
    total = jnp.cumsum(steps, axis=0)
    return exact + walked + total - steps, walked + total[-1]


def _measured(exact: Array, bias: Array, key: PRNGKeyArray, sd: Any, start: Array) -> Vec3:
    """Samples (samples, 3, *runs) of an interval with their errors; `start`: the first number of their noise."""
    z = normals(key, 3 * len(exact), start).astype(jnp.float64).reshape(*exact.shape[:2], *key.shape)
    return _spoiled(exact, bias, (z[:, 0], z[:, 1], z[:, 2]), sd)


def _measured_pairs(exact: Array, bias: Array, key: PRNGKeyArray, sd: Any, start: Array) -> tuple[Vec3, Vec3]:
    """Samples with errors as the first and second of pairs, whose noise is three blocks; `start`: of the first."""
    pairs = len(exact) // 2
    piece = max(d for d in range(1, min(max(pairs // 2, 1), _PIECE) + 1) if pairs % d == 0)
    starts = start + 3 * piece * jnp.arange(pairs // piece, dtype=jnp.uint32)
    z = jax.lax.map(lambda at: blocks(key, 3 * piece, at), starts).reshape(pairs, 3, *key.shape)
    one, two = z.real, z.imag
    return (
        _spoiled(exact[0::2], bias, (one[:, 0], two[:, 0], one[:, 1]), sd),
        _spoiled(exact[1::2], bias, (two[:, 1], one[:, 2], two[:, 2]), sd),
    )


def _spoiled(exact: Array, bias: Array, noise: tuple[Array, Array, Array], sd: Any) -> Vec3:
    """Samples (n, 3, *runs) plus bias and white noise of each run: components (n, *runs)."""
    return Vec3(*(exact[:, i] + bias[i] + noise[i] * sd[i] for i in range(3)))


def _epochs(
    moved: Increment,
    truth: Truth,
    scenario: Scenario,
    key: PRNGKeyArray,
    samples: int,
    aids: tuple[AbstractAid, ...] | None,
) -> Epochs:
    """With an epoch at the start, and the aids."""
    count = moved.dvel.x.shape[0]
    still = jax.tree.map(lambda x: jnp.zeros((1, *key.shape)) + x, Increment(Quat.identity(), Vec3.zero()))
    rows = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), still, moved)
    steps = jnp.concatenate([jnp.zeros(1), jnp.full(count, samples * truth.dt)])
    chosen = observed(scenario, aids)
    fixes = fixes_of(truth, scenario, key, samples, count, chosen)
    density = scenario.imu.at_rate(scenario.imu_rate).accel.density  # of a standing vehicle: of the force
    force = jnp.sqrt(jnp.mean(jnp.square(density)) * samples * truth.dt)
    sd = tuple(force if aid.implied else scenario.aids[number].sd for aid, number in chosen)
    rows = Epoch(rows.rotation, rows.dvel, steps, fixes)
    return Epochs(rows, scenario.site, sd, tuple(aid for aid, _ in chosen))


def observed(scenario: Scenario, aids: tuple[AbstractAid, ...] | None) -> tuple[tuple[AbstractAid, int], ...]:
    """Aids that are asked for, and their numbers in a scenario (-1: an assumption); None: all that there are.

    Raises:
        UserError: the scenario has no such aid.
    """
    if aids is None:
        return tuple((one.aid, i) for i, one in enumerate(scenario.aids)) or ((Standing(), -1),)
    out = []
    for aid in aids:
        alike = [i for i, one in enumerate(scenario.aids) if type(one.aid) is type(aid)]
        named = [i for i in alike if scenario.aids[i].aid.name == aid.name]
        found = named or (alike if len(alike) == 1 else [])
        if not found and not aid.implied:
            there = ", ".join(one.aid.name for one in scenario.aids) or "no aid: the vehicle stands"
            raise UserError(f"{scenario.name} has no {aid.name} ({aid.described}), which is observed: it has {there}")
        out.append((aid, -1) if aid.implied else (scenario.aids[found[0]].aid, found[0]))
    return tuple(out)


def fixes_of(
    truth: Truth,
    scenario: Scenario,
    key: PRNGKeyArray,
    samples: int,
    count: int,
    chosen: tuple[tuple[AbstractAid, int], ...],
) -> tuple[Fix, ...]:
    """What the aids measure at epochs of so many samples, of one run or many."""
    numbers = tuple(number for _, number in chosen if number >= 0)
    values = dict(zip(numbers, aid_values(truth, scenario, key, numbers), strict=True))
    out = []
    for aid, number in chosen:
        if number < 0:
            zero = jnp.zeros((count + 1, *key.shape))
            out.append(Fix((zero,) * len(aid.components), jnp.ones((count + 1, *key.shape), bool)))
            continue
        value, ratio = values[number], scenario.epoch_samples // samples
        if ratio > 1:  # epochs between two fixes have no aid
            value = jnp.full((count + 1, *value.shape[1:]), jnp.nan).at[::ratio].set(value)
        out.append(Fix.of(jnp.moveaxis(value, 1, -1), scenario.aids[number].partial))
    return tuple(out)


def _times(m: Float[Array, "m 3 3 ..."], v: Float[Array, "3 ..."]) -> Vec3:
    """Matrix of each interval times vector of each run."""
    return Vec3(*(m[:, i, 0] * v[0] + m[:, i, 1] * v[1] + m[:, i, 2] * v[2] for i in range(3)))
