"""The constants of WGS-84 and its normal gravity, for NumPy, JAX and plain numbers alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["EARTH_RATE", "ECCENTRICITY2", "SEMI_MAJOR_AXIS", "STANDARD_GRAVITY", "curvature", "gravity"]

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


def gravity(sin: Any, h: Any, sqrt: Callable[[Any], Any]) -> Any:
    """Normal gravity (m/s^2): Somigliana at the ellipsoid, second order in the height.

    Args:
        sin: sine of the latitude.
        h: height above the ellipsoid, m.
        sqrt: the square root for numbers of their kind.
    """
    s2 = sin**2
    surface = _GRAVITY_EQUATOR * (1.0 + _SOMIGLIANA * s2) / sqrt(1.0 - ECCENTRICITY2 * s2)
    x = h / SEMI_MAJOR_AXIS
    slope = 1.0 + _FLATTENING + _CENTRIFUGAL_RATIO - 2.0 * _FLATTENING * s2
    return surface * (1.0 - 2.0 * slope * x + 3.0 * x * x)


def curvature(sin: Any, sqrt: Callable[[Any], Any]) -> tuple[Any, Any]:
    """Radii of curvature in the meridian and in the prime vertical (m).

    Args:
        sin: sine of the latitude.
        sqrt: the square root for numbers of their kind.
    """
    x = 1.0 - ECCENTRICITY2 * sin**2
    prime_vertical = SEMI_MAJOR_AXIS / sqrt(x)
    return prime_vertical * (1.0 - ECCENTRICITY2) / x, prime_vertical
