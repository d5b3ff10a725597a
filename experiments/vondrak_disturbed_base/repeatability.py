"""The real laser-gyro log: how well its segments repeat, per filter and method."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from experiments.progress import progress
from experiments.vondrak_disturbed_base.schemes import FINES, SCHEMES, behind, fine_of
from jaxalign import Log, align, estimate_aid_sd, read
from jaxalign.inertial import InertialRecord
from jaxalign.methods import build
from jaxalign.rotation import attitude_error
from jaxalign.vector import Quat

__all__ = ["LENGTHS", "METHODS", "find", "repeatability"]

LENGTHS = (60.0, 120.0, 300.0)
SAMPLES = 10
GYRO_LASER: dict[str, Any] = {
    "imu.accel.bias_ug": 50.0,
    "imu.accel.density_ug_sqrt_hz": 20.0,
    "imu.gyro.bias_deg_h": 0.01,
    "imu.gyro.walk_deg_sqrt_h": 1e-3,
    "initial_tilt_sd_deg": 0.1,
}


def _fine(velocity_sd: float, form: str) -> Callable[[], tuple[Any, int]]:
    return lambda: (fine_of(GYRO_LASER, velocity_sd, form), SAMPLES)


METHODS: dict[str, Callable[[], tuple[Any, int]]] = {
    "TRIAD": lambda: (build("triad"), SAMPLES),
    "2 vectors, T/6": lambda: (build("dual_vector", parameters={"vectors": "boxcar", "fraction": 1 / 6}), SAMPLES),
    "2 vectors, T/3": lambda: (build("dual_vector", parameters={"vectors": "boxcar"}), SAMPLES),
    "velocity_q": lambda: (build("velocity_q"), SAMPLES),
    "2 vectors, Hann T/3": lambda: (build("dual_vector"), 1),
    "the same, epochs of 0.1 s": lambda: (build("dual_vector"), SAMPLES),
    **{what: _fine(*numbers) for what, numbers in FINES.items()},
}
"""Methods, and IMU samples per epoch."""


def find(folder: Path) -> Path | None:
    """The log in a folder of data, or None."""
    path = folder / "data" / "lasergyro" / "lasergyro_first_half.npz"
    return path if path.exists() else None


def _reference(log: Log, times: list[float]) -> np.ndarray:
    """(times, 4) attitudes: where the fine alignment of the whole log ends, taken back by the gyros."""
    method = fine_of(GYRO_LASER, 0.01, "standing", 0.0)
    epochs = method.epochs(log)
    end = align(method, epochs, every=len(epochs) - 1).q_nb[-1]
    record = InertialRecord.of(epochs)
    last, rows = record.at(-1), record.at(np.round(np.array(times) / epochs.interval).astype(int))
    q_n0b0 = last.q_n0n * Quat.of(end) * last.q_b0b.conjugate()
    return np.asarray((rows.q_n0n.conjugate() * q_n0b0 * rows.q_b0b).array)


def repeatability(
    path: Path, lengths: tuple[float, ...] = LENGTHS, schemes: Sequence[str] = tuple(SCHEMES)
) -> dict[tuple[float, str, str], np.ndarray]:
    """(length s, scheme, method) -> (segments,) differences of heading from the reference, deg."""
    # The file calls its zero velocity a navigation aid; epochs of our own need a log without one.
    whole = dataclasses.replace(read(path), aids=(), C_nb=None, epoch_samples=SAMPLES)
    out: dict[tuple[float, str, str], np.ndarray] = {}
    count = sum(int(whole.duration // length) for length in lengths) * len(schemes) * len(METHODS)
    noise = estimate_aid_sd(build("velocity_q").epochs(whole))
    with progress("laser-gyro log", count) as bar:
        for length in lengths:
            starts = np.arange(int(whole.duration // length)) * length
            expected = _reference(whole, list(starts + length))
            for scheme in schemes:
                jax.clear_caches()  # Linux limits the memory maps of programs
                for label, make in METHODS.items():
                    method, samples = make()
                    found = []
                    for start, q in zip(starts, expected, strict=True):
                        segment = whole.crop(start, start + length).with_epochs(samples)
                        chosen = behind(SCHEMES[scheme], method)
                        solution = align(chosen, segment, every=segment.epochs, aid_sd=noise)
                        found.append(np.rad2deg(attitude_error(solution.q_nb[-1], q))[2])
                        bar.update(1)
                    out[length, scheme, label] = np.array(found)
    return out
