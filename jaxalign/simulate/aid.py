"""Aids of a scenario: when they measure, their noise and faults, the true values of their unknowns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign.aids import AbstractAid, aid_of
from jaxalign.aids.linearization import as_components, named
from jaxalign.aids.motion import Motion
from jaxalign.errors import UserError
from jaxalign.simulate.arguments import leaf
from jaxalign.simulate.faults import AbstractFault
from jaxalign.simulate.imu import Truth
from jaxalign.simulate.random import fold, normals
from jaxalign.vector import Quat, Vec3

__all__ = ["SimulatedAid", "values_of"]

_UNKNOWN = 1000  # key of an unknown's draw


class SimulatedAid(eqx.Module):
    """An aid of a scenario.

    Attributes:
        aid: what it measures (static).
        sd: standard deviation of its white noise, in its unit: one number, or (m,) for the components.
        faults: outliers and gaps, applied in this order.
        unknowns: true values of unknowns that :meth:`AbstractAid.predict` knows, by name.
        unknown_sd: standard deviation with which each run draws an unknown about that value (or about zero).
        stride: epochs of the scenario between two values (static).
    """

    aid: AbstractAid = eqx.field(static=True)
    sd: Float[Array, "*m"]
    faults: tuple[AbstractFault, ...]
    unknowns: dict[str, Array]
    unknown_sd: dict[str, Array]
    stride: int = eqx.field(static=True)

    def __init__(
        self,
        aid: Any,
        sd: Any = 0.0,
        faults: tuple[AbstractFault, ...] = (),
        unknowns: Mapping[str, Any] | None = None,
        unknown_sd: Mapping[str, Any] | None = None,
        stride: int = 1,
    ):
        self.aid = aid_of(aid)
        if self.aid.implied:
            raise UserError(f"{self.aid.name}: an assumption about the vehicle is not simulated: leave it out")
        self.sd = leaf(sd, f"{self.aid.name}: sd", low=0.0)
        if self.sd.shape not in ((), (len(self.aid.components),)):
            raise UserError(f"{self.aid.name}: sd has shape {self.sd.shape}: one number, or one for each component")
        self.faults = tuple(faults)
        there = {own.name: 0.0 for own in self.aid.unknowns if own.always}  # a prediction may count on them
        self.unknowns = {name: self._numbers(name, x) for name, x in {**there, **(unknowns or {})}.items()}
        self.unknown_sd = {name: self._numbers(name, x, 0.0) for name, x in (unknown_sd or {}).items()}
        if isinstance(stride, bool) or not isinstance(stride, int) or stride < 1:
            raise UserError(f"{self.aid.name}: stride: must be a whole number of epochs, got {stride!r}")
        self.stride = stride

    def _numbers(self, name: str, given: Any, low: float = -np.inf) -> Array:
        known = self.aid.known_unknowns
        if name not in known or name in ("latency", "slow"):
            there = ", ".join(x for x in known if x not in ("latency", "slow")) or "none"
            raise UserError(f"{self.aid.name}: no unknown {name!r} to simulate: there is {there}")
        size = known[name].size
        numbers = leaf(given, f"{self.aid.name}.{name}", low=low)
        if numbers.shape not in ((), (size,)):
            what = "one number is" if size == 1 else f"one number or {size} are"
            raise UserError(f"{self.aid.name}.{name}: {given!r}: {what} expected")
        return jnp.broadcast_to(numbers, (size,))

    @property
    def partial(self) -> bool:
        """Whether its faults take away single components."""
        return any(fault.partial for fault in self.faults)

    @property
    def perfect(self) -> SimulatedAid:
        """The aid without noise; gaps, jumps and the values of its unknowns stay."""
        zeros = {name: jnp.zeros_like(x) for name, x in self.unknown_sd.items()}
        return eqx.tree_at(lambda a: (a.sd, a.unknown_sd), self, (jnp.zeros_like(self.sd), zeros))

    def drawn(self, key: PRNGKeyArray) -> dict[str, Array]:
        """The unknowns of a run (size,), or of runs (size, runs)."""
        out = {}
        for number, name in enumerate(sorted({*self.unknowns, *self.unknown_sd})):
            size = self.aid.known_unknowns[name].size
            value = self.unknowns.get(name, jnp.zeros(size))
            value = value.reshape(size, *(1 for _ in key.shape))
            if name in self.unknown_sd:
                z = normals(fold(key, _UNKNOWN + number), size).astype(jnp.float64).reshape(size, *key.shape)
                value = value + self.unknown_sd[name].reshape(size, *(1 for _ in key.shape)) * z
            out[name] = value
        return out

    def values(self, truth: Truth, noise: PRNGKeyArray, faults: PRNGKeyArray) -> Float[Array, "m c *runs"]:
        """What it measures at its own epochs, NaN in gaps. Pure.

        Args:
            truth: of the scenario.
            noise: key of the noise of a run, or (runs,) of them.
            faults: likewise of the faults.
        """
        runs = noise.shape
        take = slice(None, None, self.stride)

        def lifted(x: Array) -> Array:
            return x[take].reshape(-1, *(1 for _ in runs))

        attitude = jax.tree.map(lifted, Quat.of(truth.q_nb))
        velocity, rate = (Vec3(*(lifted(x[:, i]) for i in range(3))) for x in (truth.velocity_n, truth.rate_n))
        motion = Motion(attitude, velocity, rate, lifted(truth.t))
        own = {name: tuple(x) for name, x in self.drawn(noise).items()}
        parts = as_components(self.aid, self.aid.predict(motion, named(own)))
        count, size, time = len(truth.t[take]), len(parts), truth.t[take]
        z = normals(noise, size * count).astype(jnp.float64).reshape(count, size, *runs)
        error = z * (self.sd if self.sd.ndim == 0 else self.sd.reshape(1, size, *(1 for _ in runs)))
        for i, fault in enumerate(self.faults):
            spoil = fault if not runs else jax.vmap(fault, (0, None, -1), -1)
            error = spoil(fold(faults, i), time, error)
        return jnp.stack(jnp.broadcast_arrays(*parts), axis=1) + error


def values_of(
    aids: tuple[SimulatedAid, ...], truth: Truth, noise: PRNGKeyArray, faults: PRNGKeyArray, which: tuple[int, ...]
) -> tuple[Float[Array, "m c *runs"], ...]:
    """What some aids of a scenario measure at all epochs of it, NaN where one has no value. Pure.

    Each aid has draws of its own, whichever others there are.
    """
    out = []
    for number in which:
        keys = (noise, faults) if number == 0 else (fold(noise, number), fold(faults, 100 + number))
        values = aids[number].values(truth, *keys)
        if (stride := aids[number].stride) > 1:
            full = jnp.full((len(truth.t), *values.shape[1:]), jnp.nan)
            values = full.at[::stride].set(values)
        out.append(values)
    return tuple(out)
