"""WGS-84: radii of curvature, normal gravity, Earth and transport rate.

All functions are pure and differentiable; latitudes in rad, heights in m, n = East-North-Up.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.parametrization import as_float64
from jaxalign.vector import Vec3
from jaxalign.wgs84 import EARTH_RATE, SEMI_MAJOR_AXIS, STANDARD_GRAVITY, curvature, gravity

__all__ = [
    "EARTH_RATE",
    "SEMI_MAJOR_AXIS",
    "STANDARD_GRAVITY",
    "LatitudeCircle",
    "Site",
    "earth_rate",
    "normal_gravity",
    "radii",
    "transport_rate",
]


class Site(eqx.Module):
    """Where the vehicle is when it is switched on.

    Attributes:
        lat: latitude, rad, positive north.
        lon: longitude, rad, positive east (no result depends on it).
        h: height above the ellipsoid, m.
        anomaly: local gravity minus normal gravity, m/s^2.
    """

    lat: Float[Array, ""]
    lon: Float[Array, ""]
    h: Float[Array, ""]
    anomaly: Float[Array, ""]

    def __init__(self, lat: Any, lon: Any = 0.0, h: Any = 0.0, anomaly: Any = 0.0):
        self.lat = as_float64(lat)
        self.lon = as_float64(lon)
        self.h = as_float64(h)
        self.anomaly = as_float64(anomaly)

    @property
    def gravity(self) -> Any:
        """Local gravity, m/s^2."""
        return normal_gravity(self.lat, self.h) + self.anomaly


class LatitudeCircle(eqx.Module):
    """A circle of latitude by its sine and cosine: a vehicle that moves needs no trigonometry at each step.

    Attributes:
        sin: sine of the latitude.
        cos: its cosine.
    """

    sin: Any
    cos: Any

    @classmethod
    def of(cls, lat: Any) -> LatitudeCircle:
        """The circle of a latitude (rad)."""
        return cls(jnp.sin(lat), jnp.cos(lat))

    def moved(self, angle: Any) -> LatitudeCircle:
        """Further north by a small angle (rad): exact to rounding up to 0.01 rad, or 60 km."""
        square = angle * angle
        sin, cos = angle * (1.0 - square * (1.0 - square / 20.0) / 6.0), 1.0 - square * (0.5 - square / 24.0)
        return LatitudeCircle(self.sin * cos + self.cos * sin, self.cos * cos - self.sin * sin)

    @property
    def radii(self) -> tuple[Any, Any]:
        """Radii of curvature in the meridian and in the prime vertical (m)."""
        return curvature(self.sin, jnp.sqrt)

    def normal_gravity(self, h: Any) -> Any:
        """Normal gravity (m/s^2): Somigliana at the ellipsoid, second order in the height (WGS-84)."""
        return gravity(self.sin, h, jnp.sqrt)

    @property
    def earth_rate(self) -> Vec3:
        """Rotation of the Earth w_ie in n (rad/s)."""
        return Vec3(jnp.zeros_like(self.sin), EARTH_RATE * self.cos, EARTH_RATE * self.sin)

    def transport_rate(self, h: Any, velocity: Vec3) -> Vec3:
        """Rotation w_en of n over the Earth (rad/s) for a velocity in n (m/s); infinite at the poles."""
        meridian, prime_vertical = self.radii
        east = velocity.x / (prime_vertical + h)
        return Vec3(-velocity.y / (meridian + h), east, east * (self.sin / self.cos))


def radii(lat: Any) -> tuple[Any, Any]:
    """Radii of curvature in the meridian and in the prime vertical (m)."""
    return LatitudeCircle.of(lat).radii


def normal_gravity(lat: Any, h: Any = 0.0) -> Any:
    """Normal gravity (m/s^2): Somigliana at the ellipsoid, second order in the height (WGS-84)."""
    return LatitudeCircle.of(lat).normal_gravity(h)


def earth_rate(lat: Any) -> Vec3:
    """Rotation of the Earth w_ie in n (rad/s)."""
    return LatitudeCircle.of(lat).earth_rate


def transport_rate(lat: Any, h: Any, velocity: Vec3) -> Vec3:
    """Rotation w_en of n over the Earth (rad/s) for a velocity in n (m/s); infinite at the poles."""
    return LatitudeCircle.of(lat).transport_rate(h, velocity)
