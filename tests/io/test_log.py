import dataclasses
import re

import numpy as np
import pytest
from logs import DT, EPOCHS, EVERY, GOOD, LAT, fields, log_of, message, put, static

from jaxalign.earth import normal_gravity
from jaxalign.errors import UserError
from jaxalign.info import describe


def test_a_good_log_is_taken_as_it_is():
    log = log_of(**fields())
    assert log.epochs == EPOCHS
    assert log.duration == pytest.approx(20.0)
    assert log.warnings == ()
    np.testing.assert_array_equal(log.times, np.arange(21) * 1.0)
    np.testing.assert_array_equal(log.dtheta, fields()["dtheta"])
    assert log_of(**fields(aid="nav", velocity=np.zeros((EPOCHS + 1, 3)))).aids[0].name == "nav"


def test_integers_become_float64_and_trailing_samples_may_stay():
    base = fields()
    velocity = np.zeros((EPOCHS + 1, 3), int)
    extra = {key: np.vstack([base[key], base[key][:37]]) for key in ("dtheta", "dvel")}
    log = log_of(**(base | extra | {"velocity": velocity, "h": 20}))
    assert log.aids[0].value.dtype == np.float64
    assert log.epochs == EPOCHS
    assert isinstance(log.h, float)


BAD = {
    "one-dimensional": ({"dtheta": np.zeros(6000)}, ["dtheta", "(6000,)", "(N, 3)"]),
    "two columns": ({"dvel": GOOD["dvel"][:, :2]}, ["dvel", "(2000, 2)", "(N, 3)"]),
    "rows differ": ({"dvel": GOOD["dvel"][:-1]}, ["dtheta", "2000", "1999"]),
    "aid beyond the record": ({"velocity": np.zeros((22, 3))}, ["body has values from 0 to 21 s", "from 0 to 20 s"]),
    "no measurements": ({"aids": ("body",)}, ["aids must be Measurements"]),
    "float32": ({"dtheta": GOOD["dtheta"].astype(np.float32)}, ["dtheta", "float32", "float64", ".astype("]),
    "float16": ({"dvel": GOOD["dvel"].astype(np.float16)}, ["dvel", "float16", "float64", ".astype("]),
    "text": ({"dvel": GOOD["dvel"].astype(str)}, ["dvel", "numbers"]),
    "NaN run": (
        {"dtheta": put(GOOD["dtheta"], slice(300, 305), np.nan)},
        ["5 rows", "5 long", "row 300", "3 s"],
    ),
    "infinity": ({"dvel": put(GOOD["dvel"], (7, 2), np.inf)}, ["dvel", "1 rows", "row 7", "0.07 s"]),
    "a broken sample": ({"dvel": put(GOOD["dvel"], (7, 2), 1e5)}, ["dvel", "1e+05 m/s", "row 7", "0.07 s"]),
    "beyond floats": ({"dtheta": put(GOOD["dtheta"], (7, 2), 1e300)}, ["dtheta turns", "row 7"]),
    "NaN latitude": ({"lat": np.nan}, ["lat", "finite"]),
    "latitude array": ({"lat": np.zeros(4)}, ["lat", "(4,)", "one finite number"]),
    "latitude in degrees": ({"lat": 32.06}, ["latitude", "32.06", "degrees", "pi/180"]),
    "pole": ({"lat": np.radians(-89.6)}, ["-89.6", "89.5 deg"]),
    "longitude in degrees": ({"lon": 118.79}, ["longitude", "degrees"]),
    "height": ({"h": 380e3}, ["height", "380000"]),
    "dt zero": ({"dt": 0.0, "aid": "static"}, ["dt is 0", "seconds"]),
    "dt negative": ({"dt": -0.01, "aid": "static"}, ["dt is -0.01", "seconds"]),
    "dt a rate": ({"dt": 100}, ["dt is 100", "seconds", "Hz"]),
    "epoch_samples zero": ({"epoch_samples": 0, "aid": "static"}, ["epoch_samples = 0", "whole number"]),
    "epoch_samples broken": ({"epoch_samples": 2.5}, ["epoch_samples = 2.5", "whole number"]),
    "two epochs": ({"epoch_samples": 1000}, ["too short", "2 epoch intervals", "10 s"]),
    "tenth of a second": (
        {"dtheta": GOOD["dtheta"][:10], "dvel": GOOD["dvel"][:10], "epoch_samples": 2},
        ["too short", "5 epoch intervals", "1 s"],
    ),
    "reference shape": ({"C_nb": np.eye(3)}, ["C_nb", "(3, 3)", "(21, 3, 3)"]),
    "reference no rotation": (
        {"C_nb": put(GOOD["C_nb"], (6, 0, 1), 2e-6)},
        ["C_nb", "epoch 6", "no rotation"],
    ),
    "reference mirrored": ({"C_nb": put(GOOD["C_nb"], (3, 2, 2), -1.0)}, ["C_nb", "epoch 3", "no rotation"]),
}


@pytest.mark.parametrize("case", BAD)
def test_each_bad_field_has_its_message(case):
    changes, parts = BAD[case]
    text = message(**changes)
    for part in parts:
        assert part in text


