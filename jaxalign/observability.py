"""Has the heading become observable? The spread of the noise-free vectors against their noise."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxalign.vector import Mat3, Vec3

__all__ = ["Observability"]

_HEADING_SD = np.deg2rad(10.0)


class Observability(eqx.Module):
    """``sum a a^T`` and ``sum a`` of the noise-free vectors a (m/s), and their number.

    The eigengap of the 4x4 problem cannot serve: early on it measures the noise of the aid.
    """

    moments: Mat3
    total: Vec3
    count: Float[Array, "*shape"]

    @classmethod
    def zero(cls) -> Observability:
        """No vector yet."""
        return cls(Mat3.zero(), Vec3.zero(), jnp.zeros((), jnp.float64))

    @classmethod
    def of(cls, vector: Vec3, used: Any) -> Observability:
        """One vector (m/s), counted where ``used``; a null vector (the first epoch) is none."""
        used = jnp.where(used & (vector.norm2() > 0), 1.0, 0.0)
        counted = vector * used
        return cls(counted.outer(vector), counted, used)

    def __add__(self, other: Observability) -> Observability:
        return jax.tree.map(jnp.add, self, other)

    def cumulated(self) -> Observability:
        """Running sums along the first axis."""
        return jax.tree.map(lambda x: jnp.cumsum(x, axis=0), self)

    def scatter(self) -> Any:
        """Sum of the squared distances of the vectors from their mean."""
        return self.moments.trace - self.total.norm2() / jnp.where(self.count > 0, self.count, 1.0)

    def observable(self, sd: Any, steps: bool = False) -> Bool[Array, "*shape"]:
        """Whether the directions have opened beyond the noise: the heading begins to mean something (some 20 deg rms).

        Args:
            sd: standard deviation per axis of the noise of a vector, m/s: of the aid's velocity, or of a step.
            steps: the vectors are steps with independent noise (a standing vehicle): the heading's standard deviation
                sd / sqrt(tr(sum a a^T - sum a sum a^T / k)) is below 10 deg. Else they are sums since the start, whose
                noise is that of two velocities: 4 (s2 + s3) / (8 k sd^2) > 1, s the eigenvalues of the sum over the k
                vectors; s2 + s3 is taken as the sum of the principal minors over the trace: no cancellation against
                the large s1, and short by (s2 + s3) / s1 of itself at most (half of it where all three are equal).
        """
        a, variance = self.moments, sd * sd
        if steps:
            return (self.count > 0) & (self.scatter() * _HEADING_SD**2 > variance)
        minors = (
            (a.r0.x * a.r1.y - a.r0.y * a.r1.x)
            + (a.r0.x * a.r2.z - a.r0.z * a.r2.x)
            + (a.r1.y * a.r2.z - a.r1.z * a.r2.y)
        )
        return 4.0 * minors > 8.0 * self.count * variance * a.trace
