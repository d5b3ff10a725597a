"""Trajectories and their exact increments: closure by an independent strapdown loop, and the frozen cases."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

from jaxalign.earth import Site
from jaxalign.errors import UserError
from jaxalign.simulate import (
    Constant,
    Ramps,
    Scenario,
    Sines,
    Steps,
    Trajectory,
    VelocityInBody,
    accelerate_and_turn,
    exact_increments,
    road,
    s_turn,
    scenario,
    specific_force,
    static_base,
    sway_underway,
    swaying_base,
    truth,
    turn_rate,
    zigzag,
)
from jaxalign.simulate.imu import jitted_increments

# WGS-84 in its other defining numbers (a, 1/f, GM, gravity from the closed form of the level ellipsoid).
A, F, WIE = 6378137.0, 1 / 298.257223563, 7.292115e-5
E2 = F * (2 - F)
G_EQUATOR, G_POLE = 9.7803253359, 9.8321849379
GM = 3.986004418e14
RATIO = WIE**2 * A**2 * (A * (1 - F)) / GM


def gravity(lat, h, xp=np):
    a, b = A, A * (1 - F)
    s, c = xp.sin(lat), xp.cos(lat)
    surface = (a * G_EQUATOR * c**2 + b * G_POLE * s**2) / xp.sqrt((a * c) ** 2 + (b * s) ** 2)
    return surface * (1 - 2 / a * (1 + F + RATIO - 2 * F * s**2) * h + 3 * h**2 / a**2)


def radii(lat, xp=np):
    w = xp.sqrt(1 - E2 * xp.sin(lat) ** 2)
    return A * (1 - E2) / w**3, A / w


def skew(v, xp=np):
    return xp.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def pairs(dtheta, dvel):
    """Two-sample coning and sculling: rotation vector and velocity in the frame at the start of each pair."""
    t1, t2, v1, v2 = dtheta[0::2], dtheta[1::2], dvel[0::2], dvel[1::2]
    phi, th, v = t1 + t2 + 2 / 3 * np.cross(t1, t2), t1 + t2, v1 + v2
    angle = np.linalg.norm(th, axis=1, keepdims=True)
    angle = np.maximum(angle, 1e-8)
    once = np.cross(th, v)
    turned = v + (1 - np.cos(angle)) / angle**2 * once
    turned += (angle - np.sin(angle)) / angle**3 * np.cross(th, once)
    return phi, turned + 2 / 3 * (np.cross(t1, v2) + np.cross(v1, t2))


@jax.jit
def strapdown(turns, dvel, step, C, v, lat, lon, h):
    """Plain mechanisation in n at the rate of the pairs (their rotations and velocities in b), from an initial state.

    Returns:
        Attitude, velocity, latitude, longitude and height after each pair.
    """

    def one(carry, pair):
        (C, v, lat, lon, h), previous = carry
        turn, u = pair
        middle_v = 1.5 * v - 0.5 * previous
        for _ in range(3):  # the velocity at the middle, then corrected
            middle_lat = lat + 0.5 * step * middle_v[1] / (radii(lat, jnp)[0] + h)
            middle_h = h + 0.5 * step * middle_v[2]
            rm, rn = radii(middle_lat, jnp)
            rm, rn = rm + middle_h, rn + middle_h
            wie = WIE * jnp.array([0.0, jnp.cos(middle_lat), jnp.sin(middle_lat)])
            wen = jnp.array([-middle_v[1] / rm, middle_v[0] / rn, middle_v[0] * jnp.tan(middle_lat) / rn])
            half = jnp.eye(3) - skew((wie + wen) * step / 2, jnp)
            g = jnp.array([0.0, 0.0, -gravity(middle_lat, middle_h, jnp)])
            new_v = v + half @ (C @ u) + step * (g - skew(2 * wie + wen, jnp) @ middle_v)
            middle_v = 0.5 * (v + new_v)
        sk = skew((wie + wen) * step, jnp)
        C = (jnp.eye(3) - sk + sk @ sk / 2) @ C @ turn
        lat = lat + step * middle_v[1] / rm
        lon = lon + step * middle_v[0] / (rn * jnp.cos(middle_lat))
        state = (C, new_v, lat, lon, h + step * middle_v[2])
        return (state, v), state

    return jax.lax.scan(one, ((C, v, lat, lon, h), v), (turns, dvel))[1]


CLOSURE = {
    "s_turn": (s_turn(), 200.0),
    "accelerate_and_turn": (accelerate_and_turn(), 100.0),
    "sway_underway": (sway_underway(), 200.0),
    "zigzag": (zigzag(), 100.0),
    "zigzag_sway": (zigzag(sway=True), 100.0),
    "road": (road(), 250.0),
}


@functools.cache
def truth_of(name):
    """300 s with an epoch every pair of samples."""
    trajectory, rate = CLOSURE[name]
    made = Scenario(trajectory, Site(0.56, 2.07, 30.0), imu_rate=rate, epoch_samples=2, duration=300.0)
    return jax.tree.map(np.asarray, truth(made))


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=() if x in ("s_turn", "zigzag_sway") else pytest.mark.slow) for x in CLOSURE]
)
def test_increments_close(name):
    """Attitude to 1e-6 deg and velocity to 1e-6 m/s after 300 s of strapdown navigation."""
    t, rate = truth_of(name), CLOSURE[name][1]
    phi, dv = pairs(t.dtheta, t.dvel)
    turns = Rotation.from_rotvec(phi).as_matrix()
    C, v, lat, lon, h = strapdown(turns, dv, 2 / rate, t.C_nb[0], t.velocity_n[0], 0.56, 2.07, 30.0)
    error = Rotation.from_matrix(C @ np.swapaxes(t.C_nb[1:], 1, 2)).magnitude()
    assert np.rad2deg(error).max() < 1e-6
    assert np.abs(v - t.velocity_n[1:]).max() < 1e-6
    assert np.abs(lat - t.lat[1:]).max() < 3e-11  # 0.2 mm: the middle-point rule of the loop
    assert np.abs(lon - t.lon[1:]).max() < 3e-11
    assert np.abs(h - t.h[1:]).max() < 1e-4


@pytest.mark.parametrize("name", ["s_turn", pytest.param("accelerate_and_turn", marks=pytest.mark.slow)])
def test_position_against_an_ode_solver(name):
    trajectory, rate = CLOSURE[name]
    exact = truth_of(name)
    some = slice(0, int(100 * rate) // 2 + 1, 50)
    time, lat, lon, h = (x[some] for x in (exact.t, exact.lat, exact.lon, exact.h))
    velocity = jax.jit(lambda s: trajectory.velocity_n(s).array)

    def rates(time, x):
        v = np.asarray(velocity(time))
        rm, rn = radii(x[0])
        return [v[1] / (rm + x[2]), v[0] / ((rn + x[2]) * np.cos(x[0])), v[2]]

    ode = solve_ivp(rates, (0, 100), [0.56, 2.07, 30.0], "DOP853", time, rtol=1e-13, atol=1e-13, max_step=1.0)
    assert ode.success
    assert np.abs(ode.y[0] - lat).max() < 1e-12
    assert np.abs(ode.y[1] - lon).max() < 1e-12
    assert np.abs(ode.y[2] - h).max() < 1e-9


def vibration():
    """10 Hz: fast enough that two or three nodes in a sample of 10 ms would show."""
    return Trajectory(
        Sines(0.1, 10.0),
        Sines(0.2, 9.0, 1.0),
        Sines(0.3, 8.0, 2.0, 1.0),
        VelocityInBody(Sines(0.1, 10.0), Sines(0.2, 9.0, 0.3), Constant()),
    )


@pytest.mark.parametrize("motion", [sway_underway, vibration])
def test_increments_are_the_integrals_of_rate_and_force(motion):
    """One sample by adaptive quadrature: the six nodes leave nothing."""
    trajectory, lat, h, dt = motion(), 0.7, 100.0, 0.01
    t = jitted_increments(trajectory, Site(lat, 0.0, h), dt, 2, 2)
    # The quadrature here keeps the place fixed; in truth the height changes by 5 mm, gravity by 1.5e-8 m/s^2.
    for rate, got, atol in ((turn_rate, t.dtheta[0], 1e-14), (specific_force, t.dvel[0], 1.5e-8 * dt)):
        f = jax.jit(lambda s, rate=rate: rate(trajectory, s, lat, h).array)
        expected = [quad(lambda s, f=f, i=i: np.asarray(f(s))[i], 0, dt, epsabs=1e-16)[0] for i in range(3)]
        np.testing.assert_allclose(got, expected, rtol=0, atol=atol)


def test_vehicle_at_rest():
    """Only the Earth turns, and the specific force is the reaction to gravity."""
    t = jitted_increments(static_base(10.0, -20.0, 130.0), Site(0.6, 0.0, 50.0), 0.01, 10, 5)
    C = Rotation.from_euler("ZXY", [130.0, 10.0, -20.0], degrees=True).as_matrix()
    np.testing.assert_allclose(t.C_nb[1], C, atol=1e-15)
    wie = WIE * np.array([0, np.cos(0.6), np.sin(0.6)])
    np.testing.assert_allclose(t.dtheta, np.tile(C.T @ wie * 0.01, (10, 1)), rtol=0, atol=1e-19)
    np.testing.assert_allclose(t.dvel, np.tile(C.T @ [0, 0, gravity(0.6, 50.0)] * 0.01, (10, 1)), rtol=1e-10)


def test_body_rate_from_euler_rates():
    """w_nb against the finite difference of the attitude, away from small angles."""
    trajectory = Trajectory(Sines(1.0, 0.3), Sines(2.0, 0.2, 0.4), Sines(3.0, 0.1, 1.0))
    times, eps = np.linspace(0.0, 10.0, 41), 1e-5
    rate = np.asarray(jax.jit(lambda t: trajectory.rate_nb(t).array)(times))
    attitude = jax.jit(lambda t: trajectory.attitude(t).matrix.array)
    before, after = (Rotation.from_matrix(np.asarray(attitude(times + s * eps))) for s in (-1, 1))
    np.testing.assert_allclose((before.inv() * after).as_rotvec() / (2 * eps), rate, atol=1e-8)


@pytest.mark.parametrize("trajectory", [s_turn(), zigzag(sway=True)])
def test_velocities_agree_in_both_frames(trajectory):

    @jax.jit
    def at(times):
        some = trajectory.attitude(times).matrix, trajectory.velocity_n(times), trajectory.velocity_b(times)
        return [x.array for x in some]

    C, v_n, v_b = (np.asarray(x) for x in at(np.linspace(0.0, 250.0, 26)))
    np.testing.assert_allclose(np.einsum("kij,kj->ki", C, v_b), v_n, atol=1e-14)


def test_zigzag_follows_its_table():
    """Huang et al., Table II: 10 m/s after 20 s, 80 deg to the right at 60 s, back at 180 s."""
    trajectory = zigzag()
    assert trajectory.breaks == (0.0, 20.0, 40.0, 60.0, 160.0, 180.0)
    t = np.array([0.0, 10.0, 20.0, 50.0, 60.0, 160.0, 170.0, 250.0])
    v = np.asarray(jax.jit(lambda t: trajectory.velocity_n(t).array)(t))
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), [0, 5, 10, 10, 10, 10, 10, 10], atol=1e-13)
    np.testing.assert_allclose(np.rad2deg(trajectory.yaw(t)), [10, 10, 10, -30, -70, -70, -30, 10], atol=1e-12)
    # From 60 s on the car heads 70 deg clockwise from north: mostly east, slowly north.
    np.testing.assert_allclose(v[4], [10 * np.sin(np.deg2rad(70)), 10 * np.cos(np.deg2rad(70)), 0], atol=1e-13)


def test_swaying_base_has_the_amplitudes_of_its_table():
    """Xu et al. (2017), Table 1, at a quarter period of each."""
    e = [float(getattr(swaying_base(40.0), a)(t)) for a, t in [("pitch", 1.25), ("roll", 2.0), ("yaw", 5 / 3)]]
    np.testing.assert_allclose(np.rad2deg(e), [10.0, 12.0, 46.0], rtol=1e-14)


def test_signals():
    t = np.array([-1.0, 0.0, 1.0, 2.5, 9.0])
    np.testing.assert_allclose(Ramps(2.0, 0.0, 2.0, 5.0)(t), [5, 5, 7, 9, 9])
    np.testing.assert_allclose(Steps([4.0], [0.0], [1.0], 1.0)(t), 1 + 2 * (1 + np.tanh(np.asarray(t))))
    total = Constant(1.0) + Sines([1.0, 2.0], [0.5, 0.25], [0.0, 0.1], 3.0) + Ramps(1.0, 0.0, 1.0)
    expected = 4 + np.sin(np.pi * t) + 2 * np.sin(np.pi / 2 * t + 0.1) + np.clip(t, 0, 1)
    np.testing.assert_allclose(total(t), expected)
    assert total.breaks == (0.0, 1.0)


def test_truth_is_differentiable_in_the_trajectory():
    """Derivative of an increment in a leaf (the speed), against differences."""

    @jax.jit
    @jax.value_and_grad
    def last(speed):
        t = exact_increments(s_turn(speed), Site(0.5), 0.01, 100, 50)
        return jnp.sum(t.dvel[-1] * jnp.array([1.0, 2.0, 3.0])) + 1e3 * t.lat[-1] + jnp.sum(t.dtheta) * 1e3

    np.testing.assert_allclose(last(5.0)[1], (last(5.5)[0] - last(4.5)[0]), rtol=1e-6)


def test_breaks_inside_a_sample_are_refused():
    v = VelocityInBody(Constant(), Ramps(1.0, 0.0, 1.0003), Constant())
    trajectory = Trajectory(Constant(), Constant(), Constant(), v)
    with pytest.raises(UserError, match=r"slope jumps at 1\.0003 s"):
        truth(Scenario(trajectory, Site(0.5), duration=2.0))


def test_pole_is_refused():
    with pytest.raises(UserError, match=r"latitude is 90\.000 deg"):
        truth(Scenario(s_turn(), Site(np.pi / 2), duration=2.0))


@pytest.mark.parametrize(("width", "message"), [(0.0, "Steps.width"), ([1.0, 2.0, 3.0], "expected one number")])
def test_bad_signal(width, message):
    with pytest.raises(UserError, match=message):
        Steps([1.0, 2.0], [0.0, 1.0], width)


# --- the frozen cases: generated by an independent program with the same trajectories ---------------------


def old_gravity(lat):
    """The gravity formula of the frozen cases; 2e-6 below Somigliana's."""
    s2 = np.sin(lat) ** 2
    return 9.7803267714 * (1 + 5.27094e-3 * s2 + 2.32718e-5 * s2**2)


