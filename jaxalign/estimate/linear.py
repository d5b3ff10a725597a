"""Solving with a covariance, knowing whether it can be inverted."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Float

__all__ = ["solve_covariance"]


def solve_covariance(s: Float[Array, "n n"], b: Float[Array, "n m"]) -> tuple[Float[Array, "n m"], Any]:
    """``S^-1 b`` for a symmetric positive definite S.

    Returns:
        The solution, and whether S is one: its Cholesky factor, scaled to a unit diagonal, has no diagonal element
        below 1e-7 (a condition of about 1e14). Where it is not, the solution is that of the unit matrix: finite, in
        value and gradient, and not to be used.
    """
    diagonal = jnp.diagonal(s)
    positive = jnp.all(diagonal > 0) & jnp.all(jnp.isfinite(s))
    scale = jnp.where(positive, 1.0 / jnp.sqrt(jnp.where(positive, diagonal, 1.0)), 1.0)
    unit = jnp.eye(len(s))
    scaled = jnp.where(positive, s * scale[:, None] * scale, unit)
    factor = jnp.linalg.cholesky(jax.lax.stop_gradient(scaled))
    regular = positive & (jnp.min(jnp.where(jnp.isnan(factor), 0.0, factor).diagonal()) > 1e-7)
    solution = cho_solve(cho_factor(jnp.where(regular, scaled, unit), lower=True), b * scale[:, None])
    return solution * scale[:, None], regular
