"""Half an hour of navigation after the alignment: what the attitude errors of the schemes cost in position."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.monte_carlo import run_keys
from jaxalign import Epochs, NavState, Quat, Site, Vec3, epochs_from_arrays, navigate
from jaxalign.mechanization import displacement
from jaxalign.rotation import quat_from_dcm
from jaxalign.simulate import (
    Constant,
    CourseVelocity,
    Scenario,
    Steps,
    Trajectory,
    Truth,
    imu_increments,
    scenario,
    truth,
)

__all__ = ["SCALE_PPM", "drive", "length_km", "position_errors"]

SCALE_PPM = {"tactical": (100.0, 100.0), "navigation": (20.0, 40.0)}
"""Scale factors of gyros and accelerometers, Tables 3 and 4."""
DURATION = 1800.0


def drive(condition: int) -> Scenario:
    """A city drive from where the vehicle stood: five stretches between stops, right-angled turns.

    The paper shows its way only as a picture; 14 km in half an hour here, level but for the attitude it stood in.
    """
    stood = scenario("disturbed", condition=condition, noise_per="density", bias="sign", duration=60.0)
    deg = jnp.deg2rad
    starts, stops = (20.0, 380.0, 740.0, 1100.0, 1460.0), (345.0, 705.0, 1065.0, 1425.0, 1785.0)
    speed = Steps([9.0] * 5 + [-9.0] * 5, [*starts, *stops], 3.0)
    turns = Steps(
        deg(jnp.array([-90.0, 90.0, 90.0, -90.0, -90.0, -90.0, 90.0, 90.0])),
        [110.0, 250.0, 470.0, 610.0, 830.0, 1190.0, 1300.0, 1600.0],
        3.0,
        deg(30.0),
    )
    way = Trajectory(
        pitch=Constant(deg(1.0)), roll=Constant(deg(-0.5)), yaw=turns, velocity=CourseVelocity(speed, turns)
    )
    return dataclasses.replace(stood, trajectory=way, force=None, duration=DURATION, name="drive")


def length_km(exact: Truth) -> float:
    """Of the way."""
    speed = np.linalg.norm(exact.velocity_n, axis=1)
    return float(np.trapezoid(speed, exact.t)) / 1000


@eqx.filter_jit
def _errors(exact: Truth, made: Scenario, key: jax.Array, phi: jax.Array, scale: tuple[float, float]) -> jax.Array:
    """(starts, epochs) horizontal position errors (m) of one run, from starts off by phi (starts, 3), rad."""
    dtheta, dvel = imu_increments(exact, made, key)
    epochs: Epochs = epochs_from_arrays(
        dtheta * (1 + scale[0]),
        dvel * (1 + scale[1]),
        None,
        dt=1.0 / made.imu_rate,
        every=made.epoch_samples,
        site=made.site,
        aid="static",
    )
    true = Quat.of(quat_from_dcm(exact.C_nb[0]))
    velocity = Vec3.of(exact.velocity_n[0])

    def one(phi: jax.Array) -> jax.Array:
        found = navigate(epochs, NavState.at(made.site, Quat.exp(Vec3.of(-phi)) * true, velocity))
        here = displacement(found, made.site)
        place = Site(exact.lat, exact.lon, exact.h)
        there = displacement(NavState(found.q_nb, found.velocity, place.lat, place.lon, place.h), made.site)
        return jnp.hypot(here.x - there.x, here.y - there.y)

    return jax.vmap(one)(phi)


def position_errors(condition: int, grade: str, phi_deg: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal position errors after alignments.

    Args:
        condition: of Table 2: the sensors, with the biases of the alignment's runs.
        grade: for the scale factors.
        phi_deg: (starts, runs, 3) attitude errors at the end of the alignments, deg.
        seed: of the runs.

    Returns:
        RMS over time and largest, m, (starts, runs).
    """
    made = drive(condition)
    exact = truth(made)
    scale: Any = tuple(x * 1e-6 for x in SCALE_PPM[grade])
    found = [
        np.asarray(_errors(exact, made, key, jnp.deg2rad(phi_deg[:, i]), scale))
        for i, key in enumerate(run_keys(seed, phi_deg.shape[1]))
    ]
    errors = np.stack(found, axis=1)
    return np.sqrt((errors**2).mean(axis=-1)), errors.max(axis=-1)
