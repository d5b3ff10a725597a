"""Values of an aid that are repeated, held or zero where it should measure.

A vehicle that stands makes wheels and simulated receivers say zero exactly, for as long as it likes: zeros count only
where the values jump to zero and back. Estimators weigh outliers down, so these are notes, but for a fault that goes
on for a third of the values.
"""

from __future__ import annotations

import numpy as np

from jaxalign.log import Log
from jaxalign.measurements import Measurements
from jaxalign.trust.channels import rough
from jaxalign.trust.finding import Finding
from jaxalign.trust.held import held
from jaxalign.trust.stuck import runs, unexplained

__all__ = ["aid_findings"]

_LARGE = 1.0 / 3.0
_ENOUGH = 20  # values
_ZERO = 1e-9  # of the largest: a rotation of zeros by the recorder


def aid_findings(log: Log) -> tuple[Finding, ...]:
    """Stuck, held and zero values of all aids."""
    out: list[Finding] = []
    for one in log.aids:
        known = ~np.isnan(one.value).any(axis=1)
        if one.aid.zeros or known.sum() < _ENOUGH:
            continue
        time, value = one.time[known] + log.t0, one.value[known]
        out += _stuck(one, time, value) or _held(one, value)
        out += _zeros(one, time, value)
    return tuple(out)


def _stuck(one: Measurements, time: np.ndarray, value: np.ndarray) -> list[Finding]:
    same = np.asarray((np.diff(value, axis=0) == 0).all(axis=1))
    first, length = unexplained(same)
    moving = (np.abs(value[first]) > _ZERO * np.abs(value).max()).any(axis=1) & _sudden(value, same, first, length)
    first, length = first[moving], length[moving]
    if not len(first):
        return []
    share = float((length + 1).sum()) / len(value)
    i = int(np.argmax(length))
    text = (
        f"{one.name} repeats one value {length[i]} times from {time[first[i]]:.6g} to {time[first[i] + length[i]]:.6g} "
        f"s ({100 * share:.0f} % of all values are so): give NaN where it measured nothing"
    )
    return [Finding("aid stuck", share, _LARGE, share <= _LARGE, text)]


def _sudden(value: np.ndarray, same: np.ndarray, first: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Which runs are not of a steady motion without noise: values are noisy, or no other step is as large as theirs."""
    if any(rough(x, same) for x in value.T):
        return np.ones(len(first), dtype=bool)
    steps = np.sqrt((np.diff(value, axis=0) ** 2).sum(axis=1))
    last = first + length
    before, after = np.maximum(first - 1, 0), np.minimum(last, len(steps) - 1)
    own = np.where(last < len(steps), steps[after], 0.0)
    others = steps.copy()
    others[before], others[after] = 0.0, 0.0
    return own > others.max()


def _held(one: Measurements, value: np.ndarray) -> list[Finding]:
    same = np.diff(value, axis=0) == 0
    if value.shape[1] < 2:  # the limit of one channel, 1 in 4, is no evidence
        return []
    count, limit = held(same)
    if count <= limit:
        return []
    rows = int(same.all(axis=1).sum())
    text = (
        f"{rows} of {len(value)} values of {one.name} repeat the one before: it measures less often than it is "
        "recorded; leave the repeated ones out (their noise is not averaged, and they are late)"
    )
    return [Finding("aid repeated", float(count), limit, True, text)]


def _zeros(one: Measurements, time: np.ndarray, value: np.ndarray) -> list[Finding]:
    """Zeros between jumps that are larger than all other steps.

    If steps to and from zero were steps like the others, 2 of n would be the largest two with probability
    2 / (n (n - 1)): below 1 % from 20 values on.
    """
    zero = np.asarray(~value.any(axis=1))
    steps = np.sqrt((np.diff(value, axis=0) ** 2).sum(axis=1))
    border = zero[1:] != zero[:-1]
    inside = zero[1:] & zero[:-1]
    others = steps[~border & ~inside]
    if border.sum() < 2 or not len(others) or float(steps[border].min()) <= float(others.max()):
        return []
    first, length = runs(inside)
    longest = int(length.max()) + 1 if len(first) else 1
    share = float(zero.mean())
    text = (
        f"{one.name} jumps to zero and back, first at {time[int(np.argmax(zero))]:.6g} s ({int(zero.sum())} of "
        f"{len(zero)} values, up to {longest} in a row): give NaN where it measured nothing"
    )
    return [Finding("aid zeros", share, _LARGE, share <= _LARGE, text)]
