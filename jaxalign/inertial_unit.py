"""Errors of an inertial unit: biases, white noise and the wander of the biases, of its two triads.

One model for all: the simulator draws its sensors from it, and methods have it as what is known beforehand.
"""

from __future__ import annotations

import dataclasses
import tomllib
from abc import abstractmethod
from pathlib import Path
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxalign.errors import UserError, close_names
from jaxalign.parametrization import tunable, with_parameters
from jaxalign.units import DEG_H, DEG_SQRT_H, UG

__all__ = [
    "GRADES",
    "PER_SAMPLE",
    "AbstractTriadErrors",
    "AccelErrors",
    "GyroErrors",
    "ImuErrors",
    "by_axis",
    "imu_errors",
    "imu_figures",
]

PER_SAMPLE = ("gyro.noise_deg_h", "accel.noise_ug")
"""Figures that a method has no use for: it does not know the rate of the samples."""
_HOUR = 60.0  # sqrt(s)


class AbstractTriadErrors(eqx.Module):
    """Errors of three gyroscopes or three accelerometers, each one number for the three axes, or three (x, y, z in b).

    Subclasses hold the figures in the units of data sheets. The properties are the same in SI units, with the same
    shape: () or (3,). A method that takes several units side by side has figures of shape (1, L) or (3, L): axes first,
    lanes last.
    """

    _white: ClassVar[tuple[str, str]]
    """Fields of the white noise: density, per sample."""
    _over: ClassVar[float]
    """The unit of the noise per sample over that of the density, sqrt(s)."""

    def __check_init__(self):
        for i, field in enumerate(dataclasses.fields(self)):
            value = getattr(self, field.name)
            if value is None:
                continue
            shape = np.shape(value)
            if shape not in ((), (3,)) and not (len(shape) == 2 and shape[0] in (1, 3)):
                raise UserError(f"{field.name} has the shape {shape}: one number is expected, or three, one per axis")
            if isinstance(value, Tracer):
                continue
            numbers = np.asarray(value)
            if not np.all(np.isfinite(numbers)):
                raise UserError(f"{field.name}: must be finite, got {numbers.tolist()}")
            if i > 0 and np.any(numbers < 0):  # the bias has a sign
                raise UserError(f"{field.name}: must be at least 0, got {numbers.tolist()}")

    @property
    @abstractmethod
    def bias(self) -> Float[Array, "*axes"]:
        """Standard deviation of the constant bias, rad/s or m/s^2; its size and sign where a simulation has it so."""

    @property
    @abstractmethod
    def density(self) -> Float[Array, "*axes"]:
        """White noise as a density, rad/sqrt(s) or m/s/sqrt(s)."""

    @property
    @abstractmethod
    def sample_sd(self) -> Float[Array, "*axes"]:
        """White noise as a standard deviation per sample, rad/s or m/s^2; it adds to the density."""

    @property
    @abstractmethod
    def bias_walk(self) -> Float[Array, "*axes"] | None:
        """Random walk of the bias, rad/s/sqrt(s) or m/s^2/sqrt(s); None: it is constant."""

    def increment_sd(self, dt: Any) -> Float[Array, "*axes"]:
        """Standard deviation of the white noise of one increment over dt (s): rad or m/s."""
        variance = self.density**2 * dt + (self.sample_sd * dt) ** 2
        positive = variance > 0
        return jnp.where(positive, jnp.sqrt(jnp.where(positive, variance, 1.0)), 0.0)

    @property
    def per_sample(self) -> bool:
        """Whether white noise is stated per sample; False inside traced code, where nobody can tell."""
        noise = getattr(self, self._white[1])
        return not isinstance(noise, Tracer) and bool(np.any(np.asarray(noise) != 0))

    def at_rate(self, imu_rate: Any) -> Self:
        """These sensors sampled at so many Hz: the white noise per sample as a part of the density."""
        density, noise = (getattr(self, name) for name in self._white)
        if isinstance(noise, Tracer) or isinstance(density, Tracer) or isinstance(imu_rate, Tracer):
            square = density**2 + (noise * self._over) ** 2 / imu_rate
            positive = square > 0
            density = jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)
        elif self.per_sample:  # with NumPy: nothing to compile
            density = np.sqrt(np.asarray(density) ** 2 + (np.asarray(noise) * self._over) ** 2 / float(imu_rate))
        else:
            return self
        return dataclasses.replace(self, **dict(zip(self._white, (density, 0.0), strict=True)))


