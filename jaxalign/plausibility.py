"""Units and axes that cannot be right: what the data of a log say against themselves, on the host, in NumPy.

Accelerometers are judged by the median of |f|, which is near gravity on anything that is being aligned.
Gyroscopes have no such yardstick: a fast vehicle in rad/s and a slow one in deg/s look alike. Three witnesses
are heard, and none of them speaks where there is nothing to compare:

* tilting: the change of the specific force in b over some seconds against the one that the gyroscopes
  predict, df = -dtheta x f. Smooth windows of 4 and 10 s keep lever arms (gain omega^2 r / g) and vibration
  out of it. A finding counts only if the specific force, carried by the gyroscopes over half a minute,
  confirms it (a pendulum hides its tilt from the accelerometers, but its gyroscopes still hold the vertical);
* turning: the change of course of a velocity aid in n against the rotation about the vertical;
* standing: mean rate and its elevation against the Earth's rotation.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxalign.errors import UserError
from jaxalign.wgs84 import EARTH_RATE, STANDARD_GRAVITY

__all__ = [
    "axis_warnings",
    "check_gyro_units",
    "check_specific_force",
    "mean_force_axis",
    "median_force",
    "rotations",
]

_DEG = np.pi / 180.0
_ENOUGH_WINDOWS = 40
_SURE = 0.5  # share of the variance that the comparison must explain (rho^2)
_MATCH = 1.7  # a ratio within this factor of 57.3 is 57.3; the logs at hand give ratios from 0.8 to 1.2
_AXES = ("right (x)", "forward (y)", "up (z)")


def median_force(dvel: np.ndarray, dt: float) -> float:
    """Median of |f| over windows of about 1 s (m/s^2); dvel (N, 3) m/s, dt s."""
    f = _window_sums(dvel, _samples(1.0, dt, len(dvel)))
    n = _samples(1.0, dt, len(dvel))
    return float(np.median(np.linalg.norm(f, axis=1))) / (n * dt)


def check_specific_force(name: str, dvel: np.ndarray, dt: float) -> None:
    """Refuses accelerometer data that are far from gravity.

    Args:
        name: name of the log for the message.
        dvel: (N, 3) velocity increments, m/s.
        dt: sampling interval, s.

    Raises:
        UserError: the median of |f| is not within a factor of 1.5 of 9.8 m/s^2; the likely unit is named.
    """
    f = median_force(dvel, dt)
    g = STANDARD_GRAVITY
    if g / 1.5 < f < g * 1.5:
        return
    suspects = (
        (1.0, "accelerations in g? multiply by 9.80665"),
        (g / dt, "rates (m/s^2) given as increments? multiply by dt"),
        (g * dt, "increments (m/s) given as rates? divide by dt"),
        (1.0 / dt, "rates in g given as increments? multiply by 9.80665 dt"),
        (dt, "increments in g s given as rates in m/s^2? multiply by 9.80665 / dt"),
        (1e3, "accelerations in mg? multiply by 9.80665e-3"),
        (100.0 * g, "accelerations in cm/s^2? divide by 100"),
        (g / 0.3048, "accelerations in ft/s^2? multiply by 0.3048"),
        (1e3 * g, "accelerations in mm/s^2, or dt in ms? SI units are meant"),
    )
    # the nearest; where two agree to a thousandth, the first
    off, advice = min(
        ((round(abs(np.log(max(f, 1e-30) / value)), 3), text) for value, text in suspects),
        key=lambda pair: pair[0],
    )
    if off > 0.1:
        advice = "check unit and scale"
    raise UserError(f"{name}: |f| = {f:.4g} m/s^2, expected about 9.8: {advice}")


def mean_force_axis(dvel: np.ndarray, dt: float) -> tuple[np.ndarray, str]:
    """Mean specific force and the axis it is along.

    Returns:
        The mean of f (3,) m/s^2 and the name of its largest component such as "+z"; "none" when the mean is
        below half of gravity (the vehicle has turned over).
    """
    f = dvel.mean(axis=0) / dt
    if np.linalg.norm(f) < 0.5 * STANDARD_GRAVITY:
        return f, "none"
    axis = int(np.argmax(np.abs(f)))
    return f, ("+" if f[axis] > 0 else "-") + "xyz"[axis]


def axis_warnings(dtheta: np.ndarray, dvel: np.ndarray, dt: float) -> list[str]:
    """Findings on axes and scale that do not prevent alignment (dtheta rad, dvel m/s, both (N, 3); dt s)."""
    found = []
    _, axis = mean_force_axis(dvel, dt)
    if axis == "-z":
        found.append(
            "mean specific force is along -z: forward-right-down data? Turn it to right-forward-up (CSV: frame)"
        )
    elif axis not in ("+z", "none"):
        which = _AXES["xyz".index(axis[1])]
        sign = "" if axis[0] == "+" else "minus "
        found.append(
            f"mean specific force is along {axis}, {sign}{which}, not +z: swapped axes, or a vehicle on its side?"
        )
    ratio = median_force(dvel, dt) / STANDARD_GRAVITY
    if abs(ratio - 1.0) > 0.05:
        found.append(
            f"median |f| is {100 * (ratio - 1):+.0f} % off gravity: accelerometer scale, or steady acceleration?"
        )
    if any(rho < 0 and rho**2 > _SURE for rho, _ in _tilting(dtheta, dvel, dt)):
        found.append(
            "gyroscopes turn against the tilting that the accelerometers see: a sign or axes differ between the two"
        )
    return found


def check_gyro_units(
    name: str,
    dtheta: np.ndarray,
    dvel: np.ndarray,
    dt: float,
    lat: float,
    course_velocity: np.ndarray | None,
    epoch_samples: int,
    standing: bool,
) -> None:
    """Refuses gyroscope data that are 57.3 times too large or too small, where that can be known.

    Args:
        name: name of the log for the message.
        dtheta: (N, 3) rotation increments, rad.
        dvel: (N, 3) velocity increments, m/s.
        dt: sampling interval, s.
        lat: latitude, rad.
        course_velocity: (M+1, 3) velocities in n, m/s, or None.
        epoch_samples: IMU samples per epoch of `course_velocity`.
        standing: whether the vehicle is known to stand.

    Raises:
        UserError: one of the witnesses of the module's docstring says that the unit is wrong.
    """
    factor, witness = 1.0, ""
    if standing:
        factor, witness = _standing(dtheta, dvel, dt, lat), "the Earth's rotation on a standing vehicle"
    if factor == 1.0 and course_velocity is not None:
        evidence = _turning(dtheta, dvel, dt, course_velocity, epoch_samples)
        factor, witness = _verdict(evidence), "the change of course of the velocity aid"
    if factor == 1.0:
        factor, witness = _verdict(_tilting(dtheta, dvel, dt)), "the tilting that the accelerometers see"
        if factor != 1.0 and not _confirmed(dtheta, dvel, dt, factor):
            factor = 1.0
    if factor < 1.0:
        raise UserError(
            f"{name}: gyro rates are about 57.3 times too large for {witness}: deg/s given as rad/s? multiply by pi/180"
        )
    if factor > 1.0:
        raise UserError(
            f"{name}: gyro rates are about 57.3 times too small for {witness}: rad/s taken for deg/s? "
            "multiply by 180/pi"
        )


def _samples(seconds: float, dt: float, available: int) -> int:
    return min(max(1, round(seconds / dt)), available)


def _window_sums(x: np.ndarray, n: int) -> np.ndarray:
    """(N, 3) -> (N // n, 3), sums over windows of n."""
    m = len(x) // n
    return x[: m * n].reshape(m, n, 3).sum(axis=1)


def _compare(predicted: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
    """Correlation, and ratio of the size of what is seen to what is predicted, both without their means."""
    predicted, seen = predicted - predicted.mean(axis=0), seen - seen.mean(axis=0)
    pp, ss, ps = (predicted**2).sum(), (seen**2).sum(), (predicted * seen).sum()
    if pp == 0.0 or ss == 0.0:
        return 0.0, 1.0
    return float(ps / np.sqrt(pp * ss)), float(np.sqrt(ss / pp))


def _verdict(evidence: Iterator[tuple[float, float]]) -> float:
    """The factor that mends the gyroscopes: pi/180, 180/pi or 1."""
    for rho, ratio in evidence:
        if rho > 0 and rho**2 > _SURE:
            for factor in (_DEG, 1.0 / _DEG):
                if factor / _MATCH < ratio < factor * _MATCH:
                    return factor
    return 1.0


def _tilting(dtheta: np.ndarray, dvel: np.ndarray, dt: float) -> Iterator[tuple[float, float]]:
    """Correlation and size ratio of df seen by the accelerometers and predicted by the gyroscopes."""
    for seconds in (5.0, 2.0):
        hop = round(0.5 * seconds / dt)
        if hop < 2 or len(dvel) < (_ENOUGH_WINDOWS + 4) * hop:
            continue
        window = np.hanning(4 * hop + 1)[1:-1]
        window /= window.sum()
        angle = np.cumsum(dtheta, axis=0) - 0.5 * dtheta
        mean_f = _smooth(dvel, window, hop) / dt
        mean_angle = _smooth(angle, window, hop)
        middle = 0.5 * (mean_f[1:] + mean_f[:-1])
        predicted = -np.cross(np.diff(mean_angle, axis=0), middle)
        seen = np.diff(mean_f, axis=0)
        # a change of |f| is no tilt
        size2 = (middle**2).sum(axis=1, keepdims=True)
        seen = seen - middle * ((seen * middle).sum(axis=1, keepdims=True) / np.where(size2 > 0, size2, 1.0))
        yield _compare(predicted, seen)


def _smooth(x: np.ndarray, window: np.ndarray, hop: int) -> np.ndarray:
    views = np.lib.stride_tricks.sliding_window_view(x, len(window), axis=0)[::hop]
    return views @ window


def _turning(
    dtheta: np.ndarray, dvel: np.ndarray, dt: float, velocity: np.ndarray, epoch_samples: int
) -> Iterator[tuple[float, float]]:
    """Correlation and size ratio of the change of course and the rotation about the vertical, over 1 s."""
    stride = max(1, round(1.0 / (epoch_samples * dt)))
    v, n = velocity[::stride], epoch_samples * stride
    m = len(v) - 1
    if m < 1:
        return
    force = dvel[: m * n].reshape(m, n, 3).sum(axis=1)
    up = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-12)
    turn = (dtheta[: m * n].reshape(m, n, 3).sum(axis=1) * up).sum(axis=1)
    a, b = v[:-1], v[1:]
    course = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])
    speed = np.hypot(v[:, 0], v[:, 1])
    moving = (speed[:-1] > 2.0) & (speed[1:] > 2.0)  # NaN compares false
    if moving.sum() >= _ENOUGH_WINDOWS:
        yield _compare(turn[moving], course[moving])


