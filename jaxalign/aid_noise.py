"""The white noise of an aid, from the vectors or the values themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxalign.epochs import Fix

__all__ = ["values_noise_sd", "white_noise_sd"]

_ORDER = 3
_WHITE, _WALK = np.sqrt(20.0), np.sqrt(6.0)  # gain of third differences for white noise, and for a random walk's steps
_FLOOR = 1e-6  # m/s
_LEAST = 10  # differences


def white_noise_sd(alpha: np.ndarray, beta: np.ndarray, valid: np.ndarray, walk: bool = False) -> float | None:
    """Standard deviation per axis (m/s) of the white part of ``alpha - C beta``.

    C is fitted to all vectors; third differences over the valid vectors then remove what is smooth (the error of C,
    biases, slow errors of the aid), and the median keeps outliers out.

    Args:
        alpha: (K, 3) vectors in n0, m/s, integrated over the whole time.
        beta: (K, 3) vectors in b0.
        valid: (K,) which of them to use.
        walk: the error is a random walk, and the standard deviation of its steps is sought: a standing vehicle, whose
            only noise is that of the force integrated over each interval.

    Returns:
        The standard deviation, or None where there are fewer than thirteen vectors or they are not finite.
    """
    alpha, beta = alpha[valid], beta[valid]
    if len(alpha) < _ORDER + _LEAST or not (np.isfinite(alpha).all() and np.isfinite(beta).all()):
        return None
    scale = max(np.abs(alpha).max(), np.abs(beta).max(), np.finfo(float).tiny)
    u, _, vt = np.linalg.svd((alpha / scale).T @ (beta / scale))
    c = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    differences = np.diff(alpha - beta @ c.T, n=_ORDER, axis=0)
    per_axis = np.median(np.abs(differences), axis=0) / 0.6745 / (_WALK if walk else _WHITE)
    return max(float(np.sqrt(np.mean(per_axis**2))), _FLOOR)


def values_noise_sd(fix: Fix, periodic: bool = False) -> float | None:
    """Standard deviation of the white noise of an aid (in its unit; of several components the root mean square).

    By the median of third differences over what is there: it holds the motion too, where that is fast.

    Args:
        fix: leaves (K,).
        periodic: the values are angles.

    Returns:
        The standard deviation by all components that have thirteen values, or None where there is none.
    """
    found = []
    for value, known in zip(fix.value, fix.known, strict=True):
        x = np.asarray(value)[np.asarray(known)]
        x = np.unwrap(x) if periodic else x
        if len(x) >= _ORDER + _LEAST:
            found.append(np.median(np.abs(np.diff(x, n=_ORDER))) / 0.6745 / _WHITE)
    return max(float(np.sqrt(np.mean(np.square(found)))), _FLOOR) if found else None
