"""Strapdown navigation in the frozen frame n0 from a start that is guessed, and its errors to first order.

The velocity over the Earth, turned into n0, obeys ``v' = C_n0b f + C_n0n g - w_ie x v`` with w_ie constant there. The
errors (truth minus guess) are twelve, in this order:

    tilt    C_n0b = (I + [tilt x]) C_n0b of the guess; rad, n0
    speed   of v, m/s, n0
    gyro    bias of the gyroscopes, rad/s, b
    accel   bias of the accelerometers, m/s^2, b

and over an interval with C, its velocity increment in n0 ``d = C dv``, and M = C half way:

    tilt  <- tilt - M dt gyro
    speed <- speed + tilt x d - M dt accel + d x (M dt gyro) / 2 - w_ie dt x speed

What an error of the velocity does to the place, to the transport rate and to gravity is left out (1e-5 rad for 60 m).
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.epochs import Epochs
from jaxalign.observe.frames import Place, gravity_impulse, turn
from jaxalign.preintegrate import Increment
from jaxalign.vector import Quat, Vec3

__all__ = ["ACCEL", "GYRO", "SPEED", "STATES", "TILT", "UNKNOWN", "Guess", "Path", "back", "forth", "navigated", "skew"]

TILT, SPEED, GYRO, ACCEL = (slice(3 * i, 3 * i + 3) for i in range(4))
STATES = 12
UNKNOWN = np.pi / np.sqrt(3.0)
"""rad: an angle of which nothing is known is uniform over a turn."""


class Guess(eqx.Module):
    """Where the navigation starts.

    Attributes:
        attitude: q_n0b0.
        velocity: at the first epoch, m/s, n0.
        gyro: bias, rad/s, b.
        accel: bias, m/s^2, b.
    """

    attitude: Quat
    velocity: Vec3
    gyro: Vec3
    accel: Vec3

    @classmethod
    def of(cls, attitude: Quat, velocity: Vec3) -> Guess:
        """Without biases."""
        return cls(attitude, velocity, Vec3.zero(), Vec3.zero())

    def moved(self, error: Float[Array, " 12"]) -> Guess:
        """With an error taken in."""
        return Guess(
            (Quat.exp(Vec3.of(error[TILT])) * self.attitude).unit(),
            self.velocity + Vec3.of(error[SPEED]),
            self.gyro + Vec3.of(error[GYRO]),
            self.accel + Vec3.of(error[ACCEL]),
        )


class Path(eqx.Module):
    """The guessed motion at the epochs, and how errors pass from each to the next: leaves with a first axis of epochs.

    Attributes:
        q_n0b: attitude.
        q_n0n: of n.
        velocity: m/s, n0.
        impulse: C dv of the interval before the epoch, m/s, n0.
        turned: (K, 3, 3) M dt of that interval.
        spin: (3,) w_ie dt of it, n0.
        dt: s.
    """

    q_n0b: Quat
    q_n0n: Quat
    velocity: Vec3
    impulse: Vec3
    turned: Float[Array, "K 3 3"]
    spin: Vec3
    dt: Float[Array, " K"]

    def until(self, last: Any) -> Path:
        """Nothing happens after the epoch ``last``."""
        on = jnp.arange(self.dt.shape[0]) <= last
        impulse, spin, dt = jax.tree.map(lambda x: jnp.where(on, x, 0.0), (self.impulse, self.spin, self.dt))
        turned = jnp.where(on[:, None, None], self.turned, 0.0)
        return Path(self.q_n0b, self.q_n0n, self.velocity, impulse, turned, spin, dt)


class _State(eqx.Module):
    q_n0b: Quat
    q_n0n: Quat
    velocity: Vec3
    place: Place


def navigated(epochs: Epochs, guess: Guess) -> Path:
    """Navigate from a guess."""
    start = Place.of(epochs.site)
    w_ie = start.earth_rate

    def step(s: _State, epoch: Any) -> tuple[_State, Path]:
        dt = epoch.dt
        moved = Increment(epoch.rotation, epoch.dvel).corrected(guess.gyro, guess.accel, dt)
        impulse = s.q_n0b.rotate(moved.dvel)
        down = s.q_n0n.rotate(Vec3(0.0 * dt, 0.0 * dt, -s.place.gravity * dt))
        middle = s.velocity + (impulse + down) * 0.5
        mean = s.q_n0n.conjugate().rotate(middle)
        half = s.place.moved(mean, 0.5 * dt)
        rate = half.earth_rate + half.transport_rate(mean)
        fallen = s.q_n0n.rotate(gravity_impulse(rate, s.place.gravity, dt))
        velocity = s.velocity + impulse + fallen - w_ie.cross(middle) * dt
        q_n0b = (s.q_n0b * moved.rotation).renormalised()
        q_n0n = turn(s.q_n0n, rate, dt)
        turned = (s.q_n0b * Quat.turn(moved.rotation.log() * 0.5)).matrix.array * dt
        row = Path(q_n0b, q_n0n, velocity, impulse, turned, w_ie * dt, dt)
        return _State(q_n0b, q_n0n, velocity, s.place.moved(mean, dt)), row

    state = _State(guess.attitude, Quat.identity(), guess.velocity, start)
    return jax.lax.scan(step, state, epochs.rows)[1]


def skew(v: Vec3) -> Float[Array, "3 3"]:
    """[v x]."""
    zero = jnp.zeros_like(v.x)
    return jnp.stack([jnp.stack([zero, -v.z, v.y]), jnp.stack([v.z, zero, -v.x]), jnp.stack([-v.y, v.x, zero])])


def _times(m: Any, rows: Any) -> Any:
    """A 3x3 matrix times three rows: three sums that fuse, where a dot of this size would not."""
    return sum(m[:, i].reshape(3, *[1] * (rows.ndim - 1)) * rows[i] for i in range(3))


def forth(row: Path, x: Array) -> Array:
    """Errors (n,), or columns of them (n, n), at the epoch of a row from those at the one before it.

    What is beyond twelve stays.
    """
    d, m = skew(row.impulse), row.turned
    gyro = _times(m, x[GYRO])
    tilt = x[TILT] - gyro
    speed = x[SPEED] - _times(d, x[TILT] - 0.5 * gyro) - _times(m, x[ACCEL]) - _times(skew(row.spin), x[SPEED])
    return jnp.concatenate([tilt, speed, x[6:]])


def back(row: Path, r: Float[Array, " 12"]) -> Float[Array, " 12"]:
    """The transpose of :func:`forth`."""
    d, m = skew(row.impulse), row.turned
    across = _times(d.T, r[SPEED])
    tilt = r[TILT] - across
    speed = r[SPEED] - _times(skew(row.spin).T, r[SPEED])
    gyro = r[GYRO] - _times(m.T, r[TILT] - 0.5 * across)
    accel = r[ACCEL] - _times(m.T, r[SPEED])
    return jnp.concatenate([tilt, speed, gyro, accel, r[12:]])
