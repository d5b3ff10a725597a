"""Scenarios of one's own from TOML files."""

import jax
import numpy as np
import pytest

from jaxalign import UserError
from jaxalign.simulate import scenario, scenario_file, simulate, truth

WHOLE = """
name = "harbour"
duration = 20.0
imu_rate = 100.0
epoch = 0.5
aid = "body"
aid_sd = 0.05
bias = "fixed"
[site]
lat_deg = 54.3
lon_deg = 10.1
[gyro]
bias_deg_h = [0.1, 0.2, 0.3]
walk_deg_sqrt_h = 0.005
[accel]
noise_ug = 100.0
[[faults]]
kind = "gap"
start = 3.0
stop = 5.0
[[faults]]
kind = "segment"
ends = [10.0, 20.0]
probability = [0.0, 0.1]
factor = [1.0, 50.0]
[trajectory]
pitch = 2.0
roll = { mean = 0.5, sines = [[3.0, 8.0, 90.0]] }
yaw = { mean = 10.0, ramps = [[-4.0, 4.0, 6.0]], steps = [[90.0, 15.0, 1.0]] }
[trajectory.velocity]
frame = "body"
forward = { mean = 3.0, sines = [[0.2, 10.0, 0.0]] }
"""


def written(folder, text):
    path = folder / "own.toml"
    path.write_text(text)
    return path


def test_whole(tmp_path):
    made = scenario_file(written(tmp_path, WHOLE))
    assert (made.name, made.aids[0].aid.kind, made.duration, made.imu_rate, made.epoch_samples) == (
        *("harbour", "body", 20.0, 100.0, 50),
    )
    np.testing.assert_allclose(np.rad2deg([made.site.lat, made.site.lon]), [54.3, 10.1])
    np.testing.assert_allclose(np.rad2deg(made.imu.gyro.bias) * 3600, [0.1, 0.2, 0.3])
    assert made.bias == "fixed"
    t = np.array([0.0, 5.0, 20.0])
    euler = made.trajectory.euler(t)
    np.testing.assert_allclose(np.rad2deg(euler.x), 2.0)
    np.testing.assert_allclose(np.rad2deg(euler.y), 0.5 + 3.0 * np.cos(2 * np.pi * t / 8.0))
    np.testing.assert_allclose(np.rad2deg(euler.z), [10.0, 6.0, 10.0 - 8.0 + 90.0], atol=0.01)
    np.testing.assert_allclose(made.trajectory.velocity(t).y, 3.0 + 0.2 * np.sin(2 * np.pi * t / 10.0))
    log = simulate(made, 1)
    assert np.isnan(log.aids[0].value[6:10]).all()
    assert log.epochs == 40


