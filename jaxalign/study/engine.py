"""The loop of a study: blocks of runs over the devices, chunks of blocks to disk."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxalign.arguments import whole_number
from jaxalign.errors import UserError
from jaxalign.study import devices
from jaxalign.study.block_sums import BlockSums
from jaxalign.study.result import Result
from jaxalign.study.settings import Study
from jaxalign.study.statistics import statistics_of
from jaxalign.study.store import Store
from jaxalign.study.worker import Job, Worker, jobs_of

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


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """A thread per device; kept, for a study of few runs takes as long as to start one."""
    return ThreadPoolExecutor(count)


class _Collected:
    """The sums of all finished blocks, by method."""

    def __init__(self, labels: list[str]):
        self.blocks: dict[str, dict[int, BlockSums]] = {label: {} for label in labels}
        self.bins: dict[str, Any] = dict.fromkeys(labels, 0)

    def add(self, first: int, chunk: dict[str, BlockSums]) -> None:
        for label, sums in chunk.items():
            self.bins[label] = self.bins[label] + np.asarray(sums.bins, np.int64)
            count = len(sums.known)
            for i in range(count):
                fields = {f: getattr(sums, f)[i] for f in BlockSums.__dataclass_fields__ if f != "bins"}
                self.blocks[label][first + i] = BlockSums(**fields, bins=None)  # pyright: ignore[reportArgumentType]

    def runs(self, study: Study) -> int:
        """How many are done."""
        return sum(min(study.block, study.runs - i * study.block) for i in next(iter(self.blocks.values())))

    def result(self, study: Study, jobs: list[Job]) -> Result:
        out = {}
        for job in jobs:
            kept = self.blocks[job.label]
            parts = [kept[i] for i in sorted(kept)]
            runs = self.runs(study)
            stacked = jax.tree.map(lambda *x: np.stack(x), *parts)
            stacked = replace(stacked, bins=self.bins[job.label])
            out[job.label] = statistics_of(job.judge[0], runs, stacked)
        return Result(study, out)


def _stacked(parts: list[dict[str, BlockSums]], blocks: int, most: int) -> dict[str, BlockSums]:
    """The sums of a chunk in the order of its blocks, its bins summed.

    Args:
        parts: those of the blocks of this process: every `process_count`-th one, at least one (if it has none, of any).
        blocks: of all processes in this chunk.
        most: blocks of a process in any chunk.
    """
    processes, rank = jax.process_count(), jax.process_index()
    own = len(range(rank, blocks, processes))
    sent = {}
    for label in parts[0]:
        rest = (replace(part[label], bins=None) for part in parts)
        bins = sum((part[label].bins for part in parts[:own]), np.zeros_like(parts[0][label].bins, np.int64))
        sent[label] = jax.tree.map(lambda *x: np.stack(x), *rest), bins
    if processes == 1:
        return {label: replace(rest, bins=bins) for label, (rest, bins) in sent.items()}

    def filled(x: np.ndarray) -> np.ndarray:  # all messages have one shape
        return np.concatenate([x, np.zeros((most - len(x), *x.shape[1:]), x.dtype)])

    sent = {label: (jax.tree.map(filled, rest), bins) for label, (rest, bins) in sent.items()}
    received = devices.everyone(sent)

    def in_order(*x: np.ndarray) -> np.ndarray:
        return np.stack(x, axis=1).reshape(-1, *x[0].shape[1:])[:blocks]

    out = {}
    for label in sent:
        whole = jax.tree.map(in_order, *(one[label][0] for one in received))
        bins = sum(one[label][1] for one in received)
        out[label] = replace(whole, bins=bins)
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
    if chunk is not None:
        chunk = whole_number("chunk", chunk, of="runs", floats=True)
    speaks = devices.is_first()
    bar = _bar(progress and speaks, study.runs)
    try:
        return _run(study, bar, out, resume, chunk, warn)
    finally:
        bar.close()


def _run(
    study: Study,
    bar: Any,
    out: str | os.PathLike[str] | None,
    resume: bool,
    chunk: int | None,
    warn: Callable[[str], None],
) -> Result | None:
    """See :func:`run`."""
    speaks = devices.is_first()
    jobs = list(jobs_of(study))
    collected = _Collected(list(study.methods))
    done = np.zeros(-(-study.runs // study.block), bool)
    here = jax.local_devices()
    side_by_side = len(here) * jax.process_count()
    per_chunk = -(-(chunk or _CHUNK) // (study.block * side_by_side)) * side_by_side
    _agree_on(study, per_chunk, len(here))
    store, refusal, found = None, None, {}
    try:
        if out is not None and speaks:
            if resume and not (Path(out) / "study.json").exists():
                warn(f"{out} holds no study to resume: a new one")
            store = Store(out, study.settings, resume)
            found, damaged = store.read()
            for line in damaged:
                warn(line)
    except UserError as error:
        refusal = error
    if devices.agreed(np.array(refusal is not None)):
        if store is not None:
            store.close()
        raise refusal or UserError("process 0 has refused: see its message")
    for (first, stop), part in found.items():
        blocks = slice(first // study.block, -(-stop // study.block))
        if first % study.block == 0 and stop <= study.runs and not done[blocks].any():
            collected.add(blocks.start, part)
            done[blocks] = True
    done = devices.agreed(done)

    plan = list(_chunks(done, per_chunk))
    most = max((-(-blocks // jax.process_count()) for _, blocks in plan), default=0)  # of a process at once
    used = here[:most]
    workers = [Worker(study, jobs, device, i * len(jobs) // len(used)) for i, device in enumerate(used)]
    bar.set_description("compiling" if plan else "")
    bar.update(min(int(done.sum()) * study.block, study.runs))
    pool, begun = _pool(len(here)), list[Future[Any]]()

    def begin(first: int, blocks: int) -> list[Future[dict[str, BlockSums]]]:
        own = range(first + jax.process_index(), first + blocks, jax.process_count()) or range(first, first + 1)
        futures = [pool.submit(workers[i % len(workers)], block) for i, block in enumerate(own)]
        begun[:] = [future for future in begun if not future.done()] + futures
        return futures

    waiting = [begin(*plan[0])] if plan else []
    try:
        for i, (first, blocks) in enumerate(plan):
            parts: list[dict[str, BlockSums]] = []
            interrupted = False
            try:
                for future in waiting.pop(0):
                    parts.append(future.result())
                    bar.set_description("", refresh=False)
                    bar.update(min(study.block * jax.process_count(), bar.total - bar.n))
                if i + 1 < len(plan):  # the devices go on while this chunk is written
                    waiting.append(begin(*plan[i + 1]))
            except KeyboardInterrupt:
                interrupted = True
                if jax.process_count() > 1:
                    raise
            with _uninterrupted() as asked:
                finished = blocks if not interrupted else len(parts)
                if finished:
                    part = _stacked(parts, finished, per_chunk // jax.process_count())
                    collected.add(first, part)
                    _write(store, study, first, finished, part, collected)
            if interrupted or asked:
                raise _interrupted(study, jobs, collected, store) from None
    finally:
        for future in begun:
            future.cancel()
        if store is not None:
            store.close()
    return collected.result(study, jobs) if speaks else None


def _agree_on(study: Study, *how: int) -> None:
    """All processes must do the same study in the same pieces.

    Raises:
        UserError: they do not.
    """
    if jax.process_count() == 1:
        return
    text = json.dumps([study.settings, *how], sort_keys=True)
    mine = np.frombuffer(hashlib.sha256(text.encode()).digest(), np.uint8)
    if any(not np.array_equal(mine, other) for other in devices.everyone(mine)):
        raise UserError(
            "distributed: the processes were given different studies, chunks or devices: use the same flags"
        )


@contextmanager
def _uninterrupted() -> Iterator[list[int]]:
    """Ctrl-C waits for the end of the block; the list is then not empty."""
    asked: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    before = signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


def _chunks(done: np.ndarray, most: int) -> Iterator[tuple[int, int]]:
    """(first block, blocks) of the chunks that are to be done."""
    block = 0
    while block < len(done):
        if done[block]:
            block += 1
            continue
        rest = np.flatnonzero(done[block:])
        blocks = int(min(most, rest[0] if len(rest) else len(done) - block))
        yield block, blocks
        block += blocks


def _write(
    store: Store | None, study: Study, first: int, blocks: int, part: dict[str, BlockSums], collected: _Collected
) -> None:
    """A finished chunk to disk, in process 0; a failure ends all processes."""
    failure: UserError | None = None
    if store is not None:
        start, stop = first * study.block, min((first + blocks) * study.block, study.runs)
        try:
            store.write(start, stop, part)
        except UserError as error:
            kept = collected.runs(study) - (stop - start)
            failure = UserError(f"{error}; {kept} of {study.runs} runs are on disk: mend it and resume (--resume)")
    if devices.agreed(np.array(failure is not None)):
        raise failure or UserError("process 0 could not write its results")


def _interrupted(study: Study, jobs: list[Job], collected: _Collected, store: Store | None) -> Interrupted:
    kept = collected.runs(study)
    where = f", on disk in {store.folder}: go on with --resume" if store is not None and kept else ""
    message = f"interrupted after {kept} of {study.runs} runs{where}"
    return Interrupted(message, collected.result(study, jobs) if kept else None)


def _bar(shown: bool, total: int) -> Any:
    from tqdm import tqdm

    disable = None if shown else True  # None: where standard error is no terminal
    return tqdm(total=total, desc="preparing", unit="run", unit_scale=True, disable=disable, leave=False)