@pytest.mark.parametrize(
    ("name", "case"),
    [
        ("dvl-sturn", "dvl_sturn_clean"),
        ("dvl-sturn", "dvl_sturn_fixed"),
        ("dvl-accturn", "dvl_accturn_clean"),
    ],
)
def test_frozen_dvl_truth(shared, name, case):
    """Attitude, velocity and position are noise-free there; the increments are not."""
    z = np.load(shared / "cases" / f"{case}.npz")
    t = truth(scenario(name))
    np.testing.assert_allclose(t.C_nb, z["C_nb_true"], atol=1e-13)
    np.testing.assert_allclose(t.velocity_b, z["v_true"], atol=1e-13)
    np.testing.assert_allclose(np.stack([t.lat, t.lon, t.h], 1)[:, :2], z["pos_true"][:, :2], atol=1e-12)
    np.testing.assert_allclose(t.h, z["pos_true"][:, 2], atol=1e-9)


def test_frozen_dvl_integrals(shared):
    """C_b0b and the integral of C_b0b f of the frozen front end: its noisy increments against our exact ones.

    The helpers belong to noisy increments. The difference of the increments is a bias and white noise of the
    declared size (dvl.md section 3), so helper minus truth is explained by exactly that: integrating the
    differences to first order along our attitude leaves second-order terms only.
    """
    z = np.load(shared / "cases" / "dvl_sturn_clean.npz")
    t = truth(scenario("dvl-sturn"))
    d, v = np.asarray(t.dtheta), np.asarray(t.dvel)
    phi, dv = pairs(d, v)
    C = np.concatenate([np.eye(3)[None], accumulate(phi)])
    S = np.cumsum(np.einsum("kij,kj->ki", C[:-1], dv), axis=0)
    rotation = np.cumsum(np.einsum("kij,kj->ki", C[:-1], pair_sum(z["dtheta"] - d)), axis=0)
    epochs = np.arange(100, len(C), 100)
    small = np.array([skew(r) for r in rotation[epochs - 1]])
    np.testing.assert_allclose((np.eye(3) + small) @ C[epochs], z["C_b0b"][1:], atol=1e-8)
    f = np.einsum("kij,kj->ki", C[:-1], pair_sum(z["dvel"] - v))
    tilt = np.vstack([np.zeros(3), rotation[:-1]])
    f = f + np.cross((tilt + rotation) / 2, np.einsum("kij,kj->ki", C[:-1], dv))
    np.testing.assert_allclose((S + np.cumsum(f, axis=0))[epochs - 1], z["S_b0"][1:], atol=3e-5)


