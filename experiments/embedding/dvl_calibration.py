"""Scale, mounting and lever arm of a Doppler log, estimated through the alignment: maximum a posteriori, Gauss-Newton.

The unknowns are errors of the Doppler log and of the inertial unit, each with a standard deviation beforehand. The
attitude is none of them: the alignment finds it, and the derivative of its residuals goes through all of its epochs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxalign import Aligner, Epochs, Quat, Vec3
from jaxalign.inertial_unit import ImuErrors
from jaxalign.methods import build
from jaxalign.vector import where

__all__ = ["DOPPLER", "Found", "Unknowns", "calibrate", "corrected", "expected", "spoilt", "vectors"]

DOPPLER = 7  # unknowns of the Doppler log; they come first
ITERATIONS = 3


class Unknowns(eqx.Module):
    """Errors of the sensors, or their standard deviations.

    Attributes:
        scale: k of ``v = (1 + k) R v_log - w x lever``.
        mounting: (3,) rotation vector of R, rad (x right, y forward, z up).
        lever: (3,) from the inertial unit to the Doppler log, m.
        gyro: (3,) constant bias, rad/s.
        accel: (3,) constant bias, m/s^2.
        gyro_walk: (S, 3) mean of the gyroscopes' noise over each of S equal parts of the record, rad/s.
        accel_walk: (S, 3) the same of the accelerometers, m/s^2.
    """

    scale: Float[Array, ""]
    mounting: Float[Array, " 3"]
    lever: Float[Array, " 3"]
    gyro: Float[Array, " 3"]
    accel: Float[Array, " 3"]
    gyro_walk: Float[Array, "S 3"]
    accel_walk: Float[Array, "S 3"]


def expected(doppler: Any, imu: ImuErrors, seconds: float, parts: int) -> Unknowns:
    """Standard deviations beforehand: seven of the Doppler log; of an inertial unit over so many seconds."""
    triads = (imu.gyro, imu.accel)
    biases = (jnp.full(3, x.bias) for x in triads)
    walks = (jnp.full((parts, 3), x.density) / np.sqrt(seconds / parts) for x in triads)
    return Unknowns(doppler[0], doppler[1:4], doppler[4:], *biases, *walks)


def _rate(epochs: Epochs) -> Vec3:
    """Turn rate in b at the epochs, rad/s: mean of the two intervals beside each."""
    mean = epochs.rows.rotation.log() * (1 / epochs.rows.dt[-1])  # all intervals are alike
    return jax.tree.map(lambda x: 0.5 * (jnp.append(x[1], x[1:]) + jnp.append(x[1:], x[-1])), mean)


def _seen(velocity: Vec3, errors: Unknowns) -> Vec3:
    """A velocity of the Doppler log, in b, as it has it in its own axes and scale."""
    return Quat.exp(Vec3.of(-errors.mounting)).rotate(velocity) * (1 / (1 + errors.scale))


def _parts(v: Vec3) -> tuple[Any, Any, Any]:
    return v.x, v.y, v.z


def spoilt(epochs: Epochs, errors: Unknowns) -> Epochs:
    """With a Doppler log that has these errors."""
    velocity = epochs.rows.velocity + _rate(epochs).cross(Vec3.of(errors.lever))
    return eqx.tree_at(lambda e: e.rows.fixes[0].value, epochs, _parts(_seen(velocity, errors)))


def corrected(epochs: Epochs, errors: Unknowns) -> Epochs:
    """Without these errors of the sensors."""
    rows, parts = epochs.rows, errors.gyro_walk.shape[0]
    part = jnp.maximum(jnp.arange(len(epochs)) - 1, 0) * parts // (len(epochs) - 1)
    turned = Vec3.of(errors.gyro + errors.gyro_walk[part]) * rows.dt
    pushed = Vec3.of(errors.accel + errors.accel_walk[part]) * rows.dt
    middle = Quat.turn(rows.rotation.log() * 0.5)  # half-way through an interval, seen from its start
    velocity = Quat.exp(Vec3.of(errors.mounting)).rotate(rows.velocity) * (1 + errors.scale)
    velocity = velocity - _rate(epochs).cross(Vec3.of(errors.lever))
    new = rows.rotation * Quat.turn(-turned), rows.dvel - middle.rotate(pushed), _parts(velocity)
    return eqx.tree_at(lambda e: (e.rows.rotation, e.rows.dvel, e.rows.fixes[0].value), epochs, new)


def vectors(method: Aligner, epochs: Epochs) -> tuple[Vec3, Float[Array, " 4"]]:
    """Residuals in b of all vectors with the last attitude (m/s, first velocity free), and that attitude q_nb."""

    def step(state: Any, epoch: Any) -> tuple[Any, Any]:
        state, row = method.step(state, epoch)
        return state, (state.pair, state.observe.q_b0b, row.q_nb)

    state = method.init(epochs.site, epochs.aid_sd)
    last, (pairs, q_b0b, q_nb) = jax.lax.scan(step, state, epochs.rows)
    attitude = last.readout.attitude
    beta = pairs.beta_without_coriolis + attitude.conjugate().rotate(pairs.w_ie).cross(pairs.displacement)
    residual = attitude.conjugate().rotate(pairs.alpha) - beta  # in b0
    mean = jax.tree.map(lambda x: jnp.sum(jnp.where(pairs.valid, x, 0.0)) / jnp.sum(pairs.valid), residual)
    return q_b0b.conjugate().rotate(where(pairs.valid, residual - mean, Vec3.zero())), q_nb[-1]


class Found(NamedTuple):
    """Of each run: the unknowns (those of the Doppler log first), their standard deviations, the last attitude."""

    values: np.ndarray
    sd: np.ndarray
    residual: np.ndarray  # (runs, M+1, 3) m/s, with these errors taken away
    q_nb: np.ndarray


@eqx.filter_jit
def _normal(epochs: Epochs, points: np.ndarray, prior: Unknowns, naive: Any) -> tuple[Any, ...]:
    """Normal equations of each run, in units of the prior and without it."""
    sd, unravel = ravel_pytree(prior)
    method = build("centred_oba", "body")

    def run(given: tuple[Any, Any]) -> tuple[Any, ...]:
        epochs, point = given

        def misfit(x: Any) -> tuple[Any, Any]:
            errors = unravel(x * sd)
            residual, q_nb = vectors(method, corrected(epochs, errors))
            # Seen by the Doppler log, its noise stays what it is, whatever the errors.
            shown = where(naive, residual, _seen(residual, errors)).array
            return shown.ravel() / epochs.aid_sd, (shown, q_nb)

        slope, (residual, q_nb) = jax.jacfwd(misfit, has_aux=True)(point)
        return slope.T @ slope, slope.T @ (residual.ravel() / epochs.aid_sd), residual, q_nb

    return jax.lax.map(run, (epochs, points), batch_size=max(n for n in range(1, 11) if len(points) % n == 0))


def calibrate(epochs: Epochs, prior: Unknowns, naive: bool = False) -> Found:
    """The most likely errors of the sensors in each run.

    Args:
        epochs: of the runs, which are the first axis of all leaves.
        prior: standard deviations beforehand; zero: known to be zero.
        naive: leave the residuals in the vehicle's axes, where the errors sought scale and turn the noise.
    """
    sd = np.asarray(ravel_pytree(prior)[0])
    free, unit = np.zeros((len(epochs.rows.dt), len(sd))), np.eye(len(sd))
    for k in range(ITERATIONS + 1):
        square, slope, residual, q_nb = map(np.asarray, _normal(epochs, free, prior, jnp.asarray(naive)))
        if k < ITERATIONS:
            free = free - np.linalg.solve(square + unit, (slope + free)[..., None])[..., 0]
    left = np.sqrt(np.diagonal(np.linalg.inv(square + unit), axis1=-2, axis2=-1))
    return Found(free * sd, left * sd, residual, q_nb)
