"""The recursion: slots in, attitudes out. The only scan of the alignment."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxalign.aids import AbstractAid
from jaxalign.compilation.programs import Program
from jaxalign.earth import Site
from jaxalign.epochs import Epoch, Epochs, strided_rows
from jaxalign.errors import UserError
from jaxalign.estimate import AbstractEstimate, Readout
from jaxalign.front_end import FrontEnd
from jaxalign.method import AbstractMethod
from jaxalign.observability import Observability
from jaxalign.observe import AbstractObserve, Context, Pair
from jaxalign.precision import require_x64
from jaxalign.reconstruct import AbstractReconstruct, Identity
from jaxalign.solution import Solution, assembled
from jaxalign.vector import Quat, Vec3, where
from jaxalign.weight import AbstractWeight, Unit

_FEEDBACK = 10

__all__ = ["AlignState", "Aligner"]


class AlignState(eqx.Module):
    """What is carried from epoch to epoch."""

    observe: Any
    reconstruct: Any
    weight: Any
    estimate: Any
    observability: Observability
    index: Int[Array, ""]
    time: Float[Array, ""]
    dt: Float[Array, ""]
    sd: Float[Array, ""]
    readout: Readout
    pair: Pair
    aided: Bool[Array, ""]  # whether the aid had a sample at the last epoch
    used: Float[Array, ""]  # weight of the pair

    @property
    def context(self) -> Context:
        """What the slots may look back at."""
        defined = self.readout.defined
        attitude = where(defined, self.readout.attitude, Quat.identity())
        return Context(self.index, self.time, self.dt, attitude, defined, self.sd)


class Aligner(AbstractMethod):
    """A recursive method: a choice of four slots.

    ``state = aligner.init(site)``, then ``state, row = aligner.step(state, epoch)`` for every epoch, the
    first one being :meth:`Epoch.start`: online, or inside a scan of your own (wrap the step in a local function:
    ``lax.scan(lambda s, e: aligner.step(s, e), ...)``). :func:`align` does it for a log.

    Attributes:
        observe: epochs to vector pairs.
        reconstruct: measured pairs to modelled ones.
        weight: pairs to weights.
        estimate: weighted pairs to an attitude.
        front_end: makes epochs of a log (:meth:`epochs`); the steps know nothing of it.
    """

    observe: AbstractObserve
    reconstruct: AbstractReconstruct = eqx.field(default_factory=Identity)
    weight: AbstractWeight = eqx.field(default_factory=Unit)
    estimate: AbstractEstimate = eqx.field(kw_only=True)
    front_end: FrontEnd = eqx.field(default_factory=FrontEnd, kw_only=True)

    def __check_init__(self):
        for slot in (self.reconstruct, self.weight, self.estimate):
            slot.check(self.observe)

    @property
    def aids(self) -> tuple[AbstractAid, ...]:
        """The aid that it observes."""
        return (self.observe.aid,)

    @property
    def fits_vectors(self) -> bool:
        """Whether its residuals are those of reconstructed vectors."""
        return self.reconstruct.fits

    def whitened(self, residual: np.ndarray, time: np.ndarray, sd: float, interval: float) -> np.ndarray:
        """As the observation has it, see :meth:`AbstractObserve.whitened`."""
        return self.observe.whitened(residual, time, sd, interval)

    def at_interval(self, seconds: float | None) -> Aligner:
        """The same for epochs so far apart (s; None: at unequal intervals), which a window must know beforehand.

        :meth:`solve` finds out by itself, but inside traced code it cannot.

        Raises:
            UserError: it has a window, and the intervals differ.
        """
        if not self.observe.window:
            return self
        if seconds is None:
            raise UserError(
                f"observe.window = {self.observe.window:g} s: a window is a number of epochs, and the aids of this "
                "log do not measure at equal intervals: leave it at 0"
            )
        return dataclasses.replace(self, observe=dataclasses.replace(self.observe, interval=seconds))

    def init(self, site: Site, aid_sd: Any = 1.0) -> AlignState:
        """State before the first epoch.

        Args:
            site: where the vehicle is switched on.
            aid_sd: standard deviation of the aid's white noise per axis, m/s.
        """
        require_x64(self, site)
        zero, v = jnp.zeros((), jnp.float64), Vec3.zero()
        coupled = self.observe.coupled and self.reconstruct.keeps_displacement
        displacement = v if coupled else None
        return AlignState(
            observe=self.observe.init(site),
            reconstruct=self.reconstruct.init(),
            weight=self.weight.init(),
            estimate=self.estimate.init(coupled),
            observability=Observability.zero(),
            index=jnp.full((), -1, jnp.int32),
            time=zero,
            dt=zero,
            sd=jnp.asarray(aid_sd, jnp.float64),
            readout=Readout.nothing(),
            pair=Pair(v, v, jnp.zeros((), bool), v, v, displacement, v),
            aided=jnp.zeros((), bool),
            used=zero,
        )

    def update(self, state: AlignState, epoch: Epoch) -> AlignState:
        """Consume one epoch without reading out an attitude (feedback uses the last one)."""
        state = dataclasses.replace(state, index=state.index + 1, time=state.time + epoch.dt, dt=epoch.dt)
        context = state.context
        observe, pair = self.observe.step(state.observe, context, epoch)
        reconstruct, pair = self.reconstruct.step(state.reconstruct, context, pair)
        weight_state, weight = self.weight.step(state.weight, context, pair)
        weight = jnp.where(pair.valid, weight, 0.0)
        estimate = self.estimate.update(state.estimate, context, pair, weight)
        observability = state.observability + Observability.of(pair.noise_free, pair.valid)
        return AlignState(
            observe=observe,
            reconstruct=reconstruct,
            weight=weight_state,
            estimate=estimate,
            observability=observability,
            index=state.index,
            time=state.time,
            dt=state.dt,
            sd=state.sd,
            readout=state.readout,
            pair=pair,
            aided=epoch.valid,
            used=weight,
        )

    def read(self, state: AlignState, fresh: bool = False) -> tuple[AlignState, Solution]:
        """Read out the attitude of the last epoch.

        Args:
            state: after one or more updates.
            fresh: whether the epoch before was read out too.

        Returns:
            The new state and one row (scalar leaves) of a Solution.
        """
        context = dataclasses.replace(state.context, fresh=fresh)
        readout = self.estimate.readout(state.estimate, context)
        defined, o = readout.defined, state.observe
        attitude = where(defined, readout.attitude, Quat.identity())
        q_nb = (o.q_n0n.conjugate() * attitude * o.q_b0b).unit()
        pair = state.pair
        residual = pair.residual(attitude)
        finite = jnp.isfinite(readout.eigengap + q_nb.norm2() + residual.norm2())
        row = assembled(
            time=state.time,
            q_nb=q_nb.array,
            defined=defined,
            observable=state.observability.observable(state.sd, self.observe.steps),
            finite=finite,
            aided=state.aided,
            residual=residual.array,
            weight=state.used,
            alpha=pair.alpha.array,
            beta=pair.beta.array,
            aid_sd=state.sd,
            aids={self.observe.aid.name: (residual.array, state.used, state.sd, state.aided)},
            eigengap=readout.eigengap,
            unused=state.aided & (state.used == 0),
            status=readout.status,
        )
        return eqx.tree_at(lambda s: s.readout, state, readout), row

    def step(self, state: AlignState, epoch: Epoch) -> tuple[AlignState, Solution]:
        """Consume one epoch and read out the attitude. Pure: no jit, print or callback inside."""
        return self.read(self.update(state, epoch), fresh=True)

    def solve(self, epochs: Epochs, rows: Any = 1, done: Callable[[int], None] | None = None) -> Solution:
        """Align epochs: one compiled scan; also inside jit, vmap and grad (see :meth:`AbstractMethod.solve`)."""
        every, places = strided_rows(len(epochs), rows)
        method = self.bare
        if self.observe.window and self.observe.interval is None:
            method = method.at_interval(epochs.interval)
        return _jitted(method, epochs, every, places)


def _scan(aligner: Aligner, epochs: Epochs, every: int) -> Solution:
    """All epochs; rows at epoch 0, every ``every``-th epoch and the last one."""
    # Feedback of the attitude must not starve, whatever is asked for: the transport rate can wait some epochs, a weight
    # that looks at residuals cannot: early outliers would pass while it has no attitude.
    every = max(1, min(every, len(epochs) - 1))
    most = 1 if aligner.weight.looks_at_attitude else _FEEDBACK
    stride = max(d for d in range(1, most + 1) if every % d == 0)
    out = _scan_rows(aligner, epochs, stride)
    if stride != every:
        last = len(epochs) - 1
        rows = np.append(np.arange(0, last, every) // stride, -(-last // stride))
        out = jax.tree.map(lambda x: x[rows], out)
    return out


def _scan_rows(aligner: Aligner, epochs: Epochs, every: int) -> Solution:
    """Blocks of ``every`` epochs, in segments of about sqrt(epochs) epochs.

    Reverse mode keeps a state per segment, and what the epochs of one segment leave: as much of either.
    """
    state = aligner.init(epochs.site, epochs.aid_sd)
    rows = epochs.rows.whole

    def step(state, row):
        return aligner.step(state, row)

    def update(state, row):
        return aligner.update(state, row), None

    def block(state, rows):
        if every == 1:
            return step(state, jax.tree.map(lambda x: x[0], rows))
        state, _ = jax.lax.scan(update, state, rows)
        return aligner.read(state)

    def segment(state, rows):
        return jax.lax.scan(block, state, rows)

    blocks, rest = divmod(len(epochs) - 1, every)
    count = 1 + blocks
    length = max(1, round(math.sqrt(count / every)))
    segments = -(-count // length)
    empty = segments * length - count
    # Empty epochs in front: epoch 0 ends a block like the others, and all segments have one length: one program.
    before = empty * every + every - 1
    nothing = Epoch.start(jnp.full(3, jnp.nan))
    state = eqx.tree_at(lambda s: s.index, state, state.index - before)
    whole = jax.tree.map(
        lambda x, n: jnp.concatenate([jnp.broadcast_to(n, (before,)), x[: 1 + blocks * every]]), rows, nothing
    )
    grouped = jax.tree.map(lambda x: x.reshape(segments, length, every), whole)
    state, out = jax.lax.scan(jax.checkpoint(segment, prevent_cse=False), state, grouped)
    out = jax.tree.map(lambda x: x.reshape(segments * length, *x.shape[2:])[empty:], out)
    if rest:
        _, last = block(state, jax.tree.map(lambda x: x[-rest:], rows))
        out = jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), out, last)
    return out


@Program
def _jitted(aligner: Aligner, epochs: Epochs, every: int, places: tuple[int, ...] | None) -> Solution:
    found = _scan(aligner, epochs, every)
    return found if places is None else jax.tree.map(lambda x: x[np.array(places)], found)
