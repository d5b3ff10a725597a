"""The robust Kalman filter of the apparent velocity as printed."""

from __future__ import annotations

from typing import Any, ClassVar

from jaxtyping import Array, Float

from jaxalign.parametrization import tunable
from jaxalign.reconstruct.apparent_velocity import (
    UPPER,
    AbstractApparentVelocityFilter,
    Covariance,
    Innovation,
    dot,
    projected,
)

__all__ = ["PrintedApparentVelocityFilter"]


class PrintedApparentVelocityFilter(AbstractApparentVelocityFilter):
    """(33), (36)-(39) as printed: the weight scales the innovation and leaves gain and covariance alone.

    The covariance shrinks as if each measurement had been taken whole. It does not work: 46 deg on clean data.

    Attributes:
        threshold: Huber's, in standard deviations.
        process_variance: variance that each published coefficient gains per vector (printed: 1e-3 squared).
        prior_variance: variance of each published coefficient at the start.

    Source: Xu 2020 (27)-(40). Deviation: the basis of the base class.
    """

    threshold: Float[Array, ""] = tunable(1.345, unit="1", bounds=(0.1, 100.0))
    process_variance: Float[Array, ""] = tunable(1e-6, unit="1", bounds=(0.0, 1.0))
    prior_variance: Float[Array, ""] = tunable(1e10, unit="1", bounds=(1e2, 1e11))
    drop_constant: ClassVar[bool] = False

    def correct(self, p: Covariance, b: list[Any], innovation: Innovation) -> tuple[list[Any], list[Any]]:
        """The gain of a plain Kalman filter, (I - G b^T) P."""
        along_b = projected(p, b)
        gain = [x / (dot(along_b, b) + innovation.variance) for x in along_b]
        step = innovation.value * innovation.weight
        return [g * step for g in gain], [p[i, j] - gain[i] * along_b[j] for i, j in UPPER]
