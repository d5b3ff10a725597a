"""Huber's weight on the residual of a pair."""

from __future__ import annotations

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.arguments import check_choice
from jaxalign.observe import Context, Pair
from jaxalign.parametrization import tunable
from jaxalign.weight.base import AbstractWeight

__all__ = ["Huber"]


class Huber(AbstractWeight):
    """Full weight up to ``threshold`` standard deviations of the residual, ``threshold / r`` beyond.

    The weight is one until there is an attitude.

    Attributes:
        threshold: in standard deviations of the pair (sqrt(2) times the aid's: two velocities enter it).
        residual: "vector" (default): ``|beta - C_b0n0 alpha|`` with the last attitude read out. "norm": ``||beta| -
            |alpha||``, which needs no attitude but is blind to errors across the vector.

    Source: the weight-matching method that Shen 2025 compares with (ROBA); its original was not at hand, both residuals
    are this library's definitions (1.345 is usual for "norm").
    """

    threshold: Float[Array, ""] = tunable(2.5, unit="1", bounds=(0.1, 10.0))
    residual: Literal["vector", "norm"] = eqx.field(static=True, default="vector")

    def __check_init__(self):
        check_choice("weight.residual", self.residual, ("vector", "norm"))

    def init(self) -> Any:
        """No state."""
        return None

    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Any]:
        """Weigh one pair."""
        if self.residual == "vector":
            size = pair.residual(context.attitude).norm()
        else:
            size = jnp.abs(pair.beta.norm() - pair.alpha.norm())
        limit = self.threshold * jnp.sqrt(2.0) * context.sd
        beyond = (size > limit) & context.defined
        return state, jnp.where(beyond, limit / jnp.where(beyond, size, 1.0), 1.0)
