"""Fine alignment of a standing vehicle: error-state Kalman filter about a strapdown mechanisation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.fine.consistency import chi_square_band, nees, nis
    from jaxalign.fine.error_filter import ErrorFilter, FilterRow, FilterState
    from jaxalign.fine.error_model import ACCEL, GYRO, POSITION, PSI, STATES, VELOCITY, transition
    from jaxalign.fine.method import Fine

__all__ = [
    "ACCEL",
    "GYRO",
    "POSITION",
    "PSI",
    "STATES",
    "VELOCITY",
    "ErrorFilter",
    "FilterRow",
    "FilterState",
    "Fine",
    "chi_square_band",
    "nees",
    "nis",
    "transition",
]

_HOMES = {
    "consistency": "chi_square_band nees nis",
    "error_filter": "ErrorFilter FilterRow FilterState",
    "error_model": "ACCEL GYRO POSITION PSI STATES VELOCITY transition",
    "method": "Fine",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
