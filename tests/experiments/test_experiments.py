"""The experiments: their statistics against plain formulas, their Monte Carlo, and that each writes its files."""

import csv
import math
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from experiments.monte_carlo import monte_carlo
from experiments.page import Page, Table
from experiments.statistics import at, between, compared, few_runs, mean, per_run, rms, share
from jaxalign.methods import build
from jaxalign.simulate import noiseless, scenario
from jaxalign.tables import Estimate

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS = (
    "xu2020_rkf_dvl",
    "shen2025_moba_dvl",
    "xu2017_quaternion_kf",
    "huang_vo_tvk_gps",
    "vondrak_disturbed_base",
    "tuning",
    "embedding",
    "bound",
)
ERRORS = np.random.default_rng(1).normal(0.3, 2.0, (40, 25))


def test_rms_is_pooled_with_the_spread_between_runs():
    squares = [sum(x**2 for x in run) / 25 for run in ERRORS]
    pooled = math.sqrt(sum(squares) / 40)
    variance = sum((x - pooled**2) ** 2 for x in squares) / 39
    assert rms(ERRORS) == pytest.approx((pooled, math.sqrt(variance / 40) / (2 * pooled)))
    assert per_run(ERRORS) == pytest.approx([math.sqrt(x) for x in squares])


def test_mean_and_share():
    runs = [sum(run) / 25 for run in ERRORS]
    middle = sum(runs) / 40
    assert mean(ERRORS) == pytest.approx((middle, math.sqrt(sum((x - middle) ** 2 for x in runs) / 39 / 40)))
    assert share(np.arange(40) < 10) == pytest.approx((25.0, 100 * math.sqrt(0.25 * 0.75 / 40)))


def test_standard_errors_are_those_of_repeated_studies():
    rng = np.random.default_rng(2)
    many = [rms(rng.normal(0, 1, (50, 1)) * np.ones((1, 7))) for _ in range(400)]  # the rows of a run alike
    assert np.std([x.value for x in many]) == pytest.approx(np.mean([x.error for x in many]), rel=0.1)


def test_few_runs():
    low, high = few_runs(ERRORS, 10)
    assert low < rms(ERRORS).value < high
    assert few_runs(np.full((5, 3), 2.0)) == (2.0, 2.0)
    near_low, near_high = few_runs(ERRORS, 40)
    assert low < near_low < near_high < high


def test_compared_over_the_same_runs():
    assert compared(0.5 * ERRORS, ERRORS) == "below"
    assert compared(1.5 * ERRORS, ERRORS) == "above"
    assert compared(ERRORS, ERRORS) == "equal to"
    noise = np.random.default_rng(3).normal(0.0, 1.0, (2, 400, 5))
    assert compared(*noise) == "equal to"
    assert compared(noise[0], noise[1] + 0.4) == "below"


def test_times():
    time = np.arange(0.0, 11.0)
    assert list(time[between(time, 8.0, 10.0)]) == [9.0, 10.0]
    assert at(time, 3.4) == 3


@pytest.mark.parametrize(
    ("estimate", "text"),
    [
        (Estimate(0.8674, 0.0312), "0.867 ± 0.031"),
        (Estimate(123.4, 25.2), "123 ± 25"),
        (Estimate(0.00651, 0.00041), "0.00651 ± 0.00041"),
        (Estimate(100.0, 0.0), "100"),
        (Estimate(1234.0, 161.0), "1234 ± 160"),
    ],
)
def test_numbers_show_two_digits_of_their_error(estimate, text):
    assert str(estimate) == text


def test_page(tmp_path):
    table = Table("name", ("method", "yaw deg", "runs", "paper"))
    table.add("oba", Estimate(0.98, 0.07), 40, "0.57")
    with pytest.raises(ValueError, match="2 cells for 4 columns"):
        table.add("oba", 1.0)
    page = Page()
    page.add("# Title", table)
    page.write(tmp_path / "new")
    assert (tmp_path / "new" / "results.md").read_text().splitlines() == [
        "# Title",
        "",
        "| method | yaw deg | runs | paper |",
        "| --- | --- | --- | --- |",
        "| oba | 0.980 ± 0.070 | 40 | 0.57 |",
    ]
    lines = (tmp_path / "new" / "results.csv").read_text().splitlines()
    assert lines[1:] == ["name,oba; 0.57,yaw deg,0.98,0.07", "name,oba; 0.57,runs,40,"]


