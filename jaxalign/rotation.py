"""Rotations as arrays: quaternions ``(..., 4)``, rotation vectors and Euler angles ``(..., 3)``, DCMs ``(..., 3, 3)``.

The algebra itself lives in :mod:`jaxalign.vector` (on components, for the recursions); these functions are its
face for people. Hamilton quaternions, scalar first, ``q_ab`` maps b into a. Euler angles are (pitch, roll, yaw)
in rad of ``C_nb = Rz(yaw) Rx(pitch) Ry(roll)``, n = East-North-Up, b = right-forward-up, yaw counter-clockwise;
``heading`` is clockwise from north. Everything is differentiable, also at the identity.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxalign.vector import Quat, Vec3

__all__ = [
    "attitude_error",
    "dcm_from_euler",
    "dcm_from_quat",
    "euler_covariance",
    "euler_from_dcm",
    "euler_from_quat",
    "heading_deg",
    "quat_conjugate",
    "quat_from_dcm",
    "quat_from_euler",
    "quat_from_rotvec",
    "quat_multiply",
    "quat_rotate",
    "rotvec_from_quat",
]


def quat_multiply(p: Float[ArrayLike, "*s 4"], q: Float[ArrayLike, "*s 4"]) -> Float[Array, "*s 4"]:
    """Quaternion product ``p q``: ``q_ab q_bc = q_ac``."""
    return (Quat.of(p) * Quat.of(q)).array


def quat_conjugate(q: Float[ArrayLike, "*s 4"]) -> Float[Array, "*s 4"]:
    """The inverse of a unit quaternion."""
    return Quat.of(q).conjugate().array


def quat_rotate(q: Float[ArrayLike, "*s 4"], v: Float[ArrayLike, "*s 3"]) -> Float[Array, "*s 3"]:
    """Map a vector: ``q_ab`` takes components in b to components in a."""
    return Quat.of(q).rotate(Vec3.of(v)).array


def quat_from_rotvec(rotvec: Float[ArrayLike, "*s 3"]) -> Float[Array, "*s 4"]:
    """Quaternion of a rotation vector (rad)."""
    return Quat.exp(Vec3.of(rotvec)).array


def rotvec_from_quat(q: Float[ArrayLike, "*s 4"]) -> Float[Array, "*s 3"]:
    """Rotation vector (rad, length at most pi) of a unit quaternion."""
    return Quat.of(q).log().array


def dcm_from_quat(q: Float[ArrayLike, "*s 4"]) -> Float[Array, "*s 3 3"]:
    """Direction cosine matrix of a unit quaternion."""
    return Quat.of(q).matrix.array


def quat_from_dcm(dcm: Float[ArrayLike, "*s 3 3"]) -> Float[Array, "*s 4"]:
    """Unit quaternion (scalar part >= 0) of a direction cosine matrix.

    Of the four ways to extract it, the one with the largest pivot is taken, so that no case divides by a small
    number (Shepperd's method).
    """
    m = jnp.asarray(dcm)
    a, b, c = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    candidates = jnp.stack(
        [
            jnp.stack([1 + a + b + c, wx, wy, wz], -1),
            jnp.stack([wx, 1 + a - b - c, xy, xz], -1),
            jnp.stack([wy, xy, 1 - a + b - c, yz], -1),
            jnp.stack([wz, xz, yz, 1 - a - b + c], -1),
        ],
        axis=-2,
    )
    pivots = jnp.stack([1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c], -1)
    best = jnp.argmax(pivots, axis=-1)[..., None, None]
    q = jnp.take_along_axis(candidates, best, axis=-2)[..., 0, :]
    return Quat.of(q).unit().positive().array


def dcm_from_euler(euler: Float[ArrayLike, "*s 3"]) -> Float[Array, "*s 3 3"]:
    """C_nb of (pitch, roll, yaw) in rad."""
    return dcm_from_quat(quat_from_euler(euler))


def quat_from_euler(euler: Float[ArrayLike, "*s 3"]) -> Float[Array, "*s 4"]:
    """q_nb of (pitch, roll, yaw) in rad."""
    half = jnp.asarray(euler) / 2
    c, s = Vec3.of(jnp.cos(half)), Vec3.of(jnp.sin(half))
    zero = jnp.zeros_like(c.x)
    return (Quat(c.z, zero, zero, s.z) * Quat(c.x, s.x, zero, zero) * Quat(c.y, zero, s.y, zero)).array


def euler_from_dcm(dcm: Float[ArrayLike, "*s 3 3"]) -> Float[Array, "*s 3"]:
    """(pitch, roll, yaw) in rad of C_nb; at a pitch of +-90 deg only together are roll and yaw determined.

    Yaw is read after roll has been turned back, so that the three give C_nb back at every pitch.
    """
    m = jnp.asarray(dcm)
    flat = m[..., 2, 0] ** 2 + m[..., 2, 2] ** 2
    level = flat > 0
    cos_pitch = jnp.where(level, jnp.sqrt(jnp.where(level, flat, 1.0)), 0.0)
    pitch = jnp.arctan2(m[..., 2, 1], cos_pitch)
    roll = jnp.arctan2(-m[..., 2, 0], jnp.where(level, m[..., 2, 2], 1.0))
    c, s = jnp.cos(roll)[..., None], jnp.sin(roll)[..., None]
    east = m[..., :2, 0] * c + m[..., :2, 2] * s  # first column of C_nb Ry(roll)^T = Rz(yaw) Rx(pitch)
    yaw = jnp.arctan2(east[..., 1], east[..., 0])
    return jnp.stack([pitch, roll, yaw], axis=-1)


def euler_from_quat(q: Float[ArrayLike, "*s 4"]) -> Float[Array, "*s 3"]:
    """(pitch, roll, yaw) in rad of q_nb."""
    return euler_from_dcm(dcm_from_quat(q))


def euler_covariance(q_nb: Float[ArrayLike, "*s 4"], covariance: Float[ArrayLike, "*s 3 3"]) -> Float[Array, "*s 3 3"]:
    """Covariance of pitch, roll and yaw (rad^2), to first order, from that of the attitude error in n."""

    def one(q, phi):
        return euler_from_quat((Quat.exp(Vec3.of(phi)) * Quat.of(q)).array)

    q = jnp.asarray(q_nb)
    slope = jax.vmap(jax.jacfwd(one, argnums=1), (0, None))(q.reshape(-1, 4), jnp.zeros(3)).reshape(*q.shape[:-1], 3, 3)
    return slope @ jnp.asarray(covariance) @ jnp.swapaxes(slope, -1, -2)


def heading_deg(yaw: Float[ArrayLike, "*s"]) -> Float[Array, "*s"]:
    """Heading, clockwise from north, 0 <= heading < 360 deg, of a yaw in rad."""
    heading = jnp.mod(-jnp.rad2deg(yaw), 360.0)
    return jnp.where(heading >= 360.0, 0.0, heading)  # mod of a tiny negative number rounds to 360


def attitude_error(q_est: Float[ArrayLike, "*s 4"], q_true: Float[ArrayLike, "*s 4"]) -> Float[Array, "*s 3"]:
    """Error phi (rad, in n: east, north, up) with ``C_est = exp(-[phi x]) C_true``.

    To first order this is the ``C_est = (I - [phi x]) C_true`` of the literature; the logarithm keeps it exact
    for large errors and without the floor of ``arccos`` of a trace.
    """
    return -(Quat.of(q_est) * Quat.of(q_true).conjugate()).log().array
