"""Mistakes in a log by name, of the usual sizes, and where no method can see them.

That is where the log is also that of another, right run: then nothing contradicts it, and the answer is that of the
other run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from jaxalign.aids import Axes
from jaxalign.arguments import nearest
from jaxalign.errors import UserError
from jaxalign.log import Log
from jaxalign.simulate.mistakes import (
    ANY_AID,
    EXCHANGED,
    HEADING,
    NEEDED,
    OTHER_UP,
    QUARTER,
    VELOCITY,
    WHOLE_VELOCITY,
    aid_clock_drifts,
    aid_late,
    aid_scaled,
    heading_turned,
    imu_axes,
    imu_clock,
    imu_scaled,
    lat_lon_exchanged,
    place_moved,
    samples_lost,
    unit_turned,
    velocity_axes,
    velocity_turned,
)

__all__ = ["MISTAKES", "Mistake", "with_mistake"]


@dataclass(frozen=True)
class Mistake:
    """A mistake of a usual size.

    Attributes:
        about: one line of what it is.
        apply: Log -> Log.
        needs: which aid a log must have, in words; "": none.
        hidden: when no method can see it, and why; "": whenever it changes the answer, something contradicts it.
    """

    about: str
    apply: Callable[[Log], Log]
    needs: str
    hidden: str

    def fits(self, log: Log) -> bool:
        """Whether a log has what it needs."""
        return not self.needs or any(map(NEEDED[self.needs], log.aids))


_TURNED = (
    "without a velocity in b or a heading: it is the right answer for the axes of the unit, and nothing else speaks of "
    "the vehicle's"
)
_STILL = "at rest without rocking: force and Earth's rate keep their sizes and their angle, so another heading fits"
_LEVEL = "at rest and level: force and Earth's rate keep their sizes and their angle, so another heading fits"
_QUIET = "without turning or rocking, with gyroscopes too coarse for the Earth's rate: there is no rotation to measure"
_STRAIGHT = "at constant velocity: it enters by its changes alone (and the Coriolis force, 15 ug for 1 m/s)"
_COARSE = "with a unit too coarse for the Earth's rate and a thousandth of gravity, all that a latitude enters by"
_MIRRORED = "on a straight level course, with gyroscopes too coarse for the Earth's rate: it is that of another heading"


def _signs(*signs: int) -> np.ndarray:
    return np.diag(signs)


MISTAKES: dict[str, Mistake] = {
    "gyro-signs": Mistake(
        "all gyroscopes of the wrong sign", partial(imu_axes, matrix=_signs(-1, -1, -1), triad="gyro"), "", _QUIET
    ),
    **{
        f"gyro-{axis}-sign": Mistake(
            f"gyroscope {axis} of the wrong sign",
            partial(imu_axes, matrix=_signs(*(-1 if axis == x else 1 for x in "xyz")), triad="gyro"),
            "",
            _QUIET if axis == "z" else _LEVEL,
        )
        for axis in "xyz"
    },
    "accel-signs": Mistake(
        "all accelerometers of the wrong sign (gravity for specific force)",
        partial(imu_axes, matrix=_signs(-1, -1, -1), triad="accel"),
        "",
        "at rest with gyroscopes too coarse for the Earth's rate: a unit upside down looks so (a log warns of it)",
    ),
    "unit-turned-90": Mistake(
        "x and y of the unit exchanged, one with its sign: turned by 90 deg about up",
        partial(imu_axes, matrix=QUARTER),
        "",
        _TURNED,
    ),
    "unit-turned-180": Mistake(
        "the unit looks backwards: turned by 180 deg about up", partial(unit_turned, yaw_deg=180.0), "", _TURNED
    ),
    "unit-turned-yaw": Mistake("the unit turned by 10 deg in yaw", partial(unit_turned, yaw_deg=10.0), "", _TURNED),
    "unit-turned-pitch": Mistake(
        "the unit turned by 10 deg in pitch", partial(unit_turned, pitch_deg=10.0), "", _TURNED
    ),
    "unit-turned-roll": Mistake("the unit turned by 10 deg in roll", partial(unit_turned, roll_deg=10.0), "", _TURNED),
    "unit-upside-down": Mistake(
        "forward-right-down taken for right-forward-up (a log warns of it)",
        partial(imu_axes, matrix=OTHER_UP),
        "",
        _TURNED,
    ),
    "unit-mirrored": Mistake("x and y of the unit exchanged", partial(imu_axes, matrix=EXCHANGED), "", _STILL),
    "gyro-mirrored": Mistake(
        "x and y of the gyroscopes exchanged", partial(imu_axes, matrix=EXCHANGED, triad="gyro"), "", _LEVEL
    ),
    "gyro-turned-90": Mistake(
        "the gyroscopes turned by 90 deg about up against the accelerometers",
        partial(imu_axes, matrix=QUARTER, triad="gyro"),
        "",
        _LEVEL,
    ),
    "gyro-0.9": Mistake(
        "rates of the gyroscopes 10 % too small", partial(imu_scaled, factor=0.9, triad="gyro"), "", _QUIET
    ),
    "gyro-1.1": Mistake(
        "rates of the gyroscopes 10 % too large", partial(imu_scaled, factor=1.1, triad="gyro"), "", _QUIET
    ),
    "gyro-deg": Mistake(
        "rates of the gyroscopes in deg/s (a log refuses it where they can be compared)",
        partial(imu_scaled, factor=180.0 / np.pi, triad="gyro"),
        "",
        "at rest with gyroscopes so coarse that their noise is all there is",
    ),
    "accel-0.97": Mistake("forces 3 % too small", partial(imu_scaled, factor=0.97, triad="accel"), "", ""),
    "velocity-sign": Mistake(
        "velocities of the wrong sign",
        partial(aid_scaled, factor=-1.0),
        VELOCITY,
        "in n on a level course, with gyroscopes too coarse for the Earth's rate: it is the right log of a heading "
        "turned by 180 deg; in b at constant velocity",
    ),
    "knots": Mistake(
        "velocities in knots taken for m/s", partial(aid_scaled, factor=3600.0 / 1852.0), VELOCITY, _STRAIGHT
    ),
    "km-h": Mistake("velocities in km/h taken for m/s", partial(aid_scaled, factor=3.6), VELOCITY, _STRAIGHT),
    "ft-s": Mistake("velocities in ft/s taken for m/s", partial(aid_scaled, factor=1.0 / 0.3048), VELOCITY, _STRAIGHT),
    "north-east-up": Mistake(
        "east and north exchanged",
        partial(velocity_axes, matrix=EXCHANGED, axes=Axes.NAV),
        WHOLE_VELOCITY[Axes.NAV],
        _MIRRORED,
    ),
    "ned": Mistake(
        "north-east-down given as east-north-up",
        partial(velocity_axes, matrix=OTHER_UP, axes=Axes.NAV),
        WHOLE_VELOCITY[Axes.NAV],
        _MIRRORED,
    ),
    "frd": Mistake(
        "forward-right-down given as right-forward-up",
        partial(velocity_axes, matrix=OTHER_UP, axes=Axes.BODY),
        WHOLE_VELOCITY[Axes.BODY],
        _STRAIGHT,
    ),
    "doppler-turned": Mistake(
        "the instrument of the velocity in b turned by 10 deg in yaw",
        partial(velocity_turned, yaw_deg=10.0),
        WHOLE_VELOCITY[Axes.BODY],
        _STRAIGHT,
    ),
    "heading-from-east": Mistake(
        "headings counter-clockwise from east",
        partial(heading_turned, sign=-1.0, degrees=90.0),
        HEADING,
        "at rest, with gyroscopes too coarse for the Earth's rate and no other aid: it alone tells the heading",
    ),
    "aid-late": Mistake("aids 0.5 s late", partial(aid_late, seconds=0.5), ANY_AID, _STRAIGHT),
    "aid-early": Mistake("aids 0.5 s early", partial(aid_late, seconds=-0.5), ANY_AID, _STRAIGHT),
    "aid-clock": Mistake("the clock of the aids 1 % fast", partial(aid_clock_drifts, percent=1.0), ANY_AID, _STRAIGHT),
    "imu-clock": Mistake(
        "rates of the unit over an interval that is stated 1 % too long",
        partial(imu_clock, percent=1.0),
        ANY_AID,
        "at constant velocity without turning: rates and forces are right, and nothing tells the time",
    ),
    "imu-interval": Mistake(
        "increments of the unit over an interval that is stated 3 % too long",
        partial(imu_clock, percent=3.0, of="increments"),
        "",
        "",
    ),
    "samples-lost": Mistake(
        "5 s of the unit missing in the middle",
        lambda log: samples_lost(log, log.duration / 2, max(5.0, log.interval)),
        "",
        "if the vehicle neither turned nor changed its velocity meanwhile: the Earth's turn of 0.02 deg is all that is "
        "lost",
    ),
    "latitude-sign": Mistake("a latitude of the wrong sign", partial(place_moved, sign=-1.0), "", _COARSE),
    "latitude-off": Mistake(
        "a latitude 10 deg too small in size",
        lambda log: place_moved(log, degrees=-10.0 if log.lat >= 0 else 10.0),
        "",
        _COARSE,
    ),
    "lat-lon": Mistake(
        "latitude and longitude exchanged (a log refuses a latitude beyond 89.5 deg)",
        lat_lon_exchanged,
        "",
        f"{_COARSE}; the longitude itself never counts",
    ),
}
"""Mistakes by name, of the usual sizes."""


def with_mistake(log: Log, name: str) -> Log:
    """A log with one of :data:`MISTAKES`.

    Raises:
        UserError: there is none of that name, the log has not the aid that it needs, or what comes of it is refused.
    """
    if not isinstance(name, str) or name not in MISTAKES:
        raise UserError(f"unknown mistake {name!r}; {nearest(str(name), MISTAKES)}")
    return MISTAKES[name].apply(log)
