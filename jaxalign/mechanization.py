"""Strapdown mechanisation: attitude, velocity and position over the Earth (WGS-84), as one pure step.

n is the local East-North-Up. Midpoint values of all that changes slowly (Earth and transport rate, gravity, Coriolis)
by two passes per interval; the velocity increment is turned with the mean rotation of n. Position by the trapezoid of
the velocity: second order in the interval, so navigate a moving vehicle on short intervals (two IMU samples).
Source: the psi-angle mechanisation of the Vondrak paper, Fig. 1; Savage's two-speed form with one speed.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxalign.earth import Site, earth_rate, normal_gravity, radii, transport_rate
from jaxalign.epochs import Epoch, Epochs
from jaxalign.precision import require_x64
from jaxalign.preintegration import Increment
from jaxalign.vector import Quat, Vec3, mean_rotated

__all__ = ["NavState", "advance", "displacement", "navigate"]


class NavState(eqx.Module):
    """Where the vehicle is and how it moves; leaves may have a leading axis.

    Attributes:
        q_nb: attitude.
        velocity: over the Earth, m/s, n.
        lat: rad.
        lon: rad.
        h: m.
    """

    q_nb: Quat
    velocity: Vec3
    lat: Float[Array, "*s"]
    lon: Float[Array, "*s"]
    h: Float[Array, "*s"]

    @classmethod
    def at(cls, site: Site, q_nb: Quat, velocity: Vec3 | None = None) -> NavState:
        """At a place, with an attitude; standing unless a velocity (m/s, n) is given."""
        return cls(q_nb, Vec3.zero() if velocity is None else velocity, site.lat, site.lon, site.h)


def advance(state: NavState, increment: Increment, dt: Any, anomaly: Any = 0.0, held: bool = False) -> NavState:
    """The state after one interval. Pure.

    Args:
        state: at its start.
        increment: rotation and velocity increment (m/s, in b at its start) of the interval.
        dt: its length, s.
        anomaly: local gravity minus normal gravity, m/s^2.
        held: keep the position (a standing vehicle, whose position is known better than its velocity integrates).
    """
    force = state.q_nb.rotate(increment.dvel)

    def middle(after: Vec3) -> tuple[Vec3, Any, Any]:
        """Mean velocity, and latitude and height at the middle of the interval."""
        v = (state.velocity + after) * 0.5
        if held:
            return v, state.lat, state.h
        meridian, _ = radii(state.lat)
        return v, state.lat + 0.5 * dt * v.y / (meridian + state.h), state.h + 0.5 * dt * v.z

    after = state.velocity
    for _ in range(2):
        v, lat, h = middle(after)
        w_ie, w_en = earth_rate(lat), transport_rate(lat, h, v)
        turn = (w_ie + w_en) * (-dt)
        down = Vec3(0.0 * dt, 0.0 * dt, -(normal_gravity(lat, h) + anomaly))
        after = state.velocity + mean_rotated(turn, force) + (down - (w_ie * 2.0 + w_en).cross(v)) * dt
    q_nb = (Quat.turn(turn) * state.q_nb * increment.rotation).renormalised()
    if held:
        return NavState(q_nb, after, state.lat, state.lon, state.h)
    v, lat, h = middle(after)
    meridian, prime_vertical = radii(lat)
    return NavState(
        q_nb,
        after,
        state.lat + dt * v.y / (meridian + h),
        state.lon + dt * v.x / ((prime_vertical + h) * jnp.cos(lat)),
        state.h + dt * v.z,
    )


def displacement(state: NavState, site: Site) -> Vec3:
    """From a place to the state's, m, in n."""
    meridian, prime_vertical = radii(site.lat)
    return Vec3(
        (state.lon - site.lon) * (prime_vertical + site.h) * jnp.cos(site.lat),
        (state.lat - site.lat) * (meridian + site.h),
        state.h - site.h,
    )


def navigate(
    epochs: Epochs, start: NavState, gyro_bias: ArrayLike | None = None, accel_bias: ArrayLike | None = None
) -> NavState:
    """Navigate from the start of the epochs to their end, by the inertial unit alone; pure: vmap and differentiate it.

    Args:
        epochs: of :func:`jaxalign.epochs_from_log`; their aid is not used. Use short ones: ``interval_samples=2``.
        start: state at epoch 0.
        gyro_bias: to be taken out of the increments, rad/s, b, (3,); ``Solution.filter.gyro_bias[-1]``.
        accel_bias: likewise, m/s^2.

    Returns:
        States at the epochs, leaves of shape (M+1,).

    Raises:
        UserError: float32.
    """
    require_x64(epochs, start)

    gyro, accel = (Vec3.zero() if b is None else Vec3.of(b) for b in (gyro_bias, accel_bias))

    def step(state: NavState, row: Epoch) -> tuple[NavState, NavState]:
        increment = Increment(row.rotation, row.dvel).corrected(gyro, accel, row.dt)
        state = advance(state, increment, row.dt, epochs.site.anomaly)
        return state, state

    return jax.lax.scan(step, start, epochs.rows)[1]
