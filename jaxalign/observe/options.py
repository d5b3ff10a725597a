"""Checks of the options that the observation slots share."""

from __future__ import annotations

import math

from jaxalign.errors import UserError

__all__ = ["check_window"]


def check_window(seconds: float) -> None:
    """Refuse a negative or non-finite window."""
    if not math.isfinite(seconds) or seconds < 0:
        raise UserError(f"observe.window = {seconds}: must be a number of seconds, 0 for the whole time")
