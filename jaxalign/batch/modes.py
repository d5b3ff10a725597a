"""Several solutions of one problem: a heading told from biased gyroscopes may have more than one that fits.

From a solution the search begins again with the heading turned. Solutions that fit about as well as the best count by
their likelihood in what is said of its uncertainty.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.rotation import attitude_error

__all__ = ["best_of", "turns"]

_SAME = 0.5  # times the standard deviation: nearer, two headings are one


def turns(starts: int) -> np.ndarray:
    """(starts - 1,) headings to begin again with, less that of the solution, rad."""
    return 2 * np.pi * np.arange(1, starts) / starts


def best_of(
    q_nb: Float[Array, "m 4"], tilt: Float[Array, "m 3 3"], log_likelihood: Float[Array, " m"]
) -> tuple[Array, Float[Array, "3 3"]]:
    """The most likely of several solutions, and the covariance of its attitude with the others in mind.

    Args:
        q_nb: attitudes.
        tilt: covariances of their errors in n, rad^2.
        log_likelihood: of each, with the same prior.

    Returns:
        Which is best, and the mean square of the attitude about it. Solutions that several starts have led to count
        once; NaN where no likelihood is finite.
    """
    finite = jnp.isfinite(log_likelihood)
    level = jnp.where(finite, log_likelihood, -jnp.inf)
    best = jnp.argmax(level)
    order = jnp.argsort(-level)
    count = len(q_nb)
    phi = jax.vmap(lambda a: jax.vmap(lambda b: attitude_error(b, a))(q_nb))(q_nb)  # [i, j]: from i to j
    near = jnp.abs(phi[..., 2]) < _SAME * jnp.sqrt(tilt[:, None, 2, 2])
    rank = jnp.zeros(count, int).at[order].set(jnp.arange(count))
    copy = jnp.any(near & (rank[:, None] < rank[None, :]), axis=0)
    share = jnp.where(copy | ~finite, 0.0, jnp.exp(jnp.where(finite, level - level[best], 0.0)))
    away = phi[best]
    square = tilt + away[:, :, None] * away[:, None, :]
    square = jnp.where((share > 0)[:, None, None], square, 0.0)
    mean = jnp.einsum("i,ijk->jk", share, square) / jnp.maximum(jnp.sum(share), 1.0)
    return best, jnp.where(jnp.any(finite), mean, jnp.nan)
