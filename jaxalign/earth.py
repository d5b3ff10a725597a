"""WGS-84: radii of curvature, normal gravity, Earth and transport rate.

All functions are pure and differentiable; latitudes in rad, heights in m, n = East-North-Up.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.vector import Vec3

__all__ = [
    "EARTH_RATE",
    "SEMI_MAJOR_AXIS",
    "STANDARD_GRAVITY",
    "Site",
    "earth_rate",
    "normal_gravity",
    "radii",
    "transport_rate",
]

EARTH_RATE = 7.292115e-5
"""rad/s (WGS-84)."""
SEMI_MAJOR_AXIS = 6378137.0
"""m (WGS-84)."""
ECCENTRICITY2 = 0.00669437999014
"""First eccentricity squared (WGS-84)."""
STANDARD_GRAVITY = 9.80665
"""m/s^2: the g of "10 mg" and "50 ug"."""

_GRAVITY_EQUATOR = 9.7803253359
_SOMIGLIANA = 0.00193185265241
_FLATTENING = 1 / 298.257223563
_CENTRIFUGAL_RATIO = 0.00344978650684


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
        self.lat = jnp.asarray(lat, jnp.float64)
        self.lon = jnp.asarray(lon, jnp.float64)
        self.h = jnp.asarray(h, jnp.float64)
        self.anomaly = jnp.asarray(anomaly, jnp.float64)

    @property
    def gravity(self) -> Any:
        """Local gravity, m/s^2."""
        return normal_gravity(self.lat, self.h) + self.anomaly


def radii(lat: Any) -> tuple[Any, Any]:
    """Radii of curvature in the meridian and in the prime vertical (m)."""
    x = 1.0 - ECCENTRICITY2 * jnp.sin(lat) ** 2
    prime_vertical = SEMI_MAJOR_AXIS / jnp.sqrt(x)
    return prime_vertical * (1.0 - ECCENTRICITY2) / x, prime_vertical


def normal_gravity(lat: Any, h: Any = 0.0) -> Any:
    """Normal gravity (m/s^2): Somigliana at the ellipsoid, second order in the height (WGS-84)."""
    s2 = jnp.sin(lat) ** 2
    surface = _GRAVITY_EQUATOR * (1.0 + _SOMIGLIANA * s2) / jnp.sqrt(1.0 - ECCENTRICITY2 * s2)
    x = h / SEMI_MAJOR_AXIS
    slope = 1.0 + _FLATTENING + _CENTRIFUGAL_RATIO - 2.0 * _FLATTENING * s2
    return surface * (1.0 - 2.0 * slope * x + 3.0 * x * x)


def earth_rate(lat: Any) -> Vec3:
    """Rotation of the Earth w_ie in n (rad/s)."""
    lat = jnp.asarray(lat)
    return Vec3(jnp.zeros_like(lat), EARTH_RATE * jnp.cos(lat), EARTH_RATE * jnp.sin(lat))


def transport_rate(lat: Any, h: Any, velocity: Vec3) -> Vec3:
    """Rotation w_en of n over the Earth (rad/s) for a velocity in n (m/s); infinite at the poles."""
    meridian, prime_vertical = radii(lat)
    east = velocity.x / (prime_vertical + h)
    return Vec3(-velocity.y / (meridian + h), east, east * jnp.tan(lat))
