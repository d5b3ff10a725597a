"""How the errors of single samples add up over an interval, axis by axis: sums that the truth fixes.

An error e of the rotation of sample j about axis a adds ``s_ja e`` to the increments of its interval (rotation, then
velocity), with ``s_ja = (R_j i_a, - W_j x R_j i_a)``; one of its velocity adds ``R_j i_a`` to the velocity. R_j, W_j as
in :mod:`jaxalign.simulate.aggregate`. Where all axes have the same noise the sums over the axes do, which are simpler;
here is what it takes where they differ, and where biases wander.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.inertial_unit import AbstractTriadErrors, ImuErrors
from jaxalign.preintegration import middle_attitudes
from jaxalign.simulate.imu import Truth
from jaxalign.vector import Vec3

__all__ = ["AxisMoments", "covariance", "moments_of", "root", "step_sd", "turns"]


class AxisMoments(eqx.Module):
    """Of M intervals, for axis a of the second index.

    A random walk of the bias takes a step after each of the n samples; step i moves all samples after it, and so adds
    ``l_ia = sum_{j>i} s_ja`` of its size. With the sum of the steps given, the mean of what they add is ``ramp`` times
    it, and what is left has the covariance ``wandered`` times the variance of a step.

    Attributes:
        white: (M, 3, 6, 6) sum of s s' over the samples.
        ramp: (M, 6, 3) mean of l over the steps.
        wandered: (M, 3, 6, 6) sum of (l - ramp) (l - ramp)'.
    """

    white: Float[Array, "m 3 6 6"]
    ramp: Float[Array, "m 6 3"]
    wandered: Float[Array, "m 3 6 6"]


def turns(truth: Truth, samples: int) -> tuple[Array, Array]:
    """R_j (samples, M, 3, 3), and the velocity that comes after each sample, W_j (samples, M, 3), m/s."""
    count = truth.dtheta.shape[0] // samples
    th, dv = (x[: count * samples].reshape(count, samples, 3).swapaxes(0, 1) for x in (truth.dtheta, truth.dvel))
    middle = middle_attitudes(Vec3.of(th))
    v = middle.rotate(Vec3.of(dv)).array
    return middle.matrix.array, jnp.sum(v, 0) - jnp.cumsum(v, 0) + 0.5 * v


def moments_of(truth: Truth, samples: int) -> AxisMoments:
    """The sums for intervals of so many samples."""
    r, w = turns(truth, samples)
    lever = jnp.cross(w[..., None, :], r.swapaxes(-1, -2)).swapaxes(-1, -2)
    s = jnp.concatenate([r, -lever], axis=-2)
    after = jnp.sum(s, 0) - jnp.cumsum(s, 0)
    ramp = jnp.mean(after, 0)

    def squares(x: Array) -> Array:
        return jnp.einsum("smia,smja->maij", x, x)

    return AxisMoments(squares(s), ramp, squares(after - ramp))


def step_sd(errors: AbstractTriadErrors, dt: Any) -> Float[Array, " 3"] | None:
    """What a step of the bias after a sample adds to the error of later increments: its standard deviation, rad or m/s.

    None: the bias is constant.
    """
    walk = errors.bias_walk
    return None if walk is None else jnp.broadcast_to(walk, (3,)) * jnp.sqrt(dt) * dt


def covariance(moments: AxisMoments, imu: ImuErrors, dt: Any) -> Float[Array, "m 6 6"]:
    """Of the increments of the intervals: white noise, and the wander of the biases but for the sums of its steps.

    Args:
        moments: of the intervals.
        imu: errors of the unit.
        dt: of a sample, s.
    """

    def summed(errors: AbstractTriadErrors) -> Array:
        total = jnp.einsum("a,maij->mij", jnp.broadcast_to(errors.increment_sd(dt), (3,)) ** 2, moments.white)
        step = step_sd(errors, dt)
        return total if step is None else total + jnp.einsum("a,maij->mij", step**2, moments.wandered)

    gyro, accel = summed(imu.gyro), summed(imu.accel)
    return gyro.at[:, 3:, 3:].add(accel[:, :3, :3])


def root(m: Float[Array, "m n n"]) -> list[list[Any]]:
    """Lower Cholesky factors, by components; zero where the matrix is zero."""
    lower: list[list[Any]] = []
    for i in range(m.shape[-1]):
        row: list[Any] = []
        for k in range(i + 1):
            left = m[:, i, k]
            for j in range(k):
                left = left - row[j] * (row[j] if k == i else lower[k][j])
            positive = left > 0 if k == i else lower[k][k] > 0
            size = left if k == i else lower[k][k]
            safe = jnp.where(positive, size, 1.0)
            row.append(jnp.where(positive, jnp.sqrt(safe) if k == i else left / safe, 0.0))
        lower.append(row)
    return lower
