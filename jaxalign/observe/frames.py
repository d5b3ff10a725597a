"""Propagation of n and of the place between epochs."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxalign.earth import Parallel, Site
from jaxalign.vector import Quat, Vec3

__all__ = ["Place", "gravity_impulse", "turn"]


class Place(eqx.Module):
    """The site, its latitude following the vehicle.

    The height stays that of the start: 100 m change gravity by 3e-5 of itself, along the vertical.
    """

    parallel: Parallel
    h: Any
    anomaly: Any

    @classmethod
    def of(cls, site: Site) -> Place:
        """Where the vehicle is switched on."""
        return cls(Parallel.of(site.lat), site.h, site.anomaly)

    def moved(self, velocity: Vec3, dt: Any) -> Place:
        """After ``dt`` seconds at a velocity in n (m/s)."""
        meridian, _ = self.parallel.radii
        return Place(self.parallel.moved(velocity.y * dt / (meridian + self.h)), self.h, self.anomaly)

    @property
    def gravity(self) -> Any:
        """Local gravity, m/s^2."""
        return self.parallel.normal_gravity(self.h) + self.anomaly

    @property
    def earth_rate(self) -> Vec3:
        """w_ie in n, rad/s."""
        return self.parallel.earth_rate

    def transport_rate(self, velocity: Vec3) -> Vec3:
        """w_en in n, rad/s."""
        return self.parallel.transport_rate(self.h, velocity)


def turn(q_n0n: Quat, rate: Vec3, dt: Any) -> Quat:
    """N after ``dt`` seconds at a constant rate ``w_in`` (rad/s, in n)."""
    return (q_n0n * Quat.turn(rate * dt, slow=True)).renormalised()


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
