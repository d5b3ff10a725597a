"""Strapdown mechanisation against the simulator, a closed form, and its derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign import NavState, Quat, Vec3, epochs_from_log, navigate
from jaxalign.earth import Site
from jaxalign.mechanization import advance, displacement
from jaxalign.preintegration import Increment
from jaxalign.rotation import attitude_error, quat_from_dcm
from jaxalign.simulate import log_of, noiseless, scenario, truth

run = eqx.filter_jit(navigate)


def navigated(name, samples=2, **options):
    """Noise-free: states and truth at the scenario's epochs."""
    made = noiseless(scenario(name, **options))
    exact = truth(made)
    epochs = epochs_from_log(log_of(made, exact, 0), interval_samples=samples)
    start = NavState.at(made.site, Quat.of(quat_from_dcm(exact.C_nb[0])), Vec3.of(exact.velocity_n[0]))
    states = run(epochs, start)
    every = made.epoch_samples // samples
    return jax.tree.map(lambda x: x[::every], states), exact


@pytest.mark.parametrize(
    ("name", "options"),
    [
        pytest.param("gps-zigzag", {}, marks=pytest.mark.slow),
        pytest.param("dvl-sturn", {}, marks=pytest.mark.slow),
        pytest.param("dvl-accturn", {}, marks=pytest.mark.slow),
        ("dvl-sway", {"duration": 100.0}),
    ],
)
def test_closes_against_the_simulator(name, options):
    """Intervals of two samples over 100-300 s of turns, dives and waves: millimetres and microradians."""
    states, exact = navigated(name, **options)
    assert np.rad2deg(np.abs(attitude_error(states.q_nb.array, quat_from_dcm(exact.C_nb))).max()) < 3e-6
    np.testing.assert_allclose(states.velocity.array, exact.velocity_n, atol=2e-4)
    radius = 6.37e6
    assert np.abs(states.lat - exact.lat).max() * radius < 0.02
    assert np.abs(states.lon - exact.lon).max() * radius < 0.02
    assert np.abs(states.h - exact.h).max() < 0.02


@pytest.mark.slow
def test_shorter_intervals_close_better():
    """Second order: half the interval, a quarter of the error."""
    errors = []
    for samples in (20, 10):
        states, exact = navigated("dvl-sway", samples, duration=60.0)
        errors.append(float(np.abs(states.h - exact.h).max()))
    assert errors[1] < 0.35 * errors[0]


@pytest.mark.slow
def test_half_an_hour_at_rest():
    """Without errors of sensors or start, pure navigation stays within a metre (the vertical is unstable)."""
    states, exact = navigated("disturbed", 20, condition=1, duration=1800.0)
    east_north = np.stack([(states.lon - exact.lon) * np.cos(exact.lat), states.lat - exact.lat]) * 6.37e6
    assert np.abs(east_north).max() < 1e-3
    assert np.abs(states.h - exact.h).max() < 1e-2
    np.testing.assert_allclose(states.velocity.array, 0.0, atol=1e-4)


@pytest.mark.slow
def test_a_tilt_swings_with_schuler():
    """Closed form at rest, away from the Earth's rate: velocity g psi / w_s sin(w_s t), period 84.4 min."""
    made = noiseless(scenario("disturbed", condition=1, duration=1800.0))
    exact = truth(made)
    epochs = epochs_from_log(log_of(made, exact, 0), interval_samples=200)
    psi = 1e-5
    wrong = Quat.exp(Vec3(jnp.asarray(-psi), jnp.asarray(0.0), jnp.asarray(0.0)))
    states = run(epochs, NavState.at(made.site, wrong * Quat.of(quat_from_dcm(exact.C_nb[0]))))
    t = np.asarray(exact.t)[::10]
    schuler = np.sqrt(9.798 / 6.365e6)
    north = 9.798 * psi / schuler * np.sin(schuler * t)  # C_est = (I - [psi x]) C: f_n - psi x f_n
    # The Earth's rotation couples the axes: 4 % after half an hour.
    np.testing.assert_allclose(states.velocity.y, north, atol=0.04 * north.max())


def test_held_position_and_displacement():
    site = Site(0.6, 1.9, 300.0)
    state = NavState.at(site, Quat.identity(), Vec3(*map(jnp.asarray, (10.0, 20.0, -1.0))))
    still = Increment(Quat.identity(), Vec3(*map(jnp.asarray, (0.0, 0.0, 9.8))))
    held, moved = advance(state, still, 1.0, held=True), advance(state, still, 1.0)
    assert (held.lat, held.lon, held.h) == (site.lat, site.lon, site.h)
    mean = (np.asarray(state.velocity.array) + np.asarray(moved.velocity.array)) / 2
    np.testing.assert_allclose(displacement(moved, site).array, mean, rtol=1e-4)


@pytest.mark.slow
def test_gradient_of_the_end_with_respect_to_the_start():
    made = noiseless(scenario("dvl-sturn", duration=30.0))
    exact = truth(made)
    epochs = epochs_from_log(log_of(made, exact, 0), interval_samples=20)
    q = Quat.of(quat_from_dcm(exact.C_nb[0]))

    def end(x):
        start = NavState.at(made.site, Quat.exp(Vec3.of(x[:3])) * q, Vec3.of(exact.velocity_n[0] + x[3:]))
        last = jax.tree.map(lambda s: s[-1], navigate(epochs, start))
        return displacement(last, made.site).array

    at = jnp.zeros(6)
    forward, reverse = jax.jit(jax.jacfwd(end))(at), jax.jit(jax.jacrev(end))(at)
    np.testing.assert_allclose(forward, reverse, atol=1e-9 * np.abs(forward).max())
    compiled = jax.jit(end)
    for h in (1e-4, 1e-5):
        columns = [(compiled(at.at[i].set(h)) - compiled(at.at[i].set(-h))) / (2 * h) for i in range(6)]
        np.testing.assert_allclose(forward, np.stack(columns, axis=1), atol=1e-5 * np.abs(forward).max())
    # A tilt of one radian drives half g t^2.
    np.testing.assert_allclose(np.abs(forward[1, 0]), 0.5 * 9.8 * 30.0**2, rtol=0.01)