def test_from_a_named_one(tmp_path):
    text = 'base = "dvl-sturn"\nduration = 60.0\naid_sd = 0.3\noptions = { outliers = "fixed" }\n[site]\nlat_deg = 10.0'
    made, named = scenario_file(written(tmp_path, text)), scenario("dvl-sturn", outliers="fixed", duration=60.0)
    assert (made.name, made.duration, float(made.aids[0].sd)) == ("own", 60.0, 0.3)
    np.testing.assert_allclose(made.site.lat, np.deg2rad(10.0))
    for a, b in zip(
        jax.tree.leaves((made.trajectory, made.imu, made.aids[0].faults)),
        jax.tree.leaves((named.trajectory, named.imu, named.aids[0].faults)),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


def test_another_rate_keeps_the_epochs(tmp_path):
    made = scenario_file(written(tmp_path, 'base = "dvl-sturn"\nimu_rate = 100.0'))
    assert (made.imu_rate, made.epoch_samples) == (100.0, 100)


@pytest.mark.parametrize("motion", ["s_turn", "zigzag", "swaying_base", "static_base"])
def test_motions(tmp_path, motion):
    aid = "static" if motion.endswith("base") else "nav"
    text = f'duration = 20.0\nimu_rate = 50.0\nepoch = 1.0\naid = "{aid}"\nsite = {{ lat_deg = 1.0 }}\n'
    made = scenario_file(written(tmp_path, text + f'[motion]\nname = "{motion}"\n'))
    assert np.isfinite(truth(made).dtheta).all()


def test_a_shaken_base(tmp_path):
    text = 'base = "disturbed"\n[force]\namplitude_mg = 20.0\nfrequency = [2.0, 7.0]'
    np.testing.assert_allclose(scenario_file(written(tmp_path, text)).force.frequency, [2.0, 7.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("duration = 20.0", "durtion = 20.0"), "unknown key 'durtion'; did you mean 'duration'"),
        (("duration = 20.0", ""), "duration: missing"),
        (("duration = 20.0", 'duration = "long"'), "duration = 'long': must be a number"),
        (("epoch = 0.5", "epoch = 0.333"), "33.3 IMU samples at 100 Hz"),
        (('aid = "body"', 'aid = "dvl"'), "no aid 'dvl'"),
        (("lat_deg = 54.3", "lat = 54.3"), r"\[site\] unknown key 'lat'"),
        (("walk_deg_sqrt_h = 0.005", "walk = 0.005"), r"\[gyro\] unknown key 'walk'"),
        (("walk_deg_sqrt_h = 0.005", "walk_deg_sqrt_h = -1.0"), r"\[gyro\] .*at least 0"),
        (('bias = "fixed"', 'bias = "random"'), "kind of bias = 'random': must be one of"),
        (("walk_deg_sqrt_h = 0.005", 'bias = "sign"'), r"\[gyro\] bias: say once, above the tables, how runs draw"),
        (('kind = "gap"', 'kind = "hole"'), r"\[faults 1\] kind: unknown 'hole'"),
        (("stop = 5.0", ""), r"\[faults 1\] stop: missing"),
        (("sines = [[3.0, 8.0, 90.0]]", "sines = [[3.0, 8.0]]"), r"\[trajectory.roll\] sines: must be a list of three"),
        (("sines = [[3.0, 8.0, 90.0]]", "sines = [[3.0, 0.0, 90.0]]"), "period .* must be positive"),
        (("[[-4.0, 4.0, 6.0]]", "[[-4.0, 6.0, 4.0]]"), "the end must come after"),
        (('frame = "body"', 'frame = "bodi"'), r"frame: unknown 'bodi'; did you mean 'body'"),
        (("forward =", "course ="), r"\[trajectory.velocity\] unknown key 'course'"),
        (("pitch = 2.0", "pitch = true"), "trajectory.pitch = True: must be a number or a table"),
        (("[trajectory]", '[motion]\nname = "s_turn"\n[trajectory]'), "motion and trajectory: give one"),
        (("[site]", "[site"), "not a TOML file"),
    ],
)
def test_a_slip(tmp_path, change, message):
    text = WHOLE.replace(*change)
    assert text != WHOLE
    with pytest.raises(UserError, match=message) as found:
        scenario_file(written(tmp_path, text))
    assert "own.toml" in str(found.value)
    assert "\n" not in str(found.value)


def test_no_file(tmp_path):
    with pytest.raises(UserError, match="no such scenario file"):
        scenario_file(tmp_path / "none.toml")


def test_options_without_a_base(tmp_path):
    with pytest.raises(UserError, match="they belong to a named scenario"):
        scenario_file(written(tmp_path, WHOLE.replace('aid = "body"', 'aid = "body"\noptions = { bias = "sign" }')))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            'base = "car"\naid_sd = 0.1',
            r"the base has several aids \(odometer, .*\): write all of them as \[\[aids\]\]",
        ),
        ('base = "dvl-sturn"\naid = "heading"', r"aid_sd: missing: that of the base is in m/s, a heading is in rad"),
        (
            'base = "dvl-sturn"\n[[aids]]\nkind = "body"\nunknowns = { lever = [1.0, 2.0] }',
            "one number or 3 are expected",
        ),
        ('base = "dvl-sturn"\n[[aids]]\nkind = "body"\nunknown_sd = { scale = -1.0 }', "must be at least 0"),
        ('base = "dvl-sturn"\n[[aids]]\nkind = "body"\nsd = "0.1"', "expected a number"),
    ],
)
def test_what_an_aid_cannot_be(tmp_path, text, says):
    with pytest.raises(UserError, match=says):
        scenario_file(written(tmp_path, text))


def test_an_aid_of_the_base_keeps_what_is_not_given(tmp_path):
    made = scenario_file(written(tmp_path, 'base = "dvl-sturn"\n[[faults]]\nkind = "gap"\nstart = 1.0\nstop = 2.0'))
    (own,), (base,) = made.aids, scenario("dvl-sturn").aids
    assert (own.aid, own.stride, float(own.sd)) == (base.aid, base.stride, float(base.sd))
    assert len(own.faults) == 1
    assert scenario_file(written(tmp_path, 'base = "dvl-sturn"\naid = "nav"')).aids[0].sd == base.sd
