"""Sliding windows, epochs between fixes, noise of the aid: they go together on real logs."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from logs import with_velocity

import jaxalign as ja
from jaxalign import Status, align, epochs_from_arrays
from jaxalign.methods import build
from jaxalign.metrics import attitude_error_deg


@pytest.fixture(scope="module")
def log():
    return ja.simulate.simulate("dvl-sturn", 5)


@pytest.mark.parametrize("window", [20.5, *(pytest.param(x, marks=pytest.mark.slow) for x in (20.0, 21.0))])
def test_a_window_never_stops_for_want_of_a_far_end(log, window):
    """Epochs of half a second between fixes of one: whatever the window, every fix gives a vector."""
    method = build("oba", "body", {"front_end.interval_samples": 100, "observe.window": window})
    found = align(method, log)
    fix = np.arange(len(found.time)) % 2 == 0
    np.testing.assert_array_equal(np.asarray(found.weight) > 0, fix)
    np.testing.assert_array_equal((np.asarray(found.status) & Status.AID_MISSING) == 0, fix)
    assert abs(attitude_error_deg(found, log)[-1, 2]) < 2.0


@pytest.mark.slow
def test_a_window_over_lost_fixes_reaches_back_to_the_last_one(log):
    velocity = log.aids[0].value.copy()
    velocity[1::2] = np.nan
    holed = with_velocity(log, velocity)
    # 21 s back there is no fix, 22 s back there is one.
    odd, wide = (align(build("oba", "body", {"observe.window": w}), holed) for w in (21.0, 22.0))
    assert (np.asarray(odd.weight) > 0).sum() == (np.asarray(wide.weight) > 0).sum() == 151
    late = (np.asarray(odd.time) >= 60) & (np.asarray(odd.weight) > 0)
    np.testing.assert_allclose(np.asarray(odd.alpha)[late], np.asarray(wide.alpha)[late], atol=1e-9)


@pytest.mark.slow
def test_a_window_of_the_whole_length_is_the_whole(log):
    whole, window = (align(build("oba", "body", {"observe.window": w}), log) for w in (0.0, 300.0))
    np.testing.assert_allclose(window.q_nb, whole.q_nb, atol=1e-9)


@pytest.mark.parametrize("parameters", [{}, pytest.param({"front_end.interval_samples": 50}, marks=pytest.mark.slow)])
def test_noise_is_estimated_whatever_the_interval(log, parameters):
    bare = log.with_aid(dataclasses.replace(log.aids[0], sd=None))
    found = align(build("oba", "body", parameters), bare, every=100)
    assert float(found.aid_sd[-1]) == pytest.approx(0.1, rel=0.2)


@pytest.mark.slow
def test_the_noise_used_is_what_was_asked_for(log):
    """What the caller says; else what the log says of the aid observed; else an estimate."""
    assert float(align(build("oba"), log, 100).aid_sd[-1]) == 0.1
    assert float(align(build("oba"), log, 100, aid_sd=0.3).aid_sd[-1]) == 0.3
    standing = ja.simulate.simulate("sway", 1, duration=60.0)
    estimate = float(align(build("gravity_q"), standing, 300).aid_sd[-1])
    force = 500e-6 * 9.80665 * 0.01 * np.sqrt(10)  # 500 ug per sample of 10 ms, ten samples an epoch
    assert estimate == pytest.approx(force, rel=0.15)
    assert float(align(build("gravity_q"), standing, 300, aid_sd=0.3).aid_sd[-1]) == 0.3


@pytest.mark.parametrize(
    ("name", "aid", "parameters"),
    [
        ("gravity_q", "static", {"observe.window": 60.0}),
        ("centred_oba", "body", {"observe.window": 60.0}),
        ("centred_oba", "nav", {"observe.window": 60.0}),
    ],
)
def test_windows_that_mean_nothing_are_refused(name, aid, parameters):
    with pytest.raises(ja.UserError, match="means nothing"):
        build(name, aid, parameters)


def test_absurd_window_is_refused(log):
    with pytest.raises(ja.UserError, match="at most"):
        align(build("oba", "body", {"observe.window": 1e9}), log)


class Damped(ja.AbstractWeight):
    looks_at_attitude = False
    gamma: jax.Array = ja.tunable(1.0, unit="1", bounds=(0.1, 10.0))

    def init(self):
        return None

    def step(self, state, context, pair):
        return state, jnp.exp(-context.time / (100.0 * self.gamma))


@pytest.mark.slow
def test_tunables_may_be_traced(log):
    """Built or set inside jit, vmap and grad: a number of a method is a leaf like any other."""
    epochs, observe = ja.epochs_from_log(log), ja.BodyVelocityVectors()

    def built(gamma):
        return ja.Aligner(observe, weight=Damped(gamma), estimate=ja.QMethod()).solve(epochs, 100).q_nb[-1, 3]

    base = ja.Aligner(observe, weight=Damped(), estimate=ja.QMethod())

    def set_(gamma):
        return ja.with_parameters(base, {"weight.gamma": gamma}).solve(epochs, 100).q_nb[-1, 3]

    h = 1e-3
    values = np.array([[0.5, 1.0, 2.0]]) + np.array([[0.0], [-h], [h]])
    together, slopes = (np.asarray(x) for x in jax.jit(jax.vmap(jax.value_and_grad(built)))(values.ravel()))
    np.testing.assert_allclose(together, jax.jit(jax.vmap(set_))(values.ravel()), rtol=1e-12)
    at, below, above = together.reshape(3, 3)
    assert len(set(at)) == 3
    # One of the slopes is near its zero: steps meet the rounding of the eigenproblem there.
    np.testing.assert_allclose(slopes[:3], (above - below) / (2 * h), atol=1e-4 * np.abs(slopes).max())


def test_float32_arrays_are_refused_by_name(log):
    arguments = dict(dt=log.dt, every=200, site=ja.Site(log.lat), aid="body")
    for name in ("dtheta", "dvel", "values"):
        arrays = {"dtheta": log.dtheta, "dvel": log.dvel, "values": log.aids[0].value}
        arrays[name] = arrays[name].astype(np.float32)
        with pytest.raises(ja.UserError, match=f"{name}.*float32.*jax_enable_x64"):
            epochs_from_arrays(**arrays, **arguments)
    with pytest.raises(ja.UserError, match=r"no aid 'gps': did you mean.*body"):
        epochs_from_arrays(log.dtheta, log.dvel, log.aids[0].value, **{**arguments, "aid": "gps"})


def test_what_is_no_method_and_no_log(log):
    with pytest.raises(ja.UserError, match="no method"):
        align("oba", log)
    with pytest.raises(ja.UserError, match="neither"):
        align(build("oba"), "log.npz")
    with pytest.raises(ja.UserError, match="every"):
        align(build("oba"), log, "2")


def test_a_row_of_a_solution_is_a_solution(log):
    found = align(build("oba"), log, 100)
    last = jax.tree.map(lambda x: x[-1], found)
    assert last.time == 300.0
    assert last.heading_deg.shape == ()


@pytest.mark.uncached
def test_logs_with_slightly_different_clocks_share_a_program(log, caplog):
    method = build("oba")
    align(method, log, 100)
    with jax.log_compiles(), caplog.at_level("WARNING"):
        faster = 1 + 2e-7
        aid = dataclasses.replace(log.aids[0], time=log.aids[0].time * faster)
        align(method, dataclasses.replace(log, dt=log.dt * faster, aids=(aid,)), 100)
    assert not [r for r in caplog.records if "Finished XLA compilation" in r.getMessage()]


def test_crop_moves_the_place_of_a_nav_log():
    log = ja.simulate.simulate("gps-zigzag", 1, noise=False)
    part = log.crop(100.0, 200.0)
    exact = ja.simulate.truth(ja.simulate.scenario("gps-zigzag"))
    assert part.lat == pytest.approx(float(exact.lat[100]), abs=1e-6)  # a sphere's radius: 0.5 % of the way
    assert part.lon == pytest.approx(float(exact.lon[100]), abs=1e-6)  # a sphere's radius: 0.5 % of the way
