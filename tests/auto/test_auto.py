"""A method chosen by what a log holds."""

import dataclasses
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from logs import with_velocity

from jaxalign import align, build, choose, imu_errors, read
from jaxalign.alignment import epochs_for
from jaxalign.batch import RobustMap
from jaxalign.cli.main import main
from jaxalign.errors import UserError
from jaxalign.inertial_unit import GRADES, AccelErrors, GyroErrors, ImuErrors
from jaxalign.io.npz import write_npz
from jaxalign.metrics import attitude_error_deg
from jaxalign.rotation import euler_from_dcm
from jaxalign.simulate import scenario, simulate
from jaxalign.study import Study, run


def of_grade(name, grade, **options):
    """A log of a scenario with a unit of that grade, its biases of one standard deviation and any sign."""
    bias, walk, accel, noise = GRADES[grade]
    made = dataclasses.replace(
        scenario(name, **options), imu=ImuErrors(GyroErrors(bias, walk), AccelErrors(accel, noise))
    )
    return simulate(made, seed=5)


@pytest.mark.slow  # the first: test_command
@pytest.mark.parametrize(
    "grade",
    ["navigation", "tactical", "mems"],
)
def test_the_grade_is_that_of_the_data(grade):
    log = of_grade("dvl-sturn", grade)
    choice = choose(log)
    assert (choice.name, choice.grade) == ("robust_map", grade)
    assert isinstance(choice.method, RobustMap)
    assert (choice.method.aids[0].name, choice.method.calibrate) == ("body", ("body.scale", "body.mounting"))
    assert choice.method.heading_count == (1 if grade == "navigation" else 4)
    assert float(choice.method.imu.gyro.bias_deg_h) == GRADES[grade][0]
    assert any(grade in line for line in choice.reasons)
    found = align(choice.method, log, every=log.epochs)
    assert (np.abs(attitude_error_deg(found, log)[-1]) < 3.5 * np.rad2deg(found.sd[-1])).all()


@pytest.mark.slow
@pytest.mark.parametrize("grade", ["navigation", "mems"])
def test_standing(grade):
    """Epochs of 1 s; with gyroscopes of 200 deg/h the Earth's rate is not seen, and the heading is said to be open."""
    log = of_grade("sway", grade, duration=200.0)
    choice = choose(log)
    assert (choice.method.standing, choice.method.calibrate) == (True, ())
    assert choice.method.front_end.interval_samples == (100 if grade == "navigation" else 20)
    assert choice.grade == grade
    found = align(choice.method, log, every=20)  # so many rows that it is the program of `choose`
    assert bool(found.observable[-1]) == (grade == "navigation")
    truth = np.rad2deg(euler_from_dcm(log.C_nb[-1]))
    assert (np.abs(found.euler_deg[-1] - truth)[:2] < 3.5 * found.euler_sd_deg[-1, :2]).all()


def test_as_a_method_it_is_what_is_chosen():
    """The same programs, so the same numbers."""
    log = simulate(scenario("dvl-sturn"), seed=1)
    chosen, own = (align(method, log, every=log.epochs) for method in (choose(log).method, build("auto", aid="body")))
    assert eqx.tree_equal(chosen, own)


@pytest.mark.slow
def test_grades_of_runs_side_by_side():
    """Inside one program each run has the grade of its own data, as outside; derivatives are of that grade."""
    auto = build("auto", aid="body", calibrate=())
    logs = [of_grade("dvl-sturn", grade, duration=150.0) for grade in ("navigation", "mems")]
    many = [dataclasses.replace(epochs_for(auto, log), sd=(jnp.asarray(0.1),)) for log in logs]
    grades = [list(GRADES)[int(auto.graded(one).number)] for one in many]
    assert grades == ["navigation", "mems"]
    end = [len(many[0]) - 1]
    rows = jax.tree.map(lambda *x: jnp.stack(x, axis=-1), *(one.rows for one in many))
    together = eqx.filter_jit(lambda method, epochs: method.solve_runs(epochs, end))
    found = together(auto, dataclasses.replace(many[0], rows=rows))
    for i, one in enumerate(many):
        expected = auto.solve(one, end)
        np.testing.assert_allclose(found.q_nb[i], expected.q_nb, atol=1e-8)
        np.testing.assert_allclose(found.covariance[i], expected.covariance, rtol=1e-4)

    def heading(shift):
        value = many[0].rows.fixes[0].value
        epochs = eqx.tree_at(lambda e: e.rows.fixes[0].value, many[0], (value[0] + shift * ramp, *value[1:]))
        q = auto.solve(epochs, end).q_nb[0]
        return jnp.arctan2(2 * (q[1] * q[2] - q[0] * q[3]), 1 - 2 * (q[1] ** 2 + q[3] ** 2))

    ramp = jnp.linspace(0.0, 1.0, len(many[0]))
    slope = jax.jit(jax.grad(heading))(0.0)
    for step in (1e-3, 3e-4):
        by_hand = (heading(step) - heading(-step)) / (2 * step)
        np.testing.assert_allclose(slope, by_hand, rtol=2e-3)