@pytest.mark.slow
def test_a_run_is_the_same_whatever_else_is_run():
    methods = {"oba": build("oba", "body"), "halves": build("oba", "body", {"front_end.interval_samples": 100})}
    made = scenario("dvl-sturn", duration=12.0)
    found = monte_carlo(made, methods, 3, seed=5, chunk=1)
    assert found["oba"].euler.shape == found["halves"].euler.shape == (3, 12, 3)
    np.testing.assert_allclose(found["oba"].phi[:, 11, :2], found["halves"].phi[:, 11, :2], atol=2e-4)
    second = monte_carlo(made, {"oba": methods["oba"]}, np.array([2]), seed=5, spacing=4.0)["oba"]
    assert list(second.time) == [4.0, 8.0, 12.0]
    np.testing.assert_allclose(second.phi[0], found["oba"].phi[2, 3::4], atol=1e-9)
    assert np.isfinite(found["oba"].phi[:, 1:]).all()


@pytest.mark.slow
def test_the_size_of_a_chunk_does_not_matter():
    made, methods = scenario("dvl-sturn", duration=12.0), {"oba": build("oba", "body")}
    one, two = (monte_carlo(made, methods, 3, chunk=chunk)["oba"] for chunk in (2, 3))
    np.testing.assert_allclose(one.phi[:, 2:, :2], two.phi[:, 2:, :2], atol=1e-9)


@pytest.mark.slow
def test_monte_carlo_without_an_aid():
    pairs = build("velocity_q", "static", {"front_end.interval_samples": 2})
    errors = monte_carlo(scenario("sway", duration=20.0), {"pairs": pairs}, 2, every={"pairs": 250})["pairs"]
    assert list(errors.time) == [5.0, 10.0, 15.0, 20.0]
    assert np.abs(errors.euler[:, -1, :2]).max() < 0.1  # 500 ug are 0.03 deg


@pytest.mark.slow
def test_monte_carlo_with_perfect_sensors():
    errors = monte_carlo(noiseless(scenario("gps-zigzag", duration=60.0)), {"oba": build("oba", "nav")}, 1)["oba"]
    assert np.abs(errors.euler[0, -1]).max() < 0.01
    np.testing.assert_allclose(errors.euler[0, -1, 2], -errors.phi[0, -1, 2], atol=1e-5)


@pytest.mark.parametrize("name", EXPERIMENTS)
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--runs", "1"], "'1' is not a whole number from 2"),
        (["--seed", "x"], "'x' is not a whole number from 0"),
        (["--nonsense"], "unrecognized arguments: --nonsense"),
        (["--output", __file__], "is not a folder"),
    ],
)
def test_bad_arguments_get_one_line(name, arguments, said, capsys):
    with pytest.raises(SystemExit) as end:
        import_module(f"experiments.{name}.__main__").main(arguments)
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_quick_run_does_not_overwrite_the_results(name, capsys):
    with pytest.raises(SystemExit) as end:
        import_module(f"experiments.{name}.__main__").main(["--quick", "--output", str(ROOT / "experiments" / name)])
    assert end.value.code == 2
    assert "full run" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_experiment(name, tmp_path):
    command = [sys.executable, "-W", "error", "-m", f"experiments.{name}", "--quick", "--output", str(tmp_path)]
    # Of so few runs nearly all is compilation.
    environment = {**os.environ, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "results.md").read_text()
    assert "nan" not in text
    pictures = sorted(tmp_path.glob("*.png"))
    assert len(pictures) >= 2
    for picture in pictures:
        assert f"({picture.name})" in text
        assert 3000 < picture.stat().st_size < 200_000
    with (tmp_path / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > (30 if name == "tuning" else 100)  # a quick run of it is one problem
    assert all(math.isfinite(float(row["value"])) for row in rows)
    assert all(float(row["standard error"] or 0.0) >= 0 for row in rows)
