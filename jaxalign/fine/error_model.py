"""The psi-angle error model of inertial navigation near rest: 15 states.

Order: dr, dv, psi (east, north, up), accelerometer bias, gyro bias (b); errors are estimate minus truth, with
C_est = (I - [psi x]) C_true, and the biases are what the sensors still read too much:

    dr'  = -w_en x dr + dv
    dv'  = -(2 w_ie + w_en) x dv + f_n x psi + C_nb ba
    psi' = -(w_ie + w_en) x psi - C_nb bg

Source: the Vondrak paper (6)-(12). Deviations: C_nb in front of the biases, which is missing there; the signs of (7),
(8) are inconsistent if both biases are sensor errors, so psi' has - C_nb bg. As there, the gravity term (Schuler) is
dropped: good for an hour at rest.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.earth import earth_rate, transport_rate
from jaxalign.mechanization import NavState
from jaxalign.vector import Vec3

__all__ = ["ACCEL", "GYRO", "POSITION", "PSI", "STATES", "VELOCITY", "transition"]

POSITION, VELOCITY, PSI, ACCEL, GYRO = (slice(3 * i, 3 * i + 3) for i in range(5))
STATES = 15


def _skew(v: Vec3) -> Array:
    zero = jnp.zeros_like(v.x)
    return jnp.stack([jnp.stack([zero, -v.z, v.y]), jnp.stack([v.z, zero, -v.x]), jnp.stack([-v.y, v.x, zero])])


def transition(nav: NavState, force: Vec3, dt: Any) -> Float[Array, "15 15"]:
    """Transition matrix over an interval, to second order in its length.

    Args:
        nav: state at its start.
        force: mean specific force over it, m/s^2, n.
        dt: its length, s.
    """
    w_ie, w_en = earth_rate(nav.lat), transport_rate(nav.lat, nav.h, nav.velocity)
    c_nb = nav.q_nb.matrix.array
    a = jnp.zeros((STATES, STATES))
    a = a.at[POSITION, POSITION].set(-_skew(w_en)).at[POSITION, VELOCITY].set(jnp.eye(3))
    a = a.at[VELOCITY, VELOCITY].set(-_skew(w_ie * 2.0 + w_en)).at[VELOCITY, PSI].set(_skew(force))
    a = a.at[VELOCITY, ACCEL].set(c_nb)
    a = a.at[PSI, PSI].set(-_skew(w_ie + w_en)).at[PSI, GYRO].set(-c_nb)
    a = a * dt
    return jnp.eye(STATES) + a + 0.5 * a @ a
