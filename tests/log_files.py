"""Files for the tests of the readers, and what they should say."""

import dataclasses

import numpy as np
import pytest

from jaxalign.errors import UserError
from jaxalign.io import read
from jaxalign.io.resample import nominal_interval
from jaxalign.log import Log

G = 9.80665
LAT_DEG, LON_DEG, HEIGHT = 32.06, 118.79, 20.0
SITE = {"lat_deg": LAT_DEG, "lon_deg": LON_DEG, "h": HEIGHT}
IMU = {"time": "t", "gyro": ["wx", "wy", "wz"], "accel": ["fx", "fy", "fz"]}
AID = {"file": "dvl.csv", "velocity": ["vx", "vy", "vz"], "frame": "body"}
MAP = {"imu": IMU, "site": SITE, "aid": AID}


def refused(path, *parts, **options):
    with pytest.raises(UserError) as caught:
        read(path, **options)
    text = str(caught.value)
    assert "\n" not in text
    for part in parts:
        assert part in text
    return text


def table(path, names, columns, separator=","):
    rows = [separator.join(repr(float(x)) for x in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([separator.join(names), *rows]) + "\n")
    return path


def changed(base, section, **changes):
    """A map with some keys of one section changed; None removes a key."""
    fields = {k: v for k, v in (base[section] | changes).items() if v is not None}
    return base | {section: fields}


RATE = np.array([0.01, -0.02, 0.03])
FORCE = np.array([0.3, -0.2, 9.75])


def motion(t):
    """Rates and forces of a swaying body in RFU at times t, and a body velocity."""
    w = np.column_stack([0.1 * np.sin(0.7 * t), 0.05 * np.cos(t), 0.02 + 0 * t])
    f = np.column_stack([0.3 * np.cos(t), 0.2 * np.sin(0.5 * t), 9.8 + 0.1 * np.sin(0.3 * t)])
    v = np.column_stack([0.1 * np.cos(0.2 * t), 2 + 0.3 * np.sin(0.1 * t), 0.05 * np.sin(t)])
    return w, f, v


def swaying_files(folder, seconds=12.0, hz=100):
    t = np.arange(round(seconds * hz) + 1) / hz
    w, f, _ = motion(t)
    imu = table(folder / "imu.csv", ["t", "wx", "wy", "wz", "fx", "fy", "fz"], [t, w, f])
    at = np.arange(int(seconds) + 1.0)
    table(folder / "dvl.csv", ["t", "vx", "vy", "vz"], [at, motion(at)[2]])
    return imu, t


def constant_files(folder, t, aid_t, kind="rate", aid_v=None):
    """Constant rates on any stamps: every interpolation is exact."""
    n = len(t)
    steps = np.diff(t, prepend=t[0] - nominal_interval(t))[:, None] if kind == "increment" else 1.0
    names = ["t", "wx", "wy", "wz", "fx", "fy", "fz"]
    imu = table(folder / "imu.csv", names, [t, np.tile(RATE, (n, 1)) * steps, np.tile(FORCE, (n, 1)) * steps])
    aid_v = np.column_stack([0.01 * aid_t, 2 + 0 * aid_t, -0.02 * aid_t]) if aid_v is None else aid_v
    table(folder / "dvl.csv", ["t", "vx", "vy", "vz"], [aid_t, aid_v])
    return imu


def assert_same(a, b):
    for field in dataclasses.fields(Log):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if field.name == "aids":
            assert len(x) == len(y)
            for one, other in zip(x, y, strict=True):
                assert (one.aid, one.sd) == (other.aid, other.sd)
                np.testing.assert_array_equal(one.time, other.time)
                np.testing.assert_array_equal(one.value, other.value)
        elif isinstance(x, np.ndarray):
            np.testing.assert_array_equal(x, y, err_msg=field.name)
        else:
            assert x == y, field.name
