"""What goes wrong with an aid: outliers and gaps, as composable modules.

Each maps the aid's error (M+1, components) to another: ``fault(key, t, error) -> error``. Apply several one after the
other. Pure, to be vmapped over keys. Epoch 0 is spared by default, because its velocity enters every vector.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxalign.arguments import check_choice
from jaxalign.errors import UserError
from jaxalign.simulate.arguments import leaf
from jaxalign.simulate.random import normals

__all__ = ["AbstractFault", "DeadComponent", "First", "FixedOutliers", "Gap", "JumpOutliers", "SegmentOutliers"]

First = Literal["never", "random", "always"]
_FIRST = ("never", "random", "always")


class AbstractFault(eqx.Module):
    """A change of the aid's error."""

    partial: ClassVar[bool] = False
    """Whether it takes away single components."""

    @abstractmethod
    def __call__(self, key: PRNGKeyArray, t: Float[Array, " m"], error: Float[Array, "m c"]) -> Float[Array, "m c"]:
        """The error with the fault in it (m/s); t are the times of the epochs (s)."""


def _hits(key: PRNGKeyArray, probability: Any, epochs: int, first: First) -> Bool[Array, " epochs"]:
    """Which epochs are hit."""
    hit = jax.random.uniform(key, (epochs,), jnp.float64) < probability
    return hit if first == "random" else hit.at[0].set(first == "always")


def _axes(key: PRNGKeyArray, epochs: int, single_axis: bool, size: int) -> Bool[Array, "epochs c"]:
    """Which axes of an epoch are hit, if it is: all, or one at random."""
    if not single_axis:
        return jnp.ones((epochs, size), bool)
    return jax.random.randint(key, (epochs,), 0, size)[:, None] == jnp.arange(size)


class FixedOutliers(AbstractFault):
    """With a fixed probability the noise of an epoch is multiplied by a factor.

    Xu et al. (2020) (41): 2 %, 300 times (0.1 -> 30 m/s), all axes at once; its (23) has e_i, a single axis.
    Shen et al. (2025), first simulation: 2 %, 200 times.

    Attributes:
        probability: per epoch.
        factor: of the noise.
        single_axis: hit one random axis instead of the whole vector.
        first: whether epoch 0 is hit "never", at "random" like the others, or "always".
    """

    probability: Float[Array, ""]
    factor: Float[Array, ""]
    single_axis: bool = eqx.field(static=True)
    first: First = eqx.field(static=True)

    def __init__(self, probability: Any = 0.02, factor: Any = 300.0, single_axis: bool = False, first: First = "never"):
        self.probability = leaf(probability, "outlier probability", 0.0, 1.0)
        self.factor = leaf(factor, "outlier factor", low=0.0)
        self.single_axis = bool(single_axis)
        self.first = check_choice("first", first, _FIRST)

    def hits(self, key: PRNGKeyArray, t: Float[Array, " m"], size: int = 3) -> Bool[Array, "m c"]:
        """Which of so many components this key hits."""
        key_hit, key_axis = jax.random.split(key)
        hit = _hits(key_hit, self.probability, t.shape[0], self.first)
        return hit[:, None] & _axes(key_axis, t.shape[0], self.single_axis, size)

    def __call__(self, key: PRNGKeyArray, t: Float[Array, " m"], error: Float[Array, "m c"]) -> Float[Array, "m c"]:
        """The error (m/s), multiplied where hit."""
        return jnp.where(self.hits(key, t, error.shape[1]), error * self.factor, error)


class SegmentOutliers(AbstractFault):
    """Outliers whose probability and factor change from one segment of time to the next.

    Shen et al. (2025), second simulation; the defaults are its Table 3. Epochs on a boundary belong to the
    later segment; the last one goes on for ever.

    Attributes:
        ends: (s,) ends of the segments, s, increasing.
        probability: (s,) per epoch.
        factor: (s,) of the noise.
        single_axis: hit one random axis instead of the whole vector.
        first: whether epoch 0 is hit "never", at "random" like the others, or "always".
    """

    ends: Float[Array, " s"]
    probability: Float[Array, " s"]
    factor: Float[Array, " s"]
    single_axis: bool = eqx.field(static=True)
    first: First = eqx.field(static=True)

    def __init__(
        self,
        ends: Any = (60.0, 120.0, 180.0, 240.0, 300.0),
        probability: Any = (0.001, 0.010, 0.015, 0.020, 0.020),
        factor: Any = (10.0, 50.0, 100.0, 150.0, 200.0),
        single_axis: bool = False,
        first: First = "never",
    ):
        self.ends = jnp.atleast_1d(leaf(ends, "ends of the outlier segments", low=0.0))
        self.probability = jnp.atleast_1d(leaf(probability, "outlier probability", 0.0, 1.0))
        self.factor = jnp.atleast_1d(leaf(factor, "outlier factor", low=0.0))
        if not self.ends.shape == self.probability.shape == self.factor.shape:
            raise UserError(
                f"SegmentOutliers: {self.ends.size} ends, {self.probability.size} probabilities and "
                f"{self.factor.size} factors; give one of each per segment"
            )
        if not isinstance(self.ends, Tracer) and np.any(np.diff(np.asarray(self.ends)) <= 0):
            raise UserError(f"SegmentOutliers: the ends of the segments must increase, got {ends!r}")
        self.single_axis = bool(single_axis)
        self.first = check_choice("first", first, _FIRST)

    def _segment(self, t: Float[Array, " m"]) -> Array:
        index = jnp.searchsorted(self.ends, t, side="right")
        return jnp.minimum(index, self.ends.shape[0] - 1)

    def hits(self, key: PRNGKeyArray, t: Float[Array, " m"], size: int = 3) -> Bool[Array, "m c"]:
        """Which of so many components this key hits."""
        key_hit, key_axis = jax.random.split(key)
        hit = _hits(key_hit, self.probability[self._segment(t)], t.shape[0], self.first)
        return hit[:, None] & _axes(key_axis, t.shape[0], self.single_axis, size)

    def __call__(self, key: PRNGKeyArray, t: Float[Array, " m"], error: Float[Array, "m c"]) -> Float[Array, "m c"]:
        """The error (m/s), multiplied where hit."""
        factor = self.factor[self._segment(t)][:, None]
        return jnp.where(self.hits(key, t, error.shape[1]), error * factor, error)


