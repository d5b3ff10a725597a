"""The increments of a recorded log, in NumPy: formulas of :mod:`jaxalign.preintegration`, without a compilation.

Compiling that takes a second for each length of log; here a minute of samples takes a millisecond.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxalign.preintegration import Increment, pair, single
from jaxalign.vector import Quat, Vec3

__all__ = ["joined", "preintegrated", "preintegrated_between"]

_AT_ONCE = 50_000  # samples: what they need stays in the processor's cache


def preintegrated(dtheta: np.ndarray, dvel: np.ndarray, every: int) -> Increment:
    """The scheme ``pairs`` of :func:`jaxalign.preintegrate`, equal to rounding.

    Args:
        dtheta: (N, 3) rotation increments, rad.
        dvel: (N, 3) velocity increments, m/s.
        every: samples per interval; a remainder at the end is left out.

    Returns:
        Increments with NumPy components of shape (N // every,).
    """
    intervals = len(dtheta) // every
    step = max(1, _AT_ONCE // every)
    parts = [_part(dtheta, dvel, every, first, min(first + step, intervals)) for first in range(0, intervals, step)]
    whole = joined(parts)
    rotation = whole.rotation
    return Increment(rotation.scale(1.0 / np.sqrt(rotation.norm2())), whole.dvel)


def preintegrated_between(dtheta: np.ndarray, dvel: np.ndarray, at: np.ndarray) -> Increment:
    """Preintegrate samples on the host over intervals of any length.

    A boundary within a sample splits it linearly: a constant rate and force within that sample.

    Args:
        dtheta: (N, 3) rotation increments, rad.
        dvel: (N, 3) velocity increments, m/s.
        at: (K+1,) boundaries in samples, increasing, within 0..N.

    Returns:
        Increments with NumPy components of shape (K,).
    """
    first, last = np.ceil(at[:-1]).astype(int), np.floor(at[1:]).astype(int)
    within = last < first  # both boundaries lie in one sample
    before = np.where(within, at[1:] - at[:-1], first - at[:-1])
    after = np.where(within, 0.0, at[1:] - last)
    head = _share(dtheta, dvel, np.floor(at[:-1]).astype(int), before)
    tail = _share(dtheta, dvel, last, after)
    whole = _none(len(first))
    counts = np.where(within, 0, last - first)
    for count in np.unique(counts[counts > 0]):  # few lengths: intervals of one are lanes
        lanes = np.flatnonzero(counts == count)
        if count == 1:
            _put(whole, lanes, _alone(dtheta, dvel, first[lanes]))
            continue
        for some in np.array_split(lanes, max(1, len(lanes) * int(count) // _AT_ONCE)):
            index = (first[some][:, None] + np.arange(count)).ravel()
            _put(whole, some, preintegrated(dtheta[index], dvel[index], int(count)))
    total = head @ whole @ tail
    return Increment(total.rotation.scale(1.0 / np.sqrt(total.rotation.norm2())), total.dvel)


def _none(count: int) -> Increment:
    zero = np.zeros(count)
    return Increment(Quat(zero + 1.0, *(zero.copy() for _ in range(3))), Vec3(*(zero.copy() for _ in range(3))))


def _put(into: Increment, lanes: np.ndarray, part: Increment) -> None:
    """Put increments into lanes of others, in place."""
    for vector, new, names in ((into.rotation, part.rotation, "wxyz"), (into.dvel, part.dvel, "xyz")):
        for name in names:
            getattr(vector, name)[lanes] = getattr(new, name)


def _alone(dtheta: np.ndarray, dvel: np.ndarray, index: np.ndarray) -> Increment:
    """Single samples, with the one before each."""
    before, there = np.maximum(index - 1, 0), (index > 0)[:, None]
    th, dv, th_, dv_ = (Vec3(*x.T) for x in (dtheta[index], dvel[index], dtheta[before] * there, dvel[before] * there))
    return single((th_, dv_), th, dv)


def _share(dtheta: np.ndarray, dvel: np.ndarray, index: np.ndarray, share: np.ndarray) -> Increment:
    """Of one sample for each interval so much (0..1), its rate and force constant."""
    index = np.minimum(index, len(dtheta) - 1)
    th, dv = (Vec3(*(x[index] * share[:, None]).T) for x in (dtheta, dvel))
    nothing = Vec3(*np.zeros((3, len(index))))
    return single((nothing, nothing), th, dv)


def _part(dtheta: np.ndarray, dvel: np.ndarray, every: int, first: int, stop: int) -> Increment:
    """The intervals first ... stop - 1."""

    def samples(x: np.ndarray, start: int, step: int = 1, end: int | None = None) -> Vec3:
        """Every step-th sample of each interval, (count, intervals), from one on."""
        lanes = x[first * every : stop * every].reshape(stop - first, every, 3)[:, start:end:step]
        return Vec3(*np.ascontiguousarray(lanes.transpose(2, 1, 0)))

    if every == 1:
        before = _shifted(dtheta, first, stop), _shifted(dvel, first, stop)
        total = single(before, samples(dtheta, 0), samples(dvel, 0))
        return _at(total, 0)
    even = every // 2 * 2
    odd, after = ((samples(dtheta, k, 2, even), samples(dvel, k, 2, even)) for k in (0, 1))
    total = pair(odd[0], odd[1], after[0], after[1])
    if even < every:
        before = samples(dtheta, every - 2, 1, every - 1), samples(dvel, every - 2, 1, every - 1)
        last = single(before, samples(dtheta, every - 1), samples(dvel, every - 1))
        return _at(_composed(total), 0) @ _at(last, 0)
    return _at(_composed(total), 0)


def _shifted(x: np.ndarray, first: int, stop: int) -> Vec3:
    """The sample before each (1, intervals); zero before the first one."""
    rows = x[first - 1 : stop - 1] if first else np.concatenate([np.zeros((1, 3)), x[: stop - 1]])
    return Vec3(*rows.T[:, None])


def _composed(samples: Increment) -> Increment:
    """Compose along the first axis, neighbours first, until one is left (1, intervals)."""
    while (count := len(samples.rotation.w)) > 1:
        even = count // 2 * 2
        halved = _at(samples, slice(0, even, 2)) @ _at(samples, slice(1, even, 2))
        samples = halved if even == count else joined([halved, _at(samples, slice(even, None))])
    return samples


def _at(increment: Increment, where: Any) -> Increment:
    """The part of an increment along the first axis."""
    q, v = increment.rotation, increment.dvel
    return Increment(Quat(q.w[where], q.x[where], q.y[where], q.z[where]), Vec3(v.x[where], v.y[where], v.z[where]))


def joined(parts: Sequence[Increment]) -> Increment:
    """One after the other along the first axis."""
    rotation = Quat(*(np.concatenate([getattr(p.rotation, k) for p in parts]) for k in "wxyz"))
    return Increment(rotation, Vec3(*(np.concatenate([getattr(p.dvel, k) for p in parts]) for k in "xyz")))
