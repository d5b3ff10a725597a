"""Propagation of n and of the place between epochs."""

from __future__ import annotations

from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from jaxalign.earth import Site, earth_rate, normal_gravity, radii, transport_rate
from jaxalign.vector import Quat, Vec3

__all__ = ["Place", "gravity_impulse", "turn"]


class Place(eqx.Module):
    """Latitude (rad) and height (m) as the vehicle moves."""

    lat: Float[Array, ""]
    h: Float[Array, ""]

    @classmethod
    def of(cls, site: Site) -> Place:
        """Where the vehicle is switched on."""
        return cls(site.lat, site.h)

    def moved(self, velocity: Vec3, dt: Any) -> Place:
        """After ``dt`` seconds at a velocity in n (m/s)."""
        meridian, _ = radii(self.lat)
        return Place(self.lat + velocity.y * dt / (meridian + self.h), self.h + velocity.z * dt)

    @property
    def gravity(self) -> Any:
        """Normal gravity, m/s^2."""
        return normal_gravity(self.lat, self.h)

    @property
    def earth_rate(self) -> Vec3:
        """w_ie in n, rad/s."""
        return earth_rate(self.lat)

    def transport_rate(self, velocity: Vec3) -> Vec3:
        """w_en in n, rad/s."""
        return transport_rate(self.lat, self.h, velocity)


def turn(q_n0n: Quat, rate: Vec3, dt: Any) -> Quat:
    """n after ``dt`` seconds at a constant rate ``w_in`` (rad/s, in n)."""
    return (q_n0n * Quat.exp(rate * dt)).renormalised()


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
