"""The calibration on simulated runs and on real logs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.embedding.dvl_calibration import DOPPLER, Found, Unknowns, calibrate, corrected, expected, spoilt
from experiments.monte_carlo import run_keys
from jaxalign import Epochs, Log, align, epochs_from_log, read
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors
from jaxalign.methods import build
from jaxalign.rotation import attitude_error, euler_from_quat, quat_from_dcm
from jaxalign.simulate import intervals_of, measure_epochs, noiseless, scenario, truth

__all__ = ["INJECTED", "LABELS", "NAMES", "SCENARIOS", "SD", "UNITS", "LogRun", "Simulated", "logs", "sensitivity"]

SCENARIOS = ("dvl-sturn", "dvl-accturn")
DEG = np.pi / 180
NAMES = ("scale", *(f"{what} {axis}" for what in ("mounting", "lever arm") for axis in "xyz"))
UNITS = np.array([0.01, DEG, DEG, DEG, 1.0, 1.0, 1.0])  # %, deg, m
SD = np.array([0.5, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5]) * UNITS
PARTS, LOG_PARTS = 5, 10
INJECTED = np.array([0.5, 0.5, -0.3, 1.0, 0.0, 0.0, 0.0]) * UNITS
LENGTH_S = 390.0
SENSORS = {  # the gyroscope of the real logs is rounded to 1e-4 rad/s
    "real": ImuErrors(GyroErrors(0.02, 0.015), AccelErrors(100.0, 50.0)),
    "semi_real": ImuErrors(GyroErrors(0.02, 0.005), AccelErrors(100.0, 50.0)),
}
LABELS = (
    "perfect Doppler log",
    "with its errors",
    "Doppler log calibrated, inertial unit taken as perfect",
    "inertial unit calibrated, Doppler log taken as perfect",
    "both calibrated",
)
METHOD = build("centred_oba", "body")


def _doppler(prior: Unknowns, values: Any) -> Unknowns:
    """These values of the Doppler log, and a perfect inertial unit."""
    still = jax.tree.map(jnp.zeros_like, prior)
    return eqx.tree_at(lambda u: (u.scale, u.mounting, u.lever), still, (values[0], values[1:4], values[4:]))


def _perfect_doppler(prior: Unknowns) -> Unknowns:
    zero = jax.tree.map(jnp.zeros_like, prior)
    return eqx.tree_at(lambda u: (u.scale, u.mounting, u.lever), prior, (zero.scale, zero.mounting, zero.lever))


@eqx.filter_jit
def _aligned(epochs: Epochs) -> Any:
    return jax.lax.map(lambda e: align(METHOD, e, every=10).q_nb[-1], epochs)


class Simulated(NamedTuple):
    """Of the runs of a scenario.

    Attributes:
        truth: (runs, 7) errors of the Doppler log.
        found: with all unknowns.
        naive: with residuals in the vehicle's axes.
        alone: with a perfect inertial unit taken for granted.
        heading: label -> (runs, 1) error at the end, deg.
    """

    truth: np.ndarray
    found: Found
    naive: Found
    alone: Found
    heading: dict[str, np.ndarray]

    @classmethod
    def of(cls, name: str, runs: int, seed: int) -> Simulated:
        """Draw the errors of the Doppler log from what is known beforehand, and calibrate."""
        made = scenario(name)
        exact = truth(made)
        intervals = intervals_of(exact, made.epoch_samples)
        prior = expected(SD, made.imu, made.duration, PARTS)
        values = np.random.default_rng([seed, 1]).normal(size=(runs, DOPPLER)) * SD

        @jax.jit
        def draw(key: Any, values: Any) -> tuple[Epochs, Epochs]:
            epochs = measure_epochs(intervals, made, key)
            return epochs, spoilt(epochs, _doppler(prior, values))

        clean, bad = jax.vmap(draw)(run_keys(seed, runs), jnp.asarray(values))
        found, naive = calibrate(bad, prior), calibrate(bad, prior, naive=True)
        alone, inertial = calibrate(bad, _doppler(prior, jnp.asarray(SD))), calibrate(bad, _perfect_doppler(prior))
        attitudes = _aligned(clean), _aligned(bad), alone.q_nb, inertial.q_nb, found.q_nb
        true = euler_from_quat(quat_from_dcm(exact.C_nb[-1]))
        heading = {
            label: (np.rad2deg(np.asarray(euler_from_quat(jnp.asarray(q)) - true))[:, 2:] + 180) % 360 - 180
            for label, q in zip(LABELS, attitudes, strict=True)
        }
        return cls(values, found, naive, alone, heading)


def sensitivity(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Time (K,) s and the derivative (K, 7) of the heading (deg) by errors of the Doppler log, without noise."""
    made = noiseless(scenario(name))
    epochs = measure_epochs(intervals_of(truth(made), made.epoch_samples), made, jax.random.key(0))
    epochs = epochs.with_sd(scenario(name).aids[0].sd)
    prior = expected(SD, made.imu, made.duration, 1)

    @jax.jit
    def heading(values: Any) -> tuple[Any, Any]:
        solution = align(METHOD, corrected(epochs, _doppler(prior, -values)), every=10)
        return jnp.rad2deg(-euler_from_quat(solution.q_nb)[:, 2]), solution.time

    slope, time = jax.jacfwd(heading, has_aux=True)(jnp.zeros(DOPPLER))
    return np.asarray(time), np.asarray(slope) * UNITS


