"""The declared column map of a CSV log: a TOML file, or the same as a dict.

    frame = "NED/FRD"              # axes of sensors and velocities; default "ENU/RFU"

    [imu]
    time = "t"                     # name of the column
    time_unit = "ms"               # s (default), ms, us, ns
    gyro = ["wx", "wy", "wz"]
    gyro_unit = "deg/s"            # rad/s (default), deg/s, deg/h; increments: rad (default), deg, arcsec
    accel = ["fx", "fy", "fz"]
    accel_unit = "g"               # m/s^2 (default), g, mg; increments: m/s (default), g*s
    kind = "rate"                  # default; or "increment"
    epoch = 1.0                    # s between epochs of a log without aid (default 1)

    [site]                         # numbers, or names of columns of the IMU file, whose first row counts
    lat_deg = 32.06                # or lat (rad)
    lon_deg = 118.79               # or lon (rad); default 0
    h = 20.0                       # m; default 0

    [aid]                          # left out: the vehicle stands; several aids: each a table [[aid]]
    file = "dvl.csv"               # beside the map (or the IMU file, for a dict); left out: the IMU file
    time = "t"                     # default: as for the IMU; likewise time_unit
    time_offset = 0.0              # s to be added to the aid's time
    velocity = ["vx", "vy", "vz"]  # or values = ["heading"]
    unit = "m/s"                   # default; cm/s, mm/s, km/h, kn; of angles: rad (default), deg
    frame = "body"                 # or "nav"; or instead kind = "body", "nav", "heading", "non-holonomic" (no values)
    name = "odometer"              # default: its kind
    components = ["forward"]       # where not all are there: right, forward, up, or east, north, up; so any other
                                   # option of the kind. Where they are named, columns go by these names (NED/FRD: the
                                   # one of "up" counts downwards), else by the order of `axes`
    axes = "ENU/RFU"               # only where they differ from `frame` at the top
    interval = 1.0                 # s between epochs; default: of the aid that measures most often, from its stamps
    sd = 0.01                      # of its white noise, m/s (an angle: in its unit); one, or of each column

Without a map, a TOML file beside the log with its name (run.csv: run.toml) is taken, or else the columns
time, gyro_x, gyro_y, gyro_z (rad/s), accel_x, accel_y, accel_z (m/s^2), lat_deg and perhaps lon_deg, h, and
for the aid vel_x, vel_y, vel_z (body) or vel_e, vel_n, vel_u (nav), m/s; right-forward-up, East-North-Up.
"""

from __future__ import annotations

import dataclasses
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxalign.aids import AbstractAid, BodyVelocity, from_plain, kind_of
from jaxalign.arguments import check_choice, nearest
from jaxalign.errors import UserError
from jaxalign.files import existing_file, first_line, read_text
from jaxalign.io.streams import turned
from jaxalign.wgs84 import STANDARD_GRAVITY

__all__ = ["AidColumns", "ColumnMap", "column_map", "default_map"]

_DEG = np.pi / 180.0
_G = STANDARD_GRAVITY
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_GYRO = {
    "rate": {"rad/s": 1.0, "deg/s": _DEG, "deg/h": _DEG / 3600.0},
    "increment": {"rad": 1.0, "deg": _DEG, "arcsec": _DEG / 3600.0},
}
_ACCEL = {"rate": {"m/s^2": 1.0, "g": _G, "mg": 1e-3 * _G}, "increment": {"m/s": 1.0, "g*s": _G}}
_ANGLE = {"rad": 1.0, "deg": _DEG}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1.0 / 3.6, "kn": 1852.0 / 3600.0}
_OF_AIDS = {"m/s": _SPEED, "rad": _ANGLE}  # others are in the unit of the aid
_FRAMES = ("ENU/RFU", "NED/FRD")
_KEYS = {
    "": ("frame", "imu", "site", "aid"),
    "imu": ("time", "time_unit", "gyro", "gyro_unit", "accel", "accel_unit", "kind", "epoch"),
    "site": ("lat", "lat_deg", "lon", "lon_deg", "h"),
    "aid": (
        "file",
        "time",
        "time_unit",
        "time_offset",
        "velocity",
        "values",
        "unit",
        "frame",
        "kind",
        "axes",
        "interval",
        "sd",
    ),
}


@dataclass(frozen=True)
class AidColumns:
    """Where an aid is. Units are factors to SI; `turn` says that axes are NED/FRD; `values` are columns, if any.

    `sd` is in the order of the columns, which is that of the components where they are `named` in the map.
    """

    file: Path | None
    time: str
    time_unit: float
    time_offset: float
    values: tuple[str, ...]
    unit: float
    aid: AbstractAid
    turn: bool
    interval: float | None
    sd: float | list[float] | None
    named: bool = False

    @property
    def deviations(self) -> float | np.ndarray | None:
        """Of its noise, one number or of each component of the aid."""
        if not isinstance(self.sd, list):
            return self.sd
        return np.abs(self.in_order(np.array([self.sd])))[0]

    def in_order(self, columns: np.ndarray) -> np.ndarray:
        """Values as in the file, (n, m), along the axes of the aid."""
        if not self.turn or self.aid.velocity_axes is None:
            return columns
        if self.aid.full_velocity and len(self.aid.components) == 3 and not self.named:
            return turned(columns)
        # Named by what they are, but counted downwards.
        return columns * np.array([-1.0 if name == "up" else 1.0 for name in self.aid.components])


