"""The Earth's rotation at rest: it must rise against gravity by the latitude.

Gyroscopes whose signs are inverted, and a latitude of the wrong sign, turn the elevation of the mean rate round. The
check speaks only where the mean rate is the Earth's in both parts, along gravity and across it, but for the sign of the
first: within 5 % of the Earth's rate (0.75 deg/h, the bias of a fibre-optic gyroscope), with a standard error of at
most half of that. A unit with random biases of a size like the Earth's rate gets there by chance: the tube of that
radius about a circle has 2 pi cos(lat) pi 0.05^2 = 0.05 of the volume of a cube of the Earth's rate, so 2 in 1000 of
units of 15 deg/h and 1 in 1e5 of 100 deg/h, where their white noise lets the mean be known so well at all.

Means are taken with a smooth taper (Hann) over eight parts of a stretch: what sways and comes back leaves little. Where
their scatter says that the mean is not known well enough, gravity's turning in inertial space is asked
(:mod:`jaxalign.trust.gravity_turn`), with the gyroscopes as they are and, if that gives nothing, with their signs
inverted: where only those give the Earth's rate at its place, they are inverted.
"""

from __future__ import annotations

import numpy as np

from jaxalign.log import Log
from jaxalign.trust.channels import clock
from jaxalign.trust.finding import Finding
from jaxalign.trust.gravity_turn import turning_of_gravity
from jaxalign.trust.standing import Stretch, stretches
from jaxalign.wgs84 import EARTH_RATE

__all__ = ["earth_rate_findings", "mean_rate"]

_NEAR = 0.05  # of the Earth's rate
_PARTS = 8
_LEAST = 10.0  # s of a stretch
_DEG_H = np.degrees(3600.0)


def mean_rate(log: Log, stretch: Stretch) -> tuple[float, float, float]:
    """Mean rate along and across the specific force, and its standard error, of a stretch, rad/s.

    The standard error is that of one component, from the scatter of the parts.
    """
    size = (stretch.stop - stretch.first) // _PARTS
    where = slice(stretch.first, stretch.first + size * _PARTS)
    taper = np.hanning(size + 2)[1:-1]
    taper /= taper.sum() * log.dt
    rates, forces = (x[where].reshape(_PARTS, size, 3).transpose(0, 2, 1) @ taper for x in (log.dtheta, log.dvel))
    error = float(np.sqrt(rates.var(axis=0, ddof=1).mean() / _PARTS))
    up = forces.mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-300)
    rate = rates.mean(axis=0)
    along = float(rate @ up)
    return along, float(np.linalg.norm(rate - along * up)), error


def earth_rate_findings(log: Log) -> tuple[Finding, ...]:
    """The Earth seems to turn the wrong way: by the longest stretch at rest that can tell."""
    if 2.0 * abs(np.sin(log.lat)) < 4.0 * _NEAR:  # the two elevations are too near to each other
        return ()
    for stretch in sorted(stretches(log), key=lambda x: x.first - x.stop):
        seconds = (stretch.stop - stretch.first) * log.dt
        if seconds < _LEAST or stretch.stop - stretch.first < 4 * _PARTS:
            break
        rate = mean_rate(log, stretch)
        if 2.0 * rate[2] > _NEAR * EARTH_RATE and not stretch.still:
            where = slice(stretch.first, stretch.stop)
            rate = turning_of_gravity(log.dtheta[where], log.dvel[where], log.dt)
            if not _is(rate, log.lat) and not _is(rate, -log.lat):
                inverted = turning_of_gravity(-log.dtheta[where], log.dvel[where], log.dt)
                rate = (-inverted[0], *inverted[1:])  # as a vehicle would see it that does not sway
        if _is(rate, -log.lat):
            return (_finding(log, stretch, rate),)
        if _is(rate, log.lat):
            break
    return ()


def _is(rate: tuple[float, float, float], lat: float) -> bool:
    """Whether rates along and across gravity, with their error, are the Earth's at a latitude."""
    along, across, error = rate
    limit = _NEAR * EARTH_RATE
    off = np.hypot(along - EARTH_RATE * np.sin(lat), across - EARTH_RATE * np.cos(lat))
    return bool(2.0 * error < limit and off < limit)


def _finding(log: Log, stretch: Stretch, rate: tuple[float, float, float]) -> Finding:
    along, across, _ = rate
    elevation, lat = np.degrees([np.arctan2(along, across), log.lat])
    text = (
        f"at rest from {clock(log, stretch.first)} to {clock(log, stretch.stop)} s the Earth seems to turn the wrong "
        f"way: the rotation of {_DEG_H * np.hypot(along, across):.2f} deg/h is {elevation:+.1f} deg above the horizon, "
        f"at a latitude of {lat:+.1f} deg: gyro signs are inverted, or the latitude has the wrong sign"
    )
    return Finding("Earth's rotation", float(elevation), float(lat), False, text)
