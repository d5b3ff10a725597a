"""What the methods consume: an increment and the measurements of the aids per epoch, on the device."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxalign.aids import AbstractAid
from jaxalign.arguments import whole_number
from jaxalign.earth import Site
from jaxalign.errors import UserError
from jaxalign.parametrization import as_float64
from jaxalign.vector import Quat, Vec3

__all__ = [
    "Epoch",
    "Epochs",
    "Fix",
    "check_every",
    "over_runs",
    "row_numbers",
    "strided_rows",
]


class Fix(eqx.Module):
    """What an aid has measured at an epoch.

    Attributes:
        value: its components, in its unit; any finite numbers where there is nothing.
        valid: whether there is any component.
        each: which components there are, for an aid that may lack some; None: all or none.
    """

    value: tuple[Float[Array, "*epochs"], ...]
    valid: Bool[Array, "*epochs"]
    each: tuple[Bool[Array, "*epochs"], ...] | None = None

    @classmethod
    def of(cls, value: Any, partial: bool = False) -> Fix:
        """From components on a last axis, NaN where missing; at this boundary only: inside, masks and finite numbers.

        Args:
            value: (..., m); NumPy stays NumPy.
            partial: components may be missing one by one; else one that is missing takes the others with it.
        """
        xp = np if isinstance(value, np.ndarray) else jnp
        known = xp.isfinite(value)
        size = value.shape[-1]
        whole = xp.all(known, axis=-1)
        there = xp.where(known if partial else whole[..., None], value, 0.0)
        parts = tuple(there[..., i] for i in range(size))
        if not partial:
            return cls(parts, whole)  # pyright: ignore[reportArgumentType]
        return cls(parts, xp.any(known, axis=-1), tuple(known[..., i] for i in range(size)))  # pyright: ignore[reportArgumentType]

    @property
    def whole(self) -> Fix:
        """The fix, valid only where all components are there."""
        if self.each is None:
            return self
        valid = self.each[0]
        for there in self.each[1:]:
            valid = valid & there
        return Fix(self.value, valid)

    @property
    def known(self) -> tuple[Any, ...]:
        """Of each component, whether it is there."""
        return self.each or (self.valid,) * len(self.value)


class Epoch(eqx.Module):
    """One row: the interval up to the epoch and what the aids measured at the epoch.

    Attributes:
        rotation: from b now to b at the previous epoch.
        dvel: integral of the specific force over the interval, m/s, in b at the previous epoch.
        dt: length of the interval, s; zero at the first epoch.
        fixes: of each aid.
    """

    rotation: Quat
    dvel: Vec3
    dt: Float[Array, "*epochs"]
    fixes: tuple[Fix, ...]

    @classmethod
    def of(cls, rotation, dvel, dt, *values) -> Epoch:
        """From arrays: rotation (..., 4), dvel (..., 3), dt (...), of each aid (..., m) with NaN where missing."""
        fixes = tuple(Fix.of(jnp.asarray(value, jnp.float64)) for value in values)
        return cls(Quat.of(rotation), Vec3.of(dvel), jnp.asarray(dt, jnp.float64), fixes)

    @classmethod
    def start(cls, *values) -> Epoch:
        """The first epoch: no interval before it; of each aid (m,), NaN if missing."""
        return cls.of(jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.zeros(3), 0.0, *values)

    @property
    def velocity(self) -> Vec3:
        """The velocity of the only aid, m/s, in its axes; any finite numbers where not ``valid``.

        A recursion of vectors takes one aid, with whole velocities.
        """
        return Vec3(*self.fixes[0].value)

    @property
    def valid(self) -> Any:
        """Whether the only aid has a velocity here."""
        return self.fixes[0].valid

    @property
    def whole(self) -> Epoch:
        """The epoch with whole fixes: a component that is missing takes the others of its fix with it."""
        return dataclasses.replace(self, fixes=tuple(fix.whole for fix in self.fixes))

    def with_velocity(self, velocity: Vec3, valid: Any = None) -> Epoch:
        """With another velocity of the only aid; ``valid`` stays if it is not given."""
        (fix,) = self.fixes
        new = Fix((velocity.x, velocity.y, velocity.z), fix.valid if valid is None else valid)
        return dataclasses.replace(self, fixes=(new,))


class Epochs(eqx.Module):
    """A log, preintegrated: M+1 rows, the first without an interval. A pytree: batch it, vmap over it.

    Attributes:
        rows: an :class:`Epoch` with leaves of shape (M+1,).
        site: latitude, longitude, height of the start.
        sd: of each aid the standard deviation of its white noise: one number, or (m,) (standing: of the force over one
            interval, m/s).
        aids: that the rows hold (static).
        filtered: whether a prefilter has smoothed the force.
        raw_noise: (2,) white noise of gyroscopes and accelerometers in quiet stretches (rad/sqrt(s), m/s/sqrt(s), see
            :mod:`jaxalign.raw_noise`); None: not known.
    """

    rows: Epoch
    site: Site
    sd: tuple[Float[Array, "*m"], ...]
    aids: tuple[AbstractAid, ...] = eqx.field(static=True)
    filtered: bool = eqx.field(static=True, default=False)
    raw_noise: Any = None

    def __len__(self) -> int:
        return self.rows.dt.shape[-1]

    @property
    def interval(self) -> float | None:
        """Between epochs, s, to four digits; None where intervals differ. On the host: it depends on the data.

        Raises:
            UserError: inside traced code.
        """
        if isinstance(self.rows.dt, Tracer):
            raise UserError(
                "the interval between epochs is not known inside traced code: give it from outside, with "
                "method.at_interval(epochs.interval)"
            )
        steps = np.asarray(self.rows.dt)[..., 1:]
        first = float(steps.flat[0])
        return float(f"{first:.4g}") if np.allclose(steps, first, rtol=1e-9, atol=0.0) else None

    @property
    def aid_sd(self) -> Any:
        """Of the first aid, as one number (of several their root mean square)."""
        sd = self.sd[0]
        return sd if jnp.ndim(sd) == 0 else jnp.sqrt(jnp.mean(jnp.square(sd)))

    def with_sd(self, sd: Any) -> Epochs:
        """With other standard deviations: of the only aid, or a sequence of those of all."""
        given = sd if isinstance(sd, tuple | list) else (sd,)
        if len(given) != len(self.aids):
            raise UserError(f"standard deviations of {len(given)} aids, but there are {len(self.aids)}: one for each")
        return eqx.tree_at(lambda e: e.sd, self, tuple(as_float64(x) for x in given))


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
    whole_number("every", every, of="epochs", floats=True)


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
