"""What a filter of records is."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from typing import Any, Literal, Protocol, TypeVar

import equinox as eqx
from jaxtyping import Array, Float

__all__ = ["AbstractPrefilter", "Frame", "optional_prefilter", "without_prefilter"]

Frame = Literal["inertial", "body"]


class _Filtered(Protocol):
    @property
    def prefilter(self) -> AbstractPrefilter | None: ...


T = TypeVar("T", bound=_Filtered)


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


def optional_prefilter() -> Any:
    """A field of a method that holds a filter or None."""
    return eqx.field(default=None, kw_only=True, metadata={"slot": True})


def without_prefilter(method: T) -> T:
    """A method for epochs that its prefilter has been through: methods that differ in it alone share a program."""
    if method.prefilter is None:
        return method
    return dataclasses.replace(method, prefilter=None)  # pyright: ignore[reportArgumentType, reportCallIssue]
