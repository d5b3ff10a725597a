"""What is done to the aid of a scenario, and the errors of every recipe under it over the bound."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from experiments.monte_carlo import monte_carlo
from experiments.scenarios import with_aid
from jaxalign.aids import Standing
from jaxalign.bounds import bound
from jaxalign.front_end import FrontEnd
from jaxalign.method import AbstractMethod
from jaxalign.methods import RECIPES, build
from jaxalign.simulate import Scenario, scenario, truth
from jaxalign.simulate.faults import AbstractFault, FixedOutliers, Gap

__all__ = [
    "CONDITIONS",
    "FACTOR",
    "GAPS",
    "MISSTATED",
    "MOVING",
    "Ratios",
    "matched",
    "ratios",
    "recipes",
    "with_condition",
]

MOVING = ("dvl-sturn", "dvl-sway", "dvl-accturn", "gps-zigzag")
FACTOR = {"body": 300.0, "nav": 200.0}
"""Outliers: times the noise of the aid."""
MISSTATED = 1.5
GAPS = ((0.1, 0.2), (0.4, 0.5), (0.7, 0.8))
"""Without the aid, as shares of the duration."""
ROWS = 6
_COSTLY = {"dvl-accturn": 4}
"""So many times fewer runs: 1500 epochs."""

Faults = Callable[[Scenario], tuple[AbstractFault, ...]]


def _outliers(share: float, single_axis: bool = False, first: Any = "random") -> Faults:
    return lambda made: (FixedOutliers(share, FACTOR[made.aids[0].aid.kind], single_axis, first),)


CONDITIONS: dict[str, Faults] = {
    "clean": _outliers(0.0),
    "2 % outliers": _outliers(0.02),
    "10 %": _outliers(0.1),
    "30 %": _outliers(0.3),
    "bad first": _outliers(0.0, first="always"),
    "10 %, one axis": _outliers(0.1, True),
    "gaps": lambda made: tuple(Gap(a * made.duration, b * made.duration) for a, b in GAPS),
    "noise x 1.5": lambda made: (FixedOutliers(1.0, MISSTATED, False, "random"),),
}


def with_condition(made: Scenario, label: str) -> Scenario:
    """A scenario whose aid suffers that."""
    return with_aid(made, faults=CONDITIONS[label](made))


def recipes(made: Scenario) -> dict[str, Any]:
    """The library's own recipes that take the aid of a scenario, those with a model of the unit with its figures.

    Without ``auto``: once it is told the figures it is ``robust_map``.
    """
    aid = made.aids[0].aid if made.aids else Standing()
    names = [name for name, recipe in RECIPES.items() if recipe.takes(aid) and not recipe.published and name != "auto"]
    return {name: matched(build(name, aid), made) for name in names}


def matched(method: AbstractMethod, made: Scenario) -> AbstractMethod:
    """With the figures of the scenario's inertial unit, where a method has any."""
    method = method.with_imu(made.imu.at_rate(made.imu_rate))
    if method.rows_are_costly and method.standing:
        return method.with_front_end(FrontEnd(round(made.imu_rate)))
    return method


class Ratios(NamedTuple):
    """Errors over the bound.

    Attributes:
        time: (K,) s.
        bound: (K, 3) deg: east, north, heading.
        rms: label -> (K, 3), root mean square over the runs.
        high: label -> (K, 3), 99 % of the sizes.
        runs: how many.
    """

    time: np.ndarray
    bound: np.ndarray
    rms: dict[str, np.ndarray]
    high: dict[str, np.ndarray]
    runs: int


def ratios(name: str, label: str | None, runs: int, seed: int) -> Ratios:
    """Every recipe on a scenario under a condition (None: as it is)."""
    made = scenario(name, bias="gaussian")
    true = made
    if label is not None:
        made = true = with_condition(made, label)
        if label.startswith("noise"):
            true = with_aid(made, sd=MISSTATED * made.aids[0].sd)
    count = max(runs // _COSTLY.get(name, 1), 2)
    methods = recipes(made)
    every = {x: _epochs(made, method) // ROWS for x, method in methods.items()}
    found = monte_carlo(made, methods, count, seed, every, chunk=min(count, 25), title=f"{name}, {label or 'as it is'}")
    least = bound(true, truth(made))
    time = next(iter(found.values())).time
    rows = np.searchsorted(np.asarray(least.time), time - 1e-6)
    limit = np.asarray(least.phi_deg)[rows]
    phi = {x: np.where(np.isfinite(errors.phi), errors.phi, 180.0) for x, errors in found.items()}
    rms = {x: np.sqrt(np.mean(p**2, axis=0)) / limit for x, p in phi.items()}
    high = {x: np.percentile(np.abs(p), 99, axis=0) / limit for x, p in phi.items()}
    if label in (None, list(CONDITIONS)[-1]):
        jax.clear_caches()  # conditions share programs, scenarios do not
    return Ratios(time, limit, rms, high, count)


def _epochs(made: Scenario, method: AbstractMethod) -> int:
    """How many the method makes of the scenario."""
    return made.epochs * made.epoch_samples // (method.front_end.interval_samples or made.epoch_samples)
