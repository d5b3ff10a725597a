"""White noise of an inertial unit in the quiet parts of a record, from its samples alone.

It is no upper bound: vibration makes the noise in use several times larger. It is where to begin.
"""

from __future__ import annotations

import numpy as np

from jaxalign.units import DEG_SQRT_H, UG

__all__ = ["FLOORS", "white_densities"]

FLOORS = (0.01 * DEG_SQRT_H, 50.0 * UG)
"""rad/sqrt(s) and m/s/sqrt(s): less is not told from a record of minutes."""
_LAGS = (1, 2, 4, 8, 16)
_FEWEST = 40  # sums of one lag
_BLOCK = 50  # differences
_QUIET = 0.25  # quantile of the blocks
_BIAS = 1.15  # of that quantile
_GAIN = 20.0  # of the variance, by third differences of white noise


def white_densities(dtheta: np.ndarray, dvel: np.ndarray, dt: float) -> np.ndarray | None:
    """Density of the white noise of gyroscopes and accelerometers.

    Third differences of the increments over 1, 2, 4, 8 and 16 samples leave out what is smooth; of their mean squares
    over blocks the quiet quarter counts, the median of the axes, and of the lags from 2 on the least (a low-pass filter
    in the unit hides the noise at lag 1).

    Args:
        dtheta: (N, 3) rotation increments, rad.
        dvel: (N, 3) velocity increments, m/s.
        dt: sampling interval, s.

    Returns:
        (2,) rad/sqrt(s) and m/s/sqrt(s), at least :data:`FLOORS`; None of fewer than 40 samples.
    """
    if len(dtheta) < _FEWEST:
        return None
    return np.array([max(_density(x, dt), floor) for x, floor in zip((dtheta, dvel), FLOORS, strict=True)])


def _density(increments: np.ndarray, dt: float) -> float:
    """Of one triad."""
    by_lag = []
    for lag in _LAGS:
        count = len(increments) // lag
        if count < _FEWEST:
            continue
        sums = increments[: count * lag].reshape(count, lag, -1).sum(axis=1)
        third = np.diff(sums, n=3, axis=0)
        size = min(_BLOCK, len(third) // 4)
        blocks = len(third) // size
        square = np.mean(third[: blocks * size].reshape(blocks, size, -1) ** 2, axis=1) / _GAIN
        sd = _BIAS * np.sqrt(np.quantile(square, _QUIET, axis=0))
        by_lag.append(np.median(sd) / np.sqrt(lag * dt))
    return float(min(by_lag[1:], default=by_lag[0]))
