"""Every tunable number of every recipe has a derivative: forward = reverse = central differences at two step sizes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import OWN, RECIPES, contract_of
from slopes import Slopes

from jaxalign.methods import build
from jaxalign.parametrization import tunables
from jaxalign.tune import space_of

# What each recipe is set to, so that all its numbers have an effect and none is zero; then what may be tuned.
# rkf_oba with a lower prior: at 1e10 the rounding of the covariance hides the derivative by it (1e-3 of it);
# with a low threshold few innovations are near the corner of the weight.
IMU = "gyro.bias_deg_h gyro.walk_deg_sqrt_h gyro.bias_walk_deg_h_sqrt_h accel.bias_ug accel.density_ug_sqrt_hz "
IMU = [f"imu.{x}" for x in (IMU + "accel.bias_walk_ug_sqrt_h").split()]
FINE = " ".join(["velocity_sd initial_velocity_sd initial_tilt_sd_deg initial_heading_sd_deg", *IMU])
UNIT_WALKS = {"imu.accel.bias_walk_ug_sqrt_h": 5.0, "imu.gyro.bias_walk_deg_h_sqrt_h": 0.05}
WALKS = {f"filter.{path}": x for path, x in UNIT_WALKS.items()}
CALIBRATED = {"calibrate": "scale,mounting,latency,lever,slow", "tolerance": 1e-9, "iterations": 60}
MAP = "scale mounting_deg latency lever slow slow_seconds"
MAP = ["outlier_probability", "outlier_ratio", *(f"priors.body.{x}" for x in MAP.split())]
POSITION = "position_sd initial_position_sd"
CONSTANT = {"estimate.measurement_noise": "constant"}
TABLE = [
    # recipe, settings, tunables with an effect, tunables without; recipes that are not here: as they are, all of them
    ("roba", {"weight.threshold": 1.0}, "weight.threshold", ""),
    ("roba", {"weight.residual": "norm", "weight.threshold": 1.0}, "weight.threshold", ""),
    (
        "moba",
        {"weight.delta": 1.0, "weight.threshold": 0.8},
        "weight.exponent weight.delta",
        "weight.threshold weight.sharpness",
    ),
    (
        "moba",
        {"weight.delta": 1.0, "weight.threshold": 0.8, "weight.gate": "smooth"},
        "weight.exponent weight.delta weight.threshold weight.sharpness",
        "",
    ),
    (
        "moba",
        {"weight.delta": 1.0, "weight.threshold": 0.8, "weight.gate": "smooth", "weight.statistics": "inliers"},
        "weight.exponent weight.delta weight.threshold weight.sharpness",
        "",
    ),
    (
        "rkf_oba",
        {"reconstruct.prior_variance": 1e4, "reconstruct.threshold": 0.3},
        "reconstruct.threshold reconstruct.process_variance reconstruct.prior_variance",
        "",
    ),
    ("optimal_request", {"estimate.process_variance": 1e-9}, "estimate.process_variance", "estimate.variance"),
    (
        "optimal_request",
        {**CONSTANT, "estimate.process_variance": 1e-3},
        "estimate.process_variance estimate.variance",
        "",
    ),
    ("vo_tvk", {}, "estimate.kappa estimate.prior_variance", "estimate.variance"),
    ("vo_tvk", CONSTANT, "estimate.kappa estimate.prior_variance estimate.variance", ""),
    ("quaternion_kf", {}, "estimate.variance estimate.prior_variance", ""),
    ("quaternion_kf", {"estimate.measurement_noise": "fixed"}, "estimate.variance estimate.prior_variance", ""),
    (
        "rls_quaternion_kf",
        {"reconstruct.forgetting": 0.95},
        "reconstruct.forgetting reconstruct.prior_variance estimate.variance estimate.prior_variance",
        "",
    ),
    ("rls_q", {"reconstruct.forgetting": 0.95}, "reconstruct.forgetting reconstruct.prior_variance", ""),
    (
        "fine",
        WALKS,
        " ".join(f"filter.{x}" for x in FINE.split()) + " heading_margin",
        " ".join(f"filter.{x}" for x in POSITION.split()),
    ),
    (
        "fine",
        {**WALKS, "filter.form": "published"},
        " ".join(f"filter.{x}" for x in FINE.split()) + " heading_margin",
        " ".join(f"filter.{x}" for x in POSITION.split()),
    ),
    (
        "fine",
        {**WALKS, "filter.updates": "position"},
        " ".join(f"filter.{x}" for x in (FINE + " " + POSITION).split()) + " heading_margin",
        "",
    ),
    ("robust_map", {**CALIBRATED, **UNIT_WALKS}, " ".join([*IMU, *MAP]), ""),
    ("auto", {f"estimator.{path}": x for path, x in CALIBRATED.items()}, " ".join(f"estimator.{x}" for x in MAP), ""),
]
LISTED = {row[0] for row in TABLE}
TABLE += [(name, {}, " ".join(tunables(build(name))), "") for name in dict(OWN) if name not in LISTED]


def expanded():
    for name, settings, active, idle in TABLE:
        for row, aid in OWN:
            if row == name and (active or idle) and aid == RECIPES[name].aids[0].kind:
                label = "-".join([name, aid, *(str(x) for x in settings.values() if isinstance(x, str))])
                yield pytest.param(name, aid, settings, active.split(), idle.split(), id=label)


def test_the_table_is_whole():
    """Every tunable of every recipe has a row in which it has an effect."""
    for name in dict(OWN):
        known = set(tunables(build(name)))
        listed = {path for row in TABLE if row[0] == name for path in row[2].split()}
        assert listed == known, name


@pytest.mark.slow
@pytest.mark.parametrize(("name", "aid", "settings", "active", "idle"), list(expanded()))
def test_derivatives(name, aid, settings, active, idle):
    """60 epochs over 300 s; by relative changes of the numbers."""
    slopes = Slopes(name, aid, settings)
    assert set(slopes.paths) == {*active, *idle}
    value, reverse, _, gap = slopes.reverse(slopes.zero)
    assert np.isfinite(reverse).all()
    scale = np.maximum(np.abs(reverse), abs(value))
    # Each number by its own scale, so that each is compared as strictly.
    towards = np.where(np.arange(len(scale)) < 3, 0.0, (-1.0) ** np.arange(len(scale)) / scale)
    forward, along, reverse, scale = slopes.forward(slopes.zero, towards), reverse @ towards, reverse[3:], scale[3:]
    # An eigenvector is known to the rounding over its gap: 4e-11 rad where the gap is 5e-6 (vo_tvk), else below 1e-8. A
    # solution without one (robust_map) to that times the variance of the first velocity, 1e6 times that of a fix.
    contract = contract_of(name)
    rounding = np.finfo(float).eps * (1 / gap if gap > 0 else contract.free)
    assert abs(along - forward) <= 1e-8 + rounding * np.abs(towards).sum(), (along, forward)
    # Larger steps meet the corners of robust weights, smaller ones the rounding of an early eigenproblem.
    for h in contract.number_steps:
        numeric = np.array([slopes.difference(3 + i, h) for i in range(len(reverse))])
        assert np.all(np.abs(numeric - reverse) <= 1e-4 * scale + rounding / h), dict(
            zip(slopes.paths, zip(numeric, reverse, strict=True), strict=True)
        )
    for path, slope in zip(slopes.paths, reverse, strict=True):
        assert (slope != 0) == (path in active), path


@pytest.mark.slow
@pytest.mark.parametrize("where", ["low", "high"])
@pytest.mark.parametrize(
    ("name", "aid", "settings"),
    [
        ("roba", "body", {}),
        ("moba", "body", {}),
        ("moba", "body", {"weight.gate": "smooth"}),
        ("rkf_oba", "body", {}),
        ("request", "nav", {}),
        ("optimal_request", "nav", CONSTANT),
        ("vo_tvk", "nav", CONSTANT),
        ("vo_tvk", "nav", {}),
        ("quaternion_kf", "static", {"estimate.measurement_noise": "fixed"}),
        ("quaternion_kf", "static", {}),
        ("rls_quaternion_kf", "static", {}),
        ("fine", "static", WALKS),
        ("robust_map", "body", {"calibrate": "scale,mounting,latency,lever,slow", **UNIT_WALKS}),
    ],
)
def test_finite_at_the_bounds(name, aid, settings, where):
    """Values and derivatives with each number at a bound, the others as they are, and with all of them there."""
    slopes = Slopes(name, aid, settings, "rows")
    bounds = tunables(build(name, aid, settings))
    ends = np.array([bounds[path][0 if where == "low" else 1] for path in slopes.paths])
    for some in [*np.eye(len(ends), dtype=bool), np.ones(len(ends), bool)]:
        value, slope, *_ = slopes.reverse(slopes.zero, np.where(some, ends, slopes.numbers))
        assert np.isfinite(value)
        assert np.isfinite(slope).all(), (np.array(slopes.paths)[some], dict(zip(slopes.paths, slope[3:], strict=True)))


def test_free_numbers_stay_within_their_bounds():
    space = space_of(build("fine"), ["filter.velocity_sd", "filter.imu.accel.bias_ug", "heading_margin"])
    for size in (-50.0, -1.0, 0.0, 1.0, 50.0):
        values = space.values({path: jnp.asarray(size) for path in space.paths})
        for path, x in values.items():
            low, high = tunables(build("fine"))[path]
            assert low <= x <= high
            assert np.isclose(space.maps[path].free(x), size, rtol=1e-3) or abs(size) == 50
    start = space.values(space.origin)
    np.testing.assert_allclose(start["filter.velocity_sd"], 0.01, rtol=1e-12)
    slope = jax.jacfwd(lambda u: jnp.log(space.maps["filter.velocity_sd"](u)))(0.0)
    np.testing.assert_allclose(slope, 1.0, rtol=1e-12)
