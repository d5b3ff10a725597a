"""What is known of an inertial unit beforehand: how large its biases may be, and its white noise."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from jaxalign.errors import UserError, close_names
from jaxalign.parametrization import as_float64, tunable, with_parameters
from jaxalign.units import DEG_H, DEG_SQRT_H, UG

__all__ = ["GRADES", "ImuErrors", "imu_errors", "imu_figures"]


class ImuErrors(eqx.Module):
    """Figures of an inertial unit as its data sheet has them, the same on the three axes.

    Attributes:
        gyro_bias_deg_h: standard deviation of the constant bias of the gyroscopes.
        gyro_walk_deg_sqrt_h: their angle random walk.
        accel_bias_ug: standard deviation of the constant bias of the accelerometers.
        accel_noise_ug_sqrt_hz: density of their white noise.
    """

    gyro_bias_deg_h: Float[Array, ""] = tunable(0.05, unit="deg/h", bounds=(1e-6, 1e4))
    gyro_walk_deg_sqrt_h: Float[Array, ""] = tunable(0.01, unit="deg/sqrt(h)", bounds=(1e-6, 10.0))
    accel_bias_ug: Float[Array, ""] = tunable(100.0, unit="ug", bounds=(1e-3, 1e5))
    accel_noise_ug_sqrt_hz: Float[Array, ""] = tunable(50.0, unit="ug/sqrt(Hz)", bounds=(1e-3, 1e4))

    @property
    def gyro_bias(self) -> Float[Array, ""]:
        """rad/s."""
        return self.gyro_bias_deg_h * DEG_H

    @property
    def gyro_walk(self) -> Float[Array, ""]:
        """rad/sqrt(s)."""
        return self.gyro_walk_deg_sqrt_h * DEG_SQRT_H

    @property
    def accel_bias(self) -> Float[Array, ""]:
        """m/s^2."""
        return self.accel_bias_ug * UG

    @property
    def accel_walk(self) -> Float[Array, ""]:
        """m/s/sqrt(s)."""
        return self.accel_noise_ug_sqrt_hz * UG

    @classmethod
    def checked(cls, given: Any) -> ImuErrors:
        """What was given, if it is such figures.

        Raises:
            UserError: it is something else.
        """
        if not isinstance(given, cls):
            raise UserError(f"imu = {given!r}: must be ImuErrors, for instance imu_errors('tactical')")
        return given


GRADES = {
    "navigation": (0.05, 0.01, 100.0, 50.0),
    "tactical": (5.0, 0.1, 1000.0, 100.0),
    "mems": (200.0, 0.3, 5000.0, 200.0),
}
"""Grades by name: bias deg/h, walk deg/sqrt(h), bias ug, noise ug/sqrt(Hz)."""


def imu_errors(grade: str) -> ImuErrors:
    """A grade by name.

    Raises:
        UserError: there is none of that name.
    """
    if grade not in GRADES:
        near = close_names(grade, GRADES) or list(GRADES)
        raise UserError(f"no grade {grade!r} of inertial units: did you mean {', '.join(near)}?")
    return ImuErrors(*map(as_float64, GRADES[grade]))


def imu_figures(text: str) -> ImuErrors:
    """What was typed: the name of a grade, or of a TOML file with the fields of :class:`ImuErrors`.

    Raises:
        UserError: no such grade or file, an unknown or missing figure, or one outside its bounds.
    """
    if not text.lower().endswith(".toml"):
        return imu_errors(text)
    try:
        figures = tomllib.loads(Path(text).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UserError(f"{text}: cannot be read as TOML: {error}") from error
    names = [field.name for field in dataclasses.fields(ImuErrors)]
    missing = [name for name in names if name not in figures]
    if missing:
        raise UserError(f"{text}: {', '.join(missing)} missing: it must give {', '.join(names)}")
    try:
        return with_parameters(ImuErrors(), figures)
    except UserError as error:
        raise UserError(f"{text}: {error}") from error
