"""Slot: replace the measured pair by a modelled one, or pass it through."""

from jaxalign.reconstruct.base import AbstractReconstruct, Measured

__all__ = ["AbstractReconstruct", "Measured"]