def _standing(dtheta: np.ndarray, dvel: np.ndarray, dt: float, lat: float) -> float:
    """pi/180 or 180/pi if mean rate times it is the Earth's in size (2 %) and elevation (1.5 deg), else 1."""
    if len(dtheta) * dt < 30.0:
        return 1.0
    w, f = dtheta.mean(axis=0) / dt, dvel.mean(axis=0)
    rate, force = float(np.linalg.norm(w)), float(np.linalg.norm(f))
    if rate == 0.0 or force == 0.0:
        return 1.0
    elevation = np.arcsin(np.clip(w @ f / (rate * force), -1.0, 1.0))
    for factor in (_DEG, 1.0 / _DEG):
        if abs(factor * rate / EARTH_RATE - 1.0) < 0.02 and abs(elevation - lat) < 1.5 * _DEG:
            return factor
    return 1.0


def _confirmed(dtheta: np.ndarray, dvel: np.ndarray, dt: float, factor: float) -> bool:
    """Whether gyroscopes scaled by `factor` hold the vertical over half a minute better than as they are."""
    given, mended = (_wander(scale * dtheta, dvel, dt) for scale in (1.0, factor))
    if factor < 1.0:
        return given > 3.0 * _DEG and mended < given / 3.0
    return mended < given + 2.0 * _DEG


