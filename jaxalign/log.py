"""The checked log: what an inertial unit and its aids have recorded, on the host, in NumPy."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxalign import checks
from jaxalign.aids import AbstractAid, Axes
from jaxalign.arguments import whole_number
from jaxalign.errors import UserError
from jaxalign.measurements import Measurements
from jaxalign.plausibility import axis_warnings, check_gyro_units, check_specific_force
from jaxalign.wgs84 import SEMI_MAJOR_AXIS

__all__ = ["Log"]

_FAR = 1e4  # m: 0.02 deg of heading
_STILL = 0.05  # m/s
_TICK = 1e-6  # of a sample: times nearer to each other are one


@dataclass(frozen=True, eq=False)
class Log:
    """IMU increments at one rate, aids on their own clocks, and the place.

    Epoch k (k = 0..M, M = N // epoch_samples) is at the end of IMU sample ``k * epoch_samples``; epoch 0 is the start.
    The reference attitude is at the epochs. Aids may measure at any time; those of most logs measure at epochs.
    Everything is checked when a log is made, so that what comes later need not.

    Attributes:
        dtheta: (N, 3) rotation increments of the gyroscopes, rad, b = right-forward-up.
        dvel: (N, 3) velocity increments of the accelerometers, m/s, b.
        dt: sampling interval, s.
        epoch_samples: IMU samples per epoch.
        lat: latitude, rad.
        lon: longitude, rad.
        h: height, m.
        aids: what the aids have measured (:class:`jaxalign.Measurements`); none: the vehicle stands.
        C_nb: (M+1, 3, 3) reference attitude at the epochs, NaN where unknown, if there is one.
        t0: time of epoch 0, s.
        name: what to call it in messages and titles.
        warnings: findings that do not prevent alignment but that a person should read; what the data
            themselves show is added.

    Raises:
        UserError: wrong shape, float32 increments, NaN in the IMU, wrong units where the data show it, an aid outside
            the inertial record or twice, too short, a latitude in degrees or beyond 89.5 deg, a reference that is no
            rotation.
    """

    dtheta: np.ndarray
    dvel: np.ndarray
    dt: float
    epoch_samples: int
    lat: float
    lon: float = 0.0
    h: float = 0.0
    aids: tuple[Measurements, ...] = ()
    C_nb: np.ndarray | None = None
    t0: float = 0.0
    name: str = "log"
    warnings: tuple[str, ...] = ()

    def __post_init__(self):
        def put(**fields: Any) -> None:
            for key, value in fields.items():
                object.__setattr__(self, key, value)

        name = self.name
        put(**{key: checks.finite_number(name, key, getattr(self, key)) for key in ("dt", "lat", "lon", "h", "t0")})
        checks.check_rate(name, self.dt)
        checks.check_site(name, self.lat, self.lon, self.h)
        samples_of_epoch = whole_number(f"{name}: epoch_samples", self.epoch_samples, of="IMU samples", floats=True)
        put(epoch_samples=samples_of_epoch)
        for key in ("dtheta", "dvel"):
            put(**{key: checks.increments(name, key, getattr(self, key), self.dt)})
        if len(self.dtheta) != len(self.dvel):
            raise UserError(f"{name}: dtheta has {len(self.dtheta)} rows, dvel {len(self.dvel)}: they must be equal")
        checks.check_length(name, self.epochs, self.epoch_samples * self.dt)
        put(aids=self._checked_aids())
        if self.C_nb is not None:
            put(C_nb=checks.reference(name, self.C_nb, self.epochs))

        check_specific_force(name, self.dvel, self.dt)
        course = self._course()
        standing = self.standing or (course is not None and bool(np.nanmax(np.abs(course)) <= _STILL))
        check_gyro_units(name, self.dtheta, self.dvel, self.dt, self.lat, course, self.epoch_samples, standing)
        put(warnings=tuple(dict.fromkeys((*self.warnings, *self._findings()))))

    def _checked_aids(self) -> tuple[Measurements, ...]:
        given = self.aids
        if isinstance(given, Measurements):
            given = (given,)
        if not isinstance(given, tuple | list) or not all(isinstance(x, Measurements) for x in given):
            raise UserError(f"{self.name}: aids must be Measurements, got {given!r}")
        names = [one.name for one in given]
        if twice := [name for name in names if names.count(name) > 1]:
            raise UserError(f"{self.name}: two aids are called {twice[0]!r}: give them names of their own (name=...)")
        end = len(self.dtheta) * self.dt
        for one in given:
            if not len(one.time) or one.time[0] < -_TICK * self.dt or one.time[-1] > end + _TICK * self.dt:
                raise UserError(
                    f"{self.name}: {one.name} has values from {one.time[0]:g} to {one.time[-1]:g} s, the inertial "
                    f"record is from 0 to {end:g} s: cut off what is outside, or mend the clock"
                )
        return tuple(given)

    @property
    def standing(self) -> bool:
        """Whether there is no aid: the vehicle is taken to stand."""
        return not self.aids

    @property
    def epochs(self) -> int:
        """Number of whole epoch intervals M."""
        return len(self.dtheta) // self.epoch_samples

    @property
    def interval(self) -> float:
        """Between epochs, s."""
        return self.epoch_samples * self.dt

    @property
    def times(self) -> np.ndarray:
        """(M+1,) times of the epochs, s."""
        return self.t0 + np.arange(self.epochs + 1) * self.interval

    @property
    def duration(self) -> float:
        """Seconds from epoch 0 to the last epoch."""
        return self.epochs * self.interval

    def measured(self, aid: AbstractAid | str) -> Measurements | None:
        """What an aid has measured: the one of its name, else the only one of its class.

        Raises:
            UserError: several are of its class, and none has its name; or that of its name is of another class.
        """
        name = aid if isinstance(aid, str) else aid.name
        for one in self.aids:
            if one.name == name:
                if not isinstance(aid, str) and type(one.aid) is not type(aid):
                    raise UserError(f"{self.name}: {name} is {one.aid.described}, not {aid.described}")
                return one
        alike = [one for one in self.aids if type(one.aid) is type(aid)]
        if len(alike) > 1:
            raise UserError(
                f"{self.name} has {' and '.join(x.name for x in alike)}, all {alike[0].aid.kind}: say which (name=...)"
            )
        return alike[0] if alike else None

    @property
    def velocity_aid(self) -> Measurements | None:
        """The first aid that measures a whole velocity, those in n before those in b; None: there is none."""
        whole = [one for one in self.aids if one.velocity is not None]
        return min(whole, key=_in_body, default=None)

    def with_aid(self, measurements: Measurements) -> Log:
        """This log with these values in place of those of the same name, or beside the others."""
        others = [one for one in self.aids if one.name != measurements.name]
        place = next((i for i, one in enumerate(self.aids) if one.name == measurements.name), len(others))
        return dataclasses.replace(self, aids=(*others[:place], measurements, *others[place:]), warnings=self._told())

    def only(self, *names: str) -> Log:
        """This log with some of its aids alone.

        Raises:
            UserError: it has no aid of a name.
        """
        for name in names:
            if all(one.name != name for one in self.aids):
                known = ", ".join(one.name for one in self.aids) or "none"
                raise UserError(f"{self.name} has no aid {name!r}: it has {known}")
        return dataclasses.replace(
            self, aids=tuple(one for one in self.aids if one.name in names), warnings=self._told()
        )

    def crop(self, start: float = 0.0, end: float | None = None) -> Log:
        """The part between two times.

        With a velocity in n the place moves along to the new start; else it is kept, with a warning where the vehicle
        may have gone so far (10 km, 0.02 deg of heading) that it shows.

        Args:
            start: seconds since epoch 0, snapped to the nearest epoch.
            end: likewise; None is the last epoch.

        Raises:
            UserError: outside the log, less than 3 epoch intervals or 1 s, or an aid has no value there.
        """
        interval = self.interval
        start = checks.finite_number(self.name, "start", start)
        end = self.duration if end is None else checks.finite_number(self.name, "end", end)
        for key, value in (("start", start), ("end", end)):
            if not -0.5 * interval <= value <= self.duration + 0.5 * interval:
                raise UserError(f"{self.name}: {key} is {value:g} s, but the log runs from 0 to {self.duration:g} s")
        if start >= end:
            raise UserError(f"{self.name}: start {start:g} s is not before end {end:g} s")
        first, last = (min(max(round(x / interval), 0), self.epochs) for x in (start, end))
        checks.check_length(f"{self.name}, {start:g} to {end:g} s", last - first, interval)
        if (first, last) == (0, self.epochs):
            return self
        samples = slice(first * self.epoch_samples, last * self.epoch_samples)
        rows = slice(first, last + 1)
        place, far = self._moved(first * interval)
        aids = []
        for one in self.aids:
            part = one.between(first * interval - _TICK * self.dt, last * interval + _TICK * self.dt)
            if part is None:
                raise UserError(
                    f"{self.name}: all values of {one.name} are missing from {start:g} to {end:g} s: choose another "
                    "part, or leave the aid out"
                )
            aids.append(dataclasses.replace(part, time=np.maximum(part.time - _TICK * self.dt, 0.0)))
        return dataclasses.replace(
            self,
            **place,
            dtheta=self.dtheta[samples],
            dvel=self.dvel[samples],
            aids=tuple(aids),
            C_nb=None if self.C_nb is None else self.C_nb[rows],
            t0=self.t0 + first * interval,
            warnings=self._told() + far,
        )

    def _moved(self, time: float) -> tuple[dict[str, float], tuple[str, ...]]:
        """Latitude, longitude and height at a time, where they can be told; or a warning."""
        seen = self.velocity_aid
        if seen is None or time == 0:
            return {}, ()
        velocity = seen.velocity
        assert velocity is not None
        known = ~np.isnan(velocity).any(axis=1)
        steps = max(round(time / self.interval), 1)
        at = np.linspace(0.0, time, steps + 1)
        v = np.column_stack([np.interp(at, seen.time[known], velocity[known, i]) for i in range(3)])
        if _in_body(seen):
            far = float(np.linalg.norm(v, axis=1).sum() * time / steps)
            if far < _FAR:
                return {}, ()
            return {}, (
                f"the place is that of the log's beginning, but the vehicle went up to {far:.0f} m before this part: "
                "give the place of its start",
            )
        east, north, up = (float(np.trapezoid(v[:, i])) * time / steps for i in range(3))
        radius = SEMI_MAJOR_AXIS + self.h
        lat = self.lat + north / radius  # a sphere: 0.5 % of the way
        return {"lat": lat, "lon": self.lon + east / (radius * float(np.cos(lat))), "h": self.h + up}, ()

    def with_epochs(self, samples: int) -> Log:
        """This log with other epochs: of the vectors of a standing vehicle, and of the reference.

        Args:
            samples: IMU samples per epoch. A reference attitude is kept if this is a multiple of the present one, else
                dropped.

        Raises:
            UserError: too few epochs are left.
        """
        samples = whole_number(f"{self.name}: samples", samples, of="IMU samples", floats=True)
        reference = self.C_nb
        if reference is not None:
            step, rest = divmod(samples, self.epoch_samples)
            reference = None if rest else reference[::step][: len(self.dtheta) // samples + 1]
        return dataclasses.replace(self, epoch_samples=samples, C_nb=reference, warnings=self._told())

    def _course(self) -> np.ndarray | None:
        """(M+1, 3) velocities in n at the epochs, NaN where none was measured near; None if there is no such aid."""
        seen = self.velocity_aid
        if seen is None or _in_body(seen):
            return None
        velocity, at = seen.velocity, np.arange(self.epochs + 1) * self.interval
        assert velocity is not None
        nearest = (
            np.clip(np.searchsorted(seen.time, at), 1, len(seen.time) - 1) if len(seen.time) > 1 else 0 * at.astype(int)
        )
        nearest = np.where(at - seen.time[nearest - 1] < seen.time[nearest] - at, nearest - 1, nearest)
        near = np.abs(seen.time[nearest] - at) <= 0.5 * self.interval
        out = np.where(near[:, None], velocity[nearest], np.nan)
        return None if np.isnan(out).all() else out

    def _findings(self) -> list[str]:
        found = axis_warnings(self.dtheta, self.dvel, self.dt)
        for one in self.aids:
            lost = int(one.missing.sum())
            if 2 * lost > len(one.time):
                what = "the aid" if len(self.aids) == 1 else one.name
                found.append(f"{what} is missing at {lost} of {len(one.time)} epochs")
        return found

    def _told(self) -> tuple[str, ...]:
        """The warnings that were given, not found: a part of the log finds its own."""
        found = self._findings()
        return tuple(w for w in self.warnings if w not in found)


def _in_body(measurements: Measurements) -> bool:
    """Whether a whole velocity is in b."""
    seen = measurements.aid.velocity(tuple(measurements.value[0]))
    return seen is not None and seen[0] is Axes.BODY
