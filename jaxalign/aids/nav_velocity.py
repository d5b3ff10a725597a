"""A velocity in the axes of the Earth: GNSS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from jaxalign.aids.axes_velocity import LEVER
from jaxalign.aids.base import LATENCY, AbstractAid, Axes, Unknown, check_components, slow_error
from jaxalign.aids.linearized import Linearized

if TYPE_CHECKING:
    from jaxalign.aids.motion import Motion

__all__ = ["EAST_NORTH_UP", "NavVelocity"]

EAST_NORTH_UP = ("east", "north", "up")


@dataclass(frozen=True, kw_only=True)
class NavVelocity(AbstractAid):
    """Velocity over the Earth in n, m/s, of the antenna: ``v + rate x C_nb lever + slow``, some components of it.

    Attributes:
        components: which of east, north and up it has.
    """

    components: tuple[str, ...] = EAST_NORTH_UP  # pyright: ignore[reportIncompatibleMethodOverride]
    kind: ClassVar[str] = "nav"
    usual: ClassVar[tuple[str, ...]] = ("latency", "lever")
    unknowns: ClassVar[tuple[Unknown, ...]] = (
        LATENCY,
        LEVER,
        # Velocities that a receiver makes of positions err by 1 m/s over tens of seconds, its Doppler by millimetres.
        slow_error(3, 0.01, "m/s", (1e-6, 10.0), decades=1.0),
    )

    def __post_init__(self):
        super().__post_init__()
        check_components(self.name, self.components, EAST_NORTH_UP)

    @property
    def _rows(self) -> list[int]:
        return [i for i, name in enumerate(EAST_NORTH_UP) if name in self.components]

    def predict(self, motion: Motion, unknowns: dict[str, Any]) -> Any:
        """The components, m/s."""
        lever = unknowns.get("lever")
        v = motion.velocity if lever is None else motion.velocity_at(lever)
        return tuple((v.x, v.y, v.z)[i] for i in self._rows)

    def linearize(self, motion: Motion, unknowns: dict[str, Any]) -> Linearized:
        """Prediction and slopes, by hand; what a tilt does to the lever arm is left out."""
        from jaxalign.vector import Vec3

        zero, one = 0.0 * motion.velocity.x, 0.0 * motion.velocity.x + 1.0
        unit = (Vec3(one, zero, zero), Vec3(zero, one, zero), Vec3(zero, zero, one))
        slopes: dict[str, Any] = {}
        if "lever" in unknowns:
            moved = [motion.rate.cross(axis) for axis in motion.axes]
            slopes["lever"] = tuple(tuple((u.x, u.y, u.z)[i] for u in moved) for i in self._rows)
        return Linearized(self.predict(motion, unknowns), None, tuple(unit[i] for i in self._rows), slopes)

    def velocity(self, values: tuple[Any, ...]) -> tuple[Axes, tuple[Any, Any, Any]]:
        """The components as a velocity in n."""
        by_name = dict(zip(self.components, values, strict=True))
        east, north, up = (by_name.get(name) for name in EAST_NORTH_UP)
        return Axes.NAV, (east, north, up)

    @property
    def described(self) -> str:
        """What it measures, for people."""
        which = "ENU" if len(self.components) == 3 else ", ".join(self.components)
        return f"velocity in the navigation frame ({which})"
