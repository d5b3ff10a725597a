"""How sure an attitude is: the ensemble against the errors of many runs, and what is said of it."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from logs import with_noise
from statistical import phi_deg

from jaxalign import align, assess, imu_errors
from jaxalign.bounds import bound
from jaxalign.cli.main import main
from jaxalign.errors import UserError
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors, imu_figures
from jaxalign.io.npz import write_npz
from jaxalign.methods import build
from jaxalign.simulate import intervals_of, measure_epochs, scenario, simulate, truth
from jaxalign.simulate.faults import FixedOutliers
from jaxalign.solution import Status
from jaxalign.uncertainty import ensemble_covariance


def drawn(made, key):
    """With biases from a normal distribution."""
    a, b = (jax.random.normal(k, (3,)) for k in jax.random.split(key))
    biases = made.imu.gyro.bias_deg_h * a, made.imu.accel.bias_ug * b
    return eqx.tree_at(lambda s: (s.imu.gyro.bias_deg_h, s.imu.accel.bias_ug), made, biases)


@eqx.filter_jit
def solved(made, intervals, method, keys, every, draws):
    def one(key):
        a, b, c = jax.random.split(key, 3)
        epochs = measure_epochs(intervals, drawn(made, a), b)
        found = method.solve(epochs, every)
        return found.q_nb, ensemble_covariance(method, epochs, made.imu, found, every, draws, c)

    return jax.lax.map(one, keys)


def errors_and_deviations(made, name, runs, every, draws):
    """(runs, rows, 3) both, rad, n; rows after the first."""
    exact = truth(made)
    keys = jax.random.split(jax.random.key(11), runs)
    q, covariance = solved(
        made,
        intervals_of(exact, made.epoch_samples),
        build(name, made.aids[0].aid if made.aids else "static"),
        keys,
        every,
        draws,
    )
    rows = np.unique([*range(0, made.epochs + 1, every), made.epochs])
    phi, sd = np.deg2rad(phi_deg(q, exact.C_nb[rows])), np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    return phi[:, 1:], sd[:, 1:], rows[1:], exact


@pytest.mark.slow
@pytest.mark.long
def test_centred_oba_knows_its_errors():
    """Clean: coverage, and the deviation of the heading is the bound (32 draws: 13 % of each run)."""
    made = scenario("dvl-sturn")
    phi, sd, rows, exact = errors_and_deviations(made, "centred_oba", 40, 150, draws=32)
    covered = (np.abs(phi) < 1.96 * sd).mean(axis=(0, 1))
    assert (covered > 0.86).all(), covered
    assert covered.mean() < 0.985, covered  # one angle of so few runs may have all within
    limit = np.deg2rad(np.asarray(bound(made, exact).phi_deg)[rows, 2])
    np.testing.assert_allclose(np.median(sd[:, :, 2], axis=0), limit, rtol=0.1)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", ["oba", "roba", "revising_oba", "centred_oba"])
@pytest.mark.parametrize("share", [0.0, 0.1])
def test_coverage(name, share):
    """95 % intervals at 200 and 300 s, a tenth of outliers or none (the first fix excepted)."""
    made = with_noise(scenario("dvl-sturn"), faults=(FixedOutliers(share, 300.0),))  # one program for both
    runs = 60 if name == "revising_oba" else 100  # the dear one
    phi, sd, _, _ = errors_and_deviations(made, name, runs, 100, draws=64)
    covered = (np.abs(phi) < 1.96 * sd)[:, 1:].mean(axis=(0, 1))
    print(name, share, np.round(covered, 3))
    assert (covered > 0.88).all(), covered


@pytest.fixture(scope="module")
def log():
    return simulate("dvl-sturn", seed=3, duration=60.0)


@pytest.fixture(scope="module")
def found(log):
    return assess(build("oba", "body"), log, imu_errors("navigation"), every=10)


def test_assess_is_align_with_a_covariance(log, found):
    method, imu = build("oba", "body"), imu_errors("navigation")
    plain = align(method, log, every=10)
    np.testing.assert_array_equal(plain.q_nb, found.q_nb)
    assert plain.sd is None
    assert plain.euler_sd_deg is None
    again = assess(method, log, imu, every=10, draws=250)  # rounded up
    np.testing.assert_array_equal(found.covariance, again.covariance)
    assert np.linalg.eigvalsh(found.covariance[1:]).min() > 0
    coarser = assess(method, log, imu_errors("mems"), every=10)
    assert (coarser.sd[-1, :2] > 10 * found.sd[-1, :2]).all()
    assert coarser.sd[-1, 2] > 2 * found.sd[-1, 2]
    # Nearly level: the heading's deviation is that of the up axis, pitch and roll share the horizontal ones.
    euler = found.euler_sd_deg[-1]
    np.testing.assert_allclose(euler[2], np.rad2deg(found.sd[-1, 2]), rtol=1e-3)
    np.testing.assert_allclose(np.sum(euler[:2] ** 2), np.sum(np.rad2deg(found.sd[-1, :2]) ** 2), rtol=1e-2)


def test_aligned_from_the_last_time_below(log, found):
    heading = np.array([np.nan, 5.0, 0.5, 2.0, 0.9, 0.8, 0.7])
    variance = np.nan_to_num(np.deg2rad(heading), nan=0.0) ** 2
    covariance = np.zeros((7, 3, 3))
    covariance[:, 2, 2] = variance
    level = dataclasses.replace(
        found,
        q_nb=jnp.asarray(np.tile([1.0, 0.0, 0.0, 0.0], (7, 1))),
        covariance=jnp.asarray(covariance),
        defined=jnp.asarray(np.arange(7) > 0),
    )
    np.testing.assert_array_equal(level.aligned(1.0), [False, False, False, False, True, True, True])
    assert not level.aligned(0.1).any()
    with pytest.raises(UserError, match="cannot fall below"):
        level.aligned(0.0)
    with pytest.raises(UserError, match="assess"):
        align(build("oba", "body"), log, every=10).aligned(1.0)


@pytest.mark.slow
def test_biases_that_wander_count(log):
    """A random walk of the bias from zero, and no other error of the gyroscopes: pitch and roll grow with it."""
    found = []
    for walk in (None, 5.0, 10.0):
        imu = ImuErrors(GyroErrors(bias_walk_deg_h_sqrt_h=walk), AccelErrors(1.0, 1.0))
        found.append(assess(build("oba", "body"), log, imu, every=30, aid_sd=1e-3).sd[-1, :2])
    assert (found[1] > 3 * found[0]).all()
    np.testing.assert_allclose(found[2] / found[1], 2.0, rtol=0.05)


@pytest.mark.slow
def test_behind_a_prefilter_it_is_indicative():
    log = simulate("sway", seed=1, duration=30.0)
    found = assess(build("triad", "static", prefilter="fir"), log, imu_errors("tactical"), every=30, draws=32)
    assert (np.asarray(found.status) & Status.INDICATIVE).all()
    assert np.isfinite(found.covariance).all()


@pytest.mark.slow
def test_a_wide_open_heading_is_indicative(log):
    found = assess(build("oba", "body"), log, imu_errors("mems"), every=10)
    hint = (np.asarray(found.status) & Status.INDICATIVE) > 0
    np.testing.assert_array_equal(hint, np.asarray(found.defined) & (np.rad2deg(found.sd[:, 2]) >= 20))
    assert hint[-1]
    sure = assess(build("oba", "body"), log, imu_errors("navigation"), every=10, aid_sd=0.02)
    assert not np.asarray(sure.status)[-1] & Status.INDICATIVE


def test_bad_input(log):
    method = build("oba", "body")
    with pytest.raises(UserError, match="imu_errors"):
        assess(method, log, "tactical")
    with pytest.raises(UserError, match="draws"):
        assess(method, log, imu_errors("tactical"), draws=0)


def test_figures_from_a_file(tmp_path):
    path = tmp_path / "unit.toml"
    gyro = "[gyro]\nbias_deg_h = 2\nwalk_deg_sqrt_h = 0.1\n"
    good = gyro + "[accel]\nbias_ug = 500\ndensity_ug_sqrt_hz = [80, 80, 90]\n"
    path.write_text(good)
    found = imu_figures(str(path))
    assert float(found.gyro.bias_deg_h) == 2.0
    np.testing.assert_array_equal(found.accel.density_ug_sqrt_hz, [80, 80, 90])
    assert found.gyro.bias_walk is None
    assert float(imu_figures("mems").gyro.bias_deg_h) == 200.0
    for text, message in (
        (gyro, r"\[accel\] bias_ug, \[accel\] density_ug_sqrt_hz or noise_ug: missing"),
        ("gyro_bias_deg_h = 2\n" + good, r"gyro_bias_deg_h: the figures stand in two tables: \[gyro\] bias_deg_h"),
        (good + "x = 1\n", "no parameter"),
        (good.replace("80, 80, 90", "80, 80"), "must be a number, or three, one per axis"),
        (good.replace("= 2", "= -2"), "outside its bounds"),
        ("gyro", "TOML"),
    ):
        path.write_text(text)
        with pytest.raises(UserError, match=message):
            imu_figures(str(path))
    with pytest.raises(UserError, match="cannot be read"):
        imu_figures(str(tmp_path / "none.toml"))


def test_command(tmp_path, log, capsys):
    path = str(tmp_path / "log.npz")
    write_npz(log, path)
    out = str(tmp_path / "out.npz")
    common = ["align", path, "--method", "oba", "--every", "10"]
    assert main([*common, "--imu", "navigation", "--aligned", "90", "--output", out]) == 0
    text = capsys.readouterr().out
    assert "standard deviations at the end: pitch" in text
    assert "ALIGNED from" in text
    with np.load(out) as written:
        assert written["euler_sd_deg"].shape == (7, 3)
    assert main([*common, "--imu", "navigation", "--aligned", "0.001"]) == 0
    assert "NOT ALIGNED" in capsys.readouterr().out
    for flags, message in (
        (["--aligned", "1"], "--imu navigation"),
        (["--imu", "tactica"], "did you mean tactical"),
        (["--imu", "navigation", "--aligned", "-1"], "cannot fall below"),
    ):
        assert main([*common, *flags]) == 2
        assert message in capsys.readouterr().err
