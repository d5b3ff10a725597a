"""The loop of a study: simulate, align, reduce, block by block over the devices; chunks of blocks to disk."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.simulate import truth
from jaxalign.study import devices
from jaxalign.study.errors import Rows, common_rows, errors_of
from jaxalign.study.feed import World, feed_of, run_keys, world_of
from jaxalign.study.result import Result
from jaxalign.study.settings import Study
from jaxalign.study.statistics import statistics_of
from jaxalign.study.store import Store
from jaxalign.study.tally import Tally, tally

__all__ = ["Interrupted", "run"]

_CHUNK = 8192


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a study.

    Attributes:
        result: of the runs that were finished; None if there are not two.
    """

    def __init__(self, message: str, result: Result | None):
        super().__init__(message)
        self.result = result


class _Job(NamedTuple):
    """One method, ready to run; `judge` are arguments of `tally` after `counted`."""

    label: str
    method: Any
    world: World
    feed: str
    where: Rows
    time: np.ndarray
    judge: tuple[jax.Array, jax.Array, jax.Array]


def _sharded(body: Callable[..., Any], over: Mesh, common: Any, *blocks: Any) -> Any:
    """``body(common, *block)`` on each device: its block of the blocks, a first axis of all their leaves in and out."""
    arrays, rest = eqx.partition(common, eqx.is_array)
    spec = PartitionSpec(over.axis_names[0])

    def each(arrays: Any, *local: Any) -> Any:
        own = (jax.tree.map(lambda x: x[0], tree) for tree in local)
        return jax.tree.map(lambda x: x[None], body(eqx.combine(arrays, rest), *own))

    in_specs = (PartitionSpec(), *(spec for _ in blocks))
    return jax.shard_map(each, mesh=over, in_specs=in_specs, out_specs=spec, check_vma=False)(arrays, *blocks)


@eqx.filter_jit
def _draw(world: World, seed: jax.Array, numbers: jax.Array, over: Mesh) -> Epochs:
    """Epochs of a block of runs on each device; runs on the last axis."""

    def block(common: Any, numbers: jax.Array) -> Epochs:
        world, seed = common
        return world.epochs(run_keys(seed, numbers))

    return _sharded(block, over, (world, seed), numbers)


@eqx.filter_jit
def _reduce(common: Any, epochs: Epochs, numbers: jax.Array, over: Mesh) -> Tally:
    """Align and tally a block of runs on each device."""

    def block(common: Any, epochs: Epochs, numbers: jax.Array) -> Tally:
        method, exact, where, judge, runs = common
        return tally(errors_of(method, epochs, exact, where), numbers < runs, *judge)

    return _sharded(block, over, common, epochs, numbers)


def _jobs(study: Study, over: Mesh) -> Iterator[_Job]:
    made, seed = study.scenario, jax.random.key(study.seed)
    exact = truth(made)
    worlds: dict[str, World] = {}
    times = np.asarray(exact.t)
    for label, method in study.methods.items():
        feed = feed_of(method, made)
        where = common_rows(made, feed, study.every, label)
        if feed.name not in worlds:
            worlds[feed.name] = devices.replicated(world_of(made, feed, seed, study.fidelity, exact), over)
        time = times[where.places]
        start, stop = study.window
        window = (time > start + 1e-6) & (time <= stop + 1e-6)
        judge = devices.replicated((time, window, np.float64(study.tolerance_deg)), over)
        yield _Job(label, devices.replicated(method, over), worlds[feed.name], feed.name, where, time, judge)


class _Collected:
    """The tallies of all finished blocks, by method."""

    def __init__(self, labels: list[str]):
        self.blocks: dict[str, dict[int, Tally]] = {label: {} for label in labels}
        self.bins: dict[str, Any] = dict.fromkeys(labels, 0)

    def add(self, first: int, chunk: dict[str, Tally]) -> None:
        for label, tallied in chunk.items():
            self.bins[label] = self.bins[label] + np.asarray(tallied.bins, np.int64)
            count = len(tallied.known)
            for i in range(count):
                fields = {f: getattr(tallied, f)[i] for f in Tally.__dataclass_fields__ if f != "bins"}
                self.blocks[label][first + i] = Tally(**fields, bins=None)  # pyright: ignore[reportArgumentType]

    def result(self, study: Study, jobs: list[_Job], blocks: range | None = None) -> Result:
        out = {}
        for job in jobs:
            kept = self.blocks[job.label]
            parts = [kept[i] for i in sorted(kept)]
            runs = min(study.runs, len(parts) * study.block)
            stacked = jax.tree.map(lambda *x: np.stack(x), *parts)
            stacked = eqx.tree_at(lambda t: t.bins, stacked, self.bins[job.label], is_leaf=lambda x: x is None)
            out[job.label] = statistics_of(job.time, runs, stacked)
        return Result(study, out)


def _stacked(groups: list[dict[str, Tally]], blocks: int) -> dict[str, Tally]:
    """The tallies of a chunk from those of its dispatches, its bins summed."""
    out = {}
    for label in groups[0]:
        whole = jax.tree.map(lambda *x: np.concatenate(x)[:blocks], *(group[label] for group in groups))
        out[label] = eqx.tree_at(lambda t: t.bins, whole, np.sum(whole.bins, axis=0, dtype=np.int64))
    return out


