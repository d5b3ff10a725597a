"""Attitude from two directions: TRIAD on mean vectors, and on gravity seen in inertial space at two times.

Whole-record methods: they need the record up to an epoch for the attitude at that epoch, and do not step online.
"""

# No annotations from the future: equinox looks for abstract attributes among them, and finds none in text.
from abc import abstractmethod
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxalign.arguments import check_choice
from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.estimate.triad import triad
from jaxalign.front_end import FrontEnd
from jaxalign.inertial import InertialRecord
from jaxalign.vector import Vec3
from jaxalign.whole_record import AbstractWholeRecordMethod, RecordReadout

__all__ = ["AbstractDualVector", "DualVector", "MeanTriad", "TwoVectors", "difference"]

TwoVectors = tuple[tuple[Vec3, Vec3], tuple[Vec3, Vec3]]
"""Older and newer (alpha, beta) of each read-out, m/s."""


class MeanTriad(AbstractWholeRecordMethod):
    """Analytic coarse alignment: the mean specific force is up, the mean rotation is that of the Earth.

    The base must not turn: over 231 s of a real vehicle the mean rate wanders by 2 deg/h, and the heading by 8 deg.

    Attributes:
        front_end: makes epochs of a log. Vondrak's filter changes nothing here: it preserves means.

    Source: 003 (1)-(5). Deviations: specific force (up), not gravity; TRIAD with the force primary instead of
    the printed matrix, whose orthonormalisation puts half of the up gyro's bias over the Earth rate into the level.
    """

    front_end: FrontEnd = eqx.field(default_factory=FrontEnd, kw_only=True)

    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> RecordReadout:
        """Up is f, east is w x f, north is up x east."""
        r = record.at(rows)
        zero, g_time = 0.0 * r.time, r.alpha.norm()
        up, east = Vec3(zero, zero, g_time), Vec3(1.0 + zero, zero, zero)
        q, defined = triad(up, r.force, east, r.turned.cross(r.force))
        return RecordReadout(q, defined, up, r.force, up - q.rotate(r.force))


def difference(record: InertialRecord, stop: Any, start: Any) -> tuple[Vec3, Vec3]:
    """(alpha, beta) gained between some epochs, m/s."""
    a, b = record.at(stop), record.at(start)
    return a.alpha - b.alpha, a.beta - b.beta


class AbstractDualVector(AbstractWholeRecordMethod):
    """Gravity in inertial space at two times, seen by the accelerometers in b0: TRIAD, the newest vector exact.

    A subclass says which vectors.
    """

    front_end: eqx.AbstractVar[FrontEnd]

    @abstractmethod
    def two_vectors(self, record: InertialRecord, rows: np.ndarray) -> TwoVectors:
        """Older and newer (alpha, beta) of each read-out, m/s."""

    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> RecordReadout:
        """Two vectors per read-out, then TRIAD in inertial space."""
        at = record.at(rows)
        (alpha1, beta1), (alpha2, beta2) = self.two_vectors(record, rows)
        q_n0b0, defined = triad(alpha2, beta2, alpha1, beta1)
        q_nb = at.q_n0n.conjugate() * q_n0b0 * at.q_b0b
        return RecordReadout(q_nb, defined, alpha2, beta2, alpha2 - q_n0b0.rotate(beta2))


class DualVector(AbstractDualVector):
    """Gravity averaged over the first and over the last part of the record.

    Attributes:
        vectors: "hann" (default): force averaged with Hann windows, which on a disturbed base beats every prefilter
            with a boxcar; "boxcar": plain means (003's inertial-frame method).
        fraction: length of a part, as a fraction of the record.
        front_end: makes epochs of a log. On a vibrating vehicle epochs of one sample, or a prefilter: at 0.1 s
            vibration leaks through the steps of the window (0.14 instead of 0.11 deg on a real log of 60 s). A filter
            is for the boxcar; in front of Hann windows on samples it changes nothing.

    With windows every read-out sums its own parts: K read-outs of M epochs cost K M operations; on long logs at short
    intervals read out sparsely.

    Source: 003's inertial-frame coarse alignment; Hann windows ours. 002's comparison methods are
    :class:`jaxalign.published.ComparisonDualVector`.
    """

    vectors: Literal["hann", "boxcar"] = eqx.field(static=True, default="hann")
    fraction: float = eqx.field(static=True, default=1 / 3)
    front_end: FrontEnd = eqx.field(default_factory=FrontEnd, kw_only=True)

    def __check_init__(self):
        check_choice("vectors", self.vectors, ("hann", "boxcar"))
        if not 0 < self.fraction <= 0.5:
            raise UserError(f"fraction = {self.fraction}: must be above 0 and at most 0.5 of the record")

    def two_vectors(self, record: InertialRecord, rows: np.ndarray) -> TwoVectors:
        """Windowed sums of the increments."""
        length = np.maximum((rows * self.fraction + 1e-9).astype(int), np.minimum(1, rows))
        if self.vectors == "boxcar":
            return difference(record, length, np.zeros_like(rows)), difference(record, rows, rows - length)
        every = np.arange(1, len(record.time))
        alpha, beta = difference(record, every, every - 1)

        def windowed(start: Any, n: Any) -> tuple[Vec3, Vec3]:
            """Hann-weighted sum of the n increments from number ``start`` on."""
            j = jnp.arange(len(every)) - start
            w = 0.5 - 0.5 * jnp.cos(2 * jnp.pi * j / jnp.maximum(n - 1, 1))
            w = jnp.where((j >= 0) & (j < n), jnp.where(n < 3, 1.0, w), 0.0)
            return jax.tree.map(lambda x: jnp.sum(w * x), (alpha, beta))

        def both(row_and_length: Any) -> Any:
            row, n = row_and_length
            return windowed(0, n), windowed(row - n, n)

        return jax.lax.map(both, (jnp.asarray(rows), jnp.asarray(length)))
