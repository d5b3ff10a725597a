"""The turning of the course against the turning of the body about the vertical.

The change of course of a velocity in n within windows of some seconds is compared with the integral of the gyroscopes
along the mean specific force. East and North exchanged, north-east-down given as east-north-up, and gyroscopes of the
wrong sign mirror it: the slope is -1. The sense of a velocity (times -1) does not show, nor how the unit is mounted
about the vertical.

What makes it sound: an intercept takes a constant gyro bias; speeds must be well above the noise of the velocity; a
late receiver is allowed for (the lag of the highest correlation is taken, within +-2 s); the correlation must be
beyond chance (Fisher's z at 1e-7, for all lags) and explain 80 %; and it must remain, at 1e-3, without the largest
window of either sense, so that no single turn decides. A boat in a current, or anything that flies sideways, has a
course that turns less than the vehicle; so only a slope near -1 is a contradiction, and another size is a note.
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from jaxalign.aids import Axes
from jaxalign.log import Log
from jaxalign.measurements import Measurements
from jaxalign.trust.chance import ODDS
from jaxalign.trust.finding import Finding

__all__ = ["turning_findings"]

_WINDOW = 4.0  # s; at least two intervals of the aid
_LATE = 2.0  # s
_LAGS = 9
_FAST = 5.0  # standard deviations: the course is then known to 11 deg
_EXPLAINED = 0.8
_SURE = NormalDist().inv_cdf(1 - ODDS / 2 / _LAGS)  # 5.7
_REMAINS = NormalDist().inv_cdf(1 - 1e-3)
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
    time, v = one.time[known], velocity[known]
    if len(time) < 10:
        return []
    start, stop, course = _course_changes(time, v, _noise(one, v))
    if len(start) < 8:
        return []
    turn = _turned(log)
    best = max((_fit(turn(stop - lag) - turn(start - lag), course) for lag in np.linspace(-_LATE, _LATE, _LAGS)), key=abs_z)
    z, r, slope, error, rest = best
    if abs(z) < _SURE or r**2 < _EXPLAINED or abs(rest) < _REMAINS or rest * z < 0:
        return []
    if z < 0 and abs(slope + 1.0) < _NEAR + 3.0 * error:
        text = (
            f"the course of {one.name} turns against the gyroscopes ({slope:.2f} +- {error:.2f} times as far, "
            f"{len(course)} windows): East and North exchanged, NED velocities given as ENU (CSV: frame or axes of the "
            "column map), or gyro signs inverted"
        )
        return [Finding("turning", slope, 1.0, False, text)]
    if abs(slope) > _SIZE + 6.0 * error or abs(slope) < 1.0 / _SIZE - 6.0 * error:
        text = (
            f"the course of {one.name} turns {slope:.2f} +- {error:.2f} times as far as the gyroscopes say: scale of the "
            "gyroscopes? (a current or wind makes it so too)"
        )
        return [Finding("turning", slope, 1.0, True, text)]
    return []


def abs_z(fit: tuple[float, ...]) -> float:
    """How sure a fit is."""
    return abs(fit[0])


def _noise(one: Measurements, v: np.ndarray) -> float:
    """Standard deviation of a horizontal component, m/s: the larger of what is stated and what the values show."""
    shown = float(np.median(np.abs(np.diff(v[:, :2], n=3, axis=0)), axis=0).max()) / 0.6745 / _THIRD
    return max(shown, 0.0 if one.sd is None else float(np.max(one.sd)), 1e-3)


def _course_changes(time: np.ndarray, v: np.ndarray, sd: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Begin, end (s) and change of course (rad, from east to north) of windows in which the vehicle is fast enough."""
    a, b = v[:-1], v[1:]
    step = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])
    fast = np.hypot(v[:, 0], v[:, 1]) > _FAST * sd
    interval = float(np.median(np.diff(time)))
    good = fast[:-1] & fast[1:] & (np.diff(time) < 1.5 * interval) & (np.abs(step) < 0.5 * np.pi)
    size = max(2, round(_WINDOW / interval))
    found, k = [], 0
    while k + size <= len(step):
        bad = np.flatnonzero(~good[k : k + size])
        if len(bad):
            k += int(bad[-1]) + 1
            continue
        found.append((time[k], time[k + size], step[k : k + size].sum()))
        k += size
    start, stop, course = np.asarray(found, dtype=float).reshape(-1, 3).T
    return start, stop, course


def _turned(log: Log):
    """The angle turned about the vertical since the beginning, rad, as a function of time, s."""
    size = max(1, round(1.0 / log.dt))
    kernel = np.ones(size) / size
    up = np.column_stack([np.convolve(log.dvel[:, i], kernel, mode="same") for i in range(3)])
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-300)
    angle = np.concatenate([[0.0], np.cumsum((log.dtheta * up).sum(axis=1))])
    at = np.arange(len(angle)) * log.dt
    return lambda t: np.interp(t, at, angle)


def _fit(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float, float, float]:
    """Fisher's z in standard deviations, correlation, slope and its standard error, z without the largest windows."""
    z, r, slope, error = _regression(x, y)
    left = np.ones(len(x), dtype=bool)
    left[[int(np.argmax(x)), int(np.argmin(x))]] = False
    return z, r, slope, error, _regression(x[left], y[left])[0]


def _regression(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float, float]:
    dx, dy = x - x.mean(), y - y.mean()
    xx, yy, xy = float(dx @ dx), float(dy @ dy), float(dx @ dy)
    if xx <= 0 or yy <= 0:
        return 0.0, 0.0, 0.0, np.inf
    r = min(max(xy / np.sqrt(xx * yy), -1 + 1e-12), 1 - 1e-12)
    n = len(x)
    slope = xy / xx
    error = float(np.sqrt(max(yy - slope * xy, 0.0) / xx / (n - 2)))
    return float(np.arctanh(r) * np.sqrt(n - 3)), float(r), slope, error
