"""Fine alignment over matched runs: its deviations and innovations are as large as its errors."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign import (
    ErrorFilter,
    Fine,
    Quat,
    UserError,
    Vec3,
    epochs_from_arrays,
    estimate_aid_sd,
    with_parameters,
)
from jaxalign.fine import ACCEL, GYRO, PSI, chi_square_band, nees, nis
from jaxalign.inertial_unit import AccelErrors, ImuErrors
from jaxalign.rotation import attitude_error, quat_from_dcm
from jaxalign.simulate import draw_bias, imu_increments, scenario, truth


def matched_problem(duration: float, rate: int):
    """A filter, a scenario with sensors of its numbers, and a base that moves as its zero velocity says."""
    filter_ = with_parameters(
        ErrorFilter(),
        {"initial_tilt_sd_deg": 0.05, "initial_heading_sd_deg": 1.0, "imu.accel.density_ug_sqrt_hz": 20.0},
    )
    made = scenario("disturbed", condition=1, duration=duration, noise_per="density", bias="gaussian")
    imu = ImuErrors(made.imu.gyro, AccelErrors(50.0, 20.0))
    return filter_, dataclasses.replace(made, imu=imu, epoch_samples=rate)


def measured(made, exact, key, rate, base_sd=0.0):
    """Epochs of one run and the drawn biases; the base's velocity is white from epoch to epoch."""
    imu, other = jax.random.split(key)
    dtheta, dvel = imu_increments(exact, made, imu)
    base = base_sd * jax.random.normal(jax.random.fold_in(other, 9), (made.epochs + 1, 3))
    in_b = jnp.diff(base, axis=0) @ exact.C_nb[0]
    dvel = dvel + jnp.repeat(in_b / rate, rate, axis=0)
    keys = [jax.random.fold_in(imu, i) for i in (0, 1)]  # of gyroscopes and accelerometers
    triads = zip((made.imu.gyro, made.imu.accel), keys, strict=True)
    biases = [draw_bias(triad, made.bias, jax.random.split(k)[0]) for triad, k in triads]
    epochs = epochs_from_arrays(dtheta, dvel, None, dt=1 / made.imu_rate, every=rate, site=made.site, aid="static")
    return epochs, base, biases, other


def keys(runs: int):
    return jax.vmap(lambda i: jax.random.fold_in(jax.random.key(7), i))(jnp.arange(runs))


def matched(runs: int, duration: float, shaken: bool, rate: int = 20, heading_sd_deg: float = 1.0):
    """Initial attitudes and biases drawn from P0, sensors with the filter's noise.

    The zero velocity is off either because the base moves, or because it is measured with noise.
    """
    filter_, made = matched_problem(duration, rate)
    filter_ = with_parameters(filter_, {"initial_heading_sd_deg": heading_sd_deg})
    exact = truth(made)
    p0, qr = filter_.initial_covariance, float(filter_.velocity_sd)

    def run(key):
        epochs, base, (gyro, accel), other = measured(made, exact, key, rate, qr if shaken else 0.0)
        first, second, third = jax.random.split(other, 3)
        noise = qr * jax.random.normal(first, (made.epochs + 1, 3)) * (not shaken)
        epochs = dataclasses.replace(epochs, rows=epochs.rows.with_velocity(Vec3.of(noise)))
        sd = jnp.sqrt(jnp.diag(p0))
        psi = sd[PSI] * jax.random.normal(second, (3,))
        state = filter_.init(made.site, Quat.exp(Vec3.of(-psi)) * Quat.of(quat_from_dcm(exact.C_nb[0])))
        moving = Vec3.of(sd[3:6] * jax.random.normal(third, (3,)) + base[0])
        state = eqx.tree_at(lambda s: s.nav.velocity, state, moving)
        rows = jax.lax.scan(lambda s, e: filter_.step(s, e), state, epochs.rows)[1]
        last = jax.tree.map(lambda x: x[-1], rows)
        error = jnp.concatenate(
            [
                attitude_error(last.q_nb.array, quat_from_dcm(exact.C_nb[-1])),
                accel - last.accel_bias.array,  # errors of the sensors that are left
                gyro - last.gyro_bias.array,
            ]
        )
        squares = nis(rows.innovation[1:], rows.innovation_covariance[1:])
        return error, last.covariance[6:, 6:], squares

    return jax.jit(jax.vmap(run))(keys(runs))


@pytest.mark.slow
def test_biases_are_consistent_whatever_the_heading_error():
    """Two degrees of heading add ``w_N psi^2 / 2`` to the Earth's rate: three times the deviation of a bias."""
    error, covariance, _ = (np.asarray(x) for x in matched(100, 300.0, False, heading_sd_deg=2.0))
    low, high = chi_square_band(3, 100, 0.99)
    for block in (PSI, ACCEL, GYRO):
        part = slice(block.start - 6, block.stop - 6)
        assert low < nees(error[:, part], covariance[:, part, part]).mean() < high


