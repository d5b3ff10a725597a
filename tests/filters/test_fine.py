"""Fine alignment: frozen cases, closure, consistency over matched runs, online = offline, derivatives, bad input."""

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
    parameters,
    with_parameters,
)
from jaxalign.earth import normal_gravity
from jaxalign.fine import ACCEL, GYRO, PSI
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors
from jaxalign.methods import build
from jaxalign.metrics import attitude_error_deg
from jaxalign.prefilter import Vondrak
from jaxalign.rotation import attitude_error, quat_from_dcm
from jaxalign.simulate import simulate
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
        imu=ImuErrors(
            GyroErrors(root("P0diag", 12) / DEG_H, np.rad2deg(root("qd", 6)) * 60),
            AccelErrors(root("P0diag", 9) / UG, root("qd", 3) / UG),
        ),
        form="published",
    )


def epochs_of(arrays, log, filtered, every=None):
    site = Site(log.lat, log.lon, log.h, gravity_of_the_cases(log.lat, log.h) - float(normal_gravity(log.lat, log.h)))
    return epochs_from_arrays(
        log.dtheta,
        log.dvel,
        None,
        dt=log.dt,
        every=every or log.epoch_samples,
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
    epochs = epochs_of(arrays, log, force == "vondrak", 1 if coarse == "ifbahann" else log.epoch_samples)
    found = method.solve(epochs, len(epochs) - 1)
    expected = quat_from_dcm(arrays[f"est_{coarse}_{force}"][-1])
    error = np.abs(np.rad2deg(attitude_error(found.q_nb[-1], expected)))
    assert error.max() < 1e-3


def test_figures_of_the_axes():
    """White noise of the axes acts in n, turned by the attitude; of one number it is the same for every attitude."""
    turn = np.asarray(Quat.exp(Vec3(*map(jnp.asarray, (0.3, -0.2, 1.0)))).matrix.array)
    walks = {"gyro.bias_walk_deg_h_sqrt_h": 6.0, "accel.bias_walk_ug_sqrt_h": [60.0, 30.0, 0.0]}
    one = with_parameters(ErrorFilter().imu, walks)
    three = with_parameters(one, {"gyro.walk_deg_sqrt_h": [0.1, 0.2, 0.6], "gyro.bias_deg_h": [1.0, 2.0, 3.0]})
    one, three = ErrorFilter(imu=one), ErrorFilter(imu=three)
    q, same = three.process_noise(turn), one.process_noise(turn)
    walk = np.deg2rad([0.1, 0.2, 0.6]) / 60
    np.testing.assert_allclose(q[PSI, PSI], turn @ np.diag(walk**2) @ turn.T, rtol=1e-12)
    np.testing.assert_allclose(same[PSI, PSI], np.eye(3) * (np.deg2rad(0.05 / 60) / 60) ** 2, rtol=1e-12)
    np.testing.assert_allclose(np.diag(q)[GYRO], (6.0 * DEG_H / 60) ** 2, rtol=1e-12)
    np.testing.assert_allclose(np.diag(q)[ACCEL], (np.array([60.0, 30.0, 0.0]) * UG / 60) ** 2, rtol=1e-12)
    np.testing.assert_allclose(np.diag(three.initial_covariance)[GYRO], (np.array([1, 2, 3]) * DEG_H) ** 2, rtol=1e-12)
    assert np.count_nonzero(np.asarray(same) - np.diag(np.diag(same))) == 0


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
        {"filter.imu.accel.bias_ug": 1e-3, "filter.imu.gyro.bias_deg_h": 1e-6, "filter.imu.gyro.walk_deg_sqrt_h": 1e-6}
        | {"filter.imu.accel.density_ug_sqrt_hz": 1e-3, "filter.velocity_sd": 1e-5, "filter.initial_velocity_sd": 1e-6},
    )
    back = refine(sure, epochs, wrong)
    left = np.rad2deg(attitude_error(back.q_nb.array[-1], quat_from_dcm(log.C_nb[-1])))
    assert np.abs(left[:2]).max() < 1e-4
    assert abs(left[2]) < 1e-3  # what is second order in one degree


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
    gone = eqx.tree_at(lambda e: e.rows.fixes[0].valid, epochs, epochs.rows.valid.at[50:80].set(False))
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
                "filter.imu.gyro.bias_deg_h": 0.1 * jnp.exp(s[1]),
                "front_end.prefilter.cutoff": 0.5 * jnp.exp(s[2]),
            },
        )
        epochs = epochs_from_arrays(log.dtheta, log.dvel, None, prefilter=method.front_end.prefilter, **fixed)
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
        (
            lambda: build("fine", parameters={"coarse.front_end.interval_samples": 5}),
            "no parameter 'coarse.front_end.interval_samples'",
        ),
        (lambda: Fine(coarse=build("dual_vector", interval_samples=5)), "takes the epochs of the fine"),
        (lambda: build("fine", parameters={"filter.form": "none"}), "form"),
        (lambda: build("fine", prefilter=Vondrak), "must be one of vondrak"),
        (lambda: build("fine", parameters={"front_end.prefilter.cutoff": 1}), "there is no prefilter to set"),
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
