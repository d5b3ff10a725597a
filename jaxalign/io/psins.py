"""The text format of the PSINS toolbox (.imu).

After comment lines (%) come three lines of numbers and then the counts, one sample a line:

    pitch roll yaw (deg)  vE vN vU (m/s)        initial attitude and velocity, "maybe inaccurate": not used
    latitude longitude (deg)  height (m)  start time (s)  sampling interval (ms)  g (m/s^2)
    gyro scale factors x y z (arc-second)  accelerometer scale factors x y z (micro-g second)
    gyro counts x y z  accelerometer counts x y z

Axes are right-forward-up. There is no aid: the vehicle stands.
"""

from __future__ import annotations

import os

import numpy as np

from jaxalign.errors import UserError
from jaxalign.files import existing_file, read_text
from jaxalign.log import Log

__all__ = ["read_psins"]

ARC_SECOND = np.pi / 180.0 / 3600.0
_HEADER = (
    "initial attitude (deg) and velocity (m/s)",
    "latitude, longitude (deg), height (m), start time (s), sampling interval (ms), g (m/s^2)",
    "gyro (arc-second) and accelerometer (micro-g s) scale factors",
)


def read_psins(path: str | os.PathLike[str], epoch: float = 1.0) -> Log:
    """Reads a static log.

    Args:
        path: the file.
        epoch: interval between epochs, s, rounded to whole samples.

    Raises:
        UserError: no file, a line that is not six numbers (the line is named), an impossible header, or what
            `Log` refuses.
    """
    path = existing_file(path)
    lines = read_text(path).splitlines()
    header: list[list[float]] = []
    body = 0
    for body, line in enumerate(lines, start=1):
        if text := line.partition("%")[0].strip():
            header.append(_six(path, body, text, _HEADER[len(header)]))
            if len(header) == 3:
                break
    if len(header) < 3:
        raise UserError(f"{path}: ends after {len(header)} of 3 header lines: {_HEADER[len(header)]} is missing")
    _, (lat_deg, lon_deg, h, t0, interval_ms, g), scale = header
    if not 0 < interval_ms <= 1000 or not 9.7 < g < 9.9:
        raise UserError(
            f"{path}: the second line of numbers says sampling interval {interval_ms:g} ms and g {g:g} "
            "m/s^2: "
            f"expected {_HEADER[1]}"
        )
    if min(np.abs(scale)) == 0:
        raise UserError(f"{path}: a scale factor is zero: expected {_HEADER[2]}")
    counts = _counts(path, lines, body)
    dt = interval_ms * 1e-3
    gyro, accelerometer = np.array(scale[:3]) * ARC_SECOND, np.array(scale[3:]) * (1e-6 * g)
    return Log(
        dtheta=counts[:, :3] * gyro,
        dvel=counts[:, 3:] * accelerometer,
        dt=dt,
        epoch_samples=max(1, round(epoch / dt)),
        lat=np.radians(lat_deg),
        lon=np.radians(lon_deg),
        h=h,
        t0=t0,
        name=path.stem,
    )


def _counts(path: object, lines: list[str], body: int) -> np.ndarray:
    """The samples (N, 6); `body` is the number of lines before them."""
    if not any(line.partition("%")[0].strip() for line in lines[body:]):
        raise UserError(f"{path}: no samples after the header")
    try:
        counts = np.loadtxt(lines[body:], comments="%", ndmin=2)
        if counts.shape[1] == 6:
            return counts
    except ValueError:
        pass
    # slow, to name the line
    for number, line in enumerate(lines[body:], start=body + 1):
        if text := line.partition("%")[0].strip():
            _six(path, number, text, "gyro and accelerometer counts")
    raise UserError(f"{path}: the samples cannot be read as six numbers a line")


def _six(path: object, number: int, text: str, what: str) -> list[float]:
    try:
        values = [float(cell) for cell in text.split()]
    except ValueError:
        values = []
    if len(values) != 6:
        raise UserError(f"{path}: line {number}: {text[:60]!r} is not six numbers: {what}")
    return values
