"""What only reproduces print: beside the library's forms, and how an old option finds it (frozen results: vectors/)."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import epochs_of, solver

import jaxalign as ja
from jaxalign import UserError, published
from jaxalign.aids import plain
from jaxalign.cli.main import main
from jaxalign.method_file import read_method
from jaxalign.methods import RECIPES, build
from jaxalign.published.recipes import PUBLISHED
from jaxalign.reconstruct.apparent_velocity import UPPER, Innovation


def test_recipes_are_marked_and_listed_apart(capsys):
    assert {name for name, recipe in RECIPES.items() if recipe.published} == set(PUBLISHED)
    assert all(name.endswith("_as_published") for name in PUBLISHED)
    assert main(["methods"]) == 0
    own, apart = capsys.readouterr().out.split("\nas published")
    for name in RECIPES:
        assert (f"\n{name} " in apart) == (name in PUBLISHED)
        assert name in (apart if name in PUBLISHED else own)


@pytest.mark.parametrize(
    ("name", "path", "value", "words"),
    [
        ("oba", "observe.coriolis", "closed", "leave it out: .* oba_as_published"),
        ("centred_oba", "observe.transport_rate", True, "leave it out: .* oba_as_published"),
        ("rkf_oba", "reconstruct.as_published", False, "leave it out: .* rkf_oba_as_published"),
        ("quaternion_kf", "estimate.measurement_noise", "full", "take quaternion_kf_as_published"),
        ("dual_vector", "vectors", "halves", "take dual_vector_as_published"),
    ],
)
def test_old_method_files_say_what_to_change(tmp_path, name, path, value, words):
    method = build(name)
    content = {"method": name, "aids": [plain(aid) for aid in method.aids], "prefilter": None}
    content["parameters"] = {**ja.parameters(method), path: value}
    (tmp_path / "old.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match=f"old.json: {path}.*{words}") as caught:
        read_method(tmp_path / "old.json")
    assert "\n" not in str(caught.value)


def test_what_the_printed_recipes_have_is_set_by_path():
    assert build("oba_as_published", "body", {"observe.transport_rate": "true"}).observe.transport_rate
    assert build("dual_vector_as_published", parameters={"vectors": "rls"}).vectors == "rls"
    with pytest.raises(UserError, match="must be one of halves, ends, rls"):
        build("dual_vector_as_published", parameters={"vectors": "hann"})


@pytest.mark.parametrize("aid", ["body", "nav"])
def test_observation_for_another_method(aid):
    method = build("centred_oba", aid, {"observe.window": 0.0, "front_end.interval_samples": 20})
    found = published.with_published_observation(method)
    assert found.estimate == method.estimate
    assert found.front_end.interval_samples == 20
    assert type(found.observe) is type(build("oba_as_published", aid).observe)
    windowed = published.with_published_observation(build("oba", aid, {"observe.window": 60.0}))
    assert windowed.observe.window == 60.0
    with pytest.raises(UserError, match="a standing vehicle"):
        published.with_published_observation(build("oba", "static"))


@pytest.mark.parametrize("aid", ["body", "nav"])
def test_observation_differs_by_little(aid):
    """The transport rate, a yaw bias of some tenths of a degree, and the Coriolis term early on."""
    own, printed = (solver()(build(name, aid), epochs_of(aid, noise=False)) for name in ("oba", "oba_as_published"))
    difference = np.rad2deg(2 * np.linalg.norm(np.asarray(own.q_nb - printed.q_nb), axis=1))
    assert 0.01 < difference[-1] < 2.0


def test_printed_filter_is_a_plain_one_where_nothing_is_outlying():
    """With a weight of one, gain and covariance are those of the repaired filter, Joseph form or not."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4))
    full = root @ root.T
    p = {ij: jnp.full(3, full[ij]) for ij in UPPER}
    b = [jnp.asarray(x) for x in rng.normal(size=4)]
    one = Innovation(jnp.asarray(rng.normal(size=3)), jnp.ones(3), jnp.asarray(0.3))
    printed = published.PrintedApparentVelocityFilter()
    ours, theirs = (x.correct(p, b, one) for x in (ja.ApparentVelocityFilter(), printed))
    for a, c in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(a, c, rtol=1e-10, atol=1e-12)
    half = Innovation(one.value, jnp.full(3, 0.5), one.variance)
    gained, covariance = printed.correct(p, b, half)
    np.testing.assert_allclose(gained, 0.5 * np.asarray(theirs[0]), rtol=1e-12)
    np.testing.assert_array_equal(covariance, theirs[1])
