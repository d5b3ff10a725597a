"""The genetic algorithm that the papers tune with: Table 1 of the Vondrak paper, bits of each number."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

__all__ = ["BITS", "GENERATIONS", "SETTINGS", "Evolved", "evolve"]

SETTINGS = {"population": 20, "crossover": 0.7, "mutation": 0.05, "threshold": 0.995}
BITS, GENERATIONS = 20, 25


class Evolved(NamedTuple):
    """What it found.

    Attributes:
        x: (p,) the best numbers, each in 0..1.
        value: of the fitness there.
        evaluations: of the fitness.
        trace: the best fitness after each evaluation.
    """

    x: np.ndarray
    value: float
    evaluations: int
    trace: np.ndarray


def evolve(fitness: Callable[[np.ndarray], float], count: int, seed: int, threshold: float | None = None) -> Evolved:
    """Make a fitness of some numbers in 0..1 large.

    Args:
        fitness: (p,) -> number.
        count: p.
        seed: of everything random.
        threshold: stop when it is reached (roulette wheel, as published); None: after all the generations (tournament).
    """
    import pygad

    seen: list[float] = []

    def decode(bits: np.ndarray) -> np.ndarray:
        return bits.reshape(count, BITS) @ 2.0 ** np.arange(BITS)[::-1] / (2**BITS - 1)

    def judge(_: Any, bits: np.ndarray, __: int) -> float:
        seen.append(float(fitness(decode(np.asarray(bits)))))
        return seen[-1]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        search = pygad.GA(
            num_generations=GENERATIONS,
            sol_per_pop=int(SETTINGS["population"]),
            num_parents_mating=int(SETTINGS["population"]) // 2,
            num_genes=BITS * count,
            gene_type=int,
            gene_space=[0, 1],
            fitness_func=judge,
            parent_selection_type="rws" if threshold is not None else "tournament",
            crossover_type="single_point",
            crossover_probability=SETTINGS["crossover"],
            mutation_type="random",
            mutation_probability=SETTINGS["mutation"],
            stop_criteria=None if threshold is None else f"reach_{threshold}",
            random_seed=seed,
            suppress_warnings=True,
        )
        search.run()
    bits, value, _ = search.best_solution(search.last_generation_fitness)
    return Evolved(decode(np.asarray(bits)), float(value), len(seen), np.maximum.accumulate(seen))
