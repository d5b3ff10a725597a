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

    [aid]                          # left out: the vehicle stands
    file = "dvl.csv"               # beside the map (or the IMU file, for a dict); left out: the IMU file
    time = "t"                     # default: as for the IMU; likewise time_unit
    time_offset = 0.0              # s to be added to the aid's time
    velocity = ["vx", "vy", "vz"]
    unit = "m/s"                   # default; cm/s, mm/s, km/h, kn
    frame = "body"                 # or "nav"
    axes = "ENU/RFU"               # only where they differ from `frame` at the top
    interval = 1.0                 # s between epochs (default: from the aid's stamps)
    sd = 0.01                      # standard deviation of its white noise per axis, m/s

Without a map, a TOML file beside the log with its name (run.csv: run.toml) is taken, or else the columns
time, gyro_x, gyro_y, gyro_z (rad/s), accel_x, accel_y, accel_z (m/s^2), lat_deg and perhaps lon_deg, h, and
for the aid vel_x, vel_y, vel_z (body) or vel_e, vel_n, vel_u (nav), m/s; right-forward-up, East-North-Up.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxalign.errors import UserError, close_names
from jaxalign.io.files import existing_file, first_line, read_text
from jaxalign.wgs84 import STANDARD_GRAVITY

__all__ = ["AidColumns", "ColumnMap", "column_map", "default_map", "nearest"]

_DEG = np.pi / 180.0
_G = STANDARD_GRAVITY
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_GYRO = {
    "rate": {"rad/s": 1.0, "deg/s": _DEG, "deg/h": _DEG / 3600.0},
    "increment": {"rad": 1.0, "deg": _DEG, "arcsec": _DEG / 3600.0},
}
_ACCEL = {"rate": {"m/s^2": 1.0, "g": _G, "mg": 1e-3 * _G}, "increment": {"m/s": 1.0, "g*s": _G}}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1.0 / 3.6, "kn": 1852.0 / 3600.0}
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
        "unit",
        "frame",
        "axes",
        "interval",
        "sd",
    ),
}


@dataclass(frozen=True)
class AidColumns:
    """Where the velocity aid is. Units are factors to SI; `turn` says that axes are NED/FRD."""

    file: Path | None
    time: str
    time_unit: float
    time_offset: float
    velocity: tuple[str, str, str]
    unit: float
    frame: str
    turn: bool
    interval: float | None
    sd: float | None


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
    aid: AidColumns | None


def nearest(name: str, among: Sequence[str]) -> str:
    """' (did you mean ...?)' for the name that is most alike, or nothing."""
    found = close_names(name, among, most=1)
    return f" (did you mean {found[0]!r}?)" if found else ""


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
        for key in table:
            if key not in _KEYS[name]:
                raise UserError(
                    f"{self.where} unknown key {key!r}{nearest(str(key), _KEYS[name])}; known: {', '.join(_KEYS[name])}"
                )

    def text(self, key: str, default: str | None = None) -> str:
        value = self.table.get(key, default)
        if value is None:
            raise UserError(f"{self.where} {key} is missing")
        if not isinstance(value, str):
            raise UserError(f"{self.where} {key} is {value!r}: a name in quotes is expected")
        return value

    def choice(self, key: str, choices: Sequence[str], default: str | None = None) -> str:
        value = self.text(key, default).replace("²", "^2").replace("s2", "s^2")
        if value not in choices:
            raise UserError(f"{self.where} {key} is {value!r}{nearest(value, choices)}; known: {', '.join(choices)}")
        return value

    def unit(self, key: str, units: Mapping[str, float], default: str | None = None) -> float:
        return units[self.choice(key, list(units), default or next(iter(units)))]

    def three(self, key: str) -> tuple[str, str, str]:
        value = self.table.get(key)
        if not isinstance(value, Sequence) or len(value) != 3 or not all(isinstance(name, str) for name in value):
            raise UserError(f"{self.where} {key} is {value!r}: three column names are expected")
        return value[0], value[1], value[2]

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
        aid=_parse_aid(_Section(source, "aid", table["aid"]), imu, frame, folder) if "aid" in table else None,
    )


def _parse_aid(aid: _Section, imu: _Section, frame: str, folder: Path) -> AidColumns:
    unit = imu.choice("time_unit", list(_TIME), "s")
    return AidColumns(
        file=folder / aid.text("file") if "file" in aid.table else None,
        time=aid.text("time", imu.text("time")),
        time_unit=aid.unit("time_unit", _TIME, unit),
        time_offset=aid.number("time_offset", 0.0) or 0.0,
        velocity=aid.three("velocity"),
        unit=aid.unit("unit", _SPEED),
        frame=aid.choice("frame", ("body", "nav")),
        turn=aid.choice("axes", _FRAMES, frame) == "NED/FRD",
        interval=aid.number("interval", positive=True),
        sd=aid.number("sd", positive=True),
    )
