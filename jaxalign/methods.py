"""The methods by name: each a choice of slots, or one that takes the whole history.

A recipe is a function from the kind of aid to a method; its options are those of the observation slot. Everything
else is set by path, with :func:`jaxalign.with_parameters`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from jaxalign import estimate, observe, reconstruct, weight
from jaxalign.aligner import Aligner
from jaxalign.errors import UserError, close_names
from jaxalign.parametrization import with_parameters

if TYPE_CHECKING:
    from jaxalign.batch import RobustMap
    from jaxalign.epochs import Aid
    from jaxalign.fine import Fine
    from jaxalign.prefilter import AbstractPrefilter
    from jaxalign.two_vector import DualVector, MeanTriad

__all__ = [
    "RECIPES",
    "Recipe",
    "build",
    "build_for",
    "centred_oba",
    "dual_vector",
    "fine",
    "gravity_q",
    "moba",
    "oba",
    "observer",
    "optimal_request",
    "quaternion_kf",
    "request",
    "revising_oba",
    "rkf_oba",
    "rls_q",
    "rls_quaternion_kf",
    "roba",
    "robust_map",
    "triad",
    "velocity_q",
    "vo_tvk",
]


@dataclass(frozen=True)
class Recipe:
    """A method by name.

    Attributes:
        name: as in the papers' vocabulary.
        make: aid -> method.
        aids: the kinds of aid it takes, the first being the default.
        source: paper and equations.
        summary: one line for people.
    """

    name: str
    make: Callable[..., Any]
    aids: tuple[str, ...]
    source: str
    summary: str


RECIPES: dict[str, Recipe] = {}
"""All recipes by name."""


def _recipe(*aids: str, source: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    def register(make: Callable[..., Any]) -> Callable[..., Any]:
        summary = (make.__doc__ or "").split("\n")[0]
        RECIPES[make.__name__] = Recipe(make.__name__, make, aids, source, summary)
        return make

    return register


def observer(aid: Aid, **options: Any) -> observe.AbstractObserve:
    """The observation slot for a kind of aid, with its options."""
    return {"static": observe.Static, "body": observe.BodyVelocity, "nav": observe.NavVelocity}[aid](**options)


@_recipe("static", source="vondrak_disturbed_base (1)-(5), repaired")
def triad(aid: Aid = "static", **options: Any) -> MeanTriad:
    """Mean specific force and mean rotation: for a base that does not turn at all."""
    from jaxalign.two_vector import MeanTriad

    return MeanTriad(**options)


@_recipe("static", source="xu2017 [8-12]; vondrak_disturbed_base, inertial frame; Hann windows ours")
def dual_vector(aid: Aid = "static", **options: Any) -> DualVector:
    """Gravity in inertial space early and late, each averaged with a Hann window, and TRIAD."""
    from jaxalign.two_vector import DualVector

    return DualVector(**options)


@_recipe("static", source="vondrak_disturbed_base (6)-(20), signs repaired")
def fine(aid: Aid = "static", **options: Any) -> Fine:
    """Fine alignment: 15-state error Kalman filter with zero-velocity updates, started by dual_vector."""
    from jaxalign.fine import Fine

    return Fine(**options)


@_recipe("static", source="xu2017 (7)-(12), Scheme 1")
def gravity_q(aid: Aid = "static", **options: Any) -> Aligner:
    """q-method on the directions of the specific force: maximum likelihood for a swaying base."""
    return Aligner(observe.Static(vectors="instantaneous", **options), estimate=estimate.QMethod(normalise=True))


@_recipe("static", source="xu2017 (13)-(14), Scheme 2; weighted by length instead of normalised")
def velocity_q(aid: Aid = "static", **options: Any) -> Aligner:
    """q-method on the integrated specific force: best under linear sway about a fixed place."""
    return Aligner(observe.Static(**options), estimate=estimate.QMethod())


@_recipe("body", "nav", "static", source="xu2020 (6)-(22); shen2025 OBA; huang q-method with normalise")
def oba(aid: Aid = "body", **options: Any) -> Aligner:
    """Optimisation-based alignment: q-method on velocity vectors integrated since the start."""
    return Aligner(observer(aid, **options), estimate=estimate.QMethod())


@_recipe("body", "nav", source="shen2025's ROBA; residuals as defined here")
def roba(aid: Aid = "body", **options: Any) -> Aligner:
    """Robust OBA: Huber's weight on the residual of each vector."""
    return Aligner(observer(aid, **options), weight=weight.Huber(), estimate=estimate.QMethod())


@_recipe("body", "nav", source="shen2025 (9)-(17), Appendix A")
def moba(aid: Aid = "body", **options: Any) -> Aligner:
    """Mahalanobis OBA: vectors whose misfit in length is unlike its history are weighted down."""
    return Aligner(observer(aid, **options), weight=weight.Mahalanobis(), estimate=estimate.QMethod())


@_recipe("body", "static", source="xu2020 (27)-(40), repaired; reconstruct.as_published for the record")
def rkf_oba(aid: Aid = "body", **options: Any) -> Aligner:
    """OBA on vectors reconstructed by a robust Kalman filter of their apparent motion."""
    return Aligner(observer(aid, **options), reconstruct.ApparentVelocityFilter(), estimate=estimate.QMethod())


@_recipe("nav", "body", source="huang's baseline; Bar-Itzhack 1996")
def request(aid: Aid = "nav", **options: Any) -> Aligner:
    """REQUEST: K as a running mean of unit vectors with a fixed gain, which forgets."""
    return Aligner(observer(aid, **options), estimate=estimate.Request())


