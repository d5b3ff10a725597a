"""Tunable numbers: read and set by path, parsed, bounded, and never a reason to compile again."""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxalign.errors import UserError
from jaxalign.methods import RECIPES, build, build_for
from jaxalign.parametrization import parameters, tunable, with_parameters


class Robust(eqx.Module):
    gamma: jax.Array = tunable(2.5, unit="m/s", bounds=(0.1, 10.0))
    sharp: bool = eqx.field(static=True, default=False)


class Method(eqx.Module):
    weight: Robust
    forgetting: jax.Array = tunable(1.0, unit="1", bounds=(0.5, 1.0))
    window: float = eqx.field(static=True, default=0.0)
    kind: str = eqx.field(static=True, default="hann")
    passes: int = eqx.field(static=True, default=2)
    samples: int | None = eqx.field(static=True, default=None, metadata={"optional": True, "integer": True})
    axes: jax.Array = eqx.field(default_factory=lambda: jnp.array([1.0, 2.0, 3.0]))

    def __check_init__(self):
        if self.kind not in ("hann", "5", "TRUE", "none", "1e3"):
            raise UserError(f"kind = {self.kind!r}: must be hann")
        if self.window > 100:
            raise ValueError(f"window = {self.window:g}: too long")


METHOD = Method(Robust())
PATHS = ["weight.gamma", "weight.sharp", "forgetting", "window", "kind", "passes", "samples", "axes"]


def test_parameters_lists_paths_and_plain_values():
    found = parameters(METHOD)
    assert found == {
        "weight.gamma": 2.5,
        "weight.sharp": False,
        "forgetting": 1.0,
        "window": 0.0,
        "kind": "hann",
        "passes": 2,
        "samples": None,
        "axes": [1.0, 2.0, 3.0],
    }
    assert list(found)[:2] == PATHS[:2]
    assert json.loads(json.dumps(found)) == found


@pytest.mark.parametrize(
    ("path", "text", "value"),
    [
        ("weight.gamma", "3", 3.0),
        ("weight.gamma", "2.5e-1", 0.25),
        ("weight.gamma", 4, 4.0),
        ("weight.gamma", np.float32(0.5), 0.5),
        ("weight.gamma", jnp.asarray(0.1), 0.1),
        ("weight.gamma", 10.0, 10.0),
        ("weight.sharp", "true", True),
        ("weight.sharp", "False", False),
        ("weight.sharp", True, True),
        ("window", "30", 30.0),
        ("window", 12, 12.0),
        ("window", np.float64(1.5), 1.5),
        ("passes", "3", 3),
        ("passes", "3.0", 3),
        ("passes", np.int64(4), 4),
        ("samples", "200", 200),
        ("samples", "none", None),
        ("samples", "null", None),
        ("samples", None, None),
        ("kind", "hann", "hann"),
        ("kind", "5", "5"),
        ("kind", "TRUE", "TRUE"),
        ("kind", "none", "none"),
        ("kind", "1e3", "1e3"),
        ("axes", "[3, 2, 1]", [3.0, 2.0, 1.0]),
        ("axes", np.arange(3), [0.0, 1.0, 2.0]),
    ],
)
def test_values_are_parsed_to_what_the_field_holds(path, text, value):
    changed = with_parameters(METHOD, {path: text})
    assert parameters(changed) == parameters(METHOD) | {path: value}
    assert type(parameters(changed)[path]) is type(value)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("weight.gamma", "0.09", r"weight\.gamma = '0\.09': outside its bounds 0\.1 \.\. 10 m/s"),
        ("weight.gamma", 11, r"outside its bounds 0\.1 \.\. 10 m/s"),
        ("weight.gamma", "nan", "must be a number"),
        ("weight.gamma", "NaN", "weight.gamma = 'NaN'"),
        ("weight.gamma", "Infinity", "outside its bounds"),
        ("weight.gamma", "large", "weight.gamma = 'large': must be a number"),
        ("weight.gamma", "true", "must be a number"),
        ("weight.gamma", "none", "must be a number"),
        ("weight.gamma", "[1.0]", "must be a number"),
        ("weight.gamma", '{"a": 1}', "must be a number"),
        ("weight.gamma", "1 2", "must be a number"),
        ("weight.gamma", "", "must be a number"),
        ("weight.gamma", 1j, "must be a number"),
        ("axes", "[1, 2]", r"axes = '\[1, 2\]': must be a number \(array of shape \(3,\)\)"),
        ("axes", '["a", "b", "c"]', "must be a number"),
        ("axes", "[[1], [2, 3], 4]", "must be a number"),
        ("axes", "[1, 2, null]", "must be a number"),
        ("axes", "[1, 2, NaN]", "axes = "),
        ("weight.sharp", "1", "weight.sharp = '1': must be true or false"),
        ("weight.sharp", "yes", "must be true or false"),
        ("weight.sharp", 0, "must be true or false"),
        ("window", "long", "window = 'long': must be a number"),
        ("window", "true", "must be a number"),
        ("window", "none", "must be a number"),
        ("window", "[1]", "must be a number"),
        ("window", "NaN", "must be a number"),
        ("window", 101, "window = 101: too long"),
        ("passes", "2.5", "passes = '2.5': must be a whole number"),
        ("passes", "Infinity", "must be a whole number"),
        ("passes", "NaN", "must be a whole number"),
        ("passes", "none", "must be a whole number"),
        ("samples", "2.5", "samples = '2.5': must be a whole number"),
        ("samples", "some", "must be a whole number"),
        ("samples", "true", "must be a whole number"),
        ("kind", "square", "kind = 'square': must be hann"),
        ("kind", 5, "kind = 5: must be a word"),
    ],
)
def test_bad_values_are_refused_in_one_line(path, value, message):
    with pytest.raises(UserError, match=message) as caught:
        with_parameters(METHOD, {path: value})
    assert "\n" not in str(caught.value)


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from(PATHS),
    st.text(max_size=8)
    | st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=2), inner, max_size=2),
    ).map(json.dumps),
)
def test_whatever_is_typed_is_taken_or_refused_clearly(path, text):
    try:
        changed = with_parameters(METHOD, {path: text})
    except UserError:
        return
    value = parameters(changed)[path]
    assert type(value) in (float, int, bool, str, list, type(None))
    assert parameters(with_parameters(METHOD, {path: value}))[path] == value


