"""Errors against a reference attitude."""

from __future__ import annotations

import numpy as np

from jaxalign.host import attitude_error, quat_from_dcm
from jaxalign.log import Log
from jaxalign.solution import Solution

__all__ = ["attitude_error_deg", "component_rms", "reference_at"]


def reference_at(log: Log, time: np.ndarray) -> np.ndarray | None:
    """The reference C_nb of the log at read-out times (s since epoch 0).

    Args:
        log: with or without a reference.
        time: (K,) read-out times.

    Returns:
        (K, 3, 3), NaN at times that are no epochs of the log; None where the log has no reference.
    """
    if log.C_nb is None:
        return None
    index = np.asarray(time) / (log.epoch_samples * log.dt)
    nearest = np.clip(np.round(index).astype(int), 0, log.epochs)
    out = log.C_nb[nearest].copy()
    out[np.abs(index - nearest) > 1e-6 * np.maximum(nearest, 1)] = np.nan
    return out


def attitude_error_deg(solution: Solution, log: Log) -> np.ndarray | None:
    """Phi (K, 3) in degrees, east, north, up, with ``C_est = (I - [phi x]) C_true``; None without a reference.

    To first order the up component is the error of the heading (clockwise): the yaw error with its sign turned.
    """
    reference = reference_at(log, np.asarray(solution.time))
    if reference is None:
        return None
    known = np.isfinite(reference).all(axis=(1, 2)) & np.asarray(solution.defined)
    safe = np.where(known[:, None, None], reference, np.eye(3))
    phi = np.rad2deg(attitude_error(np.asarray(solution.q_nb), quat_from_dcm(safe)))
    phi[~known] = np.nan
    return phi


def component_rms(residual: np.ndarray) -> np.ndarray:
    """Root mean square of each fix's residuals over the components that it has.

    Args:
        residual: (K, m), exactly zero for a component that is missing.

    Returns:
        (K,); zero where all are missing.
    """
    there = np.maximum(np.sum(residual != 0, axis=1), 1)
    return np.linalg.norm(residual, axis=1) / np.sqrt(there)
