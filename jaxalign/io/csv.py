"""CSV logs with a declared column map (`jaxalign.io.columns`), brought onto one uniform clock.

Time stamps are believed. A rate is the value at its stamp and is integrated by trapezoids; an increment
belongs to the sampling interval that ends at its stamp. Cumulated sums are interpolated linearly onto a grid
whose epochs are the aid's times (`jaxalign.io.resample`): epoch 0 is the first aid sample inside the IMU
record, the others follow at the aid's nominal interval, and the grid divides each interval into a whole
number of samples, as near to the IMU's rate as can be. The aid velocity is interpolated linearly between
neighbours at most 1.5 intervals apart and NaN elsewhere. Up to 3 samples lost in a row are bridged and
reported; more is an error. NED/FRD data are turned here, once: (x, y, z) -> (y, x, -z) for sensors and
velocities alike.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxalign.checks import bad_run
from jaxalign.errors import UserError
from jaxalign.io.columns import AidColumns, ColumnMap, column_map, default_map
from jaxalign.io.files import existing_file
from jaxalign.io.resample import (
    cumulate_increments,
    cumulate_rates,
    interpolate_aid,
    nominal_interval,
    onto_grid,
)
from jaxalign.io.table import Table
from jaxalign.log import Log

__all__ = ["read_csv"]

MAX_LOST = 3
"""Samples that may be missing in a row."""


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
    t = (stamps - stamps[0]) * spec.time_unit
    dt = nominal_interval(t)
    if not 1e-5 <= dt <= 1.0:
        raise UserError(f"{path}: the IMU's sampling interval is {dt:g} s, expected 1e-5 to 1 s: is time_unit right?")
    warnings = _check_gaps(table, stamps * spec.time_unit, dt)

    x = np.hstack([_turned(x[:, :3] * spec.gyro_unit, spec.turn), _turned(x[:, 3:] * spec.accel_unit, spec.turn)])
    nodes, sums = cumulate_increments(t, x, dt) if spec.kind == "increment" else cumulate_rates(t, x)
    velocity, sd, kind = None, None, "static"
    if spec.aid is None:
        interval, start, end = spec.epoch, nodes[0], nodes[-1]
    else:
        kind, sd = spec.aid.frame, spec.aid.sd
        aid_t, aid_v = _read_aid(table, spec, spec.aid, float(stamps[0]))
        interval = spec.aid.interval or nominal_interval(aid_t)
        start, end = _overlap(path, nodes, aid_t, dt, float(stamps[0]) * spec.time_unit)
    aid_every = round(interval / dt)
    if aid_every < 1:
        raise UserError(f"{path}: epochs every {interval:g} s are closer than the IMU samples ({dt:g} s): lengthen it")
    step = dt if spec.aid is None else interval / aid_every
    count = int(np.floor((end - start) / step + 1e-6))
    if spec.aid is not None:
        count -= count % aid_every
    if count < aid_every:
        raise UserError(
            f"{path}: too short: IMU and aid have {end - start:g} s in common, not one interval of {interval:g} s"
        )
    grid = start + step * np.arange(count + 1)
    increments = onto_grid(nodes, sums, grid)
    if spec.aid is not None:
        velocity = interpolate_aid(aid_t, aid_v, grid[::aid_every], interval)
    lat, lon, h = (_site(table, *entry) for entry in (spec.lat, spec.lon, spec.h))
    return Log(
        dtheta=increments[:, :3],
        dvel=increments[:, 3:],
        dt=step,
        aid_every=aid_every,
        aid=kind,
        velocity=velocity,
        lat=lat,
        lon=lon,
        h=h,
        aid_sd=sd,
        t0=float(stamps[0]) * spec.time_unit + start,
        name=path.stem,
        warnings=tuple(warnings),
    )


def _turned(x: np.ndarray, turn: bool) -> np.ndarray:
    """FRD to RFU and NED to ENU: the same permutation."""
    return np.column_stack([x[:, 1], x[:, 0], -x[:, 2]]) if turn else x


def _site(table: Table, value: float | str, factor: float) -> float:
    if isinstance(value, str):
        value = float(table.numbers([value], blank=True)[0, 0])
        if not np.isfinite(value):
            raise UserError(f"{table.path}: the first row has no number for the site: give it in the map")
    return value * factor


def _read_aid(imu: Table, spec: ColumnMap, aid: AidColumns, origin: float) -> tuple[np.ndarray, np.ndarray]:
    """Times since the first IMU stamp (s) and velocities (m/s, our axes) of the rows that have one."""
    table = imu if aid.file is None else Table(existing_file(aid.file, "aid file"))
    raw = table.numbers([aid.time, *aid.velocity], blank=True)
    given = np.isfinite(raw).all(axis=1)
    if not given.any():
        raise UserError(f"{table.path}: all aid samples are missing (columns {', '.join(aid.velocity)})")
    _check_order(table, aid.time, raw[given, 0], table.lines[given])
    t = (raw[given, 0] - origin * spec.time_unit / aid.time_unit) * aid.time_unit + aid.time_offset
    if len(t) < 2:
        raise UserError(f"{table.path}: only one aid sample: at least 2 are needed")
    return t, _turned(raw[given, 1:] * aid.unit, aid.turn)


def _overlap(path: object, nodes: np.ndarray, aid_t: np.ndarray, dt: float, origin: float) -> tuple[float, float]:
    """Time of epoch 0 and the end of what IMU and aid have in common."""
    inside = (aid_t >= nodes[0] - 1e-6 * dt) & (aid_t <= nodes[-1] + 1e-6 * dt)
    if not inside.any():
        raise UserError(
            f"{path}: no aid sample within the IMU record: IMU {origin:.9g} to {origin + nodes[-1]:.9g} s, "
            f"aid {origin + aid_t[0]:.9g} to {origin + aid_t[-1]:.9g} s: check time_unit, or give time_offset"
        )
    start = float(max(aid_t[np.argmax(inside)], nodes[0]))
    return start, float(min(aid_t[-1], nodes[-1]))


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


def _check_gaps(table: Table, t: np.ndarray, dt: float) -> list[str]:
    lost = np.round(np.diff(t) / dt).astype(int) - 1
    if (lost > MAX_LOST).any():
        row = int(np.argmax(lost > MAX_LOST))
        raise UserError(
            f"{table.path}: gap in the IMU of {t[row + 1] - t[row]:.6g} s ({lost[row]} samples, at most "
            f"{MAX_LOST}) after line {table.lines[row]} (time {t[row]:.9g} s; "
            f"{int((lost > MAX_LOST).sum())} such gaps): align the part before or after it"
        )
    if (lost > 0).any():
        row = int(np.argmax(lost))
        return [
            f"{int(lost[lost > 0].sum())} IMU samples missing in {int((lost > 0).sum())} gaps, bridged; "
            f"longest {lost[row]} after {t[row]:.9g} s"
        ]
    return []
