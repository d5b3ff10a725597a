"""What the aids have in common that see a velocity along the axes of the vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from jaxalign.aids.base import AbstractAid, Axes, Unknown, check_components

if TYPE_CHECKING:
    from jaxalign.aids.linearized import Linearized
    from jaxalign.aids.motion import Motion

__all__ = ["LEVER", "MOUNTING", "RIGHT_FORWARD_UP", "AbstractAxesVelocity"]

RIGHT_FORWARD_UP = ("right", "forward", "up")
LEVER = Unknown("lever", 3, 1.0, "m", (1e-3, 1e3))
"""From the inertial unit to the aid, m, b: it moves as the vehicle turns."""
MOUNTING = Unknown("mounting", 3, 0.017453292519943295, "rad", (1e-6, 0.5))
"""Small angles by which its axes are turned against those of the unit, rad, b: it measures ``v - mounting x v``."""


@dataclass(frozen=True, kw_only=True)
class AbstractAxesVelocity(AbstractAid):
    """Of the velocity of a point of the vehicle the parts along some of its axes, m/s.

    Attributes:
        components: which of right, forward and up.

    Raises:
        UserError: another component, none at all, or another order.
    """

    components: tuple[str, ...] = RIGHT_FORWARD_UP  # pyright: ignore[reportIncompatibleMethodOverride]
    needs_north: ClassVar[bool] = False

    def __post_init__(self):
        super().__post_init__()
        check_components(self.name, self.components, RIGHT_FORWARD_UP)

    def predict(self, motion: Motion, unknowns: dict[str, Any]) -> Any:
        """The components, m/s."""
        return self.linearize(motion, unknowns).predicted

    def linearize(self, motion: Motion, unknowns: dict[str, Any]) -> Linearized:
        """Prediction and slopes, by hand."""
        from jaxalign.aids.along_axes import along_axes

        return along_axes(tuple(map(RIGHT_FORWARD_UP.index, self.components)), motion, unknowns)

    def velocity(self, values: tuple[Any, ...]) -> tuple[Axes, tuple[Any, Any, Any]]:
        """The components as a velocity in b."""
        by_name = dict(zip(self.components, values, strict=True))
        right, forward, up = (by_name.get(name) for name in RIGHT_FORWARD_UP)
        return Axes.BODY, (right, forward, up)
