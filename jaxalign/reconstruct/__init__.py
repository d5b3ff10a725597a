"""Slot: a measured pair to a modelled one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.reconstruct.apparent_velocity import ApparentVelocityFilter
    from jaxalign.reconstruct.base import AbstractReconstruct, Identity
    from jaxalign.reconstruct.rls import Rls

__all__ = ["AbstractReconstruct", "ApparentVelocityFilter", "Identity", "Rls"]

_HOMES = {
    "apparent_velocity": "ApparentVelocityFilter",
    "base": "AbstractReconstruct Identity",
    "rls": "Rls",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
