"""A scenario (trajectory, rates, sensor errors, aids, faults), its truth, and measurements per key.

`truth` (once) and `measure` (per key) are apart: a thousand runs share one truth, and `measure` is pure.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign import checks
from jaxalign.arguments import check_choice, whole_number
from jaxalign.earth import Site
from jaxalign.errors import UserError
from jaxalign.inertial_unit import ImuErrors
from jaxalign.log import Log
from jaxalign.measurements import Measurements
from jaxalign.precision import require_x64
from jaxalign.simulate.aid import SimulatedAid, values_of
from jaxalign.simulate.imu import Truth, jitted_increments
from jaxalign.simulate.imu_faults import AbstractImuFault
from jaxalign.simulate.random import fold
from jaxalign.simulate.sensors import BIAS_KINDS, BiasKind, SineForce, triad_increments
from jaxalign.simulate.trajectory import Trajectory

__all__ = ["Scenario", "aid_values", "imu_increments", "log_of", "measure", "noiseless", "truth"]

_IMU_FAULTS = 5  # what the key of a run is folded with to draw them; below are the sources
_MOST_SAMPLES = 2e7  # some 10 GB while the truth is made


class Scenario(eqx.Module):
    """All that a simulated log depends on, but the seed.

    Numbers are array leaves (replace them with `eqx.tree_at`); what sets shapes is static (replace it with
    `dataclasses.replace`).

    Attributes:
        trajectory: attitude and velocity.
        site: where the vehicle starts.
        imu: errors of the inertial unit.
        aids: each with its noise and faults; none: the vehicle stands.
        force: disturbance of a shaken base.
        imu_faults: of the inertial unit, applied in this order to what it measures, errors and disturbance included.
        bias: how a run draws its biases from ``imu``: "sign", "gaussian" or "fixed", see
            :func:`jaxalign.simulate.draw_bias`.
        duration: s, a whole number of epochs.
        imu_rate: Hz.
        epoch_samples: IMU samples per epoch.
        name: for messages and titles.
    """

    trajectory: Trajectory
    site: Site
    imu: ImuErrors = eqx.field(default_factory=ImuErrors)
    aids: tuple[SimulatedAid, ...] = ()
    force: SineForce | None = None
    imu_faults: tuple[AbstractImuFault, ...] = ()
    bias: BiasKind = eqx.field(static=True, default="sign")
    duration: float = eqx.field(default=300.0, static=True)
    imu_rate: float = eqx.field(default=200.0, static=True)
    epoch_samples: int = eqx.field(default=200, static=True)
    name: str = eqx.field(default="scenario", static=True)

    def __check_init__(self):
        check_choice("kind of bias", self.bias, BIAS_KINDS)
        names = [one.aid.name for one in self.aids]
        if twice := [name for name in names if names.count(name) > 1]:
            raise UserError(f"aids: two are called {twice[0]!r}: give them names of their own (name=...)")
        if not isinstance(self.imu_faults, tuple) or not all(isinstance(x, AbstractImuFault) for x in self.imu_faults):
            raise UserError(
                f"imu_faults: must be a tuple of faults of the inertial unit, got {self.imu_faults!r}; those of an aid "
                "go into its SimulatedAid"
            )
        if not 0 < self.imu_rate < np.inf:
            raise UserError(f"imu_rate: must be a positive number of Hz, got {self.imu_rate!r}")
        whole_number("epoch_samples", self.epoch_samples, of="IMU samples")
        if self.duration * self.imu_rate > _MOST_SAMPLES:
            raise UserError(
                f"duration: {self.duration:g} s at {self.imu_rate:g} Hz are more than {_MOST_SAMPLES:.0e} IMU samples"
            )
        epochs = self.duration * self.imu_rate / self.epoch_samples
        if not 1 <= epochs < np.inf or abs(epochs - round(epochs)) > 1e-6:
            raise UserError(
                f"duration: {self.duration:g} s are {epochs:g} epochs of {self.epoch_samples / self.imu_rate:g} s"
                ": it must be a whole number of epochs, at least one"
            )

    @property
    def standing(self) -> bool:
        """Whether there is no aid: the vehicle is taken to stand."""
        return not self.aids

    @property
    def samples(self) -> int:
        """Number N of IMU samples."""
        return self.epochs * self.epoch_samples

    @property
    def epochs(self) -> int:
        """Number M of epoch intervals."""
        return round(self.duration * self.imu_rate / self.epoch_samples)


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
        epoch_samples=scenario.epoch_samples,
    )


def source_keys(key: PRNGKeyArray) -> tuple[PRNGKeyArray, ...]:
    """Keys of gyroscopes, accelerometers, disturbance, noise and faults of the aids.

    Each source has its own, so that switching one on leaves the draws of the others alone.
    """
    return tuple(fold(key, i) for i in range(5))


def imu_increments(
    truth: Truth, scenario: Scenario, key: PRNGKeyArray
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Measured rotation (rad) and velocity (m/s) increments of one run. Pure; `vmap` it over keys."""
    gyro, accel, force, _, _ = source_keys(key)
    samples = truth.dtheta.shape[0]
    imu, kind = scenario.imu, scenario.bias
    dtheta = truth.dtheta + triad_increments(imu.gyro, kind, gyro, samples, truth.dt)
    dvel = truth.dvel + triad_increments(imu.accel, kind, accel, samples, truth.dt)
    if scenario.force is not None:
        dvel = dvel + scenario.force.increments(force, samples, truth.dt)
    if scenario.imu_faults:
        own = fold(key, _IMU_FAULTS)
        t = jnp.arange(1, samples + 1, dtype=jnp.float64) * truth.dt
        for i, fault in enumerate(scenario.imu_faults):
            dtheta, dvel = fault(fold(own, i), t, truth.dt, dtheta, dvel)
    return dtheta, dvel


