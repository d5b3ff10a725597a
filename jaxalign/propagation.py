"""Propagation of b, n and the place between epochs, and the velocity that force and gravity give meanwhile."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxalign.earth import LatitudeCircle, Site
from jaxalign.vector import Quat, Vec3

__all__ = ["Place", "advance_body", "advance_nav", "gravity_impulse"]


class Place(eqx.Module):
    """The site, its latitude following the vehicle.

    The height stays that of the start: 100 m change gravity by 3e-5 of itself, along the vertical.
    """

    circle: LatitudeCircle
    h: Any
    anomaly: Any

    @classmethod
    def of(cls, site: Site) -> Place:
        """Where the vehicle is switched on."""
        return cls(LatitudeCircle.of(site.lat), site.h, site.anomaly)

    def moved(self, velocity: Vec3, dt: Any) -> Place:
        """After ``dt`` seconds at a velocity in n (m/s)."""
        meridian, _ = self.circle.radii
        return Place(self.circle.moved(velocity.y * dt / (meridian + self.h)), self.h, self.anomaly)

    @property
    def gravity(self) -> Any:
        """Local gravity, m/s^2."""
        return self.circle.normal_gravity(self.h) + self.anomaly

    @property
    def earth_rate(self) -> Vec3:
        """w_ie in n, rad/s."""
        return self.circle.earth_rate

    def transport_rate(self, velocity: Vec3) -> Vec3:
        """w_en in n, rad/s."""
        return self.circle.transport_rate(self.h, velocity)


def advance_body(q_b0b: Quat, rotation: Quat, dvel: Vec3) -> tuple[Quat, Vec3]:
    """Over an interval: b at its end, and the velocity that the specific force gave (m/s, b0).

    Args:
        q_b0b: b at its start.
        rotation: from b at its end to b at its start.
        dvel: integral of the specific force, m/s, in b at its start.
    """
    return (q_b0b * rotation).renormalised(), q_b0b.rotate(dvel)


def advance_nav(q_n0n: Quat, rate: Vec3, gravity: Any, dt: Any) -> tuple[Quat, Vec3]:
    """Over an interval: n at its end, and the velocity that gravity gave (m/s, n0).

    Args:
        q_n0n: n at its start.
        rate: constant rate ``w_in``, rad/s, n.
        gravity: m/s^2.
        dt: length, s.
    """
    turned = (q_n0n * Quat.turn(rate * dt, slow=True)).renormalised()
    return turned, q_n0n.rotate(gravity_impulse(rate, gravity, dt))


def gravity_impulse(rate: Vec3, gravity: Any, dt: Any) -> Vec3:
    """``int_0^dt exp([rate x] s) (0, 0, -g) ds``: gravity over an interval, in n at its start (m/s).

    The series is cut after the third power of ``rate dt`` (1e-13 relative for 10 s epochs).

    Source: Xu 2020 (18)-(20), one order further.
    """
    zero = 0.0 * gravity
    g = Vec3(zero, zero, -gravity)
    first = rate.cross(g)
    second = rate.cross(first)
    third = rate.cross(second)
    return (g + (first + (second + third * (dt / 4)) * (dt / 3)) * (dt / 2)) * dt
