"""What the recursions consume: one increment and one aid velocity per epoch, on the device."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxalign.earth import Site
from jaxalign.errors import UserError
from jaxalign.log import Log
from jaxalign.parametrization import as_float64
from jaxalign.precision import require_x64
from jaxalign.prefilter import AbstractPrefilter, filtered_force
from jaxalign.preintegration import Increment, Scheme, preintegrate
from jaxalign.preintegration_host import joined, preintegrated
from jaxalign.vector import Quat, Vec3

__all__ = [
    "Aid",
    "Epoch",
    "Epochs",
    "check_every",
    "check_prefilter",
    "epochs_from_arrays",
    "epochs_from_log",
    "over_runs",
    "row_numbers",
]

Aid = Literal["static", "body", "nav"]


class Epoch(eqx.Module):
    """One row: the interval up to the epoch and the aid at the epoch.

    Attributes:
        rotation: from b now to b at the previous epoch.
        dvel: integral of the specific force over the interval, m/s, in b at the previous epoch.
        dt: length of the interval, s; zero at the first epoch.
        velocity: of the aid, m/s, in b or n; any finite number where not ``valid``.
        valid: whether the aid has a sample here.
    """

    rotation: Quat
    dvel: Vec3
    dt: Float[Array, "*epochs"]
    velocity: Vec3
    valid: Bool[Array, "*epochs"]

    @classmethod
    def of(cls, rotation, dvel, dt, velocity) -> Epoch:
        """Build from arrays: rotation (..., 4), dvel (..., 3), dt (...), velocity (..., 3) with NaN where missing."""
        safe, valid = _known(jnp.asarray(velocity, jnp.float64))
        return cls(Quat.of(rotation), Vec3.of(dvel), jnp.asarray(dt, jnp.float64), safe, valid)

    @classmethod
    def start(cls, velocity) -> Epoch:
        """The first epoch: no interval before it, the aid's velocity (3,), NaN if missing."""
        return cls.of(jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.zeros(3), 0.0, velocity)


def _known(velocity) -> tuple[Vec3, Bool[Array, "*epochs"]]:
    """NaN means missing, at this boundary only: inside, a mask and a finite number."""
    valid = jnp.all(jnp.isfinite(velocity), axis=-1)
    return Vec3.of(jnp.where(valid[..., None], velocity, 0.0)), valid


class Epochs(eqx.Module):
    """A log, preintegrated: M+1 rows, the first without an interval. A pytree: batch it, vmap over it.

    Attributes:
        rows: an :class:`Epoch` with leaves of shape (M+1,).
        site: latitude, longitude, height of the start.
        aid_sd: standard deviation of the aid's white noise per axis, m/s (standing: of the force over one interval).
        aid: "static", "body" or "nav" (static).
        interval: nominal length of an interval, s, to four digits (static: windows in seconds become counts by it).
        filtered: whether a prefilter has smoothed the force.
    """

    rows: Epoch
    site: Site
    aid_sd: Float[Array, ""]
    aid: Aid = eqx.field(static=True)
    interval: float = eqx.field(static=True)
    filtered: bool = eqx.field(static=True, default=False)

    def __len__(self) -> int:
        return self.rows.dt.shape[-1]


def over_runs(f: Callable[[Epochs], Any], epochs: Epochs) -> Any:
    """``f`` of each of many runs: of the leaves of ``epochs.rows`` those that differ have the runs on the last axis.

    Returns:
        What ``f`` returns, with the runs on a first axis.
    """
    axes = jax.tree.map(lambda _: None, epochs)
    rows = jax.tree.map(lambda x: -1 if x.ndim > 1 else None, epochs.rows)
    axes = eqx.tree_at(lambda e: e.rows, axes, rows, is_leaf=lambda x: x is None)
    return jax.vmap(f, in_axes=(axes,))(epochs)


def check_every(every: Any) -> None:
    """Refuse rows that are no whole number of epochs apart."""
    try:
        whole = every == int(every) and every >= 1
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole or isinstance(every, str):
        raise UserError(f"every = {every}: must be a whole number of epochs, at least 1")