def aid_values(
    truth: Truth, scenario: Scenario, key: PRNGKeyArray, which: tuple[int, ...] | None = None
) -> tuple[Float[Array, "m c *runs"], ...]:
    """What the aids measure at the epochs in one run, or in one run per key; NaN where there is no value.

    Pure. The same draws as in `measure` with the same key.

    Args:
        truth: of the scenario.
        scenario: with the aids.
        key: of a run, or (runs,) of them.
        which: of the aids; None: all.
    """
    _, _, _, noise, faults = source_keys(key)
    chosen = tuple(range(len(scenario.aids))) if which is None else which
    return values_of(scenario.aids, truth, noise, faults, chosen)


def measure(
    truth: Truth, scenario: Scenario, key: PRNGKeyArray
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"], tuple[Float[Array, "m c"], ...]]:
    """One run of the sensors: (dtheta rad, dvel m/s, values of each aid at the epochs).

    Pure: `jit` it with the truth and the scenario as arguments, `vmap` it over keys, differentiate it in any
    leaf of the scenario's errors.
    """
    return (*imu_increments(truth, scenario, key), aid_values(truth, scenario, key))


def noiseless(scenario: Scenario) -> Scenario:
    """A scenario with perfect sensors: no bias and no noise, hence no scaled outliers.

    Gaps, jumps, the disturbance of the base and faults of the inertial unit stay: they are not noise of a sensor. The
    `sd` of the aids becomes zero.
    """
    perfect = jax.tree.map(jnp.zeros_like, scenario.imu)
    aids = tuple(one.perfect for one in scenario.aids)
    return eqx.tree_at(lambda s: (s.imu, s.aids), scenario, (perfect, aids))


_measure = eqx.filter_jit(measure)


def log_of(scenario: Scenario, truth: Truth, seed: int, noise: bool = True) -> Log:
    """The log of one run, with the true attitude as its reference.

    Args:
        scenario: what to simulate.
        truth: of this scenario, from `truth`.
        seed: of the run.
        noise: False for perfect sensors, see `noiseless`; the log states the nominal `sd` all the same.

    Raises:
        UserError: if the seed is not a whole number, or the truth is of another length or rate.
    """
    check_choice("noise", noise, (True, False))
    whole_number("seed", seed, 0, 2**63 - 1)
    if truth.dtheta.shape[0] != scenario.samples or truth.epoch_samples != scenario.epoch_samples:
        raise UserError(
            f"truth: {truth.dtheta.shape[0]} samples in epochs of {truth.epoch_samples} do not belong to "
            f"scenario {scenario.name!r} ({scenario.samples} in epochs of {scenario.epoch_samples}); use truth()"
        )
    dtheta, dvel, values = _measure(truth, scenario if noise else noiseless(scenario), jax.random.key(int(seed)))
    aids = []
    for one, value in zip(scenario.aids, values, strict=True):
        stride = scenario.epoch_samples * one.stride
        own = np.asarray(value)[:: one.stride]
        time = np.arange(len(own)) * stride / scenario.imu_rate
        sd = np.asarray(one.sd)
        aids.append(Measurements(one.aid, time, own, sd if (sd > 0).all() else None))
    return Log(
        dtheta=np.asarray(dtheta),
        dvel=np.asarray(dvel),
        dt=1.0 / scenario.imu_rate,
        epoch_samples=scenario.epoch_samples,
        aids=tuple(aids),
        lat=float(scenario.site.lat),
        lon=float(scenario.site.lon),
        h=float(scenario.site.h),
        C_nb=np.asarray(truth.C_nb),
        name=scenario.name,
    )
