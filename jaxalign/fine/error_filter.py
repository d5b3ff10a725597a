"""The error-state Kalman filter of fine alignment: closed loop, zero-velocity updates, one pure step per epoch."""

from __future__ import annotations

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.arguments import check_choice
from jaxalign.earth import Site, earth_rate, normal_gravity, radii
from jaxalign.epochs import Epoch
from jaxalign.fine.error_model import ACCEL, GYRO, POSITION, PSI, STATES, VELOCITY, transition
from jaxalign.inertial_unit import PER_SAMPLE, AccelErrors, GyroErrors, ImuErrors
from jaxalign.linear import solve_positive
from jaxalign.mechanization import NavState, advance, displacement
from jaxalign.parametrization import tunable
from jaxalign.preintegration import Increment
from jaxalign.vector import Quat, Vec3, mean_rotated

__all__ = ["ErrorFilter", "FilterRow", "FilterState"]


_UP = PSI.stop - 1


def _tactical() -> ImuErrors:
    """Table 3 of the Vondrak paper."""
    return ImuErrors(GyroErrors(0.1, 0.05 / 60), AccelErrors(50.0, 50.0))


def _turned(heading: Any, q_nb: Quat) -> Quat:
    """An attitude less the error psi_U of its heading (rad)."""
    zero = jnp.zeros_like(heading)
    return Quat.exp(Vec3(zero, zero, heading)) * q_nb


def _unturned(state: FilterState) -> tuple[Vec3, Float[Array, "15 15"]]:
    """Bias of the gyroscopes, and covariance, without what the error of the heading adds to it.

    A mechanisation whose heading is off by psi turns the Earth's rate w by more than the linear ``psi x w``: the rest,
    ``w_N psi^2 / 2`` southwards, is as constant as a bias, and the filter finds their sum.
    """
    w, zero = earth_rate(state.nav.lat).y, jnp.zeros_like(state.heading)
    north = state.q_nb.conjugate().rotate(Vec3(zero, w, zero))
    by_heading = jnp.eye(STATES).at[GYRO, _UP].set((north * state.heading).array)
    return state.gyro_bias + north * (0.5 * state.heading**2), by_heading @ state.covariance @ by_heading.T


class FilterState(eqx.Module):
    """What is carried from epoch to epoch.

    Attributes:
        nav: the mechanisation, corrected by all updates so far, but for ``heading``.
        heading: estimated error psi_U of its heading, rad, that is not taken out of it (``form="standing"``).
        gyro_bias: estimate, rad/s, b; it holds the square of ``heading`` too, see :func:`_unturned`.
        accel_bias: estimate, m/s^2, b.
        covariance: of the errors in the order of :mod:`jaxalign.fine.error_model`, SI.
        site: where the vehicle stands.
    """

    nav: NavState
    heading: Float[Array, ""]
    gyro_bias: Vec3
    accel_bias: Vec3
    covariance: Float[Array, "15 15"]
    site: Site

    @property
    def q_nb(self) -> Quat:
        """The attitude."""
        return _turned(self.heading, self.nav.q_nb)


class FilterRow(eqx.Module):
    """What an epoch yields.

    Attributes:
        q_nb: attitude.
        gyro_bias: rad/s, b.
        accel_bias: m/s^2, b.
        covariance: after the update.
        innovation: of the velocity (m/s, n), and of the position (m) where it is used; zero where there was no update.
        innovation_covariance: of these.
        updated: whether there was an update.
        nav: the mechanisation, for its velocity and place.
    """

    q_nb: Quat
    gyro_bias: Vec3
    accel_bias: Vec3
    covariance: Float[Array, "15 15"]
    innovation: Float[Array, " m"]
    innovation_covariance: Float[Array, "m m"]
    updated: Bool[Array, ""]
    nav: NavState


