"""Slot: a measured pair to a modelled one."""

from jaxalign.reconstruct.apparent_velocity import ApparentVelocityFilter
from jaxalign.reconstruct.base import AbstractReconstruct, Measured
from jaxalign.reconstruct.rls import Rls

__all__ = ["AbstractReconstruct", "ApparentVelocityFilter", "Measured", "Rls"]
