"""How sure is an attitude? An ensemble of alignments of the same log, each with errors of its own added."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign.alignment import align, epochs_for
from jaxalign.arguments import whole_number
from jaxalign.batch.pool import pool_velocities
from jaxalign.batch.start import integrate_vectors, misfit, robust_start
from jaxalign.batch.trajectory import UNKNOWN
from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs
from jaxalign.front_end import is_standing
from jaxalign.inertial_unit import ImuErrors
from jaxalign.log import Log
from jaxalign.method import AbstractMethod
from jaxalign.preintegration import Increment
from jaxalign.rotation import attitude_error
from jaxalign.solution import Solution, Status
from jaxalign.vector import Vec3

__all__ = ["assess", "ensemble_covariance"]

_LANES = 32
_WIDE = np.deg2rad(20.0)
_OUTLIER = 5.0  # times the noise: beyond, a fix is as wrong as it looks


def _fix_sd(epochs: Epochs) -> tuple[Float[Array, " K"], ...]:
    """Of each aid the standard deviation of each fix: the aid's, but of one that stands out what it is off."""
    pool = pool_velocities(epochs.aids, epochs.rows.fixes)
    seen = integrate_vectors(epochs.rows, epochs.site, pool)
    alpha, beta, used = jax.tree.map(lambda x: x[:, None], (seen.alpha, seen.beta, pool.valid))
    start, _, scale = robust_start(alpha, beta, used, epochs.aid_sd, pool.axes)
    off, scale = misfit(alpha, beta, start, pool.axes).norm()[:, 0], scale[0]
    out = []
    for number, aid in enumerate(epochs.aids):
        sd = epochs.sd[number]
        one = jnp.broadcast_to(sd if jnp.ndim(sd) == 0 else jnp.sqrt(jnp.mean(sd**2)), (len(epochs),))
        told = number in pool.members and not aid.implied
        out.append(jnp.where(off > _OUTLIER * scale, off / jnp.sqrt(3.0), one) if told else one)
    return tuple(out)


def _disturbed(epochs: Epochs, imu: ImuErrors, fix_sd: Any, key: PRNGKeyArray) -> Epochs:
    """The epochs with errors drawn from the model added."""
    rows, n = epochs.rows, len(epochs)

    def normal(key: Any, *shape: int) -> Any:
        return jax.random.normal(key, (*shape, 3), jnp.float64)

    keys = jax.random.split(key, 5)
    moved = rows.dt > 0
    rate = jnp.where(moved, 1.0 / jnp.sqrt(jnp.where(moved, rows.dt, 1.0)), 0.0)[:, None]
    gyro = imu.gyro.bias * normal(keys[0]) + imu.gyro.density * rate * normal(keys[1], n)
    standing = is_standing(epochs.aids)
    force = epochs.aid_sd * rate if standing else imu.accel.density  # the noise of the force over one interval
    accel = imu.accel.bias * normal(keys[2]) + force * rate * normal(keys[3], n)
    walks, walked = (imu.gyro.bias_walk, imu.accel.bias_walk), []
    for i, (bias, walk) in enumerate(zip((gyro, accel), walks, strict=True)):
        if walk is not None:  # the mean of an interval is half a step behind its end
            step = walk * jnp.sqrt(rows.dt)[:, None] * normal(jax.random.fold_in(key, len(keys) + i), n)
            bias = bias + jnp.cumsum(step, axis=0) - 0.5 * step
        walked.append(bias)
    gyro, accel = walked
    moment = Increment(rows.rotation, rows.dvel).corrected(Vec3.of(gyro), Vec3.of(accel), rows.dt)
    fixes = []
    for number, (aid, fix, sd) in enumerate(zip(epochs.aids, rows.fixes, fix_sd, strict=True)):
        if not aid.implied:
            key, size = keys[4] if number == 0 else jax.random.fold_in(keys[4], number), len(fix.value)
            noise = sd[:, None] * jax.random.normal(key, (n, size), jnp.float64)
            fix = dataclasses.replace(fix, value=tuple(x + noise[:, i] for i, x in enumerate(fix.value)))
        fixes.append(fix)
    new = dataclasses.replace(rows, rotation=moment.rotation, dvel=moment.dvel, fixes=tuple(fixes))
    return eqx.tree_at(lambda e: e.rows, epochs, new)


