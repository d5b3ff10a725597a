"""The normal numbers come from JAX's own words, in the order of their places, and are normal."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxalign import UserError
from jaxalign.simulate import random
from jaxalign.simulate.random import each, fold

# One program instead of one for each of their operations.
normals, blocks = (jax.jit(f, static_argnums=1) for f in (random.normals, random.blocks))


def expected(key, count):
    """Box and Muller in double precision on the words of `jax.random.bits`: by cosine and sine of the whole angle."""
    word = np.asarray(jax.random.bits(key, (count // 2 + 1,), jnp.uint64))
    first, second = word >> np.uint64(32), word & np.uint64(0xFFFFFFFF)
    radius = np.sqrt(-2 * np.log((first // 2) / 2.0**31 + 2.0**-32))
    within = second << np.uint64(2) & np.uint64(0xFFFFFFFF)
    angle = np.pi / 4 + np.pi / 4 * within.astype(np.uint32).view(np.int32) / 2.0**31
    signs = (1 - 2.0 * (second >> np.uint64(31)), 1 - 2.0 * (second >> np.uint64(30) & np.uint64(1)))
    return (radius * np.array([signs[0] * np.cos(angle), signs[1] * np.sin(angle)])).T.ravel()[:count]


@pytest.mark.parametrize("count", [1, 2, 1000, 40_001])
def test_the_words_of_jax(count):
    key = jax.random.key(count)
    drawn = normals(key, count)
    assert drawn.dtype == np.float32
    # A radius near zero is that of a uniform number next to one, of which float32 knows 2^-24.
    np.testing.assert_allclose(drawn, expected(key, count), rtol=5e-7, atol=2e-4)
    far = abs(expected(key, count)) > 0.5
    np.testing.assert_allclose(np.asarray(drawn)[far], expected(key, count)[far], rtol=5e-7)


def test_the_largest_number_and_the_smallest():
    """Of the words at the ends: finite, and zero."""
    from jaxalign.simulate.random import _pair

    ends = np.array([0, 1, 2**31, 2**32 - 1], np.uint32)
    pairs = np.asarray(jax.jit(_pair)(*(jnp.asarray(x.ravel()) for x in np.meshgrid(ends, ends))))
    radius = abs(pairs).reshape(4, 4)
    np.testing.assert_allclose(radius.max(), np.sqrt(-2 * np.log(2.0**-32)), rtol=1e-6)
    assert radius.min() == 0.0


def test_they_are_normal():
    """A million numbers: distribution, tails, moments, pairs and neighbours without relation."""
    z = np.asarray(normals(jax.random.key(11), 1_000_000), np.float64)
    assert stats.kstest(z, "norm").pvalue > 1e-3
    assert stats.chisquare(*_counts(z)).pvalue > 1e-3
    for power, moment in ((1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0), (6, 15.0)):
        values = z**power
        assert abs(values.mean() - moment) < 4 * values.std() / 1e3
    for lag in (1, 2, 3, 6):
        for f in (lambda x: x, np.square, np.abs):
            assert abs(np.corrcoef(f(z[::2][:-lag]), f(z[1::2][lag:]))[0, 1]) < 4 / np.sqrt(len(z) / 2)
            assert abs(np.corrcoef(f(z[:-lag]), f(z[lag:]))[0, 1]) < 4e-3


def _counts(z):
    """Numbers found and expected in 40 bins of the same width, tails beyond 4 included."""
    edges = np.concatenate([[-np.inf], np.linspace(-4, 4, 39), [np.inf]])
    return np.array([np.sum((z > a) & (z <= b)) for a, b in itertools.pairwise(edges)]), len(z) * np.diff(
        stats.norm.cdf(edges)
    )


ROUNDING = {"rtol": 1e-6, "atol": 1e-6}  # of float32: programs differ in which products and sums are one operation


def test_many_keys_side_by_side():
    keys = jax.vmap(lambda i: jax.random.fold_in(jax.random.key(3), i))(jnp.arange(37))
    alone = np.stack([normals(key, 501) for key in keys[:3]])
    np.testing.assert_allclose(normals(keys, 501)[:, :3].T, alone, **ROUNDING)
    np.testing.assert_allclose(jax.vmap(lambda k: normals(k, 501))(keys[:3]), alone, **ROUNDING)


@pytest.mark.parametrize("start", [0, 300, 301])
def test_from_a_place_on(start):
    key = jax.random.key(1)
    whole = normals(key, 900)
    later = normals(key, 120, jnp.uint32(start))
    np.testing.assert_allclose(later, whole[start:][:120], **ROUNDING)
    z = blocks(key, 50, start)
    np.testing.assert_allclose(np.stack([z.real, z.imag], 1).ravel(), whole[2 * start :][:100], **ROUNDING)


def test_fold_and_each():
    key = jax.random.key(2)
    keys = jax.random.split(key, 4)
    np.testing.assert_array_equal(
        jax.random.key_data(fold(keys, 7)[2]), jax.random.key_data(jax.random.fold_in(keys[2], 7))
    )
    drawn = each(lambda k: jax.random.uniform(k, (3,)), keys)
    assert drawn.shape == (3, 4)
    np.testing.assert_array_equal(drawn[:, 1], each(lambda k: jax.random.uniform(k, (3,)), keys[1]))


def test_another_generator_is_refused():
    with pytest.raises(UserError, match="default generator"):
        normals(jax.random.key(0, impl="rbg"), 3)
