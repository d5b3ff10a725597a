"""Slot: weighted pairs to an attitude."""

from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.davenport import davenport
from jaxalign.estimate.qmethod import CentredWahba, QMethod
from jaxalign.estimate.quaternion_kf import QuaternionFilter
from jaxalign.estimate.request import OptimalRequest, Request
from jaxalign.estimate.tvk import KMatrixFilter

__all__ = [
    "AbstractEstimate",
    "CentredWahba",
    "KMatrixFilter",
    "OptimalRequest",
    "QMethod",
    "QuaternionFilter",
    "Readout",
    "Request",
    "davenport",
]
