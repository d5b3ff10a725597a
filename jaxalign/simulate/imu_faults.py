"""What goes wrong with an inertial unit, as composable modules: changes of what its triads measure.

Each maps the increments of a run to others, sample by sample: ``fault(key, t, dt, dtheta, dvel) -> (dtheta, dvel)``.
Apply several one after the other. Pure, to be vmapped over keys. Constant biases, their wander and white noise are no
faults but what every unit has: :mod:`jaxalign.inertial_unit`. Axes are x, y, z of b: right, forward, up.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign.arguments import check_choice
from jaxalign.errors import UserError
from jaxalign.simulate.arguments import leaf
from jaxalign.units import DEG_H, UG
from jaxalign.wgs84 import STANDARD_GRAVITY

__all__ = [
    "AbstractImuFault",
    "Drift",
    "GSensitivity",
    "Misalignment",
    "ScaleFactor",
    "WarmUp",
    "check_some",
    "figure",
]

_HOUR = 3600.0


class AbstractImuFault(eqx.Module):
    """A change of what the gyroscopes and accelerometers of a run measure."""

    @abstractmethod
    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """The increments with the fault in them.

        Args:
            key: of the fault in a run.
            t: times of the ends of the samples, s since the start.
            dt: of a sample, s.
            dtheta: rotation increments, rad.
            dvel: velocity increments, m/s.
        """


def figure(kind: str, name: str, value: Any, low: float = -np.inf, matrix: bool = False) -> Array:
    """A leaf of one number, of one for each axis, or (if there are such) of one for each pair of axes; None: zero."""
    what = f"{kind}: {name}"
    array = leaf(0.0 if value is None else value, what, low)
    if array.shape not in ((), (3,), *(((3, 3),) if matrix else ())):
        more = ", or three rows of three" if matrix else ""
        raise UserError(f"{what} has the shape {array.shape}: one number is expected, or three (x, y, z){more}")
    return array


def check_some(kind: str, **given: Any) -> None:
    """Refuse a fault of which no size is given."""
    if all(value is None for value in given.values()):
        raise UserError(f"{kind}: give {' or '.join(given)}: without it there is no fault")


def _of_run(key: PRNGKeyArray, drawn: bool, figures: tuple[Array, ...], matrix: bool = False) -> tuple[Array, ...]:
    """Figures of a run, (3,) or (3, 3) each: as they are, or drawn with them as standard deviations."""
    out = []
    for own, x in zip(jax.random.split(key, len(figures)), figures, strict=True):
        x = jnp.broadcast_to(x[:, None] if matrix and x.ndim == 1 else x, (3, 3) if matrix else (3,))
        out.append(x * jax.random.normal(own, x.shape, jnp.float64) if drawn else x)
    return tuple(out)


class WarmUp(AbstractImuFault):
    """Biases that fade after switching on: ``amount exp(-t / time_constant)``.

    One that settles from zero to a value is this with the other sign, and that value as the bias of the unit.

    Attributes:
        gyro_deg_h: of the gyroscopes at the start, deg/h, one number or three.
        accel_ug: of the accelerometers at the start, ug, likewise.
        time_constant: s.
        drawn: each run draws the amounts, with those as standard deviations (static).
    """

    gyro_deg_h: Float[Array, "*axes"]
    accel_ug: Float[Array, "*axes"]
    time_constant: Float[Array, ""]
    drawn: bool = eqx.field(static=True)

    def __init__(self, time_constant: Any, gyro_deg_h: Any = None, accel_ug: Any = None, drawn: bool = False):
        check_some("WarmUp", gyro_deg_h=gyro_deg_h, accel_ug=accel_ug)
        self.time_constant = leaf(time_constant, "WarmUp: time_constant", low=1e-3)
        self.gyro_deg_h = figure("WarmUp", "gyro_deg_h", gyro_deg_h)
        self.accel_ug = figure("WarmUp", "accel_ug", accel_ug)
        self.drawn = check_choice("WarmUp: drawn", drawn, (False, True))

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """With what the biases add (rad, m/s), integrated exactly."""
        gyro, accel = _of_run(key, self.drawn, (self.gyro_deg_h * DEG_H, self.accel_ug * UG))
        tau = self.time_constant
        seconds = (tau * jnp.exp(-(t - dt) / tau) * -jnp.expm1(-dt / tau))[:, None]
        return dtheta + gyro * seconds, dvel + accel * seconds


class Drift(AbstractImuFault):
    """Biases that grow linearly from zero, as with a steady change of temperature.

    Attributes:
        gyro_deg_h_h: of the gyroscopes, deg/h in an hour, one number or three.
        accel_ug_h: of the accelerometers, ug in an hour, likewise.
        drawn: each run draws the slopes, with those as standard deviations (static).
    """

    gyro_deg_h_h: Float[Array, "*axes"]
    accel_ug_h: Float[Array, "*axes"]
    drawn: bool = eqx.field(static=True)

    def __init__(self, gyro_deg_h_h: Any = None, accel_ug_h: Any = None, drawn: bool = False):
        check_some("Drift", gyro_deg_h_h=gyro_deg_h_h, accel_ug_h=accel_ug_h)
        self.gyro_deg_h_h = figure("Drift", "gyro_deg_h_h", gyro_deg_h_h)
        self.accel_ug_h = figure("Drift", "accel_ug_h", accel_ug_h)
        self.drawn = check_choice("Drift: drawn", drawn, (False, True))

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """With what the biases add (rad, m/s), integrated exactly."""
        gyro, accel = _of_run(key, self.drawn, (self.gyro_deg_h_h * DEG_H / _HOUR, self.accel_ug_h * UG / _HOUR))
        square = ((t - 0.5 * dt) * dt)[:, None]
        return dtheta + gyro * square, dvel + accel * square


class ScaleFactor(AbstractImuFault):
    """Errors of the scale factors: an axis measures (1 + error) times what there is.

    Attributes:
        gyro_percent: of the gyroscopes, % (1 % is 10000 ppm), one number or three.
        accel_percent: of the accelerometers, likewise.
        drawn: each run draws the error of each axis, with those as standard deviations (static).
    """

    gyro_percent: Float[Array, "*axes"]
    accel_percent: Float[Array, "*axes"]
    drawn: bool = eqx.field(static=True)

    def __init__(self, gyro_percent: Any = None, accel_percent: Any = None, drawn: bool = False):
        check_some("ScaleFactor", gyro_percent=gyro_percent, accel_percent=accel_percent)
        self.gyro_percent = figure("ScaleFactor", "gyro_percent", gyro_percent)
        self.accel_percent = figure("ScaleFactor", "accel_percent", accel_percent)
        self.drawn = check_choice("ScaleFactor: drawn", drawn, (False, True))

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """Scaled (rad, m/s)."""
        gyro, accel = _of_run(key, self.drawn, (self.gyro_percent / 100.0, self.accel_percent / 100.0))
        return dtheta * (1.0 + gyro), dvel * (1.0 + accel)


class Misalignment(AbstractImuFault):
    """Axes of a triad that are not where they should be: an axis also measures a part of what is along the others.

    Row i, column j is the part of what is along axis j that axis i measures, %: 1 % is an angle of 10 mrad or 0.57 deg.
    One number is all six of them, three are the rows; of three rows of three the diagonal is not used (it would be a
    scale factor). A skew-symmetric matrix turns the triad as a whole.

    Attributes:
        gyro_percent: of the gyroscopes.
        accel_percent: of the accelerometers.
        drawn: each run draws the six parts of each triad, with those as standard deviations (static).
    """

    gyro_percent: Float[Array, "*axes"]
    accel_percent: Float[Array, "*axes"]
    drawn: bool = eqx.field(static=True)

    def __init__(self, gyro_percent: Any = None, accel_percent: Any = None, drawn: bool = False):
        check_some("Misalignment", gyro_percent=gyro_percent, accel_percent=accel_percent)
        self.gyro_percent = figure("Misalignment", "gyro_percent", gyro_percent, matrix=True)
        self.accel_percent = figure("Misalignment", "accel_percent", accel_percent, matrix=True)
        self.drawn = check_choice("Misalignment: drawn", drawn, (False, True))

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """With the parts of the other axes (rad, m/s)."""
        parts = _of_run(key, self.drawn, (self.gyro_percent / 100.0, self.accel_percent / 100.0), matrix=True)
        gyro, accel = (x * (1.0 - jnp.eye(3)) for x in parts)
        return dtheta + dtheta @ gyro.T, dvel + dvel @ accel.T


class GSensitivity(AbstractImuFault):
    """Gyroscopes that take a force for a rotation.

    Attributes:
        deg_h_g: row i, column j: rate that gyroscope i adds for one g of specific force along axis j, deg/h/g. One
            number is all nine of them, three are the rows.
        drawn: each run draws the nine numbers, with those as standard deviations (static).
    """

    deg_h_g: Float[Array, "*axes"]
    drawn: bool = eqx.field(static=True)

    def __init__(self, deg_h_g: Any, drawn: bool = False):
        self.deg_h_g = figure("GSensitivity", "deg_h_g", deg_h_g, matrix=True)
        self.drawn = check_choice("GSensitivity: drawn", drawn, (False, True))

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """With the rotation that the force (here as measured) feigns, rad; the force as it was."""
        (part,) = _of_run(key, self.drawn, (self.deg_h_g * (DEG_H / STANDARD_GRAVITY),), matrix=True)
        return dtheta + dvel @ part.T, dvel
