"""SI values of the units of data sheets."""

from __future__ import annotations

import math

from jaxalign.wgs84 import STANDARD_GRAVITY

__all__ = ["DEG_H", "DEG_SQRT_H", "UG"]

UG = STANDARD_GRAVITY * 1e-6
"""m/s^2."""
DEG_H = math.pi / 180 / 3600
"""rad/s."""
DEG_SQRT_H = math.pi / 180 / 60
"""rad/sqrt(s)."""