def row_numbers(count: int, rows: Any) -> np.ndarray:
    """Numbers of the epochs to read out, of so many.

    Args:
        count: of epochs.
        rows: epochs between two rows (epoch 0, each so many epochs, and the last), or the numbers themselves.

    Raises:
        UserError: a number that is no epoch, or no whole number of epochs between two rows.
    """
    if np.ndim(rows) == 0:
        check_every(rows)
        return np.unique([*range(0, count, int(rows)), count - 1])
    numbers = np.asarray(rows)
    if numbers.ndim != 1:
        raise UserError(f"rows has shape {numbers.shape}: (n,) is expected, numbers of epochs")
    if not (np.issubdtype(numbers.dtype, np.integer) and numbers.size and 0 <= numbers.min() <= numbers.max() < count):
        raise UserError(f"rows = {rows}: must be whole numbers from 0 to {count - 1}")
    return numbers


def strided_rows(count: int, rows: Any) -> tuple[int, tuple[int, ...] | None]:
    """Rows of a recursion, which reads out at a stride: the stride, and which of its rows to take (None: all).

    Arguments and errors as of :func:`row_numbers`.
    """
    if np.ndim(rows) == 0:
        check_every(rows)
        return int(rows), None
    numbers, last = row_numbers(count, rows), count - 1
    stride = int(np.gcd.reduce(numbers[numbers < last])) or max(last, 1)
    strided = row_numbers(count, stride)
    return stride, None if np.array_equal(strided, numbers) else tuple(np.searchsorted(strided, numbers).tolist())