@Program
def ensemble_covariance(
    method: AbstractMethod, epochs: Epochs, imu: ImuErrors, found: Solution, every: int, draws: int, key: PRNGKeyArray
) -> Float[Array, "K 3 3"]:
    """Mean square of the attitude errors (rad^2, n) that errors drawn from the sensor model make. Pure.

    Args:
        method: that found the solution.
        epochs: as the method makes them, with the noise of the aid.
        imu: errors of the inertial unit, its white noise as densities.
        found: solution for these epochs.
        every: epochs between its rows.
        draws: alignments of the ensemble, a multiple of 32.
        key: of the draws.
    """
    fix_sd = _fix_sd(epochs)

    def one(key: Any) -> Any:
        other = method.solve(_disturbed(epochs, imu, fix_sd, key), every)
        phi = attitude_error(other.q_nb, found.q_nb)
        known = (other.defined & jnp.all(jnp.isfinite(phi), axis=-1))[:, None]
        phi = jnp.where(known, phi, 0.0)
        unknown = jnp.where(known[..., None], 0.0, UNKNOWN**2 * jnp.eye(3))
        return phi[:, :, None] * phi[:, None, :] + unknown

    def chunk(total: Any, keys: Any) -> Any:
        return total + jnp.sum(jax.vmap(one)(keys), axis=0), None

    keys = jax.random.split(key, (draws // _LANES, _LANES))
    total, _ = jax.lax.scan(chunk, jnp.zeros((found.time.shape[0], 3, 3)), keys)
    return jnp.where(found.defined[:, None, None], total / draws, 0.0)


def assess(
    method: AbstractMethod,
    log: Log | Epochs,
    imu: ImuErrors,
    every: int = 1,
    aid_sd: Any = None,
    draws: int = 256,
    seed: int = 0,
    done: Callable[[int], None] | None = None,
) -> Solution:
    """Align as :func:`jaxalign.align` does, and say how sure the attitude is: ``Solution.covariance``.

    The log is aligned again ``draws`` times, with errors drawn from the model of the sensors added to it: biases,
    their wander and white noise of the inertial unit, white noise of the aid. The mean square of what that does to the
    attitude is its covariance, whatever the method, as long as the model holds (a parametric bootstrap). Standard
    deviations from 256 draws are good to 5 %. A fix that stands out from all others is drawn with the error that it
    seems to have.

    A method that knows its covariance is left to it: ``robust_map`` and ``fine`` take ``imu`` as their own.
    ``Status.INDICATIVE`` marks rows behind a prefilter, which colours the noise, and those of an ensemble with a
    heading open by more than 20 deg, which is no small angle: an interval of 95 % may hold 65 % there.

    Args:
        method: see :func:`jaxalign.align`.
        log: likewise.
        imu: errors of the inertial unit, for instance ``imu_errors("tactical")``.
        every: epochs between two rows.
        aid_sd: see :func:`jaxalign.align`.
        draws: rounded up to a multiple of 32.
        seed: of the draws.
        done: see :func:`jaxalign.align`.

    Raises:
        UserError: as :func:`jaxalign.align`; ``imu`` is none, or states white noise per sample and ``log`` is epochs;
            fewer than one draw.
    """
    imu = ImuErrors.checked(imu)
    if isinstance(log, Log):
        imu = imu.at_rate(1.0 / log.dt)
    imu.check_densities()
    draws = whole_number("draws", draws, floats=True)
    method = AbstractMethod.checked(method).with_imu(imu)
    found = align(method, log, every, aid_sd, done)
    if not method.has_covariance:
        epochs = epochs_for(method, log, found.aid_sd[-1])
        bare = method.bare.at_interval(epochs.interval)
        count = -(-int(draws) // _LANES) * _LANES
        covariance = ensemble_covariance(bare, epochs, imu, found, int(every), count, jax.random.key(seed))
        found = dataclasses.replace(found, covariance=covariance)
    hint = jnp.full_like(found.defined, method.front_end.prefilter is not None)
    if not method.has_covariance:
        assert found.covariance is not None
        hint = hint | (found.defined & ~(found.covariance[..., 2, 2] < _WIDE**2))
    return dataclasses.replace(found, status=found.status | jnp.where(hint, jnp.int32(int(Status.INDICATIVE)), 0))
