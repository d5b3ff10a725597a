"""From a log to epochs: rows at the times of the aids, increments between them."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from jaxalign.aids import AbstractAid, Standing, aids_of
from jaxalign.arguments import whole_number
from jaxalign.earth import Site
from jaxalign.epochs import Epoch, Epochs, Fix
from jaxalign.errors import UserError
from jaxalign.log import Log
from jaxalign.measurements import Measurements
from jaxalign.parametrization import as_float64, given, optional_count
from jaxalign.precision import require_x64
from jaxalign.prefilter import AbstractPrefilter, filtered_force
from jaxalign.preintegration import Increment, Scheme, preintegrate
from jaxalign.preintegration_host import joined, preintegrated, preintegrated_between
from jaxalign.raw_noise import white_densities
from jaxalign.vector import Quat, Vec3

__all__ = ["FrontEnd", "aids_for", "check_prefilter", "epochs_from_arrays", "epochs_from_log", "is_standing"]

_TICK = 1e-6  # of a sample: times nearer to each other are one
_filtered = eqx.filter_jit(filtered_force)


def _digits(seconds: float) -> float:
    """Four of them: logs whose clocks differ in the seventh share a compiled program."""
    return float(f"{float(seconds):.4g}")


def is_standing(aids: tuple[AbstractAid, ...]) -> bool:
    """Whether all that is known is an assumption: the vehicle stands."""
    return all(aid.implied for aid in aids)


def check_prefilter(prefilter: AbstractPrefilter | None, aids: tuple[AbstractAid, ...]) -> None:
    """Refuse a prefilter for a moving vehicle.

    Raises:
        UserError: an aid says that it moves.
    """
    if prefilter is not None and not is_standing(aids):
        raise UserError(
            f"a prefilter smooths the force of a standing vehicle; with {aids[0].described} it would smooth the motion "
            "itself away: leave it out"
        )


class FrontEnd(eqx.Module):
    """From the samples of an inertial unit and the values of aids to epochs: what a method does before it aligns.

    Attributes:
        interval_samples: IMU samples per epoch; None: as the log has it.
        scheme: of the preintegration (:mod:`jaxalign.preintegration`).
        prefilter: low-pass filter of the specific force of a whole log of a standing vehicle; None: no filter.
    """

    interval_samples: int | None = optional_count()
    scheme: Scheme = given("pairs")
    prefilter: AbstractPrefilter | None = eqx.field(default=None, kw_only=True, metadata={"slot": True})

    def __check_init__(self):
        if self.interval_samples is not None:
            whole_number("interval_samples", self.interval_samples, of="IMU samples (none: the log's own)")

    @property
    def unfiltered(self) -> FrontEnd:
        """The same without a filter."""
        return self if self.prefilter is None else FrontEnd(self.interval_samples, self.scheme)

    def epochs(self, log: Log, aids: tuple[AbstractAid, ...], whole: bool = False) -> Epochs:
        """Epochs of a log, see :func:`epochs_from_log`."""
        return epochs_from_log(
            log,
            aids=aids,
            interval_samples=self.interval_samples,
            scheme=self.scheme,
            prefilter=self.prefilter,
            whole=whole,
        )


@partial(jax.jit, static_argnames=("every", "scheme"))
def _rows(dtheta, dvel, dt, values, every: int, scheme: Scheme) -> Epoch:
    moved = preintegrate(dtheta, dvel, every, scheme)
    still = Increment(Quat.identity(), Vec3.zero())
    rows = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), still, moved)
    steps = jnp.concatenate([jnp.zeros(1), jnp.full(dtheta.shape[0] // every, every * dt)])
    return Epoch(rows.rotation, rows.dvel, steps, tuple(Fix.of(value) for value in values))


def _with_start(moved: Increment) -> Increment:
    """On the host: with an epoch at the start."""
    return joined([Increment(Quat(*np.eye(4)[:, :1]), Vec3(*np.zeros((3, 1)))), moved])


def _host_rows(dtheta: np.ndarray, dvel: np.ndarray, dt: float, fixes: tuple[Fix, ...], every: int) -> Epoch:
    """Epochs of recorded data by the scheme ``pairs``, on the host: nothing to compile."""
    moved = _with_start(preintegrated(dtheta, dvel, every))
    steps = np.full(len(moved.rotation.w), every * dt)
    steps[0] = 0.0
    return jax.device_put(Epoch(moved.rotation, moved.dvel, steps, fixes))  # pyright: ignore[reportArgumentType]


def epochs_from_arrays(
    dtheta: Float[ArrayLike, "samples 3"],
    dvel: Float[ArrayLike, "samples 3"],
    values: Any,
    *,
    dt: float,
    every: int,
    site: Site,
    aid: Any,
    aid_sd: Any = 1.0,
    scheme: Scheme = "pairs",
    prefilter: AbstractPrefilter | None = None,
) -> Epochs:
    """Preintegrate arrays over equal intervals; pure and differentiable in all of them.

    For logs use :func:`epochs_from_log`.

    Args:
        dtheta: rotation increments, rad.
        dvel: velocity increments, m/s.
        values: of the aid at the epochs, NaN where missing, (samples // every + 1, m); a tuple of such for several
            aids; None for a standing vehicle.
        dt: sampling interval, s.
        every: samples per epoch.
        site: where.
        aid: what ``values`` are: an aid, or the name of its kind (docs/aids.md), or a tuple of them.
        aid_sd: noise of the aid, in its unit: a number or (m,); a tuple of such for several aids.
        scheme: of the preintegration.
        prefilter: low-pass filter of the specific force of a standing vehicle, before anything else.

    Raises:
        UserError: float32 input, an unknown aid, values that do not fit it, or a prefilter with an aid.
    """
    require_x64({"dtheta": dtheta, "dvel": dvel, "values": values, "site": site})
    aids = aids_of(aid)
    if prefilter is not None:
        check_prefilter(prefilter, aids)
        dvel = _filtered(prefilter, dtheta, dvel, _digits(dt))
    intervals = np.shape(dtheta)[0] // every  # nothing here is an operation of JAX: each would be compiled
    given = values if isinstance(values, tuple) else (values,)
    sd = aid_sd if isinstance(aid_sd, tuple) else (aid_sd,) * len(aids)
    if not len(given) == len(aids) == len(sd):
        raise UserError(f"values of {len(given)} aids and noise of {len(sd)}, but there are {len(aids)}: one for each")
    arrays = tuple(_values(one, x, intervals) for one, x in zip(aids, given, strict=True))
    if scheme == "pairs" and all(isinstance(x, np.ndarray) for x in (dtheta, dvel, *arrays)):
        fixes = tuple(Fix.of(x, _partial(x)) for x in arrays)
        rows = _host_rows(dtheta, dvel, dt, fixes, every)  # pyright: ignore[reportArgumentType]
    else:
        rows = _rows(dtheta, dvel, dt, arrays, every, scheme)
    deviations = tuple(as_float64(x) for x in sd)
    return Epochs(rows, site, deviations, aids, prefilter is not None)


def _values(aid: AbstractAid, values: Any, intervals: int) -> Any:
    """(M+1, m) of an aid."""
    size = len(aid.components)
    if values is None:
        if not aid.implied:
            raise UserError(f"{aid.name}: there are no values: an array ({intervals + 1}, {size}) is expected")
        return np.zeros((intervals + 1, size))
    if not isinstance(values, jax.Array):
        values = np.asarray(values)
    if values.ndim == 1 and size == 1:
        values = values[:, None]
    if values.shape != (intervals + 1, size):
        raise UserError(
            f"{aid.name}: values of shape {values.shape}, but {intervals} intervals need ({intervals + 1}, {size})"
        )
    return values


def _partial(values: np.ndarray) -> bool:
    """Whether components are missing one by one."""
    lost = np.isnan(values)
    return bool((lost.any(axis=1) & ~lost.all(axis=1)).any())


def aids_for(log: Log, aids: tuple[AbstractAid, ...]) -> tuple[tuple[AbstractAid, Measurements | None], ...]:
    """The aids of a method and what a log has of each.

    Raises:
        UserError: the log has no such aid, it has other components, or two of them would take the same values.
    """
    out: list[tuple[AbstractAid, Measurements | None]] = []
    for aid in aids:
        seen = None if aid.implied else log.measured(aid)
        if seen is None and not aid.implied:
            there = ", ".join(f"{one.name} ({one.aid.described})" for one in log.aids) or "no aid: the vehicle stands"
            raise UserError(
                f"{log.name} has no {aid.name} ({aid.described}), which the method observes: it has {there}"
            )
        if seen is not None and seen.aid.components != aid.components:
            raise UserError(
                f"{log.name}: {seen.name} has {', '.join(seen.aid.components)}, the method observes "
                f"{', '.join(aid.components)}: build it for what there is (jaxalign.methods.build_for)"
            )
        if seen is not None and (other := next((a for a, b in out if b is seen), None)):
            raise UserError(
                f"{log.name} has one {seen.name} ({seen.aid.described}), the method observes {other.name} and "
                f"{aid.name}: the same values would count twice"
            )
        out.append((aid, seen))
    return tuple(out)


def epochs_from_log(
    log: Log,
    *,
    aids: Any = None,
    interval_samples: int | None = None,
    scheme: Scheme = "pairs",
    prefilter: AbstractPrefilter | None = None,
    whole: bool = False,
) -> Epochs:
    """Preintegrate a log: a row at every time at which an aid has measured.

    A fix between two IMU samples splits that sample linearly.

    Args:
        log: the checked log.
        aids: which of them to take; by default all, or :class:`jaxalign.Standing` for a log without.
        interval_samples: IMU samples per epoch, at most; by default those of the log. Between fixes there are epochs
            without an aid.
        scheme: of the preintegration.
        prefilter: low-pass filter of the specific force, before anything else; standing vehicles only.
        whole: of a velocity take what is whole: a component that is missing takes the others with it.

    Raises:
        UserError: float32, an aid that the log has not, an ``interval_samples`` that does not fit, a prefilter with an
            aid, or a scheme that needs equal intervals where they are not.
    """
    require_x64()
    chosen = tuple(one.aid for one in log.aids) or (Standing(),) if aids is None else aids_of(aids)
    seen = aids_for(log, chosen)
    every = interval_samples or log.epoch_samples
    if every < 1 or len(log.dtheta) // every < 1:
        raise UserError(
            f"interval_samples = {every}: must be between 1 and the {len(log.dtheta)} samples of {log.name}"
        )
    moving = [one for _, one in seen if one is not None]
    places = [_places(one.time, log.dt) for one in moving]
    end = log.epochs * log.epoch_samples if moving else len(log.dtheta)
    if all((x == np.round(x)).all() and (x % log.epoch_samples == 0).all() for x in places):
        rows = _equal_rows(log, every, end, bool(moving))
    else:
        rows = _union(places, every if interval_samples else None, len(log.dtheta))
    values = tuple(_at_rows(aid, one, log.dt, rows, whole) for aid, one in seen)
    sd = tuple(1.0 if one is None or one.sd is None else one.sd for _, one in seen)
    known, site = tuple(aid for aid, _ in seen), Site(log.lat, log.lon, log.h)
    raw = white_densities(log.dtheta, log.dvel, log.dt)
    step = int(rows[1]) if (rows == np.arange(len(rows)) * rows[1]).all() and rows[1] == round(rows[1]) else None
    if step is not None:
        used = int(rows[-1])
        of_all = {"dt": log.dt, "every": step, "site": site, "aid": known, "aid_sd": sd}
        made = epochs_from_arrays(
            log.dtheta[:used], log.dvel[:used], values, **of_all, scheme=scheme, prefilter=prefilter
        )
        return dataclasses.replace(made, raw_noise=raw)
    if scheme != "pairs" or prefilter is not None:
        raise UserError(
            f"{log.name}: its aids do not measure at equal intervals: the scheme {scheme!r} and prefilters need those"
        )
    moved = _with_start(preintegrated_between(log.dtheta, log.dvel, rows))
    steps = np.diff(rows, prepend=0.0) * log.dt
    fixes = tuple(Fix.of(x, _partial(x)) for x in values)
    made = jax.device_put(Epoch(moved.rotation, moved.dvel, steps, fixes))  # pyright: ignore[reportArgumentType]
    return Epochs(made, site, tuple(as_float64(x) for x in sd), known, raw_noise=raw)


def _places(time: np.ndarray, dt: float) -> np.ndarray:
    """Times of fixes in samples, on a boundary between samples where they are as good as there."""
    place = time / dt
    near = np.round(place)
    tick = np.maximum(_TICK, 4e-16 * np.abs(place))
    return np.maximum(np.where(np.abs(place - near) <= tick, near, place), 0.0)


def _equal_rows(log: Log, every: int, end: int, moving: bool) -> np.ndarray:
    """Rows at the epochs of the log, or more often."""
    if moving and log.epoch_samples % every:
        raise UserError(
            f"interval_samples = {every} must divide the {log.epoch_samples} IMU samples between fixes of {log.name}"
        )
    return np.arange(end // every + 1) * float(every)


def _union(places: list[np.ndarray], every: int | None, count: int) -> np.ndarray:
    """Rows at all these places, from the start to the last of them, with others in between where they are far apart."""
    last = min(max(float(x[-1]) for x in places), float(count))
    more = np.arange(0.0, last, every) if every else np.zeros(1)
    rows = np.unique(np.concatenate([*places, more, [0.0]]))
    rows = rows[rows <= last]
    return rows[np.concatenate([[True], np.diff(rows) > _TICK])]


def _at_rows(aid: AbstractAid, seen: Measurements | None, dt: float, rows: np.ndarray, whole: bool) -> np.ndarray:
    """(K, m) values at the rows, NaN where there is none."""
    if seen is None:
        return np.zeros((len(rows), len(aid.components)))
    value = seen.value
    if whole:
        value = np.where(np.isnan(value).any(axis=1, keepdims=True), np.nan, value)
    place = _places(seen.time, dt)
    index = np.clip(np.searchsorted(rows, place - _TICK), 0, len(rows) - 1)
    inside = np.abs(rows[index] - place) <= 2 * _TICK
    out = np.full((len(rows), value.shape[1]), np.nan)
    out[index[inside]] = value[inside]
    return out
