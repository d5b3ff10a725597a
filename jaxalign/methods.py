"""The methods by name: each a choice of slots, or one that takes the whole history.

A recipe is a function from the aid to a method; its options are those of the observation slot. Everything
else is set by path, with :func:`jaxalign.with_parameters`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from jaxalign import estimate, observe, reconstruct, weight
from jaxalign.aids import AbstractAid, BodyVelocity, NavVelocity, Standing, aids_of
from jaxalign.aligner import Aligner
from jaxalign.arguments import nearest
from jaxalign.errors import UserError, close_names
from jaxalign.front_end import FrontEnd, is_standing
from jaxalign.parametrization import with_parameters
from jaxalign.published.moved import check_moved
from jaxalign.published.recipes import PUBLISHED
from jaxalign.recipes import Contract, Recipe, registering
from jaxalign.renamed import check_renamed

if TYPE_CHECKING:
    from jaxalign.batch import Auto, RobustMap
    from jaxalign.fine import Fine
    from jaxalign.prefilter import AbstractPrefilter
    from jaxalign.two_vector import DualVector, MeanTriad

__all__ = [
    "RECIPES",
    "Recipe",
    "auto",
    "build",
    "build_for",
    "centred_oba",
    "dual_vector",
    "fine",
    "gravity_q",
    "moba",
    "oba",
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
    "with_settings",
]


RECIPES: dict[str, Recipe] = {}
"""All recipes by name: those below, and those that only reproduce print (``recipe.published``)."""

_recipe = registering(RECIPES)


@_recipe(
    Standing,
    source="vondrak_disturbed_base (1)-(5), repaired",
    contract=Contract(closure_deg=math.inf, uses_latitude=False),
)
def triad(aid: AbstractAid = Standing(), **options: Any) -> MeanTriad:
    """Mean specific force and mean rotation: for a base that does not turn at all."""
    from jaxalign.two_vector import MeanTriad

    return MeanTriad(**options)


@_recipe(Standing, source="vondrak_disturbed_base, inertial frame; Hann windows ours")
def dual_vector(aid: AbstractAid = Standing(), **options: Any) -> DualVector:
    """Gravity in inertial space early and late, each averaged with a Hann window, and TRIAD."""
    from jaxalign.two_vector import DualVector

    return DualVector(**options)


@_recipe(Standing, source="vondrak_disturbed_base (6)-(20), signs repaired")
def fine(aid: AbstractAid = Standing(), **options: Any) -> Fine:
    """Fine alignment: 15-state error Kalman filter with zero-velocity updates, started by dual_vector."""
    from jaxalign.fine import Fine

    return Fine(**options)


@_recipe(Standing, source="xu2017 (7)-(12), Scheme 1")
def gravity_q(aid: AbstractAid = Standing(), **options: Any) -> Aligner:
    """q-method on the directions of the specific force: maximum likelihood for a swaying base."""
    seen = observe.GravityVectors(vectors="instantaneous", **options)
    return Aligner(seen, estimate=estimate.QMethod(normalise=True))


@_recipe(Standing, source="xu2017 (13)-(14), Scheme 2; weighted by length instead of normalised")
def velocity_q(aid: AbstractAid = Standing(), **options: Any) -> Aligner:
    """q-method on the integrated specific force: best under linear sway about a fixed place."""
    return Aligner(observe.GravityVectors(**options), estimate=estimate.QMethod())


@_recipe(BodyVelocity, NavVelocity, Standing, source="xu2020 (6)-(22); shen2025 OBA; huang q-method with normalise")
def oba(aid: AbstractAid = BodyVelocity(), **options: Any) -> Aligner:
    """Optimisation-based alignment: q-method on velocity vectors integrated since the start."""
    return Aligner(observe.observer(aid, **options), estimate=estimate.QMethod())


@_recipe(
    BodyVelocity,
    NavVelocity,
    source="shen2025's ROBA; residuals as defined here",
    contract=Contract(smooth={"weight.threshold": 10.0}),
)
def roba(aid: AbstractAid = BodyVelocity(), **options: Any) -> Aligner:
    """Robust OBA: Huber's weight on the residual of each vector."""
    return Aligner(observe.observer(aid, **options), weight=weight.Huber(), estimate=estimate.QMethod())


@_recipe(
    BodyVelocity,
    NavVelocity,
    source="shen2025 (9)-(17), Appendix A",
    contract=Contract(rounding=5e-8, latitude_steps=(1e-5, 5e-6), number_steps=(1e-4, 3e-5), small_gap=True),
)
def moba(aid: AbstractAid = BodyVelocity(), **options: Any) -> Aligner:
    """Mahalanobis OBA: vectors whose misfit in length is unlike its history are weighted down."""
    return Aligner(observe.observer(aid, **options), weight=weight.Mahalanobis(), estimate=estimate.QMethod())


