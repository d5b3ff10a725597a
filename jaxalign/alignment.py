"""A log aligned with a method: its epochs, the noise of its aid, its solution."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
from jax.core import Tracer

from jaxalign.aid_noise import white_noise_sd
from jaxalign.aligner import Aligner
from jaxalign.epochs import Epochs, check_every
from jaxalign.errors import UserError
from jaxalign.estimate import QMethod
from jaxalign.log import Log
from jaxalign.method import AbstractMethod
from jaxalign.observe import AbstractObserve, BodyVelocity, NavVelocity, Static
from jaxalign.parametrization import as_float64
from jaxalign.precision import require_x64
from jaxalign.prefilter.base import without_prefilter
from jaxalign.solution import Solution, Status

__all__ = ["align", "epochs_for", "estimate_aid_sd"]


def estimate_aid_sd(epochs: Epochs) -> float:
    """Standard deviation of the aid's white noise (m/s; standing: of the force over one interval), from the epochs.

    Aligns once with the plain q-method to get the vectors, then :func:`jaxalign.aid_noise.white_noise_sd`.

    Raises:
        UserError: too few epochs to tell.
    """
    observe: AbstractObserve = {"static": Static, "body": BodyVelocity, "nav": NavVelocity}[epochs.aid]()
    found = Aligner(observe, estimate=QMethod()).solve(epochs)
    valid = np.asarray(found.status) & int(Status.AID_MISSING) == 0
    sd = white_noise_sd(np.asarray(found.alpha), np.asarray(found.beta), valid, walk=observe.steps)
    if sd is None:
        what = (
            "epochs to estimate the noise of the force"
            if epochs.aid == "static"
            else "velocities to estimate the aid's"
        )
        raise UserError(f"too few {what}: state it (aid_sd of the log, --aid-sd), m/s")
    return sd


def _measured(method: AbstractMethod, log: Log, epochs: Epochs) -> Epochs:
    """The epochs of a log as measured: behind a prefilter the noise is not white, and cannot be estimated."""
    raw = without_prefilter(method)
    return epochs if raw is method else raw.epochs(log)


def align(
    method: AbstractMethod,
    log: Log | Epochs,
    every: int = 1,
    aid_sd: Any = None,
    done: Callable[[int], None] | None = None,
) -> Solution:
    """Align a log with a method.

    Args:
        method: a recipe of :mod:`jaxalign.methods`, an :class:`Aligner` of your own, or any other
            :class:`AbstractMethod`.
        log: a checked log (host), or Epochs (also inside jit, vmap, grad).
        every: epochs between two rows of the result: they come at epoch 0, at each ``every``-th epoch and the last one.
            The eigenproblem costs as much as all the rest of a step, so it is solved only for the rows, and for the
            feedback of the attitude: into the transport rate at least every 10 epochs, into a weight that looks at
            the attitude at each.
        aid_sd: standard deviation of the aid's white noise per axis, m/s (for a method that takes the vehicle as
            standing: of the force integrated over one interval). By default what the log says of the aid that the
            method observes, else an estimate from the log (:func:`estimate_aid_sd`). ``Solution.aid_sd`` says what
            was used.
        done: told how many rows are finished, now and then, by a method whose rows are costly (``rows_are_costly``).

    Returns:
        A :class:`Solution`.

    Raises:
        UserError: float32, an aid that the method does not observe, ``every`` < 1, noise neither stated nor to be
            estimated, or unfiltered epochs for a method with a prefilter.
    """
    check_every(every)
    epochs = epochs_for(method, log, aid_sd)  # first: it refuses what is no method
    return method.solve(epochs, int(every), done)


def epochs_for(method: AbstractMethod, log: Log | Epochs, aid_sd: Any = None) -> Epochs:
    """What a method aligns: the epochs of a log as it makes them, with the noise of the aid.

    Arguments and errors as of :func:`align`.
    """
    AbstractMethod.checked(method)
    if not isinstance(log, Log | Epochs):
        raise UserError(f"{log!r} is neither a Log nor Epochs: read a file with jaxalign.read(path)")
    require_x64(method)
    if isinstance(log, Epochs):
        require_x64(log)
        if log.aid != method.aid:
            raise UserError(f"these epochs have a {log.aid!r} aid, the method observes {method.aid!r}")
        if method.prefilter is not None and not log.filtered:
            raise UserError(
                "the method has a prefilter, but these epochs are not filtered: make them with method.epochs(log), or "
                "with epochs_from_arrays(..., prefilter=method.prefilter)"
            )
        epochs = log
    else:
        epochs = method.epochs(log)
        if aid_sd is None:
            stated = log.aid_sd is not None and log.aid == epochs.aid
            aid_sd = log.aid_sd if stated else estimate_aid_sd(_measured(method, log, epochs))
    if aid_sd is not None:
        if not isinstance(aid_sd, Tracer) and not np.all(np.asarray(aid_sd) > 0):
            raise UserError(f"aid_sd = {aid_sd}: the standard deviation of the aid's noise must be above 0 m/s")
        epochs = eqx.tree_at(lambda e: e.aid_sd, epochs, as_float64(aid_sd))
    return epochs
