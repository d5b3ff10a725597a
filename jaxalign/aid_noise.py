"""The white noise of an aid, from the vectors themselves."""

from __future__ import annotations

import numpy as np

__all__ = ["white_noise_sd"]

_ORDER = 3
_GAIN = np.sqrt(20.0)  # of third differences for white noise: 1 + 9 + 9 + 1
_FLOOR = 1e-6  # m/s
_LEAST = 10  # differences


def white_noise_sd(alpha: np.ndarray, beta: np.ndarray, valid: np.ndarray) -> float | None:
    """Standard deviation per axis (m/s) of the white part of ``alpha - C beta``.

    C is fitted to all vectors; third differences over time then remove what is smooth (the error of C, biases, slow
    errors of the aid), and the median keeps outliers out. For a standing vehicle it is the white part of the velocity
    that the accelerometers integrate.

    Args:
        alpha: (K, 3) vectors in n0, m/s, integrated over the whole time.
        beta: (K, 3) vectors in b0.
        valid: (K,) which of them to use.

    Returns:
        The standard deviation, or None where fewer than ten runs of four consecutive vectors exist.
    """
    if len(valid) < _ORDER + _LEAST:
        return None
    u, _, vt = np.linalg.svd(alpha[valid].T @ beta[valid])
    c = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    differences = np.diff(alpha - beta @ c.T, n=_ORDER, axis=0)
    usable = np.all(np.lib.stride_tricks.sliding_window_view(valid, _ORDER + 1), axis=-1)
    if usable.sum() < _LEAST:
        return None
    per_axis = np.median(np.abs(differences[usable]), axis=0) / 0.6745 / _GAIN
    return max(float(np.sqrt(np.mean(per_axis**2))), _FLOOR)