@pytest.mark.slow
def test_in_a_study():
    """Told nothing of the unit, it does nearly as well as the estimator that knows its grade."""
    bias, walk, accel, noise = GRADES["tactical"]
    made = dataclasses.replace(scenario("dvl-sturn"), imu=ImuErrors(GyroErrors(bias, walk), AccelErrors(accel, noise)))
    methods = {
        "auto": build("auto", aid="body", calibrate=()),
        "told": build("robust_map", aid="body", imu=imu_errors("tactical")),
    }
    found = run(Study(made, methods, runs=32, every=300))
    ratio = found["auto"].ratio(found["told"])
    print(ratio.value, ratio.error)
    assert (ratio.value < 1.1 + 2 * ratio.error).all()


def test_figures_that_are_given_are_taken():
    log = simulate(scenario("dvl-sturn"), seed=1)
    choice = choose(log, imu_errors("tactical"), parameters={"calibrate": "none", "outlier_probability": 0.1})
    assert choice.grade is None
    assert float(choice.method.imu.gyro.bias_deg_h) == GRADES["tactical"][0]
    assert choice.method.calibrate == ()
    assert float(choice.method.outlier_probability) == 0.1


@pytest.mark.slow
def test_too_few_fixes_to_tell():
    log = simulate(scenario("dvl-sturn"), seed=1)
    known = np.isin(np.arange(log.epochs + 1), [0, 200])
    log = with_velocity(log, np.where(known[:, None], log.aids[0].value, np.nan))
    choice = choose(log)
    assert choice.grade == "mems"
    assert "too few fixes" in choice.reasons[-1]


@pytest.mark.slow
def test_a_unit_beyond_all_grades_is_told():
    made = scenario("dvl-sturn")
    log = simulate(dataclasses.replace(made, imu=ImuErrors(GyroErrors(1500.0, 0.3), made.imu.accel)), seed=4)
    assert any("gyroscope biases" in line and "warning" in line for line in choose(log).reasons)


def test_bad_input():
    log = simulate(scenario("dvl-sturn"), seed=1)
    with pytest.raises(UserError, match="no Log"):
        choose("log.npz")
    with pytest.raises(UserError, match="imu_errors"):
        choose(log, "tactical")
    with pytest.raises(UserError, match="go together"):
        choose(log, parameters={"imu.gyro.bias_deg_h": 3.0})
    with pytest.raises(UserError, match="calibrate"):
        choose(log, parameters={"calibrate": "latancy"})
    with pytest.raises(UserError, match="outlier_probability"):
        choose(log, parameters={"outlier": 0.1})


def test_command(tmp_path, capsys):
    """It says what it chose and why; rows at most 50; its file makes the method again."""
    path, out = tmp_path / "log.npz", tmp_path / "out.npz"
    write_npz(simulate("dvl-sturn", seed=1, outliers="fixed"), path)
    assert main(["align", str(path), "--output", str(out), "--aligned", "0.5"]) == 0
    printed = capsys.readouterr().out
    for words in (
        "method robust_map",
        "among the unknowns: scale, mounting",
        "navigation, the finest",
        "ALIGNED from",
        "its sd deg",
    ):
        assert words in printed
    assert re.search(r"of the aid: scale \S+ \+- \S+ %; mounting (\S+ \+- \S+,? ){3}deg", printed)
    assert "do not trust" not in printed
    with np.load(out) as z:
        assert len(z["t"]) == 51
        assert z["calibration"].shape == (51, 4)
        assert z["euler_sd_deg"][-1, 2] < 0.5
    assert main(["align", str(path), "--prefilter", "vondrak"]) == 2
    assert "--prefilter: auto takes none" in capsys.readouterr().err


