"""Single samples that stand apart from both neighbours by more than the tail of all others explains.

How far a sample is outside what its neighbours say: the distance from the range between the medians of the three
before and the three after. A step of the motion, at a sample or within one, gives nothing. What a vehicle does in
blows is in the tail of the log itself (:func:`jaxalign.trust.chance.tail_gap`). Where that tail is so heavy that it
tells nothing, as of a vehicle that stands and then drives over stones, a sample that no vehicle does is a spike, if the
others are a tenth of it at most.
"""

from __future__ import annotations

import numpy as np

from jaxalign.log import Log
from jaxalign.trust.chance import tail_gap
from jaxalign.trust.channels import channels, clock, quantum, without_gravity
from jaxalign.trust.finding import Finding
from jaxalign.trust.stuck import LOST_ANGLE

__all__ = ["outside", "spike_findings"]

_BLOW = 1.0  # m/s: a body falls 5 cm for it; a blow may do it within one sample
_IMPOSSIBLE = {"gyro": (0.1, 35.0), "accelerometer": (10.0, 1000.0)}
"""rad and rad/s (2000 deg/s, the range of most units); m/s (a fall of 5 m) and m/s^2: both at once, in one sample."""
_ALONE = 0.1  # of the spike: what its neighbours may show


def _median3(x: np.ndarray) -> np.ndarray:
    a, b, c = x[:-2], x[1:-1], x[2:]
    return np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))


def outside(x: np.ndarray) -> np.ndarray:
    """(N,) signed distance of each sample from what its neighbours say; 0 for the first and last three."""
    out = np.zeros(len(x))
    if len(x) < 7:
        return out
    medians = _median3(x)  # of i-1, i, i+1 at i - 1
    before, after = medians[:-4], medians[4:]
    here = x[3:-3]
    low, high = np.minimum(before, after), np.maximum(before, after)
    out[3:-3] = np.where(here > high, here - high, np.where(here < low, here - low, 0.0))
    return out


def spike_findings(log: Log) -> tuple[Finding, ...]:
    """Spikes of gyroscopes and accelerometers."""
    out, zero = [], without_gravity(log)
    for channel in channels(log):
        x = channel.values
        far = np.abs(outside(x))
        count, ratio, limit = tail_gap(far, quantum(x))
        if not count:
            count, ratio, limit = _impossible(far, *_IMPOSSIBLE[channel.triad], log.dt)
        rows = np.argsort(-far)[:count]
        if not count or not all(_alone(x, int(row), float(far[row])) for row in rows):
            continue
        if zero[rows].all():  # zeros are a finding of their own
            continue
        row = int(rows[0])
        size = float(far[row])
        unit, harm = ("rad", LOST_ANGLE) if channel.triad == "gyro" else ("m/s", _BLOW)
        more = f" (and {count - 1} more)" if count > 1 else ""
        text = (
            f"{channel.name} is off by {size:.3g} {unit} in the one sample at {clock(log, row)} s{more}, "
            f"{ratio:.3g} times more than anywhere else: replace it by the mean of its neighbours"
        )
        out.append(Finding("spike", ratio, limit, size <= harm, text))
    return tuple(out)


def _impossible(far: np.ndarray, step: float, rate: float, dt: float) -> tuple[int, float, float]:
    """As `tail_gap`, of samples that no vehicle does."""
    limit = max(step, rate * dt)
    count = int((far > limit).sum())
    if not 1 <= count <= 3:
        return 0, 1.0, np.inf
    top = np.sort(far)[::-1]
    ratio = float(top[count - 1] / max(top[count], 1e-300))
    return (count, ratio, 1.0 / _ALONE) if ratio > 1.0 / _ALONE else (0, 1.0, np.inf)


def _alone(x: np.ndarray, row: int, size: float) -> bool:
    """Whether the neighbours show nothing of it, as of a blow that rings they do."""
    near = x[[row - 2, row - 1, row + 1, row + 2]]
    return float(np.ptp(near)) < _ALONE * abs(size)
