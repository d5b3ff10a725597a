"""The Cramer-Rao bound of the attitude over time: what no unbiased estimator can beat."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.batch.imu import ImuErrors
from jaxalign.batch.model import TILT, UNKNOWN, Guess, navigated
from jaxalign.batch.smoother import Prior, filtered, fixes
from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.precision import require_x64
from jaxalign.rotation import euler_covariance, quat_from_dcm
from jaxalign.simulate import Scenario, Truth, intervals_of, measure_epochs, noiseless, truth
from jaxalign.vector import Quat, Vec3

__all__ = ["Bound", "bound"]

_FAST = 1e3  # m/s: nothing is known of the first velocity
_EXACT = 1e-6  # m/s: a vehicle at rest


class Bound(eqx.Module):
    """Least standard deviations at the epochs of the aid.

    Attributes:
        time: (K,) s.
        phi_deg: (K, 3) of the attitude error in n (east, north, up), deg.
        euler_deg: (K, 3) of pitch, roll, yaw, deg.
    """

    time: Float[Array, " K"]
    phi_deg: Float[Array, "K 3"]
    euler_deg: Float[Array, "K 3"]


@eqx.filter_jit
def _bound(epochs: Epochs, exact: Truth, imu: ImuErrors, sd: Any, known: Any) -> Bound:
    c_n0b0 = Quat.of(quat_from_dcm(exact.C_nb[0]))
    guess = Guess.of(c_n0b0, Vec3.of(exact.velocity_n[0]))
    path = navigated(epochs, guess)
    measured = fixes(path, epochs.rows.velocity, epochs.rows.valid, epochs.aid)
    variance = jnp.full(len(epochs), 1.0) * sd**2
    speed = jnp.where(known, _EXACT, _FAST)
    deviations = jnp.concatenate([jnp.full(3, UNKNOWN), jnp.full(3, speed), *_biases(imu)])
    found = filtered(path, measured, variance, imu, Prior(jnp.zeros(12), deviations**2), keep=True)
    turned = path.q_n0n.matrix.array
    covariance = jnp.einsum("kji,kjl,klm->kim", turned, found.covariance[:, TILT, TILT], turned)
    q_nb = path.q_n0n.conjugate() * path.q_n0b
    euler = jnp.diagonal(euler_covariance(q_nb.array, covariance), axis1=1, axis2=2)
    phi = jnp.diagonal(covariance, axis1=1, axis2=2)
    return Bound(jnp.cumsum(path.dt), *(jnp.rad2deg(jnp.sqrt(x)) for x in (phi, euler)))


def _biases(imu: ImuErrors) -> tuple[Any, Any]:
    return jnp.full(3, 1.0) * imu.gyro_bias, jnp.full(3, 1.0) * imu.accel_bias


def bound(scenario: Scenario, exact: Truth | None = None) -> Bound:
    """The bound of a scenario, attitude and first velocity unknown.

    Its noise of aid, gyroscopes and accelerometers is white; the size of its biases is their standard deviation.

    The filter that is optimal for small errors, along the true path: its covariance is the bound wherever that is
    small against a radian, and a uniform angle's where nothing is known. Outliers are left out, gaps are not.

    Args:
        scenario: its aid, sensors and path.
        exact: its truth, if there is one already.

    Raises:
        UserError: a disturbed base, whose noise is not white; float32.
    """
    require_x64()
    if scenario.force is not None:
        raise UserError(f"{scenario.name}: the disturbance of its base is not white noise: there is no bound for it")
    exact = truth(scenario) if exact is None else exact
    epochs = measure_epochs(intervals_of(exact, scenario.aid_every), noiseless(scenario), jax.random.key(0))
    standing = scenario.aid == "static"
    sd = _EXACT if standing else jnp.maximum(scenario.aid_sd, _EXACT)
    return _bound(epochs, exact, ImuErrors.of(scenario), sd, standing)
