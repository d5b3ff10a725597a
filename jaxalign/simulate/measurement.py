"""A scenario (trajectory, rates, sensor errors, aid and its faults), its truth, and measurements per key.

`truth` (once) and `measure` (per key) are apart: a thousand runs share one truth, and `measure` is pure.
"""

from __future__ import annotations

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign import checks
from jaxalign.earth import Site
from jaxalign.errors import UserError
from jaxalign.inertial_unit import ImuErrors
from jaxalign.log import Log
from jaxalign.precision import require_x64
from jaxalign.simulate.arguments import choice, leaf
from jaxalign.simulate.faults import AbstractFault
from jaxalign.simulate.imu import Truth, jitted_increments
from jaxalign.simulate.random import fold
from jaxalign.simulate.sensors import SineForce, TriadErrors, white
from jaxalign.simulate.trajectory import Trajectory
from jaxalign.units import DEG_H, DEG_SQRT_H, UG

__all__ = ["AidKind", "Scenario", "aid_velocity", "imu_increments", "log_of", "measure", "noiseless", "truth"]

AidKind = Literal["static", "body", "nav"]


_MOST_SAMPLES = 2e7  # some 10 GB while the truth is made


class Scenario(eqx.Module):
    """All that a simulated log depends on, but the seed.

    Numbers are array leaves (replace them with `eqx.tree_at`); what sets shapes is static (replace it with
    `dataclasses.replace`).

    Attributes:
        trajectory: attitude and velocity.
        site: where the vehicle starts.
        gyro: errors of the gyroscopes.
        accel: errors of the accelerometers.
        aid_sd: standard deviation of the aid's white noise per axis, m/s.
        faults: outliers and gaps of the aid, applied in this order.
        force: disturbance of a shaken base.
        aid: "static" (no aid), "body" (velocity in b) or "nav" (velocity in n).
        duration: s, a whole number of epochs.
        imu_rate: Hz.
        aid_every: IMU samples per epoch.
        name: for messages and titles.
    """

    trajectory: Trajectory
    site: Site
    gyro: TriadErrors = eqx.field(default_factory=TriadErrors)
    accel: TriadErrors = eqx.field(default_factory=TriadErrors)
    aid_sd: Float[Array, ""] = eqx.field(default=0.0, converter=lambda x: leaf(x, "aid_sd", low=0.0))  # pyright: ignore[reportAssignmentType]
    faults: tuple[AbstractFault, ...] = ()
    force: SineForce | None = None
    aid: AidKind = eqx.field(default="body", static=True)
    duration: float = eqx.field(default=300.0, static=True)
    imu_rate: float = eqx.field(default=200.0, static=True)
    aid_every: int = eqx.field(default=200, static=True)
    name: str = eqx.field(default="scenario", static=True)

    def __check_init__(self):
        choice(self.aid, "aid", ("static", "body", "nav"))
        if not 0 < self.imu_rate < np.inf:
            raise UserError(f"imu_rate: must be a positive number of Hz, got {self.imu_rate!r}")
        if isinstance(self.aid_every, bool) or not isinstance(self.aid_every, int) or self.aid_every < 1:
            raise UserError(f"aid_every: must be a whole number of IMU samples, got {self.aid_every!r}")
        if self.duration * self.imu_rate > _MOST_SAMPLES:
            raise UserError(
                f"duration: {self.duration:g} s at {self.imu_rate:g} Hz are more than {_MOST_SAMPLES:.0e} IMU samples"
            )
        epochs = self.duration * self.imu_rate / self.aid_every
        if not 1 <= epochs < np.inf or abs(epochs - round(epochs)) > 1e-6:
            raise UserError(
                f"duration: {self.duration:g} s are {epochs:g} epochs of {self.aid_every / self.imu_rate:g} s"
                ": it must be a whole number of epochs, at least one"
            )

    @property
    def imu(self) -> ImuErrors:
        """Figures of the inertial unit that it draws from (the largest of the axes; noise per sample as a density)."""
        dt = 1.0 / self.imu_rate
        return ImuErrors(
            jnp.max(jnp.abs(self.gyro.bias)) / DEG_H,
            self.gyro.increment_sd(dt) / jnp.sqrt(dt) / DEG_SQRT_H,
            jnp.max(jnp.abs(self.accel.bias)) / UG,
            self.accel.increment_sd(dt) / jnp.sqrt(dt) / UG,
        )

    @property
    def samples(self) -> int:
        """Number N of IMU samples."""
        return self.epochs * self.aid_every

    @property
    def epochs(self) -> int:
        """Number M of epoch intervals."""
        return round(self.duration * self.imu_rate / self.aid_every)


