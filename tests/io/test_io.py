import dataclasses
import time

import numpy as np
import pytest
from log_files import assert_same, refused
from logs import log_of
from scipy.spatial.transform import Rotation

from jaxalign.errors import UserError
from jaxalign.io import read, write_npz


def sample_log(**changes):
    rng = np.random.default_rng(5)
    base = {
        "dtheta": 1e-4 * rng.standard_normal((2000, 3)),
        "dvel": np.array([0, 0, 0.098]) + 1e-4 * rng.standard_normal((2000, 3)),
        "dt": 0.01,
        "epoch_samples": 100,
        "aid": "body",
        "velocity": rng.standard_normal((21, 3)),
        "lat": 0.5,
        "lon": 2.0,
        "h": 30.0,
        "aid_sd": 0.02,
        "C_nb": Rotation.random(21, random_state=1).as_matrix(),
        "t0": 12.5,
        "name": "sample",
    }
    base["velocity"][3] = np.nan
    return log_of(**(base | changes))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"aid": "nav", "velocity": np.zeros((21, 3))},
        {"aid": "static", "velocity": None, "C_nb": None, "aid_sd": None},
    ],
    ids=["body", "zero nav", "static"],
)
def test_npz_round_trip_is_exact(tmp_path, changes):
    log = sample_log(**changes)
    write_npz(log, tmp_path / "sample.npz")
    assert_same(read(tmp_path / "sample.npz"), log)
    # under another name it is told by its content
    write_npz(log, tmp_path / "sample.dat")
    assert_same(read(tmp_path / "sample.dat"), log)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["sample.dat", "sample.npz"]


def test_aid_sd_given_replaces_the_files(tmp_path):
    write_npz(sample_log(), tmp_path / "a.npz")
    assert read(tmp_path / "a.npz").aids[0].sd == 0.02
    assert read(tmp_path / "a.npz", aid_sd=0.1).aids[0].sd == 0.1
    refused(tmp_path / "a.npz", "sd is -1", aid_sd=-1.0)


def test_npz_names_all_missing_keys_at_once(tmp_path):
    np.savez(tmp_path / "a.npz", dtheta=np.zeros((9, 3)), aid_frame="body", lat=0.5)
    refused(tmp_path / "a.npz", "missing dt_imu, dvel, aid_every, lon, h, aid_v;", "a log needs dt_imu, dtheta")


def npz_with(path, **changes):
    write_npz(sample_log(), path)
    with np.load(path) as archive:
        data = dict(archive)
    np.savez(path, **(data | changes))
    return path


def test_npz_with_bad_content(tmp_path):
    path = tmp_path / "a.npz"
    refused(npz_with(path, aid_frame="gnss"), "aid_frame is 'gnss'", "static, body, nav")
    refused(npz_with(path, aid_v=np.zeros((20, 3))), "aid_v has shape (20, 3)", "(21, 3) is expected")
    refused(npz_with(path, lat=32.0), "a: latitude is 32 rad", "degrees")
    refused(npz_with(path, dvel=np.array([{}])), "not an .npz archive of plain arrays")
    good = sample_log()
    dvel = np.array(good.dvel)
    dvel[500:510, 1] = np.nan
    refused(npz_with(path, dvel=dvel), "dvel has NaN", "10 long at row 500", "5 s")


def test_npz_stored_as_float32_is_read_and_told(tmp_path):
    log = sample_log()
    path = npz_with(tmp_path / "a.npz", dtheta=log.dtheta.astype(np.float32))
    short = read(path)
    assert short.dtheta.dtype == np.float64
    assert [("dtheta" in w and "float32" in w) for w in short.warnings] == [True]


def test_damaged_and_missing_files(tmp_path):
    path = tmp_path / "a.npz"
    refused(path, "a.npz: no such file")
    refused(tmp_path / "nowhere" / "a.npz", "no such file", "nor the folder")
    refused(tmp_path, "is a folder")
    write_npz(sample_log(), path)
    whole = path.read_bytes()
    for cut in (10, 1000, len(whole) - 100):
        path.write_bytes(whole[:cut])
        refused(path, "a.npz", "archive")
    path.write_bytes(b"")
    refused(path, "a.npz", "archive")
    path.write_text("time,gyro_x\n1,2\n")
    refused(path, "a.npz", "archive")
    broken = bytearray(whole)
    broken[3000:3200] = bytes(200)
    path.write_bytes(broken)
    refused(path, "a.npz", "damaged")
    np.save(tmp_path / "b.npy", np.zeros(3))
    (tmp_path / "b.npy").rename(path)
    refused(path, "single array")


