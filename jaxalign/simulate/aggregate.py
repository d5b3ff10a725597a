"""Sensor noise per interval instead of per IMU sample: the same distribution to first order, far cheaper.

White noise of the samples enters the increments of an interval linearly (to first order in the noise: 5e-8 rad after
300 s), so its sum is one six-dimensional Gaussian per interval, whose covariance the truth fixes. With R_j the attitude
at the middle of sample j, V_j = R_j dv_j its velocity increment in b at the start of the interval, and
W_j = sum_{i>j} V_i + V_j / 2 what comes after it, errors e_j, a_j of its increments give

    d(rotation) = sum R_j e_j
    d(velocity) = sum R_j a_j - sum W_j x R_j e_j

Not for what looks at single samples: prefilters, vectors at IMU rate, a disturbance that is not white.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign.epochs import Epoch, Epochs
from jaxalign.errors import UserError
from jaxalign.preintegration import Increment, integrated, paired, preintegrate
from jaxalign.simulate.imu import Truth
from jaxalign.simulate.measurement import Scenario, aid_velocity, source_keys
from jaxalign.simulate.random import blocks, each, fold, normals
from jaxalign.vector import Quat, Vec3

__all__ = ["Intervals", "intervals_of", "measure_epochs", "sample_epochs"]

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
    count = truth.dtheta.shape[0] // samples
    th, dv = (x[: count * samples].reshape(count, samples, 3).swapaxes(0, 1) for x in (truth.dtheta, truth.dvel))

    def turn(q: Quat, half: Quat) -> tuple[Quat, Quat]:
        middle = q * half
        return (middle * half).renormalised(), middle

    start = jax.tree.map(lambda x: jnp.broadcast_to(x, (count,)), Quat.identity())
    middle = jax.lax.scan(turn, start, Quat.turn(Vec3.of(th) * 0.5))[1]
    r = middle.matrix.array  # (samples, M, 3, 3)
    v = middle.rotate(Vec3.of(dv)).array
    w = jnp.sum(v, 0) - jnp.cumsum(v, 0) + 0.5 * v
    lever = jnp.mean(w, 0)
    u = w - lever
    scatter = jnp.sum(u * u, (0, 2))[:, None, None] * jnp.eye(3) - jnp.einsum("sma,smb->mab", u, u)
    whole = preintegrate(truth.dtheta, truth.dvel, samples)
    moved = jnp.sum(jnp.cross(w[..., None, :], r.swapaxes(-1, -2)), 0).swapaxes(-1, -2)
    return Intervals(whole.rotation, whole.dvel, jnp.sum(r, 0), moved, Vec3.of(lever), scatter, truth, samples)


def measure_epochs(intervals: Intervals, scenario: Scenario, key: PRNGKeyArray) -> Epochs:
    """Epochs of one run: noise drawn per interval, biases, aid and faults those of :func:`measure` with the same key.

    Pure: `jit` it with the intervals and the scenario as arguments.

    Args:
        intervals: the truth, preintegrated.
        scenario: of that truth.
        key: of a run; or (runs,) of them, which is several times faster than `vmap`: the leaves of ``rows`` but ``dt``
            then have the runs on their last axis.

    Raises:
        UserError: the scenario has a disturbance of the force, which is not white.
    """
    if scenario.force is not None:
        raise UserError("a disturbed base needs noise at IMU rate: fidelity 'samples'")
    dt, n, runs = intervals.truth.dt, intervals.samples, key.shape
    count = intervals.dvel.x.shape[0]

    def every(x: Any) -> Any:  # what all runs have in common
        return jax.tree.map(lambda leaf: leaf.reshape(*leaf.shape, *(1 for _ in runs)), x)

    gyro_key, accel_key, *_ = source_keys(key)
    gyro, accel = (
        each(lambda k, e=e: e.draw_bias(jax.random.split(k)[0]) * dt, source)
        for e, source in ((scenario.gyro, gyro_key), (scenario.accel, accel_key))
    )
    sd_gyro, sd_accel = scenario.gyro.increment_sd(dt), scenario.accel.increment_sd(dt)
    z = normals(fold(gyro_key, 1), 6 * count).astype(jnp.float64).reshape(6, count, *runs)
    tilt = Vec3(z[0], z[1], z[2]) * (sd_gyro * jnp.sqrt(float(n)))
    root = every(_root(intervals.scatter * sd_gyro**2 + n * sd_accel**2 * jnp.eye(3)))
    speed = Vec3(
        root[0][0] * z[3],
        root[1][0] * z[3] + root[1][1] * z[4],
        root[2][0] * z[3] + root[2][1] * z[4] + root[2][2] * z[5],
    )
    speed = speed - every(intervals.lever).cross(tilt)
    tilt = tilt + _times(every(intervals.turned), gyro)
    speed = speed + _times(every(intervals.turned), accel) - _times(every(intervals.moved), gyro)
    moved = Increment(Quat.turn(tilt) * every(intervals.rotation), every(intervals.dvel) + speed)
    return _epochs(moved, intervals.truth, scenario, key, n)


def sample_epochs(truth: Truth, scenario: Scenario, key: PRNGKeyArray, samples: int) -> Epochs:
    """Epochs of the runs with these keys, the noise per IMU sample: those of :func:`measure` with the same keys.

    Interval by interval, so that the samples are never held: as :func:`measure` and a preintegration would have it, but
    for rounding, and several times faster for many runs. Pure.

    Args:
        truth: perfect samples.
        scenario: of that truth.
        key: of a run, or (runs,) of them, as in :func:`measure_epochs`.
        samples: per interval, at least two.

    Raises:
        UserError: the scenario has a disturbance of the force.
    """
    if scenario.force is not None:
        raise UserError("a disturbed base is measured sample by sample: use measure")
    count, dt = truth.dtheta.shape[0] // samples, truth.dt
    sources: list[tuple[Array, PRNGKeyArray, Any]] = []
    for errors, source in zip((scenario.gyro, scenario.accel), source_keys(key), strict=False):
        halves = [each(lambda k, i=i: jax.random.key_data(jax.random.split(k)[i]), source) for i in (0, 1)]
        bias_key, noise_key = (jax.random.wrap_key_data(jnp.moveaxis(x, 0, -1)) for x in halves)
        sources.append((each(errors.draw_bias, bias_key) * dt, noise_key, errors.increment_sd(dt)))

    terms = 8 if scenario.imu_rate >= _LEAST_HZ else 14

    def interval(row: tuple[Array, Array, Array]) -> Increment:
        start, *exact = row
        if samples % 2:
            return integrated(*(_measured(x, *source, start) for x, source in zip(exact, sources, strict=True)))
        th, dv = (_measured_pairs(x, *source, start // 2) for x, source in zip(exact, sources, strict=True))
        return paired(th[0], dv[0], th[1], dv[1], terms)

    rows = (x[: count * samples].reshape(count, samples, 3) for x in (truth.dtheta, truth.dvel))
    starts = 3 * samples * jnp.arange(count, dtype=jnp.uint32)
    return _epochs(jax.lax.map(interval, (starts, *rows)), truth, scenario, key, samples)


def _measured(exact: Array, bias: Array, key: PRNGKeyArray, sd: Any, start: Array) -> Vec3:
    """Samples (samples, 3) of an interval with their errors; `start`: the first number of their noise."""
    z = normals(key, exact.size, start).astype(jnp.float64).reshape(*exact.shape, *key.shape)
    return _spoiled(exact, bias, (z[:, 0], z[:, 1], z[:, 2]), sd)


def _measured_pairs(exact: Array, bias: Array, key: PRNGKeyArray, sd: Any, start: Array) -> tuple[Vec3, Vec3]:
    """The same numbers as first and second samples of pairs, whose noise is three blocks; `start`: of the first."""
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
    """Samples (n, 3) plus bias and white noise of each run: components (n, *runs)."""
    runs = bias.shape[1:]
    return Vec3(*(exact[:, i].reshape(-1, *(1 for _ in runs)) + bias[i] + noise[i] * sd for i in range(3)))


def _epochs(moved: Increment, truth: Truth, scenario: Scenario, key: PRNGKeyArray, samples: int) -> Epochs:
    """With an epoch at the start, and the aid."""
    count = moved.dvel.x.shape[0]
    still = jax.tree.map(lambda x: jnp.zeros((1, *key.shape)) + x, Increment(Quat.identity(), Vec3.zero()))
    rows = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), still, moved)
    steps = jnp.concatenate([jnp.zeros(1), jnp.full(count, samples * truth.dt)])
    safe, valid = _aid(truth, scenario, key, samples, count)
    interval = float(f"{samples / scenario.imu_rate:.4g}")
    return Epochs(
        Epoch(rows.rotation, rows.dvel, steps, safe, valid), scenario.site, scenario.aid_sd, scenario.aid, interval
    )


def _times(m: Float[Array, "m 3 3 ..."], v: Float[Array, "3 ..."]) -> Vec3:
    """Matrix of each interval times vector of each run."""
    return Vec3(*(m[:, i, 0] * v[0] + m[:, i, 1] * v[1] + m[:, i, 2] * v[2] for i in range(3)))


def _aid(truth: Truth, scenario: Scenario, key: PRNGKeyArray, samples: int, count: int) -> tuple[Vec3, Array]:
    """Velocities at the epochs, any number where there is none, and where there is one."""
    velocity = aid_velocity(truth, scenario, key)
    if velocity is None:
        return jax.tree.map(lambda x: jnp.zeros((count + 1, *key.shape)) + x, Vec3.zero()), jnp.ones(
            (count + 1, *key.shape), bool
        )
    ratio = scenario.aid_every // samples
    if ratio > 1:  # epochs between two fixes have no aid
        velocity = jnp.full((count + 1, 3, *key.shape), jnp.nan).at[::ratio].set(velocity)
    valid = jnp.all(jnp.isfinite(velocity), axis=1)
    return Vec3(*(jnp.where(valid, velocity[:, i], 0.0) for i in range(3))), valid


def _root(m: Array) -> Any:
    """Lower Cholesky factors (M, 3, 3), by components; zero where the matrix is zero."""

    def root(x: Array) -> Array:
        ok = x > 0
        return jnp.where(ok, jnp.sqrt(jnp.where(ok, x, 1.0)), 0.0)

    def over(x: Array, y: Array) -> Array:
        return jnp.where(y > 0, x / jnp.where(y > 0, y, 1.0), 0.0)

    a = root(m[:, 0, 0])
    b, c = over(m[:, 1, 0], a), over(m[:, 2, 0], a)
    d = root(m[:, 1, 1] - b * b)
    e = over(m[:, 2, 1] - b * c, d)
    return (a,), (b, d), (c, e, root(m[:, 2, 2] - c * c - e * e))
