"""Stretches at rest of any log.

Two witnesses. The aid: where a log has velocities, they must be within their noise of zero all the time, and so must
their mean. The inertial unit: the variance of force and rate within windows of a second must be that of its noise,
which is the variance of its quietest windows. The second is not asked where the aid says that the vehicle stands all
the time, or where there is no aid at all: then it may sway. A log whose aids measure other things says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from jaxalign.log import Log
from jaxalign.measurements import Measurements
from jaxalign.trust.channels import quantum

__all__ = ["Stretch", "stretches"]

_WINDOW = 1.0  # s
_FEWEST = 8  # samples of a window
_FIXES = 3  # values of the aid that a stretch needs
_SIGMAS = NormalDist().inv_cdf(1 - 1e-6)  # 4.75
_QUIETEST = 0.05  # the share of windows that tells the noise
_THIRD = np.sqrt(20.0)  # gain of third differences for white noise


@dataclass(frozen=True)
class Stretch:
    """Samples `first` to `stop` (excluded) are at rest; `still`: the inertial unit says so too."""

    first: int
    stop: int
    still: bool


def stretches(log: Log) -> tuple[Stretch, ...]:
    """The stretches at rest, in their order."""
    count = len(log.dtheta)
    if log.standing:
        return (Stretch(0, count, False),)
    seen = [one for one in log.aids if one.aid.measures_velocity and not one.aid.zeros]
    if not seen:
        return ()
    slow = [_slow(one) for one in seen]
    if all(x.all() for x in slow) and all(_mean_is_zero(one, 0.0, np.inf) for one in seen):
        return (Stretch(0, count, False),)
    size = max(_FEWEST, round(_WINDOW / log.dt))
    quiet = _quiet(log.dtheta, size) & _quiet(log.dvel, size)
    span = size * log.dt
    for one, fine in zip(seen, slow, strict=True):
        for at in one.time[~fine]:  # a window with a value that moves, and the ones beside it, do not stand
            k = int(at / span)
            quiet[max(k - 1, 0) : k + 2] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], quiet.astype(np.int8), [0]])))
    pairs = [(int(a) * size, int(b) * size) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return tuple(
        Stretch(a, b, True)
        for a, b in pairs
        if any(_mean_is_zero(one, a * log.dt, b * log.dt) for one in seen)
        and all(_mean_is_zero(one, a * log.dt, b * log.dt, few=True) for one in seen)
    )


def _noise(one: Measurements) -> np.ndarray:
    """(m,) standard deviation of the white noise: as stated, else by the median of third differences."""
    if one.sd is not None:
        return np.broadcast_to(np.asarray(one.sd, dtype=float), one.value.shape[1:])
    out = []
    for x in one.value.T:
        x = x[~np.isnan(x)]
        out.append(np.median(np.abs(np.diff(x, n=3))) / 0.6745 / _THIRD if len(x) > 12 else 0.0)
    return np.asarray(out)


def _slow(one: Measurements) -> np.ndarray:
    """(n,) whether each value is within the noise of zero; those that are missing say nothing."""
    with np.errstate(invalid="ignore"):
        return np.asarray(~(np.abs(one.value) > _SIGMAS * _noise(one) + 1e-9).any(axis=1))


def _mean_is_zero(one: Measurements, start: float, stop: float, few: bool = False) -> bool:
    """Whether the mean velocity from start to stop is below one standard deviation of a value.

    The standard error is smaller, but receivers have slow errors about as large as their noise.
    """
    part = one.value[(one.time >= start) & (one.time <= stop)]
    part = part[~np.isnan(part).any(axis=1)]
    if len(part) < _FIXES:
        return few
    return bool((np.abs(part.mean(axis=0)) <= _noise(one) + 1e-9).all())


def _quiet(x: np.ndarray, size: int) -> np.ndarray:
    """(N // size,) whether the variance within each window is that of the noise.

    The variance of white noise by 3 (size - 1) values scatters by sqrt(2 / that), relatively; the limit is twice as
    far, since the variance of the noise is itself taken from windows that are quiet by chance.
    """
    count = len(x) // size
    variance = x[: count * size].reshape(count, size, 3).var(axis=1)
    steps = np.array([quantum(x[:, i]) for i in range(3)])
    floor = np.maximum(np.quantile(variance, _QUIETEST, axis=0), steps**2 / 12.0)
    ratio = (variance / np.maximum(floor, np.finfo(float).tiny)).mean(axis=1)
    return ratio <= 1.0 + _SIGMAS * np.sqrt(2.0 / (3.0 * (size - 1))) * 2.0
