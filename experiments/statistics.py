"""Statistics over Monte Carlo runs, each with its standard error from the spread between the runs.

Errors are arrays (runs, rows) of one axis.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jaxalign.tables import Estimate

__all__ = ["at", "between", "compared", "few_runs", "mean", "per_run", "rms", "share"]


def between(time: np.ndarray, start: float, stop: float) -> np.ndarray:
    """Mask of the rows with start < time <= stop."""
    return (time > start + 1e-6) & (time <= stop + 1e-6)


def at(time: np.ndarray, t: float) -> int:
    """The row nearest to a time."""
    return int(np.argmin(np.abs(time - t)))


def _mean(values: np.ndarray) -> Estimate:
    """Mean of independent values; needs two of them."""
    return Estimate(float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values))))


def mean(errors: np.ndarray) -> Estimate:
    """Mean over runs and rows."""
    return _mean(errors.reshape(len(errors), -1).mean(axis=1))


def per_run(errors: np.ndarray) -> np.ndarray:
    """(runs,) root mean square over the rows of each run."""
    return np.sqrt((errors.reshape(len(errors), -1) ** 2).mean(axis=1))


def rms(errors: np.ndarray) -> Estimate:
    """Root mean square over runs and rows (pooled)."""
    square = _mean(per_run(errors) ** 2)
    root = math.sqrt(square.value)
    return Estimate(root, square.error / (2 * root) if root > 0 else 0.0)


def share(holds: Any) -> Estimate:
    """Share of the runs for which something holds, in percent."""
    p = float(np.mean(holds))
    return Estimate(100 * p, 100 * math.sqrt(p * (1 - p) / len(holds)))


def compared(one: np.ndarray, other: np.ndarray) -> str:
    """How the RMS of one compares with that of another over the same runs: "below", "above" or "equal to" it.

    Equal: the mean difference of the runs' mean squares is within twice its standard error.
    """
    difference = _mean(per_run(one) ** 2 - per_run(other) ** 2)
    if abs(difference.value) <= 2 * difference.error:
        return "equal to"
    return "below" if difference.value < 0 else "above"


def few_runs(errors: np.ndarray, runs: int = 10, draws: int = 5000) -> tuple[float, float]:
    """Where the pooled RMS of so few runs lies with 95 % probability, by drawing them from these runs."""
    squares = per_run(errors) ** 2
    chosen = np.random.default_rng(0).integers(len(squares), size=(draws, runs))
    low, high = np.percentile(np.sqrt(squares[chosen].mean(axis=1)), [2.5, 97.5])
    return float(low), float(high)
