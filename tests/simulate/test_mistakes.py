"""What people get wrong about a log: closed forms, what undoes itself, and what a log says to it."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from logs import DT, EPOCHS, EVERY, LAT, fields, log_of

from jaxalign.aids import Axes, BodyVelocity, Heading, NavVelocity, NonHolonomic
from jaxalign.earth import EARTH_RATE
from jaxalign.errors import UserError
from jaxalign.measurements import Measurements
from jaxalign.rotation import dcm_from_euler
from jaxalign.simulate import MISTAKES, with_mistake
from jaxalign.simulate.mistakes import (
    NEEDED,
    OTHER_UP,
    QUARTER,
    aid_clock_drifts,
    aid_late,
    aid_scaled,
    heading_turned,
    imu_axes,
    imu_clock,
    imu_scaled,
    place_moved,
    samples_lost,
    unit_turned,
    velocity_axes,
    velocity_turned,
)

PAGE = (Path(__file__).parents[2] / "docs" / "faults.md").read_text()
SECONDS = EPOCHS * EVERY * DT
TIME = np.arange(EPOCHS + 1.0)


def values(*shape):
    return np.random.default_rng(shape[-1]).normal(size=(EPOCHS + 1, *shape))


def moving(**changes):
    """A level unit, and aids of all kinds."""
    nav, body = values(3), values(3)[::-1].copy()
    nav[3, 0] = np.nan
    aids = (
        Measurements(NavVelocity(), TIME, nav, 0.1),
        Measurements(BodyVelocity(), TIME, body),
        Measurements(BodyVelocity(components=("forward",), name="odometer"), TIME, values(1)),
        Measurements(NonHolonomic(), TIME, np.zeros((EPOCHS + 1, 2))),
        Measurements(Heading(), TIME, np.linspace(0.1, 6.0, EPOCHS + 1)),
    )
    rng = np.random.default_rng(5)
    noise = {"dtheta": rng.normal(size=(EPOCHS * EVERY, 3)) * 1e-5}
    turned = np.array(dcm_from_euler(np.column_stack([0 * TIME, 0 * TIME, 0.01 * TIME])))
    own = {"aid": "static", "velocity": None, "aids": aids, "C_nb": turned, "lon": 0.2}
    return log_of(**fields(**own | noise | changes))


def same(one, other, atol=1e-15):
    for key in ("dtheta", "dvel", "dt", "lat", "lon", "C_nb"):
        np.testing.assert_allclose(getattr(one, key), getattr(other, key), rtol=0, atol=atol)
    for a, b in zip(one.aids, other.aids, strict=True):
        np.testing.assert_allclose(a.time, b.time, atol=1e-12)
        np.testing.assert_allclose(a.value, b.value, atol=1e-14)


@pytest.mark.parametrize("name", sorted(MISTAKES))
def test_it_is_a_log_and_another(name):
    """Each changes something, leaves the reference with its samples, and all that it does not speak of."""
    log = moving()
    made = with_mistake(log, name)
    assert MISTAKES[name].fits(log)
    changed = [
        key for key in ("dtheta", "dvel", "dt", "lat") if not np.array_equal(getattr(log, key), getattr(made, key))
    ]
    aids = [
        a.name
        for a, b in zip(log.aids, made.aids, strict=True)
        if not (np.array_equal(a.value, b.value, equal_nan=True) and np.array_equal(a.time, b.time))
    ]
    assert changed or aids
    if name != "samples-lost":
        np.testing.assert_array_equal(made.C_nb, log.C_nb)
    if name.startswith(("gyro", "accel", "unit", "lat")):
        assert not aids
    assert "non-holonomic" not in aids or MISTAKES[name].needs == "an aid" or name == "samples-lost"


@pytest.mark.parametrize(
    "name",
    [
        "gyro-signs",
        "gyro-y-sign",
        "accel-signs",
        "unit-turned-180",
        "unit-upside-down",
        "unit-mirrored",
        "gyro-mirrored",
        "velocity-sign",
        "north-east-up",
        "ned",
        "frd",
        "heading-from-east",
        "latitude-sign",
        "lat-lon",
    ],
)
def test_twice_is_none(name):
    log = moving()
    same(with_mistake(with_mistake(log, name), name), log)


def test_a_turned_unit_is_the_right_log_of_its_axes():
    """Earth's rate and gravity in the axes of the unit: C_nu = C_nb C_bu, here C_nb = 1."""
    made = unit_turned(moving(**fields(aids=())), 70.0, 20.0, -30.0)
    c_nu = np.asarray(dcm_from_euler(np.deg2rad([20.0, -30.0, 70.0])))
    rate = EARTH_RATE * np.array([0.0, np.cos(LAT), np.sin(LAT)])
    np.testing.assert_allclose(made.dtheta, np.tile(c_nu.T @ rate * DT, (EPOCHS * EVERY, 1)), atol=1e-15)
    np.testing.assert_allclose(made.dvel[0], c_nu.T @ [0.0, 0.0, 9.8 * DT], atol=1e-12)
    log = moving()
    same(imu_axes(log, QUARTER), unit_turned(log, 90.0))
    same(unit_turned(unit_turned(log, 35.0), -35.0), log)