@pytest.mark.slow
def test_command_with_a_stated_unit(tmp_path, capsys):
    path = tmp_path / "log.npz"
    write_npz(simulate("dvl-sturn", seed=1, outliers="fixed"), path)
    assert main(["align", str(path), "--method", "auto", "--imu", "tactical", "--every", "300"]) == 0
    assert "inertial unit: as stated" in capsys.readouterr().out


def struck(log, seed):
    """With 2 % of the fixes off by 1 m/s per axis, but for the first."""
    random = np.random.default_rng(seed)
    hit = random.random(len(log.aids[0].value)) < 0.02
    hit[0] = False
    off = hit[:, None] * random.normal(size=log.aids[0].value.shape)
    return with_velocity(log, log.aids[0].value + off)


AUV = ("02", "03", "05", "10", "12", "13")


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [struck, lambda log, seed: log])
def test_auv_logs(shared, spoil):
    """Six logs of an AUV, nothing said of its sensors: 0.98 deg after 200 s and 0.33 at the end by plain OBA."""
    errors = []
    for seed, number in enumerate(AUV):
        log = spoil(read(shared / "data" / "real_akit" / f"real_akit_{number}.npz"), seed)
        choice = choose(log)
        assert choice.grade == "navigation"
        found = align(choice.method, log, every=25)
        errors.append(attitude_error_deg(found, log)[[8, -1], 2])
    at_200, at_end = np.sqrt(np.mean(np.square(errors), axis=0))
    print(at_200, at_end)
    assert at_200 <= 0.25
    assert at_end <= 0.20


@pytest.mark.slow
def test_car_windows(shared):
    """A low-cost unit of 140 deg/h with GNSS 1.7 m behind it, nothing of that said: 3.8 deg by plain OBA."""
    log = read(shared / "data" / "n380_car" / "n380_hill.npz")
    errors, sd = [], []
    for start in range(0, int(log.duration) - 60, 10):
        part = log.crop(start, start + 60)
        if np.linalg.norm(part.aids[0].value[-1] - part.aids[0].value[0]) > 8:
            choice = choose(part)
            assert choice.grade == "mems"
            found = align(choice.method, part, every=60)
            errors.append(attitude_error_deg(found, part)[-1, 2])
            sd.append(np.rad2deg(found.sd[-1, 2]))
    errors, sd = np.array(errors), np.array(sd)
    print(len(errors), np.median(np.abs(errors)), np.median(sd), np.sqrt(np.mean((errors / sd) ** 2)))
    assert len(errors) == 21
    assert np.median(np.abs(errors)) <= 0.5
    assert (np.abs(errors) < 1.96 * sd).mean() >= 0.85


@pytest.mark.slow
def test_low_cost_unit_in_a_car(shared):
    """A centimetre of lever arm counts: with it, and unknown biases, the heading is within what is said of it."""
    log = read(shared / "data" / "fog_mems" / "psins_fog_mems.npz")
    choice = choose(log)
    assert choice.grade == "mems"
    found = align(choice.method, log, every=log.epochs)
    error, sd = attitude_error_deg(found, log)[-1], np.rad2deg(found.sd[-1])
    assert (np.abs(error[[0, 2]]) < 2 * sd[[0, 2]]).all()
    assert sd[2] < 0.4
    np.testing.assert_allclose(found.filter.calibration[-1, 3], 0.13, atol=0.05)  # m, up


@pytest.mark.slow
def test_ring_laser(shared):
    """No reference, but independent toolboxes: yaw -90.58 to -90.63 deg after 300 s."""
    log = read(shared / "data" / "lasergyro" / "lasergyro_first_half.imu").crop(0, 300)
    choice = choose(log)
    assert choice.grade == "navigation"
    pitch, roll, yaw = align(choice.method, log, every=30).euler_deg[-1]
    assert yaw == pytest.approx(-90.60, abs=0.03)
    assert pitch == pytest.approx(0.8035, abs=0.002)
    assert roll == pytest.approx(0.3107, abs=0.002)
