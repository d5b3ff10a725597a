"""From free numbers to the loss of a batch of runs, with its derivative in either mode."""

from __future__ import annotations

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign.epochs import Epochs
from jaxalign.prefilter import misfit, multitaper
from jaxalign.simulate import Scenario, Truth, measure
from jaxalign.study.epochs_spec import RunModel
from jaxalign.study.errors import Rows, errors_of
from jaxalign.tune.losses import RunErrors
from jaxalign.tune.space import Space

__all__ = ["AlignmentObjective", "Mode", "SpectralObjective", "density_of", "loss_and_slope", "recorded", "taken"]

Mode = Literal["forward", "reverse"]
_LANES = 40  # runs side by side: what they leave for reverse mode stays below 20 kB per run in a batch of 256
_UNKNOWN_DEG = 180.0 / np.sqrt(3.0)
_SPECTRUM_S = 60.0


class AlignmentObjective(eqx.Module):
    """The loss of the attitude errors of a batch of runs.

    Attributes:
        space: what is tuned.
        loss: function of :class:`RunErrors`.
        model: of the runs, for a prefilter that is tuned: the batch is their keys. None: the batch is their epochs.
        exact: the truth.
        where: the read-outs within the window.
        time: (K,) s, of them.
        interval: between epochs, s (static).
    """

    space: Space
    loss: Any
    model: RunModel | None
    exact: Truth
    where: Rows
    time: Float[Array, " K"]
    interval: float = eqx.field(static=True)

    def __call__(self, free: Any, batch: Epochs | PRNGKeyArray) -> Float[Array, ""]:
        """The loss with these free numbers. Pure."""
        method = self.space.method(free)
        return self.loss(self.judged(method, batch))

    def judged(self, method: Any, batch: Epochs | PRNGKeyArray) -> RunErrors:
        """Errors of a method over a batch, a few runs at a time: reverse mode keeps those of one group."""
        count = _count(batch)
        lanes = min(_LANES, count)
        groups = -(-count // lanes)
        index = np.minimum(np.arange(groups * lanes), count - 1)  # the last group is filled with the last run

        def of(group: Any) -> tuple[Any, Any]:
            epochs = taken(batch, group)
            if self.model is not None:
                model = eqx.tree_at(lambda w: w.spec.prefilter, self.model, method.front_end.prefilter)
                epochs = model.epochs(epochs)
            errors = errors_of(method.at_interval(self.interval), epochs, self.exact, self.where)
            return errors.euler, errors.phi

        found = jax.lax.map(jax.checkpoint(of, prevent_cse=False), index.reshape(groups, lanes))
        found = jax.tree.map(lambda x: x.reshape(groups * lanes, *x.shape[2:])[:count], found)
        euler, phi = (jnp.where(jnp.isfinite(x), x, _UNKNOWN_DEG) for x in found)
        return RunErrors(euler, phi, self.time)


def _count(batch: Any) -> int:
    return batch.rows.dvel.x.shape[-1] if isinstance(batch, Epochs) else len(batch)


def taken(batch: Any, runs: Any) -> Any:
    """Some runs of a batch: of its epochs, which have the runs on the last axis, or of its keys."""
    if not isinstance(batch, Epochs):
        return batch[runs]
    rows = jax.tree.map(lambda x: x[..., runs] if x.ndim > 1 else x, batch.rows)
    return eqx.tree_at(lambda e: e.rows, batch, rows)


class SpectralObjective(eqx.Module):
    """The misfit of a prefilter's response.

    Attributes:
        space: what is tuned.
        split: Hz.
        dt: s between samples.
        count: samples of the record that the density is of.
    """

    space: Space
    split: float = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    count: int = eqx.field(static=True)

    def __call__(self, free: Any, batch: Float[Array, " F"]) -> Float[Array, ""]:
        """The loss with these free numbers, for a density of the force."""
        frequency = np.fft.rfftfreq(self.count, self.dt)
        gain = self.space.method(free).front_end.prefilter.response(frequency, self.dt)
        return jnp.log(misfit(frequency, batch, gain, self.split))


def recorded(made: Scenario) -> int:
    """Samples of the records of :func:`density_of`."""
    return min(made.samples, round(_SPECTRUM_S * made.imu_rate))


def density_of(exact: Truth, made: Scenario, keys: PRNGKeyArray) -> np.ndarray:
    """Density of the force, (m/s^2)^2/Hz, mean over the axes of at most 60 s of each run."""
    dt, count = 1.0 / made.imu_rate, recorded(made)
    draw = eqx.filter_jit(lambda key: measure(exact, made, key)[1][:count] / dt)
    total: Any = 0.0
    for key in keys:
        total = total + np.asarray(multitaper(draw(key).T, dt)[1]).mean(axis=0)
    return total / len(keys)


def loss_and_slope(objective: Any, free: Any, batch: Any, mode: Mode) -> tuple[Any, Any]:
    """The loss and its derivative: one forward pass with a tangent per number, or one backward."""
    if mode == "reverse":
        return eqx.filter_value_and_grad(lambda f: objective(f, batch))(free)
    flat, unravel = ravel_pytree(free)

    def along(tangent: Any) -> tuple[Any, Any]:
        return jax.jvp(lambda x: objective(unravel(x), batch), (flat,), (tangent,))

    value, slope = jax.vmap(along, out_axes=(None, 0))(jnp.eye(len(flat)))
    return value, unravel(slope)
