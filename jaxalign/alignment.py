"""A log aligned with a method: its epochs, the noise of its aid, its solution."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jax.core import Tracer

from jaxalign.aid_noise import values_noise_sd, white_noise_sd
from jaxalign.aligner import Aligner
from jaxalign.epochs import Epochs, Fix, check_every
from jaxalign.errors import UserError
from jaxalign.estimate import QMethod
from jaxalign.front_end import aids_for
from jaxalign.log import Log
from jaxalign.method import AbstractMethod
from jaxalign.observe import OBSERVERS, observer
from jaxalign.precision import require_x64
from jaxalign.solution import Solution, Status

__all__ = ["align", "epochs_for", "estimate_aid_sd"]


def estimate_aid_sd(epochs: Epochs, which: int = 0) -> float:
    """Standard deviation of an aid's white noise (in its unit; standing: of the force over one interval, m/s).

    Of a whole velocity: aligns once with the plain q-method to get the vectors, then
    :func:`jaxalign.aid_noise.white_noise_sd`. Of others, and where one component is missing all the time: by third
    differences of the values themselves, which hold the motion too where it is fast.

    Args:
        epochs: of one log.
        which: of its aids.

    Raises:
        UserError: too few epochs to tell.
    """
    aid = epochs.aids[which]
    if aid.full_velocity and type(aid) in OBSERVERS:
        observe = observer(aid)
        fix = epochs.rows.fixes[which]
        whole = np.all([np.asarray(x) for x in fix.known], axis=0)
        rows = dataclasses.replace(epochs.rows, fixes=(Fix(fix.value, whole),))
        alone = Epochs(rows, epochs.site, (epochs.sd[which],), (aid,), epochs.filtered)
        found = Aligner(observe, estimate=QMethod()).solve(alone)
        valid = np.asarray(found.status) & int(Status.AID_MISSING) == 0
        sd = white_noise_sd(np.asarray(found.alpha), np.asarray(found.beta), valid, walk=observe.steps)
    else:
        sd = None
    if sd is None and not aid.implied:
        sd = values_noise_sd(epochs.rows.fixes[which], aid.periodic)
    if sd is None:
        what = (
            "epochs to estimate the noise of the force"
            if aid.implied
            else f"values to estimate the noise of {aid.name}"
        )
        raise UserError(f"too few {what}: state it (sd of the measurements, --aid-sd), {aid.unit}")
    return sd


def _measured(method: AbstractMethod, log: Log, epochs: Epochs) -> Epochs:
    """The epochs of a log as measured: behind a prefilter the noise is not white, and cannot be estimated."""
    raw = method.front_end.unfiltered
    return epochs if raw is method.front_end else method.with_front_end(raw).epochs(log)


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
        aid_sd: standard deviation of the aid's white noise, in its unit: one number or one for each component (for a
            method that takes the vehicle as standing: of the force integrated over one interval, m/s); for several
            aids a sequence of them. By default what the log says, else an estimate from the log
            (:func:`estimate_aid_sd`). ``Solution.aid_sd`` says what was used.
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
        if method.aids != log.aids:
            there, wanted = (
                " and ".join(f"{aid.name} ({aid.described})" for aid in aids) for aids in (log.aids, method.aids)
            )
            raise UserError(f"these epochs have {there}, the method observes {wanted}: build it for what there is")
        if method.front_end.prefilter is not None and not log.filtered:
            raise UserError(
                "the method has a prefilter, but these epochs are not filtered: make them with method.epochs(log), or "
                "with epochs_from_arrays(..., prefilter=method.front_end.prefilter)"
            )
        epochs = log
    else:
        epochs = method.epochs(log)
        if aid_sd is None:
            aid_sd = _deviations(method, log, epochs)
    if aid_sd is not None:
        for one in aid_sd if isinstance(aid_sd, tuple | list) else (aid_sd,):
            if not isinstance(one, Tracer) and not np.all(np.asarray(one) > 0):
                raise UserError(f"aid_sd = {one}: the standard deviation of an aid's noise must be above 0")
        epochs = epochs.with_sd(aid_sd)
    return epochs


def _deviations(method: AbstractMethod, log: Log, epochs: Epochs) -> tuple[Any, ...]:
    """Of each aid the noise that the log states, or an estimate."""
    out = []
    for i, (_, seen) in enumerate(aids_for(log, method.aids)):
        stated = None if seen is None else seen.sd
        out.append(estimate_aid_sd(_measured(method, log, epochs), i) if stated is None else stated)
    return tuple(out)
