"""Three searches over the same runs: by gradient, by genetic algorithm, on a grid; runs and seconds counted."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from experiments.genetic import evolve
from experiments.tuning.problems import Problem
from jaxalign.tune import Prepared, Space, prepared, run

__all__ = ["EVALUATIONS", "Found", "Searched", "search"]

EVALUATIONS = 500
"""Of the genetic algorithm at most (25 generations of 20), and of the grid."""


class Found(NamedTuple):
    """What a search found.

    Attributes:
        values: path -> number.
        loss: over the runs that it learned from.
        trace: (evaluations,) the best loss so far.
        seconds: all of it, compilation included.
    """

    values: dict[str, float]
    loss: float
    trace: np.ndarray
    seconds: float

    def evaluations_to(self, loss: float) -> float:
        """Evaluations until a loss is reached; infinite if it is not."""
        reached = np.flatnonzero(self.trace <= loss)
        return float(reached[0] + 1) if len(reached) else np.inf


class Searched(NamedTuple):
    """A problem and what came out.

    Attributes:
        problem: what was tuned.
        runs: that the searches learned from.
        start: loss at the start.
        gradient: by gradient.
        genetic: by the genetic algorithm.
        grid: on a grid.
        path: path -> numbers of the gradient's steps.
        slices: path -> (numbers, losses), the others as the gradient left them.
    """

    problem: Problem
    runs: int
    start: float
    gradient: Found
    genetic: Found
    grid: Found
    path: dict[str, list[float]]
    slices: dict[str, tuple[np.ndarray, np.ndarray]]


_loss = eqx.filter_jit(lambda objective, free, batch: objective(free, batch))


class _Box:
    """Losses at shares (0..1) of the ranges of the numbers (of their logarithms)."""

    def __init__(self, space: Space, ready: Prepared):
        self.space, self.ready = space, ready

    def values(self, shares: Any) -> dict[str, float]:
        out = {}
        for path, share in zip(self.space.paths, shares, strict=True):
            bounded = self.space.maps[path]
            low, high = float(bounded.low), float(bounded.high)
            x = low + share * (high - low)
            out[path] = float(np.exp(x)) if bounded.log else float(x)
        return out

    def share(self, path: str, value: float) -> float:
        bounded = self.space.maps[path]
        low, high = float(bounded.low), float(bounded.high)
        return ((np.log(value) if bounded.log else value) - low) / (high - low)

    def loss(self, values: dict[str, float]) -> float:
        free = {path: jnp.asarray(self.space.maps[path].free(x)) for path, x in values.items()}
        loss = float(_loss(self.ready.objective, free, self.ready.batch))
        return loss if np.isfinite(loss) else 1e3


def search(problem: Problem, runs: int, seed: int, steps: int, evaluations: int = EVALUATIONS) -> Searched:
    """All three."""
    tune = problem.tune(runs, seed, steps)
    ready = prepared(tune)
    box = _Box(tune.space, ready)
    tuned = run(tune)
    trace = np.minimum.accumulate(tuned.history.loss)
    values = tuned.values
    gradient = Found(values, box.loss(values), trace, tuned.seconds)

    begun = time.perf_counter()
    evolved = evolve(lambda x: -box.loss(box.values(x)), len(tune.paths), seed)
    best = box.values(evolved.x)
    genetic = Found(best, -evolved.value, -evolved.trace, time.perf_counter() - begun)

    begun = time.perf_counter()
    each = round(evaluations ** (1 / len(tune.paths)))
    axes = np.meshgrid(*[(np.arange(each) + 0.5) / each] * len(tune.paths), indexing="ij")
    points = np.stack([x.ravel() for x in axes], axis=-1)
    losses = np.array([box.loss(box.values(x)) for x in points])
    i = int(np.argmin(losses))
    grid = Found(box.values(points[i]), losses[i], np.minimum.accumulate(losses), time.perf_counter() - begun)

    slices = {}
    for path in tune.paths:
        shares = np.linspace(0.002, 0.998, 41)
        some = [box.values([s if p == path else box.share(p, values[p]) for p in tune.paths]) for s in shares]
        slices[path] = np.array([x[path] for x in some]), np.array([box.loss(x) for x in some])
    start = tuned.history.loss[0]
    return Searched(problem, tune.runs, start, gradient, genetic, grid, tuned.history.values, slices)
