"""The work of a study on one device: it draws the runs of a block once for all methods, aligns and tallies them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epochs
from jaxalign.simulate import Scenario, Truth, truth
from jaxalign.study import devices
from jaxalign.study.block_sums import BlockSums, sum_block
from jaxalign.study.epochs_spec import RunModel, epochs_spec, run_keys, run_model
from jaxalign.study.errors import Rows, common_rows, errors_of
from jaxalign.study.settings import Study

__all__ = ["Job", "Worker", "jobs_of"]


class Job(NamedTuple):
    """One method, ready to run; `judge` are the arguments of `sum_block` after `counted`."""

    label: str
    method: Any
    model: RunModel
    spec: str
    where: Rows
    judge: tuple[np.ndarray, np.ndarray, np.float64]


_WIDE = {"xla_cpu_prefer_vector_width": 512}  # XLA's own choice is half of it; what the processor lacks it leaves alone


@cache
def _programs() -> tuple[Program[..., Epochs], Program[..., BlockSums]]:
    """`_draw` and `_reduce`, for blocks of runs; not on import, which must not start JAX."""
    options = _WIDE if jax.default_backend() == "cpu" else None
    return Program(_draw, options, shared=True), Program(_reduce, options, shared=True)


def _draw(model: RunModel, seed: jax.Array, numbers: jax.Array) -> Epochs:
    """Epochs of a block of runs."""
    return model.epochs(run_keys(seed, numbers))


def _reduce(method: Any, epochs: Epochs, exact: Truth, where: Rows, judge: Any, counted: jax.Array) -> BlockSums:
    """Align a block of runs and sum it up."""
    return sum_block(errors_of(method, epochs, exact, where), counted, *judge)


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
    models: dict[str, RunModel] = {}
    times = np.asarray(exact.t)
    start, stop = study.window
    for label, method in study.methods.items():
        spec = epochs_spec(method, made)
        where = common_rows(made, spec, study.every, label)
        if spec.name not in models:
            models[spec.name] = run_model(made, spec, seed, study.fidelity, exact)
        time = times[where.places]
        judge = time, (time > start + 1e-6) & (time <= stop + 1e-6), np.float64(study.tolerance_deg)
        yield Job(
            label,
            method.bare.at_interval(spec.samples / made.imu_rate),
            models[spec.name],
            spec.name,
            where,
            judge,
        )


class Worker:
    """A device: called with the number of a block, it returns the sums of each method.

    Args:
        study: what to do.
        jobs: of all methods.
        device: which.
        first: of the jobs, that it does first: devices begin with different ones, so that they compile side by side.
    """

    def __init__(self, study: Study, jobs: list[Job], device: Any, first: int = 0):
        self.study, self.device, self.first = study, device, first
        self.programs = _programs()  # here, not in the device's thread: `cache` lets two threads make a pair each
        models = {job.spec: job.model for job in jobs}
        own = [{k: getattr(job, k) for k in _OWN} for job in jobs]
        models, own, self.seed = devices.placed((models, own, jax.random.key(study.seed)), device)
        self.jobs = [job._replace(model=models[job.spec], **some) for job, some in zip(jobs, own, strict=True)]

    def __call__(self, block: int) -> dict[str, BlockSums]:
        """Label -> the sums of the runs of a block, on the host."""
        numbers = block * self.study.block + np.arange(self.study.block)
        counted, placed = devices.placed((numbers < self.study.runs, numbers), self.device)
        draw, reduce = self.programs
        drawn: dict[str, Epochs] = {}
        out = {}
        for job in (*self.jobs[self.first :], *self.jobs[: self.first]):
            if job.spec not in drawn:
                drawn[job.spec] = draw(job.model, self.seed, placed)
            out[job.label] = reduce(job.method, drawn[job.spec], job.model.exact, job.where, job.judge, counted)
        return {job.label: jax.tree.map(np.asarray, out[job.label]) for job in self.jobs}


_OWN = ("method", "where", "judge")
