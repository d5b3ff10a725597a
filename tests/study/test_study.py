"""Studies: the statistics are those of the single runs."""

import dataclasses
import json

import equinox as eqx
import jax
import numpy as np
import pytest
from logs import with_noise
from scipy import stats
from studies import RUNS, SHORT, result_of_small, small

from jaxalign import UserError, align, epochs_from_arrays
from jaxalign.methods import build
from jaxalign.rotation import euler_from_quat, quat_from_dcm
from jaxalign.simulate import intervals_of, measure, measure_epochs, noiseless, scenario, truth
from jaxalign.study import PERCENTILES, Study, run
from jaxalign.study.epochs_spec import run_keys
from jaxalign.study.report import write
from jaxalign.study.settings import described
from jaxalign.study.statistics import MethodStatistics


@pytest.fixture(scope="module")
def made(study):
    return study.scenario


@pytest.fixture(scope="module")
def study():
    return small()


@pytest.fixture(scope="module")
def result():
    return result_of_small()


@pytest.fixture(scope="module")
def errors(made, study):
    """(methods, runs, K, 3) deg, each run aligned on its own."""
    exact = truth(made)
    intervals = intervals_of(exact, made.epoch_samples)
    reference = np.rad2deg(euler_from_quat(quat_from_dcm(exact.C_nb[10::10])))
    draw = eqx.filter_jit(measure_epochs)
    out = []
    for method in study.methods.values():
        each = []
        for key in run_keys(jax.random.key(study.seed), np.arange(RUNS)):
            found = align(method, draw(intervals, made, key), every=10)
            difference = found.euler_deg[1:] - reference
            each.append((difference + 180.0) % 360.0 - 180.0)
        out.append(each)
    return np.array(out)


def test_a_short_scenario_is_read_out_at_its_end():
    assert Study(scenario("dvl-sturn", duration=8.0), ["oba"], runs=2).every == 8


def test_a_study_is_a_dataclass():
    """What was left out has been put in; another study is made of it."""
    study = Study("dvl-sturn", ["oba"])
    assert (study.runs, study.every, study.window) == (1000, 10, (250.0, 300.0))
    assert study.scenario.name == "dvl-sturn"
    more = dataclasses.replace(study, runs=2000)
    assert (more.runs, more.every, more.methods) == (2000, 10, study.methods)
    with pytest.raises(UserError, match="runs = 1:"):
        dataclasses.replace(study, runs=1)
    with pytest.raises(dataclasses.FrozenInstanceError):
        study.every = 1
    with pytest.raises(TypeError, match="missing 2 required positional arguments: 'scenario' and 'methods'"):
        Study()