@_recipe(
    BodyVelocity,
    Standing,
    source="xu2020 (27)-(40), repaired",
    contract=Contract(
        closure_deg=0.05,
        mounting=2e-3,
        sensitive=True,
        smooth={"reconstruct.threshold": 100.0},
        velocity_steps=(5e-5, 2e-5),
    ),
)
def rkf_oba(aid: AbstractAid = BodyVelocity(), **options: Any) -> Aligner:
    """OBA on vectors reconstructed by a robust Kalman filter of their apparent motion."""
    return Aligner(observe.observer(aid, **options), reconstruct.ApparentVelocityFilter(), estimate=estimate.QMethod())


@_recipe(
    NavVelocity,
    BodyVelocity,
    source="huang's baseline; Bar-Itzhack 1996",
    contract=Contract(closure_deg=0.1, forgets=True),
)
def request(aid: AbstractAid = NavVelocity(), **options: Any) -> Aligner:
    """REQUEST: K as a running mean of unit vectors with a fixed gain, which forgets."""
    return Aligner(observe.observer(aid, **options), estimate=estimate.Request())


@_recipe(NavVelocity, BodyVelocity, source="huang's baseline; Choukroun 2004")
def optimal_request(aid: AbstractAid = NavVelocity(), **options: Any) -> Aligner:
    """Optimal-REQUEST: K as a running mean with the gain of a Kalman filter."""
    return Aligner(observe.observer(aid, **options), estimate=estimate.OptimalRequest())


@_recipe(
    NavVelocity,
    BodyVelocity,
    source="huang (34)-(64), regularised",
    contract=Contract(
        closure_deg=0.2,
        mounting=math.inf,  # its nine elements do not turn as a whole
        latitude_steps=(2e-3, 1e-3),
        number_steps=(2e-2, 1e-2),
        slope_rounding=1e-7,  # it begins with a relative gap of 2e-12
    ),
)
def vo_tvk(aid: AbstractAid = NavVelocity(), **options: Any) -> Aligner:
    """VO-TVK: the elements of K as the state of a Kalman filter."""
    return Aligner(observe.observer(aid, **options), estimate=estimate.KMatrixFilter())


@_recipe(Standing, source="xu2017 (20)-(28), Scheme 3; vectors averaged over 1 s first")
def quaternion_kf(aid: AbstractAid = Standing(), **options: Any) -> Aligner:
    """Quaternion Kalman filter on the directions of the specific force."""
    return Aligner(observe.GravityVectors(vectors="instantaneous", **options), estimate=estimate.QuaternionFilter())


@_recipe(Standing, source="xu2017 (30)-(35), Scheme 4; basis scaled", contract=Contract(closure_deg=0.03))
def rls_quaternion_kf(aid: AbstractAid = Standing(), **options: Any) -> Aligner:
    """Quaternion Kalman filter on the force as fitted by recursive least squares."""
    seen = observe.GravityVectors(vectors="instantaneous", **options)
    return Aligner(seen, reconstruct.Rls(), estimate=estimate.QuaternionFilter(averaging=0.0))


@_recipe(Standing, source="xu2017 (30)-(35) with the q-method of Scheme 1", contract=Contract(closure_deg=0.03))
def rls_q(aid: AbstractAid = Standing(), **options: Any) -> Aligner:
    """q-method on the directions of the force as fitted by recursive least squares."""
    seen = observe.GravityVectors(vectors="instantaneous", **options)
    return Aligner(seen, reconstruct.Rls(), estimate=estimate.QMethod(normalise=True))


@_recipe(BodyVelocity, NavVelocity, source="none of the papers: Wahba's problem with the first velocity eliminated")
def centred_oba(aid: AbstractAid = BodyVelocity(), **options: Any) -> Aligner:
    """OBA with the first velocity free: on the Cramer-Rao bound for clean aid noise."""
    return Aligner(observe.observer(aid, **options), estimate=estimate.CentredWahba())


@_recipe(
    BodyVelocity,
    NavVelocity,
    source="none of the papers: centred, reweighted over a history, in constant memory",
    contract=Contract(sensitive=True, velocity_steps=(1e-5, 5e-6), latitude_steps=(5e-6, 2e-6), small_gap=True),
)
def revising_oba(aid: AbstractAid = BodyVelocity(), **options: Any) -> Aligner:
    """OBA with the first velocity free, for outliers: the weights of the last 64 vectors are open to revision."""
    return Aligner(observe.observer(aid, **options), estimate=estimate.RevisingWahba())


@_recipe(
    BodyVelocity,
    NavVelocity,
    Standing,
    source="none of the papers: mixture likelihood, Gauss-Newton by filter and smoother",
    # The covariance starts at a radian, and loses 1e-7 of what the fixes say to rounding; the first velocity is free.
    contract=Contract(rounding=2e-7, number_steps=(2e-2, 1e-2), free=1e6),
    several=True,
)
def robust_map(aid: Any = BodyVelocity(), **options: Any) -> RobustMap:
    """The most probable attitude by all fixes, outliers told from the rest, with biases and honest deviations."""
    from jaxalign.batch import RobustMap

    return RobustMap(aids=aids_of(aid), **options)