@partial(jax.jit, static_argnames=("every", "scheme"))
def _rows(dtheta, dvel, dt, velocity, every: int, scheme: Scheme) -> Epoch:
    moved = preintegrate(dtheta, dvel, every, scheme)
    still = Increment(Quat.identity(), Vec3.zero())
    rows = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), still, moved)
    steps = jnp.concatenate([jnp.zeros(1), jnp.full(dtheta.shape[0] // every, every * dt)])
    safe, valid = _known(velocity)
    return Epoch(rows.rotation, rows.dvel, steps, safe, valid)


def _host_rows(dtheta: np.ndarray, dvel: np.ndarray, dt: float, velocity: np.ndarray, every: int) -> Epoch:
    """The same of recorded data by the scheme ``pairs``, on the host: nothing to compile."""
    still = Increment(Quat(*np.eye(4)[:, :1]), Vec3(*np.zeros((3, 1))))
    moved = joined([still, preintegrated(dtheta, dvel, every)])
    steps = np.full(len(velocity), every * dt)
    steps[0] = 0.0
    valid = np.isfinite(velocity).all(axis=-1)
    safe = Vec3(*np.where(valid, velocity.T, 0.0))
    rows = Epoch(moved.rotation, moved.dvel, steps, safe, valid)  # pyright: ignore[reportArgumentType]
    return jax.device_put(rows)


_filtered = eqx.filter_jit(filtered_force)


def _digits(seconds: float) -> float:
    """Four of them: logs whose clocks differ in the seventh share a compiled program."""
    return float(f"{float(seconds):.4g}")


def check_prefilter(prefilter: AbstractPrefilter | None, aid: str) -> None:
    """Refuse a prefilter for a moving vehicle.

    Raises:
        UserError: the aid is a velocity.
    """
    if prefilter is not None and aid != "static":
        raise UserError(
            f"a prefilter smooths the force of a standing vehicle; with a {aid!r} aid it would smooth the motion "
            "itself away: leave it out"
        )


def epochs_from_arrays(
    dtheta: Float[ArrayLike, "samples 3"],
    dvel: Float[ArrayLike, "samples 3"],
    velocity: Float[ArrayLike, "epochs 3"] | None,
    *,
    dt: float,
    every: int,
    site: Site,
    aid: Aid,
    aid_sd: float = 1.0,
    scheme: Scheme = "pairs",
    prefilter: AbstractPrefilter | None = None,
) -> Epochs:
    """Preintegrate arrays; pure and differentiable in all of them (for logs use :func:`epochs_from_log`).

    Args:
        dtheta: rotation increments, rad.
        dvel: velocity increments, m/s.
        velocity: of the aid at the epochs, m/s, NaN where missing; (samples // every + 1, 3); None: at rest.
        dt: sampling interval, s.
        every: samples per epoch.
        site: where.
        aid: what ``velocity`` is.
        aid_sd: noise of the aid, m/s.
        scheme: of the preintegration.
        prefilter: low-pass filter of the specific force of a standing vehicle, before anything else.

    Raises:
        UserError: float32 input, an unknown kind of aid, or a prefilter with a velocity aid.
    """
    require_x64({"dtheta": dtheta, "dvel": dvel, "velocity": velocity, "site": site})
    if aid not in get_args(Aid):
        raise UserError(f"aid = {aid!r}: must be one of {', '.join(get_args(Aid))}")
    if prefilter is not None:
        check_prefilter(prefilter, aid)
        dvel = _filtered(prefilter, dtheta, dvel, _digits(dt))
    intervals = np.shape(dtheta)[0] // every  # nothing here is an operation of JAX: each would be compiled
    if velocity is None:
        velocity = np.zeros((intervals + 1, 3))
    elif not isinstance(velocity, jax.Array):
        velocity = np.asarray(velocity)
    if len(velocity) != intervals + 1:
        raise ValueError(f"{intervals} intervals need {intervals + 1} velocities, got {len(velocity)}")
    if scheme == "pairs" and all(isinstance(x, np.ndarray) for x in (dtheta, dvel, velocity)):
        rows = _host_rows(dtheta, dvel, dt, velocity, every)  # pyright: ignore[reportArgumentType]
    else:
        rows = _rows(dtheta, dvel, dt, velocity, every, scheme)
    return Epochs(rows, site, as_float64(aid_sd), aid, _digits(every * dt), prefilter is not None)


def epochs_from_log(
    log: Log,
    *,
    interval_samples: int | None = None,
    scheme: Scheme = "pairs",
    static: bool = False,
    prefilter: AbstractPrefilter | None = None,
) -> Epochs:
    """Preintegrate a log.

    Args:
        log: the checked log.
        interval_samples: IMU samples per epoch; by default the log's own. With a velocity aid it must divide
            the aid's interval: the epochs between two fixes have no aid.
        scheme: of the preintegration.
        static: take the vehicle as standing, whatever aid the log has.
        prefilter: low-pass filter of the specific force, before anything else; standing vehicles only.

    Raises:
        UserError: float32, an ``interval_samples`` that does not fit, or a prefilter with a velocity aid.
    """
    require_x64()
    every = interval_samples or log.aid_every
    if every < 1 or len(log.dtheta) // every < 1:
        raise UserError(
            f"interval_samples = {every}: must be between 1 and the {len(log.dtheta)} samples of {log.name}"
        )
    if static or log.velocity is None:
        velocity, aid = None, "static"
    else:
        velocity, aid = log.velocity, log.aid
        if log.aid_every % every:
            raise UserError(
                f"interval_samples = {every} must divide the {log.aid_every} IMU samples between fixes of {log.name}"
            )
        if every != log.aid_every:
            ratio = log.aid_every // every
            velocity = np.full((log.epochs * ratio + 1, 3), np.nan)
            velocity[::ratio] = log.velocity
    used = (len(log.dtheta) if velocity is None else log.epochs * log.aid_every) // every * every
    return epochs_from_arrays(
        log.dtheta[:used],
        log.dvel[:used],
        velocity,
        dt=log.dt,
        every=every,
        site=Site(log.lat, log.lon, log.h),
        aid=aid,  # type: ignore[arg-type]
        aid_sd=1.0 if log.aid_sd is None else log.aid_sd,
        scheme=scheme,
        prefilter=prefilter,
    )