def test_statistics_are_those_of_the_single_runs(result, errors):
    for m, each in zip(result.methods.values(), errors, strict=True):
        np.testing.assert_allclose(m.time_s, [10, 20, 30, 40, 50, 60])
        np.testing.assert_allclose(m.mean.value, each.mean(axis=0), rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(m.mean.error, each.std(axis=0, ddof=1) / np.sqrt(RUNS), rtol=1e-7)
        np.testing.assert_allclose(m.rmse.value, np.sqrt((each**2).mean(axis=0)), rtol=1e-8)
        spread = (each**2).std(axis=0, ddof=1) / np.sqrt(RUNS) / (2 * m.rmse.value)
        np.testing.assert_allclose(m.rmse.error, spread, rtol=1e-5)
        np.testing.assert_allclose(m.within.value, (abs(each) <= 20.0).mean(axis=0), atol=1e-12)
        np.testing.assert_allclose(m.end, each[:, -1], rtol=1e-6, atol=1e-9)
        # The noise of another program may differ by the rounding of float32.
        np.testing.assert_allclose(m.window, np.sqrt((each[:, 3:] ** 2).mean(axis=1)), rtol=2e-6)
        assert m.undefined.max() == m.failed.max() == 0
        for value, p in zip(m.percentiles.value, PERCENTILES, strict=True):
            # Within a bin of the order statistics beside it.
            low, high = (np.percentile(abs(each), p, axis=0, method=side) for side in ("lower", "higher"))
            assert np.all((value > low / 1.02) & (value < high * 1.02)), p


def test_convergence_times(result, errors):
    for m, each in zip(result.methods.values(), errors, strict=True):
        for r, axis in ((0, 2), (7, 2), (3, 0)):
            out = np.flatnonzero(abs(each[r, :, axis]) > 20.0)
            first = 0 if not len(out) else out[-1] + 1
            expected = np.inf if first == 6 else m.time_s[first]
            assert m.converged_s[r, axis] == expected
        share = m.share_converged.value
        np.testing.assert_allclose(share, (abs(each[:, -1]) <= 20.0).mean(axis=0))


def test_accuracy_and_ratio(result):
    one, two = result["oba"], result["roba"]
    square = one.window**2
    np.testing.assert_allclose(one.accuracy.value, np.sqrt(square.mean(axis=0)))
    np.testing.assert_allclose(
        one.accuracy.error, square.std(axis=0, ddof=1) / np.sqrt(RUNS) / (2 * one.accuracy.value)
    )
    ratio = two.ratio(one)
    np.testing.assert_allclose(ratio.value, two.accuracy.value / one.accuracy.value)
    rng = np.random.default_rng(0)
    draws = rng.integers(RUNS, size=(2000, RUNS))
    again = np.sqrt((two.window[draws] ** 2).mean(axis=1) / (one.window[draws] ** 2).mean(axis=1))
    np.testing.assert_allclose(ratio.error, again.std(axis=0), rtol=0.25)


@pytest.mark.slow
def test_one_run_can_be_had_again_as_a_log(made):
    """Run 3 of a study at sample fidelity is `measure` with its key."""
    study = Study(made, ["oba"], runs=4, seed=9, fidelity="samples")
    found = run(study)["oba"]
    exact = truth(made)
    dtheta, dvel, (velocity,) = eqx.filter_jit(measure)(exact, made, run_keys(jax.random.key(9), np.array([3]))[0])
    epochs = epochs_from_arrays(
        dtheta, dvel, velocity, dt=1 / 200.0, every=200, site=made.site, aid="body", aid_sd=made.aids[0].sd
    )
    expected = align(build("oba", "body"), epochs, every=10).euler_deg[-1]
    reference = np.rad2deg(euler_from_quat(quat_from_dcm(exact.C_nb[-1])))
    np.testing.assert_allclose(found.end[3], (expected - reference + 180) % 360 - 180, rtol=1e-6, atol=1e-9)


def test_an_aid_whose_noise_is_not_stated(made):
    """Estimated, as `align` does: with zero no vector would have a weight."""
    found = run(small(with_noise(made, 0.0)))
    assert np.abs(found["roba"].end[:, 2]).max() < 3 * np.abs(found["oba"].end[:, 2]).max()


def test_blocks_are_small_where_runs_are_large():
    long = Study(scenario("sway", duration=600.0), ["gravity_q"], runs=100_000, every=1)
    assert long.block < Study(scenario("dvl-sturn"), ["oba"], runs=100_000).block == 1024
    assert long.block >= 16


def test_perfect_sensors_are_no_trouble(made):
    found = run(small(noiseless(made), ["oba"]))["oba"]
    assert np.abs(found.end[:, :2]).max() < 1e-3
    assert np.abs(found.end[:, 2]).max() < 0.1  # the transport rate by attitudes up to ten epochs old
    assert np.isfinite(found.accuracy.value).all()


def test_runs_without_an_attitude_are_counted():
    """No aid for the first 25 s: no attitude at 10 and 20 s, which is in no error."""
    made = scenario("dvl-sturn", gaps=((0.0, 25.0),), **SHORT)
    found = run(small(made, ["oba"]))["oba"]
    np.testing.assert_array_equal(found.undefined, [1, 1, 0, 0, 0, 0])
    assert np.isnan(found.rmse.value[:2]).all()
    assert np.isfinite(found.rmse.value[2:]).all()
    assert np.isnan(found.percentiles.value[:, 0]).all()


@pytest.mark.slow
@pytest.mark.parametrize("record", ["dual_vector", "fine"])
def test_standing_vehicle_and_methods_with_their_own_epochs(record):
    made = scenario("disturbed", condition=1, duration=20.0)
    methods = {"velocity_q": build("velocity_q", "static", {"front_end.interval_samples": 2}), record: build(record)}
    found = run(Study(made, methods, runs=2, every=100))
    assert set(found.methods) == set(methods)
    for m in found.methods.values():
        np.testing.assert_allclose(m.time_s, [10, 20])
        assert np.abs(m.end[:, :2]).max() < 0.5


def raw_and_filtered():
    """A shaken base, and a method without and with a filter."""
    made = scenario("disturbed", amplitude_mg=10.0, duration=20.0)
    return made, {"raw": build("dual_vector"), "filtered": build("dual_vector", prefilter="vondrak")}


@pytest.mark.slow
def test_prefilters_in_a_study():
    found = run(Study(*raw_and_filtered(), runs=2, every=100, fidelity="samples"))
    assert np.isfinite(found["filtered"].end).all()
    assert np.any(found["raw"].end != found["filtered"].end)


def test_prefilters_need_samples():
    made, methods = raw_and_filtered()
    with pytest.raises(UserError, match="--fidelity samples"):
        run(Study(made, methods, runs=2, every=100))
    quiet = dataclasses.replace(made, force=None)
    with pytest.raises(UserError, match="a prefilter looks at single IMU samples"):
        run(Study(quiet, methods, runs=2, every=100))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenario": "dvl-stern"}, "did you mean 'dvl-sturn'"),
        ({"scenario": 3}, "must be a Scenario or the name"),
        ({"methods": ["obba"]}, "did you mean"),
        ({"methods": "oba"}, "give a list of names"),
        ({"methods": []}, "at least one"),
        ({"methods": ["oba", "oba"]}, "named twice"),
        ({"methods": {"x": 3}}, "is no method"),
        ({"methods": ["fine"]}, "takes the vehicle as standing, but in dvl-sturn it moves"),
        ({"methods": {"x": build("oba", "nav")}}, "has no nav .* which is observed: it has body"),
        ({"runs": 1}, "runs = 1: must be a whole number from 2"),
        ({"runs": 2.5}, "runs = 2.5"),
        ({"seed": -1}, "seed = -1"),
        ({"every": 0}, "every = 0"),
        ({"every": 1000}, "every = 1000: must be a whole number from 1 to 60"),
        ({"fidelity": "coarse"}, "must be one of increments, samples"),
        ({"tolerance_deg": 0.0}, "must be a positive number of degrees"),
        ({"window": (50.0, 20.0)}, "no read-out is in it"),
        ({"window": (51.0, 59.0)}, "they come every 10 s until 60 s"),
        ({"window": (60.0, 70.0)}, "they come every 10 s until 60 s"),
        ({"window": 3}, "two times in s"),
        ({"chunk": 0}, "chunk = 0"),
    ],
)
def test_bad_input(change, message):
    how = {"chunk": change.pop("chunk")} if "chunk" in change else {}
    given = {"scenario": scenario("dvl-sturn", **SHORT), "methods": ["oba"], "runs": 4, **change}
    with pytest.raises(UserError, match=message) as found:
        run(Study(**given), **how)
    assert "\n" not in str(found.value)


