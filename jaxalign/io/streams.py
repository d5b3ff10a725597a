"""A log from plain arrays, each on its own clock: what every reader ends in.

Time stamps are believed. A rate is the value at its stamp and is integrated by trapezoids; an increment belongs to the
sampling interval that ends at its stamp. Cumulated sums are interpolated linearly onto an even grid
(:mod:`jaxalign.io.resample`). Where an aid measures at an even interval, epochs are at its samples: the grid divides
the interval into a whole number of samples, as near to the rate of the IMU as can be. Aids keep their own times: one
between two samples of the grid splits that sample (:func:`jaxalign.epochs_from_log`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxalign.checks import finite_number
from jaxalign.errors import UserError
from jaxalign.io.resample import cumulate_increments, cumulate_rates, nominal_interval, onto_grid
from jaxalign.log import Log
from jaxalign.measurements import Measurements

__all__ = ["MAX_LOST", "check_gaps", "log_from_streams", "turned"]

MAX_LOST = 3
"""Samples of the IMU that may be missing in a row."""
_EPOCH = 1.0  # s, of a vehicle that stands
_NEAR = 1e-6  # of an interval: a sample so near to an epoch is there


def turned(x: np.ndarray, turn: bool = True) -> np.ndarray:
    """Forward-right-down to right-forward-up, and north-east-down to east-north-up: the same permutation, (n, 3)."""
    return np.column_stack([x[:, 1], x[:, 0], -x[:, 2]]) if turn else x


def log_from_streams(
    time: np.ndarray,
    gyro: np.ndarray,
    accel: np.ndarray,
    aids: Measurements | Sequence[Measurements] = (),
    *,
    lat: float,
    lon: float = 0.0,
    h: float = 0.0,
    increments: bool = False,
    interval: float | None = None,
    max_lost: int = MAX_LOST,
    origin: float = 0.0,
    name: str = "log",
    warnings: Sequence[str] = (),
) -> Log:
    """A checked log from arrays on their own clocks.

    Epoch 0 is the first sample of an aid inside the record of the IMU, the end the last one; without aids the whole
    record counts.

    Args:
        time: (N,) stamps of the IMU, s, increasing.
        gyro: (N, 3) rad/s at the stamps, b = right-forward-up; or rotation increments, rad.
        accel: (N, 3) specific force, m/s^2; or velocity increments, m/s.
        aids: what the aids have measured, times on the clock of the IMU.
        lat: latitude, rad.
        lon: longitude, rad.
        h: height, m.
        increments: whether gyro and accel are increments over the interval that ends at their stamp.
        interval: between epochs, s; by default that of the aid that measures most often, 1 s without aids.
        max_lost: samples of the IMU that may be missing in a row; they are bridged.
        origin: s, what the clock says at time zero: large times lose digits, so let them begin near zero.
        name: of the log.
        warnings: to be kept with it.

    Raises:
        UserError: shapes that do not fit, NaN, time that does not increase, gaps, no aid within the record of the IMU,
            or what :class:`Log` refuses.
    """
    time, gyro, accel = (np.asarray(x, np.float64) for x in (time, gyro, accel))
    _check_shapes(name, time, gyro, accel)
    given = (aids,) if isinstance(aids, Measurements) else tuple(aids)
    if wrong := [one for one in given if not isinstance(one, Measurements)]:
        raise UserError(f"{name}: aids must be Measurements, got {wrong[0]!r}")
    t = time - time[0]
    dt = nominal_interval(t)
    if not 1e-5 <= dt <= 1.0:
        raise UserError(f"{name}: the IMU's sampling interval is {dt:g} s, expected 1e-5 to 1 s: is time in seconds?")
    said = check_gaps(name, time + origin, dt, max_lost, lambda row: f"row {row}")
    x = np.hstack([gyro, accel])
    nodes, sums = cumulate_increments(t, x, dt) if increments else cumulate_rates(t, x)
    moved = [dataclasses.replace(one, time=one.time - time[0]) for one in given]
    inside = [_within(name, one, nodes, dt, float(time[0]) + origin) for one in moved]
    if interval is None:
        interval = min((nominal_interval(one.time) for one in inside if len(one.time) > 1), default=_EPOCH)
    interval = finite_number(name, "interval", interval)
    samples = round(interval / dt)
    if samples < 1:
        raise UserError(f"{name}: epochs every {interval:g} s are closer than the IMU samples ({dt:g} s): lengthen it")
    start = min((float(one.time[0]) for one in inside), default=float(nodes[0]))
    end = max((float(one.time[-1]) for one in inside), default=float(nodes[-1]))
    step = interval / samples if inside else dt
    count = int(np.floor((end - start) / step + 1e-6))
    if start + (count + 1) * step <= nodes[-1] + _NEAR * dt and end - start > (count + 1e-6) * step:
        count += 1  # the last value is between two samples
    if count < samples:
        raise UserError(
            f"{name}: too short: IMU and aids have {end - start:g} s in common, not one interval of {interval:g} s"
        )
    grid = start + step * np.arange(count + 1)
    moves = onto_grid(nodes, sums, grid)
    return Log(
        dtheta=moves[:, :3],
        dvel=moves[:, 3:],
        dt=step,
        epoch_samples=samples,
        aids=tuple(_on_grid(one, start, interval, count * step) for one in inside),
        lat=lat,
        lon=lon,
        h=h,
        t0=float(time[0]) + origin + start,
        name=name,
        warnings=(*warnings, *said),
    )


def _check_shapes(name: str, time: np.ndarray, gyro: np.ndarray, accel: np.ndarray) -> None:
    if time.ndim != 1 or gyro.shape != (len(time), 3) or accel.shape != (len(time), 3):
        raise UserError(
            f"{name}: time, gyro, accel have shapes {time.shape}, {gyro.shape}, {accel.shape}: (N,), (N, 3), (N, 3) "
            "are expected"
        )
    if len(time) < 4:
        raise UserError(f"{name}: too short: {len(time)} rows")
    for key, x in (("time", time[:, None]), ("gyro", gyro), ("accel", accel)):
        bad = np.flatnonzero(~np.isfinite(x).all(axis=1))
        if len(bad):
            raise UserError(f"{name}: {key} is NaN or infinite at {len(bad)} rows, first row {bad[0]} (counted from 0)")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        raise UserError(
            f"{name}: time does not increase at {len(back)} rows, first after row {back[0]} (counted from 0): sort the "
            "rows and remove duplicates"
        )


def check_gaps(name: object, t: np.ndarray, dt: float, most: int, where: Any) -> list[str]:
    """Refuse a long gap; what to say of short ones.

    Args:
        name: for the message.
        t: (N,) stamps, s.
        dt: nominal interval, s.
        most: samples that may be missing in a row.
        where: row number -> how to call it.

    Raises:
        UserError: more are.
    """
    lost = np.round(np.diff(t) / dt).astype(int) - 1
    if (lost > most).any():
        row = int(np.argmax(lost > most))
        raise UserError(
            f"{name}: gap in the IMU of {t[row + 1] - t[row]:.6g} s ({lost[row]} samples, at most "
            f"{most}) after {where(row)} (time {t[row]:.9g} s; "
            f"{int((lost > most).sum())} such gaps): align the part before or after it"
        )
    if (lost > 0).any():
        row = int(np.argmax(lost))
        return [
            f"{int(lost[lost > 0].sum())} IMU samples missing in {int((lost > 0).sum())} gaps, bridged; "
            f"longest {lost[row]} after {t[row]:.9g} s"
        ]
    return []


def _within(name: str, one: Measurements, nodes: np.ndarray, dt: float, origin: float) -> Measurements:
    """The values inside the record of the IMU."""
    inside = (one.time >= nodes[0] - _NEAR * dt) & (one.time <= nodes[-1] + _NEAR * dt)
    if not inside.any():
        raise UserError(
            f"{name}: no {one.name} sample within the IMU record: IMU {origin:.9g} to {origin + nodes[-1]:.9g} s, "
            f"{one.name} {origin + one.time[0]:.9g} to {origin + one.time[-1]:.9g} s: check the unit of time, or shift "
            "the clock"
        )
    times = np.clip(one.time[inside], nodes[0], nodes[-1])
    return dataclasses.replace(one, time=times, value=one.value[inside])


def _on_grid(one: Measurements, start: float, interval: float, end: float) -> Measurements:
    """On the clock of the log, at epochs where as good as there; NaN for samples missing from an even clock."""
    time = one.time - start
    number = np.round(time / interval)
    near = np.abs(time - number * interval) <= _NEAR * interval
    time = np.where(near, number * interval, time)
    kept = (time >= 0) & (time <= end * (1 + 1e-12))
    time, value = time[kept], one.value[kept]
    if near[kept].all() and len(time) > 1:
        own = max(round(nominal_interval(time) / interval), 1)
        steps = (number[kept] - number[kept][0]) / own
        if (steps == np.round(steps)).all():
            first, last = number[kept][[0, -1]] * interval
            first -= np.floor(first / (own * interval) + _NEAR) * own * interval
            last = first + np.floor((end - first) / (own * interval) + _NEAR) * own * interval
            at = first + np.arange(round((last - first) / (own * interval)) + 1) * (own * interval)
            full = np.full((len(at), value.shape[1]), np.nan)
            full[np.round((time - first) / (own * interval)).astype(int)] = value
            time, value = at, full
    return dataclasses.replace(one, time=time, value=value)
