"""Names of parameters that have changed are answered with the new one."""

import pytest

from jaxalign import UserError, build
from jaxalign.method_file import read_method

OLD = [
    ("robust_map", "outliers", "outlier_probability", 0.1),
    ("robust_map", "spread", "outlier_ratio", 30.0),
    ("robust_map", "starts", "headings", 4),
    ("robust_map", "noise", "aid_noise", "stated"),
    ("optimal_request", "estimate.process", "estimate.process_variance", 1e-4),
    ("optimal_request", "estimate.noise", "estimate.measurement_noise", "constant"),
    ("vo_tvk", "estimate.prior", "estimate.prior_variance", 1.0),
    ("rkf_oba", "reconstruct.process", "reconstruct.process_variance", 1e-6),
    ("rkf_oba", "reconstruct.prior", "reconstruct.prior_variance", 1e8),
    ("rkf_oba", "reconstruct.gamma", "reconstruct.threshold", 2.0),
    ("roba", "weight.gamma", "weight.threshold", 2.0),
    ("moba", "weight.gamma", "weight.exponent", 3.0),
]


@pytest.mark.parametrize(("recipe", "old", "new", "value"), OLD)
def test_old_name_is_told_the_new_one(recipe, old, new, value):
    with pytest.raises(UserError, match=rf"^{old} is now called {new}: write that instead$"):
        build(recipe, parameters={old: value})
    build(recipe, parameters={new: value})


def test_old_option_of_a_recipe():
    with pytest.raises(UserError, match="starts is now called headings"):
        build("robust_map", starts=4)


def test_old_method_file(tmp_path):
    path = tmp_path / "old.json"
    path.write_text(
        '{"method": "roba", "aids": [{"kind": "body"}], "prefilter": null, "parameters": {"weight.gamma": 2}}'
    )
    with pytest.raises(UserError, match=r"old.json: weight.gamma is now called weight.threshold"):
        read_method(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("scale_sd", "priors.body.scale"),
        ("mounting_sd_deg", "priors.body.mounting_deg"),
        ("slow_time", "priors.body.slow_seconds"),
        ("imu.gyro_bias_deg_h", "imu.gyro.bias_deg_h"),
        ("imu.accel_noise_ug_sqrt_hz", "imu.accel.density_ug_sqrt_hz"),
    ],
)
def test_old_figures_of_robust_map(old, new):
    with pytest.raises(UserError, match=rf"^{old} is now called {new}: write that instead$"):
        build("robust_map", parameters={old: 1.0})
    build("robust_map", parameters={new: 0.01 if old != "slow_time" else 300.0})


def test_old_figures_of_fine():
    with pytest.raises(UserError, match=r"filter.gyro_bias_deg_h is now called filter.imu.gyro.bias_deg_h"):
        build("fine", aid="static", parameters={"filter.gyro_bias_deg_h": 1.0})


def test_names_are_separated_by_commas():
    with pytest.raises(UserError, match="write latency,lever"):
        build("robust_map", parameters={"calibrate": "latency+lever"})


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"aid": "nav", "parameters": {"calibrate": "mounting"}}', '"calibrate": "scale,mounting" in place of'),
        ('{"method": "oba", "aids": null, "prefilter": null, "parameters": {}}', "aids is None: a list of aids"),
        ('{"method": ["oba"], "aids": [], "prefilter": null, "parameters": {}}', "method is .*: a name"),
        ('{"method": "oba", "aids": [], "prefilter": null, "parameters": []}', "parameters is .*: a table"),
        ('{"method": "oba", "aids": [], "prefilter": null}', "no entry 'parameters'"),
        ("[1, 2]", "no table of entries"),
        ("{", "no JSON"),
    ],
)
def test_no_method_file(tmp_path, text, says):
    path = tmp_path / "method.json"
    path.write_text(text)
    with pytest.raises(UserError, match=says):
        read_method(path)