def test_settings_are_json_and_whole(study):
    settings = json.loads(json.dumps(study.settings))
    assert settings["seed"] == 4
    assert settings["methods"]["roba"]["weight"]["threshold"] == 2.5
    assert settings["scenario"]["aids"][0]["faults"][0] == {
        "kind": "FixedOutliers",
        "probability": 0.02,
        "factor": 300.0,
        "single_axis": False,
        "first": "never",
    }
    assert described({"a": np.float64(1.0), "b": (1, None)}) == {"a": 1.0, "b": [1, None]}


def test_files(result, tmp_path):
    from PIL import Image

    paths = write(result, tmp_path, plot=True)
    assert [p.name for p in paths] == ["results.npz", "results.csv", "results.md", "results.png"]
    with np.load(paths[0], allow_pickle=False) as file:
        np.testing.assert_array_equal(file["rmse_deg"][1], result["roba"].rmse.value)
        assert file["percentiles_deg"].shape == (2, 3, 6, 3)
        assert json.loads(str(file["settings"]))["runs"] == RUNS
    lines = paths[1].read_text().splitlines()
    assert lines[0].startswith("method,time_s,angle,mean_deg,mean_deg_se,rmse_deg")
    assert len(lines) == 1 + 2 * 6 * 3
    cells = dict(zip(lines[0].split(","), lines[-1].split(","), strict=True))
    assert (cells["method"], cells["time_s"], cells["angle"]) == ("roba", "60", "yaw")
    np.testing.assert_allclose(float(cells["rmse_deg"]), result["roba"].rmse.value[-1, 2], rtol=1e-6)
    text = paths[2].read_text()
    assert "| oba |" in text
    assert f"{RUNS} runs, seed 4" in text
    with Image.open(paths[3]) as picture:
        assert picture.size[0] > 500