class GyroErrors(AbstractTriadErrors):
    """Errors of three gyroscopes, in the units of data sheets. What is not stated is zero.

    Attributes:
        bias_deg_h: constant bias, deg/h: its standard deviation (see :class:`AbstractTriadErrors`).
        walk_deg_sqrt_h: angle random walk, deg/sqrt(h) (a density of 1 deg/h/sqrt(Hz) is 1/60 deg/sqrt(h)).
        noise_deg_h: standard deviation of the white noise of each rate sample, deg/h; beside the angle random walk.
        bias_walk_deg_h_sqrt_h: random walk of the bias (rate random walk), deg/h/sqrt(h); 1 deg/h/sqrt(s) is 60 of
            them. None: the bias is constant.
    """

    _white: ClassVar[tuple[str, str]] = ("walk_deg_sqrt_h", "noise_deg_h")
    _over: ClassVar[float] = DEG_H / DEG_SQRT_H
    bias_deg_h: Float[Array, "*axes"] = tunable(0.0, unit="deg/h", bounds=(0.0, 1e5), axes=True)
    walk_deg_sqrt_h: Float[Array, "*axes"] = tunable(0.0, unit="deg/sqrt(h)", bounds=(0.0, 100.0), axes=True)
    noise_deg_h: Float[Array, "*axes"] = tunable(0.0, unit="deg/h", bounds=(0.0, 1e6), axes=True)
    bias_walk_deg_h_sqrt_h: Float[Array, "*axes"] | None = tunable(
        None, unit="deg/h/sqrt(h)", bounds=(0.0, 1e5), axes=True
    )

    def __init__(
        self,
        bias_deg_h: Any = 0.0,
        walk_deg_sqrt_h: Any = 0.0,
        noise_deg_h: Any = 0.0,
        bias_walk_deg_h_sqrt_h: Any = None,
    ):
        self.bias_deg_h = bias_deg_h
        self.walk_deg_sqrt_h = walk_deg_sqrt_h
        self.noise_deg_h = noise_deg_h
        self.bias_walk_deg_h_sqrt_h = bias_walk_deg_h_sqrt_h

    @property
    def bias(self) -> Float[Array, "*axes"]:
        """rad/s."""
        return self.bias_deg_h * DEG_H

    @property
    def density(self) -> Float[Array, "*axes"]:
        """rad/sqrt(s)."""
        return self.walk_deg_sqrt_h * DEG_SQRT_H

    @property
    def sample_sd(self) -> Float[Array, "*axes"]:
        """rad/s."""
        return self.noise_deg_h * DEG_H

    @property
    def bias_walk(self) -> Float[Array, "*axes"] | None:
        """rad/s/sqrt(s)."""
        walk = self.bias_walk_deg_h_sqrt_h
        return None if walk is None else walk * DEG_H / _HOUR


class AccelErrors(AbstractTriadErrors):
    """Errors of three accelerometers, in the units of data sheets. What is not stated is zero.

    1 ug is 9.80665e-6 m/s^2.

    Attributes:
        bias_ug: constant bias, ug: its standard deviation (see :class:`AbstractTriadErrors`).
        density_ug_sqrt_hz: density of the white noise, ug/sqrt(Hz).
        noise_ug: standard deviation of the white noise of each sample, ug; beside that of the density.
        bias_walk_ug_sqrt_h: random walk of the bias, ug/sqrt(h); 1 ug/sqrt(s) is 60 of them. None: the bias is
            constant.
    """

    _white: ClassVar[tuple[str, str]] = ("density_ug_sqrt_hz", "noise_ug")
    _over: ClassVar[float] = 1.0
    bias_ug: Float[Array, "*axes"] = tunable(0.0, unit="ug", bounds=(0.0, 3e5), axes=True)
    density_ug_sqrt_hz: Float[Array, "*axes"] = tunable(0.0, unit="ug/sqrt(Hz)", bounds=(0.0, 1e5), axes=True)
    noise_ug: Float[Array, "*axes"] = tunable(0.0, unit="ug", bounds=(0.0, 1e7), axes=True)
    bias_walk_ug_sqrt_h: Float[Array, "*axes"] | None = tunable(None, unit="ug/sqrt(h)", bounds=(0.0, 1e6), axes=True)

    def __init__(
        self, bias_ug: Any = 0.0, density_ug_sqrt_hz: Any = 0.0, noise_ug: Any = 0.0, bias_walk_ug_sqrt_h: Any = None
    ):
        self.bias_ug = bias_ug
        self.density_ug_sqrt_hz = density_ug_sqrt_hz
        self.noise_ug = noise_ug
        self.bias_walk_ug_sqrt_h = bias_walk_ug_sqrt_h

    @property
    def bias(self) -> Float[Array, "*axes"]:
        """m/s^2."""
        return self.bias_ug * UG

    @property
    def density(self) -> Float[Array, "*axes"]:
        """m/s/sqrt(s)."""
        return self.density_ug_sqrt_hz * UG

    @property
    def sample_sd(self) -> Float[Array, "*axes"]:
        """m/s^2."""
        return self.noise_ug * UG

    @property
    def bias_walk(self) -> Float[Array, "*axes"] | None:
        """m/s^2/sqrt(s)."""
        walk = self.bias_walk_ug_sqrt_h
        return None if walk is None else walk * UG / _HOUR


