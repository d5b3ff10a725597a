"""Normal random numbers, cheap enough not to rule a study: Box and Muller's on the words of JAX's own generator.

Block i of Threefry is two words of 32 bits, and gives the numbers 2 i and 2 i + 1: one radius, one angle.
`jax.random.normal` makes one number of a block, by an inverse error function that costs as much as the cipher, whose
rounds it runs as a rolled loop on a CPU. The two numbers of a block are one complex number: XLA's CPU kernels have one
output each, and would draw anew for a second. For the same reason loops hold what is drawn: a kernel outside would draw
anew for each use.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex64, Float, PRNGKeyArray

from jaxalign.errors import UserError

__all__ = ["DRAW", "blocks", "each", "fold", "normals"]

DRAW = "threefry2x32, Box-Muller"
"""How the numbers of a key come about: part of the settings of a study, for other ones are other runs."""

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PART, _PARTS = 1 << 12, 4  # blocks of a part, all keys together, which stay in the cache; and least number of parts
_SIN = (1.0, -1 / 6, 1 / 120, -1 / 5040)  # of the powers of the squared angle: to the last bit of float32 below pi / 4
_COS = (1.0, -1 / 2, 1 / 24, -1 / 720, 1 / 40320)
_LOG = (3.3333331174e-1, -2.4999993993e-1, 2.0000714765e-1, -1.6668057665e-1, 1.4249322787e-1, -1.2420140846e-1)
_LOG = (*_LOG, 1.1676998740e-1, -1.1514610310e-1, 7.0376836292e-2)
_ROOT_HALF = np.int32(0x3F3504F3)  # the bits of the root of a half


def each(f: Callable[[PRNGKeyArray], Any], key: PRNGKeyArray) -> Any:
    """``f(key)``; for an array of keys (runs,) arrays with the runs on the last axis."""
    return f(key) if key.ndim == 0 else jax.vmap(f, out_axes=-1)(key)


def fold(key: PRNGKeyArray, number: int) -> PRNGKeyArray:
    """`jax.random.fold_in` of one key or of each."""
    return jax.random.fold_in(key, number) if key.ndim == 0 else jax.vmap(lambda k: jax.random.fold_in(k, number))(key)


def normals(key: PRNGKeyArray, count: int, start: Any = 0) -> Float[Array, "count ..."]:
    """Unit normals in float32, the numbers start ... start + count - 1 of a key.

    Their rounding, 1e-7 of a number, is far below what any number of runs can tell.

    Args:
        key: one, or (runs,) of them; of JAX's default generator.
        count: how many.
        start: the first of them; may be traced. Together below 2^32.

    Raises:
        UserError: keys of another generator.
    """
    first = jnp.asarray(start, jnp.uint32)
    whole = count // 2 + 1  # one more than needed where the first number is the first of its block
    rows = min(-(-whole // _PARTS), max(8, _PART // max(1, math.prod(key.shape))))
    starts = first // 2 + jnp.arange(0, whole, rows, dtype=jnp.uint32)
    z = jax.lax.map(lambda at: blocks(key, rows, at), starts).reshape(-1, *key.shape)
    numbers = jnp.stack([z.real, z.imag], axis=1).reshape(-1, *key.shape)
    return jax.lax.dynamic_slice_in_dim(numbers, first % 2, count)


def blocks(key: PRNGKeyArray, rows: int, start: Any) -> Complex64[Array, "rows ..."]:
    """Unit normals of the blocks from `start` on: real part and imaginary part. For use in a loop, which holds them.

    Raises:
        UserError: keys of another generator.

    Source: Salmon et al. (2011), Threefry-2x32 with 20 rounds; Box and Muller (1958).
    """
    if jax.random.key_impl(key) != "threefry2x32":
        raise UserError(f"keys of {jax.random.key_impl(key)!r}: JAX's default generator is needed (jax.random.key)")
    words = jax.random.key_data(key)
    counts = jnp.asarray(start, jnp.uint32) + jnp.arange(rows, dtype=jnp.uint32)
    counts = counts.reshape(rows, *(1 for _ in key.shape))
    return _pair(*_threefry(words[..., 0], words[..., 1], jnp.zeros_like(counts), counts))


def _pair(first: Array, second: Array) -> Array:
    """Two unit normals of two words, as a complex number: 31 bits for the radius, 32 for the angle."""
    uniform = _float(first >> np.uint32(1)) * np.float32(2.0**-31) + np.float32(2.0**-32)  # in (0, 1]
    radius = jnp.sqrt(-_log(uniform))  # over the root of two
    # An angle within its quarter from the middle of it, and a bit for the sign of either number.
    angle = _float(second << np.uint32(2)) * np.float32(math.pi / 4 * 2.0**-31)
    square = angle * angle
    sin, cos = angle * _polynomial(_SIN, square), _polynomial(_COS, square)
    return jax.lax.complex(_signed(radius * (cos - sin), second), _signed(radius * (cos + sin), second << np.uint32(1)))


def _log(x: Array) -> Array:
    """Natural logarithm, to the last bit or two: XLA's own is not the same in all programs, by the last bit.

    Source: the Cephes library (Moshier 1989), logf.
    """
    bits = jax.lax.bitcast_convert_type(x, jnp.int32) - _ROOT_HALF
    exponent = (bits >> np.int32(23)).astype(jnp.float32)
    more = jax.lax.bitcast_convert_type((bits & np.int32(0x7FFFFF)) + _ROOT_HALF, jnp.float32) - np.float32(1.0)
    square = more * more
    series = more * square * _polynomial(_LOG, more)
    # The logarithm of two in two parts, of which the first is exact times an exponent.
    return (series + exponent * np.float32(-2.12194440e-4) - np.float32(0.5) * square + more) + exponent * np.float32(
        0.693359375
    )


def _float(word: Array) -> Array:
    """The word as a signed number, in float32."""
    return jax.lax.bitcast_convert_type(word, jnp.int32).astype(jnp.float32)


def _polynomial(coefficients: tuple[float, ...], x: Array) -> Array:
    total = jnp.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = total * x + np.float32(coefficient)
    return total


def _signed(size: Array, word: Array) -> Array:
    """With the sign of the first bit of the word."""
    bits = jax.lax.bitcast_convert_type(size, jnp.uint32) ^ (word & np.uint32(1 << 31))
    return jax.lax.bitcast_convert_type(bits, jnp.float32)


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