def test_percentiles_of_many_runs():
    """Against a known distribution: the bins cost less than half a percent."""
    from jaxalign.study.block_sums import bin_edges
    from jaxalign.study.statistics import _percentiles

    errors = abs(np.random.default_rng(0).standard_normal(200_000))
    bins = np.histogram(errors, bin_edges())[0][None, None]
    found = _percentiles(bins, np.array([200_000]))
    expected = np.percentile(errors, PERCENTILES)
    np.testing.assert_allclose(found.value[:, 0, 0], expected, rtol=5e-3)
    assert np.all(abs(found.value[:, 0, 0] - stats.halfnorm.ppf([0.5, 0.95, 0.99])) < 4 * found.error[:, 0, 0] + 5e-3)


def test_convergence_of_few():
    """More than half never converge: the median is infinite and says so."""
    some = np.full((10, 3), np.inf)
    some[:4] = 20.0
    zeros = np.zeros((10, 3))
    m = MethodStatistics(np.array([10.0, 20.0]), 10, *(None,) * 6, zeros, zeros, some)
    assert np.isinf(m.convergence.value).all()
    np.testing.assert_allclose(m.share_converged.value, 0.4)


def test_a_list_of_durations():
    with pytest.raises(UserError, match="duration: must be one number"):
        scenario("dvl-sturn", duration=[60, 60])


@pytest.mark.slow
def test_both_fidelities_agree_in_distribution():
    """Independent runs: the same spread of the errors in every angle, as far as 1500 runs can tell."""
    made = scenario("dvl-sturn")
    one = run(Study(made, ["oba", "centred_oba"], runs=1500, seed=1))
    two = run(Study(made, ["oba", "centred_oba"], runs=1500, seed=2, fidelity="samples"))
    for label in ("oba", "centred_oba"):
        a, b = one[label], two[label]
        for i in range(3):
            assert stats.ks_2samp(a.end[:, i], b.end[:, i]).pvalue > 1e-3
        difference = a.accuracy.value - b.accuracy.value
        assert np.all(abs(difference) < 3.5 * np.hypot(a.accuracy.error, b.accuracy.error))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "window", "label", "expected", "sigma"),
    [
        ("dvl-sturn", (250.5, 300.0), "oba", 0.896, 0.016),
        ("dvl-sturn", (250.5, 300.0), "centred_oba", 0.238, 0.0035),
        ("gps-zigzag", (150.0, 250.0), "oba", 3.19, 0.06),
        ("gps-zigzag", (150.0, 250.0), "unit", 15.46, 0.29),
        ("gps-zigzag", (150.0, 250.0), "centred_oba", 1.00, 0.015),
    ],
)
def test_reference_figures(name, window, label, expected, sigma):
    """Of 1500 independent runs each (yaw RMSE, transport rate on), at 2000 of ours: within three standard errors."""
    aid = {"dvl-sturn": "body", "gps-zigzag": "nav"}[name]
    parameters = {"estimate.normalise": True} if label == "unit" else {}
    method = build("oba" if label == "unit" else label, aid, parameters)
    found = run(Study(scenario(name), {label: method}, runs=2000, every=1, window=window))[label].accuracy
    assert abs(found.value[2] - expected) < 3 * np.hypot(found.error[2], sigma)
