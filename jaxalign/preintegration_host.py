"""The increments of a recorded log, in NumPy: formulas of :mod:`jaxalign.preintegration`, without a compilation.

Compiling that takes a second for each length of log; here a minute of samples takes a millisecond.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxalign.preintegration import Increment, pair, single
from jaxalign.vector import Quat, Vec3

__all__ = ["joined", "preintegrated"]

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
    """Its part along the first axis."""
    q, v = increment.rotation, increment.dvel
    return Increment(Quat(q.w[where], q.x[where], q.y[where], q.z[where]), Vec3(v.x[where], v.y[where], v.z[where]))


def joined(parts: Sequence[Increment]) -> Increment:
    """One after the other along the first axis."""
    rotation = Quat(*(np.concatenate([getattr(p.rotation, k) for p in parts]) for k in "wxyz"))
    return Increment(rotation, Vec3(*(np.concatenate([getattr(p.dvel, k) for p in parts]) for k in "xyz")))
