"""The checked log: what an inertial unit and its velocity aid have recorded, on the host, in NumPy."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxalign import checks
from jaxalign.errors import UserError
from jaxalign.plausibility import axis_warnings, check_gyro_units, check_specific_force
from jaxalign.wgs84 import SEMI_MAJOR_AXIS

__all__ = ["AIDS", "Log"]

AIDS = ("static", "body", "nav")
"""The kinds of aid."""


_FAR = 1e4  # m: 0.02 deg of heading


@dataclass(frozen=True, eq=False)
class Log:
    """IMU increments at one rate, velocities of the aid at the epochs, and the place.

    Epoch k (k = 0..M, M = N // aid_every) is at the end of IMU sample ``k * aid_every``; epoch 0 is the
    start. Everything is checked when a log is made, so that what comes later need not.

    Attributes:
        dtheta: (N, 3) rotation increments of the gyroscopes, rad, b = right-forward-up.
        dvel: (N, 3) velocity increments of the accelerometers, m/s, b.
        dt: sampling interval, s.
        aid_every: IMU samples per epoch.
        aid: "static" (no aid: the vehicle stands), "body" (DVL, odometer; m/s in b), "nav" (GNSS; m/s, ENU).
        velocity: (M+1, 3) velocities of the aid, NaN where a sample is missing; None for "static".
        lat: latitude, rad.
        lon: longitude, rad.
        h: height, m.
        aid_sd: standard deviation of the aid's white noise per axis, m/s, if known.
        C_nb: (M+1, 3, 3) reference attitude at the epochs, NaN where unknown, if there is one.
        t0: time of epoch 0, s.
        name: what to call it in messages and titles.
        warnings: findings that do not prevent alignment but that a person should read; what the data
            themselves show is added.

    Raises:
        UserError: wrong shape, float32 increments, NaN in the IMU, wrong units where the data show it, no aid
            sample at all, too short, a latitude in degrees or beyond 89.5 deg, a reference that is no
            rotation.
    """

    dtheta: np.ndarray
    dvel: np.ndarray
    dt: float
    aid_every: int
    aid: str
    velocity: np.ndarray | None
    lat: float
    lon: float = 0.0
    h: float = 0.0
    aid_sd: float | None = None
    C_nb: np.ndarray | None = None
    t0: float = 0.0
    name: str = "log"
    warnings: tuple[str, ...] = ()

    def __post_init__(self):
        def put(**fields: Any) -> None:
            for key, value in fields.items():
                object.__setattr__(self, key, value)

        name = self.name
        if self.aid not in AIDS:
            raise UserError(f"{name}: aid is {self.aid!r}: it must be one of {', '.join(AIDS)}")
        put(**{key: checks.finite_number(name, key, getattr(self, key)) for key in ("dt", "lat", "lon", "h", "t0")})
        checks.check_rate(name, self.dt)
        checks.check_site(name, self.lat, self.lon, self.h)
        put(aid_every=checks.whole_number(name, "aid_every", self.aid_every))
        for key in ("dtheta", "dvel"):
            put(**{key: checks.increments(name, key, getattr(self, key), self.dt)})
        if len(self.dtheta) != len(self.dvel):
            raise UserError(f"{name}: dtheta has {len(self.dtheta)} rows, dvel {len(self.dvel)}: they must be equal")
        checks.check_length(name, self.epochs, self.aid_every * self.dt)
        if self.aid_sd is not None:
            put(aid_sd=checks.finite_number(name, "aid_sd", self.aid_sd))
            if self.aid_sd <= 0:
                raise UserError(f"{name}: aid_sd is {self.aid_sd:g}: a standard deviation (m/s) must be positive")
        put(velocity=checks.velocity(name, self.aid, self.velocity, self.epochs))
        if self.C_nb is not None:
            put(C_nb=checks.reference(name, self.C_nb, self.epochs))

        check_specific_force(name, self.dvel, self.dt)
        course = self.velocity if self.aid == "nav" else None
        standing = self.aid == "static" or (course is not None and bool(np.nanmax(np.abs(course)) <= 0.05))
        check_gyro_units(name, self.dtheta, self.dvel, self.dt, self.lat, course, self.aid_every, standing)
        put(warnings=tuple(dict.fromkeys((*self.warnings, *self._findings()))))

    @property
    def epochs(self) -> int:
        """Number of whole epoch intervals M."""
        return len(self.dtheta) // self.aid_every

    @property
    def times(self) -> np.ndarray:
        """(M+1,) times of the epochs, s."""
        return self.t0 + np.arange(self.epochs + 1) * (self.aid_every * self.dt)

    @property
    def duration(self) -> float:
        """Seconds from epoch 0 to the last epoch."""
        return self.epochs * self.aid_every * self.dt

    @property
    def missing(self) -> np.ndarray:
        """(M+1,) whether the aid sample of an epoch is missing; all False for "static"."""
        if self.velocity is None:
            return np.zeros(self.epochs + 1, bool)
        return np.asarray(np.isnan(self.velocity).any(axis=1))

    def crop(self, start: float = 0.0, end: float | None = None) -> Log:
        """The part between two times.

        With a "nav" aid the place moves along to the new start; else it is kept, with a warning where the vehicle may
        have gone so far (10 km, 0.02 deg of heading) that it shows.

        Args:
            start: seconds since epoch 0, snapped to the nearest epoch.
            end: likewise; None is the last epoch.

        Raises:
            UserError: outside the log, or less than 3 epoch intervals or 1 s.
        """
        interval = self.aid_every * self.dt
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
        samples = slice(first * self.aid_every, last * self.aid_every)
        rows = slice(first, last + 1)
        place, far = self._moved(first)
        return dataclasses.replace(
            self,
            **place,
            dtheta=self.dtheta[samples],
            dvel=self.dvel[samples],
            velocity=None if self.velocity is None else self.velocity[rows],
            C_nb=None if self.C_nb is None else self.C_nb[rows],
            t0=self.t0 + first * interval,
            warnings=self._told() + far,
        )

    def _moved(self, epoch: int) -> tuple[dict[str, float], tuple[str, ...]]:
        """Latitude, longitude and height at an epoch, where they can be told; or a warning."""
        if self.velocity is None or epoch == 0:
            return {}, ()
        interval, known = self.aid_every * self.dt, ~self.missing
        times = np.arange(self.epochs + 1)
        v = np.column_stack([np.interp(times, times[known], self.velocity[known, i]) for i in range(3)])[: epoch + 1]
        if self.aid == "body":
            far = float(np.linalg.norm(v, axis=1).sum() * interval)
            if far < _FAR:
                return {}, ()
            return {}, (
                f"the place is that of the log's beginning, but the vehicle went up to {far:.0f} m before this part: "
                "give the place of its start",
            )
        east, north, up = (float(np.trapezoid(v[:, i])) * interval for i in range(3))
        radius = SEMI_MAJOR_AXIS + self.h
        lat = self.lat + north / radius  # a sphere: 0.5 % of the way
        return {"lat": lat, "lon": self.lon + east / (radius * float(np.cos(lat))), "h": self.h + up}, ()

    def with_epochs(self, aid_every: int) -> Log:
        """A static log with other epochs.

        Args:
            aid_every: IMU samples per epoch. A reference attitude is kept if this is a multiple of the
                present one, else dropped.

        Raises:
            UserError: the log has an aid, whose samples are its epochs; or too few epochs are left.
        """
        aid_every = checks.whole_number(self.name, "aid_every", aid_every)
        if self.aid != "static":
            raise UserError(
                f"{self.name}: epochs of a log with an aid ({self.aid}) are its aid samples; only a static "
                "log can change them"
            )
        reference = self.C_nb
        if reference is not None:
            step, rest = divmod(aid_every, self.aid_every)
            reference = None if rest else reference[::step][: len(self.dtheta) // aid_every + 1]
        return dataclasses.replace(self, aid_every=aid_every, C_nb=reference, warnings=self._told())

    def _findings(self) -> list[str]:
        found = axis_warnings(self.dtheta, self.dvel, self.dt)
        lost = int(self.missing.sum())
        if 2 * lost > self.epochs + 1:
            found.append(f"the aid is missing at {lost} of {self.epochs + 1} epochs")
        return found

    def _told(self) -> tuple[str, ...]:
        """The warnings that were given, not found: a part of the log finds its own."""
        found = self._findings()
        return tuple(w for w in self.warnings if w not in found)
