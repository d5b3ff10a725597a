"""Monte Carlo of simulate and align: the attitude errors of several methods over the same runs, every one kept.

A study (:mod:`jaxalign.study`) keeps statistics only; the experiments want the errors themselves. Run number i of a
seed has the same random numbers for every method, for any number of runs, and for every choice of the aid's faults:
differences between methods and between conditions are paired.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.progress import progress
from jaxalign.epochs import Epochs
from jaxalign.prefilter.base import without_prefilter
from jaxalign.simulate import Scenario, Truth, truth
from jaxalign.study.errors import Rows, errors_of, rows_of
from jaxalign.study.feed import World, feed_of, world_of
from jaxalign.study.feed import run_keys as keys_of

__all__ = ["Errors", "monte_carlo", "run_keys"]


class Errors(NamedTuple):
    """Errors of one method, NaN where it has no attitude.

    Attributes:
        time: (K,) s.
        phi: (runs, K, 3) deg: east, north, up, with C_est = (I - [phi x]) C_true.
        euler: (runs, K, 3) deg: pitch, roll, yaw, estimate minus truth.
    """

    time: np.ndarray
    phi: np.ndarray
    euler: np.ndarray


def run_keys(seed: int, runs: int | np.ndarray) -> jax.Array:
    """The keys of so many runs, or of the runs with these numbers."""
    return keys_of(jax.random.key(seed), jnp.arange(runs) if isinstance(runs, int) else jnp.asarray(runs))


@eqx.filter_jit
def _epochs(world: World, keys: jax.Array) -> Epochs:
    return world.epochs(keys)


@eqx.filter_jit
def _errors(method: Any, epochs: Epochs, exact: Truth, where: Rows):
    found = errors_of(method, epochs, exact, where)
    return found.phi, found.euler


def _multiples(time: np.ndarray, spacing: float) -> np.ndarray:
    """Mask of the times that are multiples of a spacing (s; 0: all)."""
    steps = time / (spacing or 1.0)
    return (np.abs(steps - np.round(steps)) < 1e-6) | (spacing == 0)


def monte_carlo(
    made: Scenario,
    methods: Mapping[str, Any],
    runs: int | np.ndarray,
    seed: int = 0,
    every: int | Mapping[str, int] = 1,
    spacing: float = 0.0,
    chunk: int = 25,
    title: str = "",
) -> dict[str, Errors]:
    """Errors of each method over the same simulated runs, the noise per IMU sample.

    Args:
        made: what to simulate, with any aid.
        methods: label -> method; the lengths of their epochs may differ (``interval_samples``).
        runs: how many, or which (their numbers).
        seed: of all the runs.
        every: epochs between two read-outs, as in :func:`jaxalign.align`; or label -> epochs.
        spacing: keep only the rows at multiples of so many seconds (0: all).
        chunk: runs at a time; sets the memory needed.
        title: of the bar on standard error.

    Returns:
        label -> errors at the read-outs, after the start, that fall on an epoch of the scenario.
    """
    exact = truth(made)
    numbers = np.arange(runs) if isinstance(runs, int) else np.asarray(runs)
    chunk = min(chunk, len(numbers))
    filled = np.resize(numbers, -(-len(numbers) // chunk) * chunk)  # the last chunk is as long as the others
    keys = run_keys(seed, filled).reshape(-1, chunk)
    feeds = {label: feed_of(method, made) for label, method in methods.items()}
    worlds: dict[str, World] = {}
    parts: dict[str, list[Any]] = {label: [] for label in methods}
    time: dict[str, np.ndarray] = {}
    with progress(title or made.name, keys.size * len(methods)) as bar:
        for some in keys:
            measured: dict[str, Epochs] = {}
            for label, method in methods.items():
                feed = feeds[label]
                if feed.name not in worlds:
                    # Without its name: scenarios that differ in numbers alone share their programs.
                    unnamed = dataclasses.replace(made, name="scenario")
                    worlds[feed.name] = world_of(unnamed, feed, jax.random.key(seed), "samples", exact)
                if feed.name not in measured:
                    measured[feed.name] = _epochs(worlds[feed.name], some)
                where = rows_of(made, feed, every if isinstance(every, int) else every[label])
                errors = _errors(without_prefilter(method), measured[feed.name], exact, where)
                times = np.asarray(exact.t)[where.places]
                kept = _multiples(times, spacing)
                parts[label].append([np.asarray(x)[:, kept] for x in errors])
                time[label] = times[kept]
                bar.update(chunk)
    out = {}
    for label, errors in parts.items():
        phi, euler = (np.concatenate(x)[: len(numbers)] for x in zip(*errors, strict=True))
        out[label] = Errors(time[label], phi, euler)
    return out
