"""What a filter of records is."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Literal

import equinox as eqx
from jaxtyping import Array, Float

__all__ = ["AbstractPrefilter", "Frame"]

Frame = Literal["inertial", "body"]
"""In which the specific force is filtered: turned by the gyroscopes, or axis by axis as measured."""


class AbstractPrefilter(eqx.Module):
    """A zero-phase low-pass filter of whole, evenly spaced records.

    Attributes:
        frame: the frame in which the specific force of a log is filtered (:func:`jaxalign.prefilter.filtered_force`).
    """

    frame: eqx.AbstractVar[Frame]

    @abstractmethod
    def __call__(self, x: Float[Array, "samples axes"], dt: float) -> Float[Array, "samples axes"]:
        """The filtered record, sample by sample; every axis by itself.

        Args:
            x: the record.
            dt: sampling interval, s.
        """

    @abstractmethod
    def response(self, frequency: Any, dt: float) -> Any:
        """Gain at frequencies (Hz), away from the ends of the record; the phase is zero."""