@dataclass(frozen=True)
class ColumnMap:
    """Where everything is. Units are factors to SI; a site entry is (number or column name, factor)."""

    time: str
    time_unit: float
    gyro: tuple[str, str, str]
    gyro_unit: float
    accel: tuple[str, str, str]
    accel_unit: float
    kind: str
    turn: bool
    epoch: float
    lat: tuple[float | str, float]
    lon: tuple[float | str, float]
    h: tuple[float | str, float]
    aids: tuple[AidColumns, ...]


def column_map(columns: str | os.PathLike[str] | Mapping[str, Any], beside: Path) -> ColumnMap:
    """Reads a map (module docstring).

    Args:
        columns: TOML file or a mapping of the same shape.
        beside: the IMU file; the aid's file of a mapping is looked for in its folder.

    Raises:
        UserError: no such file, no TOML, a key or a unit that is not known, or one that is missing.
    """
    if isinstance(columns, Mapping):
        return _parse("column map", columns, beside.parent)
    path = existing_file(columns, "column map")
    try:
        table = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: not a TOML file: {first_line(error)}") from None
    return _parse(str(path), table, path.parent)


def default_map(path: Path, header: Sequence[str]) -> ColumnMap:
    """The map for a file that came without one (module docstring).

    Raises:
        UserError: the file has not the default columns.
    """
    beside = path.with_suffix(".toml")
    if beside.is_file():
        return column_map(beside, path)
    gyro, accel, body = ([f"{what}_{axis}" for axis in "xyz"] for what in ("gyro", "accel", "vel"))
    nav = ["vel_e", "vel_n", "vel_u"]
    missing = [name for name in ("time", *gyro, *accel, "lat_deg") if name not in header]
    if missing:
        raise UserError(
            f"{path}: no column map given and the default columns {', '.join(missing)} are not there; "
            f"the file has {', '.join(header)}: give a map (--columns MAP.toml)"
        )
    site = {key: key for key in ("lat_deg", "lon_deg", "h") if key in header}
    table: dict[str, Any] = {"imu": {"time": "time", "gyro": gyro, "accel": accel}, "site": site}
    for frame, velocity in (("body", body), ("nav", nav)):
        if all(name in header for name in velocity):
            table["aid"] = {"velocity": velocity, "frame": frame}
    return _parse("default columns", table, path.parent)


class _Section:
    """One table of the map, with its checks."""

    def __init__(self, source: str, name: str, table: Any):
        self.where = f"{source}: [{name}]" if name else f"{source}:"
        if not isinstance(table, Mapping):
            raise UserError(f"{self.where} must be a table of keys")
        self.table = table
        if name != "aid":  # that knows its keys by its kind
            self.check_keys(_KEYS[name])

    def check_keys(self, known: Sequence[str]) -> None:
        for key in self.table:
            if key not in known:
                raise UserError(f"{self.where} unknown key {key!r}: {nearest(str(key), known)}")

    def text(self, key: str, default: str | None = None) -> str:
        value = self.table.get(key, default)
        if value is None:
            raise UserError(f"{self.where} {key} is missing")
        if not isinstance(value, str):
            raise UserError(f"{self.where} {key} is {value!r}: a name in quotes is expected")
        return value

    def choice(self, key: str, choices: Sequence[str], default: str | None = None) -> str:
        value = self.text(key, default)
        if value not in choices:
            value = value.replace("²", "^2").replace("s2", "s^2")
        return check_choice(f"{self.where} {key}", value, choices)

    def unit(self, key: str, units: Mapping[str, float], default: str | None = None) -> float:
        return units[self.choice(key, list(units), default or next(iter(units)))]

    def three(self, key: str) -> tuple[str, str, str]:
        value = self.table.get(key)
        if not isinstance(value, Sequence) or len(value) != 3 or not all(isinstance(name, str) for name in value):
            raise UserError(f"{self.where} {key} is {value!r}: three column names are expected")
        return value[0], value[1], value[2]

    def names(self, key: str, count: int) -> tuple[str, ...]:
        value = self.table.get(key)
        value = [value] if isinstance(value, str) else value
        if not isinstance(value, Sequence) or len(value) != count or not all(isinstance(name, str) for name in value):
            what = (
                "three column names are"
                if count == 3
                else "one column name is"
                if count == 1
                else f"{count} column names are"
            )
            raise UserError(f"{self.where} {key} is {value!r}: {what} expected")
        return tuple(value)

    def needed(self, *keys: str) -> None:
        """One of these."""
        if not any(key in self.table for key in keys):
            raise UserError(f"{self.where} {keys[0]} is missing{''.join(f' (or {key})' for key in keys[1:])}")

    def made(self, name: str) -> AbstractAid:
        """The aid of a kind, with those of its fields that are here."""
        try:
            kind = kind_of(name)
            own = _fields(kind)
            if kind.implied:
                raise UserError(f"{name!r} is an assumption that has no values: leave the table out")
            if twice := [key for key in own if key in _KEYS["aid"]]:
                raise UserError(
                    f"the field {twice[0]!r} of {name!r} is a key of the map: its class must call it otherwise"
                )
            aid = from_plain({"kind": name, **{key: self.table[key] for key in own if key in self.table}})
        except UserError as error:
            raise UserError(f"{self.where} {error}") from None
        self.check_keys((*_KEYS["aid"], *own))
        return aid

    def number(self, key: str, default: float | None = None, positive: bool = False) -> float | None:
        value = self.table.get(key, default)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise UserError(f"{self.where} {key} is {value!r}: a number is expected")
        if positive and value <= 0:
            raise UserError(f"{self.where} {key} is {value!r}: it must be positive")
        return float(value)

    def place(self, key: str, angle: bool, default: float | None) -> tuple[float | str, float]:
        given = [k for k in (key, f"{key}_deg") if k in self.table and (angle or k == key)]
        if len(given) == 2:
            raise UserError(f"{self.where} has both {key} and {key}_deg: give one")
        if not given and default is None:
            raise UserError(f"{self.where} lat_deg (or lat in rad) is missing: alignment needs the latitude")
        factor = _DEG if given and given[0].endswith("_deg") else 1.0
        value = self.table[given[0]] if given else default
        if isinstance(value, str):
            return value, factor
        number = self.number(given[0] if given else key, default)
        assert number is not None
        return number, factor


