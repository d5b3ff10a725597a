"""What the experiments with a Doppler log share: conditions, statistics of the last seconds, outliers, weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.figures import finish, panels
from experiments.monte_carlo import Errors, monte_carlo, run_keys
from experiments.statistics import at, between, per_run, rms
from jaxalign import Log, align
from jaxalign.methods import build
from jaxalign.simulate import Scenario, aid_values, scenario, simulate, truth
from jaxalign.tables import Estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "accuracy",
    "conditions",
    "early_hits",
    "last",
    "log_with_outliers",
    "methods",
    "run_weights",
    "spread",
    "weights_over_time",
    "yaw_at",
]

LAST_S = 50.0
"""RMSE over the last 50 s: Shen et al. (2025), section 4.1.2."""

Choice = tuple[str, dict[str, Any]]


def methods(chosen: Mapping[str, Choice]) -> dict[str, Any]:
    """Label -> method, from label -> (recipe, parameters)."""
    return {label: build(name, "body", parameters) for label, (name, parameters) in chosen.items()}


def conditions(
    name: str,
    options: Mapping[str, dict[str, Any]],
    chosen: Mapping[str, Choice],
    runs: Any,
    seed: int,
    variant: Callable[[Any], Any] | None = None,
    **how: Any,
) -> dict[str, dict[str, Errors]]:
    """Condition -> label -> errors, on the same runs; of a variant (method -> method) of the methods."""
    made = methods(chosen)
    if variant is not None:
        made = {label: variant(method) for label, method in made.items()}
    return {
        condition: monte_carlo(scenario(name, **option), made, runs, seed, title=f"{name}, {condition}", **how)
        for condition, option in options.items()
    }


def last(errors: Errors) -> np.ndarray:
    """(runs, rows, 3) errors in pitch, roll, yaw (deg) over the last 50 s."""
    return errors.euler[:, between(errors.time, errors.time[-1] - LAST_S, errors.time[-1])]


def accuracy(errors: Errors) -> list[Estimate]:
    """RMSE over the last 50 s and all runs: pitch, roll, yaw (deg)."""
    return [rms(last(errors)[..., i]) for i in range(3)]


def spread(errors: Errors) -> list[float]:
    """Median, 95 % and largest of the runs' yaw RMSE over the last 50 s (deg)."""
    each = per_run(last(errors)[..., 2])
    return [float(np.median(each)), float(np.percentile(each, 95)), float(each.max())]


def yaw_at(errors: Errors, t: float) -> Estimate:
    """RMSE of yaw over the runs at one time (deg)."""
    return rms(errors.euler[:, at(errors.time, t), 2:])


def early_hits(name: str, outliers: dict[str, Any], runs: int, seed: int, before: float) -> np.ndarray:
    """(runs,) whether an outlier falls into the first seconds of a run."""
    clean, bad = scenario(name), scenario(name, **outliers)
    exact = truth(clean)

    @jax.jit
    def hit(key: Any) -> Any:
        (one,), (other,) = (aid_values(exact, made, key) for made in (clean, bad))
        wrong = one != other  # all the other draws are the same
        return jnp.any(wrong & (exact.t <= before)[:, None])

    return np.asarray(jax.vmap(hit)(run_keys(seed, runs)))


def log_with_outliers(name: str, outliers: dict[str, Any], seed: int) -> tuple[Log, np.ndarray]:
    """One log, and which of its velocities are outliers."""
    made: Scenario = scenario(name, **outliers)
    log, clean = simulate(made, seed), simulate(name, seed)
    return log, np.any(log.aids[0].value != clean.aids[0].value, axis=1)


def run_weights(chosen: Mapping[str, Choice], log: Log) -> dict[str, np.ndarray]:
    """Label -> the weight of each vector of one log."""
    return {label: np.asarray(align(method, log).weight) for label, method in methods(chosen).items()}


def weights_over_time(found: dict[str, np.ndarray], log: Log, hit: np.ndarray, title: str) -> Figure:
    """The weights of each method, outliers marked."""
    axes = panels(len(found), 1, height=1.0 + 1.7 * len(found), sharex=True)
    time = log.times - log.t0
    for axis, (label, weight) in zip(axes[:, 0], found.items(), strict=True):
        for mask, text, style in ((~hit, "good velocity", "C0."), (hit, "outlier", "C3x")):
            axis.plot(time[mask], weight[mask], style, markersize=3 if style == "C0." else 5, label=text)
        axis.set_ylabel("weight (1)")
        axis.set_ylim(-0.05, 1.05)
        axis.set_title(label, fontsize="medium")
    axes[-1, 0].set_xlabel("time (s)")
    return finish(axes, title)
