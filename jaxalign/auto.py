"""A method for a log when none is named: what it takes for unknown, how good the inertial unit is, and why."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxalign.aids import AbstractAid
from jaxalign.alignment import epochs_for
from jaxalign.batch.auto import Auto, is_coarse, standing_samples
from jaxalign.batch.robust_map import FEWEST_FIXES, RobustMap
from jaxalign.errors import UserError
from jaxalign.inertial_unit import GRADES, ImuErrors, imu_errors
from jaxalign.log import Log
from jaxalign.methods import build_for, with_settings
from jaxalign.units import DEG_H, UG

__all__ = ["NAME", "Choice", "choose"]

NAME = "robust_map"
_INTERVAL = "front_end.interval_samples"
_BEYOND = 3.0  # times its standard deviation beforehand, a bias is none of that grade


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
    """The method for a log: the robust batch estimator, with all aids of the log and a model of its inertial unit.

    A standing vehicle is observed each second (each 0.2 s by a coarse unit); of each aid the unknowns are estimated
    that its class names as usual (a velocity in b: scale factor and misalignment; in n: lever arm and latency).
    Unless ``imu`` is given, the log is aligned with each grade of :data:`jaxalign.inertial_unit.GRADES`, and the
    finest whose likelihood is within a factor of 400 of the best is taken: what the data do not speak against. A
    grade that is known is better than one that is guessed. With gyroscopes worse than 1 deg/h (a coarse unit) the
    search starts from four headings.

    Args:
        log: a checked log.
        imu: errors of the inertial unit, for instance ``imu_errors("tactical")``.
        aid_sd: see :func:`jaxalign.align`.
        parameters: path -> value, see :func:`jaxalign.with_parameters`.

    Raises:
        UserError: as :func:`jaxalign.align`, an unknown parameter, or figures of the unit both in ``imu`` and
            ``parameters``.
    """
    if not isinstance(log, Log):
        raise UserError(f"{log!r} is no Log: a method is chosen by what a log holds; read one with jaxalign.read(path)")
    imu = None if imu is None else ImuErrors.checked(imu).at_rate(1.0 / log.dt)
    given = sorted(x for x in parameters or {} if x.startswith("imu."))
    if given:
        raise UserError(
            f"{given[0]}: the figures of the inertial unit go together: give them with imu (--imu FILE.toml)"
        )
    auto = build_for(tuple(one.aid for one in log.aids), "auto")
    usual = {_INTERVAL: standing_samples(log, coarse=False), **(parameters or {})}
    auto = dataclasses.replace(auto, estimator=with_settings(NAME, auto.estimator, usual))
    if imu is not None:
        grade, unit, why = None, imu, ("inertial unit: as stated",)
    else:
        grade, why = _grade(auto, log, aid_sd)
        unit = imu_errors(grade)
    coarse = bool(is_coarse(unit))
    method = auto.for_unit(unit, coarse)
    if coarse and _INTERVAL not in (parameters or {}):
        method = method.with_front_end(
            dataclasses.replace(method.front_end, interval_samples=standing_samples(log, coarse))
        )
    reasons = tuple(f"aid: {_told(aid)}" for aid in method.aids)
    return Choice(NAME, method, grade, (*reasons, *why))


def _told(aid: AbstractAid) -> str:
    """An aid, and what is estimated of it."""
    if aid.implied:
        return "none: the vehicle stands, its velocity is zero but for its disturbance"
    unknowns = f"; among the unknowns: {', '.join(aid.usual)}" if aid.usual else ""
    return f"{aid.described}{unknowns}"


def _grade(auto: Auto, log: Log, aid_sd: Any) -> tuple[str, tuple[str, ...]]:
    """The finest grade that the data do not speak against, and what to say of it."""
    found = auto.graded(epochs_for(auto.estimator, log, aid_sd))
    own = int(found.number)
    grade = list(GRADES)[own]
    likelihood = {name: float(x) for name, x in zip(GRADES, found.likelihood, strict=True) if np.isfinite(x)}
    if not likelihood or found.fixes < FEWEST_FIXES:
        return grade, (f"inertial unit: {grade}, as the log has too few fixes to tell",)
    best = max(likelihood.values())
    told = ", ".join(f"{x} {value - best:.1f}" for x, value in likelihood.items())
    why = f"inertial unit: {grade}, the finest grade that the data allow (log-likelihood to the best: {told})"
    gyro_bias, _, accel_bias, _ = GRADES[grade]
    beyond = [
        f"{name} biases of {size:.1f} times what is usual"
        for name, size in (
            ("gyroscope", np.max(np.abs(found.gyro[:, own])) / (gyro_bias * DEG_H)),
            ("accelerometer", np.max(np.abs(found.accel[:, own])) / (accel_bias * UG)),
        )
        if size > _BEYOND
    ]
    if not beyond:
        return grade, (why,)
    return grade, (why, f"warning: {' and '.join(beyond)} for {grade}: state the figures of the unit (--imu FILE.toml)")
