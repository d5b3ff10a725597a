"""The robust batch estimator: closure, frozen results, noise, unknowns of the aid, gradients, real logs."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from frozen import case
from frozen import epochs as frozen_epochs
from logs import with_noise, with_velocity
from statistical import phi_deg

from jaxalign import Measurements, Quat, Vec3, align, epochs_from_log, parameters, read, rotation, with_parameters
from jaxalign.batch import Auto, RobustMap
from jaxalign.batch.modes import best_of
from jaxalign.bounds import bound
from jaxalign.errors import UserError
from jaxalign.fine import chi_square_band
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors, imu_errors
from jaxalign.metrics import attitude_error_deg
from jaxalign.simulate import intervals_of, measure_epochs, scenario, simulate, truth

measured = eqx.filter_jit(measure_epochs)


@pytest.mark.parametrize(
    ("name", "aid", "most"),
    [
        ("dvl-sturn", "body", 2e-4),
        pytest.param("dvl-sway", "body", 2e-4, marks=pytest.mark.slow),
        pytest.param("gps-zigzag", "nav", 5e-5, marks=pytest.mark.slow),
        pytest.param("sway", "static", 1e-5, marks=pytest.mark.slow),
    ],
)
def test_noise_free_closure(name, aid, most):
    """What is left is the trapezoid of the velocity over an epoch, in Coriolis' term and the transport rate."""
    log = simulate(scenario(name), 0, noise=False)
    perfect = ImuErrors(GyroErrors(1e-4, 1e-4), AccelErrors(1e-1, 1e-1))
    # The rows of test_frozen_map: the same program.
    every = 50 if aid == "body" else log.epochs
    found = align(RobustMap(imu=perfect, aids=aid, aid_noise="stated"), log, every=every, aid_sd=0.01)
    assert np.abs(attitude_error_deg(found, log)[-1]).max() < most


@pytest.mark.parametrize(
    "name", ["dvl_sturn_clean", "dvl_sturn_fixed", pytest.param("dvl_accturn_clean", marks=pytest.mark.slow)]
)
def test_frozen_map(shared, name):
    """Another redescending loss, random-walk blocks instead of white noise: another estimate, near theirs."""
    arrays, log = case(shared, name)
    made = scenario("dvl-accturn" if "acc" in name else "dvl-sturn")
    method = RobustMap(imu=made.imu, aid_noise="stated")
    rows = np.flatnonzero(np.isfinite(arrays["est_MAP"][:, 0, 0]))
    every = int(np.gcd.reduce(rows))
    found = align(method, frozen_epochs(log, "lookback", method), every=every, aid_sd=float(made.aids[0].sd))
    ours = found.C_nb[rows // every]
    turn = np.einsum("kij,klj->kil", ours, arrays["est_MAP"][rows])
    phi = np.rad2deg(np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1))
    ratio = np.abs(phi) / arrays["crlb_deg"][rows]
    assert ratio[:, 2].max() < 0.3, ratio
    assert ratio[:, :2].max() < 0.4, ratio


def test_frozen_gps(shared):
    """Theirs with weights neglects the transport rate: what that costs is between two of their others."""
    arrays, log = case(shared, "gps_noise_base")
    method = RobustMap(imu=scenario("gps-zigzag").imu, aids="nav", aid_noise="stated")
    found = align(method, frozen_epochs(log, "pairs", method), every=len(log.aids[0].value) - 1, aid_sd=1.0)

    def heading(name):
        return np.rad2deg((found.C_nb[-1] @ arrays[f"est_{name}"][-1].T)[1, 0])

    neglected = heading("wahba_centred") - heading("wahba_centred_full")
    assert abs(heading("wahba_centred_irls") - neglected) < 0.3 * 0.743
    assert abs(heading("wahba_centred_full")) < 0.02 * 0.743


@pytest.mark.slow
def test_calibration_of_the_doppler_log():
    """Scale and misalignment among the unknowns: the heading is that of a perfect log again."""
    made = scenario("dvl-accturn")
    log = simulate(made, seed=5)
    turn = Quat.exp(Vec3(*jnp.array([0.0, 0.0, np.deg2rad(1.5)]))).conjugate()
    spoiled = with_velocity(log, np.asarray(1.006 * turn.rotate(Vec3.of(log.aids[0].value)).array))
    imu = made.imu
    plain, calibrating = (RobustMap(imu=imu, calibrate=x, aid_noise="stated") for x in ((), ("scale", "mounting")))
    wrong, mended = (attitude_error_deg(align(m, spoiled, every=log.epochs), log)[-1, 2] for m in (plain, calibrating))
    assert abs(wrong) > 0.5
    assert abs(mended) < 0.2


