"""Differences of running sums: since the start, over a sliding window, or since the previous sample."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxalign.errors import UserError
from jaxalign.vector import Vec3, where

__all__ = ["Previous", "Sliding", "Sums", "Whole", "window"]


class Sums(eqx.Module):
    """Running sums whose differences are vector pairs: see :class:`jaxalign.observe.base.Pair`."""

    alpha: Vec3
    beta: Vec3
    displacement: Vec3 | None

    @classmethod
    def zero(cls, displacement: bool) -> Sums:
        """All zero; without ``displacement`` where no term depends on the attitude."""
        return cls(Vec3.zero(), Vec3.zero(), Vec3.zero() if displacement else None)

    def __sub__(self, other: Sums) -> Sums:
        return jax.tree.map(lambda a, b: a - b, self, other)


class Whole(eqx.Module):
    """Since the first epoch with a valid aid."""

    start: Sums
    started: Bool[Array, ""]

    def push(self, index: Int[Array, ""], sums: Sums, valid: Any) -> tuple[Whole, Sums, Any, Sums]:
        """Take the sums of an epoch; return (state, difference, usable, difference since the start)."""
        start = where(self.started, self.start, sums)
        since = sums - start
        return Whole(start, self.started | valid), since, valid, since


class Previous(eqx.Module):
    """Since the previous valid epoch: instantaneous vectors."""

    whole: Whole
    last: Sums

    @property
    def started(self) -> Any:
        """Whether there has been a valid epoch."""
        return self.whole.started

    def push(self, index: Int[Array, ""], sums: Sums, valid: Any) -> tuple[Previous, Sums, Any, Sums]:
        """Take the sums of an epoch, see :meth:`Whole.push`; the first valid epoch gives no vector."""
        usable = valid & self.whole.started
        whole, _, _, since = self.whole.push(index, sums, valid)
        return Previous(whole, where(valid, sums, self.last)), sums - self.last, usable, since


class Sliding(eqx.Module):
    """Over the last L epochs (fewer at the beginning): a ring buffer of the sums.

    Where the aid has no sample L epochs ago, the window reaches back to the last one before; it never stops.
    """

    whole: Whole
    last: Sums  # at the last valid epoch
    history: Sums  # last valid sums at each of the last L epochs
    known: Bool[Array, " window"]  # whether there had been any

    @property
    def started(self) -> Any:
        """Whether there has been a valid epoch."""
        return self.whole.started

    def push(self, index: Int[Array, ""], sums: Sums, valid: Any) -> tuple[Sliding, Sums, Any, Sums]:
        """Take the sums of an epoch, see :meth:`Whole.push`."""
        length = self.known.shape[-1]
        slot = index % length
        whole, _, _, since = self.whole.push(index, sums, valid)
        old = jax.tree.map(lambda buffer: buffer[slot], self.history)
        difference = sums - where((index >= length) & self.known[slot], old, whole.start)
        last = where(valid, sums, self.last)
        history = jax.tree.map(lambda buffer, x: buffer.at[slot].set(x), self.history, last)
        return Sliding(whole, last, history, self.known.at[slot].set(whole.started)), difference, valid, since


_MOST = 1_000_000  # epochs of a window: beyond, a slip of the pen rather than a wish


def window(seconds: float, interval: float | None, sums: Sums) -> Whole | Sliding:
    """The state for a window of so many seconds, 0 meaning since the start.

    Args:
        seconds: length; rounded to whole epochs, at least one.
        interval: seconds between epochs; None: not known.
        sums: all-zero sums of the right structure.

    Raises:
        UserError: an absurd length, or an interval that is not known.
    """
    whole = Whole(sums, jnp.zeros((), bool))
    if seconds == 0:
        return whole
    if interval is None:
        raise UserError(
            f"observe.window = {seconds:g} s: a window is a number of epochs, and their interval is not known: inside "
            "traced code, or for steps of one's own, take method.at_interval(seconds)"
        )
    length = max(1, round(seconds / interval))
    if length > _MOST:
        raise UserError(f"observe.window = {seconds:g} s is {length} epochs: at most {_MOST}, or 0 for the whole time")
    buffers = jax.tree.map(lambda x: jnp.zeros(length, x.dtype), sums)
    return Sliding(whole, sums, buffers, jnp.zeros(length, bool))
