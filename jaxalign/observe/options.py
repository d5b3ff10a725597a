"""Checks of the options that the observation slots share."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import equinox as eqx

from jaxalign.errors import UserError

__all__ = ["check_choice", "check_count", "check_interval", "check_window", "optional_count"]


def optional_count() -> Any:
    """A static field holding a whole number or None."""
    return eqx.field(static=True, default=None, metadata={"optional": True, "integer": True})


def check_choice(path: str, value: str, choices: Iterable[str]) -> None:
    """Refuse a word that is not one of the choices."""
    if value not in choices:
        raise UserError(f"{path} = {value!r}: must be one of {', '.join(choices)}")


def check_count(path: str, value: int) -> None:
    """Refuse what is no whole number above zero."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise UserError(f"{path} = {value!r}: must be a whole number, at least 1")


def check_window(seconds: float) -> None:
    """Refuse a negative or non-finite window."""
    if not math.isfinite(seconds) or seconds < 0:
        raise UserError(f"observe.window = {seconds}: must be a number of seconds, 0 for the whole time")


def check_interval(samples: int | None, path: str = "observe.interval_samples") -> None:
    """Refuse an interval of less than one IMU sample."""
    if samples is not None and samples < 1:
        raise UserError(f"{path} = {samples}: must be at least 1 IMU sample, or none for the log's own")