class ImuErrors(eqx.Module):
    """Errors of an inertial unit; by default there are none.

    Attributes:
        gyro: of its gyroscopes.
        accel: of its accelerometers.
    """

    gyro: GyroErrors = eqx.field(default_factory=GyroErrors)
    accel: AccelErrors = eqx.field(default_factory=AccelErrors)

    @property
    def alike(self) -> bool:
        """Whether each triad has one white noise for its three axes, and a bias that is constant; by its form alone."""
        triads = (self.gyro, self.accel)
        return all(x.bias_walk is None and jnp.ndim(x.density) == 0 == jnp.ndim(x.sample_sd) for x in triads)

    @classmethod
    def checked(cls, given: Any) -> ImuErrors:
        """What was given, if it is such figures.

        Raises:
            UserError: it is something else.
        """
        if not isinstance(given, cls):
            raise UserError(f"imu = {given!r}: must be ImuErrors, for instance imu_errors('tactical')")
        return given

    def at_rate(self, imu_rate: Any) -> ImuErrors:
        """This unit sampled at so many Hz: white noise per sample as a part of the densities, as methods need it.

        On the host without an operation of JAX.
        """
        return ImuErrors(self.gyro.at_rate(imu_rate), self.accel.at_rate(imu_rate))

    def check_densities(self) -> None:
        """Refuse white noise per sample: for a method, which sees epochs.

        Raises:
            UserError: there is some (inside traced code it cannot be seen).
        """
        if self.gyro.per_sample or self.accel.per_sample:
            raise UserError(
                "imu: white noise is stated per sample, a method needs its density: give imu.at_rate(200.0), with the "
                "rate of your samples in Hz"
            )

    def over_lanes(self, count: int) -> ImuErrors:
        """NumPy leaves (1, count), or (3, count) if any figure has three axes. A constant bias wanders by zero.

        Units that differ in no more than their numbers then share a compiled program.

        Args:
            count: of lanes; figures that have lanes already have so many.
        """
        axes = max((by_axis(np.asarray(x)).shape[0] for x in jax.tree.leaves(self)), default=1)

        def of_lanes(x: Any) -> np.ndarray:
            return np.broadcast_to(np.zeros((1, 1)) if x is None else by_axis(np.asarray(x)), (axes, count))

        return jax.tree.map(of_lanes, self, is_leaf=lambda x: x is None)


def by_axis(figure: Any) -> Any:
    """A figure as (1, 1), (3, 1), (1, L) or (3, L): axes first, lanes last."""
    return figure if figure.ndim == 2 else figure.reshape(-1, 1)


GRADES = {
    "navigation": (0.05, 0.01, 100.0, 50.0),
    "tactical": (5.0, 0.1, 1000.0, 100.0),
    "mems": (200.0, 0.3, 5000.0, 200.0),
}
"""Grades by name: gyro bias deg/h, angle random walk deg/sqrt(h), accelerometer bias ug, density ug/sqrt(Hz)."""


def imu_errors(grade: str) -> ImuErrors:
    """A grade by name.

    Raises:
        UserError: there is none of that name.
    """
    if grade not in GRADES:
        near = close_names(grade, GRADES) or list(GRADES)
        raise UserError(f"no grade {grade!r} of inertial units: did you mean {', '.join(near)}?")
    gyro_bias, walk, accel_bias, density = GRADES[grade]
    return ImuErrors(GyroErrors(gyro_bias, walk), AccelErrors(accel_bias, density))


_NEEDED = {
    "gyro": (("bias_deg_h",), ("walk_deg_sqrt_h", "noise_deg_h")),
    "accel": (("bias_ug",), ("density_ug_sqrt_hz", "noise_ug")),
}
_FORM = "[gyro] bias_deg_h, walk_deg_sqrt_h and [accel] bias_ug, density_ug_sqrt_hz"


def imu_figures(text: str) -> ImuErrors:
    """What was typed: the name of a grade, or of a TOML file of figures.

    The file has two tables with the fields of :class:`GyroErrors` and :class:`AccelErrors`, as a scenario file has
    them; each figure is one number, or a list of three::

        [gyro]
        bias_deg_h = [2.0, 2.0, 3.0]
        walk_deg_sqrt_h = 0.1
        [accel]
        bias_ug = 500.0
        density_ug_sqrt_hz = 80.0

    Raises:
        UserError: no such grade or file, an unknown or missing figure, or one outside its bounds.
    """
    if not text.lower().endswith(".toml"):
        return imu_errors(text)
    try:
        tables = tomllib.loads(Path(text).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UserError(f"{text}: cannot be read as TOML: {error}") from error
    flat = [key for key, value in tables.items() if key not in _NEEDED or not isinstance(value, dict)]
    if flat:
        raise UserError(f"{text}: {flat[0]}: the figures stand in two tables: {_FORM}")
    missing = [
        f"[{triad}] {' or '.join(names)}"
        for triad, needed in _NEEDED.items()
        for names in needed
        if not set(names) & set(tables.get(triad, {}))
    ]
    if missing:
        raise UserError(f"{text}: {', '.join(missing)}: missing; it must give {_FORM}")
    figures = {f"{triad}.{name}": value for triad, table in tables.items() for name, value in table.items()}
    try:
        return with_parameters(ImuErrors(), figures)
    except UserError as error:
        raise UserError(f"{text}: {error}") from error