class LogRun(NamedTuple):
    """Of one log.

    Attributes:
        name: of the log.
        turned: deg, by how much its course changed, there and back.
        values: (7,) found, with the errors put in.
        sd: (7,) stated.
        reference: (7,) from the reference's velocity, with the errors put in.
        heading: label -> error at the end, deg.
    """

    name: str
    turned: float
    values: np.ndarray
    sd: np.ndarray
    reference: np.ndarray
    heading: dict[str, float]


def logs(count: int) -> list[LogRun]:
    """So many logs of the AUV, as far as they are there, with errors of the Doppler log put in."""
    shared = Path(os.environ.get("JAXALIGN_SHARED", "../shared"))
    return [_log(path) for path in sorted((shared / "data").glob("*real_akit/*real_akit_[0-9][0-9].npz"))[:count]]


def _log(path: Path) -> LogRun:
    log = read(path).crop(0.0, LENGTH_S)
    imu = SENSORS["semi_real" if path.stem.startswith("semi") else "real"]
    prior = expected(SD, imu, log.duration, LOG_PARTS)
    epochs = jax.tree.map(lambda x: jnp.asarray(x)[None], epochs_from_log(log))
    put = _doppler(prior, jnp.asarray(INJECTED))
    bad = jax.jit(jax.vmap(lambda e: spoilt(e, put)))(epochs)
    sd = 0.02
    for _ in range(2):  # what is left says how large the noise is, and how long it lasts
        bad = bad.with_sd(jnp.full(1, sd))
        found = calibrate(bad, prior)
        left = found.residual[0]
        last = np.sum(left[1:] * left[:-1]) / np.sum(left**2)
        sd = np.sqrt(np.mean(left**2) * max(1.0, (1 + last) / (1 - last)))
    attitudes = {"as it was": _aligned(epochs), "with errors put in": _aligned(bad), "calibrated": found.q_nb}
    assert log.C_nb is not None
    true = quat_from_dcm(jnp.asarray(log.C_nb[-1]))
    heading = {k: float(np.rad2deg(attitude_error(jnp.asarray(q)[0], true)[2])) for k, q in attitudes.items()}
    return LogRun(
        path.stem,
        _turned(log),
        found.values[0, :DOPPLER],
        found.sd[0, :DOPPLER],
        _reference(path, log) + INJECTED,
        heading,
    )


def _turned(log: Log) -> float:
    """Total of the changes of the course, each over 5 s, deg."""
    assert log.C_nb is not None
    yaw = np.unwrap(np.arctan2(-log.C_nb[::5, 0, 1], log.C_nb[::5, 1, 1]))
    return float(np.rad2deg(np.abs(np.diff(yaw)).sum()))


def _reference(path: Path, log: Log) -> np.ndarray:
    """Scale, mounting, lever arm that fit the velocity of the Doppler log best to that of the reference."""
    with np.load(path) as arrays:
        true, rate = (arrays[key][: log.epochs + 1] for key in ("aid_v_true", "omega_b_at_aid"))
    axes, velocity = np.eye(3), log.aids[0].value
    columns = [velocity, *(np.cross(e, velocity) for e in axes), *(-np.cross(rate, e) for e in axes)]
    design, off = np.stack(columns, axis=-1), true - velocity
    good = np.isfinite(off).all(axis=1) & np.isfinite(rate).all(axis=1)
    return np.linalg.lstsq(design[good].reshape(-1, DOPPLER), off[good].ravel(), rcond=None)[0]
