"""Attitude from two directions: TRIAD on mean vectors, and on gravity seen in inertial space at two times.

Whole-record methods: they need the record up to an epoch for the attitude at that epoch, and do not step online.
"""

from __future__ import annotations

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.estimate.triad import triad
from jaxalign.inertial import InertialRecord
from jaxalign.observe.options import check_choice, check_interval, optional_count
from jaxalign.prefilter import AbstractPrefilter
from jaxalign.prefilter.base import optional_prefilter
from jaxalign.reconstruct import Rls
from jaxalign.record_method import AbstractRecordMethod, Found
from jaxalign.vector import Vec3

__all__ = ["DualVector", "MeanTriad"]


class MeanTriad(AbstractRecordMethod):
    """Analytic coarse alignment: the mean specific force is up, the mean rotation is that of the Earth.

    The base must not turn: over 231 s of a real vehicle the mean rate wanders by 2 deg/h, and the heading by 8 deg.

    Attributes:
        interval_samples: IMU samples per epoch; None: as the log has it.
        prefilter: of the specific force. Vondrak's changes nothing here: it preserves means.

    Source: 003 (1)-(5). Deviations: specific force (up), not gravity; TRIAD with the force primary instead of
    the printed matrix, whose orthonormalisation puts half of the up gyro's bias over the Earth rate into the level.
    """

    interval_samples: int | None = optional_count()
    prefilter: AbstractPrefilter | None = optional_prefilter()

    def __check_init__(self):
        check_interval(self.interval_samples, "interval_samples")

    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> Found:
        """Up is f, east is w x f, north is up x east."""
        r = record.at(rows)
        zero, g_time = 0.0 * r.time, r.alpha.norm()
        up, east = Vec3(zero, zero, g_time), Vec3(1.0 + zero, zero, zero)
        q, defined = triad(up, r.force, east, r.turned.cross(r.force))
        return Found(q, defined, up, r.force, up - q.rotate(r.force))


class DualVector(AbstractRecordMethod):
    """Gravity in inertial space at two times, seen by the accelerometers in b0: TRIAD, the newest vector exact.

    Attributes:
        vectors: "hann" (default): force averaged with Hann windows over the first and the last part of the record,
            which on a disturbed base beats every prefilter with a boxcar; "boxcar": plain means over the same parts
            (003's inertial-frame method); "halves": velocities V(t/2), V(t) (002); "ends": force in the first and the
            last interval (002); "rls": the same two, each from a fit of the whole record by recursive least squares.
        fraction: length of a part, as a fraction of the record.
        interval_samples: IMU samples per epoch; None: as the log has it. On a vibrating vehicle 1, or a prefilter: at
            0.1 s vibration leaks through the steps of the window (0.14 instead of 0.11 deg on a real log of 60 s).
        prefilter: of the specific force, for the boxcar; in front of Hann windows on samples it changes nothing.

    With windows every read-out sums its own parts: K read-outs of M epochs cost K M operations; on long logs at short
    intervals read out sparsely.

    Source: 002's comparison methods [8-12], 003's inertial-frame coarse alignment; windows ours.
    """

    vectors: Literal["hann", "boxcar", "halves", "ends", "rls"] = eqx.field(static=True, default="hann")
    fraction: float = eqx.field(static=True, default=1 / 3)
    interval_samples: int | None = optional_count()
    prefilter: AbstractPrefilter | None = optional_prefilter()

    def __check_init__(self):
        check_choice("vectors", self.vectors, ("hann", "boxcar", "halves", "ends", "rls"))
        check_interval(self.interval_samples, "interval_samples")
        if not 0 < self.fraction <= 0.5:
            raise UserError(f"fraction = {self.fraction}: must be above 0 and at most 0.5 of the record")

    def find(self, epochs: Epochs, record: InertialRecord, rows: np.ndarray) -> Found:
        """Two vectors per read-out, then TRIAD in inertial space."""
        at = record.at(rows)
        (alpha1, beta1), (alpha2, beta2) = self._vectors(record, rows)
        q_n0b0, defined = triad(alpha2, beta2, alpha1, beta1)
        q_nb = at.q_n0n.conjugate() * q_n0b0 * at.q_b0b
        return Found(q_nb, defined, alpha2, beta2, alpha2 - q_n0b0.rotate(beta2))

    def _vectors(self, record: InertialRecord, rows: np.ndarray) -> tuple[tuple[Vec3, Vec3], tuple[Vec3, Vec3]]:
        """Older and newer (alpha, beta) of each read-out, m/s."""

        def difference(stop: Any, start: Any) -> tuple[Vec3, Vec3]:
            a, b = record.at(stop), record.at(start)
            return a.alpha - b.alpha, a.beta - b.beta

        first, zero = np.minimum(1, rows), np.zeros_like(rows)
        length = np.maximum((rows * self.fraction + 1e-9).astype(int), first)
        if self.vectors == "ends":
            return difference(first, zero), difference(rows, rows - first)
        if self.vectors == "halves":
            return difference(rows // 2, zero), difference(rows, zero)
        if self.vectors == "rls":
            return _fitted(record, rows)
        if self.vectors == "boxcar":
            return difference(length, zero), difference(rows, rows - length)
        every = np.arange(1, len(record.time))
        alpha, beta = difference(every, every - 1)

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


def _fitted(record: InertialRecord, rows: np.ndarray) -> tuple[tuple[Vec3, Vec3], tuple[Vec3, Vec3]]:
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

    def gravity(stop: Any, start: Any) -> Vec3:
        return record.at(stop).alpha - record.at(start).alpha

    return (gravity(one, 0 * rows), first), (gravity(rows, many), last)