def accumulate(phi):
    C, out = np.eye(3), []
    for turn in Rotation.from_rotvec(phi).as_matrix():
        C = C @ turn
        out.append(C)
    return np.array(out)


def pair_sum(x):
    return x[0::2] + x[1::2]


@pytest.mark.parametrize(
    ("name", "case", "options"),
    [
        ("gps-zigzag", "gps_clean_sway", {"sway": True}),
        ("sway", "self_sway_noisefree_300s", {"duration": 300.0}),
    ],
)
def test_frozen_noise_free_increments(shared, name, case, options):
    """Rotation increments to 1e-13 rad; velocity increments once the gravity formula is allowed for."""
    z = np.load(shared / "cases" / f"{case}.npz")
    setting = dataclasses.replace(scenario(name, **options), epoch_samples=1)
    t = truth(setting)
    np.testing.assert_allclose(t.dtheta, z["dtheta"], atol=1e-13)
    middle = (np.asarray(t.C_nb[1:]) + np.asarray(t.C_nb[:-1])) / 2
    lat, h = (np.asarray(x[1:] + x[:-1]) / 2 for x in (t.lat, t.h))
    excess = old_gravity(lat) - gravity(lat, h)
    assert np.all(np.abs(excess / 9.8 + 2.1e-6) < 1e-7)
    np.testing.assert_allclose(t.dvel + middle[:, 2] * excess[:, None] / 100, z["dvel"], atol=2e-12)
    np.testing.assert_allclose(t.C_nb[:: int(z["aid_every"])], z["C_nb_true"], atol=1e-13)
    np.testing.assert_allclose(t.velocity_n[:: int(z["aid_every"])], z["aid_v"], atol=1e-13)
