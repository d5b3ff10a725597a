"""Normal random numbers for the compiled loop: xorshift and a ziggurat, four times faster than numba's own."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

__all__ = ["normal", "seeded"]

_LAYERS, _TAIL, _AREA = 128, 3.442619855899, 9.91256303526217e-3


def _tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges as fractions of 2^31, widths, heights of the layers (Marsaglia and Tsang 2000)."""
    k, w, f = np.zeros(_LAYERS, np.int64), np.zeros(_LAYERS), np.zeros(_LAYERS)
    scale, d, last = 2.0**31, _TAIL, _TAIL
    q = _AREA / math.exp(-0.5 * d * d)
    k[0], k[1] = int(d / q * scale), 0
    w[0], w[-1] = q / scale, d / scale
    f[0], f[-1] = 1.0, math.exp(-0.5 * d * d)
    for i in range(_LAYERS - 2, 0, -1):
        d = math.sqrt(-2.0 * math.log(_AREA / d + math.exp(-0.5 * d * d)))
        k[i + 1], last = int(d / last * scale), d
        f[i], w[i] = math.exp(-0.5 * d * d), d / scale
    return k, w, f


_K, _W, _F = _tables()


@njit(inline="always")
def seeded(seed):
    """A state from a seed (splitmix)."""
    state = np.empty(1, np.uint64)
    x = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x632BE59BD9B4E019)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    state[0] = (x ^ (x >> np.uint64(31))) | np.uint64(1)
    return state


@njit(inline="always")
def _word(state):
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return x * np.uint64(0x2545F4914F6CDD1D)


@njit(inline="always")
def _uniform(state):
    return (np.float64(_word(state) >> np.uint64(11)) + 0.5) * 2.0**-53


@njit
def _rare(state, h, i):
    while True:
        x = h * _W[i]
        if i == 0:
            while True:
                x = -math.log(_uniform(state)) / _TAIL
                y = -math.log(_uniform(state))
                if y + y > x * x:
                    return _TAIL + x if h > 0 else -_TAIL - x
        if _F[i] + _uniform(state) * (_F[i - 1] - _F[i]) < math.exp(-0.5 * x * x):
            return x
        word = _word(state)
        h, i = np.int64(np.int32(word >> np.uint64(32))), np.int64(word & np.uint64(127))
        if abs(h) < _K[i]:
            return h * _W[i]


@njit(inline="always")
def normal(state):
    """The next number."""
    word = _word(state)
    h, i = np.int64(np.int32(word >> np.uint64(32))), np.int64(word & np.uint64(127))
    if abs(h) < _K[i]:
        return h * _W[i]
    return _rare(state, h, i)
