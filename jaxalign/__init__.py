"""Initial alignment of strapdown inertial navigation systems: differentiable, vectorised, in JAX.

Conventions, once for the whole library:

- n is East-North-Up, b right-forward-up, i inertial; n0 and b0 are n and b frozen at t = 0. ``C_ab`` and ``q_ab`` map
  vectors of b into a; quaternions are Hamilton, scalar first.
- ``C_nb = Rz(yaw) Rx(pitch) Ry(roll)``, yaw counter-clockwise from north; ``heading`` is clockwise from north, 0..360
  deg, for people.
- Attitude errors are phi in n with ``C_est = (I - [phi x]) C_true``.
- SI units and radians inside; degrees, deg/h, ug only at the edges, with ``_deg`` and the like in the name.
- Forward-right-down and North-East-Down data are turned once, in the reader.
- float64: enable x64 before anything is built. The library never changes JAX's global settings.

The way of the data: a :class:`Log` is preintegrated to :class:`Epochs`; a method (:mod:`jaxalign.methods`) turns epochs
into vector pairs, reconstructs, weighs and accumulates them, and reads out attitudes: a :class:`Solution`. In front
of it a :mod:`jaxalign.prefilter` may smooth the force of a standing vehicle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign import compilation, earth, io, methods, metrics, prefilter, rotation, simulate, study, tune
    from jaxalign.aligner import Aligner, AlignState
    from jaxalign.alignment import align, estimate_aid_sd
    from jaxalign.auto import Choice, choose
    from jaxalign.batch import RobustMap
    from jaxalign.bounds import Bound, bound
    from jaxalign.earth import Site
    from jaxalign.epochs import Epoch, Epochs, epochs_from_arrays, epochs_from_log
    from jaxalign.errors import UserError
    from jaxalign.estimate import (
        AbstractEstimate,
        CentredWahba,
        KMatrixFilter,
        OptimalRequest,
        QMethod,
        QuaternionFilter,
        Readout,
        Request,
        RevisingWahba,
        davenport,
    )
    from jaxalign.fine import ErrorFilter, Fine
    from jaxalign.inertial_unit import ImuErrors, imu_errors
    from jaxalign.io import read
    from jaxalign.log import Log
    from jaxalign.mechanization import NavState, navigate
    from jaxalign.method import AbstractMethod
    from jaxalign.methods import build
    from jaxalign.observe import AbstractObserve, BodyVelocity, Context, NavVelocity, Pair, Static
    from jaxalign.parametrization import parameters, tunable, with_parameters
    from jaxalign.preintegration import Increment, preintegrate
    from jaxalign.reconstruct import AbstractReconstruct, ApparentVelocityFilter, Measured, Rls
    from jaxalign.record_method import AbstractRecordMethod
    from jaxalign.solution import FilterRecord, Solution, Status
    from jaxalign.two_vector import DualVector, MeanTriad
    from jaxalign.uncertainty import assess
    from jaxalign.vector import Mat3, Quat, Vec3
    from jaxalign.weight import AbstractWeight, Huber, Mahalanobis, Unit

__version__ = "0.1.0"

__all__ = [
    "AbstractEstimate",
    "AbstractMethod",
    "AbstractObserve",
    "AbstractReconstruct",
    "AbstractRecordMethod",
    "AbstractWeight",
    "AlignState",
    "Aligner",
    "ApparentVelocityFilter",
    "BodyVelocity",
    "Bound",
    "CentredWahba",
    "Choice",
    "Context",
    "DualVector",
    "Epoch",
    "Epochs",
    "ErrorFilter",
    "FilterRecord",
    "Fine",
    "Huber",
    "ImuErrors",
    "Increment",
    "KMatrixFilter",
    "Log",
    "Mahalanobis",
    "Mat3",
    "MeanTriad",
    "Measured",
    "NavState",
    "NavVelocity",
    "OptimalRequest",
    "Pair",
    "QMethod",
    "Quat",
    "QuaternionFilter",
    "Readout",
    "Request",
    "RevisingWahba",
    "Rls",
    "RobustMap",
    "Site",
    "Solution",
    "Static",
    "Status",
    "Unit",
    "UserError",
    "Vec3",
    "align",
    "assess",
    "bound",
    "build",
    "choose",
    "compilation",
    "davenport",
    "earth",
    "epochs_from_arrays",
    "epochs_from_log",
    "estimate_aid_sd",
    "imu_errors",
    "io",
    "methods",
    "metrics",
    "navigate",
    "parameters",
    "prefilter",
    "preintegrate",
    "read",
    "rotation",
    "simulate",
    "study",
    "tunable",
    "tune",
    "with_parameters",
]

_HOMES = {
    "aligner": "Aligner AlignState",
    "alignment": "align estimate_aid_sd",
    "auto": "Choice choose",
    "batch": "RobustMap",
    "bounds": "Bound bound",
    "earth": "Site",
    "epochs": "Epoch Epochs epochs_from_arrays epochs_from_log",
    "errors": "UserError",
    "estimate": (
        "AbstractEstimate CentredWahba KMatrixFilter OptimalRequest QMethod QuaternionFilter Readout Request "
        "RevisingWahba davenport"
    ),
    "fine": "ErrorFilter Fine",
    "inertial_unit": "ImuErrors imu_errors",
    "io": "read",
    "log": "Log",
    "mechanization": "NavState navigate",
    "method": "AbstractMethod",
    "methods": "build",
    "observe": "AbstractObserve BodyVelocity Context NavVelocity Pair Static",
    "parametrization": "parameters tunable with_parameters",
    "preintegration": "Increment preintegrate",
    "reconstruct": "AbstractReconstruct ApparentVelocityFilter Measured Rls",
    "record_method": "AbstractRecordMethod",
    "solution": "FilterRecord Solution Status",
    "two_vector": "DualVector MeanTriad",
    "uncertainty": "assess",
    "vector": "Mat3 Quat Vec3",
    "weight": "AbstractWeight Huber Mahalanobis Unit",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
