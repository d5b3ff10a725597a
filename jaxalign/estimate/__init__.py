"""Slot: weighted pairs to an attitude."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.estimate.base import AbstractEstimate, Readout
    from jaxalign.estimate.eigenproblem import davenport
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

_HOMES = {
    "base": "AbstractEstimate Readout",
    "eigenproblem": "davenport",
    "profile": "CentredSums",
    "qmethod": "CentredWahba QMethod",
    "quaternion_kf": "QuaternionFilter",
    "request": "OptimalRequest Request",
    "revising": "Held RevisingWahba reweighted",
    "tvk": "KMatrixFilter",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
