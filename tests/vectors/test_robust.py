"""What each robust recipe survives on the S-turns with a DVL, and what it does not.

Twelve runs per condition; outliers are 300 times the noise unless said. Bounds on the median and on the largest of the
runs' heading errors (rms of the last 50 s, deg), which are 0.6 and 2 on clean data.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from logs import with_noise

from jaxalign import Vec3
from jaxalign.methods import build
from jaxalign.rotation import attitude_error, quat_from_dcm
from jaxalign.simulate import FixedOutliers, Gap, aid_values, intervals_of, measure_epochs, scenario, truth

RUNS = 12
ROBUST = ("roba", "moba", "rkf_oba")


@functools.cache
def base():
    """Scenario, truth, keys of the runs, and their epochs: all methods and faults see the same increments."""
    made = scenario("dvl-sturn")
    exact = truth(made)
    keys = jax.random.split(jax.random.key(12), RUNS)
    draw = eqx.filter_jit(jax.vmap(measure_epochs, (None, None, 0)))
    return made, exact, keys, draw(intervals_of(exact, made.epoch_samples), made, keys)


def measured(*faults):
    """Epochs with the fixes of the aid."""
    made, exact, keys, epochs = base()
    made = with_noise(made, faults=faults)
    velocity = np.asarray(jax.jit(jax.vmap(lambda key: aid_values(exact, made, key)[0]))(keys))
    known = np.isfinite(velocity).all(axis=2)
    fixes = Vec3.of(np.where(known[..., None], velocity, 0.0))
    return eqx.tree_at(lambda e: e.rows, epochs, epochs.rows.with_velocity(fixes, known))


def heading_errors(name, epochs):
    """(runs,) rms over the last 50 s, where everything is finite."""
    end, finite = solve(name)(epochs, quat_from_dcm(base()[1].C_nb))
    assert np.asarray(finite).all()
    return np.asarray(end)


ZERO_START = {"reconstruct.drop_constant": True, "reconstruct.process_variance": 1e-8}


@functools.cache
def solve(name):
    method = build("rkf_oba", "body", ZERO_START) if name == "zero start" else build(name, "body")

    def run(epochs, reference):
        found = method.solve(epochs, 1)
        error = jnp.rad2deg(attitude_error(found.q_nb, reference)[251:, 2])
        finite = jax.tree.reduce(lambda a, b: a & jnp.all(jnp.isfinite(b)), found, jnp.array(True))
        return jnp.sqrt(jnp.mean(error**2)), finite

    return jax.jit(jax.vmap(run, in_axes=(0, None)))


@pytest.mark.parametrize(
    ("condition", "faults", "median", "largest"),
    [
        ("clean", (), dict.fromkeys(ROBUST, 1.0), dict.fromkeys(ROBUST, 2.0)),
        (
            "gaps of 10 s",
            (Gap(30, 40), Gap(90, 100), Gap(165, 175)),
            dict.fromkeys(ROBUST, 1.0),
            dict.fromkeys(ROBUST, 2.0),
        ),
        # The history from which MOBA learns what is normal holds the outliers too: 10 deg at 10 %.
        ("10 %", (FixedOutliers(0.1),), {"roba": 1.0, "rkf_oba": 1.0, "moba": 15.0}, {"roba": 2.0}),
        # Of twelve runs one or two begin with an outlier: those are lost to rkf_oba.
        ("30 %", (FixedOutliers(0.3),), {"roba": 1.0, "rkf_oba": 3.0, "moba": 40.0}, {"roba": 2.0}),
        # MOBA looks at lengths only, and those are vertical: it does not see a horizontal axis.
        (
            "one axis",
            (FixedOutliers(0.02, single_axis=True),),
            {"roba": 1.0, "rkf_oba": 1.0, "moba": 4.0},
            {"roba": 2.0},
        ),
        # A bad first velocity stands in every vector: none of the three survives it.
        ("first", (FixedOutliers(0.0, first="always"),), {}, {}),
    ],
)
@pytest.mark.parametrize("name", ["roba", *(pytest.param(x, marks=pytest.mark.slow) for x in ROBUST[1:])])
def test_conditions(condition, faults, median, largest, name):
    found = heading_errors(name, measured(*faults))
    if condition == "first":
        assert np.median(found) > 20
        return
    assert np.median(found) < median[name], found
    assert found.max() < largest.get(name, np.inf), found


def test_plain_oba_survives_none_of_it():
    assert np.median(heading_errors("oba", measured(FixedOutliers(0.1)))) > 5


def test_centred_oba_survives_a_bad_first_velocity():
    """As one outlier of 301, weighted like the others."""
    clean, first = (
        heading_errors("centred_oba", measured()),
        heading_errors("centred_oba", measured(FixedOutliers(0.0, first="always"))),
    )
    assert np.median(clean) < 0.3
    assert np.median(first) < 10


@pytest.mark.slow
def test_zero_start_survives_a_bad_first_velocity():
    """The constant that it drops is the first velocity's error."""
    assert np.median(heading_errors("zero start", measured(FixedOutliers(0.0, first="always")))) < 1.0
