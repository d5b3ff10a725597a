"""Fine alignment: frozen cases, closure, consistency over matched runs, online = offline, derivatives, bad input."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from frozen import case, gravity_of_the_cases, parameters_of

from jaxalign import (
    ErrorFilter,
    Fine,
    Quat,
    Site,
    Status,
    UserError,
    Vec3,
    align,
    epochs_from_arrays,
    estimate_aid_sd,
    parameters,
    with_parameters,
)
from jaxalign.earth import normal_gravity
from jaxalign.fine import ACCEL, GYRO, PSI, chi_square_band, nees, nis
from jaxalign.methods import build
from jaxalign.metrics import attitude_error_deg
from jaxalign.prefilter import Vondrak
from jaxalign.rotation import attitude_error, quat_from_dcm
from jaxalign.simulate import imu_increments, scenario, simulate, truth
from jaxalign.units import DEG_H, UG

SECONDS = 60.0  # of the frozen cases, and of all records here that need no other length: they share programs


@eqx.filter_jit
def refine(method, epochs, start, every=1):
    """One program for all tests of a form of the filter."""
    return method.refine(epochs, start, every=every)


def slow(name):
    return pytest.param(name, marks=pytest.mark.slow)


CASES = ("disturbed_align_c2_10mg", "disturbed_align_real_60s")


def filter_of(parameters) -> ErrorFilter:
    """The frozen parameters, in the units of people."""

    def root(key, i):
        return float(np.sqrt(parameters[key][i]))

    assert parameters["P0diag"][6] == parameters["P0diag"][7]
    return ErrorFilter(
        velocity_sd=root("R", 0),
        initial_position_sd=root("P0diag", 0),
        initial_velocity_sd=root("P0diag", 3),
        initial_tilt_sd_deg=np.rad2deg(root("P0diag", 6)),
        initial_heading_sd_deg=np.rad2deg(root("P0diag", 8)),
        accel_bias_ug=root("P0diag", 9) / UG,
        gyro_bias_deg_h=root("P0diag", 12) / DEG_H,
        accel_noise_ug_sqrt_hz=root("qd", 3) / UG,
        gyro_walk_deg_sqrt_h=np.rad2deg(root("qd", 6)) * 60,
        form="published",
    )


def epochs_of(arrays, log, filtered, every=None):
    site = Site(log.lat, log.lon, log.h, gravity_of_the_cases(log.lat, log.h) - float(normal_gravity(log.lat, log.h)))
    return epochs_from_arrays(
        log.dtheta,
        log.dvel,
        None,
        dt=log.dt,
        every=every or log.aid_every,
        site=site,
        aid="static",
        prefilter=Vondrak(frame="body") if filtered else None,
    )


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("force", [slow("none"), "vondrak"])
def test_frozen(shared, name, force):
    """From the same start. The columns of the frozen biases are accelerometer then gyro (the README says otherwise)."""
    arrays, log = case(shared, name)
    parameters = parameters_of(arrays, f"fine_{force}")
    assert parameters["state"].startswith("dr dv psi ba bg")
    start = Quat.of(quat_from_dcm(arrays[f"est_fine_{force}"][0]))
    method = Fine(filter=filter_of(parameters))
    rows = refine(method, epochs_of(arrays, log, force == "vondrak"), start)
    expected = quat_from_dcm(arrays[f"est_fine_{force}"])
    assert np.abs(np.rad2deg(attitude_error(rows.q_nb.array, expected))).max() < 1e-3
    biases = np.concatenate([rows.accel_bias.array, rows.gyro_bias.array], axis=1)[1:]
    prior = np.sqrt(np.asarray(parameters["P0diag"])[9:])
    assert (np.abs(biases - arrays[f"bias_fine_{force}"]) / prior).max() < 1e-3
    variances = np.diagonal(rows.covariance, axis1=1, axis2=2)[1:]
    np.testing.assert_allclose(variances, arrays[f"Pdiag_fine_{force}"], rtol=1e-3)
    np.testing.assert_allclose(rows.innovation[1:], arrays[f"innov_fine_{force}"], atol=2e-5)


@pytest.mark.parametrize("name", CASES)
def test_frozen_filtered_force(shared, name):
    arrays, log = case(shared, name)
    found = jax.jit(Vondrak().__call__, static_argnums=1)(jnp.asarray(log.dvel), log.dt)[::50] / log.dt
    np.testing.assert_allclose(found, arrays["f_vondrak_0p5_every50"], atol=1e-10)


# Without a filter: tests/vectors/test_cases.py.
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("force", [slow("none"), "vondrak"])
@pytest.mark.parametrize("coarse", ["triad", slow("ifba"), slow("ifbahann")])
def test_frozen_coarse(shared, name, force, coarse):
    """At the last epoch. Theirs work on samples; on epochs of 0.1 s vibration leaks through the stepped Hann window."""
    arrays, log = case(shared, name)
    method = {
        "triad": build("triad"),
        "ifba": build("dual_vector", parameters={"vectors": "boxcar"}),
        "ifbahann": build("dual_vector"),
    }[coarse]
    epochs = epochs_of(arrays, log, force == "vondrak", 1 if coarse == "ifbahann" else log.aid_every)
    found = method.solve(epochs, len(epochs) - 1)
    expected = quat_from_dcm(arrays[f"est_{coarse}_{force}"][-1])
    error = np.abs(np.rad2deg(attitude_error(found.q_nb[-1], expected)))
    assert error.max() < 1e-3


def test_noise_free_closure():
    """Perfect sensors, 30 deg of heading, a coarse attitude that is off: the filter comes back to the truth."""
    log = simulate("disturbed", seed=0, noise=False, condition=1, duration=SECONDS)
    found = align(build("fine"), log)
    error = attitude_error_deg(found, log)
    assert np.abs(error[1:, :2]).max() < 1e-7
    assert np.abs(error[1:, 2]).max() < 1e-5
    assert np.abs(found.filter.gyro_bias).max() < 1e-6 * DEG_H + 1e-12
    assert np.abs(found.filter.accel_bias).max() < 1e-3 * UG

    epochs = build("fine").epochs(log)
    wrong = Quat.exp(Vec3.of(jnp.deg2rad(jnp.array([0.05, -0.05, 1.0])))) * Quat.of(quat_from_dcm(log.C_nb[0]))
    sure = with_parameters(
        Fine(),
        {"filter.accel_bias_ug": 1e-3, "filter.gyro_bias_deg_h": 1e-6, "filter.gyro_walk_deg_sqrt_h": 1e-6}
        | {"filter.accel_noise_ug_sqrt_hz": 1e-3, "filter.velocity_sd": 1e-5, "filter.initial_velocity_sd": 1e-6},
    )
    back = refine(sure, epochs, wrong)
    left = np.rad2deg(attitude_error(back.q_nb.array[-1], quat_from_dcm(log.C_nb[-1])))
    assert np.abs(left[:2]).max() < 1e-4
    assert abs(left[2]) < 1e-3  # what is second order in one degree


def matched_problem(duration: float, rate: int):
    """A filter, a scenario with sensors of its numbers, and a base that moves as its zero velocity says."""
    filter_ = with_parameters(
        ErrorFilter(), {"initial_tilt_sd_deg": 0.05, "initial_heading_sd_deg": 1.0, "accel_noise_ug_sqrt_hz": 20.0}
    )
    made = scenario("disturbed", condition=1, duration=duration, noise_per="density", bias="gaussian")
    accel = eqx.tree_at(lambda e: (e.bias, e.density), made.accel, (jnp.full(3, 50 * UG), jnp.asarray(20 * UG)))
    return filter_, dataclasses.replace(made, accel=accel, aid_every=rate)


def measured(made, exact, key, rate, base_sd=0.0):
    """Epochs of one run and the drawn biases; the base's velocity is white from epoch to epoch."""
    imu, other = jax.random.split(key)
    dtheta, dvel = imu_increments(exact, made, imu)
    base = base_sd * jax.random.normal(jax.random.fold_in(other, 9), (made.epochs + 1, 3))
    in_b = jnp.diff(base, axis=0) @ exact.C_nb[0]
    dvel = dvel + jnp.repeat(in_b / rate, rate, axis=0)
    keys = [jax.random.fold_in(imu, i) for i in (0, 1)]  # of gyroscopes and accelerometers
    biases = [e.draw_bias(jax.random.split(k)[0]) for e, k in zip((made.gyro, made.accel), keys, strict=True)]
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
        epochs = eqx.tree_at(lambda e: e.rows.velocity, epochs, Vec3.of(noise))
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
    epochs = eqx.tree_at(lambda e: e.aid_sd, epochs, jnp.full(runs, sd))
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
    wide = {"initial_heading_sd_deg": 30.0, "accel_noise_ug_sqrt_hz": 20.0}

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


