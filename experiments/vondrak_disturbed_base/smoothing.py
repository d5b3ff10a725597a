"""The smoothing factor: by the paper's genetic algorithm, by gradient, by formula; evaluations counted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from experiments.genetic import SETTINGS, evolve
from jaxalign.prefilter import Vondrak, misfit, multitaper, vondrak
from jaxalign.published.objectives import changes_db, printed, reconstructed
from jaxalign.simulate import scenario, simulate

__all__ = ["CUTOFFS", "OBJECTIVES", "Choice", "by_genetic_algorithm", "by_gradient", "force_record", "objectives"]

CUTOFFS = (0.01, 100.0)
SPLIT = 0.5
STEPS = 60
OBJECTIVES = ("printed (27)", "reconstructed (27)", "J")
Objective = Callable[[Any], Any]


class Choice(NamedTuple):
    """What a search found.

    Attributes:
        cutoff: Hz.
        value: of the objective there.
        evaluations: of the objective (a gradient counts as one).
    """

    cutoff: float
    value: float
    evaluations: int


def force_record(condition: int, seed: int) -> tuple[np.ndarray, float]:
    """60 s of the force along the first axis (m/s^2), the mean removed, and its sampling interval (s)."""
    log = simulate(scenario("disturbed", condition=condition, duration=60.0), seed)
    force = log.dvel[:, 0] / log.dt
    return force - force.mean(), log.dt


def objectives(condition: int, seed: int) -> dict[str, Objective]:
    """Objectives to maximise over ln(cut-off / Hz), for one record; J with its sign and logarithm."""
    x, dt = force_record(condition, seed)
    t = np.arange(len(x)) * dt
    frequency, density = multitaper(x, dt)

    def changes(log_cutoff: Any) -> tuple[Any, Any]:
        after = multitaper(vondrak(t, x, jnp.exp(log_cutoff)), dt)[1]
        return changes_db(frequency, density, after, SPLIT)

    def j(log_cutoff: Any) -> Any:
        gain = Vondrak(cutoff=jnp.exp(log_cutoff)).response(frequency, dt)
        return -jnp.log(misfit(frequency, density, gain, SPLIT))

    made: dict[str, Objective] = {
        "printed (27)": lambda c: printed(*changes(c))[0],
        "reconstructed (27)": lambda c: reconstructed(*changes(c))[0],
        "J": j,
    }
    return {name: jax.jit(f) for name, f in made.items()}


def by_genetic_algorithm(objective: Objective, seed: int, threshold: float | None = SETTINGS["threshold"]) -> Choice:
    """Table 1's settings, over ln(cut-off); stops at the threshold (None: after all the generations)."""
    low, high = np.log(CUTOFFS)

    def decode(x: np.ndarray) -> float:
        return float(low + x[0] * (high - low))

    found = evolve(lambda x: float(objective(decode(x))), 1, seed, threshold)
    return Choice(float(np.exp(decode(found.x))), found.value, found.evaluations)


def by_gradient(objective: Objective, start: float) -> Choice:
    """Rprop on ln(cut-off) (steps by the sign of the gradient), from a start (Hz), within the range of the cut-off."""
    low, high = np.log(CUTOFFS)
    search = optax.rprop(0.3, max_step_size=1.0)
    slope = jax.jit(jax.grad(objective))
    at: Any = jnp.asarray(np.log(start))
    state = search.init(at)
    for _ in range(STEPS):
        step, state = search.update(-slope(at), state, at)
        at = jnp.clip(at + step, low, high)
    return Choice(float(jnp.exp(at)), float(objective(at)), STEPS)
