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

from jaxalign.aids import AbstractAid, Standing
from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs, row_numbers, strided_rows
from jaxalign.inertial import InertialRecord
from jaxalign.method import AbstractMethod
from jaxalign.nav_estimate import Block
from jaxalign.solution import FilterRecord, Solution, assembled
from jaxalign.vector import Quat, Vec3

__all__ = ["AbstractWholeRecordMethod", "RecordReadout"]


class RecordReadout(eqx.Module):
    """What a method finds at the read-out epochs.

    Attributes:
        q_nb: attitude.
        defined: whether there is one.
        alpha: a vector in n0, m/s.
        beta: the same in b0.
        residual: alpha - C_n0b0 beta, m/s.
        covariance: of the attitude error in n, rad^2, where known.
        filter: what a filter tells beside the attitude.
        nav: velocity, position, unknowns and covariance of a :class:`jaxalign.NavEstimate`, by name.
        blocks: of that covariance (static).
    """

    q_nb: Quat
    defined: Bool[Array, " K"]
    alpha: Vec3
    beta: Vec3
    residual: Vec3
    covariance: Float[Array, "K 3 3"] | None = None
    filter: FilterRecord | None = None
    nav: dict[str, Any] | None = None
    blocks: tuple[Block, ...] = eqx.field(static=True, default=())


class AbstractWholeRecordMethod(AbstractMethod):
    """A method for a standing vehicle that needs the record up to an epoch, or all of it, for the attitude there."""

    aids: ClassVar[tuple[AbstractAid, ...]] = (Standing(),)

    @abstractmethod
    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> RecordReadout:
        """Attitudes at the epochs ``rows`` (host integers)."""

    def solve(self, epochs: Epochs, rows: Any = 1, done: Callable[[int], None] | None = None) -> Solution:
        """Align epochs (see :meth:`AbstractMethod.solve`)."""
        return _jitted(self.bare, epochs, *strided_rows(len(epochs), rows))


@Program
def _jitted(method: AbstractWholeRecordMethod, epochs: Epochs, every: int, places: tuple[int, ...] | None) -> Solution:
    rows = row_numbers(len(epochs), every)
    rows = rows if places is None else rows[np.array(places)]
    whole = InertialRecord.of(epochs)
    found, time = method.find(epochs, whole, rows), whole.time[rows]
    told = jax.tree.leaves((found.q_nb, found.residual, found.covariance, found.filter))
    finite = jnp.all(jnp.stack([jnp.isfinite(x).reshape(len(rows), -1).all(axis=1) for x in told]), axis=0)
    aided, one = epochs.rows.valid[rows], jnp.ones_like(time)
    residual, weight, sd = found.residual.array, aided * one, epochs.aid_sd * one
    return assembled(
        time=time,
        q_nb=found.q_nb.unit().array,
        defined=found.defined,
        observable=whole.observable(epochs.aid_sd)[rows],
        finite=finite,
        aided=aided,
        residual=residual,
        weight=weight,
        alpha=found.alpha.array,
        beta=found.beta.array,
        covariance=found.covariance,
        aid_sd=sd,
        filter=None if found.filter is None else dict(vars(found.filter)),
        nav=found.nav,
        blocks=found.blocks,
        aids={epochs.aids[0].name: (residual, weight, sd, aided)},
    )