@pytest.mark.slow
@pytest.mark.parametrize("shaken", [False, True])
def test_consistency_over_matched_runs(shaken):
    """NEES over attitude and biases, and each block by itself, within the 95 % band of 100 runs; NIS within its."""
    runs = 100
    error, covariance, squares = (np.asarray(x) for x in matched(runs, 300.0, shaken))
    low, high = chi_square_band(9, runs)
    assert low < nees(error, covariance).mean() < high
    for block in (PSI, ACCEL, GYRO):
        part = slice(block.start - 6, block.stop - 6)
        low, high = chi_square_band(3, runs, 0.99)  # three of them
        assert low < nees(error[:, part], covariance[:, part, part]).mean() < high
    low, high = chi_square_band(3, squares.size)
    assert low < squares.mean() < high


def from_cold(duration: float, runs: int, rate: int = 20, **filter_options):
    """Heading errors (deg), stated standard deviations (deg) and NEES of the attitude, through Fine itself."""
    filter_, made = matched_problem(duration, rate)
    method = Fine(filter=dataclasses.replace(filter_, initial_heading_sd_deg=jnp.asarray(3.0), **filter_options))
    exact = truth(made)
    epochs = jax.jit(jax.vmap(lambda key: measured(made, exact, key, rate, 0.01)[0]))(keys(runs))
    sd = estimate_aid_sd(jax.tree.map(lambda x: x[0], epochs))
    epochs = epochs.with_sd(jnp.full(runs, sd))
    found = jax.jit(jax.vmap(lambda e: method.solve(e, made.epochs)))(epochs)
    true = np.broadcast_to(quat_from_dcm(exact.C_nb[-1]), (runs, 4))
    error = attitude_error(found.q_nb[:, -1], true)
    squares = nees(error, found.filter.covariance[:, -1, PSI, PSI])
    return np.rad2deg(error[:, 2]), np.rad2deg(found.sd[:, -1, 2]), np.asarray(squares)


@pytest.mark.slow
@pytest.mark.parametrize("duration", [20.0, 60.0, 120.0])
def test_fine_from_cold_is_as_sure_as_it_should_be(duration):
    """On a base that truly moves by 1 cm/s; from 20 s, where the heading is open by 10 deg, to two minutes."""
    heading, sd, squares = from_cold(duration, 60)
    low, high = chi_square_band(3, 60, 0.99)
    assert low < squares.mean() < high
    assert 0.7 < np.sqrt(np.mean(heading**2)) / sd.mean() < 1.3


@pytest.mark.slow
def test_the_published_form_pretends_to_know_the_heading():
    """The shaking in f x psi counts as information that the heading is right as it is."""
    runs, filter_problem = 60, matched_problem(20.0, 20)
    _, made = filter_problem
    exact = truth(made)
    wide = {"initial_heading_sd_deg": 30.0, "imu.accel.density_ug_sqrt_hz": 20.0}

    def run(key, filter_):
        epochs, *_ = measured(made, exact, key, 20, 0.01)
        off = Quat.exp(Vec3(*map(jnp.asarray, (0.0, 0.0, np.deg2rad(5.0))))) * Quat.of(quat_from_dcm(exact.C_nb[0]))
        row = Fine(filter=filter_).refine(epochs, off, every=made.epochs)
        error = attitude_error(row.q_nb.array[-1], quat_from_dcm(exact.C_nb[-1]))[2]
        return jnp.rad2deg(error), jnp.rad2deg(jnp.sqrt(row.covariance[-1, 8, 8]))

    found = {}
    for form in ("standing", "published"):
        filter_ = with_parameters(ErrorFilter(), {**wide, "form": form})
        found[form] = tuple(np.asarray(x) for x in jax.jit(jax.vmap(run, (0, None)))(keys(runs), filter_))
    error, sd = found["published"]
    assert error.mean() < -2.5  # of -5
    assert np.sqrt(np.mean(error**2)) > 1.4 * sd.mean()
    error, sd = found["standing"]
    assert abs(error.mean()) < 2.5
    assert np.sqrt(np.mean(error**2)) < 1.3 * sd.mean()


def test_band_and_squares_against_closed_forms():
    low, high = chi_square_band(3, 100)
    assert low < 3 < high
    np.testing.assert_allclose([low, high], [2.54, 3.50], atol=0.01)  # Bar-Shalom: 3 +- 1.96 sqrt(2 * 3 / 100)
    rng = np.random.default_rng(1)
    root = rng.normal(size=(4, 4)) * np.array([1e-7, 1.0, 1e3, 1e-4])[:, None]
    x = root @ rng.normal(size=(4, 200000))
    mean = float(nees(x.T, np.broadcast_to(root @ root.T, (200000, 4, 4))).mean())
    assert mean == pytest.approx(4.0, abs=5 * np.sqrt(8 / 200000))
    with pytest.raises(UserError, match="probability"):
        chi_square_band(3, 100, 1.5)
