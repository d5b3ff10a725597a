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
    from jaxalign.aids import AbstractAid, BodyVelocity, Heading, NavVelocity, NonHolonomic, Standing, Unknown
    from jaxalign.aligner import Aligner, AlignState
    from jaxalign.alignment import align, estimate_aid_sd
    from jaxalign.auto import Choice, choose
    from jaxalign.batch import Auto, RobustMap
    from jaxalign.bounds import Bound, bound
    from jaxalign.earth import Site
    from jaxalign.epochs import Epoch, Epochs, Fix
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
    from jaxalign.front_end import FrontEnd, epochs_from_arrays, epochs_from_log
    from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors, imu_errors
    from jaxalign.io import log_from_streams, read
    from jaxalign.log import Log
    from jaxalign.measurements import Measurements
    from jaxalign.mechanization import NavState, navigate
    from jaxalign.method import AbstractMethod
    from jaxalign.methods import build
    from jaxalign.nav_estimate import NavEstimate
    from jaxalign.observe import AbstractObserve, BodyVelocityVectors, Context, GravityVectors, NavVelocityVectors, Pair
    from jaxalign.parametrization import parameters, tunable, with_parameters
    from jaxalign.preintegration import Increment, preintegrate
    from jaxalign.reconstruct import AbstractReconstruct, ApparentVelocityFilter, Identity, Rls
    from jaxalign.solution import FilterRecord, Solution, Status
    from jaxalign.two_vector import DualVector, MeanTriad
    from jaxalign.uncertainty import assess
    from jaxalign.vector import Mat3, Quat, Vec3
    from jaxalign.weight import AbstractWeight, Huber, Mahalanobis, Unit
    from jaxalign.whole_record import AbstractWholeRecordMethod

__version__ = "0.1.0"

__all__ = [
    "AbstractAid",
    "AbstractEstimate",
    "AbstractMethod",
    "AbstractObserve",
    "AbstractReconstruct",
    "AbstractWeight",
    "AbstractWholeRecordMethod",
    "AccelErrors",
    "AlignState",
    "Aligner",
    "ApparentVelocityFilter",
    "Auto",
    "BodyVelocity",
    "BodyVelocityVectors",
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
    "Fix",
    "FrontEnd",
    "GravityVectors",
    "GyroErrors",
    "Heading",
    "Huber",
    "Identity",
    "ImuErrors",
    "Increment",
    "KMatrixFilter",
    "Log",
    "Mahalanobis",
    "Mat3",
    "MeanTriad",
    "Measurements",
    "NavEstimate",
    "NavState",
    "NavVelocity",
    "NavVelocityVectors",
    "NonHolonomic",
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
    "Standing",
    "Status",
    "Unit",
    "Unknown",
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
    "log_from_streams",
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
    "aids": "AbstractAid BodyVelocity Heading NavVelocity NonHolonomic Standing Unknown",
    "aligner": "Aligner AlignState",
    "alignment": "align estimate_aid_sd",
    "auto": "Choice choose",
    "batch": "Auto RobustMap",
    "bounds": "Bound bound",
    "earth": "Site",
    "epochs": "Epoch Epochs Fix",
    "errors": "UserError",
    "estimate": (
        "AbstractEstimate CentredWahba KMatrixFilter OptimalRequest QMethod QuaternionFilter Readout Request "
        "RevisingWahba davenport"
    ),
    "fine": "ErrorFilter Fine",
    "front_end": "FrontEnd epochs_from_arrays epochs_from_log",
    "inertial_unit": "AccelErrors GyroErrors ImuErrors imu_errors",
    "io": "log_from_streams read",
    "log": "Log",
    "measurements": "Measurements",
    "mechanization": "NavState navigate",
    "method": "AbstractMethod",
    "methods": "build",
    "nav_estimate": "NavEstimate",
    "observe": "AbstractObserve BodyVelocityVectors Context GravityVectors NavVelocityVectors Pair",
    "parametrization": "parameters tunable with_parameters",
    "preintegration": "Increment preintegrate",
    "reconstruct": "AbstractReconstruct ApparentVelocityFilter Identity Rls",
    "whole_record": "AbstractWholeRecordMethod",
    "solution": "FilterRecord Solution Status",
    "two_vector": "DualVector MeanTriad",
    "uncertainty": "assess",
    "vector": "Mat3 Quat Vec3",
    "weight": "AbstractWeight Huber Mahalanobis Unit",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
