"""What is thought of each fix: the probability that it is none of the outliers, its weight, and the noise of all.

Arrays have the epochs on the first axis and lanes on the last, as everywhere in this room.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.vector import Vec3, root

__all__ = ["estimate_noise", "lower_median", "median_variance", "outlier_odds", "steady_velocities", "weigh"]

_BELIEF = 6.0  # numbers that the stated noise of the aid is worth
_FITTED = 8.0  # numbers that the attitude, the first velocity and what is seen of the biases take up
_LONGEST = 0.95  # correlation of neighbouring fixes
_MEDIANS = {1: 0.4549, 2: 1.3863, 3: 2.366}  # of the squared length of a normal vector of so many components
_STEADY = 3.0  # times the variance that is left, a squared change may well be noise


def lower_median(x: Float[Array, "K L"], used: Bool[Array, "K L"]) -> Float[Array, " L"]:
    """The lower median over the first axis of numbers that are not negative; zero where none is used.

    By bisection over the bits of the numbers, which are in their order: no sort. They are rounded to float32, and the
    result has no derivative.
    """
    bits = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(x).astype(jnp.float32), jnp.int32)
    count = jnp.sum(used, axis=0)
    wanted = (count - 1) // 2

    def halve(i: Any, low: Any) -> Any:
        middle = low | (jnp.int32(1) << (30 - i))
        return jnp.where(jnp.sum(used & (bits < middle), axis=0) <= wanted, middle, low)

    low = jax.lax.fori_loop(0, 31, halve, jnp.zeros(x.shape[1:], jnp.int32))
    return jnp.where(count > 0, jax.lax.bitcast_convert_type(low, jnp.float32).astype(jnp.float64), 0.0)


def _median(count: Any) -> Any:
    """Of the squared length of a normal vector of so many components (Wilson and Hilferty beyond three)."""
    if isinstance(count, int):
        return _MEDIANS.get(count, count * (1 - 2 / (9 * count)) ** 3)
    out = count * (1 - 2 / (9 * jnp.maximum(count, 1))) ** 3
    for size, median in _MEDIANS.items():
        out = jnp.where(count == size, median, out)
    return out


def median_variance(noise: Float[Array, "K m L"], used: Any, stated: Any, count: Any = None) -> Float[Array, " L"]:
    """Variance of the noise by its median, which a half of outliers does not move; at least the stated one.

    Args:
        noise: of each component, zero where there is none.
        used: (K, L) where there is a fix.
        stated: standard deviation.
        count: (K, L) components that there are; None: all of them.
    """
    square = jnp.sum(noise**2, axis=1)
    if count is None:
        return jnp.maximum(lower_median(square, used) / _median(noise.shape[1]), stated**2)
    return jnp.maximum(lower_median(square / _median(count), used), stated**2)


def weigh(
    noise: Float[Array, "K m L"], variance: Any, used: Any, probability: Any, ratio: Any, count: Any = None
) -> tuple[Float[Array, "K L"], Float[Array, "K L"]]:
    """Probability that each fix is no outlier, and its weight.

    Args:
        noise: of each component, in units of which the variance is that of all.
        variance: (L,).
        used: (K, L) where there is a fix.
        probability: of an outlier beforehand.
        ratio: standard deviation of outliers over that of the others.
        count: (K, L) components that there are; None: all of them.
    """
    square = jnp.sum(noise**2, axis=1) / variance
    wide = ratio**2
    odds = jnp.log((1 - probability) / probability) + 0.5 * (noise.shape[1] if count is None else count) * jnp.log(wide)
    good = jnp.where(used, jax.nn.sigmoid(odds - 0.5 * square * (1 - 1 / wide)), 0.0)
    return good, good + (1 - good) / wide


def outlier_odds(weight: Any, used: Any, probability: Any, ratio: Any) -> Float[Array, " L"]:
    """Log-probability of as many outliers as there seem to be, less that of none."""
    wide = ratio**2
    bad = jnp.where(used, 1.0 - (weight - 1.0 / wide) / (1.0 - 1.0 / wide), 0.0)
    return jnp.sum(bad, axis=0) * jnp.log(probability / (1.0 - probability))


def _persistence(noise: Any, good: Any, variance: Any) -> Any:
    """How many times the noise of a fix counts because its neighbours share it: (1 + r) / (1 - r).

    r is the correlation of neighbouring fixes, never taken for negative; white noise with the variance so enlarged
    has the same density at low frequencies, where the attitude is.
    """
    pair = (good[1:] * good[:-1])[:, None]
    shared = jnp.sum(pair * noise[1:] * noise[:-1], axis=(0, 1))
    own = 0.5 * jnp.sum(pair * (noise[1:] ** 2 + noise[:-1] ** 2), axis=(0, 1))
    r = jnp.clip(shared / (own + _BELIEF * variance), 0.0, _LONGEST)
    return (1.0 + r) / (1.0 - r)


def estimate_noise(
    noise: Any, good: Any, stated: Any, mode: str, count: Any = None, share: Any = 1.0
) -> tuple[Float[Array, " L"], Float[Array, " L"]]:
    """Variance of the noise and how many times it counts, by the fixes that are no outliers.

    Args:
        noise: (K, m, L).
        good: (K, L) probability that a fix is no outlier.
        stated: (L,) standard deviation.
        mode: "at_least", "estimated" or "stated", see :class:`jaxalign.RobustMap`.
        count: (K, L) components that there are; None: all of them.
        share: of what is fitted, that is fitted to this aid.
    """
    lanes = noise.shape[-1]
    if mode == "stated":
        return jnp.broadcast_to(stated**2, (lanes,)), jnp.ones(lanes)
    squares = jnp.sum(good[:, None] * noise**2, axis=(0, 1))
    numbers = noise.shape[1] * jnp.sum(good, axis=0) if count is None else jnp.sum(good * count, axis=0)
    free = jnp.maximum(numbers - _FITTED * share, 0.0)
    variance = (_BELIEF * stated**2 + squares) / (_BELIEF + free)
    if mode == "at_least":
        variance = jnp.maximum(variance, stated**2)
    return variance, _persistence(noise, good, variance)


def steady_velocities(velocity: Vec3, left: Float[Array, "K L"], variance: Float[Array, "K L"], used: Any) -> Vec3:
    """(K, L) velocities without the part of their changes that is noise.

    A vehicle that keeps its velocity says nothing of the heading, but the noise of its velocity would.

    Args:
        velocity: smoothed, m/s, n0.
        left: variance of each fix's prediction after it, all components together.
        variance: of the fixes.
        used: where there is one.
    """
    weight = jnp.where(used, 1.0 / variance, 0.0)
    total = jnp.maximum(jnp.sum(weight, axis=0), 1e-300)
    mean = jax.tree.map(lambda x: jnp.sum(weight * x, axis=0) / total, velocity)
    change = velocity - mean
    size, noise = change.norm2(), _STEADY * left
    moves = size > noise
    return mean + change * root(jnp.where(moves, 1.0 - noise / jnp.where(moves, size, 1.0), 0.0))
