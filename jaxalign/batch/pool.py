"""A velocity from all aids that speak of one, roughly: what an attitude without a guess begins with."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxalign.aids import AbstractAid, Axes
from jaxalign.epochs import Fix
from jaxalign.vector import Vec3

__all__ = ["Pool", "pool_velocities"]

_ENOUGH = 3  # epochs with all components


class Pool(NamedTuple):
    """Components (K, ...).

    Attributes:
        axes: of the velocity.
        velocity: m/s; what no aid measures is zero.
        valid: where it is to be used.
        members: numbers of the aids that it comes from.
    """

    axes: Axes
    velocity: Vec3
    valid: Any
    members: tuple[int, ...]


def pool_velocities(aids: tuple[AbstractAid, ...], fixes: tuple[Fix, ...]) -> Pool:
    """The velocities of the aids in n, if there are any, else of those in b; else that of a vehicle at rest.

    Where all components that are ever measured come together at three epochs or more, those count; else each is held
    until its next value.
    """
    told: dict[Axes, list[tuple[int, tuple[Any, ...], tuple[Any, ...]]]] = {Axes.NAV: [], Axes.BODY: []}
    for number, (aid, fix) in enumerate(zip(aids, fixes, strict=True)):
        if (seen := aid.velocity(fix.value)) is not None:
            holed = tuple(jnp.where(there, x, jnp.nan) for x, there in zip(fix.value, fix.known, strict=True))
            parts = (aid.velocity(holed) or seen)[1]  # an aid may compute it of several values
            told[seen[0]].append((number, seen[1], tuple(None if x is None else jnp.isfinite(x) for x in parts)))
    whole = [axes for axes in told if _measured(told[axes]) == 3]
    axes = next(iter(whole or [axes for axes in told if told[axes]]), Axes.BODY)
    members = told[axes]
    if not members:
        valid = fixes[0].valid
        for fix in fixes[1:]:
            valid = valid | fix.valid
        zero = 0.0 * fixes[0].value[0]
        return Pool(axes, Vec3(zero, zero, zero), valid, ())
    parts, knowns = [], []
    for i in range(3):
        value: Any = None
        known: Any = None
        for _, values, there in members:
            if values[i] is None:
                continue
            if known is None:
                value, known = values[i], there[i]
            else:
                value, known = jnp.where(known, value, values[i]), known | there[i]
        parts.append(value)
        knowns.append(known)
    numbers = tuple(number for number, _, _ in members)
    if len(members) == 1 and fixes[numbers[0]].each is None:
        valid = fixes[numbers[0]].valid
        zero = 0.0 * fixes[numbers[0]].value[0]
        return Pool(axes, Vec3(*(zero if x is None else x for x in parts)), valid, numbers)
    return Pool(axes, *_together(parts, knowns), numbers)


def _measured(members: list[Any]) -> int:
    """How many components any of them measures."""
    return sum(any(values[i] is not None for _, values, _ in members) for i in range(3))


def _together(parts: list[Any], knowns: list[Any]) -> tuple[Vec3, Any]:
    there = [known for known in knowns if known is not None]
    at_once, any_now = there[0], there[0]
    for known in there[1:]:
        at_once, any_now = at_once & known, any_now | known
    shape = jnp.broadcast_shapes(*(jnp.shape(x) for x in there))

    def hold(value: Any, known: Any) -> Any:
        def step(carry: Any, row: Any) -> Any:
            last, ever = carry
            last, ever = jnp.where(row[1], row[0], last), ever | row[1]
            return (last, ever), (last, ever)

        rows = jnp.broadcast_to(value, shape), jnp.broadcast_to(known, shape)
        return jax.lax.scan(step, (jnp.zeros(shape[1:]), jnp.zeros(shape[1:], bool)), rows)[1]

    zero, yes = jnp.zeros(shape), jnp.ones(shape, bool)
    held = [(zero, yes) if known is None else hold(value, known) for value, known in zip(parts, knowns, strict=True)]
    ever = held[0][1] & held[1][1] & held[2][1]
    enough = jnp.sum(at_once, axis=0) >= _ENOUGH
    return Vec3(*(value for value, _ in held)), jnp.where(enough, at_once, any_now & ever)
