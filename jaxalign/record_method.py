"""What whole-record methods share: a standing vehicle, rows of the solution, flags."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxalign.aligner import align
from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs, epochs_from_log, over_runs
from jaxalign.inertial import InertialRecord
from jaxalign.log import Log
from jaxalign.prefilter import AbstractPrefilter
from jaxalign.prefilter.base import without_prefilter
from jaxalign.solution import FilterRecord, Solution, Status
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


class AbstractRecordMethod(eqx.Module):
    """A static-base method that needs the record: its attitude at an epoch comes from the record up to there, or all.

    Attributes:
        interval_samples: IMU samples per epoch; None: as the log has it.
        prefilter: low-pass filter of the specific force; None: no filter.
    """

    interval_samples: eqx.AbstractVar[int | None]
    prefilter: eqx.AbstractVar[AbstractPrefilter | None]
    aid: ClassVar[str] = "static"
    has_covariance: ClassVar[bool] = False
    """Whether its solutions come with a covariance."""
    dear_rows: ClassVar[bool] = False
    """Whether each row goes over all epochs before it."""

    @abstractmethod
    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> Found:
        """Attitudes at the epochs ``rows`` (host integers)."""

    def epochs(self, log: Log) -> Epochs:
        """Filter and preintegrate a log for this method, taking the vehicle as standing."""
        return epochs_from_log(log, interval_samples=self.interval_samples, static=True, prefilter=self.prefilter)

    def solve(self, epochs: Epochs, every: int = 1) -> Solution:
        """Align epochs; rows as :func:`jaxalign.align` has them."""
        return _jitted(without_prefilter(self), epochs, every)

    def solve_runs(self, epochs: Epochs, every: int = 1) -> Solution:
        """Align many runs, see :func:`jaxalign.epochs.over_runs`."""
        return over_runs(lambda one: self.solve(one, every), epochs)

    def align(self, log: Log | Epochs, every: int = 1) -> Solution:
        """See :func:`jaxalign.align`."""
        return align(self, log, every)


@Program
def _jitted(method: AbstractRecordMethod, epochs: Epochs, every: int) -> Solution:
    count = len(epochs)
    rows = np.unique([*range(0, count, every), count - 1])
    whole = InertialRecord.of(epochs)
    found, time = method.find(epochs, whole, rows), whole.time[rows]
    numbers = jax.tree.leaves((found.q_nb, found.residual, found.covariance, found.filter))
    finite = jnp.all(jnp.stack([jnp.isfinite(x).reshape(len(rows), -1).all(axis=1) for x in numbers]), axis=0)
    defined = found.defined & finite
    observable = whole.observable(epochs.aid_sd)[rows] & defined
    bits = jnp.where(defined, 0, int(Status.UNDEFINED))
    bits = bits + jnp.where(observable, 0, int(Status.HEADING_UNOBSERVABLE))
    bits = bits + jnp.where(finite, 0, int(Status.NON_FINITE))
    aided = epochs.rows.valid[rows]
    bits = bits + jnp.where(aided, 0, int(Status.AID_MISSING))
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
        status=bits.astype(jnp.int32),
        aid_sd=epochs.aid_sd * one,
        filter=jax.tree.map(masked, found.filter),
    )
