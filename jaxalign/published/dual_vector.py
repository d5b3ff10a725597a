"""Two vectors for TRIAD as the papers compare them: single increments, halves of the record, fits."""

from __future__ import annotations

from typing import Any, Literal

import equinox as eqx
import jax
import numpy as np

from jaxalign.arguments import check_choice
from jaxalign.front_end import FrontEnd
from jaxalign.inertial import InertialRecord
from jaxalign.reconstruct import Rls
from jaxalign.two_vector import AbstractDualVector, TwoVectors, difference

__all__ = ["ComparisonDualVector"]


class ComparisonDualVector(AbstractDualVector):
    """Gravity in inertial space at two times by the comparison methods of 002.

    Attributes:
        vectors: "halves" (default): velocities V(t/2), V(t); "ends": force in the first and the last interval; "rls":
            the same two, each from a fit of the whole record by recursive least squares.
        front_end: makes epochs of a log.

    Source: 002 [8-12].
    """

    vectors: Literal["halves", "ends", "rls"] = eqx.field(static=True, default="halves")
    front_end: FrontEnd = eqx.field(default_factory=FrontEnd, kw_only=True)

    def __check_init__(self):
        check_choice("vectors", self.vectors, ("halves", "ends", "rls"))

    def two_vectors(self, record: InertialRecord, rows: np.ndarray) -> TwoVectors:
        """Older and newer (alpha, beta) of each read-out, m/s."""
        first, zero = np.minimum(1, rows), np.zeros_like(rows)
        if self.vectors == "ends":
            return difference(record, first, zero), difference(record, rows, rows - first)
        if self.vectors == "halves":
            return difference(record, rows // 2, zero), difference(record, rows, zero)
        return _fitted(record, rows)


def _fitted(record: InertialRecord, rows: np.ndarray) -> TwoVectors:
    """Increments of velocity in the first interval and in that of each read-out, beta as fitted up to the read-out."""
    rls = Rls()
    every = np.arange(1, len(record.time))
    now, before = record.at(every), record.at(every - 1)
    steps, middle = now.beta - before.beta, 0.5 * (now.time + before.time)

    def fit(state: Any, step: Any) -> Any:
        state = rls.update(state, *step)
        return state, (rls.at(state, middle[0]), rls.at(state, step[0]))

    _, fits = jax.lax.scan(fit, rls.init(), (middle, steps))
    first, last = jax.tree.map(lambda x: x[np.maximum(rows - 1, 0)], fits)
    one, many = np.minimum(1, rows), np.minimum(np.maximum(rows - 1, 0), rows)
    return (difference(record, one, 0 * rows)[0], first), (difference(record, rows, many)[0], last)
