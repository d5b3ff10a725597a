"""The turning of the course against the turning of the body about the vertical.

Velocities in n are put together in blocks of some seconds. The change of course from block to block is compared with
the integral of the gyroscopes along the mean specific force. East and North exchanged, north-east-down given as
east-north-up, and gyroscopes of the wrong sign mirror it: the slope is -1. The sense of a velocity (times -1) does not
show, nor how the unit is mounted about the vertical.

What makes it sound: an intercept takes a constant gyro bias; speeds must be well above the noise of the velocity; a
late receiver is allowed for (the lag of the highest correlation is taken, within +-2 s); the correlation must be
beyond chance (Fisher's z at 1e-7 for all lags and lengths of blocks together); the slope must explain 80 % of the
changes, but for the noise of the velocity; and it must remain, at 1e-3, without the two largest turns, so that no
single one decides. A boat in a current, or anything that flies sideways, has a course that turns less than
the vehicle; so only a slope near -1 is a contradiction, and another size is a note.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from jaxalign.aids import Axes
from jaxalign.log import Log
from jaxalign.measurements import Measurements
from jaxalign.trust.chance import ODDS
from jaxalign.trust.finding import Finding

__all__ = ["turning_findings"]

_BLOCKS = (4.0, 8.0)  # s
_LATE = 2.0  # s
_LAGS = 9
_FAST = 5.0  # standard deviations of the velocity of a block: its course is then known to 11 deg
_FEWEST = 8  # changes
_EXPLAINED = 0.8
_SURE = NormalDist().inv_cdf(1 - ODDS / 2 / _LAGS / len(_BLOCKS))  # 5.9
_REMAINS = NormalDist().inv_cdf(1 - 1e-3 / _LAGS / len(_BLOCKS))  # 3.9
_NEAR = 0.25  # of the slope about -1
_SIZE = 2.0
_THIRD = np.sqrt(20.0)  # gain of third differences for white noise


def turning_findings(log: Log) -> tuple[Finding, ...]:
    """Turning of each velocity in n against the gyroscopes."""
    out: list[Finding] = []
    for one in log.aids:
        if one.aid.full_velocity and one.aid.velocity_axes is Axes.NAV:
            out += _of_aid(log, one)
    return tuple(out)


def _of_aid(log: Log, one: Measurements) -> list[Finding]:
    velocity = one.velocity
    if velocity is None:
        return []
    known = ~np.isnan(velocity).any(axis=1)
    time, v = one.time[known], velocity[known, :2]
    if len(time) <= _FEWEST:
        return []
    sd, turned = _noise(one, v), _turned(log)
    fits = [
        fit
        for seconds in _BLOCKS
        if (blocks := _blocks(time, v, sd, seconds)) is not None
        for lag in np.linspace(-_LATE, _LATE, _LAGS)
        if (fit := blocks.fit(turned, lag)) is not None
    ]
    sense = np.sign(max(fits, key=lambda fit: abs(fit.z)).z) if fits else 0.0
    sure = [fit for fit in fits if fit.z * sense > _SURE and fit.explained > _EXPLAINED]
    if max((fit.rest * sense for fit in fits), default=0.0) < _REMAINS:
        return []
    if not sure:
        return []
    fit = max(sure, key=lambda fit: abs(fit.z))
    slope, error = fit.slope, fit.error
    says = f"{slope:.2f} +- {error:.2f} times as far as the gyroscopes say ({fit.changes} changes of course)"
    if abs(slope + 1.0) < _NEAR + 3.0 * error:
        text = (
            f"the course of {one.name} turns against the gyroscopes, {says}: East and North exchanged, NED velocities "
            "given as ENU (CSV: frame or axes of the column map), or gyro signs inverted"
        )
        return [Finding("turning", slope, 1.0, False, text)]
    if abs(slope) > _SIZE + 6.0 * error or slope < 1.0 / _SIZE - 6.0 * error:
        text = f"the course of {one.name} turns {says}: scale of the gyroscopes? (a current or wind makes it so too)"
        return [Finding("turning", slope, 1.0, True, text)]
    return []


class _Fit(NamedTuple):
    """Of changes of course: Fisher's z and that without the largest changes, slope, its error, what it explains."""

    z: float
    rest: float
    slope: float
    error: float
    explained: float
    changes: int


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Blocks of velocities.

    Attributes:
        time: (K, m) s.
        course: (K-1,) changes of course from block to block, rad, from east to north.
        use: (K-1,) whether both blocks are fast, and neighbours.
        noise: mean variance of a change by the noise of the velocity.
    """

    time: np.ndarray
    course: np.ndarray
    use: np.ndarray
    noise: float

    def fit(self, turned: Callable[[np.ndarray], np.ndarray], lag: float) -> _Fit | None:
        """The changes of course over those of the angle `turned`, where the velocity is late by `lag` s."""
        x, y = np.diff(turned(self.time - lag).mean(axis=1))[self.use], self.course[self.use]
        z, slope, error, unexplained, all_of_it = _regression(x, y)
        left = _without_largest(x)
        rest = _regression(x[left], y[left])[0] if left.sum() > 4 else 0.0
        if all_of_it <= 0:
            return None
        too_much = max(unexplained - len(x) * self.noise, 0.0)
        return _Fit(z, rest, slope, error, 1.0 - too_much / all_of_it, len(x))


def _without_largest(x: np.ndarray) -> np.ndarray:
    """(n,) which values are left without the two largest turns, each with what it is in before and after."""
    size = np.abs(x - np.median(x))
    left = np.ones(len(x), dtype=bool)
    for _ in range(2):
        k = int(np.argmax(np.where(left, size, -1.0)))
        left[max(k - 1, 0) : k + 2] = False
    return left


def _blocks(time: np.ndarray, v: np.ndarray, sd: float, seconds: float) -> _Blocks | None:
    """Blocks of so many seconds; None where too few changes of course can be used."""
    interval = float(np.median(np.diff(time)))
    size = max(1, round(seconds / interval))
    count = len(time) // size
    if count <= _FEWEST:
        return None
    time = time[: count * size].reshape(count, size)
    middle = np.median(v[: count * size].reshape(count, size, 2), axis=1)  # outliers do not count
    speed = np.hypot(*middle.T)
    fast = (speed > _FAST * sd / np.sqrt(size)) & (np.ptp(time, axis=1) < 1.5 * size * interval)
    a, b = middle[:-1], middle[1:]
    course = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    near = np.diff(time.mean(axis=1)) < 1.5 * size * interval
    use = fast[:-1] & fast[1:] & near & (np.abs(course) < 0.5 * np.pi)
    if use.sum() < _FEWEST:
        return None
    median_gain = 0.5 * np.pi if size > 2 else 1.0  # variance of a median over that of the mean
    variance = median_gain * sd**2 / size * (1.0 / speed[:-1][use] ** 2 + 1.0 / speed[1:][use] ** 2)
    return _Blocks(time, course, use, float(variance.mean()))


def _noise(one: Measurements, v: np.ndarray) -> float:
    """Standard deviation of a horizontal component, m/s: the larger of what is stated and what the values show."""
    shown = float(np.median(np.abs(np.diff(v, n=3, axis=0)), axis=0).max()) / 0.6745 / _THIRD
    return max(shown, 0.0 if one.sd is None else float(np.max(one.sd)), 1e-3)


def _turned(log: Log) -> Callable[[np.ndarray], np.ndarray]:
    """The angle turned about the vertical since the beginning, rad, as a function of time, s."""
    size = min(max(1, round(1.0 / log.dt)), len(log.dvel))
    kernel = np.ones(size) / size
    up = np.column_stack([np.convolve(log.dvel[:, i], kernel, mode="same") for i in range(3)])
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-300)
    angle = np.concatenate([[0.0], np.cumsum((log.dtheta * up).sum(axis=1))])
    at = np.arange(len(angle)) * log.dt
    return lambda t: np.interp(t, at, angle)


def _regression(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float, float, float]:
    """Fisher's z in standard deviations, slope, its standard error, squares that are left, and all."""
    dx, dy = x - x.mean(), y - y.mean()
    xx, yy, xy = float(dx @ dx), float(dy @ dy), float(dx @ dy)
    if xx <= 0 or yy <= 0:
        return 0.0, 0.0, np.inf, yy, yy
    r = min(max(xy / np.sqrt(xx * yy), -1 + 1e-12), 1 - 1e-12)
    slope, left = xy / xx, max(yy - xy * xy / xx, 0.0)
    return float(np.arctanh(r) * np.sqrt(len(x) - 3)), slope, float(np.sqrt(left / xx / (len(x) - 2))), left, yy