def short(duration=SECONDS):
    return simulate("disturbed", seed=2, condition=2, amplitude_mg=10.0, duration=duration)


@pytest.mark.slow
def test_online_equals_offline():
    log = short()
    method = build("fine")
    epochs = method.epochs(log)
    start = Quat.of(quat_from_dcm(log.C_nb[0]))
    whole = refine(method, epochs, start)
    state, step = method.filter.init(epochs.site, start), eqx.filter_jit(method.filter.step)
    rows = jax.tree.map(np.asarray, epochs.rows)
    for k in range(30):
        state, row = step(state, jax.tree.map(lambda x, k=k: x[k], rows))
        np.testing.assert_allclose(row.q_nb.array, whole.q_nb.array[k], atol=1e-13)
        np.testing.assert_allclose(row.covariance, whole.covariance[k], rtol=1e-9, atol=1e-20)


@pytest.mark.slow
def test_an_epoch_without_measurement_is_bridged():
    log = short()
    method = build("fine")
    epochs = method.epochs(log)
    gone = eqx.tree_at(lambda e: e.rows.valid, epochs, epochs.rows.valid.at[50:80].set(False))
    rows = refine(method, gone, Quat.of(quat_from_dcm(log.C_nb[0])))
    updated = np.asarray(rows.updated)
    assert not updated[0]
    assert not updated[50:80].any()
    assert updated[80:].all()
    assert (np.asarray(rows.innovation)[50:80] == 0).all()
    sd = np.sqrt(np.diagonal(rows.covariance, axis1=1, axis2=2))
    assert sd[79, 3] > sd[49, 3] * 1.2
    assert sd[120, 3] < sd[79, 3]
    assert np.isfinite(rows.covariance).all()
    solution = method.solve(gone)
    missing = (np.asarray(solution.status) & Status.AID_MISSING) != 0
    np.testing.assert_array_equal(np.flatnonzero(missing), np.arange(50, 80))
    assert (np.asarray(solution.weight)[50:80] == 0).all()


