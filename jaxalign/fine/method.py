"""Fine alignment of a standing vehicle as a whole-record method: a coarse attitude, then the error-state filter."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.epochs import Epochs, strided_rows
from jaxalign.errors import UserError
from jaxalign.fine.error_filter import ErrorFilter, FilterRow
from jaxalign.fine.error_model import ACCEL, GYRO, POSITION, PSI, VELOCITY
from jaxalign.front_end import FrontEnd
from jaxalign.inertial import InertialRecord
from jaxalign.inertial_unit import ImuErrors
from jaxalign.method import AbstractMethod
from jaxalign.nav_estimate import blocks_of
from jaxalign.parametrization import tunable
from jaxalign.solution import FilterRecord
from jaxalign.two_vector import DualVector
from jaxalign.vector import Quat
from jaxalign.whole_record import AbstractWholeRecordMethod, RecordReadout

__all__ = ["Fine"]


_WORST = 1.0  # rad


_ORDER = np.r_[PSI, VELOCITY, GYRO, ACCEL, POSITION]
_SIGN = np.repeat([1.0, 1.0, -1.0, -1.0, 1.0], 3)  # errors of the biases are truth less estimate
_BLOCKS = blocks_of(attitude=3, velocity=3, gyro_bias=3, accel_bias=3, position=3)


def _handed(row: FilterRow) -> dict[str, Any]:
    """State and covariance as :class:`jaxalign.NavEstimate` has them."""
    covariance = row.covariance[:, _ORDER[:, None], _ORDER] * (_SIGN[:, None] * _SIGN)
    nav = row.nav
    return {
        "velocity": nav.velocity.array,
        "position": jnp.stack([nav.lat, nav.lon, nav.h], axis=-1),
        "unknowns": jnp.zeros((len(covariance), 0)),
        "covariance": covariance,
    }


class Fine(AbstractWholeRecordMethod):
    """Coarse attitude from the whole record, then the error-state filter over the record from its start.

    The coarse attitude is where the filter linearises, and no information: to the initial heading variance is added
    what the turning of gravity over the record and the noise of the force (``Epochs.aid_sd``) leave open, some times
    over (two windows are not all the data, and they are used twice), so that on a short record the heading has the
    standard deviation that it deserves. The attitude is taken back to the start of the record by the gyros, so that the
    filter uses all of it. ``Solution.covariance`` and ``Solution.filter`` hold what the filter believes.

    Attributes:
        coarse: any method for a standing vehicle.
        filter: the error-state filter.
        heading_margin: times what the directions allow is added to the initial heading standard deviation; 0: nothing.
        front_end: makes epochs of a log, for both; each ends with an update.

    Source: the Vondrak paper, Fig. 1 and Fig. 6. Deviation: coarse by Hann-windowed vectors over the whole record, not
    TRIAD over its beginning.
    """

    has_covariance: ClassVar[bool] = True
    coarse: AbstractMethod = eqx.field(default_factory=DualVector, metadata={"hides": ("front_end",)})
    filter: ErrorFilter = eqx.field(default_factory=ErrorFilter)
    heading_margin: Float[Array, ""] = tunable(3.0, unit="1", bounds=(0.0, 10.0))
    front_end: FrontEnd = eqx.field(default_factory=FrontEnd, kw_only=True)

    def __check_init__(self):
        if not isinstance(self.coarse, AbstractMethod) or not self.coarse.standing:
            raise UserError("coarse: must be a method for a standing vehicle, such as build('dual_vector')")
        if self.coarse.front_end != FrontEnd():
            raise UserError("coarse: it takes the epochs of the fine alignment: set the front end there")

    def with_imu(self, imu: ImuErrors) -> Self:
        """With these errors of the inertial unit in its filter.

        The standard deviation of the initial heading stays. A gyroscope bias turns the coarse heading by the bias over
        the horizontal Earth rate (5 deg for 1 deg/h at 35 deg of latitude), which the filter does not know of: for
        biases of 1 deg/h or more set ``filter.initial_heading_sd_deg`` too, or take ``robust_map``.
        """
        return dataclasses.replace(self, filter=dataclasses.replace(self.filter, imu=imu))

    def refine(self, epochs: Epochs, start: Quat, heading_sd: Any = 0.0, every: int = 1) -> FilterRow:
        """The filter over epochs from a known attitude at epoch 0. Pure.

        Args:
            epochs: of a standing vehicle.
            start: attitude at epoch 0.
            heading_sd: see :meth:`ErrorFilter.init`.
            every: epochs between rows: at 0, every ``every``-th and the last; memory goes with the rows.

        Returns:
            Rows, leaves with a first axis.
        """
        step = self.filter.step
        first, rows = (jax.tree.map(lambda x, i=i: x[i], epochs.rows) for i in (0, slice(1, None)))
        state, row = step(self.filter.init(epochs.site, start, heading_sd), first)

        def block(state: Any, some: Any) -> Any:
            before, last = jax.tree.map(lambda x: x[:-1], some), jax.tree.map(lambda x: x[-1], some)
            state, _ = jax.lax.scan(lambda s, e: (step(s, e)[0], None), state, before)
            return step(state, last)

        blocks, rest = divmod(len(epochs) - 1, every)
        parts = [jax.tree.map(lambda x: x[None], row)]
        if blocks:
            whole = jax.tree.map(lambda x: x[: blocks * every].reshape(blocks, every), rows)
            state, found = jax.lax.scan(block, state, whole)
            parts.append(found)
        if rest:
            _, found = block(state, jax.tree.map(lambda x: x[-rest:], rows))
            parts.append(jax.tree.map(lambda x: x[None], found))
        return jax.tree.map(lambda *x: jnp.concatenate(x), *parts)

    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> RecordReadout:
        """Coarse attitude, taken back to epoch 0, and the filter from there."""
        last = len(epochs) - 1
        coarse = self.coarse.solve(epochs, last)
        end = record.at(last)
        known = coarse.defined[-1]
        start = (end.q_n0n * Quat.of(coarse.q_nb[-1]) * end.q_b0b.conjugate()).unit()
        heading_sd = jnp.minimum(self.heading_margin * record.heading_sd(epochs.aid_sd), _WORST)
        stride, places = strided_rows(len(epochs), rows)
        row = self.refine(epochs, start, heading_sd, stride)
        if places is not None:
            row = jax.tree.map(lambda x: x[np.array(places)], row)
        before = record.at(np.maximum(rows - 1, 0))
        at = record.at(rows)
        alpha, beta = at.alpha - before.alpha, at.beta - before.beta
        q_n0b0 = at.q_n0n * row.q_nb * at.q_b0b.conjugate()
        told = FilterRecord(
            row.gyro_bias.array,
            row.accel_bias.array,
            row.covariance,
            row.innovation,
            row.innovation_covariance,
            row.updated.astype(jnp.float64),
        )
        defined = known & (jnp.asarray(rows) > 0)
        residual = alpha - q_n0b0.rotate(beta)
        return RecordReadout(
            row.q_nb, defined, alpha, beta, residual, row.covariance[:, PSI, PSI], told, _handed(row), _BLOCKS
        )
