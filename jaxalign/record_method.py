"""What whole-record methods share: a standing vehicle, rows of the solution, flags."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs, row_numbers, strided_rows
from jaxalign.inertial import InertialRecord
from jaxalign.method import AbstractMethod
from jaxalign.prefilter.base import without_prefilter
from jaxalign.solution import FilterRecord, Solution, status_bits
from jaxalign.vector import Quat, Vec3, where

__all__ = ["AbstractRecordMethod", "Found"]


class Found(eqx.Module):
    """What a method finds at the read-out epochs.

    Attributes:
        q_nb: attitude.
        defined: whether there is one.
        alpha: a vector in n0, m/s.
        beta: the same in b0.
        residual: alpha - C_n0b0 beta, m/s.
        covariance: of the attitude error in n, rad^2, where known.
        filter: what a filter tells beside the attitude.
    """

    q_nb: Quat
    defined: Bool[Array, " K"]
    alpha: Vec3
    beta: Vec3
    residual: Vec3
    covariance: Float[Array, "K 3 3"] | None = None
    filter: FilterRecord | None = None


class AbstractRecordMethod(AbstractMethod):
    """A method for a standing vehicle that needs the record up to an epoch, or all of it, for the attitude there."""

    aid: ClassVar[str] = "static"

    @abstractmethod
    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> Found:
        """Attitudes at the epochs ``rows`` (host integers)."""

    def solve(self, epochs: Epochs, rows: Any = 1, done: Callable[[int], None] | None = None) -> Solution:
        """Align epochs (see :meth:`AbstractMethod.solve`)."""
        return _jitted(without_prefilter(self), epochs, *strided_rows(len(epochs), rows))


@Program
def _jitted(method: AbstractRecordMethod, epochs: Epochs, every: int, places: tuple[int, ...] | None) -> Solution:
    rows = row_numbers(len(epochs), every)
    rows = rows if places is None else rows[np.array(places)]
    whole = InertialRecord.of(epochs)
    found, time = method.find(epochs, whole, rows), whole.time[rows]
    told = jax.tree.leaves((found.q_nb, found.residual, found.covariance, found.filter))
    finite = jnp.all(jnp.stack([jnp.isfinite(x).reshape(len(rows), -1).all(axis=1) for x in told]), axis=0)
    defined = found.defined & finite
    observable = whole.observable(epochs.aid_sd)[rows] & defined
    aided = epochs.rows.valid[rows]
    bits = status_bits(defined=defined, observable=observable, aided=aided, finite=finite)
    one = jnp.ones_like(time)
    identity = jax.tree.map(lambda x: x * one, Quat.identity())

    def masked(x: Any) -> Any:
        return jnp.where(defined.reshape(-1, *[1] * (x.ndim - 1)), x, 0.0)

    return Solution(
        time=time,
        q_nb=where(defined, found.q_nb.unit().positive(), identity).array,
        defined=defined,
        observable=observable,
        eigengap=0.0 * one,
        residual=masked(found.residual.array),
        weight=aided * one,
        alpha=found.alpha.array,
        beta=found.beta.array,
        covariance=None if found.covariance is None else masked(found.covariance),
        status=bits,
        aid_sd=epochs.aid_sd * one,
        filter=jax.tree.map(masked, found.filter),
    )