def test_a_log_that_is_made_anew_is_checked_anew():
    """Warnings of what the data show come and go; those that were given stay."""
    log = moving(warnings=("the odometer slips",))
    down = with_mistake(log, "unit-upside-down")
    assert [w.split(":")[0] for w in down.warnings] == ["the odometer slips", "mean specific force is along -z"]
    assert with_mistake(down, "unit-upside-down").warnings == log.warnings
    with pytest.raises(UserError, match=r"\|f\| = 98 m/s\^2, expected about 9.8"):
        imu_scaled(log, 10.0, "accel")
    with pytest.raises(UserError, match=r"deg/s given as rad/s"):
        with_mistake(
            log_of(
                **fields(
                    aid="static",
                    velocity=None,
                    dtheta=np.repeat(fields()["dtheta"], 2, axis=0),
                    dvel=np.repeat(fields()["dvel"], 2, axis=0),
                    C_nb=None,
                )
            ),
            "gyro-deg",
        )


def test_velocities():
    """Slots of NED and FRD; a missing component spoils only what it is in; noise as stated."""
    log = moving()
    nav, body, odometer = (one.value for one in log.aids[:3])
    np.testing.assert_array_equal(with_mistake(log, "ned").aids[0].value, nav[:, [1, 0, 2]] * [1, 1, -1])
    np.testing.assert_array_equal(with_mistake(log, "frd").aids[1].value, body[:, [1, 0, 2]] * [1, 1, -1])
    np.testing.assert_array_equal(with_mistake(log, "frd").aids[0].value, nav)
    knots = with_mistake(log, "knots")
    np.testing.assert_allclose(knots.aids[2].value * 0.514444, odometer, rtol=1e-6)
    assert knots.aids[0].sd == 0.1
    np.testing.assert_allclose(with_mistake(log, "km-h").aids[0].value, 3.6 * nav)
    np.testing.assert_allclose(with_mistake(log, "ft-s").aids[1].value * 0.3048, body)
    turned = velocity_turned(log, 30.0).aids[1].value  # its forward axis looks 30 deg to the left
    np.testing.assert_allclose(turned[:, 1], np.cos(np.pi / 6) * body[:, 1] - 0.5 * body[:, 0], atol=1e-14)
    same(velocity_turned(velocity_turned(log, 30.0), -30.0), log)


def test_headings():
    """From east, counter-clockwise: 90 deg minus what a compass says."""
    log = moving()
    seen = heading_turned(log, -1.0, 90.0).aids[4].value
    np.testing.assert_allclose(np.exp(1j * seen), 1j * np.exp(-1j * log.aids[4].value), atol=1e-12)


