"""The recursion: slots in, attitudes out. The only scan of the alignment."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxalign.earth import Site
from jaxalign.epochs import Epoch, Epochs, epochs_from_log, require_x64
from jaxalign.errors import UserError
from jaxalign.estimate import AbstractEstimate, Readout
from jaxalign.log import Log
from jaxalign.observe import AbstractObserve, Context, Pair
from jaxalign.reconstruct import AbstractReconstruct, Measured
from jaxalign.solution import Solution, Status
from jaxalign.vector import Mat3, Quat, Vec3, where
from jaxalign.weight import AbstractWeight, Unit

__all__ = ["AlignState", "Aligner", "align"]


class _Geometry(eqx.Module):
    """``sum a a^T`` of the noise-free vectors and their number: has the heading become observable?"""

    spread: Mat3
    count: Float[Array, ""]

    @classmethod
    def zero(cls) -> _Geometry:
        return cls(Mat3.zero(), jnp.zeros((), jnp.float64))

    def plus(self, clean: Vec3, used: Any) -> _Geometry:
        return _Geometry(self.spread + (clean * used).outer(clean), self.count + used)

    def observable(self, sd: Any) -> Bool[Array, ""]:
        """4 (s2 + s3) / (8 k sd^2) > 1; s2 + s3 from the principal minors, without cancellation."""
        a = self.spread
        minors = (
            (a.r0.x * a.r1.y - a.r0.y * a.r1.x)
            + (a.r0.x * a.r2.z - a.r0.z * a.r2.x)
            + (a.r1.y * a.r2.z - a.r1.z * a.r2.y)
        )
        return 4.0 * minors > 8.0 * self.count * sd * sd * a.trace


class AlignState(eqx.Module):
    """What is carried from epoch to epoch."""

    observe: Any
    reconstruct: Any
    weight: Any
    estimate: Any
    geometry: _Geometry
    index: Int[Array, ""]
    time: Float[Array, ""]
    sd: Float[Array, ""]
    readout: Readout
    pair: Pair
    used: Float[Array, ""]  # weight of the pair

    @property
    def context(self) -> Context:
        """What the slots may look back at."""
        defined = self.readout.defined
        attitude = where(defined, self.readout.attitude, Quat.identity())
        return Context(self.index, self.time, attitude, defined, self.sd)


class Aligner(eqx.Module):
    """A recursive method: a choice of four slots.

    ``state = aligner.init(site, interval)``, then ``state, row = aligner.step(state, epoch)`` for every epoch, the
    first one being :meth:`Epoch.start`: online, or inside a scan of your own (wrap the step in a local function:
    ``lax.scan(lambda s, e: aligner.step(s, e), ...)``). :func:`align` does it for a log.

    Attributes:
        observe: epochs to vector pairs.
        reconstruct: measured pairs to modelled ones.
        weight: pairs to weights.
        estimate: weighted pairs to an attitude.
    """

    observe: AbstractObserve
    reconstruct: AbstractReconstruct = eqx.field(default_factory=Measured)
    weight: AbstractWeight = eqx.field(default_factory=Unit)
    estimate: AbstractEstimate = eqx.field(kw_only=True)

    @property
    def aid(self) -> str:
        """The kind of aid that it observes."""
        return self.observe.aid

    def init(self, site: Site, interval: float, aid_sd: Any = 1.0) -> AlignState:
        """State before the first epoch.

        Args:
            site: where the vehicle is switched on.
            interval: nominal seconds between epochs (a Python float).
            aid_sd: standard deviation of the aid's white noise per axis, m/s.
        """
        zero, v = jnp.zeros((), jnp.float64), Vec3.zero()
        moment = v if self.observe.coupled else None
        return AlignState(
            observe=self.observe.init(site, interval),
            reconstruct=self.reconstruct.init(),
            weight=self.weight.init(),
            estimate=self.estimate.init(self.observe.coupled),
            geometry=_Geometry.zero(),
            index=jnp.full((), -1, jnp.int32),
            time=zero,
            sd=jnp.asarray(aid_sd, jnp.float64),
            readout=Readout(Quat.identity(), zero),
            pair=Pair(v, v, jnp.zeros((), bool), v, v, moment, v),
            used=zero,
        )

    def update(self, state: AlignState, epoch: Epoch) -> AlignState:
        """Consume one epoch without reading out an attitude (feedback uses the last one)."""
        state = eqx.tree_at(lambda s: (s.index, s.time), state, (state.index + 1, state.time + epoch.dt))
        context = state.context
        observe, pair = self.observe.step(state.observe, context, epoch)
        reconstruct, pair = self.reconstruct.step(state.reconstruct, context, pair)
        weight_state, weight = self.weight.step(state.weight, context, pair)
        weight = jnp.where(pair.valid, weight, 0.0)
        estimate = self.estimate.update(state.estimate, context, pair, weight)
        geometry = state.geometry.plus(pair.clean, jnp.where(pair.valid, 1.0, 0.0))
        return AlignState(
            observe=observe,
            reconstruct=reconstruct,
            weight=weight_state,
            estimate=estimate,
            geometry=geometry,
            index=state.index,
            time=state.time,
            sd=state.sd,
            readout=state.readout,
            pair=pair,
            used=weight,
        )

    def read(self, state: AlignState) -> tuple[AlignState, Solution]:
        """Read out the attitude of the last epoch: the new state and one row (scalar leaves) of a Solution."""
        readout = self.estimate.readout(state.estimate, state.context)
        defined, o = readout.defined, state.observe
        attitude = where(defined, readout.attitude, Quat.identity())
        q_nb = (o.q_n0n.conjugate() * attitude * o.q_b0b).unit().positive()
        q_nb = where(defined, q_nb, Quat.identity())
        pair = state.pair
        residual = pair.alpha - attitude.rotate(pair.beta)
        observable = state.geometry.observable(state.sd) & defined
        finite = jnp.isfinite(readout.eigengap + q_nb.norm2() + residual.norm2())
        bits = (
            (~defined, Status.UNDEFINED),
            (~observable, Status.HEADING_UNOBSERVABLE),
            (~pair.valid, Status.AID_MISSING),
            (~finite, Status.NON_FINITE),
        )
        status = sum(jnp.where(condition, jnp.int32(bit), jnp.int32(0)) for condition, bit in bits)
        row = Solution(
            time=state.time,
            q_nb=q_nb.array,
            defined=defined,
            observable=observable,
            eigengap=readout.eigengap,
            residual=residual.array,
            weight=state.used,
            alpha=pair.alpha.array,
            beta=pair.beta.array,
            sd=None,
            status=status,
            aid_sd=state.sd,
        )
        return eqx.tree_at(lambda s: s.readout, state, readout), row

    def step(self, state: AlignState, epoch: Epoch) -> tuple[AlignState, Solution]:
        """Consume one epoch and read out the attitude. Pure: no jit, print or callback inside."""
        return self.read(self.update(state, epoch))

    def align(self, log: Log | Epochs, every: int = 1) -> Solution:
        """See :func:`align`."""
        return align(self, log, every)


def _scan(aligner: Aligner, epochs: Epochs, every: int) -> Solution:
    """All epochs; rows at epoch 0, every ``every``-th epoch and the last one."""
    state = aligner.init(epochs.site, epochs.interval, epochs.aid_sd)

    def step(state, row):
        return aligner.step(state, row)

    def update(state, row):
        return aligner.update(state, row), None

    def block(state, rows):
        state, _ = jax.lax.scan(update, state, rows)
        return aligner.read(state)

    if every == 1:
        _, rows = jax.lax.scan(step, state, epochs.rows)
        return eqx.tree_at(lambda s: s.aid_sd, rows, epochs.aid_sd)

    def part(start, stop):
        return jax.tree.map(lambda x: x[start:stop], epochs.rows)

    blocks, rest = divmod(len(epochs) - 1, every)
    state, first = block(state, part(0, 1))
    pieces = [jax.tree.map(lambda x: x[None], first)]
    if blocks:
        grouped = jax.tree.map(lambda x: x.reshape(blocks, every), part(1, 1 + blocks * every))
        state, rows = jax.lax.scan(block, state, grouped)
        pieces.append(rows)
    if rest:
        _, last = block(state, part(len(epochs) - rest, len(epochs)))
        pieces.append(jax.tree.map(lambda x: x[None], last))
    rows = jax.tree.map(lambda *x: jnp.concatenate(x), *pieces)
    return eqx.tree_at(lambda s: s.aid_sd, rows, epochs.aid_sd)


@eqx.filter_jit
def _jitted(aligner: Aligner, epochs: Epochs, every: int) -> Solution:
    return _scan(aligner, epochs, every)


def align(method: Any, log: Log | Epochs, every: int = 1) -> Solution:
    """Align a log with a method.

    Args:
        method: an :class:`Aligner`, or anything with ``align(log, every)``.
        log: a checked log (host), or Epochs (also inside jit, vmap, grad).
        every: epochs between two read-outs. The eigenproblem costs more than all the rest of a step; between read-outs feedback
            of the attitude (transport rate, residual weights) uses the last one. Rows come at epoch 0, at each
            ``every``-th epoch and at the last one.

    Returns:
        A :class:`Solution`.

    Raises:
        UserError: float32, an aid that the method does not observe, or ``every`` < 1.
    """
    if not isinstance(method, Aligner):
        return method.align(log, every)
    if every < 1 or every != int(every):
        raise UserError(f"every = {every}: must be a whole number of epochs, at least 1")
    require_x64(method)
    if isinstance(log, Log):
        static = method.aid == "static"
        if not static and log.aid != method.aid:
            raise UserError(
                f"{log.name} has a {log.aid!r} aid, the method observes {method.aid!r}: build it with aid={log.aid!r}"
            )
        log = epochs_from_log(log, interval_samples=method.observe.interval_samples, static=static)
    else:
        require_x64(log)
        if log.aid != method.aid:
            raise UserError(f"these epochs have a {log.aid!r} aid, the method observes {method.aid!r}")
    return _jitted(method, log, int(every))
