"""The six channels of an inertial unit: names, what counts as equal, quantum, roughness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxalign.log import Log

__all__ = [
    "Channel",
    "channels",
    "clock",
    "equal_neighbours",
    "quantum",
    "rough",
    "rounding",
    "spread",
    "without_gravity",
]

_AXES = ("x", "y", "z")
_ROUNDING = 8.0  # units in the last place of the largest sum: increments from a reader are differences of sums


@dataclass(frozen=True, eq=False)
class Channel:
    """One axis of one triad.

    Attributes:
        triad: "gyro" or "accelerometer".
        axis: "x", "y" or "z".
        values: (N,) increments, rad or m/s.
        same: (N-1,) whether a value equals the one before.
    """

    triad: str
    axis: str
    values: np.ndarray
    same: np.ndarray

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.triad} {self.axis}"


def channels(log: Log) -> tuple[Channel, ...]:
    """Gyroscopes x, y, z, accelerometers x, y, z."""
    return tuple(
        Channel(triad, axis, values[:, i], equal_neighbours(values[:, i]))
        for triad, values in (("gyro", log.dtheta), ("accelerometer", log.dvel))
        for i, axis in enumerate(_AXES)
    )


def clock(log: Log, row: int) -> str:
    """The time at which an IMU sample begins, for people."""
    return f"{log.t0 + row * log.dt:.6g}"


def rounding(x: np.ndarray) -> float:
    """What a reader that took differences of sums may have changed a value by."""
    return _ROUNDING * float(np.finfo(float).eps) * float(np.abs(np.cumsum(x)).max())


def equal_neighbours(x: np.ndarray) -> np.ndarray:
    """(N-1,) whether a value equals the one before, but for rounding."""
    return np.abs(np.diff(x)) <= rounding(x)


def without_gravity(log: Log) -> np.ndarray:
    """(N,) rows where all three accelerometers are at zero, but for rounding."""
    return np.logical_and.reduce([np.abs(x) <= rounding(x) for x in log.dvel.T])


def quantum(x: np.ndarray) -> float:
    """The step of rounded data: the tenth percentile of the gaps between the values that occur."""
    gaps = np.diff(np.unique(x))
    gaps = gaps[gaps > 64 * np.finfo(float).eps * float(np.abs(x).max())]
    return float(np.percentile(gaps, 10)) if len(gaps) else 0.0


def rough(x: np.ndarray, same: np.ndarray) -> bool:
    """Whether a channel has noise from sample to sample, as every sensor has and noise-free simulations have not.

    Fourth differences of white noise are sqrt(70 / 20) times as large as third ones; those of smooth data are smaller.
    """
    changing = ~(same[:-3] | same[1:-2] | same[2:-1] | same[3:])
    if changing.sum() < 10:
        return False
    third, fourth = (float(np.median(np.abs(np.diff(x, n=n))[: len(changing)][changing])) for n in (3, 4))
    return fourth > third > 4.0 * rounding(x)


def spread(x: np.ndarray, size: int) -> float:
    """Median standard deviation within windows of a size; 0 where there is none."""
    size = max(size, 4)
    count = len(x) // size
    return float(np.median(x[: count * size].reshape(count, size).std(axis=1))) if count else 0.0
