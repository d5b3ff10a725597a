"""Functions compiled once for a machine: the same numbers, without tracing, and never those of another function."""

import sys
from contextlib import nullcontext
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign.compilation import programs, reloads, settings
from jaxalign.compilation.programs import Program
from jaxalign.vector import Vec3

pytestmark = pytest.mark.skipif(reloads() is False, reason="XLA loads no stored program on this machine")
usual = settings.store


class Kept(dict):
    def hidden(self):  # in what JAX has been given
        return nullcontext() if usual() is None else usual().hidden()

    def put(self, key, value):
        self[key] = value


@pytest.fixture
def store(monkeypatch):
    kept = Kept()
    monkeypatch.setattr(settings, "store", lambda: kept)
    return kept


traced = []


def turned(v, angle, *, name="x"):
    """A function with static arguments and results."""
    traced.append(name)
    along = getattr(v, name)
    return {"v": v.cross(v) * angle + v, "along": along, "what": name, "nothing": None}


@pytest.fixture
def arguments():
    traced.clear()
    return Vec3(*np.random.default_rng(0).normal(size=(3, 5))), jnp.asarray(0.3)


def same(one, other):
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert a == b if isinstance(a, str) else np.array_equal(a, b)


def test_a_stored_one_is_not_traced_again(store, arguments):
    first = Program(turned)(*arguments, name="y")
    assert traced == ["y"]
    assert len(store) == 1
    again = Program(turned)(*arguments, name="y")  # as in another process: nothing in memory
    same(first, again)
    assert traced == ["y"]
    assert isinstance(again["v"], Vec3)
    np.testing.assert_array_equal(again["along"], arguments[0].y)


def test_whatever_it_depends_on_makes_another_one(store, arguments, monkeypatch):
    v, angle = arguments
    program = Program(turned)
    program(v, angle)
    program(v, angle, name="y")  # what is fixed
    program(jax.tree.map(lambda x: x[:3], v), angle)  # shapes
    program(jax.tree.map(lambda x: x.astype(np.float32), v), angle)
    program(v, jnp.float32(0.3))
    with jax.numpy_dtype_promotion("strict"):  # settings
        program(v, angle)
    for name in ("_library", "_digest"):
        monkeypatch.setattr(programs, name, lambda: "another text of the library")
    Program(turned)(v, angle)
    assert len(traced) == len(store) == 7
    program(v, angle)
    assert len(traced) == 7


class Foreign(eqx.Module):
    """A class whose text nobody looks at."""

    x: Any


@pytest.mark.parametrize("kind", ["class", "function", "object"])
def test_what_may_change_unseen_is_not_kept(store, arguments, kind):
    v, angle = arguments
    if kind == "class":
        Program(lambda v, angle: v.x * angle)(Foreign(v.x), angle)
    elif kind == "function":
        Program(lambda f, x: f(x))(lambda x: x + 1.0, angle)
    else:
        Program(lambda f, x: x + len(f.__class__.__name__))(sys.intern, angle)
    assert not store


def test_inside_traced_code_it_is_the_function(store, arguments):
    v, angle = arguments
    program = Program(turned)
    slope = jax.grad(lambda a: jnp.sum(program(v * jnp.arange(5.0), a)["v"].x + a**2))(angle)
    np.testing.assert_allclose(slope, 2 * 5 * 0.3)
    assert jax.vmap(lambda a: program(v, a)["along"])(jnp.ones(2)).shape == (2, 5)
    assert not store


@pytest.mark.parametrize("stored", [b"", b"no program"])
def test_what_does_not_load_is_made_anew(store, arguments, stored):
    v, angle = arguments
    first = Program(turned)(v, angle)
    (key,) = store
    store[key] = stored
    same(Program(turned)(v, angle), first)
    assert store[key] != stored


def test_errors_that_jax_looks_for_are_found(store, arguments):
    program = Program(lambda x: jnp.log(x))
    assert np.isnan(program(jnp.asarray(-1.0)))
    with jax.debug_nans(True), pytest.raises(FloatingPointError):
        program(jnp.asarray(-1.0))


def test_errors_of_the_function_pass(store, arguments):
    with pytest.raises(AttributeError, match="colour"):
        Program(turned)(*arguments, name="colour")


def test_what_cannot_be_kept_computes_all_the_same(store, arguments, monkeypatch):
    def refuse(*_):
        raise RuntimeError("this device does not write programs")

    monkeypatch.setattr(programs, "_serialized", refuse)
    v, angle = arguments
    program = Program(turned)
    np.testing.assert_array_equal(program(v, angle)["along"], v.x)
    program(v, angle)
    assert traced == ["x"]
    assert not store


def test_a_text_that_has_changed_since_is_not_what_runs(store, arguments, monkeypatch):
    monkeypatch.setattr(programs, "_digest", lambda: "edited")
    Program(turned)(*arguments)
    assert not store


def test_what_stays_on_its_device_is_another_program(store, arguments):
    v, angle = arguments
    program, kept = Program(turned), jax.device_put(v, jax.devices()[0])
    assert program(kept, angle)["along"].committed
    assert not program(v, angle)["along"].committed
    assert len(store) == 2


def test_memory_is_bounded(store, monkeypatch):
    monkeypatch.setattr(programs, "_MOST", 3)
    program = Program(lambda x: x + 1.0)
    for n in range(1, 6):
        assert program(np.ones(n)).shape == (n,)
    assert len(program._ready) == 3


def test_it_says_what_it_is(store):
    assert Program(turned).__doc__ == turned.__doc__
    assert Program(turned).__name__ == "turned"
    assert not eqx.is_array(Program(turned))