class JumpOutliers(AbstractFault):
    """With a fixed probability a jump of random direction and uniform size is added, as GNSS fixes do.

    Attributes:
        probability: per epoch.
        low: least size, m/s.
        high: largest size, m/s.
        first: whether epoch 0 is hit "never", at "random" like the others, or "always".
    """

    probability: Float[Array, ""]
    low: Float[Array, ""]
    high: Float[Array, ""]
    first: First = eqx.field(static=True)

    def __init__(self, probability: Any = 0.02, low: Any = 20.0, high: Any = 50.0, first: First = "never"):
        self.probability = leaf(probability, "outlier probability", 0.0, 1.0)
        self.low = leaf(low, "least jump", low=0.0)
        self.high = leaf(high, "largest jump", low=0.0)
        self.first = check_choice("first", first, _FIRST)

    def hits(self, key: PRNGKeyArray, t: Float[Array, " m"], size: int = 3) -> Bool[Array, "m c"]:
        """Which of so many components this key hits."""
        hit = _hits(jax.random.split(key, 3)[0], self.probability, t.shape[0], self.first)
        return jnp.broadcast_to(hit[:, None], (t.shape[0], size))

    def __call__(self, key: PRNGKeyArray, t: Float[Array, " m"], error: Float[Array, "m c"]) -> Float[Array, "m c"]:
        """The error (m/s) with the jumps added."""
        _, key_direction, key_size = jax.random.split(key, 3)
        size = error.shape[1]
        direction = normals(key_direction, size * t.shape[0]).astype(jnp.float64).reshape(-1, size)
        direction = direction / jnp.linalg.norm(direction, axis=-1, keepdims=True)
        length = jax.random.uniform(key_size, t.shape, jnp.float64)
        length = self.low + (self.high - self.low) * length
        return jnp.where(self.hits(key, t, error.shape[1]), error + direction * length[:, None], error)


class Gap(AbstractFault):
    """No aid from `start` to `stop` (s, both included): NaN there.

    Attributes:
        start: s.
        stop: s.
    """

    start: Float[Array, ""]
    stop: Float[Array, ""]

    def __init__(self, start: Any, stop: Any):
        self.start = leaf(start, "start of the gap")
        self.stop = leaf(stop, "end of the gap")
        concrete = not isinstance(self.start, Tracer) and not isinstance(self.stop, Tracer)
        if concrete and float(self.stop) < float(self.start):
            raise UserError(f"Gap: it ends ({stop} s) before it starts ({start} s)")

    def __call__(self, key: PRNGKeyArray, t: Float[Array, " m"], error: Float[Array, "m c"]) -> Float[Array, "m c"]:
        """The error, NaN in the gap (with a microsecond's tolerance)."""
        inside = (t >= self.start - 1e-6) & (t <= self.stop + 1e-6)
        return jnp.where(inside[:, None], jnp.nan, error)


class DeadComponent(AbstractFault):
    """No value of one component from `start` to `stop` (s, both included): NaN there.

    Attributes:
        component: its number, from 0.
        start: s.
        stop: s.
    """

    partial: ClassVar[bool] = True
    start: Float[Array, ""]
    stop: Float[Array, ""]
    component: int = eqx.field(static=True)

    def __init__(self, component: int, start: Any = 0.0, stop: Any = 1e9):
        if isinstance(component, bool) or not isinstance(component, int) or component < 0:
            raise UserError(f"component: must be a whole number from 0, got {component!r}")
        self.component = component
        self.start = leaf(start, "start of the gap")
        self.stop = leaf(stop, "end of the gap")

    def __call__(self, key: PRNGKeyArray, t: Float[Array, " m"], error: Float[Array, "m c"]) -> Float[Array, "m c"]:
        """The error, NaN in the gap (with a microsecond's tolerance)."""
        if self.component >= error.shape[1]:
            raise UserError(f"component {self.component}: the aid has {error.shape[1]} (counted from 0)")
        inside = (t >= self.start - 1e-6) & (t <= self.stop + 1e-6)
        own = jnp.arange(error.shape[1]) == self.component
        return jnp.where(inside[:, None] & own, jnp.nan, error)
