"""The motion of a vehicle as an aid sees it."""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxalign.vector import Quat, Vec3

__all__ = ["Motion"]


class Motion(NamedTuple):
    """Components of any common shape.

    n is East-North-Up; for an aid without ``needs_north`` it may be any other axes at rest.

    Attributes:
        attitude: q_nb.
        velocity: over the Earth, m/s, n.
        rate: of b against the Earth, rad/s, n.
        time: s since the first epoch.
    """

    attitude: Quat
    velocity: Vec3
    rate: Vec3
    time: Any

    @property
    def axes(self) -> tuple[Vec3, Vec3, Vec3]:
        """Right, forward and up of the vehicle, in n: the columns of C_nb."""
        m = self.attitude.matrix
        return Vec3(m.r0.x, m.r1.x, m.r2.x), Vec3(m.r0.y, m.r1.y, m.r2.y), Vec3(m.r0.z, m.r1.z, m.r2.z)

    @property
    def velocity_b(self) -> Vec3:
        """Over the Earth, m/s, b."""
        return self.attitude.conjugate().rotate(self.velocity)

    def velocity_at(self, lever: Vec3) -> Vec3:
        """Of a point of the vehicle, m/s, n.

        Args:
            lever: where it is, from the inertial unit, m, b.
        """
        return self.velocity + self.rate.cross(self.attitude.rotate(lever))