class ErrorFilter(eqx.Module):
    """15 error states about a strapdown mechanisation, fed back after every update (closed loop; see ``form``).

    The default numbers are the tactical unit of the Vondrak paper (Table 3) on a base shaken by some cm/s. The noise
    of the zero velocity stands for the motion of the base: with far too small a ``velocity_sd`` the standard deviations
    are too small. A low-passed force is coloured: then they are not honest either.

    Attributes:
        velocity_sd: noise of the zero velocity per axis, m/s.
        position_sd: noise of the zero displacement per axis, m (``updates="position"``).
        initial_position_sd: m.
        initial_velocity_sd: m/s.
        initial_tilt_sd_deg: of east and north, deg.
        initial_heading_sd_deg: deg.
        imu: errors of the inertial unit: standard deviations and random walk of its biases, and its white noise.
        updates: "velocity": zero velocity, the position held; "position": zero displacement from the start as well.
        form: "published": the measured force in f x psi, all errors fed back. On a shaken base both are wrong: that
            force holds the shaking which the innovations are made of, so the filter takes it for information that the
            heading is right as it is (5 deg off keep most of it after 20 s of 1 cm/s); and a correction of the heading
            that follows the velocity of one epoch turns the force of the next. "standing": gravity in f x psi, and the
            error of the heading is estimated but not fed back into the mechanisation, whose heading stays that of the
            coarse alignment. Its constant error of some degrees is harmless: what it adds to the Earth's rate is as
            constant as a bias of the gyroscopes, and its square is taken out of the bias that is given.

    Source: the Vondrak paper (13)-(20). Joseph's form instead of (19); (13)'s Z has the sign of estimate minus truth.
    "standing" is none of the papers'.
    """

    velocity_sd: Float[Array, ""] = tunable(0.01, unit="m/s", bounds=(1e-6, 10.0))
    position_sd: Float[Array, ""] = tunable(0.01, unit="m", bounds=(1e-6, 100.0))
    initial_position_sd: Float[Array, ""] = tunable(1e-3, unit="m", bounds=(0.0, 100.0))
    initial_velocity_sd: Float[Array, ""] = tunable(0.01, unit="m/s", bounds=(0.0, 10.0))
    initial_tilt_sd_deg: Float[Array, ""] = tunable(0.1, unit="deg", bounds=(0.0, 10.0))
    initial_heading_sd_deg: Float[Array, ""] = tunable(3.0, unit="deg", bounds=(0.0, 30.0))
    imu: ImuErrors = eqx.field(default_factory=_tactical, metadata={"hides": PER_SAMPLE})
    updates: Literal["velocity", "position"] = eqx.field(static=True, default="velocity")
    form: Literal["standing", "published"] = eqx.field(static=True, default="standing")

    def __check_init__(self):
        self.imu.check_densities()
        check_choice("form", self.form, ("standing", "published"))
        check_choice("updates", self.updates, ("velocity", "position"))

    @property
    def initial_covariance(self) -> Float[Array, "15 15"]:
        """P0, SI."""
        tilt, heading = jnp.deg2rad(self.initial_tilt_sd_deg), jnp.deg2rad(self.initial_heading_sd_deg)
        sd = [self.initial_position_sd] * 3 + [self.initial_velocity_sd] * 3 + [tilt, tilt, heading]
        biases = [jnp.broadcast_to(triad.bias, (3,)) for triad in (self.imu.accel, self.imu.gyro)]
        return jnp.diag(jnp.concatenate([jnp.stack(sd), *biases]) ** 2)

    def process_noise(self, c_nb: Float[Array, "3 3"]) -> Float[Array, "15 15"]:
        """Q per second, SI.

        Args:
            c_nb: attitude: white noise that differs from axis to axis acts in n turned by it.
        """
        white, triads = [], (self.imu.accel, self.imu.gyro)
        for triad in triads:
            square = jnp.broadcast_to(triad.density, (3,)) ** 2
            white.append(jnp.diag(square) if triad.density.ndim == 0 else (c_nb * square) @ c_nb.T)
        walks = [0.0 if triad.bias_walk is None else triad.bias_walk for triad in triads]
        wander = jnp.concatenate([jnp.broadcast_to(walk, (3,)) ** 2 for walk in walks])
        q = jnp.zeros((STATES, STATES)).at[VELOCITY, VELOCITY].set(white[0]).at[PSI, PSI].set(white[1])
        return q.at[ACCEL.start :, ACCEL.start :].set(jnp.diag(wander))

    def init(self, site: Site, q_nb: Quat, heading_sd: Any = 0.0) -> FilterState:
        """State at epoch 0.

        Args:
            site: where the vehicle stands.
            q_nb: attitude there, of any coarse alignment.
            heading_sd: of that attitude, rad, where it may be worse than the parameters say: added to theirs.
        """
        covariance = self.initial_covariance.at[_UP, _UP].add(jnp.asarray(heading_sd) ** 2)
        return FilterState(
            NavState.at(site, q_nb), jnp.zeros((), jnp.float64), Vec3.zero(), Vec3.zero(), covariance, site
        )

    def step(self, state: FilterState, epoch: Epoch) -> tuple[FilterState, FilterRow]:
        """Mechanise over one interval, then update with zero velocity. Pure: usable online and in a scan.

        ``epoch.velocity`` is the velocity measured at its end (m/s, n), zero for a standing vehicle; where not
        ``valid``, or at the first epoch, which has no interval, there is no update.
        """
        dt, held = epoch.dt, self.updates == "velocity"
        moved = Increment(epoch.rotation, epoch.dvel).corrected(state.gyro_bias, state.accel_bias, dt)
        started = dt > 0
        zero = jnp.zeros_like(dt)
        force = Vec3(zero, zero, normal_gravity(state.nav.lat, state.nav.h) + state.site.anomaly)
        if self.form == "published":
            turn = earth_rate(state.nav.lat) * (-dt)  # the mean over the interval, in an n that turns with the Earth
            force = mean_rotated(turn, state.nav.q_nb.rotate(moved.dvel)) * (1.0 / jnp.where(started, dt, 1.0))
        phi = transition(state.nav, force, dt)
        covariance = phi @ state.covariance @ phi.T + self.process_noise(state.nav.q_nb.matrix.array) * dt
        nav = advance(state.nav, moved, dt, state.site.anomaly, held)

        known = phi[:, _UP] * state.heading
        innovation = (nav.velocity - epoch.velocity).array
        variance = jnp.full(3, self.velocity_sd**2)
        h = jnp.zeros((3, STATES)).at[:, VELOCITY].set(jnp.eye(3))
        if not held:
            innovation = jnp.concatenate([innovation, displacement(nav, state.site).array])
            variance = jnp.concatenate([variance, jnp.full(3, self.position_sd**2)])
            h = jnp.concatenate([h, jnp.zeros((3, STATES)).at[:, POSITION].set(jnp.eye(3))])
        s = h @ covariance @ h.T + jnp.diag(variance)
        gain = solve_positive(s, h @ covariance).T
        updated = epoch.valid & started
        gain, innovation = gain * updated, (innovation - h @ known) * updated
        error = known + gain @ innovation
        keep = jnp.eye(STATES) - gain @ h
        covariance = keep @ covariance @ keep.T + gain @ (variance[:, None] * gain.T)
        covariance = 0.5 * (covariance + covariance.T)
        state = self._corrected(state, nav, error, covariance, held)
        gyro_bias, covariance = _unturned(state)
        row = FilterRow(state.q_nb, gyro_bias, state.accel_bias, covariance, innovation, s, updated, state.nav)
        return state, row

    def _corrected(self, state: FilterState, nav: NavState, error: Any, covariance: Any, held: bool) -> FilterState:
        """Feed the estimated errors back; see ``form`` for that of the heading."""
        heading = state.heading
        if self.form == "standing":
            heading, error = error[_UP], error.at[_UP].set(0.0)
        q_nb = (Quat.turn(Vec3.of(error[PSI])) * nav.q_nb).renormalised()
        velocity = nav.velocity - Vec3.of(error[VELOCITY])
        lat, lon, h = nav.lat, nav.lon, nav.h
        if not held:
            meridian, prime_vertical = radii(lat)
            lat = lat - error[1] / (meridian + h)
            lon = lon - error[0] / ((prime_vertical + h) * jnp.cos(lat))
            h = h - error[2]
        return FilterState(
            NavState(q_nb, velocity, lat, lon, h),
            heading,
            state.gyro_bias + Vec3.of(error[GYRO]),
            state.accel_bias + Vec3.of(error[ACCEL]),
            covariance,
            state.site,
        )
