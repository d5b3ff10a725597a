"""The Cramer-Rao bound of the attitude over time: what no unbiased estimator can beat."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.batch.smoother import Prior, filtered
from jaxalign.batch.solver import Model, Problem, State, linearized
from jaxalign.batch.trajectory import TILT, UNKNOWN, Trajectory
from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.inertial_unit import ImuErrors
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


@Program
def _bound(epochs: Epochs, exact: Truth, imu: ImuErrors, sd: Any, known: Any) -> Bound:
    one, count = jax.tree.map(lambda x: x[:, None], epochs.rows), len(epochs)
    q_nb = Quat.of(quat_from_dcm(exact.C_nb))
    model = Model(imu, jnp.zeros(()), jnp.ones(()), jnp.zeros(0), jnp.zeros(0), jnp.ones(()), (), "stated", epochs.aid)
    problem = Problem(one, epochs.site, sd, jnp.asarray([count - 1]))
    # Attitude and velocity in n0 need the turn of n, which follows the velocity in n: twice from an n at rest.
    q_n0n = jax.tree.map(lambda x: jnp.broadcast_to(x, (count,)), Quat.identity())
    still, yes = jnp.zeros((count, 1)), jnp.ones(1, bool)
    for _ in range(4):
        velocity = q_n0n.rotate(Vec3.of(exact.velocity_n))
        q, v, n = jax.tree.map(lambda x: x[:, None], (q_n0n * q_nb, velocity, q_n0n))
        at = Trajectory(q, v, Vec3(still, still, still), Vec3(still, still, still))
        steady = at.velocity if epochs.aid == "nav" else None
        state = State(
            at, n, jnp.zeros((0, 1)), jnp.ones((count, 1)), jnp.ones(1) * sd**2, jnp.ones(1), steady, yes, yes
        )
        linear = linearized(model, problem, state)
        q_n0n = jax.tree.map(lambda x: x[:, 0], linear.intervals.q_n0n)
    speed = jnp.where(known, _EXACT, _FAST)
    deviations = jnp.concatenate([jnp.full(3, UNKNOWN), jnp.full(3, speed), *_biases(imu)])
    prior = Prior(jnp.zeros((12, 1)), deviations[:, None] ** 2)
    found = filtered(eqx.tree_at(lambda x: x.prior, linear, prior), keep=True)
    turned = q_n0n.matrix.array
    covariance = jnp.einsum("kji,kjl,klm->kim", turned, found.covariance[:, TILT, TILT, 0], turned)
    euler = jnp.diagonal(euler_covariance(q_nb.array, covariance), axis1=1, axis2=2)
    phi = jnp.diagonal(covariance, axis1=1, axis2=2)
    return Bound(jnp.cumsum(epochs.rows.dt), *(jnp.rad2deg(jnp.sqrt(x)) for x in (phi, euler)))


@Program
def _measured(exact: Truth, scenario: Scenario) -> Epochs:
    """What perfect sensors measure."""
    return measure_epochs(intervals_of(exact, scenario.aid_every), noiseless(scenario), jax.random.key(0))


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
    epochs = _measured(exact, scenario)
    standing = scenario.aid == "static"
    sd = _EXACT if standing else jnp.maximum(scenario.aid_sd, _EXACT)
    return _bound(epochs, exact, scenario.imu, sd, standing)
