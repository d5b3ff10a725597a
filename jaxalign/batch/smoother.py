"""Kalman filter forth and disturbance smoother back over the errors of a guessed path: one Gauss-Newton step.

The states are those of :mod:`jaxalign.batch.model`, with constants behind them if the measurement has more unknowns.
Velocities are measured axis by axis. The backward pass carries no covariance: it gives the start and the noise of each
measurement by all of them, which is what reweighting needs.

Source: Durbin and Koopman, Time Series Analysis by State Space Methods (4.6.1), (4.58)-(4.69), in scalars.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.batch.imu import ImuErrors
from jaxalign.batch.model import Path, back, forth, skew
from jaxalign.vector import Vec3, root

__all__ = ["Filtered", "Measured", "Prior", "filtered", "fixes", "settled", "smoothed"]


_SETTLED = 3.0  # times the variance that is left, a squared change may well be noise


class Prior(eqx.Module):
    """Errors of the guess before the first measurement.

    Attributes:
        mean: (n,).
        variance: (n,).
    """

    mean: Float[Array, " n"]
    variance: Float[Array, " n"]


class Measured(eqx.Module):
    """Velocities of the aid against a path: ``gap = slope x + noise``, the noise the same on all axes.

    Attributes:
        gap: (K, 3) measured minus guessed velocity, m/s, n0.
        slope: (K, 3, n).
    """

    gap: Float[Array, "K 3"]
    slope: Float[Array, "K 3 n"]


class Filtered(eqx.Module):
    """What the filter leaves.

    Attributes:
        mean: (K, n) errors by the measurements up to each epoch.
        covariance: (K, n, n) of them.
        innovation: (K, 3) of each axis after those before it, over its variance.
        gain: (K, 3, n).
        log_likelihood: of all measurements, but for a constant.
    """

    mean: Float[Array, "K n"]
    covariance: Float[Array, "K n n"]
    innovation: Float[Array, "K 3"]
    gain: Float[Array, "K 3 n"]
    log_likelihood: Float[Array, ""]


def _change(path: Path, aid: str) -> Vec3:
    """How fast a velocity changes, in the frame of its aid, turned into n0: over the interval before each epoch."""
    before, turned = jax.tree.map(lambda x: jnp.concatenate([x[:1], x[:-1]]), (path.velocity, path.q_n0b))
    if aid == "body":
        before = (path.q_n0b * turned.conjugate()).rotate(before)
    moved = path.dt > 0
    return (path.velocity - before) * jnp.where(moved, 1.0 / jnp.where(moved, path.dt, 1.0), 0.0)


def _rate(path: Path) -> Vec3:
    """How fast the vehicle turns, n0, rad/s: over the two intervals around each epoch, as far as the path goes."""
    before = jax.tree.map(lambda x: jnp.concatenate([x[:1], x[:-1]]), path.q_n0b)
    turn = (path.q_n0b * before.conjugate()).positive().log()
    turn = jax.tree.map(lambda x: jnp.where(path.dt > 0, x, 0.0), turn)
    turn, dt = jax.tree.map(lambda x: x + jnp.append(x[1:], 0.0), (turn, path.dt))
    return turn * jnp.where(dt > 0, 1.0 / jnp.where(dt > 0, dt, 1.0), 0.0)


def fixes(
    path: Path,
    velocity: Vec3,
    used: Bool[Array, " K"],
    aid: str,
    mounting: Float[Array, " 4"] | None = None,
    latency: Float[Array, " 1"] | None = None,
    lever: Float[Array, " 3"] | None = None,
    smooth: Vec3 | None = None,
) -> Measured:
    """The velocities of an aid along a path.

    The path wanders off with the noise of the inertial unit, and a tilt of the whole history turns that wandering too.
    What it does to a measurement is therefore taken at the velocity known best, not at that of the path, or a heading
    that is wide open would be told from turned noise: a body aid and a standing vehicle measure in a frame that turns
    along (the tilt acts on the whole velocity of the path), a navigation aid does not (on what it is off ``smooth``).

    Args:
        path: guessed.
        velocity: (K,) of the aid, m/s, in b or n; any where the vehicle stands.
        used: (K,) where there is one to use; elsewhere nothing is measured.
        aid: "body", "nav" or "static" (the velocity is zero).
        mounting: scale factor and misalignment (rad, b) of a body aid so far, four more unknowns:
            ``v_measured = (1 + scale) (v - misalignment x v)``.
        latency: s, of the aid so far, one more unknown: it measures the velocity of so long ago.
        lever: m, b, from the inertial unit to the aid so far, three more unknowns: it moves as the vehicle turns.
        smooth: (K,) what the velocity is by all measurements so far, for a navigation aid; None: that of the path.
    """
    v = path.velocity
    if mounting is not None:
        velocity = (velocity + Vec3.of(mounting[1:]).cross(velocity)) * (1.0 / (1.0 + mounting[0]))
    unit = jnp.broadcast_to(jnp.eye(3), (*v.x.shape, 3, 3))
    none = jnp.zeros_like(unit)
    off = v
    if aid == "body":
        seen = path.q_n0b.rotate(velocity)
    elif aid == "nav":
        seen = path.q_n0n.rotate(velocity)
        off = v - (v if smooth is None else smooth)
    else:
        seen = v * 0.0
    tilt = jax.vmap(skew)(off)
    blocks = [tilt, unit, none, none]
    if mounting is not None:
        blocks += [v.array[..., None], tilt @ path.q_n0b.matrix.array]
    if latency is not None:
        change = _change(path, aid)
        seen = seen + change * latency[0]
        blocks.append(-change.array[..., None])
    if lever is not None:
        rate = _rate(path)
        seen = seen - rate.cross(path.q_n0b.rotate(Vec3.of(lever)))
        blocks.append(jax.vmap(skew)(rate) @ path.q_n0b.matrix.array)
    there = used[:, None]
    slope = jnp.concatenate(blocks, axis=-1)
    return Measured(jnp.where(there, (seen - v).array, 0.0), jnp.where(there[..., None], slope, 0.0))


def settled(velocity: Vec3, measured: Measured, variance: Float[Array, " K"], found: Filtered) -> Vec3:
    """(K,) velocities to say how sure a heading is: without the part of their changes that is noise.

    A vehicle that keeps its velocity says nothing of the heading, but the noise of its velocity would. For a step it is
    the whole velocity that counts: the gap has the noise in it too.

    Args:
        velocity: (K,) smoothed, m/s, n0.
        measured: that the filter had.
        variance: likewise.
        found: by the filter: slope times gain is what is left of the variance of a measurement after it.
    """
    left = jnp.sum(measured.slope * found.gain, axis=(1, 2)) * variance
    weight = jnp.any(measured.slope != 0, axis=(1, 2)) / variance
    total = jnp.maximum(jnp.sum(weight), 1e-300)
    mean = jax.tree.map(lambda x: jnp.sum(weight * x) / total, velocity)
    change = velocity - mean
    size = jnp.maximum(change.norm2(), 1e-300)
    return mean + change * root(jnp.maximum(1.0 - _SETTLED * left / size, 0.0))


def _noise(row: Path, imu: ImuErrors) -> Float[Array, "6 6"]:
    """Covariance of what the white noise of an interval does to tilt and speed."""
    gyro, accel = imu.gyro_walk**2 * row.dt, imu.accel_walk**2 * row.dt
    d = skew(row.impulse)
    across = -0.5 * gyro * d
    speed = gyro / 3.0 * sum(d[:, i, None] * d[:, i] for i in range(3)) + accel * jnp.eye(3)
    return jnp.concatenate(
        [jnp.concatenate([gyro * jnp.eye(3), across.T], axis=1), jnp.concatenate([across, speed], axis=1)]
    )


def filtered(
    path: Path, measured: Measured, variance: Float[Array, " K"], imu: ImuErrors, prior: Prior, keep: bool = False
) -> Filtered:
    """Forth.

    Args:
        path: guessed.
        measured: along it.
        variance: of each measurement per axis, (m/s)^2; any positive number where there is none.
        imu: its noise.
        prior: of the errors at the first epoch, before its measurement.
        keep: mean and covariance at all epochs (else only the last: leaves with a first axis of one).
    """
    size = prior.mean.shape[0]

    def step(carry: Any, row: Any) -> Any:
        x, p, likelihood = carry
        motion, gap, slope, r = row
        x, p = forth(motion, x), forth(motion, forth(motion, p).T)
        p = p + jnp.pad(_noise(motion, imu), (0, size - 6))
        surprises, gains = [], []
        for i in range(3):
            h = slope[i]
            g = jnp.sum(p * h, axis=1)
            s = jnp.sum(g * h) + r
            surprise, gain = (gap[i] - jnp.sum(h * x)) / s, g / s
            x, p = x + g * surprise, p - g[:, None] * gain
            likelihood = likelihood - 0.5 * (surprise * surprise * s + jnp.where(jnp.any(h != 0), jnp.log(s), 0.0))
            surprises.append(surprise)
            gains.append(gain)
        return (x, p, likelihood), ((x, p) if keep else None, jnp.stack(surprises), jnp.stack(gains))

    start = (prior.mean, jnp.diag(prior.variance), jnp.zeros(()))
    last, (kept, innovation, gain) = jax.lax.scan(step, start, (path, measured.gap, measured.slope, variance))
    mean, covariance = kept if keep else jax.tree.map(lambda x: x[None], last[:2])
    return Filtered(mean, covariance, innovation, gain, last[2])


def smoothed(
    path: Path, measured: Measured, variance: Float[Array, " K"], prior: Prior, found: Filtered
) -> tuple[Float[Array, " n"], Float[Array, "K 3"]]:
    """Back.

    Returns:
        The errors at the first epoch and the noise of each measurement, m/s, n0, by all measurements.
    """

    def step(r: Any, row: Any) -> Any:
        motion, slope, innovation, gain, variance = row
        noise = [jnp.zeros(())] * 3
        for i in reversed(range(3)):
            u = innovation[i] - jnp.sum(gain[i] * r)
            r = r + slope[i] * u
            noise[i] = variance * u
        return back(motion, r), jnp.stack(noise)

    rows = (path, measured.slope, found.innovation, found.gain, variance)
    r, noise = jax.lax.scan(step, jnp.zeros_like(prior.mean), rows, reverse=True)
    return prior.mean + prior.variance * r, noise