@pytest.mark.slow
def test_biases_that_wander():
    """Walked at the rate of the samples, axes of their own: as wide as the bound, and honest; constant is neither."""
    runs, made = 60, scenario("dvl-sturn", bias="gaussian")
    constant = ImuErrors(GyroErrors(0.02, [0.005, 0.01, 0.02]), AccelErrors(50.0, [50.0, 100.0, 20.0]))
    walks = {"gyro.bias_walk_deg_h_sqrt_h": [5.0, 5.0, 20.0], "accel.bias_walk_ug_sqrt_h": 600.0}
    made = dataclasses.replace(made, imu=with_parameters(constant, walks))
    exact = truth(made)
    epochs = measured(intervals_of(exact, made.epoch_samples), made, jax.random.split(jax.random.key(9), runs))
    squares, last = {}, np.array([made.epochs])
    for unit in (made.imu, constant):
        found = eqx.filter_jit(lambda m: m.solve_runs(epochs, last))(RobustMap(imu=unit, aid_noise="stated"))
        phi = np.deg2rad(phi_deg(found.q_nb, exact.C_nb[-1:]))[:, 0]
        squares[unit is constant] = np.einsum("ri,rij,rj->r", phi, np.linalg.inv(found.covariance[:, -1]), phi)
        if unit is not constant:
            np.testing.assert_allclose(
                np.rad2deg(np.median(found.sd[:, -1], axis=0)), bound(made).phi_deg[-1], rtol=0.02
            )
    low, high = chi_square_band(3, runs, 0.99)
    assert low < squares[False].mean() < high
    assert squares[True].mean() > 10 * high


@pytest.mark.slow
def test_one_number_is_three_equal_ones():
    """On the host, where they are two programs."""
    epochs = epochs_from_log(simulate("dvl-sturn", seed=2, outliers="fixed", duration=60.0))
    one = imu_errors("tactical")
    three = with_parameters(one, {"gyro.walk_deg_sqrt_h": [0.1] * 3, "accel.bias_ug": [1000.0] * 3})
    found, other = (RobustMap(imu=unit).solve(epochs, 20) for unit in (one, three))
    np.testing.assert_allclose(found.q_nb, other.q_nb, atol=1e-9)
    np.testing.assert_allclose(found.sd, other.sd, rtol=1e-6)


def spoilt(log, exact, late=0.0, lever=(0.0, 0.0, 0.0)):
    """The log of an aid that is late (s), and not where the inertial unit is (m, b)."""
    v, c = np.asarray(exact.velocity_n), np.asarray(exact.C_nb)
    interval = log.epoch_samples * log.dt
    turned = np.einsum("kij,kjl->kil", np.swapaxes(c[:-1], 1, 2), c[1:])
    rate = np.asarray(Quat.of(rotation.quat_from_dcm(turned)).log().array) / interval
    rate = 0.5 * (np.vstack([rate[:1], rate]) + np.vstack([rate, rate[-1:]]))
    moved = np.cross(rate, np.asarray(lever))
    if log.aids[0].name == "body":
        v = np.einsum("kji,kj->ki", c, v)
    else:
        moved = np.einsum("kij,kj->ki", c, moved)
    before = np.vstack([v[:1], v[:-1]])
    return with_velocity(log, log.aids[0].value - late / interval * (v - before) + moved)


LATE, LEVER = 0.3, (0.5, -1.5, 1.0)


@pytest.mark.parametrize(
    ("name", "unknown"),
    [
        pytest.param("gps-zigzag", ("latency", "lever"), marks=pytest.mark.slow),
        pytest.param("dvl-accturn", ("latency",), marks=pytest.mark.slow),
        pytest.param("dvl-sway", ("lever",), marks=pytest.mark.slow),
    ],
)
def test_latency_and_lever_arm_are_found(name, unknown):
    """Velocities of 0.3 s ago, or of elsewhere, with a noise of 0.05 m/s: that is found, and the attitude is right."""
    late, lever = ("latency" in unknown) * LATE, np.array(LEVER) * ("lever" in unknown)
    made = with_noise(scenario(name), 0.05)
    log, exact = simulate(made, seed=2), truth(made)
    log = spoilt(log, exact, late, lever)
    imu = made.imu
    plain, found = (
        align(
            with_parameters(
                RobustMap(imu=imu, aids=log.aids[0].aid, calibrate=x, aid_noise=noise),
                {f"priors.{log.aids[0].name}.latency": 0.5},
            ),
            log,
            every=log.epochs,
        )
        for x, noise in (((), "stated"), (unknown, "at_least"))
    )
    assert plain.filter.calibration is None
    wanted = np.concatenate([[late] * ("latency" in unknown), lever if "lever" in unknown else []])
    sd = np.sqrt(np.diagonal(found.filter.covariance[-1])[12:])
    print(name, np.round(found.filter.calibration[-1], 3), np.round(sd, 3))
    assert (np.abs(found.filter.calibration[-1] - wanted) < np.maximum(4 * sd, 0.05)).all()
    seen = sd < 0.5  # a turn about one axis says nothing of the arm along it
    assert seen.sum() >= len(wanted) - ("lever" in unknown)
    assert (np.abs(attitude_error_deg(found, log)[-1]) < 3.5 * np.rad2deg(found.sd[-1])).all()
    np.testing.assert_allclose(found.aid_sd[-1], 0.05, rtol=0.2)
    assert found.filter.log_likelihood[-1] > plain.filter.log_likelihood[-1] + 5


