"""Fine alignment of a standing vehicle as a whole-record method: a coarse attitude, then the error-state filter."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.fine.error_filter import ErrorFilter, FilterRow
from jaxalign.fine.error_model import PSI
from jaxalign.inertial import InertialRecord
from jaxalign.observe.options import check_interval, optional_count
from jaxalign.prefilter import AbstractPrefilter
from jaxalign.prefilter.base import optional_prefilter
from jaxalign.record_method import AbstractRecordMethod, Found
from jaxalign.solution import FilterRecord
from jaxalign.two_vector import DualVector
from jaxalign.vector import Quat

__all__ = ["Fine"]


class Fine(AbstractRecordMethod):
    """Coarse attitude from the whole record, then the error-state filter over the record from its start.

    The coarse attitude is where the filter linearises, and no information: what it may be off by stands in the initial
    standard deviations (0.1 deg in tilt, 3 deg in heading). It is taken back to the start of the record by the gyros,
    so that the filter uses all of it. ``Solution.sd`` and ``Solution.filter`` hold what the filter believes.

    Attributes:
        coarse: any method for a standing vehicle.
        filter: the error-state filter.
        interval_samples: IMU samples per epoch (between updates); None: as the log has it.
        prefilter: of the specific force, in front of both.

    Source: the Vondrak paper, Fig. 1 and Fig. 6. Deviation: coarse by Hann-windowed vectors over the whole record, not
    TRIAD over its beginning.
    """

    coarse: Any = eqx.field(default_factory=DualVector)
    filter: ErrorFilter = eqx.field(default_factory=ErrorFilter)
    interval_samples: int | None = optional_count()
    prefilter: AbstractPrefilter | None = optional_prefilter()

    def __check_init__(self):
        check_interval(self.interval_samples)
        if getattr(self.coarse, "aid", None) != "static":
            raise UserError("coarse: must be a method for a standing vehicle, such as build('dual_vector')")
        own = getattr(self.coarse, "observe", self.coarse).interval_samples
        if own is not None or self.coarse.prefilter is not None:
            raise UserError("coarse: it takes the epochs of the fine alignment: set interval and prefilter there")

    def refine(self, epochs: Epochs, start: Quat) -> FilterRow:
        """The filter over epochs from a known attitude at epoch 0: rows with leaves of shape (M+1, ...). Pure."""

        def step(state: Any, row: Any) -> Any:
            return self.filter.step(state, row)

        return jax.lax.scan(step, self.filter.init(epochs.site, start), epochs.rows)[1]

    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> Found:
        """Coarse attitude, taken back to epoch 0, and the filter from there."""
        last = len(epochs) - 1
        coarse = self.coarse.solve(epochs, last)
        end = record.at(last)
        known = coarse.defined[-1]
        start = (end.q_n0n * Quat.of(coarse.q_nb[-1]) * end.q_b0b.conjugate()).unit()
        row = jax.tree.map(lambda x: x[rows], self.refine(epochs, start))
        before = record.at(np.maximum(rows - 1, 0))
        at = record.at(rows)
        alpha, beta = at.alpha - before.alpha, at.beta - before.beta
        q_n0b0 = at.q_n0n * row.q_nb * at.q_b0b.conjugate()
        variances = jnp.diagonal(row.covariance, axis1=1, axis2=2)[:, PSI]
        told = FilterRecord(
            row.gyro_bias.array,
            row.accel_bias.array,
            row.covariance,
            row.innovation,
            row.innovation_covariance,
            row.updated.astype(jnp.float64),
        )
        positive = variances > 0
        sd = jnp.where(positive, jnp.sqrt(jnp.where(positive, variances, 1.0)), 0.0)
        defined = known & (jnp.asarray(rows) > 0)
        return Found(row.q_nb, defined, alpha, beta, alpha - q_n0b0.rotate(beta), sd, told)
