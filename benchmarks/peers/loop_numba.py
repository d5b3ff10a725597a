"""`oba` as a loop over samples and epochs, compiled by numba: what a careful engineer writes without JAX.

The same algorithm as ours: two-sample coning and sculling, closed Coriolis term with two passes, transport rate fed
back from the last read-out, latitude integrated.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from benchmarks.peers.ziggurat import normal, seeded

__all__ = ["align", "study"]

EARTH_RATE, A, E2 = 7.292115e-5, 6378137.0, 0.00669437999014


@njit(inline="always")
def qmul(p, q):
    """Product of quaternions."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


@njit(inline="always")
def conj(q):
    """Inverse rotation."""
    return (q[0], -q[1], -q[2], -q[3])


@njit(inline="always")
def cross(a, b):
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@njit(inline="always")
def lin(a, x, b, y):
    """``a x + b y``."""
    return (a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2])


@njit(inline="always")
def rotate(q, v):
    """Map a vector."""
    u = (q[1], q[2], q[3])
    t = cross(u, v)
    t = (2 * t[0], 2 * t[1], 2 * t[2])
    w = cross(u, t)
    return (v[0] + q[0] * t[0] + w[0], v[1] + q[0] * t[1] + w[1], v[2] + q[0] * t[2] + w[2])


@njit(inline="always")
def qexp(v):
    """Quaternion of a rotation vector."""
    a2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    if a2 < 1e-6:
        s, w = 0.5 - a2 / 48 + a2 * a2 / 3840, 1 - a2 / 8 + a2 * a2 / 384
    else:
        a = math.sqrt(a2)
        s, w = math.sin(a / 2) / a, math.cos(a / 2)
    return (w, s * v[0], s * v[1], s * v[2])


@njit(inline="always")
def normed(q):
    """To norm one."""
    s = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (s * q[0], s * q[1], s * q[2], s * q[3])


@njit(inline="always")
def turned_mean(r, v):
    """Mean of exp([s r x]) v over s from 0 to 1."""
    a2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    if a2 < 1e-6:
        f, g = 0.5 - a2 / 24, 1 / 6 - a2 / 120
    else:
        a = math.sqrt(a2)
        f, g = (1 - math.cos(a)) / a2, (a - math.sin(a)) / (a2 * a)
    c = cross(r, v)
    d = cross(r, c)
    return (v[0] + f * c[0] + g * d[0], v[1] + f * c[1] + g * d[1], v[2] + f * c[2] + g * d[2])


@njit
def solve(b, w):
    """Attitude of Wahba's problem: the largest eigenvector of Davenport's matrix; relative gap."""
    t = b[0, 0] + b[1, 1] + b[2, 2]
    k = np.empty((4, 4))
    k[0, 0] = t
    k[0, 1], k[0, 2], k[0, 3] = b[2, 1] - b[1, 2], b[0, 2] - b[2, 0], b[1, 0] - b[0, 1]
    for i in range(3):
        k[i + 1, 0] = k[0, i + 1]
        for j in range(3):
            k[i + 1, j + 1] = b[i, j] + b[j, i]
        k[i + 1, i + 1] -= t
    values, vectors = np.linalg.eigh(k)
    gap = (values[3] - values[2]) / values[3] if values[3] > 0 else 0.0
    return (vectors[0, 3], vectors[1, 3], vectors[2, 3], vectors[3, 3]), gap > 1e-12


@njit(inline="always")
def gravity(sin2, h):
    """Normal gravity (WGS-84)."""
    surface = 9.7803253359 * (1 + 0.00193185265241 * sin2) / math.sqrt(1 - E2 * sin2)
    x = h / A
    return surface * (1 - 2 * (1 + 1 / 298.257223563 + 0.00344978650684 - 2 / 298.257223563 * sin2) * x + 3 * x * x)


