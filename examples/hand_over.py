"""From alignment to navigation: an error-state Kalman filter that starts where ``robust_map`` ends, under way.

    python -m examples.hand_over

The first half of a log of a vehicle that moves is aligned. Its :class:`jaxalign.NavEstimate` gives the filter state and
covariance: attitude, velocity and biases, correlated as they are. The filter navigates the second half with the same
Doppler velocities. If the hand-over is honest, its first innovations are as large as it expects them to be.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxalign as ja  # noqa: E402
from jaxalign.fine import transition  # noqa: E402
from jaxalign.fine.error_model import ACCEL, GYRO, PSI, STATES, VELOCITY  # noqa: E402
from jaxalign.mechanization import NavState, advance  # noqa: E402
from jaxalign.simulate import simulate  # noqa: E402

ORDER = np.r_[PSI, VELOCITY, GYRO, ACCEL]  # rows of the filter in the order of the hand-over
SIGN = np.repeat([1.0, 1.0, -1.0, -1.0], 3)  # the filter counts biases as truth less estimate


def begin(estimate: ja.NavEstimate) -> tuple[Any, Any]:
    """State and covariance of the filter from one row of what was handed over."""
    lat, lon, h = estimate.position
    nav = NavState(ja.Quat.of(estimate.q_nb), ja.Vec3.of(estimate.velocity), lat, lon, h)
    known = estimate.block("attitude", "velocity", "gyro_bias", "accel_bias") * (SIGN[:, None] * SIGN)
    covariance = jnp.zeros((STATES, STATES)).at[ORDER[:, None], ORDER].set(known)
    return (nav, ja.Vec3.of(estimate.gyro_bias), ja.Vec3.of(estimate.accel_bias)), covariance


def step(state: Any, covariance: Any, row: ja.Epoch, imu: ja.ImuErrors, sd: Any) -> tuple[Any, Any, Any, Any]:
    """Navigate over an interval, and take in the velocity in b at its end where there is one.

    Returns:
        State, covariance, and the innovation (m/s, b) with its covariance.
    """
    nav, gyro, accel = state
    moved = ja.Increment(row.rotation, row.dvel).corrected(gyro, accel, row.dt)
    force = nav.q_nb.rotate(moved.dvel) * (1.0 / row.dt)
    phi = transition(nav, force, row.dt)
    noise = jnp.zeros(STATES).at[VELOCITY].set(imu.accel.density**2).at[PSI].set(imu.gyro.density**2)
    covariance = phi @ covariance @ phi.T + jnp.diag(noise) * row.dt
    nav = advance(nav, moved, row.dt)

    c_bn, v = nav.q_nb.conjugate().matrix.array, nav.velocity.array
    across = jnp.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    h = jnp.zeros((3, STATES)).at[:, VELOCITY].set(c_bn).at[:, PSI].set(-c_bn @ across)
    innovation = c_bn @ v - row.velocity.array
    expected = h @ covariance @ h.T + sd**2 * jnp.eye(3)
    gain = jnp.where(row.valid, jnp.linalg.solve(expected, h @ covariance).T, 0.0)
    error, covariance = gain @ innovation, covariance - gain @ h @ covariance
    nav = NavState(
        (ja.Quat.exp(ja.Vec3.of(error[PSI])) * nav.q_nb).unit(),
        nav.velocity - ja.Vec3.of(error[VELOCITY]),
        nav.lat,
        nav.lon,
        nav.h,
    )
    state = (nav, gyro + ja.Vec3.of(error[GYRO]), accel + ja.Vec3.of(error[ACCEL]))
    return state, covariance, innovation, expected


def navigated(estimate: ja.NavEstimate, rows: ja.Epoch, imu: ja.ImuErrors, sd: Any) -> tuple[Any, Any, Any]:
    """All rows from a hand-over on: states, innovations (K, 3) and their covariances (K, 3, 3). Pure."""

    def one(carry: Any, row: ja.Epoch) -> tuple[Any, Any]:
        state, covariance, innovation, expected = step(*carry, row, imu, sd)
        return (state, covariance), (state, innovation, expected)

    return jax.lax.scan(one, begin(estimate), rows)[1]


def main() -> None:
    """Align 150 s of a log under way, then navigate."""
    scenario = ja.simulate.scenario("dvl-sturn")
    log = simulate(scenario, seed=1)
    half = 150  # epochs of 1 s
    method = dataclasses.replace(ja.build("robust_map", "body"), imu=scenario.imu)
    found = ja.align(method, log.crop(0.0, float(half)), every=half)
    assert found.nav is not None
    estimate = jax.tree.map(lambda x: x[-1], found.nav)
    sd = np.rad2deg(np.asarray(estimate.sd("attitude")))
    print(f"handed over at {float(estimate.time):.0f} s: heading {found.heading_deg[-1]:.2f} +- {sd[2]:.2f} deg")

    epochs = ja.epochs_from_log(log, interval_samples=20)
    rows = jax.tree.map(lambda x: x[half * 10 + 1 :], epochs.rows)
    (nav, _, _), innovation, expected = jax.jit(navigated)(estimate, rows, scenario.imu, 0.1)
    valid = np.asarray(rows.valid)
    first = np.flatnonzero(valid)[:5]
    square = [float(x @ np.linalg.solve(s, x)) / 3 for x, s in zip(innovation[first], expected[first], strict=True)]
    print(f"its first five fixes: normalised squared innovations {', '.join(f'{x:.2f}' for x in square)} (1 expected)")
    true = np.rad2deg(np.arctan2(log.C_nb[-1][0, 1], log.C_nb[-1][1, 1])) % 360.0
    last = jax.tree.map(lambda x: x[-1], nav.q_nb).matrix.array
    heading = np.rad2deg(np.arctan2(float(last[0, 1]), float(last[1, 1]))) % 360.0
    print(f"at the end: heading {heading:.2f} deg, true {true:.2f} deg")


if __name__ == "__main__":
    main()
