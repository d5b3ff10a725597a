"""The turning of gravity in inertial space, as a vehicle at rest sees it that sways.

The gyroscopes carry the specific force to the axes at the beginning; there its integral is
V(t) = g (u t + u' t^2 / 2 + u'' t^3 / 6) with u' = w x u and u'' = w x (w x u), where w is the Earth's rotation. A
cubic fitted to V gives w across gravity from u', and along it from u'' (it takes minutes). Sways come back and leave
little.
"""

from __future__ import annotations

import numpy as np

from jaxalign.plausibility import rotations

__all__ = ["turning_of_gravity"]

_LONGEST = 900.0  # s: the next term is then w t / 4 = 2 % of the last
_PIECE = 1.0  # s
_LEAST = 60.0


def turning_of_gravity(dtheta: np.ndarray, dvel: np.ndarray, dt: float) -> tuple[float, float, float]:
    """Rate of the Earth along and across the specific force, rad/s, and the larger of their standard errors.

    Args:
        dtheta: (N, 3) rotation increments, rad.
        dvel: (N, 3) velocity increments, m/s.
        dt: s.

    Returns:
        The rates; an infinite error where the record is too short.
    """
    size = max(1, round(_PIECE / dt))
    count = min(len(dtheta), round(_LONGEST / dt)) // size
    if count * size * dt < _LEAST:
        return 0.0, 0.0, np.inf
    turn, change = _pieces(dtheta[: count * size], dvel[: count * size], size)
    frame, total = np.eye(3), np.zeros((count + 1, 3))
    for k in range(count):
        total[k + 1] = total[k] + frame @ change[k]
        frame = frame @ turn[k]
    span = count * size * dt
    t = np.linspace(0.0, 1.0, count + 1)
    basis = t[:, None] ** np.arange(4)
    inverse = np.linalg.inv(basis.T @ basis)
    c = inverse @ (basis.T @ total)
    rest = total - basis @ c
    g = max(float(np.linalg.norm(c[1])), 1e-30)
    u, first, second = c[1] / g, 2.0 * c[2] / g / span, 6.0 * c[3] / g / span**2
    across = np.cross(u, first)
    size_across = max(float(np.linalg.norm(across)), 1e-30)
    along = float(second @ across) / size_across**2
    # residuals of neighbouring pieces are alike: fewer of them count
    alike = float((rest[1:] * rest[:-1]).sum() / max((rest**2).sum(), 1e-300))
    grows = (1.0 + max(alike, 0.0)) / max(1.0 - alike, 1e-6)
    sd = np.sqrt((rest**2).sum() / (3.0 * (count - 3)) * grows * np.diag(inverse))
    error = max(2.0 * sd[2] / g / span, 6.0 * sd[3] / g / span**2 / size_across)
    return along, size_across, float(error)


def _pieces(dtheta: np.ndarray, dvel: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (K, 3, 3) and velocity change (K, 3) of each piece of `size` samples, in its axes at its beginning."""
    angle, force = (x.reshape(-1, size, 3) for x in (dtheta, dvel))
    force = force + 0.5 * np.cross(angle, force)  # turning within a sample
    frame = np.broadcast_to(np.eye(3), (len(angle), 3, 3))
    total = np.zeros((len(angle), 3))
    for j in range(size):
        total = total + (frame @ force[:, j, :, None])[..., 0]
        frame = frame @ rotations(angle[:, j])
    return frame, total