@pytest.mark.slow
def test_a_heading_that_nothing_tells_stays_open():
    """A low-cost unit at rest with GNSS: the path wanders off with its noise, and that is no acceleration."""
    made = dataclasses.replace(
        scenario("sway", duration=120.0), imu=ImuErrors(GyroErrors(100.0, 0.3), AccelErrors(2000.0, 200.0))
    )
    log = simulate(made, seed=4).with_epochs(100)
    velocity = 0.05 * np.random.default_rng(1).normal(size=(log.epochs + 1, 3))
    log = log.with_aid(Measurements("nav", np.arange(log.epochs + 1) * log.interval, velocity, 0.05))
    found = align(RobustMap(imu=imu_errors("mems"), aids="nav", headings=4), log, every=60)
    assert (np.rad2deg(found.sd[1:, 2]) > 60).all()
    assert not found.observable[-1]
    assert (np.abs(attitude_error_deg(found, log)[-1, :2]) < 4 * np.rad2deg(found.sd[-1, :2])).all()


def test_modes_count_by_their_likelihood():
    """Two headings 2 rad apart, one of them found twice, and one that fits by far less."""
    half = np.array([0.0, 2.0, 2.001, -1.0]) / 2
    q = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    tilt = np.broadcast_to(np.diag([1e-4, 1e-4, 0.01]), (4, 3, 3))
    chosen = jax.jit(best_of)
    best, covariance = chosen(q, tilt, np.array([-1.0, 0.0, -1e-3, -50.0]))
    assert best == 1
    share = np.exp(-1.0) / (1 + np.exp(-1.0))
    np.testing.assert_allclose(covariance, np.diag([1e-4, 1e-4, 0.01 + share * 4.0]), rtol=1e-6, atol=1e-12)
    best, covariance = chosen(q, tilt, np.array([-np.inf, np.nan, 0.0, -50.0]))
    assert best == 2
    np.testing.assert_allclose(covariance, tilt[0], atol=1e-12)


@pytest.mark.slow
@pytest.mark.long
def test_gradients_are_finite_and_right():
    method = RobustMap(tolerance=1e-9, iterations=60)
    epochs = epochs_from_log(simulate("dvl-sturn", seed=2, outliers="fixed", duration=100.0))
    paths = ["imu.gyro.bias_deg_h", "imu.gyro.walk_deg_sqrt_h", "outlier_probability", "outlier_ratio"]
    at = jnp.array([float(parameters(method)[p]) for p in paths])

    @jax.jit
    @jax.value_and_grad
    def loss(relative):
        changed = with_parameters(method, dict(zip(paths, at * jnp.exp(relative), strict=True)))
        found = changed.solve(epochs, 100)
        return 1e3 * found.q_nb[-1, 3] + 1e3 * found.sd[-1, 2]

    zero = jnp.zeros(4)
    value, slope = loss(zero)
    assert np.isfinite(slope).all()
    for i in range(4):
        for h in (1e-2, 3e-3):
            numeric = (loss(zero.at[i].set(h))[0] - loss(zero.at[i].set(-h))[0]) / (2 * h)
            assert abs(numeric - slope[i]) <= 1e-3 * max(abs(slope[i]), 1e-3 * abs(value))


@pytest.mark.slow
def test_derivatives_with_biases_that_are_known():
    """What cannot change has no unit to measure its changes by."""
    imu = with_parameters(imu_errors("navigation"), {"gyro.bias_deg_h": 0.0, "accel.bias_ug": 0.0})
    method = RobustMap(imu=imu, tolerance=1e-9, iterations=60)
    epochs = epochs_from_log(simulate("dvl-sturn", seed=2, outliers="fixed", duration=60.0))

    def values(x):
        changed = with_parameters(
            method, {"outlier_probability": 0.02 * jnp.exp(x[0]), "outlier_ratio": 30.0 * jnp.exp(x[1])}
        )
        found = changed.solve(eqx.tree_at(lambda e: e.site.lat, epochs, epochs.site.lat + x[2]), 60)
        return jnp.array([found.q_nb[-1, 3], found.sd[-1, 2]])

    zero = jnp.zeros(3)
    forward, reverse = (np.asarray(jax.jit(mode(values))(zero)) for mode in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, rtol=1e-6, atol=1e-8 * np.abs(reverse).max())
    call = jax.jit(values)
    numeric = (call(zero.at[2].set(1e-3)) - call(zero.at[2].set(-1e-3))) / 2e-3
    np.testing.assert_allclose(reverse[:, 2], numeric, rtol=1e-3)


