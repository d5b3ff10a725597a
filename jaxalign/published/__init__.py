"""What exists only to reproduce what a paper prints, or what a frozen reference result was made with.

The library's own forms are elsewhere; most of these are worse, and say by how much. They differ by composition: a class
here takes the place of one slot, and the recipes ``..._as_published`` of :mod:`jaxalign.published.recipes` put them
together. :mod:`jaxalign.published.preintegration` has schemes for ``preintegrate``,
:mod:`jaxalign.published.objectives` the objectives of a smoothing factor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.published.apparent_velocity import PrintedApparentVelocityFilter
    from jaxalign.published.body_velocity import RecursiveBodyVelocityVectors
    from jaxalign.published.dual_vector import ComparisonDualVector
    from jaxalign.published.nav_velocity import EarthFixedNavVelocityVectors
    from jaxalign.published.quaternion_kf import FullNoiseQuaternionFilter
    from jaxalign.published.recipes import with_published_observation

__all__ = [
    "ComparisonDualVector",
    "EarthFixedNavVelocityVectors",
    "FullNoiseQuaternionFilter",
    "PrintedApparentVelocityFilter",
    "RecursiveBodyVelocityVectors",
    "with_published_observation",
]

_HOMES = {
    "apparent_velocity": "PrintedApparentVelocityFilter",
    "body_velocity": "RecursiveBodyVelocityVectors",
    "dual_vector": "ComparisonDualVector",
    "nav_velocity": "EarthFixedNavVelocityVectors",
    "quaternion_kf": "FullNoiseQuaternionFilter",
    "recipes": "with_published_observation",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