def test_zero_velocity_outliers_and_a_partly_missing_reference_are_fine():
    velocity = np.zeros((EPOCHS + 1, 3))
    velocity[5] = 300.0
    velocity[7:9] = np.nan
    velocity[11, 2] = np.nan
    velocity[12] = np.nan
    log = log_of(**fields(velocity=velocity, C_nb=put(GOOD["C_nb"], 0, np.nan)))
    assert log.warnings == ()
    assert list(np.flatnonzero(log.aids[0].missing)) == [7, 8, 12]
    assert log.aids[0].partial
    assert np.isnan(log.aids[0].velocity[11]).all()


def test_mostly_missing_aid_is_told():
    velocity = put(GOOD["velocity"], slice(0, 15), np.nan)
    assert "missing at 15 of 21" in log_of(**fields(velocity=velocity)).warnings[0]


# --- parts of a log ---


def test_crop_snaps_to_epochs_and_keeps_everything_together():
    velocity = np.arange(3.0 * (EPOCHS + 1)).reshape(-1, 3)
    dtheta = GOOD["dtheta"] + 1e-9 * np.arange(EVERY * EPOCHS)[:, None]
    log = log_of(**fields(velocity=velocity, dtheta=dtheta, t0=100.0))
    part = log.crop(4.4, 9.6)
    assert part.epochs == 6
    np.testing.assert_array_equal(part.aids[0].value, velocity[4:11])
    np.testing.assert_array_equal(part.dtheta, dtheta[400:1000])
    np.testing.assert_allclose(part.times, 100.0 + np.arange(4, 11), rtol=0, atol=1e-12)
    assert part.C_nb.shape == (7, 3, 3)
    assert log.crop() is log
    assert log.crop(end=8).epochs == 8
    twice = log.crop(2, 15).crop(2, 6)
    np.testing.assert_array_equal(twice.aids[0].value, log.crop(4, 8).aids[0].value)
    np.testing.assert_allclose(twice.aids[0].time, np.arange(5.0), atol=1e-9)


@pytest.mark.parametrize(
    ("start", "end", "part"),
    [
        (-3, 10, "start is -3 s"),
        (0, 20.6, "end is 20.6 s"),
        (25, None, "start is 25 s, but the log runs from 0 to 20 s"),
        (5, 7, "too short: 2 epoch intervals"),
        (9, 4, "start 9 s is not before end 4 s"),
        (np.nan, 4, "start is nan"),
    ],
)
def test_crop_refuses(start, end, part):
    with pytest.raises(UserError, match=re.escape(part)):
        log_of(**fields()).crop(start, end)


def test_crop_finds_its_own_warnings_and_keeps_given_ones():
    velocity = put(GOOD["velocity"], slice(0, 15), np.nan)
    log = log_of(**fields(velocity=velocity, warnings=("told by the reader",)))
    assert len(log.warnings) == 2
    assert log.crop(15, 20).warnings == ("told by the reader",)
    # and making it again does not repeat them
    assert dataclasses.replace(log).warnings == log.warnings


def test_with_epochs():
    log = log_of(**static())
    finer = log.with_epochs(10)
    assert (finer.epochs, finer.epoch_samples, finer.C_nb) == (200, 10, None)
    turns = GOOD["C_nb"].copy()
    for k in range(EPOCHS + 1):
        c, s = np.cos(0.1 * k), np.sin(0.1 * k)
        turns[k, :2, :2] = [[c, -s], [s, c]]
    coarser = log_of(**static(C_nb=turns)).with_epochs(300)
    assert coarser.epochs == 6
    np.testing.assert_array_equal(coarser.C_nb, turns[:19:3])
    aided = log_of(**fields()).with_epochs(10)
    assert (aided.epochs, len(aided.aids[0].time)) == (200, 21)
    with pytest.raises(UserError, match="too short: 2 epoch"):
        log.with_epochs(1000)
    with pytest.raises(UserError, match="samples = 0"):
        log.with_epochs(0)


# --- describe ---


def test_describe_says_what_the_log_is():
    velocity = put(GOOD["velocity"], slice(3, 6), np.nan)
    velocity[9] = np.nan
    velocity[12] = [0.0, 3.0, 4.0]
    g = float(normal_gravity(LAT, 0.0))
    dvel = np.tile([0, 0, g * (1 + 1e-4) * DT], (EVERY * EPOCHS, 1))
    text = dict(describe(log_of(**fields(velocity=velocity, dvel=dvel, name="trial", aid_sd=0.01))))
    assert text["name"] == "trial"
    assert text["IMU"] == "100 Hz, 2000 samples"
    assert text["aid samples missing"] == "4 of 21, longest run 3 (3 s)"
    assert "largest 5.000 m/s" in text["aid speed"]
    assert text["aid noise"] == "0.01 m/s per axis"
    assert "+100 ppm" in text["median |f|"]
    assert text["mean gyro rate"] == "15.04 deg/h; Earth rate 15.04 deg/h"
    assert text["reference attitude"] == "at 21 of 21 epochs"
    assert text["warning"] == "none"


def test_describe_of_a_static_log_with_swapped_axes():
    text = dict(describe(log_of(**static(dvel=GOOD["dvel"][:, [2, 0, 1]], C_nb=None))))
    assert text["aid"] == "none: static"
    assert "aid speed" not in text
    assert "90.00 deg off" in text["mean f"]
    assert "along +x" in text["warning"]
    assert text["reference attitude"] == "no"
