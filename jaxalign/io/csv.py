"""CSV logs with a declared column map (`jaxalign.io.columns`), brought onto one uniform clock.

What the columns hold goes to :func:`jaxalign.log_from_streams`. NED/FRD data are turned here, once: (x, y, z) ->
(y, x, -z) for sensors and velocities alike. Up to 3 samples of the IMU lost in a row are bridged and reported; more is
an error.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxalign.checks import bad_run
from jaxalign.errors import UserError
from jaxalign.files import existing_file
from jaxalign.io.columns import AidColumns, ColumnMap, column_map, default_map
from jaxalign.io.resample import nominal_interval
from jaxalign.io.streams import MAX_LOST, check_gaps, log_from_streams, turned
from jaxalign.io.table import Table
from jaxalign.log import Log
from jaxalign.measurements import Measurements

__all__ = ["read_csv"]


def read_csv(
    path: str | os.PathLike[str],
    columns: str | os.PathLike[str] | Mapping[str, Any] | None = None,
) -> Log:
    """Reads a log.

    Args:
        path: file with the IMU.
        columns: TOML file or mapping (`jaxalign.io.columns`); None tries the TOML file beside it and the
            default names.

    Raises:
        UserError: missing files or columns, cells that are no numbers, time that repeats or goes back, gaps
            of more than 3 samples, a map that is not understood, no aid sample within the IMU record, or what
            `Log` refuses.
    """
    path = existing_file(path)
    if columns is not None and not isinstance(columns, Mapping):
        existing_file(columns, "column map")
    table = Table(path)
    spec = default_map(path, table.header) if columns is None else column_map(columns, path)
    raw = table.numbers([spec.time, *spec.gyro, *spec.accel])
    stamps, x = raw[:, 0], raw[:, 1:]
    _check_finite(table, spec.time, stamps, spec.time_unit, x)
    _check_order(table, spec.time, stamps)
    if len(stamps) < 4:
        raise UserError(f"{path}: too short: {len(stamps)} rows")
    time, origin = (stamps - stamps[0]) * spec.time_unit, float(stamps[0]) * spec.time_unit
    dt = nominal_interval(time)
    if not 1e-5 <= dt <= 1.0:
        raise UserError(f"{path}: the IMU's sampling interval is {dt:g} s, expected 1e-5 to 1 s: is time_unit right?")
    warnings = check_gaps(path, time + origin, dt, MAX_LOST, lambda row: f"line {table.lines[row]}")
    lat, lon, h = (_site(table, *entry) for entry in (spec.lat, spec.lon, spec.h))
    aids = [_read_aid(table, spec, aid, float(stamps[0])) for aid in spec.aids if aid.values]
    for aid in spec.aids:
        if not aid.values:  # zeros, with the others
            at = aids[0].time if aids else time
            aids.append(Measurements(aid.aid, at, np.zeros((len(at), len(aid.aid.components))), aid.deviations))
    epoch = next((one.interval for one in spec.aids if one.interval), None) if spec.aids else spec.epoch
    try:
        return log_from_streams(
            time,
            turned(x[:, :3] * spec.gyro_unit, spec.turn),
            turned(x[:, 3:] * spec.accel_unit, spec.turn),
            aids,
            lat=lat,
            lon=lon,
            h=h,
            increments=spec.kind == "increment",
            interval=epoch,
            max_lost=10**9,  # they have been looked at
            origin=origin,
            name=path.stem,
            warnings=warnings,
        )
    except UserError as error:
        text = str(error)
        raise UserError(text if str(path) in text else f"{path}: {text.removeprefix(f'{path.stem}: ')}") from None


def _site(table: Table, value: float | str, factor: float) -> float:
    if isinstance(value, str):
        value = float(table.numbers([value], blank=True)[0, 0])
        if not np.isfinite(value):
            raise UserError(f"{table.path}: the first row has no number for the site: give it in the map")
    return value * factor


def _read_aid(imu: Table, spec: ColumnMap, aid: AidColumns, origin: float) -> Measurements:
    """On the clock of the IMU; rows without any value are left out."""
    table = imu if aid.file is None else Table(existing_file(aid.file, "aid file"))
    raw = table.numbers([aid.time, *aid.values], blank=True)
    given = np.isfinite(raw[:, 0]) & np.isfinite(raw[:, 1:]).any(axis=1)
    if not given.any():
        raise UserError(f"{table.path}: all aid samples are missing (columns {', '.join(aid.values)})")
    _check_order(table, aid.time, raw[given, 0], table.lines[given])
    time = (raw[given, 0] - origin * spec.time_unit / aid.time_unit) * aid.time_unit + aid.time_offset
    if len(time) < 2:
        raise UserError(f"{table.path}: only one aid sample: at least 2 are needed")
    try:
        return Measurements(aid.aid, time, aid.in_order(raw[given, 1:] * aid.unit), aid.deviations)
    except UserError as error:
        raise UserError(f"{table.path}: {error}") from None


def _check_finite(table: Table, name: str, stamps: np.ndarray, unit: float, x: np.ndarray) -> None:
    if not np.isfinite(stamps).all():
        row = int(np.argmin(np.isfinite(stamps)))
        raise UserError(f"{table.path}: line {table.lines[row]}, column {name!r}: time is not a finite number")
    if run := bad_run(x):
        count, first, length = run
        raise UserError(
            f"{table.path}: NaN or infinity in {count} rows of the IMU; the first run is {length} long at "
            f"line {table.lines[first]} (time {stamps[first] * unit:.9g} s): cut the log there or fill them"
        )


def _check_order(table: Table, name: str, stamps: np.ndarray, lines: np.ndarray | None = None) -> None:
    steps = np.diff(stamps)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        line = (table.lines if lines is None else lines)[row]
        what = "repeats" if steps[row - 1] == 0 else f"goes back from {stamps[row - 1]:.12g}"
        raise UserError(
            f"{table.path}: line {line}, column {name!r}: time {stamps[row]:.12g} {what} "
            f"({int((steps <= 0).sum())} such rows): sort the rows and remove duplicates"
        )
