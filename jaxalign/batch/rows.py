"""A scan that may end early."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

__all__ = ["over_rows"]


def over_rows(
    step: Callable[[Any, Any], tuple[Any, Any]],
    start: Any,
    rows: Any,
    length: Any,
    like: Callable[[], Any],
    reverse: bool = False,
) -> tuple[Any, Any]:
    """``lax.scan`` over the first rows only.

    Args:
        step: carry and row to carry and output.
        start: carry.
        rows: leaves with a first axis.
        length: of how many rows, traced: what comes after them costs nothing, but has no derivative in reverse mode.
            None: of all.
        like: makes an output; the rows behind have zeros instead.
        reverse: from the last of these rows to the first.

    Returns:
        The last carry and the outputs.
    """
    if length is None:
        return jax.lax.scan(step, start, rows, reverse=reverse)
    count = len(jax.tree.leaves(rows)[0])
    out = jax.tree.map(lambda x: jnp.zeros((count, *x.shape), x.dtype), like())

    def body(i: Any, at: Any) -> Any:
        carry, out = at
        k = length - 1 - i if reverse else i
        row = jax.tree.map(lambda x: jax.lax.dynamic_index_in_dim(x, k, keepdims=False), rows)
        carry, new = step(carry, row)
        return carry, jax.tree.map(lambda x, y: jax.lax.dynamic_update_index_in_dim(x, y, k, 0), out, new)

    return jax.lax.fori_loop(0, length, body, (start, out))