@pytest.mark.slow
def test_sparse_rows_are_those_of_all():
    log = short()
    method = build("fine")
    epochs, start = method.epochs(log), Quat.of(quat_from_dcm(log.C_nb[0]))
    whole, sparse = (refine(method, epochs, start, every) for every in (1, 7))
    rows = [*range(0, 601, 7), 600]
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(sparse), strict=True):
        np.testing.assert_allclose(np.asarray(a)[rows], b, rtol=1e-9, atol=1e-15)


@pytest.mark.slow
def test_zero_position_holds_the_position():
    """The slow swing of a velocity that is only known to be zero on average goes; the attitude agrees."""
    log = simulate("disturbed", seed=4, condition=2, amplitude_mg=10.0, duration=120.0)
    found = {name: align(build("fine", parameters={"filter.updates": name}), log) for name in ("velocity", "position")}
    assert found["position"].filter.innovation.shape[1] == 6
    difference = np.rad2deg(attitude_error(found["position"].q_nb[-1], found["velocity"].q_nb[-1]))
    assert np.abs(difference[:2]).max() < 0.002
    assert abs(difference[2]) < 0.15
    assert found["position"].sd[-1, 2] <= found["velocity"].sd[-1, 2]
    state = np.sqrt(np.diagonal(found["position"].filter.covariance[-1]))
    assert (state[:3] < 0.005).all()
    assert np.abs(found["position"].filter.innovation[100:, 3:]).max() < 0.01