@njit(fastmath=True)
def align(dtheta, dvel, velocity, biases, sds, noise, seed, plain, dt, samples, every, lat, h, out):
    """One run: quaternions q_nb at every `every`-th epoch into out (K, 4).

    Errors of the sensors are added on the way: biases (2, 3) per sample, sds (gyro, accelerometer, aid); the noise is
    drawn here if `noise` is empty (by numba's own generator if `plain`, else by the ziggurat), else taken from it: 6
    numbers a sample, then 3 an epoch.
    """
    if plain:
        np.random.seed(seed)  # noqa: NPY002 - what numba compiles
    state = seeded(seed)
    n = dtheta.shape[0]
    epochs = n // samples
    q_b, q_n, att = (1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    force = alpha = moment = (0.0, 0.0, 0.0)
    v_b0 = start = (0.0, 0.0, 0.0)
    w_ie0 = (0.0, EARTH_RATE * math.cos(lat), EARTH_RATE * math.sin(lat))
    fixed, carried = np.zeros((3, 3)), np.zeros((3, 3))
    known = False
    z = np.empty((2, 6))
    step = samples * dt
    for k in range(epochs + 1):
        rotation, dv = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if k > 0:
            for i in range((k - 1) * samples, k * samples, 2):
                for j in range(2):
                    for a in range(6):
                        if noise.size == 0:
                            z[j, a] = np.random.standard_normal() if plain else normal(state)  # noqa: NPY002
                        else:
                            z[j, a] = noise[6 * (i + j) + a]
                th1 = (
                    dtheta[i, 0] + biases[0, 0] + sds[0] * z[0, 0],
                    dtheta[i, 1] + biases[0, 1] + sds[0] * z[0, 1],
                    dtheta[i, 2] + biases[0, 2] + sds[0] * z[0, 2],
                )
                th2 = (
                    dtheta[i + 1, 0] + biases[0, 0] + sds[0] * z[1, 0],
                    dtheta[i + 1, 1] + biases[0, 1] + sds[0] * z[1, 1],
                    dtheta[i + 1, 2] + biases[0, 2] + sds[0] * z[1, 2],
                )
                dv1 = (
                    dvel[i, 0] + biases[1, 0] + sds[1] * z[0, 3],
                    dvel[i, 1] + biases[1, 1] + sds[1] * z[0, 4],
                    dvel[i, 2] + biases[1, 2] + sds[1] * z[0, 5],
                )
                dv2 = (
                    dvel[i + 1, 0] + biases[1, 0] + sds[1] * z[1, 3],
                    dvel[i + 1, 1] + biases[1, 1] + sds[1] * z[1, 4],
                    dvel[i + 1, 2] + biases[1, 2] + sds[1] * z[1, 5],
                )
                th = lin(1.0, th1, 1.0, th2)
                d = lin(
                    1.0,
                    turned_mean(th, lin(1.0, dv1, 1.0, dv2)),
                    2 / 3,
                    lin(1.0, cross(th1, dv2), 1.0, cross(dv1, th2)),
                )
                dv = lin(1.0, dv, 1.0, rotate(rotation, d))
                rotation = qmul(rotation, qexp(lin(1.0, th, 2 / 3, cross(th1, th2))))
            rotation = normed(rotation)
        length = step if k > 0 else 0.0
        for a in range(3):
            if noise.size == 0:
                z[0, a] = np.random.standard_normal() if plain else normal(state)  # noqa: NPY002
            else:
                z[0, a] = noise[6 * n + 3 * k + a]
        v = (
            velocity[k, 0] + sds[2] * z[0, 0],
            velocity[k, 1] + sds[2] * z[0, 1],
            velocity[k, 2] + sds[2] * z[0, 2],
        )
        force = lin(1.0, force, 1.0, rotate(q_b, dv))
        q_b = normed(qmul(q_b, rotation))
        before, v_b0 = v_b0, rotate(q_b, v)
        s = math.sin(lat)
        g = gravity(s * s, h)
        north, east = 0.0, 0.0
        if known:
            mean = rotate(conj(q_n), rotate(att, lin(0.5, before, 0.5, v_b0)))
            north, east = mean[1], mean[0]
        x = 1 - E2 * s * s
        meridian = A / math.sqrt(x) * (1 - E2) / x
        middle = lat + 0.5 * length * north / (meridian + h)
        lat = lat + length * north / (meridian + h)
        s, c = math.sin(middle), math.cos(middle)
        x = 1 - E2 * s * s
        prime = A / math.sqrt(x)
        meridian = prime * (1 - E2) / x
        rate = (
            -north / (meridian + h),
            EARTH_RATE * c + east / (prime + h),
            EARTH_RATE * s + east / (prime + h) * s / c,
        )
        down = (0.0, 0.0, -g)
        first = cross(rate, down)
        second = cross(rate, first)
        third = cross(rate, second)
        impulse = lin(length, down, length * length / 2, first)
        impulse = lin(1.0, impulse, length**3 / 6, second)
        impulse = lin(1.0, impulse, length**4 / 24, third)
        alpha = lin(1.0, alpha, 1.0, rotate(q_n, impulse))
        q_n = normed(qmul(q_n, qexp((rate[0] * length, rate[1] * length, rate[2] * length))))
        if k == 0:
            start = v_b0
        else:
            moment = lin(1.0, moment, 0.5 * length, lin(1.0, before, 1.0, v_b0))
        beta = lin(1.0, lin(1.0, v_b0, -1.0, start), -1.0, force)
        for i in range(3):
            for j in range(3):
                fixed[i, j] += alpha[i] * beta[j]
                carried[i, j] += alpha[i] * moment[j]
        if k % every == 0:
            found = known
            for _ in range(2):
                b = fixed.copy()
                if found:
                    w = rotate(conj(att), w_ie0)
                    for i in range(3):
                        row = cross(w, (carried[i, 0], carried[i, 1], carried[i, 2]))
                        b[i, 0] += row[0]
                        b[i, 1] += row[1]
                        b[i, 2] += row[2]
                att, found = solve(b, w_ie0)
            known = found
            q = qmul(qmul(conj(q_n), att), q_b)
            for i in range(4):
                out[k // every, i] = q[i]


@njit(parallel=True, fastmath=True)
def study(dtheta, dvel, velocity, biases, sds, runs, plain, dt, samples, every, lat, h):
    """Many runs on all threads: (runs, K, 4); the biases with a random sign on each axis."""
    out = np.empty((runs, velocity.shape[0] // every + 1, 4))
    for run in prange(runs):
        signed, coin = np.empty((2, 3)), seeded(-1 - run)
        for i in range(2):
            for j in range(3):
                signed[i, j] = biases[i, j] if normal(coin) < 0 else -biases[i, j]
        align(dtheta, dvel, velocity, signed, sds, np.empty(0), run + 1, plain, dt, samples, every, lat, h, out[run])
    return out
