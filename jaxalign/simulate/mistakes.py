"""What people get wrong about a log: axes, signs, units, clocks, the place; on the host, in NumPy.

Functions ``Log -> Log``. The log is made anew, and so checked anew: a mistake that it refuses raises its `UserError`,
one that it warns of adds the warning. The reference attitude stays what the vehicle did, and with the samples of the
unit: against it the attitude that such a log gives is wrong. By name: :mod:`jaxalign.simulate.named_mistakes`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from jaxalign.aids import Axes, Heading
from jaxalign.arguments import check_choice
from jaxalign.checks import finite_number
from jaxalign.errors import UserError
from jaxalign.log import Log
from jaxalign.measurements import Measurements

__all__ = [
    "ANY_AID",
    "EXCHANGED",
    "HEADING",
    "NEEDED",
    "OTHER_UP",
    "QUARTER",
    "VELOCITY",
    "WHOLE_VELOCITY",
    "aid_clock_drifts",
    "aid_late",
    "aid_scaled",
    "heading_turned",
    "imu_axes",
    "imu_clock",
    "imu_scaled",
    "lat_lon_exchanged",
    "place_moved",
    "samples_lost",
    "unit_turned",
    "velocity_axes",
    "velocity_turned",
]

Triads = Literal["gyro", "accel", "both"]
_TRIADS = ("gyro", "accel", "both")
_DEG = np.pi / 180.0
_SAME = 1e-6  # of a sample

EXCHANGED = np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1]])
"""x and y exchanged: a reflection."""
QUARTER = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
"""Axes turned by 90 deg about z, counter-clockwise: x is what y was."""
OTHER_UP = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""East-north-up as north-east-down, right-forward-up as forward-right-down, and back."""


def _replaced(log: Log, **fields: Any) -> Log:
    """With other fields; of the warnings those that were given are kept, what the data show is found anew."""
    return dataclasses.replace(log, **{"warnings": log._told(), **fields})


def _number(what: str, value: Any) -> float:
    return finite_number("mistake", what, value)


def _turn(yaw_deg: Any, pitch_deg: Any, roll_deg: Any) -> np.ndarray:
    """Components along axes that are turned: the transpose of Rz(yaw) Rx(pitch) Ry(roll)."""
    yaw, pitch, roll = (
        _number(what, x) * _DEG for what, x in (("yaw_deg", yaw_deg), ("pitch_deg", pitch_deg), ("roll_deg", roll_deg))
    )
    (a, b), (c, d), (e, f) = ((np.cos(x), np.sin(x)) for x in (yaw, pitch, roll))
    z = np.array([[a, -b, 0.0], [b, a, 0.0], [0.0, 0.0, 1.0]])
    x = np.array([[1.0, 0.0, 0.0], [0.0, c, -d], [0.0, d, c]])
    y = np.array([[e, 0.0, f], [0.0, 1.0, 0.0], [-f, 0.0, e]])
    return (z @ x @ y).T


