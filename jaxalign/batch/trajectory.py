"""The nominal trajectory of the batch estimator: a state at every epoch, and its errors to first order.

Arrays of this room have the epochs on the first axis and *lanes* on the last: rows of one log, or runs. The errors
(truth minus nominal) are twelve, in this order, followed by the unknowns of the aid:

    tilt      C_n0b = (I + [tilt x]) C_n0b of the trajectory; rad, n0
    velocity  m/s, n0
    gyro      bias of the gyroscopes, rad/s, b
    accel     bias of the accelerometers, m/s^2, b

The velocity over the Earth, turned into n0, obeys ``v' = C_n0b f + C_n0n g - w_ie x v`` with w_ie constant there.
Each interval is mechanized from the state before it; what the result is off the state after it is the defect of that
interval (multiple shooting). So the noise of the unit never carries the trajectory away from the measurements, as it
does the path that is navigated from the first epoch alone.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.batch.rows import over_rows
from jaxalign.earth import Site
from jaxalign.epochs import Epoch
from jaxalign.preintegration import Increment
from jaxalign.propagation import Place, advance_nav
from jaxalign.vector import Quat, Vec3

__all__ = [
    "ACCEL",
    "GYRO",
    "STATES",
    "TILT",
    "UNKNOWN",
    "VELOCITY",
    "Intervals",
    "NominalTrajectory",
    "by_tilt",
    "mechanize",
]

TILT, VELOCITY, GYRO, ACCEL = (slice(3 * i, 3 * i + 3) for i in range(4))
STATES = 12
UNKNOWN = np.pi / np.sqrt(3.0)
"""rad: an angle of which nothing is known is uniform over a turn."""


class NominalTrajectory(eqx.Module):
    """Components of shape (K, L).

    Attributes:
        attitude: q_n0b.
        velocity: m/s, n0.
        gyro: bias, rad/s, b.
        accel: bias, m/s^2, b.
    """

    attitude: Quat
    velocity: Vec3
    gyro: Vec3
    accel: Vec3

    def moved(self, error: Float[Array, "K n L"]) -> NominalTrajectory:
        """With the errors of all epochs taken in."""
        tilt, velocity, gyro, accel = (
            Vec3(*(error[:, i] for i in range(s.start, s.stop))) for s in (TILT, VELOCITY, GYRO, ACCEL)
        )
        attitude = (by_tilt(tilt) * self.attitude).unit()
        return NominalTrajectory(attitude, self.velocity + velocity, self.gyro + gyro, self.accel + accel)

    def turned(self, angle: Any, velocity: bool) -> NominalTrajectory:
        """With the heading turned by an angle (rad), and the velocities with it if so wished."""
        about = Quat.exp(Vec3(0.0 * angle, 0.0 * angle, angle))
        v = about.rotate(self.velocity) if velocity else self.velocity
        return NominalTrajectory((about * self.attitude).unit(), v, self.gyro, self.accel)


class Intervals(eqx.Module):
    """The interval before each epoch: how errors pass over it, and its defect. Zero where nothing happens.

    Attributes:
        q_n0n: n at the epoch.
        turned: (K, 3, 3, L) C_n0b half way times dt, s.
        gained: (K, 3, L) velocity that the force gave by the velocities of the trajectory, m/s, n0.
        coupled: (K, 3, 3, L) ``[gained x] turned / 2``.
        spin: (K, 3, L) w_ie dt, n0.
        dt: (K, L) s.
        defect: (K, 12, L) mechanized minus nominal, as an error.
    """

    q_n0n: Quat
    turned: Float[Array, "K 3 3 L"]
    gained: Float[Array, "K 3 L"]
    coupled: Float[Array, "K 3 3 L"]
    spin: Float[Array, "K 3 L"]
    dt: Float[Array, "K L"]
    defect: Float[Array, "K 12 L"]


def _before(tree: Any) -> Any:
    """The values one epoch earlier; at the first epoch its own.

    Computed once: in reverse mode XLA would compute all that their derivatives come from again for each use of them.
    """
    return jax.lax.optimization_barrier(jax.tree.map(lambda x: jnp.concatenate([x[:1], x[:-1]]), tree))


def by_tilt(tilt: Vec3) -> Quat:
    """A turn by a tilt, exact to second order: what the errors of a linear problem need, and no trigonometry."""
    half = tilt * 0.5
    return _rescaled(Quat(1.0 + 0.0 * half.x, half.x, half.y, half.z))


def _rescaled(q: Quat) -> Quat:
    """Of unit norm. It ends in a division, which XLA computes once for all who use it."""
    norm = jnp.sqrt(q.norm2())
    return Quat(q.w / norm, q.x / norm, q.y / norm, q.z / norm)


def _stack(*vectors: Vec3) -> Array:
    """(K, 3 vectors, L)."""
    return jnp.stack(jnp.broadcast_arrays(*(c for v in vectors for c in (v.x, v.y, v.z))), axis=1)


def _over_the_earth(site: Site, velocity: Vec3, dt: Any) -> tuple[Vec3, Any]:
    """Rate of n (rad/s, n) and gravity (m/s^2) in each interval, for its mean velocity in n."""
    start = Place.of(site)
    meridian, _ = start.circle.radii
    moved = velocity.y * dt
    north = jnp.cumsum(moved, axis=0) - 0.5 * moved
    place = Place(start.circle.moved(north / (meridian + start.h)), start.h, start.anomaly)
    return place.earth_rate + place.transport_rate(velocity), place.gravity


def _turned_and_fallen(rate: Vec3, gravity: Any, dt: Any, length: Any) -> tuple[Quat, Vec3]:
    """N at the epochs, and what gravity gives in each interval, m/s, n0."""

    def step(q_n0n: Quat, row: Any) -> tuple[Quat, tuple[Quat, Vec3]]:
        rate, gravity, dt = row
        q_n0n, fallen = advance_nav(q_n0n, rate, gravity, dt)
        return q_n0n, (q_n0n, fallen)

    one = jax.tree.map(lambda x: x * jnp.ones(dt.shape[1:]), Quat.identity())
    return over_rows(step, one, (rate, gravity, dt), length, lambda: (one, one.vector))[1]


def mechanize(rows: Epoch, site: Site, at: NominalTrajectory, q_n0n: Quat, on: Any, length: Any = None) -> Intervals:
    """Mechanize every interval from the state before it.

    A tilt turns what the force gave by the velocities of the trajectory, not by the accelerometers: then turning the
    whole trajectory about the vertical leaves its defects as they are, whatever the noise, and noise tells no heading.
    What an error of the velocity does to the place, to the transport rate and to gravity is left out (1e-5 rad for
    60 m).

    Args:
        rows: leaves (K, L) or (K, 1).
        site: leaves (L,) or ().
        at: the trajectory.
        q_n0n: n at the epochs by an earlier trajectory: it tells the velocity in n and the direction of gravity. What
            it is off, some 1e-4 rad, the next one is not.
        on: (K, L) whether the interval before the epoch counts; where not, nothing happens.
        length: epochs that count in any lane, see :func:`jaxalign.batch.rows.over_rows`; None: all.
    """
    before = _before(at)
    dt = jnp.where(on, rows.dt, 0.0)
    w_ie = Place.of(site).earth_rate
    middle = (before.velocity + at.velocity) * 0.5
    n_before = _before(q_n0n)
    rate, gravity = _over_the_earth(site, n_before.conjugate().rotate(middle), dt)
    q_n0n, fallen = _turned_and_fallen(rate, gravity, dt, length)

    measured = Increment(rows.rotation, rows.dvel).corrected(before.gyro, before.accel, rows.dt)
    rotation = _rescaled(measured.rotation).positive()
    half = _rescaled(Quat(1.0 + rotation.w, rotation.x, rotation.y, rotation.z))
    matrix = (before.attitude * half).matrix
    turned = jnp.stack(
        [jnp.stack([r.x * dt, r.y * dt, r.z * dt], axis=1) for r in (matrix.r0, matrix.r1, matrix.r2)], 1
    )
    given = fallen - w_ie.cross(middle) * dt
    gained = at.velocity - before.velocity - given
    tilt = (before.attitude * rotation * at.attitude.conjugate()).positive().vector * 2.0
    velocity = before.attitude.rotate(measured.dvel) - gained
    gained, tilt, velocity = jax.tree.map(lambda x: jnp.where(on, x, 0.0), (gained, tilt, velocity))
    defect = _stack(tilt, velocity, before.gyro - at.gyro, before.accel - at.accel)
    gain = _stack(gained)
    coupled = 0.5 * jnp.stack([_cross(gain, turned[:, :, j]) for j in range(3)], axis=2)
    return Intervals(q_n0n, turned, gain, coupled, _stack(w_ie * dt), dt, jnp.where(on[:, None], defect, 0.0))


def _cross(a: Array, b: Array) -> Array:
    """Of the second axis."""
    x, y, z = a[:, 0], a[:, 1], a[:, 2]
    u, v, w = b[:, 0], b[:, 1], b[:, 2]
    return jnp.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
