"""Whole rows that are repeated, as in a record that was sampled up by holding, or filled where rows were lost.

In such a record a row that repeats the one before is followed by one in which all channels change. With m channels
that repeat independently of each other, each with a probability p of its own, a sample does that with probability
prod p (1 - p) <= 4^-m, whatever the quantum. So more than 1 in 64 such samples of a triad, or 1 in 4096 of both, are
not chance.
"""

from __future__ import annotations

import numpy as np

from jaxalign.log import Log
from jaxalign.trust.chance import most_events
from jaxalign.trust.channels import channels, clock
from jaxalign.trust.finding import Finding

__all__ = ["held", "held_findings"]


def held(same: np.ndarray) -> tuple[int, float]:
    """How often a repeated row is followed by one that is new in all, and what chance gives at most.

    Args:
        same: (N-1, m) whether a value equals the one before.

    Returns:
        The number, and its limit.
    """
    repeated, new = np.asarray(same.all(axis=1)), np.asarray(~same.any(axis=1))
    return int((repeated[:-1] & new[1:]).sum()), most_events(len(same) * 4.0 ** -same.shape[1])


def held_findings(log: Log) -> tuple[Finding, ...]:
    """Repeated rows of both triads, or of one of them: a note, since the sums are right but for half an interval."""
    same = np.column_stack([channel.same for channel in channels(log)])
    for what, part in (("IMU", same), ("gyro", same[:, :3]), ("accelerometer", same[:, 3:])):
        count, limit = held(part)
        if count > limit:
            rows = np.asarray(part.all(axis=1))
            return (
                Finding(
                    "repeated samples",
                    float(count),
                    limit,
                    True,
                    f"{int(rows.sum())} of {len(rows) + 1} {what} rows repeat the one before, the first at "
                    f"{clock(log, int(rows.argmax()) + 1)} s: was the record sampled up, or were lost rows filled? "
                    "Give it at the rate at which the unit measures",
                ),
            )
    return ()
