"""A method chosen by what a log holds."""

import dataclasses
import re

import numpy as np
import pytest

from jaxalign import align, choose, imu_errors, read
from jaxalign.batch import RobustMap
from jaxalign.cli.main import main
from jaxalign.errors import UserError
from jaxalign.inertial_unit import GRADES
from jaxalign.io.npz import write_npz
from jaxalign.metrics import attitude_error_deg
from jaxalign.rotation import euler_from_dcm
from jaxalign.simulate import scenario, simulate
from jaxalign.simulate.sensors import accel_errors, gyro_errors


def of_grade(name, grade, **options):
    """A log of a scenario with a unit of that grade, its biases of one standard deviation and any sign."""
    bias, walk, accel, noise = GRADES[grade]
    made = dataclasses.replace(
        scenario(name, **options), gyro=gyro_errors(bias, walk), accel=accel_errors(accel, noise)
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
    assert (choice.method.aid, choice.method.calibrate) == ("body", "mounting")
    assert choice.method.starts == (1 if grade == "navigation" else 4)
    assert float(choice.method.imu.gyro_bias_deg_h) == GRADES[grade][0]
    assert any(grade in line for line in choice.reasons)
    found = align(choice.method, log, every=log.epochs)
    assert (np.abs(attitude_error_deg(found, log)[-1]) < 3.5 * np.rad2deg(found.sd[-1])).all()


@pytest.mark.slow
@pytest.mark.parametrize("grade", ["navigation", "mems"])
def test_standing(grade):
    """Epochs of 1 s; with gyroscopes of 200 deg/h the Earth's rate is not seen, and the heading is said to be open."""
    log = of_grade("sway", grade, duration=200.0)
    choice = choose(log)
    assert (choice.method.aid, choice.method.calibrate) == ("static", "none")
    assert choice.method.interval_samples == (100 if grade == "navigation" else 20)
    assert choice.grade == grade
    found = align(choice.method, log, every=20)  # so many rows that it is the program of `choose`
    assert bool(found.observable[-1]) == (grade == "navigation")
    truth = np.rad2deg(euler_from_dcm(log.C_nb[-1]))
    assert (np.abs(found.euler_deg[-1] - truth)[:2] < 3.5 * found.euler_sd_deg[-1, :2]).all()


def test_figures_that_are_given_are_taken():
    log = simulate(scenario("dvl-sturn"), seed=1)
    choice = choose(log, imu_errors("tactical"), parameters={"calibrate": "none", "outliers": 0.1})
    assert choice.grade is None
    assert float(choice.method.imu.gyro_bias_deg_h) == GRADES["tactical"][0]
    assert choice.method.calibrate == "none"
    assert float(choice.method.outliers) == 0.1


@pytest.mark.slow
def test_too_few_fixes_to_tell():
    log = simulate(scenario("dvl-sturn"), seed=1)
    known = np.isin(np.arange(log.epochs + 1), [0, 200])
    log = dataclasses.replace(log, velocity=np.where(known[:, None], log.velocity, np.nan))
    choice = choose(log)
    assert choice.grade == "mems"
    assert "too few fixes" in choice.reasons[-1]


@pytest.mark.slow
def test_a_unit_beyond_all_grades_is_told():
    made = scenario("dvl-sturn")
    log = simulate(dataclasses.replace(made, gyro=gyro_errors(1500.0, 0.3)), seed=4)
    assert any("gyroscope biases" in line and "warning" in line for line in choose(log).reasons)


def test_bad_input():
    log = simulate(scenario("dvl-sturn"), seed=1)
    with pytest.raises(UserError, match="no Log"):
        choose("log.npz")
    with pytest.raises(UserError, match="imu_errors"):
        choose(log, "tactical")
    with pytest.raises(UserError, match="go together"):
        choose(log, parameters={"imu.gyro_bias_deg_h": 3.0})
    with pytest.raises(UserError, match="calibrate"):
        choose(log, parameters={"calibrate": "latancy"})
    with pytest.raises(UserError, match="outliers"):
        choose(log, parameters={"outlier": 0.1})


def test_command(tmp_path, capsys):
    """It says what it chose and why; rows at most 50; its file makes the method again."""
    path, out = tmp_path / "log.npz", tmp_path / "out.npz"
    write_npz(simulate("dvl-sturn", seed=1, outliers="fixed"), path)
    assert main(["align", str(path), "--output", str(out), "--aligned", "0.5"]) == 0
    printed = capsys.readouterr().out
    for words in (
        "method robust_map",
        "misalignment are among the unknowns",
        "navigation, the finest",
        "ALIGNED from",
        "its sd deg",
    ):
        assert words in printed
    assert re.search(r"of the aid: scale factor \S+ \+- \S+ %, misalignment (\S+ \+- \S+,? ){3}deg", printed)
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
    hit = random.random(len(log.velocity)) < 0.02
    hit[0] = False
    off = hit[:, None] * random.normal(size=log.velocity.shape)
    return dataclasses.replace(log, velocity=log.velocity + off)


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
        if np.linalg.norm(part.velocity[-1] - part.velocity[0]) > 8:
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
