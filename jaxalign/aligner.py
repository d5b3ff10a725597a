"""The recursion: slots in, attitudes out. The only scan of the alignment."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from jaxalign.aid_noise import white_noise_sd
from jaxalign.compilation.programs import Program
from jaxalign.earth import Site
from jaxalign.epochs import Epoch, Epochs, check_every, check_prefilter, epochs_from_log, over_runs
from jaxalign.errors import UserError
from jaxalign.estimate import AbstractEstimate, QMethod, Readout
from jaxalign.log import Log
from jaxalign.observe import AbstractObserve, BodyVelocity, Context, NavVelocity, Pair, Static
from jaxalign.parameters import as_float64
from jaxalign.precision import require_x64
from jaxalign.prefilter import AbstractPrefilter
from jaxalign.prefilter.base import optional_prefilter, without_prefilter
from jaxalign.reconstruct import AbstractReconstruct, Measured
from jaxalign.solution import Solution, Status
from jaxalign.spread import Spread
from jaxalign.vector import Quat, Vec3, where
from jaxalign.weight import AbstractWeight, Unit

_FEEDBACK = 10

__all__ = ["AlignState", "Aligner", "align", "epochs_for", "estimate_aid_sd"]


class AlignState(eqx.Module):
    """What is carried from epoch to epoch."""

    observe: Any
    reconstruct: Any
    weight: Any
    estimate: Any
    spread: Spread
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
        prefilter: low-pass filter of the specific force of a whole log of a standing vehicle (:meth:`epochs`); the
            steps know nothing of it. None: no filter.
    """

    has_covariance: ClassVar[bool] = False
    """Whether its solutions come with a covariance."""
    dear_rows: ClassVar[bool] = False
    """Whether each row goes over all epochs before it; then ``solve`` takes ``done`` too, which is told of rows."""
    observe: AbstractObserve
    reconstruct: AbstractReconstruct = eqx.field(default_factory=Measured)
    weight: AbstractWeight = eqx.field(default_factory=Unit)
    estimate: AbstractEstimate = eqx.field(kw_only=True)
    prefilter: AbstractPrefilter | None = optional_prefilter()

    def __check_init__(self):
        check_prefilter(self.prefilter, self.aid)
        for slot in (self.reconstruct, self.weight, self.estimate):
            slot.check(self.observe)

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
        require_x64(self, site)
        zero, v = jnp.zeros((), jnp.float64), Vec3.zero()
        coupled = self.observe.coupled and self.reconstruct.keeps_moment
        moment = v if coupled else None
        return AlignState(
            observe=self.observe.init(site, interval),
            reconstruct=self.reconstruct.init(),
            weight=self.weight.init(),
            estimate=self.estimate.init(coupled),
            spread=Spread.zero(),
            index=jnp.full((), -1, jnp.int32),
            time=zero,
            dt=zero,
            sd=jnp.asarray(aid_sd, jnp.float64),
            readout=Readout.nothing(),
            pair=Pair(v, v, jnp.zeros((), bool), v, v, moment, v),
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
        spread = state.spread + Spread.of(pair.clean, pair.valid)
        return AlignState(
            observe=observe,
            reconstruct=reconstruct,
            weight=weight_state,
            estimate=estimate,
            spread=spread,
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
        q_nb = (o.q_n0n.conjugate() * attitude * o.q_b0b).unit().positive()
        q_nb = where(defined, q_nb, Quat.identity())
        pair = state.pair
        residual = pair.residual(attitude)
        observable = state.spread.observable(state.sd, self.observe.steps) & defined
        finite = jnp.isfinite(readout.eigengap + q_nb.norm2() + residual.norm2())
        bits = (
            (~defined, Status.UNDEFINED),
            (~observable, Status.HEADING_UNOBSERVABLE),
            (~state.aided, Status.AID_MISSING),
            (state.aided & (state.used == 0), Status.UNUSED),
            (~finite, Status.NON_FINITE),
        )
        status = readout.status + sum(
            (jnp.where(condition, jnp.int32(bit), 0) for condition, bit in bits), jnp.int32(0)
        )
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
            covariance=None,
            status=status,
            aid_sd=state.sd,
        )
        return eqx.tree_at(lambda s: s.readout, state, readout), row

    def step(self, state: AlignState, epoch: Epoch) -> tuple[AlignState, Solution]:
        """Consume one epoch and read out the attitude. Pure: no jit, print or callback inside."""
        return self.read(self.update(state, epoch), fresh=True)

    def epochs(self, log: Log) -> Epochs:
        """Preintegrate a log for this method.

        Raises:
            UserError: float32, or an aid that the method does not observe.
        """
        static = self.aid == "static"
        if not static and log.aid != self.aid:
            raise UserError(
                f"{log.name} has a {log.aid!r} aid, the method observes {self.aid!r}: build it with aid={log.aid!r}"
            )
        return epochs_from_log(
            log, interval_samples=self.observe.interval_samples, static=static, prefilter=self.prefilter
        )

    def solve(self, epochs: Epochs, every: int = 1) -> Solution:
        """Align epochs: one compiled scan; also inside jit, vmap and grad."""
        return _jitted(without_prefilter(self), epochs, every)

    def solve_runs(self, epochs: Epochs, every: int = 1) -> Solution:
        """Align many runs, see :func:`jaxalign.epochs.over_runs`."""
        return over_runs(lambda one: self.solve(one, every), epochs)

    def align(self, log: Log | Epochs, every: int = 1) -> Solution:
        """See :func:`align`."""
        return align(self, log, every)


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
    state = aligner.init(epochs.site, epochs.interval, epochs.aid_sd)
    rows = epochs.rows

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
def _jitted(aligner: Aligner, epochs: Epochs, every: int) -> Solution:
    return _scan(aligner, epochs, every)


def estimate_aid_sd(epochs: Epochs) -> float:
    """Standard deviation of the aid's white noise (m/s; standing: of the force over one interval), from the epochs.

    Aligns once with the plain q-method to get the vectors, then :func:`jaxalign.aid_noise.white_noise_sd`.

    Raises:
        UserError: too few epochs to tell.
    """
    observe: AbstractObserve = {"static": Static, "body": BodyVelocity, "nav": NavVelocity}[epochs.aid]()
    found = Aligner(observe, estimate=QMethod()).solve(epochs)
    valid = np.asarray(found.status) & int(Status.AID_MISSING) == 0
    sd = white_noise_sd(np.asarray(found.alpha), np.asarray(found.beta), valid, walk=observe.steps)
    if sd is None:
        what = (
            "epochs to estimate the noise of the force"
            if epochs.aid == "static"
            else "velocities to estimate the aid's"
        )
        raise UserError(f"too few {what}: state it (aid_sd of the log, --aid-sd), m/s")
    return sd


def _measured(method: Any, log: Log, epochs: Epochs) -> Epochs:
    """The epochs of a log as measured: behind a prefilter the noise is not white, and cannot be estimated."""
    raw = without_prefilter(method)
    return epochs if raw is method else raw.epochs(log)


def align(
    method: Any, log: Log | Epochs, every: int = 1, aid_sd: Any = None, done: Callable[[int], None] | None = None
) -> Solution:
    """Align a log with a method.

    Args:
        method: a recipe of :mod:`jaxalign.methods`, an :class:`Aligner` of your own, or anything with ``aid``,
            ``epochs(log)`` and ``solve(epochs, every)``.
        log: a checked log (host), or Epochs (also inside jit, vmap, grad).
        every: epochs between two rows of the result: they come at epoch 0, at each ``every``-th epoch and the last one.
            The eigenproblem costs as much as all the rest of a step, so it is solved only for the rows, and for the
            feedback of the attitude: into the transport rate at least every 10 epochs, into a weight that looks at
            the attitude at each.
        aid_sd: standard deviation of the aid's white noise per axis, m/s (for a method that takes the vehicle as
            standing: of the force integrated over one interval). By default what the log says of the aid that the
            method observes, else an estimate from the log (:func:`estimate_aid_sd`). ``Solution.aid_sd`` says what
            was used.
        done: told how many rows are finished, now and then, by a method whose rows are dear (``dear_rows``).

    Returns:
        A :class:`Solution`.

    Raises:
        UserError: float32, an aid that the method does not observe, ``every`` < 1, noise neither stated nor to be
            estimated, or unfiltered epochs for a method with a prefilter.
    """
    check_every(every)
    epochs = epochs_for(method, log, aid_sd)  # first: it refuses what is no method
    if done is not None and method.dear_rows:
        return method.solve(epochs, int(every), done)
    return method.solve(epochs, int(every))


def epochs_for(method: Any, log: Log | Epochs, aid_sd: Any = None) -> Epochs:
    """What a method aligns: the epochs of a log as it makes them, with the noise of the aid.

    Arguments and errors as of :func:`align`.
    """
    if not hasattr(method, "solve"):
        raise UserError(f"{method!r} is no method: build one by name with jaxalign.methods.build('oba', aid='body')")
    if not isinstance(log, Log | Epochs):
        raise UserError(f"{log!r} is neither a Log nor Epochs: read a file with jaxalign.read(path)")
    require_x64(method)
    if isinstance(log, Epochs):
        require_x64(log)
        if log.aid != method.aid:
            raise UserError(f"these epochs have a {log.aid!r} aid, the method observes {method.aid!r}")
        if getattr(method, "prefilter", None) is not None and not log.filtered:
            raise UserError(
                "the method has a prefilter, but these epochs are not filtered: make them with method.epochs(log), or "
                "with epochs_from_arrays(..., prefilter=method.prefilter)"
            )
        epochs = log
    else:
        epochs = method.epochs(log)
        if aid_sd is None:
            stated = log.aid_sd is not None and log.aid == epochs.aid
            aid_sd = log.aid_sd if stated else estimate_aid_sd(_measured(method, log, epochs))
    if aid_sd is not None:
        if not isinstance(aid_sd, Tracer) and not np.all(np.asarray(aid_sd) > 0):
            raise UserError(f"aid_sd = {aid_sd}: the standard deviation of the aid's noise must be above 0 m/s")
        epochs = eqx.tree_at(lambda e: e.aid_sd, epochs, as_float64(aid_sd))
    return epochs
