"""Increments from one clock onto another, without losing any.

The cumulated sum S(t) of the increments (the integral of the rate) is known at the IMU's time stamps and
taken as linear between them; increments on a new grid are its differences, so that whatever grid is chosen
their total is the same. A linear S means a constant rate within an IMU sample, which is what a plain sum of
increments assumes as well.
"""

from __future__ import annotations

import numpy as np

__all__ = ["cumulate_increments", "cumulate_rates", "nominal_interval", "onto_grid"]


def nominal_interval(t: np.ndarray) -> float:
    """Interval of an almost regular clock from its stamps (s); lost stamps are counted, jitter averaged."""
    steps = np.diff(t)
    median = float(np.median(steps))
    count = np.round(steps / median)
    used = (count >= 1) & (np.abs(steps / median - count) < 0.25)
    return float(steps[used].sum() / count[used].sum()) if used.any() else median


def cumulate_increments(t: np.ndarray, x: np.ndarray, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of S for increments, the one of stamp t_i being over the sampling interval that ends there.

    Missing samples (a step of 2 intervals or more) are filled by the mean of the increments beside the gap.

    Args:
        t: (N,) stamps, s.
        x: (N, K) increments.
        interval: nominal sampling interval, s.

    Returns:
        (N+1,) times and (N+1, K) sums; the first node is one interval before t_0.
    """
    steps = np.diff(t, prepend=t[0] - interval)
    lost = np.maximum(np.round(steps / interval) - 1.0, 0.0)
    before = np.vstack([x[:1], x[:-1]])
    total = np.cumsum(x + lost[:, None] * 0.5 * (x + before), axis=0)
    return np.concatenate([[t[0] - interval], t]), np.vstack([np.zeros_like(x[:1]), total])


def cumulate_rates(t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of S for rates, x_i being the value at the moment t_i: trapezoids, also over missing samples.

    Args:
        t: (N,) stamps, s.
        x: (N, K) rates.

    Returns:
        t and (N, K) sums.
    """
    pieces = 0.5 * (x[1:] + x[:-1]) * np.diff(t)[:, None]
    return t, np.vstack([np.zeros_like(x[:1]), np.cumsum(pieces, axis=0)])


def onto_grid(t: np.ndarray, s: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Increments between neighbouring times of a grid, by linear interpolation of S.

    Args:
        t: (N,) times of the nodes, s, increasing.
        s: (N, K) sums.
        grid: (G+1,) times within t[0]..t[-1] (but for rounding), s.

    Returns:
        (G, K) increments.
    """
    # The mean slope is taken out first: it passes through the interpolation unchanged, and what is left is
    # small, so that rounding does not grow with the length of the log.
    slope = (s[-1] - s[0]) / (t[-1] - t[0])
    rest = s - s[0] - (t - t[0])[:, None] * slope
    columns = [np.diff(np.interp(grid, t, rest[:, k])) for k in range(s.shape[1])]
    return np.column_stack(columns) + np.diff(grid)[:, None] * slope
