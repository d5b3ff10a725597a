"""Attitude from two directions: TRIAD on mean vectors, and on gravity seen in inertial space at two times.

Whole-record methods: they need the record up to an epoch for the attitude at that epoch, and do not step online.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxalign.aligner import align
from jaxalign.earth import earth_rate
from jaxalign.epochs import Epochs, epochs_from_log
from jaxalign.errors import UserError
from jaxalign.estimate.triad import triad
from jaxalign.log import Log
from jaxalign.observe.options import check_choice, check_interval, optional_count
from jaxalign.reconstruct import Rls
from jaxalign.solution import Solution, Status
from jaxalign.spread import Spread
from jaxalign.vector import Quat, Vec3, mean_rotated, where

__all__ = ["AbstractRecordMethod", "DualVector", "MeanTriad"]


class _Record(eqx.Module):
    """Everything per epoch that the methods below choose from; leaves of shape (M+1,)."""

    time: Float[Array, " epochs"]
    q_b0b: Quat
    q_n0n: Quat
    alpha: Vec3  # -int C_n0n g dt, m/s
    beta: Vec3  # int C_b0b f dt, m/s
    turned: Vec3  # sum of the rotation vectors of the intervals, in b, rad
    force: Vec3  # sum of the velocity increments, in b, m/s

    @classmethod
    def of(cls, epochs: Epochs) -> _Record:
        rows, site = epochs.rows, epochs.site

        def attitude(q, rotation):
            q = (q * rotation).renormalised()
            return q, q

        def running(v: Vec3) -> Vec3:
            return jax.tree.map(jnp.cumsum, v)

        q_b0b = jax.lax.scan(attitude, Quat.identity(), rows.rotation)[1]
        before = jax.tree.map(lambda one, q: jnp.concatenate([one[None], q[:-1]]), Quat.identity(), q_b0b)
        time = jnp.cumsum(rows.dt)
        angle = earth_rate(site.lat) * time
        up = mean_rotated(angle, Vec3(0.0 * time, 0.0 * time, site.gravity * time))
        beta = running(before.rotate(rows.dvel))
        turned = rows.rotation.log()
        # An interval's dvel stands in b at its start; half the rotation back makes it the mean over the interval.
        force = Quat.exp(turned * -0.5).rotate(rows.dvel)
        return cls(time, q_b0b, Quat.exp(angle), up, beta, running(turned), running(force))

    def at(self, index: Any) -> _Record:
        """Some epochs of it."""
        return jax.tree.map(lambda x: x[index], self)


class _Found(eqx.Module):
    """What a method finds at the read-out epochs."""

    q_nb: Quat
    defined: Bool[Array, " K"]
    alpha: Vec3
    beta: Vec3
    residual: Vec3


class AbstractRecordMethod(eqx.Module):
    """A static-base method that needs the record up to an epoch for the attitude at that epoch."""

    interval_samples: eqx.AbstractVar[int | None]
    aid: ClassVar[str] = "static"

    @abstractmethod
    def find(self, record: _Record, rows: np.ndarray) -> _Found:
        """Attitudes at the epochs ``rows`` (host integers)."""

    def epochs(self, log: Log) -> Epochs:
        """Preintegrate a log for this method, taking the vehicle as standing."""
        return epochs_from_log(log, interval_samples=self.interval_samples, static=True)

    def solve(self, epochs: Epochs, every: int = 1) -> Solution:
        """Align epochs; rows as :func:`jaxalign.align` has them."""
        return _jitted(self, epochs, every)

    def align(self, log: Log | Epochs, every: int = 1) -> Solution:
        """See :func:`jaxalign.align`."""
        return align(self, log, every)


@eqx.filter_jit
def _jitted(method: AbstractRecordMethod, epochs: Epochs, every: int) -> Solution:
    count = len(epochs)
    rows = np.unique([*range(0, count, every), count - 1])
    whole = _Record.of(epochs)
    found, record = method.find(whole, rows), whole.at(rows)
    defined = found.defined
    steps = jax.tree.map(lambda x: jnp.diff(x, prepend=x[:1]), whole.alpha)
    spread = Spread.of(steps, np.arange(count) > 0).cumulated()
    observable = jax.tree.map(lambda x: x[rows], spread).observable(epochs.aid_sd, steps=True) & defined
    bits = jnp.where(defined, 0, int(Status.UNDEFINED))
    bits = bits + jnp.where(observable, 0, int(Status.HEADING_UNOBSERVABLE))
    one = jnp.ones_like(record.time)
    identity = jax.tree.map(lambda x: x * one, Quat.identity())
    return Solution(
        time=record.time,
        q_nb=where(defined, found.q_nb.unit().positive(), identity).array,
        defined=defined,
        observable=observable,
        eigengap=0.0 * one,
        residual=where(defined, found.residual, found.residual * 0.0).array,
        weight=one,
        alpha=found.alpha.array,
        beta=found.beta.array,
        sd=None,
        status=bits.astype(jnp.int32),
        aid_sd=epochs.aid_sd * one,
    )


class MeanTriad(AbstractRecordMethod):
    """Analytic coarse alignment: the mean specific force is up, the mean rotation is that of the Earth.

    The base must not turn: over 231 s of a real vehicle the mean rate wanders by 2 deg/h, and the heading by 8 deg.

    Attributes:
        interval_samples: IMU samples per epoch; None: as the log has it.

    Source: 003 (1)-(5). Deviations: specific force (up), not gravity; TRIAD with the force primary instead of
    the printed matrix, whose orthonormalisation puts half of the up gyro's bias over the Earth rate into the level.
    """

    interval_samples: int | None = optional_count()

    def __check_init__(self):
        check_interval(self.interval_samples)

    def find(self, record: _Record, rows: np.ndarray) -> _Found:
        """Up is f, east is w x f, north is up x east."""
        r = record.at(rows)
        zero, g_time = 0.0 * r.time, r.alpha.norm()
        up, east = Vec3(zero, zero, g_time), Vec3(1.0 + zero, zero, zero)
        q, defined = triad(up, r.force, east, r.turned.cross(r.force))
        return _Found(q, defined, up, r.force, up - q.rotate(r.force))


class DualVector(AbstractRecordMethod):
    """Gravity in inertial space at two times, seen by the accelerometers in b0: TRIAD, the newest vector exact.

    Attributes:
        vectors: "hann" (default): force averaged with Hann windows over the first and the last part of the record,
            which on a disturbed base beats every prefilter with a boxcar; "boxcar": plain means over the same parts
            (003's inertial-frame method); "halves": velocities V(t/2), V(t) (002); "ends": force in the first and the
            last interval (002); "rls": the same two, each from a fit of the whole record by recursive least squares.
        fraction: length of a part, as a fraction of the record.
        interval_samples: IMU samples per epoch; None: as the log has it.

    With windows every read-out sums its own parts: K read-outs of M epochs cost K M operations; on long logs at short
    intervals read out sparsely.

    Source: 002's comparison methods [8-12], 003's inertial-frame coarse alignment; windows ours.
    """

    vectors: Literal["hann", "boxcar", "halves", "ends", "rls"] = eqx.field(static=True, default="hann")
    fraction: float = eqx.field(static=True, default=1 / 3)
    interval_samples: int | None = optional_count()

    def __check_init__(self):
        check_choice("vectors", self.vectors, ("hann", "boxcar", "halves", "ends", "rls"))
        check_interval(self.interval_samples)
        if not 0 < self.fraction <= 0.5:
            raise UserError(f"fraction = {self.fraction}: must be above 0 and at most 0.5 of the record")

    def find(self, record: _Record, rows: np.ndarray) -> _Found:
        """Two vectors per read-out, then TRIAD in inertial space."""
        at = record.at(rows)
        (alpha1, beta1), (alpha2, beta2) = self._vectors(record, rows)
        q_n0b0, defined = triad(alpha2, beta2, alpha1, beta1)
        q_nb = at.q_n0n.conjugate() * q_n0b0 * at.q_b0b
        return _Found(q_nb, defined, alpha2, beta2, alpha2 - q_n0b0.rotate(beta2))

    def _vectors(self, record: _Record, rows: np.ndarray) -> tuple[tuple[Vec3, Vec3], tuple[Vec3, Vec3]]:
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


def _fitted(record: _Record, rows: np.ndarray) -> tuple[tuple[Vec3, Vec3], tuple[Vec3, Vec3]]:
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
