"""Attitude errors of a method over the runs of a block, and the rows at which they are taken."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.rotation import attitude_error, euler_from_quat, quat_from_dcm
from jaxalign.simulate import Scenario, Truth
from jaxalign.solution import Solution, Status
from jaxalign.study.epochs_spec import EpochsSpec

__all__ = ["Errors", "Rows", "errors_of", "rows_of"]


class Rows(NamedTuple):
    """Where a method is read out.

    Attributes:
        every: its epochs between two read-outs.
        rows: (K,) rows of its solution at which the truth is known, without epoch 0.
        places: (K,) their epochs in the truth.
    """

    every: int
    rows: np.ndarray
    places: np.ndarray


def rows_of(made: Scenario, spec: EpochsSpec, every: int) -> Rows:
    """Read-outs every so many epochs of the method."""
    last = made.samples // spec.samples
    epochs = np.unique([*range(0, last + 1, every), last])
    rows = np.flatnonzero((epochs * spec.samples % made.epoch_samples == 0) & (epochs > 0))
    return Rows(every, rows, epochs[rows] * spec.samples // made.epoch_samples)


def common_rows(made: Scenario, spec: EpochsSpec, every: int, label: str) -> Rows:
    """Read-outs every so many epochs of the scenario, whatever the epochs of the method.

    Raises:
        UserError: the epochs of the method do not divide those of the scenario.
    """
    if every * made.epoch_samples % spec.samples or made.samples % spec.samples:
        raise UserError(
            f"{label}: its epochs of {spec.samples} IMU samples do not end where it is read out, every "
            f"{every * made.epoch_samples} of {made.samples} samples: choose another front_end.interval_samples or"
            " --every"
        )
    return rows_of(made, spec, every * made.epoch_samples // spec.samples)


class Errors(eqx.Module):
    """Errors of the runs of a block, or of all runs: arrays of JAX or of NumPy; NaN where a run has no attitude.

    Attributes:
        time: (K,) s.
        euler: (runs, K, 3) deg: pitch, roll, yaw, estimate minus truth.
        phi: (runs, K, 3) deg: east, north, up, with C_est = (I - [phi x]) C_true.
        failed: (runs, K) whether a number of the run is not finite.
    """

    time: Any
    euler: Any
    phi: Any
    failed: Any


def errors_of(method: Any, epochs: Epochs, exact: Truth, where: Rows) -> Errors:
    """Align the runs of a block (last axis of the leaves of ``epochs``) and compare with the truth. Pure."""
    reference = quat_from_dcm(exact.C_nb[where.places])

    def run(found: Solution) -> tuple[Any, Any, Any]:
        found = jax.tree.map(lambda x: x[where.rows], found)
        euler = jnp.rad2deg(euler_from_quat(found.q_nb) - euler_from_quat(reference))
        euler, phi = (euler + 180.0) % 360.0 - 180.0, jnp.rad2deg(attitude_error(found.q_nb, reference))
        failed = (found.status & int(Status.NON_FINITE)) != 0
        known = (found.defined & ~failed)[:, None]
        return jnp.where(known, euler, jnp.nan), jnp.where(known, phi, jnp.nan), failed

    return Errors(exact.t[where.places], *jax.vmap(run)(method.solve_runs(epochs, where.every)))