def test_clocks():
    """Stamps move, values go with them, what is outside the record is cut off."""
    log = moving()
    late, early = aid_late(log, 1.5), aid_late(log, -1.5)
    np.testing.assert_allclose(late.aids[1].time, np.arange(1.5, SECONDS))
    np.testing.assert_array_equal(late.aids[1].value, log.aids[1].value[:-2])
    np.testing.assert_allclose(early.aids[1].time, np.arange(0.5, SECONDS - 1.0))
    np.testing.assert_array_equal(early.aids[1].value, log.aids[1].value[2:])
    np.testing.assert_allclose(aid_clock_drifts(log, 10.0).aids[0].time, 1.1 * np.arange(19))
    slow = imu_clock(log, 2.0)  # rates stay, turns and the record grow
    assert (slow.dt, slow.epochs) == (1.02 * DT, EPOCHS)
    np.testing.assert_allclose(slow.dvel / slow.dt, log.dvel / log.dt)
    np.testing.assert_allclose(slow.dtheta, 1.02 * log.dtheta)
    np.testing.assert_array_equal(slow.aids[0].time, TIME)
    pulses = imu_clock(log, -10.0, "increments")
    np.testing.assert_array_equal(pulses.dtheta, log.dtheta)
    np.testing.assert_array_equal(pulses.aids[0].time, np.arange(19))
    assert any("% off gravity" in text for text in pulses.warnings)
    still = moving(aids=())
    assert imu_clock(still, 1.0).dt == 1.01 * DT


def test_lost_samples():
    """Of the unit and the reference; an aid that measures at epochs is late from then on."""
    log = moving()
    made = samples_lost(log, 5.0, 3.0)
    assert made.epochs == EPOCHS - 3
    np.testing.assert_array_equal(made.dtheta, np.delete(log.dtheta, np.s_[5 * EVERY : 8 * EVERY], 0))
    np.testing.assert_array_equal(made.C_nb[[5, 6]], log.C_nb[[5, 9]])
    np.testing.assert_array_equal(made.aids[1].value, log.aids[1].value[:-3])
    for start, seconds in ((-1.0, 3.0), (5.0, 0.2), (18.0, 3.0)):
        with pytest.raises(UserError, match=r"choose whole epochs of 1 s within the 20 s"):
            samples_lost(log, start, seconds)


def test_places():
    log = moving()
    assert with_mistake(log, "latitude-sign").lat == -LAT
    assert (with_mistake(log, "lat-lon").lat, with_mistake(log, "lat-lon").lon) == (0.2, LAT)
    south = dataclasses.replace(log, lat=-0.9)
    for one in (log, south):
        np.testing.assert_allclose(abs(one.lat) - abs(with_mistake(one, "latitude-off").lat), np.deg2rad(10.0))
    with pytest.raises(UserError, match=r"undefined here|looks like degrees"):
        place_moved(log, degrees=57.5)
    with pytest.raises(UserError, match="latitude is 2"):
        with_mistake(dataclasses.replace(log, lon=2.0), "lat-lon")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda log: with_mistake(log, "nedd"), "unknown mistake 'nedd'; did you mean 'ned'"),
        (
            lambda log: with_mistake(log, "knots"),
            "this mistake needs an aid that measures a velocity; its aids: heading",
        ),
        (lambda log: velocity_axes(log, OTHER_UP, Axes.NAV), "needs an aid with a whole velocity in n"),
        (lambda log: aid_late(log, 30.0), "no value of heading is left within the record: choose a smaller mistake"),
        (lambda log: aid_late(log, "x"), "mistake: seconds is 'x': it must be one finite number"),
        (lambda log: aid_clock_drifts(log, -100.0), "a clock that stands or runs backwards"),
        (lambda log: imu_axes(log, np.eye(2)), r"matrix has the shape \(2, 2\): \(3, 3\) is expected"),
        (lambda log: imu_scaled(log, 1.0, "accels"), "triad = 'accels': must be one of gyro, accel, both"),
        (lambda log: imu_clock(log, 1.0, "rate"), "of = 'rate': must be one of rates, increments"),
        (lambda log: aid_late(log.only(), 1.0), "this mistake needs an aid; its aids: none: the vehicle stands"),
        (lambda log: aid_scaled(log.only(), 1.0), "needs an aid that measures a velocity; .*the vehicle stands"),
    ],
)
def test_a_slip(change, message):
    log = moving().only("heading")
    with pytest.raises(UserError, match=message) as found:
        change(log)
    assert "\n" not in str(found.value)


def test_the_page_has_all():
    """Names, what they are, and where they hide."""
    rows = {name: rest for name, *rest in re.findall(r"^\| `([\w.-]+)` \| (.*?) \| (.*?) \|$", PAGE, flags=re.M)}
    for name, one in MISTAKES.items():
        assert rows[name] == [one.about, one.hidden or "never"], name
        assert one.needs in ("", *NEEDED)
        assert "\n" not in one.about