@pytest.mark.parametrize(
    ("path", "near"),
    [("weight.gama", "weight.gamma"), ("gamma", "weight.gamma"), ("forgeting", "forgetting"), ("Window", "window")],
)
def test_unknown_paths_are_met_with_the_nearest(path, near):
    with pytest.raises(UserError, match=rf"no parameter '{path}' in this method: did you mean .*{near}"):
        with_parameters(METHOD, {path: 1.0})


def test_unlike_everything_lists_everything():
    with pytest.raises(UserError) as caught:
        with_parameters(METHOD, {"zzzzzz": 1.0})
    assert all(path in str(caught.value) for path in PATHS)


def test_a_slot_is_not_a_number():
    with pytest.raises(UserError, match="no parameter 'weight' in this method"):
        with_parameters(METHOD, {"weight": 1.0})


def test_the_original_is_left_alone_and_several_are_set_at_once():
    before = parameters(METHOD)
    changed = with_parameters(METHOD, {"weight.gamma": 1.0, "weight.sharp": True, "window": 5.0})
    assert parameters(METHOD) == before
    assert parameters(changed) == before | {"weight.gamma": 1.0, "weight.sharp": True, "window": 5.0}


def test_a_tunable_is_a_strong_float64_leaf_however_it_is_made():
    made = [Robust(3), Robust(np.float32(3)), Robust(jnp.float32(3)), with_parameters(Robust(), {"gamma": 3})]
    for module in made:
        assert module.gamma.dtype == jnp.float64
        assert not module.gamma.weak_type
        assert module.gamma.shape == ()
    assert not with_parameters(METHOD, {"axes": [1, 2, 3]}).axes.weak_type