def _wander(dtheta: np.ndarray, dvel: np.ndarray, dt: float) -> float:
    """RMS angle (rad) between mean forces of neighbouring windows of 30 s, carried over by the gyroscopes."""
    n = _samples(0.1, dt, len(dtheta))
    angle, force = _window_sums(dtheta, n), _window_sums(dvel, n)
    steps = max(1, min(round(30.0 / (n * dt)), len(angle) // 4))
    m = len(angle) // steps
    angle = angle[: m * steps].reshape(m, steps, 3)
    force = force[: m * steps].reshape(m, steps, 3)
    frame = np.broadcast_to(np.eye(3), (m, 3, 3))
    total = np.zeros((m, 3))
    for j in range(steps):
        total = total + (frame @ force[:, j, :, None])[..., 0]
        frame = frame @ rotations(angle[:, j])
    here, there = total[:-1], (frame[:-1] @ total[1:, :, None])[..., 0]
    angles = np.arctan2(np.linalg.norm(np.cross(here, there), axis=1), (here * there).sum(axis=1))
    return float(np.sqrt((angles**2).mean()))


def rotations(vectors: np.ndarray) -> np.ndarray:
    """(m, 3) rotation vectors -> (m, 3, 3) matrices (Rodrigues)."""
    size = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = vectors.T
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    return np.eye(3) + np.sinc(size / np.pi) * cross + 0.5 * np.sinc(0.5 * size / np.pi) ** 2 * (cross @ cross)
