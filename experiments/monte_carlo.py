"""Monte Carlo of simulate and align: the attitude errors of several methods over the same runs.

Run number i of a seed has the same random numbers for every method, for any number of runs, and for every choice of
the aid's faults: differences between methods and between conditions are paired.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.progress import Progress
from jaxalign import Epochs, UserError, epochs_from_arrays, estimate_aid_sd, parameters
from jaxalign.prefilter import AbstractPrefilter
from jaxalign.rotation import attitude_error, euler_from_quat, quat_from_dcm
from jaxalign.simulate import Scenario, Truth, measure, truth

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
    numbers = jnp.arange(runs) if isinstance(runs, int) else jnp.asarray(runs)
    return jax.vmap(lambda i: jax.random.fold_in(jax.random.key(seed), i))(numbers)


@eqx.filter_jit
def _epochs(
    exact: Truth, made: Scenario, keys: jax.Array, aid: str, samples: int, prefilter: AbstractPrefilter | None = None
) -> Epochs:
    """Measure, filter and preintegrate: epochs of all the runs, of so many samples each."""

    def run(key):
        dtheta, dvel, velocity = measure(exact, made, key)
        if aid == "static":
            velocity = None
        elif made.aid_every != samples:  # epochs between two fixes have no aid
            ratio = made.aid_every // samples
            sparse = jnp.full((made.epochs * ratio + 1, 3), jnp.nan)
            velocity = sparse.at[::ratio].set(velocity)
        used = made.samples // samples * samples
        return epochs_from_arrays(
            dtheta[:used],
            dvel[:used],
            velocity,
            dt=1.0 / made.imu_rate,
            every=samples,
            site=made.site,
            aid=aid,  # pyright: ignore[reportArgumentType]
            aid_sd=made.aid_sd,  # pyright: ignore[reportArgumentType]
            prefilter=prefilter,
        )

    return jax.vmap(run)(keys)


@eqx.filter_jit
def _errors(method: Any, epochs: Epochs, every: int, rows: np.ndarray, reference: jax.Array):
    """Errors phi and Euler (deg) of all the runs at some rows of the solution."""

    def run(epochs):
        found = method.solve(epochs, every)
        q, defined = found.q_nb[rows], found.defined[rows, None]
        euler = jnp.rad2deg(euler_from_quat(q) - euler_from_quat(reference))
        errors = jnp.rad2deg(attitude_error(q, reference)), (euler + 180.0) % 360.0 - 180.0
        return tuple(jnp.where(defined, x, jnp.nan) for x in errors)

    return jax.vmap(run)(epochs)


def _samples(method: Any, made: Scenario) -> int:
    """IMU samples per epoch of a method: its own, or the scenario's."""
    samples = getattr(getattr(method, "observe", method), "interval_samples", None) or made.aid_every
    if method.aid != "static" and made.aid_every % samples:
        raise UserError(f"interval_samples = {samples} must divide the {made.aid_every} IMU samples between fixes")
    return samples


def _rows(made: Scenario, samples: int, every: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the solution at which the truth is known, and their places in the truth."""
    last = made.samples // samples
    epochs = np.unique([*range(0, last + 1, every), last])
    rows = np.flatnonzero(epochs * samples % made.aid_every == 0)
    return rows, epochs[rows] * samples // made.aid_every


def _multiples(time: np.ndarray, spacing: float) -> np.ndarray:
    """Mask of the times that are multiples of a spacing (s; 0: all)."""
    steps = time / (spacing or 1.0)
    return (np.abs(steps - np.round(steps)) < 1e-6) | (spacing == 0)


def _with_noise(epochs: Epochs, sd: dict[Any, float], key: Any, raw: Callable[[], Epochs]) -> Epochs:
    """A standing vehicle's noise, estimated from the first run as measured, as :func:`jaxalign.align` does."""
    if key not in sd:
        sd[key] = estimate_aid_sd(jax.tree.map(lambda x: x[0], raw()))
    return eqx.tree_at(lambda e: e.aid_sd, epochs, jnp.full_like(epochs.aid_sd, sd[key]))


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
    """Errors of each method over the same simulated runs.

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
        label -> errors at the read-outs that fall on an epoch of the scenario.
    """
    exact = truth(made)
    reference = jax.jit(quat_from_dcm)(exact.C_nb)
    numbers = np.arange(runs) if isinstance(runs, int) else np.asarray(runs)
    chunk = min(chunk, len(numbers))
    filled = np.resize(numbers, -(-len(numbers) // chunk) * chunk)  # the last chunk is as long as the others
    keys = run_keys(seed, filled).reshape(-1, chunk)
    parts: dict[str, list[Any]] = {label: [] for label in methods}
    time: dict[str, np.ndarray] = {}
    sd: dict[Any, float] = {}
    with Progress(title or made.name, keys.size * len(methods)) as bar:
        for some in keys:
            measured: dict[Any, Epochs] = {}
            for label, method in methods.items():
                aid, samples, prefilter = method.aid, _samples(method, made), method.prefilter
                key = aid, samples, repr(prefilter and (type(prefilter).__name__, parameters(prefilter)))
                if key not in measured:
                    epochs = _epochs(exact, made, some, aid, samples, prefilter)
                    if aid == "static":
                        raw = partial(_epochs, exact, made, some[:1], aid, samples)
                        epochs = _with_noise(epochs, sd, (aid, samples), raw)
                    measured[key] = epochs
                stride = every if isinstance(every, int) else every[label]
                rows, places = _rows(made, samples, stride)
                errors = _errors(method, measured[key], stride, rows, reference[places])
                kept = _multiples(np.asarray(exact.t)[places], spacing)
                parts[label].append([np.asarray(x)[:, kept] for x in errors])
                time[label] = np.asarray(exact.t)[places][kept]
                bar.advance(chunk)
    out = {}
    for label, errors in parts.items():
        phi, euler = (np.concatenate(x)[: len(numbers)] for x in zip(*errors, strict=True))
        out[label] = Errors(time[label], phi, euler)
    return out
