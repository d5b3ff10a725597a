"""The quaternion Kalman filter with the measurement noise as published: a full matrix."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.estimate.quaternion_kf import AbstractQuaternionFilter
from jaxalign.parametrization import as_float64, tunable

__all__ = ["FullNoiseQuaternionFilter"]


class FullNoiseQuaternionFilter(AbstractQuaternionFilter):
    """R is the mean of the residuals' 4x4 products.

    R then makes the heading depend on the north gyro's bias: the good figures of the paper are an accident of equal
    biases. Do not use it.

    Attributes:
        averaging: pairs are averaged over this time before they are a measurement, s; 0 (default): each pair is one.
        variance: of the elements at the start.
        prior_variance: variance of the elements of q at the start.
        start: q_n0b0 at the start, (4,), see the base class.

    Source: Xu 2017 (20)-(28). Deviations: those of the base class, and 1e-10 on the diagonal of R, which is singular.
    """

    averaging: float = eqx.field(static=True, default=0.0)
    variance: Float[Array, ""] = tunable(1e-4, unit="1", bounds=(1e-14, 10.0))
    prior_variance: Float[Array, ""] = tunable(1.0, unit="1", bounds=(1e-12, 1e6))
    start: Float[Array, " 4"] = eqx.field(converter=as_float64, default=(0.0, 0.0, 0.0, 0.0))

    def first_noise(self) -> Any:
        """The variance on the diagonal."""
        return self.variance * jnp.eye(4)

    def next_noise(self, noise: Any, residual: Any, share: Any, weight: Any) -> tuple[Any, Any]:
        """The mean of the products."""
        noise = (1.0 - share) * noise + share * weight * jnp.outer(residual, residual)
        return noise, noise + 1e-10 * jnp.eye(4)
