"""A vehicle that stands: its velocity is zero but for its disturbance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from jaxalign.aids.axes_velocity import RIGHT_FORWARD_UP
from jaxalign.aids.base import AbstractAid, Axes

if TYPE_CHECKING:
    from jaxalign.aids.linearized import Linearized
    from jaxalign.aids.motion import Motion

__all__ = ["Standing"]


@dataclass(frozen=True, kw_only=True)
class Standing(AbstractAid):
    """Zero velocity at every epoch, m/s, in b. No log has to hold it: it is an assumption about the vehicle.

    Its stated noise is that of the specific force integrated over one interval, the least of the disturbance.
    """

    kind: ClassVar[str] = "static"
    needs_north: ClassVar[bool] = False
    implied: ClassVar[bool] = True

    @property
    def components(self) -> tuple[str, ...]:
        """Those of the velocity that is zero."""
        return RIGHT_FORWARD_UP

    def predict(self, motion: Motion, unknowns: dict[str, Any]) -> Any:
        """The velocity, m/s, b."""
        return self.linearize(motion, unknowns).predicted

    def linearize(self, motion: Motion, unknowns: dict[str, Any]) -> Linearized:
        """Prediction and slopes, by hand."""
        from jaxalign.aids.along_axes import along_axes

        return along_axes((0, 1, 2), motion, {})

    def velocity(self, values: tuple[Any, ...]) -> tuple[Axes, tuple[Any, Any, Any]]:
        """The components as a velocity in b."""
        return Axes.BODY, (values[0], values[1], values[2])

    @property
    def described(self) -> str:
        """What it measures, for people."""
        return "none: static"