def test_unknown_formats(tmp_path):
    path = tmp_path / "notes.bin"
    path.write_bytes(bytes(range(256)))
    refused(path, "notes.bin", "unknown format", "npz, psins or csv")
    refused(path, "format 'ubx' is unknown", "auto, npz, psins, csv", format="ubx")
    path.write_text("hello\n")
    refused(path, "unknown format")
    write_npz(sample_log(), tmp_path / "a.npz")
    refused(tmp_path / "a.npz", "column map is for CSV", columns={})
    refused(tmp_path / "a.npz", "binary data where text is expected", format="psins")


def test_nothing_half_written(tmp_path, monkeypatch):
    log = sample_log()
    with pytest.raises(UserError, match=r"cannot be written: no such folder"):
        write_npz(log, tmp_path / "nowhere" / "a.npz")
    with pytest.raises(UserError, match=r"is a folder"):
        write_npz(log, tmp_path)
    path = tmp_path / "a.npz"
    write_npz(log, path)
    before = path.read_bytes()

    def full(stream, **_):
        stream.write(b"PK half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(UserError, match=r"a\.npz: cannot be written: No space left"):
        write_npz(log, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


# --- PSINS text ---

PSINS_HEADER = [
    "% a comment",
    "",
    "0.0 0.0 -90.6 0.0 0.0 0.0",
    "34.5 108.9 380.0 2.5 10.0 9.780327 % with a comment",
    "0.1 0.2 0.3 125.0 250.0 125.0",
]


def psins(path, rows, header=PSINS_HEADER):
    path.write_text("\n".join([*header, *rows]) + "\n")
    return path


def test_psins_scale_factors(tmp_path):
    # 80 counts of 125 ug s are 0.01 s g; gyro counts in arc-seconds
    log = read(psins(tmp_path / "a.imu", ["1 -2 3 4 -5 80"] * 500))
    arcsec = np.pi / 648000
    np.testing.assert_allclose(log.dtheta[7], np.array([0.1, -0.4, 0.9]) * arcsec, rtol=1e-14)
    np.testing.assert_allclose(log.dvel[7], np.array([500e-6, -1250e-6, 0.01]) * 9.780327, rtol=1e-14)
    assert (log.aids, log.dt, log.epoch_samples, log.epochs) == ((), 0.01, 100, 5)
    assert (log.t0, log.h) == (2.5, 380.0)
    np.testing.assert_allclose([log.lat, log.lon], np.radians([34.5, 108.9]), rtol=1e-15)
    assert_same(read(psins(tmp_path / "b.txt", ["1 -2 3 4 -5 80"] * 500)), dataclasses.replace(log, name="b"))


def test_psins_errors_name_the_line(tmp_path):
    path, good = tmp_path / "a.imu", ["0 0 2 0 0 80"] * 500
    refused(psins(path, [*good[:10], "0 0 x 0 0 80", *good]), "line 16", "'0 0 x 0 0 80'", "not six numbers")
    refused(psins(path, [*good[:10], "0 0 2 0 80", *good]), "line 16", "not six numbers")
    refused(psins(path, ["0 0 2 0 80"] * 500), "line 6", "not six numbers")
    refused(psins(path, []), "no samples")
    refused(psins(path, [], PSINS_HEADER[:4]), "2 of 3 header lines", "scale factors")
    refused(psins(path, good, [*PSINS_HEADER[:3], "34.5 108.9"]), "line 4", "latitude")
    refused(psins(path, good, [*PSINS_HEADER[:3], "34.5 108.9 380 0 0 9.78", PSINS_HEADER[4]]), "interval 0 ms")
    refused(psins(path, good, [*PSINS_HEADER[:4], "0 1 1 1 1 1"]), "scale factor is zero")
    refused(psins(path, good[:200]), "too short", "2 epoch intervals")
    refused(psins(path, good, [*PSINS_HEADER[:4], "0.1 0.1 0.1 12.5 12.5 12.5"]), "|f| = 0.978", "expected about")


def test_psins_equals_its_npz_on_a_real_log(shared):
    start = time.perf_counter()
    log = read(shared / "data/lasergyro/lasergyro_first_half.imu")
    assert time.perf_counter() - start < 2.0  # about 0.06 s; a slow machine may be slower
    other = read(shared / "data/lasergyro/lasergyro_first_half.npz")
    np.testing.assert_allclose(log.dtheta, other.dtheta, rtol=0, atol=1e-15)
    np.testing.assert_allclose(log.dvel, other.dvel, rtol=0, atol=1e-15)
    assert (log.lat, log.lon, log.h, log.epochs) == (other.lat, other.lon, other.h, other.epochs)
    assert (log.standing, other.aids[0].name) == (True, "nav")


def test_frozen_cases_are_read(shared):
    for pattern in ("dvl_*", "gps_*", "self_*", "disturbed_align_*"):
        for path in sorted((shared / "cases").glob(pattern)):
            log = read(path)
            assert log.warnings == (), path
            assert log.aids[0].name == ("body" if pattern == "dvl_*" else "nav")
