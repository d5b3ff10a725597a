"""How probable it is that chance alone does it: the limits of the checks come from here.

All checks of a log together should be wrong about one sound log in a million; with some ten looks at a log, each look
has :data:`ODDS`.
"""

from __future__ import annotations

import numpy as np

__all__ = ["ODDS", "most_events", "repeat_odds", "run_gap", "tail_gap"]

ODDS = 1e-7
"""Probability of a false finding that one look at a sound log may have."""
_UNSEEN = -float(np.log(1e-6))  # events not seen in n trials: their rate is below this / n with certainty 1 - 1e-6
_STEEPEST = 10.0  # tail index; that of a Gaussian at 1 in 1e5
_TAIL = 100  # order statistics that the tail index is taken from: to 10 %


def repeat_odds(repeats: np.ndarray, trials: np.ndarray) -> np.ndarray:
    """Upper bound of the probability of an event that was seen `repeats` times in `trials`."""
    return np.minimum((repeats + _UNSEEN) / (trials + _UNSEEN), 1.0)


def most_events(mean: float) -> float:
    """The number of events that a Poisson variable of this mean exceeds with probability ODDS at most (Chernoff)."""
    n = np.arange(1, 200 + int(2 * mean + 20 * np.sqrt(mean)))
    bound = n - mean - n * np.log(n / max(mean, 1e-300))
    return float(n[(n > mean) & (bound < np.log(ODDS))][0])


def tail_gap(sizes: np.ndarray, quantum: float, most: int = 3) -> tuple[int, float, float]:
    """How many of the largest values stand apart from the tail of all others.

    The tail is taken as a power law, the heaviest that is usual, whose index is found from the order statistics below
    (Hill's estimator, less three of its standard errors, and at most that of a Gaussian). By Renyi's representation
    the k-th largest is more than r times the next one with probability r^(-k index).

    Args:
        sizes: (n,) absolute values.
        quantum: of the values: a difference of one means nothing.
        most: how many may stand apart.

    Returns:
        Their number (0: none), the smallest of them over the next one, and the limit of that ratio.
    """
    count = min(_TAIL, len(sizes) // 20)
    if count < 10:
        return 0, 1.0, np.inf
    top = np.sort(np.partition(sizes, len(sizes) - count - most)[-(count + most) :])[::-1] + quantum
    for k in range(most, 0, -1):
        rest = top[k : k + count]
        if rest[-1] <= 0:
            continue
        logs = float(np.mean(np.log(rest[:-1] / rest[-1])))
        index = min(_STEEPEST, (1 - 3 / np.sqrt(count)) / max(logs, 1e-9))
        limit = float(ODDS ** (-1.0 / (k * index)))
        ratio = float(top[k - 1] / rest[0])
        if ratio > limit and top[k - 1] > 4.0 * quantum:  # one level is little more than the noise that reaches it
            return k, ratio, limit
    return 0, 1.0, np.inf


def run_gap(lengths: np.ndarray, most: int = 3) -> int:
    """The length from which on runs stand apart from all others; 0 where there are too few to say.

    Runs that end by chance have an exponential tail, if only of the times at which they end most seldom: its scale s is
    the mean excess of the order statistics below (plus three of its standard errors), and the k-th longest is more than
    d longer than the next one with probability exp(-k d / s).

    Args:
        lengths: (n,) of all runs.
        most: how many may stand apart.
    """
    count = min(_TAIL, len(lengths) // 20)
    if count < 10:
        return 0
    top = np.sort(lengths)[::-1].astype(float)
    for k in range(most, 0, -1):
        rest = top[k : k + count]
        scale = (1.0 + float((rest - rest[-1]).mean())) * (1.0 + 3.0 / np.sqrt(count))
        if k * (top[k - 1] - rest[0]) > -scale * np.log(ODDS):
            return int(top[k - 1])
    return int(top[0]) + 1