@_recipe("nav", "body", source="huang's baseline; Choukroun 2004")
def optimal_request(aid: Aid = "nav", **options: Any) -> Aligner:
    """Optimal-REQUEST: K as a running mean with the gain of a Kalman filter."""
    return Aligner(observer(aid, **options), estimate=estimate.OptimalRequest())


@_recipe("nav", "body", source="huang (34)-(64), regularised; estimate.kappa=0 is the printed, singular form")
def vo_tvk(aid: Aid = "nav", **options: Any) -> Aligner:
    """VO-TVK: the elements of K as the state of a Kalman filter."""
    return Aligner(observer(aid, **options), estimate=estimate.KMatrixFilter())


@_recipe("static", source="xu2017 (20)-(28), Scheme 3; vectors averaged over 1 s first")
def quaternion_kf(aid: Aid = "static", **options: Any) -> Aligner:
    """Quaternion Kalman filter on the directions of the specific force."""
    return Aligner(observe.Static(vectors="instantaneous", **options), estimate=estimate.QuaternionFilter())


@_recipe("static", source="xu2017 (30)-(35), Scheme 4; basis scaled")
def rls_quaternion_kf(aid: Aid = "static", **options: Any) -> Aligner:
    """Quaternion Kalman filter on the force as fitted by recursive least squares."""
    seen = observe.Static(vectors="instantaneous", **options)
    return Aligner(seen, reconstruct.Rls(), estimate=estimate.QuaternionFilter(averaging=0.0))


@_recipe("static", source="xu2017 (30)-(35) with the q-method of Scheme 1")
def rls_q(aid: Aid = "static", **options: Any) -> Aligner:
    """q-method on the directions of the force as fitted by recursive least squares."""
    return Aligner(
        observe.Static(vectors="instantaneous", **options), reconstruct.Rls(), estimate=estimate.QMethod(normalise=True)
    )


@_recipe("body", "nav", source="none of the papers: Wahba's problem with the first velocity eliminated")
def centred_oba(aid: Aid = "body", **options: Any) -> Aligner:
    """The same with the first velocity free: on the Cramer-Rao bound for clean aid noise."""
    return Aligner(observer(aid, **options), estimate=estimate.CentredWahba())


@_recipe("body", "nav", source="none of the papers: centred, reweighted over a history, in constant memory")
def revising_oba(aid: Aid = "body", **options: Any) -> Aligner:
    """The same with outliers: recursive, and the weights of the last 64 vectors are open to revision."""
    return Aligner(observer(aid, **options), estimate=estimate.RevisingWahba())


@_recipe("body", "nav", "static", source="none of the papers: mixture likelihood, Gauss-Newton by filter and smoother")
def robust_map(aid: Aid = "body", **options: Any) -> RobustMap:
    """The most probable attitude by all fixes, outliers told from the rest, with biases and honest deviations."""
    from jaxalign.batch import RobustMap

    return RobustMap(aid=aid, **options)


def build(
    name: str,
    aid: str | None = None,
    parameters: dict[str, Any] | None = None,
    prefilter: str | AbstractPrefilter | None = None,
) -> Any:
    """A method by name.

    Args:
        name: of the recipe.
        aid: "static", "body" or "nav"; by default what the recipe is first meant for.
        parameters: path -> value (strings are parsed), see :func:`jaxalign.with_parameters`.
        prefilter: low-pass filter of the specific force in front of a method for a standing vehicle: a name of
            :data:`jaxalign.prefilter.PREFILTERS` or a filter; its numbers are ``prefilter.cutoff`` and so on.

    Raises:
        UserError: unknown name, filter or parameter (the nearest are offered), an aid that the recipe does not take, or
            a prefilter with a velocity aid.
    """
    if name not in RECIPES:
        if name == "auto":
            raise UserError("auto is a choice for one log: `jaxalign align`, or jaxalign.choose(log)")
        near = close_names(name, RECIPES)
        hint = f"did you mean {', '.join(near)}?" if near else f"there are {', '.join(RECIPES)}"
        raise UserError(f"no method {name!r}: {hint}")
    recipe = RECIPES[name]
    kind = aid or recipe.aids[0]
    if kind not in recipe.aids:
        raise UserError(f"{name} does not take a {kind!r} aid, only {', '.join(recipe.aids)}")
    method = recipe.make(kind)
    if prefilter is not None:
        method = dataclasses.replace(method, prefilter=_filter(prefilter))
    return with_parameters(method, parameters or {})


def build_for(
    aid: str, name: str, parameters: dict[str, Any] | None = None, prefilter: str | AbstractPrefilter | None = None
) -> Any:
    """A method by name for data with a kind of aid: one that takes no aid at all leaves it aside.

    Arguments and errors as of :func:`build`.
    """
    alone = name in RECIPES and RECIPES[name].aids == ("static",)
    return build(name, "static" if alone else aid, parameters, prefilter)


def _filter(given: Any) -> AbstractPrefilter:
    """A filter, or the one of a name."""
    from jaxalign.prefilter import PREFILTERS, AbstractPrefilter

    if isinstance(given, str):
        if given not in PREFILTERS:
            near = close_names(given, PREFILTERS) or list(PREFILTERS)
            raise UserError(f"no prefilter {given!r}: did you mean {', '.join(near)}?")
        return PREFILTERS[given]()
    if not isinstance(given, AbstractPrefilter):
        raise UserError(f"prefilter = {given!r}: must be one of {', '.join(PREFILTERS)}, or a filter such as Vondrak()")
    return given
