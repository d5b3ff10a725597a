"""Attitudes on the host, in NumPy: what people read of a solution must not cost a compilation.

The conventions, and the names, are those of :mod:`jaxalign.rotation`, which does the same in traced code.
"""

from __future__ import annotations

import numpy as np

from jaxalign.vector import Quat

__all__ = [
    "attitude_error",
    "dcm_from_quat",
    "euler_covariance",
    "euler_from_quat",
    "heading_deg",
    "quat_from_dcm",
]


def _quat(q: np.ndarray) -> Quat:
    return Quat(*np.moveaxis(np.asarray(q), -1, 0))


def dcm_from_quat(q: np.ndarray) -> np.ndarray:
    """Direction cosine matrices (..., 3, 3) of unit quaternions (..., 4)."""
    m = _quat(q).matrix
    return np.stack([np.stack([row.x, row.y, row.z], -1) for row in (m.r0, m.r1, m.r2)], -2)


def euler_from_quat(q_nb: np.ndarray) -> np.ndarray:
    """(pitch, roll, yaw) in rad (..., 3) of q_nb (..., 4)."""
    m = dcm_from_quat(q_nb)
    pitch = np.arctan2(m[..., 2, 1], np.hypot(m[..., 2, 0], m[..., 2, 2]))
    roll = np.arctan2(-m[..., 2, 0], m[..., 2, 2])
    c, s = np.cos(roll)[..., None], np.sin(roll)[..., None]
    east = m[..., :2, 0] * c + m[..., :2, 2] * s  # yaw after roll has been turned back: right at every pitch
    return np.stack([pitch, roll, np.arctan2(east[..., 1], east[..., 0])], axis=-1)


def euler_covariance(q_nb: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Covariance (..., 3, 3) of pitch, roll and yaw (rad^2), to first order, from that of the attitude error in n."""
    pitch, _, yaw = np.moveaxis(euler_from_quat(q_nb), -1, 0)
    zero, one = np.zeros_like(pitch), np.ones_like(pitch)
    east, north = np.cos(yaw), np.sin(yaw)  # of the axis of pitch
    c, s = np.cos(pitch), np.sin(pitch)
    # A small turn in n is d pitch about that axis, d roll about (-c north, c east, s), d yaw about the vertical.
    slope = np.stack([east, north, zero, -north / c, east / c, zero, north * s / c, -east * s / c, one], axis=-1)
    slope = slope.reshape(*pitch.shape, 3, 3)
    return slope @ np.asarray(covariance) @ np.swapaxes(slope, -1, -2)


def heading_deg(yaw: np.ndarray) -> np.ndarray:
    """Heading, clockwise from north, 0 <= heading < 360 deg, of a yaw in rad."""
    heading = np.mod(-np.rad2deg(yaw), 360.0)
    return np.where(heading >= 360.0, 0.0, heading)  # mod of a tiny negative number rounds to 360


def quat_from_dcm(dcm: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) of direction cosine matrices (..., 3, 3), by Shepperd's method; either sign."""
    m = np.asarray(dcm)
    trace = np.trace(m, axis1=-2, axis2=-1)
    # K = 4 q q^T - I of a rotation: its row with the largest diagonal, plus one there, is along q.
    k = np.empty((*trace.shape, 4, 4))
    k[..., 0, 0] = trace
    k[..., 1:, 1:] = m + np.swapaxes(m, -1, -2) - trace[..., None, None] * np.eye(3)
    for i, j, n in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        k[..., 0, n + 1] = k[..., n + 1, 0] = m[..., j, i] - m[..., i, j]
    best = np.argmax(np.diagonal(k, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(k + np.eye(4), best[..., None, None], axis=-2)[..., 0, :]
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def attitude_error(q_est: np.ndarray, q_true: np.ndarray) -> np.ndarray:
    """Error phi (..., 3), rad, in n, with ``C_est = exp(-[phi x]) C_true``, of quaternions (..., 4)."""
    q = _quat(q_est) * _quat(q_true).conjugate()
    v = np.stack([q.x, q.y, q.z], axis=-1) * np.where(q.w < 0, -1.0, 1.0)[..., None]
    size = np.linalg.norm(v, axis=-1)
    angle = 2.0 * np.arctan2(size, np.abs(q.w))
    return -v * np.divide(angle, size, out=np.full_like(size, 2.0), where=size > 0)[..., None]
