"""Has the heading become observable? The spread of the noise-free vectors against the noise of the aid."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.vector import Mat3, Vec3

__all__ = ["Spread"]


class Spread(eqx.Module):
    """``sum a a^T`` of the noise-free vectors a and their number.

    The eigengap of the 4x4 problem cannot serve: early on it measures the noise of the aid.
    """

    moments: Mat3
    count: Float[Array, "*shape"]

    @classmethod
    def zero(cls) -> Spread:
        """No vector yet."""
        return cls(Mat3.zero(), jnp.zeros((), jnp.float64))

    @classmethod
    def of(cls, vector: Vec3, used: Any) -> Spread:
        """One vector (m/s), counted where ``used``."""
        used = jnp.where(used, 1.0, 0.0)
        return cls((vector * used).outer(vector), used)

    def __add__(self, other: Spread) -> Spread:
        return jax.tree.map(jnp.add, self, other)

    def cumulated(self) -> Spread:
        """Running sums along the first axis."""
        return jax.tree.map(lambda x: jnp.cumsum(x, axis=0), self)

    def observable(self, sd: Any) -> Bool[Array, "*shape"]:
        """``4 (s2 + s3) / (8 k sd^2) > 1`` with s the eigenvalues of the sum, k the number of vectors.

        s2 + s3 is taken as the sum of the principal minors over the trace: no cancellation against the large s1, and
        short by (s2 + s3) / s1 of itself at most (half of it where all three are equal).

        Args:
            sd: standard deviation of the aid's white noise per axis, m/s.
        """
        a = self.moments
        minors = (
            (a.r0.x * a.r1.y - a.r0.y * a.r1.x)
            + (a.r0.x * a.r2.z - a.r0.z * a.r2.x)
            + (a.r1.y * a.r2.z - a.r1.z * a.r2.y)
        )
        return 4.0 * minors > 8.0 * self.count * sd * sd * a.trace
