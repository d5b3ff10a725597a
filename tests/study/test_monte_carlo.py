"""Reference figures of 1500 independent runs, at sample-rate noise: within three combined standard errors."""

import numpy as np
import pytest

from experiments.monte_carlo import monte_carlo
from experiments.statistics import mean, per_run, rms
from jaxalign.methods import build
from jaxalign.simulate import scenario

RUNS, REFERENCE_RUNS = 400, 1500

pytestmark = pytest.mark.slow


def headings(name, recipes, first_s, runs=RUNS, every=1, **options):
    """Label -> (runs, rows) heading errors (deg) after a time; recipes: label -> (name, aid, parameters)."""
    methods = {label: build(*choice) for label, choice in recipes.items()}
    found = monte_carlo(scenario(name, **options), methods, runs, seed=5, every=every, chunk=50)
    return {label: errors.phi[:, errors.time > first_s, 2] for label, errors in found.items()}


def assert_rms(errors, expected, sigma):
    ours = rms(errors)
    assert abs(ours.value - expected) < 3 * np.hypot(ours.error, sigma), (ours, expected)


def assert_quantile(errors, q, expected):
    """Of the runs' own RMS; its standard error by bootstrap, the reference's by the numbers of runs."""
    each, rng = per_run(errors), np.random.default_rng(0)
    draws = [np.quantile(rng.choice(each, len(each)), q) for _ in range(500)]
    sigma = np.std(draws) * np.sqrt(1 + len(each) / REFERENCE_RUNS)
    assert abs(np.quantile(each, q) - expected) < 3 * sigma, (np.quantile(each, q), sigma)


def test_dvl_sturn():
    recipes = {name: (name, "body") for name in ("oba", "centred_oba")}
    found = headings("dvl-sturn", recipes, 250.5)
    assert_rms(found["oba"], 0.896, 0.016)
    assert_rms(found["centred_oba"], 0.238, 0.0035)


def test_dvl_sturn_with_outliers():
    """2 % of the fixes, 300 times the noise: a few runs rule the RMS of oba and moba, and may rule that of rkf_oba."""
    recipes = {name: (name, "body") for name in ("oba", "roba", "moba", "rkf_oba")}
    found = headings("dvl-sturn", recipes, 250.5, outliers="fixed")
    assert_rms(found["oba"], 5.86, 0.11)
    assert_rms(found["roba"], 0.897, 0.015)
    assert_rms(found["moba"], 3.61, 0.11)
    assert_quantile(found["rkf_oba"], 0.5, 0.64)
    assert_quantile(found["rkf_oba"], 0.95, 1.75)


def test_gps_zigzag():
    recipes = {
        "oba": ("oba", "nav"),
        "unit": ("oba", "nav", {"estimate.normalise": True}),
        "optimal": ("optimal_request", "nav"),
        "centred_oba": ("centred_oba", "nav"),
    }
    found = headings("gps-zigzag", recipes, 149.5)
    assert_rms(found["oba"], 3.19, 0.06)
    assert_rms(found["unit"], 15.46, 0.29)
    assert_rms(found["centred_oba"], 1.00, 0.015)
    # Optimal-REQUEST with the physical noise is the q-method but for |alpha| in the place of |beta|.
    assert_rms(found["optimal"], 3.19, 0.06)
    assert rms(found["optimal"] - found["oba"]).value < 0.05 * rms(found["oba"]).value


def test_sway():
    """Equal positive biases leave 0.208 deg of yaw; with random signs the mean is none and the RMS 0.22."""
    recipes = {"gravity_q": ("gravity_q", "static", {"front_end.interval_samples": 2})}
    fixed = mean(-headings("sway", recipes, 500.5, 100, every=500)["gravity_q"])
    assert abs(fixed.value - 0.208) < 3 * np.hypot(fixed.error, 0.0016)
    random = headings("sway", recipes, 500.5, 200, every=500, bias="sign")["gravity_q"]
    middle = mean(random)
    assert abs(middle.value) < 3 * middle.error
    assert_rms(random, 0.22, 0.22 / np.sqrt(2 * REFERENCE_RUNS))