def _parse(source: str, table: Mapping[str, Any], folder: Path) -> ColumnMap:
    top = _Section(source, "", table)
    imu = _Section(source, "imu", table.get("imu", {}))
    site = _Section(source, "site", table.get("site", {}))
    kind = imu.choice("kind", list(_GYRO), "rate")
    frame = top.choice("frame", _FRAMES, _FRAMES[0])
    epoch = imu.number("epoch", 1.0, positive=True)
    assert epoch is not None
    return ColumnMap(
        time=imu.text("time"),
        time_unit=imu.unit("time_unit", _TIME),
        gyro=imu.three("gyro"),
        gyro_unit=imu.unit("gyro_unit", _GYRO[kind]),
        accel=imu.three("accel"),
        accel_unit=imu.unit("accel_unit", _ACCEL[kind]),
        kind=kind,
        turn=frame == "NED/FRD",
        epoch=epoch,
        lat=site.place("lat", True, None),
        lon=site.place("lon", True, 0.0),
        h=site.place("h", False, 0.0),
        aids=tuple(
            _parse_aid(_Section(source, "aid", one), imu, frame, folder) for one in _tables(table.get("aid", []))
        ),
    )


def _tables(given: Any) -> list[Any]:
    """One table, or a list of them."""
    return list(given) if isinstance(given, list | tuple) else [given]


def _parse_aid(aid: _Section, imu: _Section, frame: str, folder: Path) -> AidColumns:
    table = aid.table
    if "frame" in table and "kind" in table:
        raise UserError(f"{aid.where} has both frame and kind: give one")
    if "velocity" in table and "values" in table:
        raise UserError(f"{aid.where} has both velocity and values: give one")
    if "kind" not in table and "frame" not in table:
        aid.check_keys((*_KEYS["aid"], *_fields(BodyVelocity)))
        aid.needed("frame", "kind")
    kind = aid.text("kind") if "kind" in table else aid.choice("frame", ("body", "nav"))
    made = aid.made(kind)
    if "velocity" in table or "values" in table:
        values = aid.names("velocity" if "velocity" in table else "values", len(made.components))
    else:
        if not made.zeros or {"file", "time", "time_unit", "time_offset", "unit"} & set(table):
            aid.needed("values", "velocity")
        values = ()
    unit = aid.unit("unit", _OF_AIDS.get(made.unit, {made.unit: 1.0}))
    sd = _deviations(aid, len(made.components))
    own = unit if made.unit == "rad" else 1.0  # deviations of velocities have always been in m/s
    return AidColumns(
        file=folder / aid.text("file") if "file" in table else None,
        time=aid.text("time", imu.text("time")),
        time_unit=aid.unit("time_unit", _TIME, imu.choice("time_unit", list(_TIME), "s")),
        time_offset=aid.number("time_offset", 0.0) or 0.0,
        values=values,
        unit=unit,
        aid=made,
        turn=aid.choice("axes", _FRAMES, frame) == "NED/FRD",
        interval=aid.number("interval", positive=True),
        sd=None if sd is None else [x * own for x in sd] if isinstance(sd, list) else sd * own,
        named="components" in table,
    )


def _fields(kind: type[AbstractAid]) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]


def _deviations(aid: _Section, size: int) -> float | list[float] | None:
    """One number, or one for each component."""
    given = aid.table.get("sd")
    if not isinstance(given, list):
        return aid.number("sd", positive=True)
    if len(given) != size or not all(isinstance(x, int | float) and x is not True and 0 < x < np.inf for x in given):
        raise UserError(f"{aid.where} sd is {given!r}: one positive number, or {size} of them, are expected")
    return [float(x) for x in given]