def run(
    study: Study,
    *,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    chunk: int | None = None,
    progress: bool = False,
    warn: Callable[[str], None] = lambda line: None,
) -> Result | None:
    """Run a study on all devices of all processes.

    Args:
        study: what to do.
        out: folder for the finished chunks; None: nothing is written.
        resume: complete the study in that folder.
        chunk: runs between two writes, filled up to whole blocks on every device.
        progress: a bar on standard error.
        warn: takes a line on each damaged file.

    Returns:
        The statistics; None in processes other than the first.

    Raises:
        UserError: a method that does not fit the scenario, a folder that cannot be used (see :class:`Store`), or a
            write that failed: the chunks on disk are kept.
        Interrupted: Ctrl-C, after the finished blocks have been written.
    """
    if chunk is not None and (isinstance(chunk, bool) or chunk != int(chunk) or chunk < 1):
        raise UserError(f"chunk = {chunk!r}: must be a whole number of runs, at least 1")
    over = devices.mesh()
    jobs = list(_jobs(study, over))
    speaks = devices.is_first()
    store = Store(out, study.settings, resume) if out is not None and speaks else None
    collected = _Collected(list(study.methods))
    total = -(-study.runs // study.block)
    done = np.zeros(total, bool)
    if store is not None:
        found, damaged = store.read()
        for line in damaged:
            warn(line)
        for (first, stop), part in found.items():
            blocks = slice(first // study.block, -(-stop // study.block))
            if (
                first % study.block == 0
                and stop <= study.runs
                and not done[blocks].any()
                and list(part) == list(study.methods)
            ):
                collected.add(blocks.start, part)
                done[blocks] = True
    done = devices.agreed(done)

    per_chunk = -(-(chunk or _CHUNK) // (study.block * over.size)) * over.size
    seed = devices.replicated(jax.random.key(study.seed), over)
    bar = _bar(progress and speaks, len(jobs) * study.runs, int(done.sum()) * study.block * len(jobs))
    with bar:
        for first in _starts(done, per_chunk):
            blocks = _length(done, first, per_chunk)
            groups: list[dict[str, Tally]] = []
            interrupted = None
            try:
                for group in _dispatched(study, jobs, first, blocks, seed, over):
                    groups.append(group)
                    bar.update(min(over.size, blocks - len(groups) * over.size + over.size) * study.block * len(jobs))
            except KeyboardInterrupt as error:
                interrupted = error
            if groups:
                finished = min(blocks, len(groups) * over.size)
                part = _stacked(groups, finished)
                collected.add(first, part)
                _write(store, study, first, finished, part, collected)
            if interrupted is not None:
                raise _interrupted(study, jobs, collected, store) from None
    return collected.result(study, jobs) if speaks else None


def _starts(done: np.ndarray, per_chunk: int) -> Iterator[int]:
    """First blocks of the chunks that are to be done."""
    block = 0
    while block < len(done):
        if done[block]:
            block += 1
        else:
            yield block
            block += _length(done, block, per_chunk)


def _length(done: np.ndarray, first: int, most: int) -> int:
    """Blocks from one on that are not done, at most so many."""
    rest = np.flatnonzero(done[first:])
    return int(min(most, rest[0] if len(rest) else len(done) - first))


def _dispatched(
    study: Study, jobs: list[_Job], first: int, blocks: int, seed: jax.Array, over: Mesh
) -> Iterator[dict[str, Tally]]:
    """Tallies of the blocks, as many as there are devices at a time, the next ones begun before they are waited for."""
    ahead: dict[str, Tally] | None = None
    runs = devices.replicated(np.int64(study.runs), over)
    for block in range(first, first + blocks, over.size):
        numbers = devices.numbers(block * study.block, study.block, over)
        drawn: dict[str, Epochs] = {}
        begun = {}
        for job in jobs:
            if job.feed not in drawn:
                drawn[job.feed] = _draw(job.world, seed, numbers, over)
            common = (job.method, job.world.exact, job.where, job.judge, runs)
            begun[job.label] = _reduce(common, drawn[job.feed], numbers, over)
        if ahead is not None:
            yield devices.gathered(ahead)
        ahead = begun
    if ahead is not None:
        yield devices.gathered(ahead)


def _write(
    store: Store | None, study: Study, first: int, blocks: int, part: dict[str, Tally], collected: _Collected
) -> None:
    """A finished chunk to disk, in process 0; a failure ends all processes."""
    failure: UserError | None = None
    if store is not None:
        start, stop = first * study.block, min((first + blocks) * study.block, study.runs)
        try:
            store.write(start, stop, part)
        except UserError as error:
            kept = (sum(map(len, collected.blocks.values())) // len(collected.blocks) - blocks) * study.block
            failure = UserError(f"{error}; {kept} of {study.runs} runs are on disk: mend it and resume (--resume)")
    if devices.agreed(np.array(failure is not None)):
        raise failure or UserError("process 0 could not write its results")


def _interrupted(study: Study, jobs: list[_Job], collected: _Collected, store: Store | None) -> Interrupted:
    kept = min((len(blocks) for blocks in collected.blocks.values()), default=0)
    where = f", on disk in {store.folder}: go on with --resume" if store is not None and kept else ""
    message = f"interrupted after {min(kept * study.block, study.runs)} of {study.runs} runs{where}"
    return Interrupted(message, collected.result(study, jobs) if kept else None)


def _bar(shown: bool, total: int, done: int) -> Any:
    from tqdm import tqdm

    return tqdm(total=total, initial=done, unit="run", unit_scale=True, disable=None if shown else True, leave=False)
