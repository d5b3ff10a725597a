"""Attitude errors of a method over the runs of a block, and the rows at which they are taken."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.rotation import attitude_error, euler_from_quat, quat_from_dcm
from jaxalign.simulate import Scenario, Truth
from jaxalign.solution import Solution, Status
from jaxalign.study.feed import Feed

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


def rows_of(made: Scenario, feed: Feed, every: int) -> Rows:
    """Read-outs every so many epochs of the method."""
    last = made.samples // feed.samples
    epochs = np.unique([*range(0, last + 1, every), last])
    rows = np.flatnonzero((epochs * feed.samples % made.aid_every == 0) & (epochs > 0))
    return Rows(every, rows, epochs[rows] * feed.samples // made.aid_every)


def common_rows(made: Scenario, feed: Feed, every: int, label: str) -> Rows:
    """Read-outs every so many epochs of the scenario, whatever the epochs of the method.

    Raises:
        UserError: the epochs of the method do not divide those of the scenario.
    """
    if every * made.aid_every % feed.samples or made.samples % feed.samples:
        raise UserError(
            f"{label}: its epochs of {feed.samples} IMU samples do not end where it is read out, every "
            f"{every * made.aid_every} of {made.samples} samples: choose another interval_samples or --every"
        )
    return rows_of(made, feed, every * made.aid_every // feed.samples)


class Errors(eqx.Module):
    """Errors of the runs of a block; NaN where a run has no attitude.

    Attributes:
        euler: (runs, K, 3) deg: pitch, roll, yaw, estimate minus truth.
        phi: (runs, K, 3) deg: east, north, up, with C_est = (I - [phi x]) C_true.
        failed: (runs, K) whether a number of the run is not finite.
    """

    euler: Float[Array, "runs K 3"]
    phi: Float[Array, "runs K 3"]
    failed: Bool[Array, "runs K"]


def errors_of(method: Any, epochs: Epochs, exact: Truth, where: Rows) -> Errors:
    """Align the runs of a block (last axis of the leaves of ``epochs``) and compare with the truth. Pure."""
    reference = quat_from_dcm(exact.C_nb[where.places])

    def run(found: Solution) -> Errors:
        found = jax.tree.map(lambda x: x[where.rows], found)
        euler = jnp.rad2deg(euler_from_quat(found.q_nb) - euler_from_quat(reference))
        euler, phi = (euler + 180.0) % 360.0 - 180.0, jnp.rad2deg(attitude_error(found.q_nb, reference))
        failed = (found.status & int(Status.NON_FINITE)) != 0
        known = (found.defined & ~failed)[:, None]
        return Errors(jnp.where(known, euler, jnp.nan), jnp.where(known, phi, jnp.nan), failed)

    return jax.vmap(run)(method.solve_runs(epochs, where.every))
