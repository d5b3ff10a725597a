"""The noise of an aid as the robust batch estimator finds it: mis-stated, large, shared by neighbours."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from logs import with_noise
from statistical import outlying, phi_deg

from jaxalign import Vec3
from jaxalign.batch import RobustMap
from jaxalign.simulate import intervals_of, measure_epochs, scenario, truth

measured = eqx.filter_jit(measure_epochs)


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["at_least", "estimated"])
def test_mis_stated_noise(noise):
    """Two thirds of the true noise are stated: the data say so, and the deviations hold."""
    made = outlying(scenario("dvl-sturn"), 0.1)
    exact = truth(made)
    epochs = measured(intervals_of(exact, made.epoch_samples), made, jax.random.key(1))
    epochs = epochs.with_sd(epochs.aid_sd / 1.5)
    found = RobustMap(imu=made.imu, aid_noise=noise).solve(epochs, 300)
    np.testing.assert_allclose(found.aid_sd[-1], 0.1, rtol=0.08)


def coloured(made, keys, sd, seconds):
    """Epochs of many runs (on the last axis), their fixes with a noise (m/s) that neighbours share for so long."""
    r = np.exp(-1.0 / max(seconds, 1e-3))
    exact = truth(made)
    intervals = intervals_of(exact, made.epoch_samples)
    made = with_noise(made, 1e-3)

    @jax.jit
    def drawn(keys):
        first, second = jax.vmap(jax.random.split)(keys).T
        epochs = measure_epochs(intervals, made, first)
        white = jax.vmap(lambda key: jax.random.normal(key, (len(epochs), 3)))(second)

        def step(x, n):
            x = r * x + np.sqrt(1 - r * r) * n
            return x, x

        noise = sd * jax.lax.scan(step, white[:, 0], jnp.moveaxis(white, 1, 0))[1]
        rows = epochs.rows.with_velocity(epochs.rows.velocity + Vec3.of(noise))
        return dataclasses.replace(epochs, rows=rows).with_sd(jnp.asarray(sd))

    return drawn(keys), exact


@eqx.filter_jit
def ends_of(method, epochs):
    """Attitudes and deviations of the heading at the end of many runs."""
    found = method.solve_runs(epochs, np.array([len(epochs) - 1]))
    return found.q_nb, found.sd[:, -1, 2]


def headings(method, epochs, exact):
    """Heading errors and their deviations, deg."""
    q, sd = ends_of(method, epochs)
    return np.asarray(phi_deg(q, exact.C_nb[-1:]))[:, 0, 2], np.rad2deg(sd)


@pytest.mark.slow
@pytest.mark.parametrize(("sd", "seconds"), [(10.0, 0.0), (1.0, 20.0)])
def test_noise_as_large_as_the_changes_of_velocity(sd, seconds):
    """GNSS white of 10 m/s, or of 1 m/s that lasts for 20 s, on a car of 10 m/s: slow, but no step too far."""
    made = scenario("gps-zigzag")
    epochs, exact = coloured(made, jax.random.split(jax.random.key(1), 24), sd, seconds)
    phi, deviation = headings(RobustMap(imu=made.imu, aids="nav"), epochs, exact)
    print(np.sqrt(np.mean(phi**2)), np.median(deviation))
    assert np.sqrt(np.mean((phi / deviation) ** 2)) < 1.2
    assert np.abs(phi).max() < 30
    assert np.median(deviation) < 16


@pytest.mark.slow
def test_a_stated_noise_that_is_far_too_small_says_nothing_of_the_start():
    """30 s with a hundredth of the true noise stated: the heading is as open as it is."""
    made = scenario("dvl-sturn", duration=30.0)
    epochs = measured(intervals_of(truth(made), made.epoch_samples), made, jax.random.key(1))
    method = RobustMap(imu=made.imu)
    sd = [np.rad2deg(method.solve(epochs.with_sd(jnp.asarray(x)), 30).sd[-1, 2]) for x in (0.1, 1e-3)]
    assert sd[1] > 0.6 * sd[0]


@pytest.mark.slow
def test_noise_that_neighbours_share_is_counted():
    """A first-order process of 5 s instead of white noise: deviations that were three times too small hold."""
    made = scenario("dvl-sturn")
    epochs, exact = coloured(made, jax.random.split(jax.random.key(3), 60), 0.1, 5.0)
    ratio = []
    for noise in ("at_least", "stated"):
        phi, sd = headings(RobustMap(imu=made.imu, aid_noise=noise), epochs, exact)
        ratio.append(np.sqrt(np.mean((phi / sd) ** 2)))
    print(ratio)
    assert ratio[0] < 1.5
    assert ratio[1] > 2.0
