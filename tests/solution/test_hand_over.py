"""What an alignment hands on is as sure as it says: attitude, velocity and biases together."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxalign as ja
from examples.hand_over import navigated
from jaxalign.nav_estimate import NavEstimate, blocks_of
from jaxalign.rotation import attitude_error, dcm_from_quat, quat_from_dcm
from jaxalign.simulate import draw_bias, intervals_of, measure_epochs, scenario, simulate, truth
from jaxalign.simulate.measurement import source_keys

RUNS = 200


def estimate(seed=1):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(13, 13))
    blocks = blocks_of(attitude=3, velocity=3, gyro_bias=3, accel_bias=3, offset=1)
    q = np.array([0.9, 0.1, -0.3, 0.2])
    parts = (jnp.asarray(x) for x in (7.0, q / np.linalg.norm(q), *rng.normal(size=(4, 3)), np.ones(1), root @ root.T))
    return NavEstimate(*parts, blocks=blocks)


def test_blocks_and_axes():
    one = estimate()
    np.testing.assert_array_equal(one.block("velocity", "attitude")[:3, 3:], one.covariance[3:6, 0:3])
    np.testing.assert_allclose(one.sd("offset"), np.sqrt(one.covariance[12, 12]))
    with pytest.raises(ja.UserError, match="no block 'lever' in this covariance: there is attitude"):
        one.block("lever")
    swap = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    ned = one.in_ned()
    np.testing.assert_allclose(dcm_from_quat(ned.q_nb), swap @ dcm_from_quat(one.q_nb) @ swap, atol=1e-15)
    np.testing.assert_allclose(ned.velocity, swap @ one.velocity)
    np.testing.assert_allclose(ned.block("attitude", "gyro_bias")[:3, 3:], swap @ one.covariance[0:3, 6:9] @ swap)
    np.testing.assert_allclose(ned.block("offset", "velocity")[0, 1:], swap @ one.covariance[3:6, 12])
    assert ned.in_ned() is ned
    body = one.with_body_errors()
    c_bn = np.asarray(dcm_from_quat(one.q_nb)).T
    np.testing.assert_allclose(body.block("attitude"), c_bn @ one.block("attitude") @ c_bn.T, atol=1e-12)
    both = one.in_ned().with_body_errors()
    np.testing.assert_allclose(both.block("attitude"), swap @ body.block("attitude") @ swap, atol=1e-12)


def test_of_a_standing_vehicle():
    """The filter of fine alignment hands on what it says of itself, with the signs of a hand-over."""
    log = simulate("disturbed", 1, duration=60.0)
    found = ja.align(ja.build("fine"), log, every=300)
    handed = found.nav
    np.testing.assert_allclose(handed.block("attitude"), found.covariance)
    np.testing.assert_array_equal(handed.gyro_bias, found.filter.gyro_bias)
    assert np.abs(handed.velocity[-1]).max() < 0.1
    np.testing.assert_allclose(handed.position[-1], [log.lat, log.lon, log.h])
    # an east gyro that reads too much turns the estimate: more of its bias found, less of the heading's error
    assert np.sign(handed.block("attitude", "gyro_bias")[-1][2, 3]) != 0
    assert ja.align(ja.build("gravity_q"), log, every=300).nav is None


def squares(error, covariance):
    """Normalised squares per degree of freedom."""
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    z, correlation = error / sd, covariance / (sd[..., :, None] * sd[..., None, :])
    return np.einsum("...i,...i", z, np.linalg.solve(correlation, z[..., None])[..., 0]) / error.shape[-1]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "aid", "row"), [("dvl-sturn", "body", 150), ("gps-zigzag", "nav", 200)])
def test_handed_over_errors_are_as_large_as_stated(name, aid, row):
    made = scenario(name, bias="gaussian")
    exact = truth(made)
    intervals = intervals_of(exact, made.epoch_samples)
    method = dataclasses.replace(ja.build("robust_map", aid), imu=made.imu, aid_noise="stated")

    @eqx.filter_jit
    def handed(keys):
        found = method.solve_runs(measure_epochs(intervals, made, keys), np.array([row]))
        gyro, accel, *_ = (jax.vmap(lambda key, i=i: jax.random.split(source_keys(key)[i])[0])(keys) for i in range(2))
        draw = [jax.vmap(lambda k, e=e: draw_bias(e, made.bias, k)) for e in (made.imu.gyro, made.imu.accel)]
        return found.nav, draw[0](gyro), draw[1](accel)

    nav, gyro, accel = handed(jax.random.split(jax.random.key(0), RUNS))
    nav = jax.tree.map(lambda x: np.asarray(x)[:, 0], nav)
    phi = np.asarray(attitude_error(nav.q_nb, jnp.broadcast_to(quat_from_dcm(exact.C_nb[row]), nav.q_nb.shape)))
    velocity = nav.velocity - np.asarray(exact.velocity_n[row])
    error = np.concatenate([phi, velocity, nav.gyro_bias - gyro, nav.accel_bias - accel], axis=1)
    mean = squares(error, nav.covariance).mean()
    print(name, mean)
    assert 0.9 < mean < 1.15
    north = (nav.position[:, 0] - float(exact.lat[row])) * 6.37e6
    assert np.abs(north).max() < 60.0  # of a kilometre or two


@pytest.mark.slow
def test_a_filter_goes_on_with_innovations_as_it_expects():
    made = scenario("dvl-sturn", bias="gaussian")
    exact = truth(made)
    half, fine = 150, 20
    whole, short = (intervals_of(exact, n) for n in (made.epoch_samples, fine))
    method = dataclasses.replace(ja.build("robust_map", "body"), imu=made.imu, aid_noise="stated")
    per = made.epoch_samples // fine

    @eqx.filter_jit
    def first_fixes(keys):
        nav = method.solve_runs(measure_epochs(whole, made, keys), np.array([half])).nav
        rows = measure_epochs(short, made, keys).rows
        rows = jax.tree.map(lambda x: x[half * per + 1 : (half + 5) * per + 1], rows)
        rows = jax.tree.map(
            lambda x: jnp.moveaxis(x, -1, 0) if x.ndim > 1 else jnp.broadcast_to(x, (len(keys), *x.shape)), rows
        )
        _, innovation, expected = jax.vmap(lambda e, r: navigated(e, r, made.imu, made.aids[0].sd))(
            jax.tree.map(lambda x: x[:, 0], nav), rows
        )
        return innovation[:, per - 1 :: per], expected[:, per - 1 :: per]

    innovation, expected = first_fixes(jax.random.split(jax.random.key(3), RUNS))
    mean = squares(np.asarray(innovation), np.asarray(expected)).mean()
    print(mean)
    assert 0.8 < mean < 1.25