def truth(scenario: Scenario) -> Truth:
    """Perfect increments and the states at the epochs: compute once, use for every seed.

    Raises:
        UserError: in single precision, for a site in degrees or at a pole, or if a break of the trajectory
            falls inside an IMU sample.
    """
    require_x64()
    checks.check_site(scenario.name, *(float(x) for x in (scenario.site.lat, scenario.site.lon, scenario.site.h)))
    for time in scenario.trajectory.breaks:
        sample = time * scenario.imu_rate
        if 0 < time < scenario.duration and abs(sample - round(sample)) > 1e-6:
            raise UserError(
                f"trajectory: its slope jumps at {time:g} s, inside an IMU sample; choose an imu_rate (now "
                f"{scenario.imu_rate:g} Hz) of which {time:g} s is a whole number of samples"
            )
    return jitted_increments(
        scenario.trajectory,
        scenario.site,
        1.0 / scenario.imu_rate,
        samples=scenario.samples,
        aid_every=scenario.aid_every,
    )


def source_keys(key: PRNGKeyArray) -> tuple[PRNGKeyArray, ...]:
    """Keys of gyroscopes, accelerometers, disturbance, aid noise and faults.

    Each source has its own, so that switching one on leaves the draws of the others alone.
    """
    return tuple(fold(key, i) for i in range(5))


def imu_increments(
    truth: Truth, scenario: Scenario, key: PRNGKeyArray
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Measured rotation (rad) and velocity (m/s) increments of one run. Pure; `vmap` it over keys."""
    gyro, accel, force, _, _ = source_keys(key)
    samples = truth.dtheta.shape[0]
    dtheta = truth.dtheta + scenario.gyro.increments(gyro, samples, truth.dt)
    dvel = truth.dvel + scenario.accel.increments(accel, samples, truth.dt)
    if scenario.force is not None:
        dvel = dvel + scenario.force.increments(force, samples, truth.dt)
    return dtheta, dvel


def aid_velocity(truth: Truth, scenario: Scenario, key: PRNGKeyArray) -> Float[Array, "m 3 *runs"] | None:
    """Velocities of the aid (m/s) in one run, or in one run per key; NaN in gaps; None for a "static" one.

    Pure. The same draws as in `measure` with the same key.
    """
    if scenario.aid == "static":
        return None
    _, _, _, noise, faults = source_keys(key)
    exact = truth.velocity_b if scenario.aid == "body" else truth.velocity_n
    error = white(noise, exact.shape[0]) * scenario.aid_sd
    for i, fault in enumerate(scenario.faults):
        spoil = fault if key.ndim == 0 else jax.vmap(fault, (0, None, -1), -1)
        error = spoil(fold(faults, i), truth.t, error)
    return exact.reshape(*exact.shape, *(1 for _ in key.shape)) + error


def measure(
    truth: Truth, scenario: Scenario, key: PRNGKeyArray
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, "m 3"] | None]:
    """One run of the sensors: (dtheta rad, dvel m/s, velocity m/s or None).

    Pure: `jit` it with the truth and the scenario as arguments, `vmap` it over keys, differentiate it in any
    leaf of the scenario's errors.
    """
    return (*imu_increments(truth, scenario, key), aid_velocity(truth, scenario, key))


def noiseless(scenario: Scenario) -> Scenario:
    """The same scenario with perfect sensors: no bias and no noise, hence no scaled outliers.

    Gaps, jumps and the disturbance of the base stay: they are not noise of a sensor. `aid_sd` becomes zero.
    """
    return eqx.tree_at(
        lambda s: (s.gyro, s.accel, s.aid_sd),
        scenario,
        (
            jax.tree.map(jnp.zeros_like, scenario.gyro),
            jax.tree.map(jnp.zeros_like, scenario.accel),
            jnp.zeros(()),
        ),
    )


_measure = eqx.filter_jit(measure)


def log_of(scenario: Scenario, truth: Truth, seed: int, noise: bool = True) -> Log:
    """The log of one run, with the true attitude as its reference.

    Args:
        scenario: what to simulate.
        truth: of this scenario, from `truth`.
        seed: of the run.
        noise: False for perfect sensors, see `noiseless`; the log's `aid_sd` is the nominal one all the same.

    Raises:
        UserError: if the seed is not a whole number, or the truth is of another length or rate.
    """
    choice(noise, "noise", (True, False))
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)):
        raise UserError(f"seed: must be a whole number, got {seed!r}")
    if not 0 <= seed < 2**63:
        raise UserError(f"seed: must be from 0 to 2^63 - 1, got {seed}")
    if truth.dtheta.shape[0] != scenario.samples or truth.aid_every != scenario.aid_every:
        raise UserError(
            f"truth: {truth.dtheta.shape[0]} samples in epochs of {truth.aid_every} do not belong to "
            f"scenario {scenario.name!r} ({scenario.samples} in epochs of {scenario.aid_every}); use truth()"
        )
    dtheta, dvel, velocity = _measure(truth, scenario if noise else noiseless(scenario), jax.random.key(int(seed)))
    return Log(
        dtheta=np.asarray(dtheta),
        dvel=np.asarray(dvel),
        dt=1.0 / scenario.imu_rate,
        aid_every=scenario.aid_every,
        aid=scenario.aid,
        velocity=None if velocity is None else np.asarray(velocity),
        lat=float(scenario.site.lat),
        lon=float(scenario.site.lon),
        h=float(scenario.site.h),
        aid_sd=float(scenario.aid_sd) or None,
        C_nb=np.asarray(truth.C_nb),
        name=scenario.name,
    )
