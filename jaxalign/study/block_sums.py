"""What is kept of the runs of a block: sums and counts over the runs, and a few numbers of each run.

All statistics of a study come from these, so that its memory hardly grows with its runs. The sums are over a block of
fixed size, and blocks are added on the host in the order of their runs: the result does not depend on chunks, devices
or interruptions, to the last bit.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxalign.study.errors import Errors

__all__ = ["BINS", "PER_DECADE", "SMALLEST_DEG", "BlockSums", "bin_edges", "sum_block"]

SMALLEST_DEG, PER_DECADE = 1e-6, 128
BINS = int(np.ceil(PER_DECADE * np.log10(180.0 / SMALLEST_DEG))) + 1
"""Logarithmic bins of the absolute errors, 1.8 % wide: percentiles from them are good to a fraction of that."""


def bin_edges() -> np.ndarray:
    """(BINS + 1,) edges in degrees; the first bin begins at zero."""
    edges = SMALLEST_DEG * 10.0 ** (np.arange(BINS + 1) / PER_DECADE)
    edges[0] = 0.0
    return edges


class BlockSums(eqx.Module):
    """A block of runs; K read-outs, three angles (pitch, roll, yaw), in degrees.

    Attributes:
        known: (K,) runs with an attitude.
        failed: (K,) runs with a number that is not finite.
        total: (K, 3) sum of the errors.
        square: (K, 3) of their squares.
        fourth: (K, 3) of their fourth powers.
        within: (K, 3) runs with an absolute error within the tolerance.
        bins: (K, 3, BINS) histogram of the absolute errors.
        end: (runs, 3) error at the last read-out; NaN: none.
        window: (runs, 3) mean square over the window; NaN: no attitude in it.
        converged: (runs, 3) s: first read-out from which on the error stays within the tolerance; infinite: none.
    """

    known: Int[Array, " K"]
    failed: Int[Array, " K"]
    total: Float[Array, "K 3"]
    square: Float[Array, "K 3"]
    fourth: Float[Array, "K 3"]
    within: Int[Array, "K 3"]
    bins: Int[Array, "K 3 bins"]
    end: Float[Array, "runs 3"]
    window: Float[Array, "runs 3"]
    converged: Float[Array, "runs 3"]


def sum_block(
    errors: Errors,
    counted: Bool[Array, " runs"],
    time: Float[Array, " K"],
    window: Bool[Array, " K"],
    tolerance_deg: Float[Array, ""],
) -> BlockSums:
    """Reduce a block. Pure.

    Args:
        errors: of its runs.
        counted: which runs belong to the study (the last block is filled up).
        time: s, of the read-outs.
        window: which read-outs the accuracy of a run is taken from.
        tolerance_deg: for `within` and `converged`.
    """
    known = jnp.isfinite(errors.euler) & counted[:, None, None]
    error = jnp.where(known, errors.euler, 0.0)
    size = jnp.abs(error)
    square = error * error
    within = known & (size <= tolerance_deg)

    k, axes = error.shape[1:]
    place = jnp.log10(jnp.maximum(size, SMALLEST_DEG) / SMALLEST_DEG) * PER_DECADE
    place = jnp.clip(place, 0, BINS - 1).astype(jnp.int32) + BINS * jnp.arange(k * axes, dtype=jnp.int32).reshape(
        k, axes
    )
    ones = known.astype(jnp.int32)
    bins = jnp.zeros(k * axes * BINS, jnp.int32).at[place.ravel()].add(ones.ravel(), mode="promise_in_bounds")

    inside = known & window[:, None]
    count = jnp.sum(inside, axis=1)
    mean_square = jnp.sum(jnp.where(inside, square, 0.0), axis=1) / jnp.maximum(count, 1)
    # From the last read-out that is out of tolerance, one further.
    last_out = jnp.max(jnp.where(within, -1, jnp.arange(k)[:, None]), axis=1)
    converged = jnp.where(last_out < k - 1, time[jnp.minimum(last_out + 1, k - 1)], jnp.inf)
    return BlockSums(
        known=jnp.sum(known[..., 0], axis=0, dtype=jnp.int32),
        failed=jnp.sum(errors.failed & counted[:, None], axis=0, dtype=jnp.int32),
        total=jnp.sum(error, axis=0),
        square=jnp.sum(square, axis=0),
        fourth=jnp.sum(square * square, axis=0),
        within=jnp.sum(within, axis=0, dtype=jnp.int32),
        bins=bins.reshape(k, axes, BINS),
        end=jnp.where(known[:, -1], error[:, -1], jnp.nan),
        window=jnp.where(count > 0, mean_square, jnp.nan),
        converged=converged,
    )
