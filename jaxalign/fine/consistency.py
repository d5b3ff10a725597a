"""Is a filter's covariance honest? Normalised squares of errors and innovations, and their chi-square bands."""

from __future__ import annotations

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxalign.errors import UserError
from jaxalign.linear import solve_positive

__all__ = ["chi_square_band", "nees", "nis"]


def _normalised_square(x: ArrayLike, covariance: ArrayLike) -> Array:
    x, covariance = jnp.asarray(x), jnp.asarray(covariance)
    # Units differ by orders of magnitude: solve for the correlation matrix instead.
    sd = jnp.sqrt(jnp.diagonal(covariance, axis1=-2, axis2=-1))
    z = x / sd
    correlation = covariance / (sd[..., :, None] * sd[..., None, :])
    return jnp.sum(z * solve_positive(correlation, z[..., None])[..., 0], axis=-1)


def nees(error: Float[ArrayLike, "*s n"], covariance: Float[ArrayLike, "*s n n"]) -> Float[Array, "*s"]:
    """Normalised estimation error squared, ``e^T P^-1 e``: mean n if the covariance is honest.

    Args:
        error: estimate minus truth of some states.
        covariance: of these states, with positive variances.
    """
    return _normalised_square(error, covariance)


def nis(innovation: Float[ArrayLike, "*s m"], covariance: Float[ArrayLike, "*s m m"]) -> Float[Array, "*s"]:
    """Normalised innovation squared: mean m if the filter's model is right; needs no truth.

    Args:
        innovation: ``Solution.filter.innovation``, rows with an update only.
        covariance: ``Solution.filter.innovation_covariance``.
    """
    return _normalised_square(innovation, covariance)


def chi_square_band(degrees: int, count: int, probability: float = 0.95) -> tuple[float, float]:
    """Where the mean of so many independent normalised squares lies with that probability.

    Args:
        degrees: of freedom of each: the number of states or measurements.
        count: independent runs (or epochs of innovations).
        probability: of the band, two-sided.

    Raises:
        UserError: no degree or count, or a probability outside 0..1.
    """
    if degrees < 1 or count < 1 or not 0 < probability < 1:
        raise UserError(f"chi_square_band: {degrees} degrees, {count} runs, probability {probability}")
    from scipy.stats import chi2

    tail = (1 - probability) / 2
    low, high = chi2.ppf([tail, 1 - tail], degrees * count) / count
    return float(low), float(high)
