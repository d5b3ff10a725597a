"""Aids: one class in one file for each kind; an aid of one's own is a subclass of :class:`AbstractAid`.

To look at a log imports no JAX: nor does this.
"""

from __future__ import annotations

from jaxalign.aids.base import (
    LATENCY,
    AbstractAid,
    Axes,
    Unknown,
    aid_of,
    aids_of,
    from_plain,
    kind_of,
    plain,
    slow_error,
)
from jaxalign.aids.body_velocity import BodyVelocity
from jaxalign.aids.heading import Heading
from jaxalign.aids.linearized import Linearized
from jaxalign.aids.nav_velocity import NavVelocity
from jaxalign.aids.non_holonomic import NonHolonomic
from jaxalign.aids.standing import Standing

__all__ = [
    "LATENCY",
    "AbstractAid",
    "Axes",
    "BodyVelocity",
    "Heading",
    "Linearized",
    "NavVelocity",
    "NonHolonomic",
    "Standing",
    "Unknown",
    "aid_of",
    "aids_of",
    "from_plain",
    "kind_of",
    "plain",
    "slow_error",
]
