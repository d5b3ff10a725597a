"""The recipes that reproduce print, and the papers' observation for any other method."""

from __future__ import annotations

import dataclasses
from typing import Any

from jaxalign import estimate, observe, published, reconstruct, weight
from jaxalign.aids import AbstractAid, BodyVelocity, NavVelocity, Standing
from jaxalign.aligner import Aligner
from jaxalign.errors import UserError
from jaxalign.parametrization import as_float64
from jaxalign.recipes import Contract, Recipe, registering

__all__ = [
    "PUBLISHED",
    "dual_vector_as_published",
    "moba_as_published",
    "oba_as_published",
    "quaternion_kf_as_published",
    "rkf_oba_as_published",
    "rls_quaternion_kf_as_published",
    "vo_tvk_as_published",
    "with_published_observation",
]

PUBLISHED: dict[str, Recipe] = {}
"""The recipes of this module by name; :data:`jaxalign.methods.RECIPES` has them too."""

_recipe = registering(PUBLISHED, published=True)


_OBSERVERS = {
    type(slot.aid): slot for slot in (published.RecursiveBodyVelocityVectors, published.EarthFixedNavVelocityVectors)
}


def _observer(aid: AbstractAid, **options: Any) -> observe.AbstractObserve:
    """The observation slot of the papers that an aid feeds, with its options."""
    return _OBSERVERS[type(aid)](aid=aid, **options)


def with_published_observation(method: Aligner) -> Aligner:
    """A method on vectors as the papers have them: Coriolis term by recursion, n fixed to the Earth.

    Args:
        method: with a velocity aid.

    Raises:
        UserError: the vehicle stands: nothing differs there.
    """
    if method.standing:
        raise UserError("the observation of a standing vehicle is that of the papers: nothing to replace")
    seen: Any = method.observe
    observer = _observer(method.observe.aid, window=seen.window)
    return dataclasses.replace(method, observe=observer)


# A transport rate neglected is a heading error of v_N / (R w_ie cos(lat)), 0.15 deg for 1 m/s.
@_recipe(
    BodyVelocity,
    NavVelocity,
    source="xu2020 (6)-(22); shen2025 OBA; huang's q-method with normalise",
    contract=Contract(closure_deg=2.0),
)
def oba_as_published(aid: AbstractAid = BodyVelocity(), **options: Any) -> Aligner:
    """OBA with the Coriolis term by recursion and the transport rate neglected."""
    return Aligner(_observer(aid, **options), estimate=estimate.QMethod())


@_recipe(BodyVelocity, source="shen2025 (9)-(17), Appendix A", contract=Contract(closure_deg=2.0, rounding=5e-8))
def moba_as_published(aid: AbstractAid = BodyVelocity(), **options: Any) -> Aligner:
    """Mahalanobis OBA with the Coriolis term by recursion and the transport rate neglected."""
    return Aligner(_observer(aid, **options), weight=weight.Mahalanobis(), estimate=estimate.QMethod())


@_recipe(BodyVelocity, source="xu2020 (27)-(40) as printed", contract=None)
def rkf_oba_as_published(aid: AbstractAid = BodyVelocity(), **options: Any) -> Aligner:
    """The robust Kalman filter of the apparent motion as printed: does not work (46 deg on clean data)."""
    fit = published.PrintedApparentVelocityFilter()
    return Aligner(_observer(aid, **options), fit, estimate=estimate.QMethod())


@_recipe(NavVelocity, BodyVelocity, source="huang (34)-(64) as printed", contract=None)
def vo_tvk_as_published(aid: AbstractAid = NavVelocity(), **options: Any) -> Aligner:
    """VO-TVK without regularisation: singular from the second vector on, and says so."""
    return Aligner(_observer(aid, **options), estimate=estimate.KMatrixFilter(kappa=as_float64(0.0)))


@_recipe(Standing, source="xu2017 (20)-(28), Scheme 3 with the full R")
def quaternion_kf_as_published(aid: AbstractAid = Standing(), **options: Any) -> Aligner:
    """Quaternion Kalman filter, each vector a measurement, R a full matrix."""
    seen = observe.GravityVectors(vectors="instantaneous", **options)
    return Aligner(seen, estimate=published.FullNoiseQuaternionFilter())


@_recipe(Standing, source="xu2017 (30)-(35), Scheme 4 with the full R", contract=Contract(closure_deg=0.03))
def rls_quaternion_kf_as_published(aid: AbstractAid = Standing(), **options: Any) -> Aligner:
    """Quaternion Kalman filter on the force as fitted by recursive least squares, R a full matrix."""
    seen = observe.GravityVectors(vectors="instantaneous", **options)
    return Aligner(seen, reconstruct.Rls(), estimate=published.FullNoiseQuaternionFilter())


@_recipe(Standing, source="xu2017 [8-12]")
def dual_vector_as_published(aid: AbstractAid = Standing(), **options: Any) -> published.ComparisonDualVector:
    """TRIAD on two velocities, two increments or two fits of the force: 002's comparison methods."""
    return published.ComparisonDualVector(**options)
