"""A velocity in the axes of the vehicle: Doppler velocity log, odometer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from jaxalign.aids.axes_velocity import LEVER, MOUNTING, AbstractAxesVelocity
from jaxalign.aids.base import LATENCY, Unknown, slow_error

__all__ = ["BodyVelocity"]


@dataclass(frozen=True, kw_only=True)
class BodyVelocity(AbstractAxesVelocity):
    """Velocity over the Earth in b, m/s: a Doppler velocity log with bottom lock, an odometer.

    ``(1 + scale) (1 - [mounting x]) C_bn (v + rate x C_nb lever) + slow``, some components of it.

    Attributes:
        components: which of right, forward and up it has.
    """

    kind: ClassVar[str] = "body"
    usual: ClassVar[tuple[str, ...]] = ("scale", "mounting")
    unknowns: ClassVar[tuple[Unknown, ...]] = (
        Unknown("scale", 1, 0.005, "1", (1e-6, 0.1)),
        MOUNTING,
        LATENCY,
        LEVER,
        slow_error(3, 0.005, "m/s", (1e-6, 10.0), decades=0.4),
    )

    @property
    def described(self) -> str:
        """What it measures, for people."""
        which = "right-forward-up" if len(self.components) == 3 else ", ".join(self.components)
        return f"velocity in the body frame ({which})"
