"""What the smoothing factor is chosen by: a pure function of spectra, differentiable.

The objectives of the paper are in :mod:`jaxalign.published.objectives`.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxalign.errors import UserError

__all__ = ["low_band", "misfit"]


def low_band(frequency: Any, split: float) -> np.ndarray:
    """Mask of the low band: zero frequency and the split included.

    Raises:
        UserError: the split is outside the spectrum.
    """
    low = np.asarray(frequency) <= split * (1 + 1e-12)
    if low.all() or not low.any():
        raise UserError(f"split = {split:g} Hz: must lie within the frequencies of the spectrum")
    return low


def misfit(
    frequency: Float[ArrayLike, " f"], density: Float[ArrayLike, " f"], gain: Float[ArrayLike, " f"], split: float = 0.5
) -> Float[Array, ""]:
    """J: power of the signal lost below the split (Hz) plus power of the disturbance left above it.

    ``int_low (1 - G)^2 S df + int_high G^2 S df`` has one minimum, whatever the scale of the data, and no filtering in
    the loop.

    Args:
        frequency: Hz, evenly spaced.
        density: of the unfiltered record.
        gain: of the filter at these frequencies (``prefilter.response``).
        split: between signal and disturbance, Hz.

    Returns:
        J, in the unit of the record squared.

    Raises:
        UserError: the split is outside the spectrum.
    """
    low = low_band(frequency, split)
    gain = jnp.asarray(gain)
    lost = jnp.where(low, (1.0 - gain) ** 2, gain**2)
    f = np.asarray(frequency)
    return jnp.sum(lost * jnp.asarray(density)) * (f[1] - f[0])