def _mixed(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Matrix times each row; a missing component (NaN) only spoils what has a part of it."""
    parts = np.where(matrix == 0, 0.0, matrix * values[:, None, :])
    return parts.sum(axis=2)


# --- inertial unit ----------------------------------------------------------------------------------------


def imu_axes(log: Log, matrix: Any, triad: Triads = "both") -> Log:
    """Other axes or signs: what is recorded is a matrix times what was measured.

    Args:
        log: it.
        matrix: (3, 3).
        triad: "gyro", "accel" or "both".

    Raises:
        UserError: a matrix of another shape, or a log that cannot be.
    """
    check_choice("triad", triad, _TRIADS)
    m = np.asarray(matrix, float)
    if m.shape != (3, 3):
        raise UserError(f"mistake: matrix has the shape {m.shape}: (3, 3) is expected")
    dtheta = log.dtheta if triad == "accel" else log.dtheta @ m.T
    dvel = log.dvel if triad == "gyro" else log.dvel @ m.T
    return _replaced(log, dtheta=dtheta, dvel=dvel)


def unit_turned(log: Log, yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> Log:
    """The unit sits turned in the vehicle, by Rz(yaw) Rx(pitch) Ry(roll) (yaw counter-clockwise), and nobody knows."""
    return imu_axes(log, _turn(yaw_deg, pitch_deg, roll_deg))


def imu_scaled(log: Log, factor: float, triad: Triads) -> Log:
    """Increments of a triad times a factor: a wrong unit or scale."""
    return imu_axes(log, _number("factor", factor) * np.eye(3), triad)


# --- velocities and headings of aids -----------------------------------------------------------------------


def _lacking(log: Log, what: str) -> UserError:
    there = ", ".join(one.aid.described for one in log.aids) or "none: the vehicle stands"
    return UserError(f"{log.name}: this mistake needs {what}; its aids: {there}")


def _changed(log: Log, what: str, change: Callable[[np.ndarray], Any]) -> Log:
    """Other values of the aids that are such; their stated noise stays."""
    which = NEEDED[what]
    if not any(map(which, log.aids)):
        raise _lacking(log, what)
    aids = (dataclasses.replace(one, value=change(one.value)) if which(one) else one for one in log.aids)
    return _replaced(log, aids=tuple(aids))


def _speaks(one: Measurements) -> bool:
    """Whether it has a velocity, not only zeros."""
    return one.aid.measures_velocity and not one.aid.zeros


def _whole(axes: Axes) -> Callable[[Measurements], bool]:
    """Whether it has three components of a velocity in these axes."""
    return lambda one: (
        _speaks(one) and one.aid.full_velocity and one.aid.velocity_axes is axes and len(one.aid.components) == 3
    )


ANY_AID, VELOCITY, HEADING = "an aid", "an aid that measures a velocity", "an aid that is a heading"
WHOLE_VELOCITY = {Axes.BODY: "an aid with a whole velocity in b", Axes.NAV: "an aid with a whole velocity in n"}
NEEDED: dict[str, Callable[[Measurements], bool]] = {
    ANY_AID: lambda one: True,
    VELOCITY: _speaks,
    WHOLE_VELOCITY[Axes.BODY]: _whole(Axes.BODY),
    WHOLE_VELOCITY[Axes.NAV]: _whole(Axes.NAV),
    HEADING: lambda one: isinstance(one.aid, Heading),
}
"""What a mistake needs, in words, and which aids are such."""


def aid_scaled(log: Log, factor: float) -> Log:
    """Velocities of aids times a factor: knots taken for m/s are 1 / 0.514444 times too large; -1 is the wrong sign.

    Raises:
        UserError: no aid measures a velocity, or it becomes absurd.
    """
    number = _number("factor", factor)
    return _changed(log, VELOCITY, lambda value: value * number)


def velocity_axes(log: Log, matrix: Any, axes: Axes) -> Log:
    """Whole velocities of aids with other axes or signs: what is recorded is a matrix times what was measured.

    Args:
        log: it.
        matrix: (3, 3).
        axes: of the aids that are meant.

    Raises:
        UserError: no aid has a whole velocity in these axes.
    """
    m = np.asarray(matrix, float)
    return _changed(log, WHOLE_VELOCITY[axes], lambda value: _mixed(m, value))


def velocity_turned(log: Log, yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> Log:
    """The instrument of a velocity in b sits turned in the vehicle (as in :func:`unit_turned`), and nobody knows."""
    return velocity_axes(log, _turn(yaw_deg, pitch_deg, roll_deg), Axes.BODY)


def heading_turned(log: Log, sign: float = 1.0, degrees: float = 0.0) -> Log:
    """Headings times a sign, plus an angle; counter-clockwise from east is the sign -1 and 90 deg.

    Raises:
        UserError: no aid is a heading.
    """
    sign, angle = _number("sign", sign), _number("degrees", degrees) * _DEG

    def change(value: np.ndarray) -> np.ndarray:
        return np.remainder(sign * value + angle, 2 * np.pi)

    return _changed(log, HEADING, change)


# --- clocks -------------------------------------------------------------------------------------------------


def _stamped(log: Log, stamp: Callable[[np.ndarray], np.ndarray], end: float | None = None, **fields: Any) -> Log:
    """Aids with other times; values that then are outside the record are cut off, as a reader would."""
    if not log.aids:
        raise _lacking(log, ANY_AID)
    end, tick = len(log.dtheta) * log.dt if end is None else end, _SAME * log.dt
    aids = []
    for one in log.aids:
        time = stamp(one.time)
        inside = (time >= -tick) & (time <= end + tick)
        if not inside.any() or np.isnan(one.value[inside]).all():
            raise UserError(f"{log.name}: no value of {one.name} is left within the record: choose a smaller mistake")
        aids.append(dataclasses.replace(one, time=time[inside], value=one.value[inside]))
    return _replaced(log, aids=tuple(aids), **fields)


def aid_late(log: Log, seconds: float) -> Log:
    """Values of the aids are stamped so much too late (s; below zero: too early)."""
    late = _number("seconds", seconds)
    return _stamped(log, lambda time: time + late)


def aid_clock_drifts(log: Log, percent: float) -> Log:
    """The clock of the aids runs too fast by so many %, and is right at the start."""
    fast = 1.0 + _number("percent", percent) / 100.0
    if fast <= 0:
        raise UserError(f"percent: {percent!r}: a clock that stands or runs backwards is no log")
    return _stamped(log, lambda time: time * fast)


def imu_clock(log: Log, percent: float, of: Literal["rates", "increments"] = "rates") -> Log:
    """The sampling interval of the unit is stated too long by so many %.

    Args:
        log: it.
        percent: too long.
        of: what the unit puts out: "rates", which the interval then makes too large increments of, or "increments",
            which stay as they are and look like smaller rates.

    Raises:
        UserError: a log that cannot be.
    """
    check_choice("of", of, ("rates", "increments"))
    factor = 1.0 + _number("percent", percent) / 100.0
    size = factor if of == "rates" else 1.0
    own = {"dt": log.dt * factor, "dtheta": log.dtheta * size, "dvel": log.dvel * size}
    if not log.aids:
        return _replaced(log, **own)
    return _stamped(log, lambda time: time, len(log.dtheta) * log.dt * factor, **own)


def samples_lost(log: Log, start: float, seconds: float) -> Log:
    """A block of samples of the unit is missing, and those behind it have closed up; aids keep their times.

    Args:
        log: it.
        start: of the block, s; snapped to an epoch, so that the reference attitude stays with its samples.
        seconds: of it; likewise.

    Raises:
        UserError: the block is empty or outside the record, or too little is left.
    """
    first = round(_number("start", start) / log.interval)
    count = round(_number("seconds", seconds) / log.interval)
    if count < 1 or first < 0 or first + count > log.epochs:
        raise UserError(
            f"{log.name}: no block of {seconds:g} s at {start:g} s: choose whole epochs of {log.interval:g} s within "
            f"the {log.duration:g} s"
        )
    lost = slice(first * log.epoch_samples, (first + count) * log.epoch_samples)
    own: dict[str, Any] = {key: np.delete(getattr(log, key), lost, axis=0) for key in ("dtheta", "dvel")}
    if log.C_nb is not None:
        own["C_nb"] = np.delete(log.C_nb, slice(first + 1, first + count + 1), axis=0)
    if not log.aids:
        return _replaced(log, **own)
    return _stamped(log, lambda time: time, len(own["dtheta"]) * log.dt, **own)


# --- place --------------------------------------------------------------------------------------------------


def place_moved(log: Log, sign: float = 1.0, degrees: float = 0.0) -> Log:
    """The latitude times a sign, plus an angle.

    Raises:
        UserError: it is beyond 89.5 deg.
    """
    return _replaced(log, lat=_number("sign", sign) * log.lat + _number("degrees", degrees) * _DEG)


def lat_lon_exchanged(log: Log) -> Log:
    """Latitude given for longitude, and the other way round.

    Raises:
        UserError: the longitude is no latitude.
    """
    return _replaced(log, lat=log.lon, lon=log.lat)