@pytest.mark.slow
def test_a_broken_run_leaves_the_derivatives_of_others():
    epochs = epochs_from_log(simulate("dvl-sturn", seed=2, outliers="fixed", duration=60.0))
    each = (epochs.rows.rotation, epochs.rows.dvel, epochs.rows.fixes[0].value)
    each = jax.tree.map(lambda x: jnp.stack([x, x], axis=-1), each)
    rows = eqx.tree_at(lambda r: (r.rotation, r.dvel, r.fixes[0].value), epochs.rows, each)
    rows = eqx.tree_at(lambda r: r.dvel.x, rows, rows.dvel.x.at[30, 1].set(jnp.nan))

    @jax.jit
    @jax.value_and_grad
    def loss(velocity):
        made = eqx.tree_at(lambda e: e.rows, epochs, eqx.tree_at(lambda r: r.fixes[0].value[0], rows, velocity))
        found = RobustMap().solve_runs(made, 60)
        return jnp.sum(jnp.where(found.defined[:, -1], found.q_nb[:, -1, 3], 0.0))

    value, slope = loss(rows.velocity.x)
    assert np.isfinite(value)
    assert np.isfinite(slope[:, 0]).all()
    assert np.abs(slope[:, 0]).max() > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("method", [RobustMap(), Auto()], ids=["robust_map", "auto"])
def test_a_constant_inside_traced_code(method):
    epochs = epochs_from_log(simulate("dvl-sturn", seed=2, duration=60.0))
    last = np.array([60])
    found = method.solve(epochs, last)
    np.testing.assert_array_equal(jax.jit(lambda x: x * method.solve(epochs, last).q_nb)(1.0), found.q_nb)
    kept = method.solve(jax.device_put(epochs, jax.devices()[0]), last)
    assert kept.q_nb.committed
    assert not found.q_nb.committed


def test_bad_input():
    method, epochs = RobustMap(), epochs_from_log(simulate("dvl-sturn", seed=2, duration=60.0))
    for rows in (0, -1, 2.5, None, float("nan"), np.array([[10]]), np.array([61])):
        with pytest.raises(UserError, match=r"every|rows"):
            method.solve(epochs, rows)
    with pytest.raises(UserError, match="one log"):
        method.solve_runs(epochs, 10)
    with pytest.raises(UserError, match="no aid 'dvl'"):
        RobustMap(aids="dvl")
    with jax.enable_x64(False), pytest.raises(UserError, match="float32"):
        method.solve(epochs, 10)


def test_grades():
    assert parameters(RobustMap(imu=imu_errors("mems")))["imu.gyro.bias_deg_h"] == 200.0
    with pytest.raises(UserError, match="did you mean tactical"):
        imu_errors("tactica")
    with pytest.raises(UserError, match="at_least"):
        with_parameters(RobustMap(), {"aid_noise": "guess"})
    with pytest.raises(UserError, match="no parameter"):
        with_parameters(RobustMap(), {"aid": "nav"})


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.02])
def test_auv_at_sea(shared, share):
    """Six real logs: RMS of the heading error at 200 s and at the end; and the deviations stated hold."""
    imu = ImuErrors(GyroErrors(0.1, 0.015), AccelErrors(200.0, 50.0))
    rng = np.random.default_rng(3)
    found, stated = [], []
    for number in ("02", "03", "05", "10", "12", "13"):
        log = read(shared / "data" / "real_akit" / f"real_akit_{number}.npz")
        velocity = np.array(log.aids[0].value)
        hit = rng.random(len(velocity)) < share
        hit[0] = False
        velocity[hit] += rng.normal(size=(hit.sum(), 3))
        log = with_velocity(log, velocity)
        solution = align(RobustMap(imu=imu), log, every=200, aid_sd=0.02)
        found.append(attitude_error_deg(solution, log)[[1, -1]])
        stated.append(np.rad2deg(np.asarray(solution.sd))[[1, -1]])
    rms = np.sqrt(np.square(found).mean(axis=0))
    assert rms[0, 2] < 0.25
    assert rms[1, 2] < 0.20
    assert np.sqrt(np.square(np.divide(found, stated)).mean(axis=0)).max() < 1.3
