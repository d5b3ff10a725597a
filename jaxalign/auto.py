"""A method for a log when none is named: what it takes for unknown, how good the inertial unit is, and why."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxalign.alignment import epochs_for
from jaxalign.batch.iterate import on_host
from jaxalign.batch.robust_map import FEWEST_FIXES, RobustMap
from jaxalign.errors import UserError
from jaxalign.inertial_unit import GRADES, ImuErrors, imu_errors
from jaxalign.log import Log
from jaxalign.methods import build
from jaxalign.units import DEG_H, UG

__all__ = ["NAME", "Choice", "choose"]

NAME = "robust_map"
_MARGIN = 6.0  # of the log-likelihood: 400 to 1
_STEP, _FINE = 1.0, 0.2  # s, between epochs of a standing vehicle; where biases are large and it may sway
_LEAST = 20  # of them
_COARSE = 1.0  # deg/h: gyroscopes that may hide a part of the Earth's rate
_STARTS = 4
_BEYOND = 3.0  # times its standard deviation beforehand, a bias is none of that grade
_UNKNOWNS = {"static": "none", "body": "mounting", "nav": "latency+lever"}
_AIDS = {
    "static": "no aid: the vehicle stands, its velocity is zero but for its disturbance",
    "body": "body velocity; its scale factor and misalignment are among the unknowns",
    "nav": "navigation velocity; the lever arm to its antenna and its latency are among the unknowns",
}


@dataclass(frozen=True)
class Choice:
    """A method that was chosen.

    Attributes:
        name: of its recipe.
        method: itself, for :func:`jaxalign.align`.
        grade: of the inertial unit, None where its figures were given.
        reasons: what was chosen and why, line by line.
    """

    name: str
    method: RobustMap
    grade: str | None
    reasons: tuple[str, ...]


def choose(
    log: Log, imu: ImuErrors | None = None, aid_sd: Any = None, parameters: dict[str, Any] | None = None
) -> Choice:
    """The method for a log: the robust batch estimator, with the aid of the log and a model of its inertial unit.

    A standing vehicle is observed each second (each 0.2 s by a coarse unit); a body aid has its scale factor and
    misalignment among the unknowns, a navigation aid its lever arm and latency. Unless ``imu`` is given, the log is
    aligned with each grade of :data:`jaxalign.batch.GRADES`, and the finest whose likelihood is within a factor of 400
    of the best is taken: what the data do not speak against. A grade that is known is better than one that is guessed.
    With gyroscopes worse than 1 deg/h (a coarse unit) the search starts from four headings.

    Args:
        log: a checked log.
        imu: figures of the inertial unit, for instance ``imu_errors("tactical")``.
        aid_sd: see :func:`jaxalign.align`.
        parameters: path -> value, see :func:`jaxalign.with_parameters`.

    Raises:
        UserError: as :func:`jaxalign.align`, an unknown parameter, or figures of the unit both in ``imu`` and
            ``parameters``.
    """
    if not isinstance(log, Log):
        raise UserError(f"{log!r} is no Log: a method is chosen by what a log holds; read one with jaxalign.read(path)")
    imu = None if imu is None else ImuErrors.checked(imu)
    settings = {"calibrate": _UNKNOWNS[log.aid], "interval_samples": _interval(log, _STEP), **(parameters or {})}
    given = sorted(x for x in parameters or {} if x.startswith("imu."))
    if given:
        raise UserError(
            f"{given[0]}: the figures of the inertial unit go together: give them with imu (--imu FILE.toml)"
        )
    base = build(NAME, log.aid, settings)

    def chosen(imu: ImuErrors, grade: str | None, why: tuple[str, ...]) -> Choice:
        coarse = float(imu.gyro_bias_deg_h) > _COARSE
        starts = _STARTS if coarse and "starts" not in settings else base.starts
        samples = _interval(log, _FINE) if coarse and "interval_samples" not in (parameters or {}) else None
        method = dataclasses.replace(base, imu=imu, starts=starts, interval_samples=samples or base.interval_samples)
        return Choice(NAME, method, grade, (*reasons, *why))

    reasons = (f"aid: {_AIDS[log.aid]}",)
    if imu is not None:
        return chosen(imu, None, ("inertial unit: as stated",))
    grade, why = _grade(base, log, aid_sd)
    return chosen(imu_errors(grade), grade, why)


def _interval(log: Log, step: float) -> int | None:
    """IMU samples between epochs so far apart (s), of a standing vehicle."""
    step = min(step, log.duration / _LEAST)
    return max(round(step / log.dt), 1) if log.aid == "static" else None


def _grade(base: RobustMap, log: Log, aid_sd: Any) -> tuple[str, tuple[str, ...]]:
    """The finest grade that the data do not speak against, and what to say of it."""
    epochs = epochs_for(base, log, aid_sd)
    figures = np.array([GRADES[grade] for grade in GRADES]).T
    model = dataclasses.replace(base.model, imu=ImuErrors(*figures))
    last = np.full(len(GRADES), len(epochs) - 1)
    read = on_host(model, epochs, last, base.iterations, base.starts).read
    coarsest = list(GRADES)[-1]
    likelihood = {grade: float(x) for grade, x in zip(GRADES, read.log_likelihood, strict=True) if np.isfinite(x)}
    if not likelihood or int(np.sum(np.asarray(epochs.rows.valid))) < FEWEST_FIXES:
        return coarsest, (f"inertial unit: {coarsest}, as the log has too few fixes to tell",)
    best = max(likelihood.values())
    grade = next(x for x, value in likelihood.items() if value > best - _MARGIN)
    told = ", ".join(f"{x} {value - best:.1f}" for x, value in likelihood.items())
    why = f"inertial unit: {grade}, the finest grade that the data allow (log-likelihood to the best: {told})"
    own, (gyro_bias, _, accel_bias, _) = list(GRADES).index(grade), GRADES[grade]
    beyond = [
        f"{name} biases of {size:.1f} times what is usual"
        for name, size in (
            ("gyroscope", np.max(np.abs(read.gyro[:, own])) / (gyro_bias * DEG_H)),
            ("accelerometer", np.max(np.abs(read.accel[:, own])) / (accel_bias * UG)),
        )
        if size > _BEYOND
    ]
    if not beyond:
        return grade, (why,)
    return grade, (why, f"warning: {' and '.join(beyond)} for {grade}: state the figures of the unit (--imu FILE.toml)")
