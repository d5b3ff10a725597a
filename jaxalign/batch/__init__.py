"""Robust batch estimation over a trajectory with a state at every epoch."""

from __future__ import annotations

from jaxalign.batch.auto import Auto
from jaxalign.batch.robust_map import RobustMap

__all__ = ["Auto", "RobustMap"]
