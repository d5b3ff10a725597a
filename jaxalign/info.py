"""What a log is, in words and numbers for a person."""

from __future__ import annotations

import math

import numpy as np

from jaxalign.log import Log
from jaxalign.plausibility import median_force
from jaxalign.wgs84 import EARTH_RATE, gravity

__all__ = ["describe"]

_AIDS = {
    "static": "none: static",
    "body": "velocity in the body frame (right-forward-up)",
    "nav": "velocity in the navigation frame (ENU)",
}
_DEG_PER_HOUR = np.degrees(1.0) * 3600.0


def describe(log: Log) -> list[tuple[str, str]]:
    """Rates, lengths, gaps and plausibility of a log.

    Args:
        log: the log.

    Returns:
        (label, value with its unit) in the order for reading, one "warning" line for each warning.
    """
    interval = log.aid_every * log.dt
    rows = [
        ("name", log.name),
        ("IMU", f"{1 / log.dt:.6g} Hz, {len(log.dtheta)} samples"),
        ("duration", f"{log.duration:.6g} s from t = {log.t0:.9g} s"),
        ("epochs", f"{log.epochs} intervals of {interval:.6g} s ({log.aid_every} samples)"),
        ("site", _site(log)),
        ("aid", _AIDS[log.aid]),
    ]
    if log.velocity is not None:
        rows += _aid(log, interval)
    return [
        *rows,
        *_inertial(log),
        ("reference attitude", _reference(log)),
        *(("warning", text) for text in log.warnings or ("none",)),
    ]


def _site(log: Log) -> str:
    lat, lon = np.degrees([log.lat, log.lon])
    return f"latitude {lat:.6f} deg, longitude {lon:.6f} deg, height {log.h:.1f} m"


def _aid(log: Log, interval: float) -> list[tuple[str, str]]:
    assert log.velocity is not None
    missing = log.missing
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(int), [0]])))
    longest = int(np.diff(edges)[::2].max()) if len(edges) else 0
    speed = np.linalg.norm(log.velocity[~missing], axis=1)
    gap = f", longest run {longest} ({longest * interval:g} s)" if longest else ""
    noise = "not given" if log.aid_sd is None else f"{log.aid_sd:g} m/s per axis"
    return [
        ("aid samples missing", f"{int(missing.sum())} of {len(missing)}{gap}"),
        (
            "aid speed",
            f"mean {speed.mean():.3f}, median {np.median(speed):.3f}, largest {speed.max():.3f} m/s",
        ),
        ("aid noise", noise),
    ]


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
