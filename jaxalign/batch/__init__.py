"""Robust batch estimation over a trajectory with a state at every epoch."""

from __future__ import annotations

from jaxalign.batch.imu import GRADES, ImuErrors, imu_errors, imu_figures
from jaxalign.batch.robust_map import RobustMap

__all__ = ["GRADES", "ImuErrors", "RobustMap", "imu_errors", "imu_figures"]
