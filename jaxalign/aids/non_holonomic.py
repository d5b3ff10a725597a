"""A vehicle on wheels does not move sideways, nor off the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from jaxalign.aids.axes_velocity import LEVER, MOUNTING, AbstractAxesVelocity
from jaxalign.aids.base import Unknown

__all__ = ["NonHolonomic"]


@dataclass(frozen=True, kw_only=True)
class NonHolonomic(AbstractAxesVelocity):
    """The velocity sideways and up is zero but for slip, in the axes of the wheels that do not steer, m/s.

    Its values are zeros; their standard deviation is that of the slip. ``mounting``: the axes of the wheels against
    those of the unit (that about the forward axis does not show); ``lever``: from the unit to the axle.

    Attributes:
        components: of right, forward and up those that are zero.
    """

    components: tuple[str, ...] = ("right", "up")
    kind: ClassVar[str] = "non-holonomic"
    zeros: ClassVar[bool] = True
    usual: ClassVar[tuple[str, ...]] = ("mounting",)
    unknowns: ClassVar[tuple[Unknown, ...]] = (MOUNTING, LEVER)

    @property
    def described(self) -> str:
        """What it measures, for people."""
        return f"no velocity {' and '.join(self.components)} (non-holonomic)"