@_recipe(
    BodyVelocity,
    NavVelocity,
    Standing,
    source="none of the papers: robust_map with the grade of the unit that the likelihood allows",
    contract=RECIPES["robust_map"].contract,
    several=True,
)
def auto(aid: Any = BodyVelocity(), **options: Any) -> Auto:
    """robust_map for a log of which nothing is said: the usual unknowns of its aids, the grade of the unit as found."""
    from jaxalign.batch.auto import Auto, usual_unknowns
    from jaxalign.batch.robust_map import RobustMap

    aids, imu = aids_of(aid), options.pop("imu", None)
    return Auto(RobustMap(aids=aids, **{"calibrate": usual_unknowns(aids), **options}), imu)


RECIPES.update(PUBLISHED)


def build(
    name: str,
    aid: Any = None,
    parameters: dict[str, Any] | None = None,
    prefilter: str | AbstractPrefilter | None = None,
    interval_samples: int | None = None,
    **options: Any,
) -> Any:
    """A method by name.

    Args:
        name: of the recipe.
        aid: an aid, or the name of its kind (docs/aids.md); of a method that takes several, a tuple of them. By default
            what the recipe is first meant for.
        parameters: path -> value (strings are parsed), see :func:`jaxalign.with_parameters`.
        prefilter: low-pass filter of the specific force in front of a method for a standing vehicle: a name of
            :data:`jaxalign.prefilter.PREFILTERS` or a filter; its numbers are ``front_end.prefilter.cutoff`` and
            so on.
        interval_samples: IMU samples per epoch; None: as the log has it.
        **options: of the recipe: those of its observation slot (``window=10.0``), or of the method that has none.

    Raises:
        UserError: unknown name, filter, option or parameter (the nearest are offered), an aid that the recipe does not
            take, or a prefilter with a velocity aid.
    """
    if name not in RECIPES:
        near = close_names(name, RECIPES)
        hint = f"did you mean {', '.join(near)}?" if near else f"there are {', '.join(RECIPES)}"
        raise UserError(f"no method {name!r}: {hint}")
    recipe = RECIPES[name]
    aids = aids_of(recipe.aids[0] if aid is None else aid)
    for one in aids:
        if not recipe.takes(one):
            known = ", ".join(kind.kind for kind in recipe.aids)
            raise UserError(f"{name} does not take {one.name} ({one.described}), only {known}")
    if not recipe.several and len(aids) != 1:
        raise UserError(f"{name} takes one aid, not {len(aids)}")
    method = _made(recipe, aids if recipe.several else aids[0], options)
    if prefilter is not None or interval_samples is not None:
        filtered = None if prefilter is None else _filter(prefilter)
        method = method.with_front_end(FrontEnd(interval_samples, prefilter=filtered))
    return with_settings(name, method, parameters or {})


def with_settings(name: str, method: Any, values: Mapping[str, Any]) -> Any:
    """A method of a recipe with some fields set, see :func:`jaxalign.with_parameters`.

    Args:
        name: of the recipe.
        method: made by it.
        values: path -> value (strings are parsed).

    Raises:
        UserError: as there; of an option that is in :mod:`jaxalign.published` now, what to write instead.
    """
    check_moved(name, method, values)
    return with_parameters(method, values)


def _made(recipe: Recipe, aid: Any, options: Mapping[str, Any]) -> Any:
    """What a recipe makes with these options."""
    try:
        return recipe.make(aid, **options)
    except TypeError as error:  # an unknown name, or one that the recipe sets itself
        plain = recipe.make(aid)
        part = vars(plain).get("observe") or vars(plain).get("estimator") or plain
        known = [field.name for field in dataclasses.fields(part) if not field.metadata.get("given")]
        for option in options:
            if option not in known:
                check_renamed(option, known)
                raise UserError(f"{recipe.name} has no option {option!r}: {nearest(option, known)}") from None
        raise UserError(f"{recipe.name}: {error}") from error


def build_for(
    aids: Any,
    name: str,
    parameters: dict[str, Any] | None = None,
    prefilter: str | AbstractPrefilter | None = None,
    **options: Any,
) -> Any:
    """A method by name for data with some aids (none: the vehicle stands): with all of them, or the one that it takes.

    Arguments and errors as of :func:`build`; also where several aids would do, and one must be named.
    """
    recipe, aids = RECIPES.get(name), aids_of(aids)
    if recipe is None:
        return build(name)  # it says what is wrong
    if recipe.stands_only or is_standing(aids):
        return build(name, Standing(), parameters, prefilter, **options)
    if recipe.several:
        return build(name, aids, parameters, prefilter, **options)
    fit = [aid for aid in aids if recipe.takes(aid) and aid.full_velocity]
    if not fit:
        known = " or ".join(kind().described for kind in recipe.aids)
        there = ", ".join(f"{aid.name} ({aid.described})" for aid in aids)
        raise UserError(f"{name} takes {known}, and there is {there}: robust_map takes what there is")
    if len(fit) > 1:
        raise UserError(f"{name} takes one of {', '.join(aid.name for aid in fit)}: say which (--aid NAME, Log.only)")
    return build(name, fit[0], parameters, prefilter, **options)


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
