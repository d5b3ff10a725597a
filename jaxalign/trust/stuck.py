"""Samples that stay at one value: stuck, zero, or at the end of the range.

A run of equal values is explained by rounding where equal neighbours are common: the probability p of one is bounded
from all of the log and from the neighbourhood of the run, and a run of L repeats among N samples is expected N p^L
times. Where repeats are common the samples are not independent of each other (a dithered ring laser gives its pulses in
lumps, with many zeros between): there a run must also stand apart from the other runs of its channel. Beyond that a
unit at rest whose noise is below its quantum gives the same value for as long as it stands. So a channel is stuck only
where others say that it should change: another one of its triad is as lively as usual; or all six begin and end at the
same samples, as a logger does it and no vehicle; or its triad does, and the other one is lively. A channel without
noise is no sensor's, but simulated, and may stay where it is. All three accelerometers at zero are a fault in any case:
gravity is missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxalign.log import Log
from jaxalign.trust.chance import ODDS, repeat_odds, run_gap
from jaxalign.trust.channels import Channel, channels, clock, quantum, rough, rounding, spread, without_gravity
from jaxalign.trust.finding import Finding
from jaxalign.wgs84 import STANDARD_GRAVITY

__all__ = ["LOST_ANGLE", "LOST_VELOCITY", "runs", "stuck_findings", "unexplained"]

LOST_ANGLE = 0.1 * np.pi / 180.0
"""rad: what is lost of a rotation is an error of the attitude of that size; fine alignment is asked for 0.1 deg."""
LOST_VELOCITY = 0.1
"""m/s: 0.1 deg of a tilt over 6 s of gravity, or of a heading found from a change of velocity of 60 m/s."""
_LEAST = 4  # repeats
_AROUND = 500  # samples on either side from which the odds of a repeat are taken; at least ten times the run
_LIVELY = 0.5  # of the usual spread
_COMMON = 0.02  # short runs per sample: so many that the tail of their lengths is known
_STEPS = 3.0  # quanta: a value that rests between two levels leaves by one, or two with a slope
_DEAD = 0.9  # of the log


@dataclass(frozen=True)
class _Run:
    """`first` to `last` sample (both included) of channel `index` are equal."""

    index: int
    first: int
    last: int


def runs(same: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the first of equal samples, and number of repeats, of each run of equal neighbours (N-1,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    return edges[::2], edges[1::2] - edges[::2]


def unexplained(same: np.ndarray, around: int = _AROUND) -> tuple[np.ndarray, np.ndarray]:
    """The runs that chance does not explain: first sample and repeats (see the module's docstring)."""
    first, length = runs(same)
    least = _LEAST
    if (length < _LEAST).sum() > _COMMON * len(same):
        least = max(least, run_gap(length))
    keep = length >= least
    first, length = first[keep], length[keep]
    total = np.concatenate([[0], np.cumsum(same)])
    reach = np.maximum(around, 10 * length)
    low, high = np.maximum(first - reach, 0), np.minimum(first + length + reach, len(same))
    near = repeat_odds(total[high] - total[low] - length, high - low - length)
    everywhere = repeat_odds(total[-1] - length, len(same) - length)
    log_odds = np.log(len(same)) + length * np.log(np.maximum(near, everywhere))
    found = log_odds < np.log(ODDS)
    return first[found], length[found]


def stuck_findings(log: Log) -> tuple[Finding, ...]:
    """Stuck and dead channels, zeros, and the end of a range."""
    all_six = channels(log)
    zero = without_gravity(log)
    found: list[_Run] = []
    for i, channel in enumerate(all_six):
        found += _of_channel(i, channel)
    found = [run for run in found if _should_change(run, all_six) and not zero[run.first : run.last + 1].all()]
    dead = [i for i in range(6) if _dead(i, all_six)]
    out = [*_zero_finding(log, zero)]
    for i in dead:
        name = all_six[i].name
        text = (
            f"{name} never changes while the others of its triad do: is it connected, and is its column the right one?"
        )
        out.append(Finding("dead channel", 1.0, _DEAD, False, text))
    return tuple(out + _findings(log, [run for run in found if run.index not in dead], all_six))


def _of_channel(index: int, channel: Channel) -> list[_Run]:
    x, same = channel.values, channel.same
    first, length = unexplained(same)
    if not len(first) or not rough(x, same):
        return []
    step, last = quantum(x), first + length
    before = np.abs(x[first] - x[np.maximum(first - 1, 0)])  # at the ends of the log: nothing
    after = np.abs(x[last] - x[np.minimum(last + 1, len(x) - 1)])
    jumps = np.maximum(before, after) > _STEPS * step
    return [_Run(index, int(a), int(b)) for a, b in zip(first[jumps], last[jumps], strict=True)]


def _should_change(run: _Run, all_six: tuple[Channel, ...]) -> bool:
    """Whether the other channels say that this one should change there."""
    own = range(3 * (run.index // 3), 3 * (run.index // 3) + 3)
    still = [i for i in range(6) if all_six[i].same[run.first : run.last].all()]
    exact = [i for i in still if _begins_and_ends(all_six[i].same, run)]
    if len(exact) >= 5 and len(still) == 6:  # one may by chance have had its value before or after
        return True
    witnesses = [i for i in own if i not in still]
    if all(i in exact for i in own) and run.first > 0 and run.last < len(all_six[0].values) - 1:
        witnesses = [i for i in range(6) if i not in own]
    return any(_lively(all_six[i].values, run) for i in witnesses)


def _begins_and_ends(same: np.ndarray, run: _Run) -> bool:
    return not same[max(run.first - 1, 0) : run.first].any() and not same[run.last : run.last + 1].any()


def _lively(x: np.ndarray, run: _Run) -> bool:
    part = x[run.first : run.last + 1]
    usual = spread(x, len(part))
    return usual > 0 and float(part.std()) >= _LIVELY * usual


def _dead(index: int, all_six: tuple[Channel, ...]) -> bool:
    """Whether a channel is the same all the time while the others of its triad show their noise."""
    if all_six[index].same.mean() < _DEAD:
        return False
    others = [i for i in range(3 * (index // 3), 3 * (index // 3) + 3) if i != index]
    return all(all_six[i].same.mean() < 0.5 and rough(all_six[i].values, all_six[i].same) for i in others)


def _zero_finding(log: Log, zero: np.ndarray) -> list[Finding]:
    count = int(zero.sum())
    if not count:
        return []
    still = all((np.abs(x[zero]) <= rounding(x)).all() for x in log.dtheta.T)
    which = "all six channels are" if still else "all accelerometers are"
    first = int(np.argmax(zero))
    lost = count * log.dt * STANDARD_GRAVITY
    return [
        Finding(
            "zeros",
            lost,
            LOST_VELOCITY,
            lost <= LOST_VELOCITY,
            f"{which} exactly zero in {count} samples, first at {clock(log, first)} s, so {lost:.2g} m/s of gravity are"
            " missing: samples were lost; align the part before or after, or interpolate",
        )
    ]


def _findings(log: Log, found: list[_Run], all_six: tuple[Channel, ...]) -> list[Finding]:
    """One finding for runs of the same kind: of a triad stuck, of one at the end of its range."""
    out = []
    for start, what, unit, limit in ((0, "gyro", "rad", LOST_ANGLE), (3, "accelerometer", "m/s", LOST_VELOCITY)):
        of_triad = [run for run in found if start <= run.index < start + 3]
        for kind in ("zeros", "saturation", "stuck samples"):
            some = [run for run in of_triad if _kind(run, all_six[run.index].values) == kind]
            if not some:
                continue
            longest = max(some, key=lambda run: run.last - run.first)
            lost = max(_lost(some, i, all_six[i].values) for i in {run.index for run in some})
            axes = ", ".join(sorted({all_six[run.index].axis for run in some}))
            seconds = (longest.last - longest.first + 1) * log.dt
            says = {
                "zeros": "is exactly zero",
                "saturation": "stays at the end of its range",
                "stuck samples": "stays at one value",
            }[kind]
            mend = (
                "choose a larger range"
                if kind == "saturation"
                else "align the part before or after, or mend the logger"
            )
            more = f" ({len(some)} times in all)" if len(some) > 1 else ""
            text = (
                f"{what} {axes} {says} for {seconds:.3g} s from {clock(log, longest.first)} s{more}, while it should "
                f"change; some {lost:.2g} {unit} may be lost: {mend}"
            )
            out.append(Finding(kind, lost, limit, lost <= limit, text))
    return out


def _kind(run: _Run, x: np.ndarray) -> str:
    value = x[run.first]
    same = rounding(x)
    if abs(value) <= same:
        return "zeros"
    return "saturation" if value >= x.max() - same or value <= x.min() + same else "stuck samples"


def _lost(some: list[_Run], index: int, x: np.ndarray) -> float:
    """What may be lost of the sum of a channel: the usual distance from the value at which it stays, times the run."""
    return sum(
        (run.last - run.first + 1) * float(np.sqrt(np.mean((x - x[run.first]) ** 2)))
        for run in some
        if run.index == index
    )
