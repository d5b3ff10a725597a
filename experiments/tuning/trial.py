"""The tuned methods on runs that no search has seen, in the scenario they were tuned for and in another one."""

from __future__ import annotations

from typing import Any, NamedTuple

from experiments.tuning.searches import Searched
from jaxalign import with_parameters
from jaxalign.study import Study
from jaxalign.study import run as run_study

__all__ = ["Tried", "tried"]


class Tried(NamedTuple):
    """RMSE of the heading over the window, deg, and over that of the untuned method, each with its standard error."""

    rmse: dict[str, tuple[float, float]]
    ratio: dict[str, tuple[float, float]]


def tried(searched: Searched, other: bool, seed: int) -> Tried:
    """Untuned, by gradient, by genetic algorithm: over the same new runs."""
    problem = searched.problem
    methods: dict[str, Any] = {
        "untuned": problem.method,
        "gradient": with_parameters(problem.method, searched.gradient.values),
        "genetic": with_parameters(problem.method, searched.genetic.values),
    }
    made = problem.made(other)
    every = round(10.0 * made.imu_rate / made.epoch_samples)
    result = run_study(Study(made, methods, 4 * searched.runs, seed=seed + 1000, every=every))
    assert result is not None  # one process
    first = result["untuned"]

    def heading(estimate: Any) -> tuple[float, float]:
        return float(estimate.value[2]), float(estimate.error[2])

    return Tried(
        {label: heading(result[label].accuracy) for label in methods},
        {label: heading(result[label].ratio(first)) for label in methods if label != "untuned"},
    )
