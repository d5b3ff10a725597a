"""The Cramer-Rao bound of the attitude over time: what no unbiased estimator can beat."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.batch.measurement import steady_aid
from jaxalign.batch.problem import AidNoise, Model, Problem, State
from jaxalign.batch.smoother import Prior, filter_forward
from jaxalign.batch.solver import linearize_problem
from jaxalign.batch.trajectory import TILT, UNKNOWN, NominalTrajectory
from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.inertial_unit import ImuErrors
from jaxalign.precision import require_x64
from jaxalign.rotation import euler_covariance
from jaxalign.simulate import Scenario, SimulatedAid, Truth, intervals_of, measure_epochs, noiseless, truth
from jaxalign.vector import Quat, Vec3

__all__ = ["Bound", "bound"]

_Drawn = dict[str, tuple[Any, Any]]
"""Value and standard deviation of unknowns, by name."""
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
def _bound(epochs: Epochs, exact: Truth, unknowns: tuple[_Drawn, ...], imu: ImuErrors, known: Any) -> Bound:
    one, count = jax.tree.map(lambda x: x[:, None], epochs.rows), len(epochs)
    q_nb = Quat.of(exact.q_nb)
    names = tuple(aid.estimated(tuple(own)) for aid, own in zip(epochs.aids, unknowns, strict=True))
    values, deviations = [jnp.zeros(0)], [jnp.zeros(0)]
    for aid, own in zip(epochs.aids, unknowns, strict=True):
        for name in aid.estimated(tuple(own)):
            size, usual = aid.known_unknowns[name].size, aid.known_unknowns[name].sd
            value, sd = own.get(name, (jnp.zeros(size), jnp.full(size, usual)))
            values.append(value)
            deviations.append(sd)
    value, spread = jnp.concatenate(values), jnp.concatenate(deviations)
    none, forever = jnp.zeros(()), jnp.full(len(spread), jnp.inf)
    model = Model(imu, none, jnp.ones(()), spread, forever, jnp.ones(()), names, "stated", epochs.aids)
    sd = tuple(jnp.maximum(x, _EXACT) for x in epochs.sd)
    problem = Problem(one, epochs.site, sd, jnp.asarray([count - 1]))
    # Attitude and velocity in n0 need the turn of n, which follows the velocity in n: twice from an n at rest.
    q_n0n = jax.tree.map(lambda x: jnp.broadcast_to(x, (count,)), Quat.identity())
    still, yes = jnp.zeros((count, 1)), jnp.ones(1, bool)
    noise = tuple(
        AidNoise(jnp.ones((count, 1)), one_sd**2 * jnp.ones(1), jnp.ones(1)) for one_sd, _ in problem.deviations
    )
    for _ in range(4):
        velocity = q_n0n.rotate(Vec3.of(exact.velocity_n))
        q, v, n = jax.tree.map(lambda x: x[:, None], (q_n0n * q_nb, velocity, q_n0n))
        at = NominalTrajectory(q, v, Vec3(still, still, still), Vec3(still, still, still))
        steady = None if steady_aid(epochs.aids) is None else at.velocity
        state = State(at, n, value[:, None], noise, steady, yes, yes)
        linear = linearize_problem(model, problem, state)
        q_n0n = jax.tree.map(lambda x: x[:, 0], linear.intervals.q_n0n)
    speed = jnp.where(known, _EXACT, _FAST)
    deviations = jnp.concatenate([jnp.full(3, UNKNOWN), jnp.full(3, speed), *_biases(imu), spread])
    prior = Prior(jnp.zeros((len(deviations), 1)), deviations[:, None] ** 2)
    found = filter_forward(eqx.tree_at(lambda x: x.prior, linear, prior), keep=True)
    turned = q_n0n.matrix.array
    covariance = jnp.einsum("kji,kjl,klm->kim", turned, found.covariance[:, TILT, TILT, 0], turned)
    euler = jnp.diagonal(euler_covariance(q_nb.array, covariance), axis1=1, axis2=2)
    phi = jnp.diagonal(covariance, axis1=1, axis2=2)
    return Bound(jnp.cumsum(epochs.rows.dt), *(jnp.rad2deg(jnp.sqrt(x)) for x in (phi, euler)))


@Program
def _measured(exact: Truth, scenario: Scenario) -> Epochs:
    """What perfect sensors measure."""
    return measure_epochs(intervals_of(exact, scenario.epoch_samples), noiseless(scenario), jax.random.key(0))


def _biases(imu: ImuErrors) -> tuple[Any, Any]:
    return jnp.full(3, 1.0) * imu.gyro.bias, jnp.full(3, 1.0) * imu.accel.bias


def bound(scenario: Scenario, exact: Truth | None = None) -> Bound:
    """The bound of a scenario, attitude and first velocity unknown.

    Its noise of aid, gyroscopes and accelerometers is white; the size of its biases is their standard deviation, and
    they wander as it states.

    The filter that is optimal for small errors, along the true path: its covariance is the bound wherever that is
    small against a radian, and a uniform angle's where nothing is known. Outliers and faults of the inertial unit are
    left out, gaps are not. What runs draw of the unknowns of an aid (``unknown_sd``) is unknown to it too.

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
    scenario = dataclasses.replace(scenario, imu_faults=())
    epochs = _measured(exact, scenario)
    unknowns = tuple(_drawn(one) for one in scenario.aids) or ({},)
    epochs = epochs.with_sd(tuple(one.sd for one in scenario.aids) or _EXACT)
    return _bound(epochs, exact, unknowns, scenario.imu.at_rate(scenario.imu_rate), scenario.standing)


def _drawn(one: SimulatedAid) -> _Drawn:
    """The unknowns of a simulated aid that differ from run to run: an estimator has to find them."""
    return {name: (one.unknowns.get(name, jnp.zeros_like(sd)), sd) for name, sd in one.unknown_sd.items()}
