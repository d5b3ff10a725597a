"""Names of parameters that have changed: what an old method file or command is told."""

from __future__ import annotations

import re
from collections.abc import Collection

from jaxalign.errors import UserError

__all__ = ["check_renamed"]

_NAMES = {
    "aid_noise": ("noise",),
    "front_end.interval_samples": ("observe.interval_samples", "interval_samples"),
    "headings": ("starts",),
    "imu.accel.bias_ug": ("imu.accel_bias_ug", "accel_bias_ug"),
    "imu.accel.bias_walk_ug_sqrt_h": ("accel_bias_walk_ug_sqrt_h",),
    "imu.accel.density_ug_sqrt_hz": ("imu.accel_noise_ug_sqrt_hz", "accel_noise_ug_sqrt_hz"),
    "imu.gyro.bias_deg_h": ("imu.gyro_bias_deg_h", "gyro_bias_deg_h"),
    "imu.gyro.bias_walk_deg_h_sqrt_h": ("gyro_bias_walk_deg_h_sqrt_h",),
    "imu.gyro.walk_deg_sqrt_h": ("imu.gyro_walk_deg_sqrt_h", "gyro_walk_deg_sqrt_h"),
    "outlier_probability": ("outliers",),
    "outlier_ratio": ("spread",),
    "estimate.measurement_noise": ("estimate.noise",),
    "estimate.prior_variance": ("estimate.prior",),
    "estimate.process_variance": ("estimate.process",),
    "reconstruct.prior_variance": ("reconstruct.prior",),
    "reconstruct.process_variance": ("reconstruct.process",),
    "reconstruct.threshold": ("reconstruct.gamma",),
    "weight.exponent": ("weight.gamma",),  # of Mahalanobis, which has a threshold too
    "weight.threshold": ("weight.gamma",),
}
"""New name -> what it was called; the first that a method has counts."""
_PRIORS = {
    "latency_sd": "latency",
    "lever_sd": "lever",
    "mounting_sd_deg": "mounting_deg",
    "scale_sd": "scale",
    "slow_sd": "slow",
    "slow_time": "slow_seconds",
}
"""Old name -> the new one behind "priors." and the name of an aid."""


def check_renamed(name: str, known: Collection[str]) -> None:
    """Refuse an old name of something that is known by a new one.

    Args:
        name: as given.
        known: names that there are.

    Raises:
        UserError: says the new name.
    """
    if name.startswith("prefilter.") and f"front_end.{name}" in known:
        raise UserError(f"{name} is now called front_end.{name}: write that instead")
    if name in _PRIORS:
        pattern = re.compile(rf"priors\..+\.{_PRIORS[name]}")
        if now := [path for path in known if pattern.fullmatch(path)]:
            raise UserError(f"{name} is now called {' or '.join(now)}: write that instead")
    for new, before in _NAMES.items():
        for old in before:
            prefix = name.removesuffix(old)
            if prefix != name and prefix[-1:] in ("", ".") and prefix + new in known:
                raise UserError(f"{name} is now called {prefix + new}: write that instead")
