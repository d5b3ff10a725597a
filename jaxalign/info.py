"""What a log is, in words and numbers for a person."""

from __future__ import annotations

import math

import numpy as np

from jaxalign.aids import Standing
from jaxalign.log import Log
from jaxalign.measurements import Measurements
from jaxalign.plausibility import median_force
from jaxalign.trust import log_findings
from jaxalign.wgs84 import EARTH_RATE, gravity

__all__ = ["describe"]

_DEG_PER_HOUR = np.degrees(1.0) * 3600.0


def describe(log: Log) -> list[tuple[str, str]]:
    """Rates, lengths, gaps and plausibility of a log.

    Args:
        log: the log.

    Returns:
        (label, value with its unit) in the order for reading, one "warning" line for each warning, and one "check" line
        for each finding of the checks that need no alignment (:mod:`jaxalign.trust`).
    """
    rows = [
        ("name", log.name),
        ("IMU", f"{1 / log.dt:.6g} Hz, {len(log.dtheta)} samples"),
        ("duration", f"{log.duration:.6g} s from t = {log.t0:.9g} s"),
        ("epochs", f"{log.epochs} intervals of {log.interval:.6g} s ({log.epoch_samples} samples)"),
        ("site", _site(log)),
    ]
    if log.standing:
        rows.append(("aid", Standing().described))
    for one in log.aids:
        rows += _aid(log, one)
    return [
        *rows,
        *_inertial(log),
        ("reference attitude", _reference(log)),
        *(("warning", text) for text in log.warnings or ("none",)),
        *_checks(log),
    ]


def _checks(log: Log) -> list[tuple[str, str]]:
    found = log_findings(log)
    if not found:
        return [("checks", "none failed")]
    return [("check", one.text if one.trusted else f"NOT TRUSTED: {one.text}") for one in found]


def _site(log: Log) -> str:
    lat, lon = np.degrees([log.lat, log.lon])
    return f"latitude {lat:.6f} deg, longitude {lon:.6f} deg, height {log.h:.1f} m"


def _aid(log: Log, one: Measurements) -> list[tuple[str, str]]:
    """An aid; where there are several the labels have its name."""
    name = "aid" if len(log.aids) == 1 else one.name
    missing = one.missing
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(int), [0]])))
    longest = int(np.diff(edges)[::2].max()) if len(edges) else 0
    interval = float(np.median(np.diff(one.time))) if len(one.time) > 1 else log.interval
    gap = f", longest run {longest} ({longest * interval:g} s)" if longest else ""
    rows = [(name, one.aid.described)]
    if not np.allclose(one.time, np.arange(len(one.time)) * interval + one.time[0], rtol=0, atol=1e-6 * log.dt):
        steps = np.diff(one.time)
        rows.append((f"{name} clock", f"{len(one.time)} samples, every {steps.min():g} to {steps.max():g} s"))
    elif abs(interval - log.interval) > 1e-9:
        rows.append((f"{name} clock", f"{len(one.time)} samples, every {interval:g} s"))
    rows.append((f"{name} samples missing", f"{int(missing.sum())} of {len(missing)}{gap}"))
    if one.velocity is not None:
        speed = np.linalg.norm(one.velocity, axis=1)
        speed = speed[np.isfinite(speed)]
        text = f"mean {speed.mean():.3f}, median {np.median(speed):.3f}, largest {speed.max():.3f} m/s"
        rows.append((f"{name} speed", text))
    else:
        for what, values in zip(one.aid.components, one.value.T, strict=True):
            rows.append((f"{name} {what}".removesuffix(f" {name}"), _range(values, one.aid.unit)))
    return [*rows, (f"{name} noise", _noise(one))]


def _noise(one: Measurements) -> str:
    sd, parts, unit = one.sd, one.aid.components, one.aid.unit
    if sd is None:
        return "not given"
    if unit == "rad":
        sd, unit = np.degrees(sd), "deg"
    if np.ndim(sd):
        return ", ".join(f"{what} {x:g}" for what, x in zip(parts, np.asarray(sd), strict=True)) + f" {unit}"
    return f"{sd:g} {unit} per axis" if len(parts) > 1 else f"{sd:g} {unit}"


def _range(values: np.ndarray, unit: str) -> str:
    known = values[np.isfinite(values)]
    if not len(known):
        return "never measured"
    known, unit = (np.degrees(known), "deg") if unit == "rad" else (known, unit)
    return f"from {known.min():.3f} to {known.max():.3f} {unit}"


def _inertial(log: Log) -> list[tuple[str, str]]:
    normal = gravity(math.sin(log.lat), log.h, math.sqrt)
    force = median_force(log.dvel, log.dt)
    mean_f = log.dvel.mean(axis=0) / log.dt
    mean_w = log.dtheta.mean(axis=0) / log.dt
    rate = np.linalg.norm(mean_w) * _DEG_PER_HOUR
    tilt = np.degrees(np.arctan2(np.hypot(mean_f[0], mean_f[1]), mean_f[2]))
    axes = ", ".join(f"{axis} {value:+.4f}" for axis, value in zip("xyz", mean_f, strict=True))
    return [
        (
            "median |f|",
            f"{force:.5f} m/s^2; normal gravity {normal:.5f} m/s^2 ({(force / normal - 1) * 1e6:+.0f} ppm)",
        ),
        ("mean f", f"{axes} m/s^2, {tilt:.2f} deg off +z (up)"),
        ("mean gyro rate", f"{rate:.2f} deg/h; Earth rate {EARTH_RATE * _DEG_PER_HOUR:.2f} deg/h"),
    ]


def _reference(log: Log) -> str:
    if log.C_nb is None:
        return "no"
    known = int((~np.isnan(log.C_nb).any(axis=(1, 2))).sum())
    return f"at {known} of {len(log.C_nb)} epochs"
