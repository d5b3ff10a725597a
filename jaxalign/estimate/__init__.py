"""Slot: weighted pairs to an attitude."""

from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.davenport import davenport
from jaxalign.estimate.profile import CentredSums
from jaxalign.estimate.qmethod import CentredWahba, QMethod
from jaxalign.estimate.quaternion_kf import QuaternionFilter
from jaxalign.estimate.request import OptimalRequest, Request
from jaxalign.estimate.revising import Held, RevisingWahba, reweighted
from jaxalign.estimate.tvk import KMatrixFilter

__all__ = [
    "AbstractEstimate",
    "CentredSums",
    "CentredWahba",
    "Held",
    "KMatrixFilter",
    "OptimalRequest",
    "QMethod",
    "QuaternionFilter",
    "Readout",
    "Request",
    "RevisingWahba",
    "davenport",
    "reweighted",
]
