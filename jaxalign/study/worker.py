"""The work of a study on one device: it draws the runs of a block once for all methods, aligns and tallies them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs
from jaxalign.prefilter.base import without_prefilter
from jaxalign.simulate import Scenario, Truth, truth
from jaxalign.study import devices
from jaxalign.study.errors import Rows, common_rows, errors_of
from jaxalign.study.feed import World, feed_of, run_keys, world_of
from jaxalign.study.settings import Study
from jaxalign.study.tally import Tally, tally

__all__ = ["Job", "Worker", "jobs_of"]


class Job(NamedTuple):
    """One method, ready to run; `judge` are the arguments of `tally` after `counted`."""

    label: str
    method: Any
    world: World
    feed: str
    where: Rows
    judge: tuple[np.ndarray, np.ndarray, np.float64]


_WIDE = {"xla_cpu_prefer_vector_width": 512}  # XLA's own choice is half of it; what the processor lacks it leaves alone


@cache
def _programs() -> tuple[Program[..., Epochs], Program[..., Tally]]:
    """`_draw` and `_reduce`, for blocks of runs; not on import, which must not start JAX."""
    options = _WIDE if jax.default_backend() == "cpu" else None
    return Program(_draw, options, shared=True), Program(_reduce, options, shared=True)


def _draw(world: World, seed: jax.Array, numbers: jax.Array) -> Epochs:
    """Epochs of a block of runs."""
    return world.epochs(run_keys(seed, numbers))


def _reduce(method: Any, epochs: Epochs, exact: Truth, where: Rows, judge: Any, counted: jax.Array) -> Tally:
    """Align and tally a block of runs."""
    return tally(errors_of(method, epochs, exact, where), counted, *judge)


_known: list[tuple[Scenario, Scenario, Truth]] = []


def _truth_of(made: Scenario) -> tuple[Scenario, Truth]:
    """A scenario and its truth, on a device; those of the last one are kept: they take as long as a thousand runs."""
    if not (_known and _known[0][0] is made):
        exact = truth(made)
        _known[:] = [(made, *devices.placed((made, exact), next(iter(exact.dtheta.devices()))))]
    return _known[0][1:]


def jobs_of(study: Study) -> Iterator[Job]:
    """The methods of a study, each with what it needs of the scenario.

    Raises:
        UserError: a method that does not fit the scenario.
    """
    seed = jax.random.key(study.seed)
    made, exact = _truth_of(study.scenario)
    worlds: dict[str, World] = {}
    times = np.asarray(exact.t)
    start, stop = study.window
    for label, method in study.methods.items():
        feed = feed_of(method, made)
        where = common_rows(made, feed, study.every, label)
        if feed.name not in worlds:
            worlds[feed.name] = world_of(made, feed, seed, study.fidelity, exact)
        time = times[where.places]
        judge = time, (time > start + 1e-6) & (time <= stop + 1e-6), np.float64(study.tolerance_deg)
        yield Job(label, without_prefilter(method), worlds[feed.name], feed.name, where, judge)


class Worker:
    """A device: called with the number of a block, it returns the tally of each method.

    Args:
        study: what to do.
        jobs: of all methods.
        device: which.
        first: of the jobs, that it does first: devices begin with different ones, so that they compile side by side.
    """

    def __init__(self, study: Study, jobs: list[Job], device: Any, first: int = 0):
        self.study, self.device, self.first = study, device, first
        worlds = {job.feed: job.world for job in jobs}
        own = [{k: getattr(job, k) for k in _OWN} for job in jobs]
        worlds, own, self.seed = devices.placed((worlds, own, jax.random.key(study.seed)), device)
        self.jobs = [job._replace(world=worlds[job.feed], **some) for job, some in zip(jobs, own, strict=True)]

    def __call__(self, block: int) -> dict[str, Tally]:
        """Label -> tally of the runs of a block, on the host."""
        numbers = block * self.study.block + np.arange(self.study.block)
        counted, placed = devices.placed((numbers < self.study.runs, numbers), self.device)
        draw, reduce = _programs()
        drawn: dict[str, Epochs] = {}
        out = {}
        for job in (*self.jobs[self.first :], *self.jobs[: self.first]):
            if job.feed not in drawn:
                drawn[job.feed] = draw(job.world, self.seed, placed)
            out[job.label] = reduce(job.method, drawn[job.feed], job.world.exact, job.where, job.judge, counted)
        return {job.label: jax.tree.map(np.asarray, out[job.label]) for job in self.jobs}


_OWN = ("method", "where", "judge")
