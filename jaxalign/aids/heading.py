"""A heading: magnetic compass, gyrocompass, two GNSS antennas."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from jaxalign.aids.base import LATENCY, AbstractAid, Unknown
from jaxalign.aids.linearized import Linearized

if TYPE_CHECKING:
    from jaxalign.aids.motion import Motion

__all__ = ["Heading"]


@dataclass(frozen=True, kw_only=True)
class Heading(AbstractAid):
    """Heading of the vehicle, rad clockwise from north: ``atan2(forward east, forward north) + offset``.

    ``offset``: a constant error, such as a wrong declination or a turned instrument.
    """

    kind: ClassVar[str] = "heading"
    unit: ClassVar[str] = "rad"
    periodic: ClassVar[bool] = True
    usual: ClassVar[tuple[str, ...]] = ("offset",)
    most: ClassVar[float] = 4.0 * math.pi
    unknowns: ClassVar[tuple[Unknown, ...]] = (Unknown("offset", 1, 0.2, "rad", (1e-5, 3.0)), LATENCY)

    @property
    def components(self) -> tuple[str, ...]:
        """The heading alone."""
        return ("heading",)

    def predict(self, motion: Motion, unknowns: dict[str, Any]) -> Any:
        """The heading, rad."""
        return self.linearize(motion, unknowns).predicted

    def linearize(self, motion: Motion, unknowns: dict[str, Any]) -> Linearized:
        """Prediction and slopes, by hand: a tilt moves the forward axis f by ``tilt x f``."""
        import jax.numpy as jnp

        from jaxalign.vector import Vec3

        forward = motion.axes[1]
        level = forward.x**2 + forward.y**2
        there = level > 0  # not straight up or down
        over = jnp.where(there, 1.0 / jnp.where(there, level, 1.0), 0.0)
        zero = 0.0 * level
        heading = jnp.arctan2(jnp.where(there, forward.x, 0.0), jnp.where(there, forward.y, 1.0))
        across = Vec3(forward.y * over, -forward.x * over, zero)  # slope by the forward axis
        tilt = forward.cross(across)
        offset = unknowns.get("offset")
        slopes = {} if offset is None else {"offset": ((zero + 1.0,),)}
        return Linearized((heading if offset is None else heading + offset,), (tilt,), None, slopes)

    @property
    def described(self) -> str:
        """What it measures, for people."""
        return "heading, clockwise from north"