@pytest.mark.slow
def test_gradients():
    """Forward = reverse = differences: velocity noise, bias prior and the cut-off of the filter in front."""
    log = short(20.0)
    reference = quat_from_dcm(log.C_nb[-1])
    fixed = {"dt": log.dt, "every": 200, "site": Site(log.lat, log.lon, log.h), "aid": "static"}

    def loss(s):
        method = with_parameters(
            build("fine", prefilter="vondrak"),
            {
                "filter.velocity_sd": 0.01 * jnp.exp(s[0]),
                "filter.gyro_bias_deg_h": 0.1 * jnp.exp(s[1]),
                "prefilter.cutoff": 0.5 * jnp.exp(s[2]),
            },
        )
        epochs = epochs_from_arrays(log.dtheta, log.dvel, None, prefilter=method.prefilter, **fixed)
        found = method.solve(epochs, 1)
        error = attitude_error(found.q_nb[-1], reference)
        return jnp.rad2deg(error[2]) + 0.1 * jnp.log(found.filter.covariance[-1, 8, 8])

    at = jnp.zeros(3)
    value = jax.jit(loss)
    forward, reverse = jax.jit(jax.jacfwd(loss))(at), jax.jit(jax.grad(loss))(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-7)
    for h in (1e-3, 1e-4):
        numeric = [(value(at.at[i].add(h)) - value(at.at[i].add(-h))) / (2 * h) for i in range(3)]
        np.testing.assert_allclose(forward, numeric, rtol=2e-5, atol=1e-7)
    assert (np.abs(forward) > 1e-4).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Fine(coarse=build("oba", "body")), "standing vehicle"),
        (lambda: build("fine", parameters={"coarse.interval_samples": 5}), "no parameter 'coarse.interval_samples'"),
        (lambda: Fine(coarse=build("dual_vector", parameters={"interval_samples": 5})), "takes the epochs of the fine"),
        (lambda: build("fine", parameters={"filter.form": "none"}), "form"),
        (lambda: build("fine", prefilter=Vondrak), "must be one of vondrak"),
        (lambda: build("fine", parameters={"prefilter.cutoff": 1}), "there is no prefilter to set"),
        (lambda: align(build("fine", prefilter="fir"), build("fine").epochs(short())), "not filtered"),
        (lambda: Fine(coarse=build("dual_vector", prefilter="fir")), "takes the epochs of the fine"),
        (lambda: build("fine", parameters={"filter.updates": "speed"}), "updates"),
        (lambda: build("fine", parameters={"filter.velocity_sd": 0}), "outside its bounds"),
    ],
)
def test_refused(make, words):
    with pytest.raises(UserError, match=words):
        make()


@pytest.mark.slow
def test_any_coarse_method_starts_it():
    assert not [path for path in parameters(build("fine")) if path.startswith("coarse.interval")]
    log = simulate("disturbed", seed=4, condition=2, duration=60.0)
    ends = [
        align(Fine(coarse=build(name)), log, every=600).euler_deg[-1] for name in ("dual_vector", "gravity_q", "triad")
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=5e-3)
    np.testing.assert_allclose(ends[0], ends[2], atol=5e-3)