def test_changing_a_tunable_does_not_compile_again():
    traces = []

    @eqx.filter_jit
    def scaled(method, x):
        traces.append(method)
        return x * method.weight.gamma * method.forgetting

    values = [METHOD, Method(Robust(0.5)), *(with_parameters(METHOD, {"weight.gamma": v}) for v in (1, "2", 3.5))]
    results = [float(scaled(method, 2.0)) for method in values]
    assert results == [5.0, 1.0, 2.0, 4.0, 7.0]
    assert len(traces) == 1
    scaled(with_parameters(METHOD, {"window": 3.0}), 2.0)
    assert len(traces) == 2  # a static field does


def test_a_tunable_has_a_gradient():
    slope = eqx.filter_grad(lambda method: method.weight.gamma**2 * method.forgetting)(METHOD)
    assert float(slope.weight.gamma) == 5.0
    assert float(slope.forgetting) == 6.25


def test_round_trip():
    changed = with_parameters(METHOD, {"weight.gamma": 0.3, "samples": 7, "kind": "5", "axes": [3, 1, 2]})
    again = with_parameters(METHOD, parameters(changed))
    assert eqx.tree_equal(again, changed)
    through_json = with_parameters(METHOD, json.loads(json.dumps(parameters(changed))))
    assert eqx.tree_equal(through_json, changed)


@pytest.mark.parametrize(("name", "aid"), [(name, aid) for name, recipe in RECIPES.items() for aid in recipe.aids])
def test_recipes_round_trip(name, aid):
    method = build(name, aid)
    values = parameters(method)
    assert json.loads(json.dumps(values)) == values
    assert eqx.tree_equal(build(name, aid, values), method)
    # as typed on a command line: words as they are, numbers and none as JSON writes them
    typed = {path: value if isinstance(value, str) else json.dumps(value) for path, value in values.items()}
    assert eqx.tree_equal(build(name, aid, typed), method)
    for leaf in jax.tree.leaves(method):
        assert leaf.dtype == jnp.float64
        assert not leaf.weak_type


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("obaa",), "no method 'obaa': did you mean .*oba"),
        (("zzz",), "no method 'zzz': there are triad, dual_vector"),
        (("oba", "radar"), "no aid 'radar': did you mean"),
        (("roba", "static"), "roba does not take static .*, only body, nav"),
        (("oba", "body", {"observe.windw": 3}), r"no parameter 'observe.windw' .* did you mean observe\.window"),
        (("oba", "body", {"observe.window": -3}), r"observe\.window = -3.*: must be a number of seconds"),
        (("roba", "body", {"weight.residual": "open"}), "weight.residual = 'open': must be one of vector, norm"),
        (
            ("oba", "body", {"observe.coriolis": "closed"}),
            "observe.coriolis is no option of oba .*leave it out:",
        ),
        (("dual_vector", "static", {"vectors": "rls"}), "vectors = 'rls' .* take dual_vector_as_published"),
        (
            ("oba", "body", {"front_end.interval_samples": 0}),
            "interval_samples = 0: must be a whole number of IMU samples",
        ),
    ],
)
def test_build_refuses_in_one_line(arguments, message):
    with pytest.raises(UserError, match=message) as caught:
        build(*arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (
            "oba",
            {"windw": 3.0},
            r"oba has no option 'windw': did you mean 'window'\? \(known: ",
        ),
        ("gravity_q", {"vectors": "integrated"}, "gravity_q: .* multiple values for .* 'vectors'"),
        ("robust_map", {"heading": 3}, "robust_map has no option 'heading': did you mean 'headings'"),
        ("oba", {"window": -1.0}, r"observe\.window = -1"),
    ],
)
def test_build_refuses_options(name, options, message):
    with pytest.raises(UserError, match=message) as caught:
        build(name, **options)
    assert "\n" not in str(caught.value)


def test_build_passes_options_on():
    assert build("oba", aid="body", window=10.0).observe.window == 10.0
    assert build("robust_map", "nav", headings=4).headings == 4
    assert build("dual_vector", fraction=0.25, parameters={"vectors": "boxcar"}).fraction == 0.25
    assert build_for("body", "triad", interval_samples=20).front_end.interval_samples == 20


def test_build_sets_parameters():
    method = build("oba", "body", {"observe.window": "30", "front_end.interval_samples": "none"})
    assert method.observe.window == 30.0
    assert method.front_end.interval_samples is None
    assert type(build("centred_oba").observe.aid) is RECIPES["centred_oba"].aids[0]
