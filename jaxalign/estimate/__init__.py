"""Slot: weighted pairs to an attitude."""

from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.davenport import davenport
from jaxalign.estimate.qmethod import CentredWahba, QMethod

__all__ = ["AbstractEstimate", "CentredWahba", "QMethod", "Readout", "davenport"]
