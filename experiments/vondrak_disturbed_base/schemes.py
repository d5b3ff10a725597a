"""The four schemes of the paper, its two grades of sensors, and the start of its fine alignment."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxalign import DualVector, Epochs, Fine, Quat, Vec3
from jaxalign.earth import EARTH_RATE, STANDARD_GRAVITY
from jaxalign.front_end import FrontEnd
from jaxalign.inertial import InertialRecord
from jaxalign.methods import build
from jaxalign.parametrization import with_parameters
from jaxalign.prefilter import AbstractPrefilter, Fir, Vondrak, Wavelet
from jaxalign.simulate import Scenario, draw_bias
from jaxalign.whole_record import AbstractWholeRecordMethod, RecordReadout

__all__ = ["FINES", "GRADES", "SCHEMES", "Turned", "behind", "fine_of", "floor_deg", "grade_of"]

SCHEMES: dict[str, AbstractPrefilter | None] = {
    "1: Vondrak": Vondrak(),
    "2: no filter": None,
    "3: FIR": Fir(),
    "4: wavelet": Wavelet(),
}
"""All at 0.5 Hz."""


def _filter(accel_ug: float, gyro_deg_h: float, walk_deg_h_sqrt_hz: float) -> dict[str, float]:
    return {
        "imu.accel.bias_ug": accel_ug,
        "imu.accel.density_ug_sqrt_hz": accel_ug,
        "imu.gyro.bias_deg_h": gyro_deg_h,
        "imu.gyro.walk_deg_sqrt_h": walk_deg_h_sqrt_hz / 60,
        "initial_tilt_sd_deg": 0.05,
    }


GRADES = {"tactical": _filter(50, 0.1, 0.05), "navigation": _filter(10, 0.02, 0.01)}
"""Tables 3 and 4, as the filter takes them."""
FINES = {
    "fine, published form, 1 mm/s": (1e-3, "published"),
    "fine, 1 mm/s": (1e-3, "standing"),
    "fine, 1 cm/s": (1e-2, "standing"),
}
"""Noise of the zero velocity (m/s) and form of the fine alignments."""


def grade_of(condition: int) -> str:
    """Of a condition of Table 2."""
    return "tactical" if condition <= 2 else "navigation"


class Turned(AbstractWholeRecordMethod):
    """A coarse alignment whose heading is off by a stated angle more: what the fine alignment has to remove.

    Attributes:
        method: the coarse alignment.
        deg: turn about up, deg.
    """

    method: AbstractWholeRecordMethod = eqx.field(default_factory=DualVector)
    deg: Any = 2.0
    front_end: FrontEnd = eqx.field(default_factory=FrontEnd)

    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> RecordReadout:
        """The coarse attitude, turned."""
        found = self.method.find(epochs, record, rows)
        turn = Quat.exp(Vec3(0.0, 0.0, jnp.deg2rad(self.deg)))
        q_nb = jax.tree.map(lambda x: x * jnp.ones(len(rows)), turn) * found.q_nb
        return dataclasses.replace(found, q_nb=q_nb)


def fine_of(numbers: dict[str, Any], velocity_sd: float, form: str, turned: float = 2.0) -> Fine:
    """The fine alignment of sensors with these numbers: 3 deg of heading to begin with.

    Args:
        numbers: of the filter.
        velocity_sd: m/s.
        form: of the filter; the published one does not widen its initial heading on a short record.
        turned: the coarse heading is off by so many degrees more.
    """
    start = build("dual_vector")
    method = Fine(coarse=Turned(method=start, deg=turned) if turned else start)
    settings = {**numbers, "velocity_sd": velocity_sd, "form": form}
    margin = {"heading_margin": 0.0} if form == "published" else {}
    return with_parameters(method, {f"filter.{name}": value for name, value in settings.items()} | margin)


def behind(prefilter: AbstractPrefilter | None, method: Any) -> Any:
    """The method with a filter in front."""
    return method.with_front_end(FrontEnd(method.front_end.interval_samples, prefilter=prefilter))


def floor_deg(made: Scenario, keys: jax.Array) -> np.ndarray:
    """(runs,) heading error (phi_U, deg) that the drawn biases leave to every method at rest.

    ``tan(lat) nabla_E / g - eps_E / (w_ie cos(lat))``.
    """

    def biases(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        gyro, accel = (jax.random.split(jax.random.fold_in(key, i))[0] for i in (0, 1))
        return draw_bias(made.imu.gyro, made.bias, gyro), draw_bias(made.imu.accel, made.bias, accel)

    gyro, accel = jax.vmap(biases)(keys)
    east = made.trajectory.attitude(jnp.zeros(())).matrix.array[0]
    lat = made.site.lat
    phi = jnp.tan(lat) * (accel @ east) / STANDARD_GRAVITY - (gyro @ east) / (EARTH_RATE * jnp.cos(lat))
    return np.asarray(jnp.rad2deg(phi))
