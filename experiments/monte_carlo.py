"""Monte Carlo of simulate and align: the attitude errors of several methods over the same runs, every one kept.

A study (:mod:`jaxalign.study`) keeps statistics only; the experiments want the errors themselves. Run number i of a
seed has the same random numbers for every method, for any number of runs, and for every choice of the aid's faults:
differences between methods and between conditions are paired.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.progress import progress
from jaxalign.epochs import Epochs
from jaxalign.simulate import Scenario, Truth, truth
from jaxalign.study.epochs_spec import RunModel, epochs_spec, run_model
from jaxalign.study.epochs_spec import run_keys as keys_of
from jaxalign.study.errors import Errors, Rows, errors_of, rows_of

__all__ = ["Errors", "monte_carlo", "run_keys"]


def run_keys(seed: int, runs: int | np.ndarray) -> jax.Array:
    """The keys of so many runs, or of the runs with these numbers."""
    return keys_of(jax.random.key(seed), jnp.arange(runs) if isinstance(runs, int) else jnp.asarray(runs))


@eqx.filter_jit
def _epochs(model: RunModel, keys: jax.Array) -> Epochs:
    return model.epochs(keys)


@eqx.filter_jit
def _errors(method: Any, epochs: Epochs, exact: Truth, where: Rows) -> Errors:
    return errors_of(method, epochs, exact, where)


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
    specs = {label: epochs_spec(method, made) for label, method in methods.items()}
    models: dict[str, RunModel] = {}
    parts: dict[str, list[Any]] = {label: [] for label in methods}
    time: dict[str, np.ndarray] = {}
    with progress(title or made.name, keys.size * len(methods)) as bar:
        for some in keys:
            measured: dict[str, Epochs] = {}
            for label, method in methods.items():
                spec = specs[label]
                if spec.name not in models:
                    # Without its name: scenarios that differ in numbers alone share their programs.
                    unnamed = dataclasses.replace(made, name="scenario")
                    models[spec.name] = run_model(unnamed, spec, jax.random.key(seed), "samples", exact)
                if spec.name not in measured:
                    measured[spec.name] = _epochs(models[spec.name], some)
                where = rows_of(made, spec, every if isinstance(every, int) else every[label])
                spaced = method.bare.at_interval(spec.samples / made.imu_rate)
                errors = _errors(spaced, measured[spec.name], exact, where)
                time[label] = np.asarray(errors.time)
                kept = _multiples(time[label], spacing)
                parts[label].append([np.asarray(x)[:, kept] for x in (errors.euler, errors.phi, errors.failed)])
                time[label] = time[label][kept]
                bar.update(chunk)
    out = {}
    for label, errors in parts.items():
        euler, phi, failed = (np.concatenate(x)[: len(numbers)] for x in zip(*errors, strict=True))
        out[label] = Errors(time[label], euler, phi, failed)
    return out
