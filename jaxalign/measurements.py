"""What an aid has measured, on its own clock; on the host, in NumPy."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxalign.aids import AbstractAid, aid_of
from jaxalign.errors import UserError

__all__ = ["Measurements"]


@dataclass(frozen=True, eq=False)
class Measurements:
    """The values of one aid.

    Attributes:
        aid: what it measures, or the name of its kind (docs/aids.md).
        time: (n,) s since the start of the inertial record, increasing.
        value: (n, m) in the unit of the aid, NaN where a component is missing; (n,) for a single component.
        sd: standard deviation of its white noise, if known: one number, or (m,) for the components.

    Raises:
        UserError: wrong shapes, times that do not increase, infinite or absurd values, no value at all, or a deviation
            that is not positive.
    """

    aid: AbstractAid
    time: np.ndarray
    value: np.ndarray
    sd: float | np.ndarray | None = None

    def __post_init__(self):
        aid = aid_of(self.aid)
        if aid.implied:
            raise UserError(
                f"{aid.name}: an assumption about the vehicle has no values: a log without aids is taken so"
            )
        size = len(aid.components)
        time, value = _floats(aid, "time", self.time), _floats(aid, "value", self.value)
        if value.ndim == 1 and size == 1:
            value = value[:, None]
        if time.ndim != 1 or value.shape != (len(time), size):
            raise UserError(
                f"{aid.name}: {len(np.atleast_1d(time))} times and values of shape {value.shape}: "
                f"({len(np.atleast_1d(time))}, {size}) is expected ({', '.join(aid.components)})"
            )
        if not np.isfinite(time).all() or (np.diff(time) <= 0).any():
            raise UserError(f"{aid.name}: its times must be finite and increase: sort them and remove duplicates")
        self._check_values(aid, time, value)
        put = {"aid": aid, "time": time, "value": value, "sd": _deviation(aid, self.sd)}
        for name, x in put.items():
            object.__setattr__(self, name, x)

    def _check_values(self, aid: AbstractAid, time: np.ndarray, value: np.ndarray) -> None:
        infinite = np.flatnonzero(np.isinf(value).any(axis=1))
        if len(infinite):
            raise UserError(f"{aid.name} is infinite at {time[infinite[0]]:g} s: use NaN for a missing sample")
        with np.errstate(invalid="ignore"):
            absurd = np.flatnonzero(np.any(np.abs(value) > aid.most, axis=1))
        if absurd.size:
            raise UserError(
                f"{aid.name} is {np.nanmax(np.abs(value[absurd[0]])):.3g} {aid.unit} at {time[absurd[0]]:g} s: use "
                f"{aid.unit}, and NaN for a missing sample"
            )
        if np.isnan(value).all():
            raise UserError(
                f"all {len(value)} values of {aid.name} are missing (NaN): give some, or leave the aid out: a log "
                "without aids is one of a vehicle that stands"
            )

    @property
    def name(self) -> str:
        """Of the aid."""
        return self.aid.name

    @property
    def missing(self) -> np.ndarray:
        """(n,) where no component is there."""
        return np.asarray(np.isnan(self.value).all(axis=1))

    @property
    def partial(self) -> bool:
        """Whether components are missing one by one somewhere."""
        lost = np.isnan(self.value)
        return bool((lost.any(axis=1) & ~lost.all(axis=1)).any())

    @property
    def velocity(self) -> np.ndarray | None:
        """(n, 3) velocity where it is whole, NaN elsewhere, in the axes of the aid; None if it is never whole."""
        if not self.aid.full_velocity:
            return None
        seen = self.aid.velocity(tuple(self.value.T))
        assert seen is not None
        whole = np.column_stack(seen[1])
        whole = np.where(np.isnan(whole).any(axis=1, keepdims=True), np.nan, whole)
        return None if np.isnan(whole).all() else whole

    def between(self, start: float, end: float) -> Measurements | None:
        """Those from one time to another (s, both included), on a clock that starts there; None if there is none."""
        inside = (self.time >= start) & (self.time <= end)
        if not inside.any() or np.isnan(self.value[inside]).all():
            return None
        return dataclasses.replace(self, time=self.time[inside] - start, value=self.value[inside])


def _floats(aid: AbstractAid, key: str, value: Any) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise UserError(f"{aid.name}: {key} must be an array of numbers, got {array.dtype}")
    return array.astype(np.float64, copy=False)


def _deviation(aid: AbstractAid, sd: Any) -> float | np.ndarray | None:
    if sd is None:
        return None
    array = _floats(aid, "sd", sd)
    if array.shape not in ((), (1,), (len(aid.components),)):
        raise UserError(f"{aid.name}: sd has shape {array.shape}: one number, or one for each component, is expected")
    if not (np.isfinite(array).all() and (array > 0).all()):
        raise UserError(f"{aid.name}: sd is {sd}: a standard deviation ({aid.unit}) must be positive and finite")
    same = array.size == 1 or bool((array == array.flat[0]).all())
    return float(array.flat[0]) if same else array
