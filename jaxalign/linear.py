"""Small symmetric positive definite systems, any number of them at once.

As plain array operations, unrolled over the few columns: under ``vmap`` a step of the elimination is one loop over the
runs. ``jax.numpy.linalg`` calls LAPACK matrix by matrix, and on CPUs it may never return: a batched call waits, inside
a thread of XLA's pool, for work it hands to the same pool; as many such calls at once as there are threads (two
programs on two cores) wait for each other forever (seen with jaxlib 0.10.2).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

__all__ = ["cholesky", "solve_covariance", "solve_positive"]


def cholesky(a: Float[Array, "*s n n"]) -> Float[Array, "*s n n"]:
    """The lower factor L of ``a = L L'``; NaN from the column on where a pivot is not positive.

    The lower half of ``a`` is read.
    """
    size = a.shape[-1]
    columns, index = [], jnp.arange(size)
    for j in range(size):
        column = jnp.where(index < j, 0.0, a[..., :, j]) / jnp.sqrt(a[..., j : j + 1, j])
        column = jnp.where(a[..., j : j + 1, j] > 0, column, jnp.nan)
        a = a - column[..., :, None] * column[..., None, :]
        columns.append(column)
    return jnp.stack(columns, axis=-1)


def _substituted(factor: Array, b: Array) -> Array:
    """``(L L')^-1 b``, b (..., n, m)."""
    size = factor.shape[-1]
    rows: list[Any] = []
    for j in range(size):
        row = b[..., j, :] / factor[..., j, j, None]
        b = b - factor[..., :, j, None] * row[..., None, :]
        rows.append(row)
    b = jnp.stack(rows, axis=-2)
    for j in reversed(range(size)):
        rows[j] = b[..., j, :] / factor[..., j, j, None]
        b = b - factor[..., j, :, None] * rows[j][..., None, :]
    return jnp.stack(rows, axis=-2)


def _solve(a: Array, b: Array, factor: Array) -> Array:
    """The derivatives are those of ``a x = b``: only the solution is kept for them."""

    def product(x: Array) -> Array:
        return a @ x

    def solve(_: Any, b: Array) -> Array:
        return _substituted(factor, b)

    return jax.lax.custom_linear_solve(product, b, solve, symmetric=True)


def solve_positive(a: Float[Array, "*s n n"], b: Float[Array, "*s n m"]) -> Float[Array, "*s n m"]:
    """``a^-1 b`` for a symmetric positive definite a; NaN where it is not."""
    return _solve(a, b, cholesky(jax.lax.stop_gradient(a)))


def solve_covariance(s: Float[Array, "n n"], b: Float[Array, "n m"]) -> tuple[Float[Array, "n m"], Any]:
    """``S^-1 b`` for a symmetric positive definite S, and whether it is one.

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
    factor = cholesky(jax.lax.stop_gradient(scaled))
    regular = positive & (jnp.min(jnp.where(jnp.isnan(factor), 0.0, factor).diagonal()) > 1e-7)
    scaled, factor = (jnp.where(regular, x, unit) for x in (scaled, factor))
    return _solve(scaled, b * scale[:, None], factor) * scale[:, None], regular
