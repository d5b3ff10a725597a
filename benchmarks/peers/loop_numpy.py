"""`oba` as a loop of NumPy calls over samples and epochs: what most of the field runs."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["align"]

EARTH_RATE, A, E2 = 7.292115e-5, 6378137.0, 0.00669437999014


def skew(v: Any) -> np.ndarray:
    """Cross-product matrix."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def expm(v: Any) -> np.ndarray:
    """Rotation matrix of a rotation vector."""
    a, k = np.linalg.norm(v), skew(v)
    if a < 1e-3:
        return np.eye(3) + k * (1 - a**2 / 6) + k @ k * (0.5 - a**2 / 24)
    return np.eye(3) + k * (np.sin(a) / a) + k @ k * ((1 - np.cos(a)) / a**2)


def mean_rotation(v: Any) -> np.ndarray:
    """Mean of exp([s v x]) over s from 0 to 1."""
    a, k = np.linalg.norm(v), skew(v)
    if a < 1e-3:
        return np.eye(3) + k * (0.5 - a**2 / 24) + k @ k * (1 / 6 - a**2 / 120)
    return np.eye(3) + k * ((1 - np.cos(a)) / a**2) + k @ k * ((a - np.sin(a)) / a**3)


def rates(lat: float, h: float, v: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Rotation of n, radius of the meridian, gravity."""
    s, c = np.sin(lat), np.cos(lat)
    x = 1 - E2 * s * s
    prime = A / np.sqrt(x)
    meridian = prime * (1 - E2) / x
    surface = 9.7803253359 * (1 + 0.00193185265241 * s * s) / np.sqrt(x)
    y = h / A
    slope = 1 + 1 / 298.257223563 + 0.00344978650684 - 2 / 298.257223563 * s * s
    rate = np.array([-v[1] / (meridian + h), EARTH_RATE * c + v[0] / (prime + h), EARTH_RATE * s])
    rate[2] += v[0] / (prime + h) * s / c
    return rate, meridian, surface * (1 - 2 * slope * y + 3 * y * y)


def solve(b: np.ndarray) -> tuple[np.ndarray, bool]:
    """Rotation matrix of Wahba's problem by Davenport's method, and whether it is unique."""
    z = np.array([b[2, 1] - b[1, 2], b[0, 2] - b[2, 0], b[1, 0] - b[0, 1]])
    k = np.zeros((4, 4))
    k[0, 0], k[0, 1:], k[1:, 0] = np.trace(b), z, z
    k[1:, 1:] = b + b.T - np.trace(b) * np.eye(3)
    values, vectors = np.linalg.eigh(k)
    w, u = vectors[0, 3], vectors[1:, 3]
    unique = values[3] > 0 and (values[3] - values[2]) / values[3] > 1e-12
    return (w * w - u @ u) * np.eye(3) + 2 * np.outer(u, u) + 2 * w * skew(u), unique


def align(
    dtheta: np.ndarray,
    dvel: np.ndarray,
    velocity: np.ndarray,
    dt: float,
    samples: int,
    every: int,
    lat: float,
    h: float,
) -> np.ndarray:
    """One run: C_nb at every `every`-th epoch, (K, 3, 3)."""
    c_b, c_n, att, known = np.eye(3), np.eye(3), np.eye(3), False
    force, alpha, moment, v_b0, start = (np.zeros(3) for _ in range(5))
    w_ie0 = np.array([0.0, EARTH_RATE * np.cos(lat), EARTH_RATE * np.sin(lat)])
    fixed, carried, out = np.zeros((3, 3)), np.zeros((3, 3)), []
    for k in range(len(dtheta) // samples + 1):
        rotation, dv = np.eye(3), np.zeros(3)
        length = samples * dt if k else 0.0
        if k:
            for i in range((k - 1) * samples, k * samples, 2):
                th1, th2, dv1, dv2 = dtheta[i], dtheta[i + 1], dvel[i], dvel[i + 1]
                th = th1 + th2
                d = mean_rotation(th) @ (dv1 + dv2) + 2 / 3 * (np.cross(th1, dv2) + np.cross(dv1, th2))
                dv = dv + rotation @ d
                rotation = rotation @ expm(th + 2 / 3 * np.cross(th1, th2))
        force = force + c_b @ dv
        c_b = c_b @ rotation
        before, v_b0 = v_b0, c_b @ velocity[k]
        mean = c_n.T @ att @ (before + v_b0) / 2 if known else np.zeros(3)
        _, meridian, g = rates(lat, h, mean)
        rate, _, _ = rates(lat + 0.5 * length * mean[1] / (meridian + h), h, mean)
        lat = lat + length * mean[1] / (meridian + h)
        down = np.array([0.0, 0.0, -g])
        first = np.cross(rate, down)
        second = np.cross(rate, first)
        impulse = length * down + length**2 / 2 * first + length**3 / 6 * second
        alpha = alpha + c_n @ (impulse + length**4 / 24 * np.cross(rate, second))
        c_n = c_n @ expm(rate * length)
        if k == 0:
            start = v_b0
        moment = moment + (before + v_b0) / 2 * length
        fixed = fixed + np.outer(alpha, v_b0 - start - force)
        carried = carried + np.outer(alpha, moment)
        if k % every == 0:
            found = known
            for _ in range(2):
                b = fixed + np.cross(att.T @ w_ie0, carried) if found else fixed
                att, found = solve(b)
            known = found
            out.append(c_n.T @ att @ c_b)
    return np.array(out)
