"""Normal random numbers, cheap enough not to rule a study.

`jax.random.normal` runs the rounds of its generator as a rolled loop on a CPU, which compiles fast and passes every
round through memory. Unrolled, the rounds become one loop over registers: the same numbers, faster. Two
nested loops of XLA's hold what each produces, or it would draw anew in every kernel that has a use for a number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign.errors import UserError

__all__ = ["each", "fold", "normals", "slab"]

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_SLAB, _PARTS = 1 << 13, 4  # numbers of a part, all keys together, and parts of a slab: they stay in the cache


def each(f: Callable[[PRNGKeyArray], Any], key: PRNGKeyArray) -> Any:
    """``f(key)``; for an array of keys (runs,) arrays with the runs on the last axis."""
    return f(key) if key.ndim == 0 else jax.vmap(f, out_axes=-1)(key)


def fold(key: PRNGKeyArray, number: int) -> PRNGKeyArray:
    """`jax.random.fold_in` of one key or of each."""
    return jax.random.fold_in(key, number) if key.ndim == 0 else jax.vmap(lambda k: jax.random.fold_in(k, number))(key)


def normals(key: PRNGKeyArray, count: int, start: Any = 0) -> Float[Array, "count ..."]:
    """Unit normals in float32: ``jax.random.normal(key, (start + count,), float32)[start:]``, bit by bit.

    Args:
        key: one, or (runs,) of them; of JAX's default generator.
        count: how many.
        start: the first of them; may be traced. Together below 2^32.

    Raises:
        UserError: keys of another generator.

    Source: Salmon et al. (2011), Threefry-2x32 with 20 rounds; a word per number, as JAX has it.
    """
    if jax.random.key_impl(key) != "threefry2x32":
        raise UserError(f"keys of {jax.random.key_impl(key)!r}: JAX's default generator is needed (jax.random.key)")
    rows = min(-(-count // _PARTS), max(16, _SLAB // max(1, math.prod(key.shape))))
    starts = jnp.asarray(start, jnp.uint32) + jnp.arange(0, count, _PARTS * rows, dtype=jnp.uint32)
    return jax.lax.map(lambda at: slab(key, rows, _PARTS, at), starts).reshape(-1, *key.shape)[:count]


def slab(key: PRNGKeyArray, rows: int, parts: int, start: Any) -> Float[Array, "numbers ..."]:
    """The ``parts * rows`` unit normals from `start` on; as :func:`normals`, for use in a loop of one's own."""
    words, runs = jax.random.key_data(key), key.shape
    first = jnp.asarray(start, jnp.uint32)

    def part(start: Array) -> Array:
        counts = (start + jnp.arange(rows, dtype=jnp.uint32)).reshape(rows, *(1 for _ in runs))
        return _uniform(*_threefry(words[..., 0], words[..., 1], jnp.zeros_like(counts), counts))

    uniform = jax.lax.map(part, first + rows * jnp.arange(parts, dtype=jnp.uint32)).reshape(-1, *runs)
    return np.float32(np.sqrt(2.0)) * jax.lax.erf_inv(uniform)


def _uniform(first: Array, second: Array) -> Array:
    """From the two words of a block to the open interval (-1, 1), as JAX does."""
    # Twenty-three bits to [1, 2), to (-1, 1): it starts at the float next to -1.
    mantissa = ((first ^ second) >> np.uint32(9)) | np.uint32(0x3F800000)
    low = np.nextafter(np.float32(-1.0), np.float32(0.0))
    uniform = (jax.lax.bitcast_convert_type(mantissa, jnp.float32) - np.float32(1.0)) * np.float32(2.0) + low
    return jnp.maximum(low, uniform)


def _threefry(k0: Array, k1: Array, x0: Array, x1: Array) -> tuple[Array, Array]:
    """The block cipher of the generator, on pairs of words."""
    keys = (k0, k1, k0 ^ k1 ^ np.uint32(0x1BD11BDA))
    x0, x1 = x0 + keys[0], x1 + keys[1]
    for i in range(5):
        for turn in _ROTATIONS[i % 2]:
            x0 = x0 + x1
            x1 = ((x1 << np.uint32(turn)) | (x1 >> np.uint32(32 - turn))) ^ x0
        x0, x1 = x0 + keys[(i + 1) % 3], x1 + keys[(i + 2) % 3] + np.uint32(i + 1)
    return x0, x1
