"""The normal numbers are JAX's own, bit by bit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign import UserError
from jaxalign.simulate.random import each, fold, normals, slab


@pytest.mark.parametrize("count", [1, 3, 1000, 40_001])
def test_the_numbers_of_jax(count):
    key = jax.random.key(count)
    expected = jax.random.normal(key, (count,), jnp.float32)
    np.testing.assert_array_equal(normals(key, count), expected)
    np.testing.assert_array_equal(jax.jit(lambda k: normals(k, count))(key), expected)


def test_many_keys_side_by_side():
    keys = jax.vmap(lambda i: jax.random.fold_in(jax.random.key(3), i))(jnp.arange(37))
    expected = jax.vmap(lambda k: jax.random.normal(k, (501,), jnp.float32))(keys).T
    np.testing.assert_array_equal(normals(keys, 501), expected)
    np.testing.assert_array_equal(jax.vmap(lambda k: normals(k, 501))(keys).T, expected)


def test_from_a_place_on():
    key = jax.random.key(1)
    expected = jax.random.normal(key, (900,), jnp.float32)
    np.testing.assert_array_equal(jax.jit(lambda s: normals(key, 120, s))(jnp.uint32(300)), expected[300:420])
    np.testing.assert_array_equal(slab(key, 40, 3, 300), expected[300:420])


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
