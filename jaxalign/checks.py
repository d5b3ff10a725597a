"""The fields of a log, one by one: shape, type and range, each with its message.

Every function takes the log's name for the message, returns the value as it is to be kept and raises
`UserError`. Whether the numbers can be true (units, axes) is the business of `jaxalign.plausibility`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxalign.errors import UserError

__all__ = [
    "bad_run",
    "check_length",
    "check_rate",
    "check_site",
    "finite_number",
    "increments",
    "reference",
]

MAX_LATITUDE_DEG = 89.5
"""Beyond it there is no useful east (deg)."""
MIN_EPOCHS = 3
"""Epoch intervals below which nothing can be aligned."""
MIN_DURATION = 1.0
"""Seconds below which nothing can be aligned."""


def finite_number(name: str, key: str, value: Any) -> float:
    """One finite number as float."""
    array = np.asarray(value)
    if array.size != 1 or array.dtype.kind not in "iuf" or not np.isfinite(array).all():
        shown = f"an array of shape {array.shape}" if array.size != 1 else repr(value)
        raise UserError(f"{name}: {key} is {shown}: it must be one finite number")
    return float(array.reshape(()))


def check_rate(name: str, dt: float) -> None:
    """Sampling interval between 1e-5 and 1 s."""
    if not 1e-5 <= dt <= 1.0:
        raise UserError(
            f"{name}: dt is {dt:g}: it is the sampling interval in seconds (1e-5 to 1), not a rate in Hz or "
            "milliseconds"
        )


def check_site(name: str, lat: float, lon: float, h: float) -> None:
    """Latitude and longitude in radians, away from the pole; height on Earth."""
    if abs(lat) > np.pi / 2 + 1e-9:
        raise UserError(f"{name}: latitude is {lat:g} rad: it looks like degrees; multiply by pi/180")
    if abs(lat) > np.radians(MAX_LATITUDE_DEG):
        raise UserError(
            f"{name}: latitude is {np.degrees(lat):.3f} deg: beyond {MAX_LATITUDE_DEG} deg a heading "
            "against north is undefined here"
        )
    if abs(lon) > 2 * np.pi + 1e-9:
        raise UserError(f"{name}: longitude is {lon:g} rad: it looks like degrees; multiply by pi/180")
    if not -12e3 <= h <= 100e3:
        raise UserError(f"{name}: height is {h:g} m: expected -12000 to 100000; is it in mm?")


def check_length(name: str, epochs: int, interval: float) -> None:
    """At least 3 epoch intervals and 1 s."""
    if epochs < MIN_EPOCHS or epochs * interval < MIN_DURATION * (1 - 1e-9):
        raise UserError(
            f"{name}: too short: {epochs} epoch intervals of {interval:g} s, "
            f"at least {MIN_EPOCHS} and {MIN_DURATION:g} s are needed (a heading takes minutes)"
        )


def bad_run(x: np.ndarray) -> tuple[int, int, int] | None:
    """Rows of x (N, K) with NaN or infinity: how many, the first, the length of its run; None if none."""
    bad = np.flatnonzero(~np.isfinite(x).all(axis=1))
    if not len(bad):
        return None
    breaks = np.flatnonzero(np.diff(bad) > 1)
    return len(bad), int(bad[0]), int(breaks[0]) + 1 if len(breaks) else len(bad)


_FARTHEST = np.pi / 2  # in one sample: two of them are integrated as one turn of at most half a circle
_HARDEST = 1e5  # m/s^2, of a sample


def increments(name: str, key: str, value: Any, dt: float) -> np.ndarray:
    """(N, 3) finite float64, rotations of less than a quarter of a circle; float32 is refused."""
    array = np.asarray(value)
    if array.dtype.kind == "f" and array.dtype.itemsize < 8:
        raise UserError(
            f"{name}: {key} is {array.dtype}: increments need float64 (alignment senses 7e-5 rad/s). "
            "JAX makes float32 unless jax_enable_x64 is set; if they were recorded so, convert them "
            "deliberately: "
            f"{key}.astype(numpy.float64)"
        )
    array = _floats(name, key, array, "(N, 3)")
    if array.ndim != 2 or array.shape[1] != 3:
        raise UserError(f"{name}: {key} has shape {array.shape}: (N, 3) is expected, one row per IMU sample")
    if run := bad_run(array):
        count, first, length = run
        raise UserError(
            f"{name}: {key} has NaN or infinity in {count} rows; the first run is {length} long at row "
            f"{first} "
            f"(counted from 0; {first * dt:.6g} s): cut the log there or fill them"
        )
    with np.errstate(over="ignore"):
        size = np.linalg.norm(array, axis=1)
    row = int(np.argmax(size)) if len(size) else 0
    if key == "dvel" and size.max(initial=0.0) > _HARDEST * dt:
        raise UserError(
            f"{name}: dvel changes the velocity by {size[row]:.3g} m/s within the one sample of row {row} "
            f"(counted from 0; {row * dt:.6g} s): no vehicle does; cut the log there or mend the sample"
        )
    if key == "dtheta" and size.max(initial=0.0) > _FARTHEST:
        raise UserError(
            f"{name}: dtheta turns by {np.rad2deg(size[row]):.0f} deg within the one sample of row {row}: rotation "
            "increments in rad are expected, not rates or degrees"
        )
    return array


def reference(name: str, value: Any, epochs: int) -> np.ndarray:
    """(M+1, 3, 3) rotations, NaN where unknown."""
    array = _floats(name, "C_nb", value, f"({epochs + 1}, 3, 3)")
    if array.shape != (epochs + 1, 3, 3):
        raise UserError(f"{name}: C_nb has shape {array.shape}: ({epochs + 1}, 3, 3) is expected, one matrix per epoch")
    known = np.flatnonzero(~np.isnan(array).any(axis=(1, 2)))
    rotations = array[known]
    error = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    error = np.where(np.linalg.det(rotations) < 0, 2.0, error)  # a reflection
    wrong = np.flatnonzero(~(error <= 1e-6))
    if len(wrong):
        raise UserError(
            f"{name}: C_nb at epoch {known[wrong[0]]} is no rotation (error {error[wrong[0]]:.2g}, at most "
            "1e-6): "
            "orthonormalise the reference"
        )
    return array


def _floats(name: str, key: str, value: Any, shape: str) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise UserError(f"{name}: {key} must be an array of numbers {shape}, got {array.dtype}")
    return array.astype(np.float64, copy=False)
