"""How noisy a direction is, for the filters of K: a constant, or what the aid's noise makes of it."""

from __future__ import annotations

from typing import Any, Literal

import jax.numpy as jnp

from jaxalign.errors import UserError
from jaxalign.observe import AbstractObserve, Context, Pair

__all__ = ["NOISES", "Noise", "check_noise", "direction_information"]

Noise = Literal["physical", "constant"]
NOISES = ("physical", "constant")


def check_noise(noise: str, observe: AbstractObserve) -> None:
    """Refuse the physical noise of velocities for the vectors of a standing vehicle.

    Raises:
        UserError: says what to choose.
    """
    if noise == "physical" and observe.steps:
        raise UserError(
            "estimate.measurement_noise = 'physical' is that of a velocity aid: for a standing vehicle take 'constant'"
        )


def direction_information(noise: Noise, variance: Any, context: Context, pair: Pair) -> Any:
    """One over the variance of a direction per axis across it, 1/rad^2; zero for a null pair.

    "physical": two velocities enter a vector, so that the variance is ``2 sd^2 / |alpha|^2``; "constant": ``variance``.

    Source: Huang (20)-(22) as repaired: the first velocity's noise counts too, and the length divides.
    """
    length2 = pair.alpha.norm2()
    if noise == "constant":
        return jnp.where(length2 > 0, 1.0 / variance, 0.0)
    return length2 / (2.0 * jnp.maximum(context.sd, 1e-9) ** 2)
