import dataclasses
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_files import (
    FORCE,
    LAT_DEG,
    LON_DEG,
    MAP,
    RATE,
    G,
    assert_same,
    changed,
    constant_files,
    motion,
    refused,
    swaying_files,
    table,
)

from jaxalign.aids import AbstractAid
from jaxalign.io import read
from jaxalign.io.resample import (
    cumulate_increments,
    cumulate_rates,
    nominal_interval,
    onto_grid,
)


def test_csv_of_a_swaying_body(tmp_path):
    path, _ = swaying_files(tmp_path)
    log = read(path, columns=MAP)
    assert (log.epochs, log.epoch_samples, log.aids[0].name, log.name, log.t0) == (12, 100, "body", "imu", 0.0)
    assert log.dt == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_allclose([log.lat, log.lon], np.radians([LAT_DEG, LON_DEG]), rtol=1e-15)
    # the closed integrals of `motion`; a trapezoid is wrong by dt^3 |second derivative| / 12 a sample
    t = np.arange(1201) * 0.01
    angle = np.column_stack([-0.1 / 0.7 * np.cos(0.7 * t), 0.05 * np.sin(t), 0.02 * t])
    speed = np.column_stack(
        [0.3 * np.sin(t), -0.4 * np.cos(0.5 * t), 9.8 * t - 0.1 / 0.3 * np.cos(0.3 * t)],
    )
    np.testing.assert_allclose(log.dtheta, np.diff(angle, axis=0), rtol=0, atol=1e-6 * 0.05 / 12 * 1.01)
    np.testing.assert_allclose(log.dvel, np.diff(speed, axis=0), rtol=0, atol=1e-6 * 0.3 / 12 * 1.01)
    np.testing.assert_allclose(log.aids[0].value, motion(np.arange(13.0))[2], rtol=0, atol=1e-12)


def test_csv_in_ned_and_frd_is_the_same_log(tmp_path):
    path, t = swaying_files(tmp_path)
    log = read(path, columns=MAP)
    w, f, _ = motion(t)
    at = np.arange(13.0)
    turn = [1, 0, 2], np.array([1, 1, -1])
    names = ["t", "wx", "wy", "wz", "fx", "fy", "fz"]
    frd = table(tmp_path / "frd.csv", names, [t, w[:, turn[0]] * turn[1], f[:, turn[0]] * turn[1]])
    table(tmp_path / "dvl_frd.csv", ["t", "vx", "vy", "vz"], [at, motion(at)[2][:, turn[0]] * turn[1]])
    both = changed(MAP | {"frame": "NED/FRD"}, "aid", file="dvl_frd.csv")
    assert_same(dataclasses.replace(read(frd, columns=both), name="imu"), log)
    imu_only = changed(MAP | {"frame": "NED/FRD"}, "aid", axes="ENU/RFU")
    assert_same(dataclasses.replace(read(frd, columns=imu_only), name="imu"), log)
    # and forgotten, it is told
    assert "along -z" in read(frd, columns=MAP).warnings[0]


def test_csv_ned_means_east_north_up_out_of_a_nav_aid(tmp_path):
    t = np.arange(501) * 0.01
    frd = np.tile([0.1, 0.2, -9.8], (501, 1))
    names = ["t", "wx", "wy", "wz", "fx", "fy", "fz"]
    path = table(tmp_path / "imu.csv", names, [t, np.tile([0.01, 0.02, 0.03], (501, 1)), frd])
    table(tmp_path / "dvl.csv", ["t", "vx", "vy", "vz"], [np.arange(6.0), np.tile([3.0, 4.0, -0.5], (6, 1))])
    log = read(path, columns=changed(MAP | {"frame": "NED/FRD"}, "aid", frame="nav"))
    np.testing.assert_allclose(log.aids[0].value[2], [4.0, 3.0, 0.5])  # north 3, east 4, down -0.5
    np.testing.assert_allclose(log.dtheta[2] / 0.01, [0.02, 0.01, -0.03], rtol=1e-12)
    np.testing.assert_allclose(log.dvel[2] / 0.01, [0.2, 0.1, 9.8], rtol=1e-12)


@pytest.mark.parametrize(
    ("kind", "gyro", "gyro_size", "accel", "accel_size"),
    [
        ("rate", "deg/s", 180 / np.pi, "g", 1 / G),
        ("rate", "deg/h", 180 / np.pi * 3600, "mg", 1e3 / G),
        ("increment", "rad", 0.01, "m/s", 0.01),
        ("increment", "arcsec", 0.01 * 648000 / np.pi, "g*s", 0.01 / G),
        ("increment", "deg", 0.01 * 180 / np.pi, "m/s", 0.01),
    ],
)
def test_csv_units_and_kinds_agree(tmp_path, kind, gyro, gyro_size, accel, accel_size):
    t = np.arange(501) * 0.01
    names = ["t", "wx", "wy", "wz", "fx", "fy", "fz"]
    n = len(t)
    path = table(
        tmp_path / "imu.csv",
        names,
        [t, np.tile(RATE * gyro_size, (n, 1)), np.tile(FORCE * accel_size, (n, 1))],
    )
    at = np.arange(6.0)
    table(tmp_path / "dvl.csv", ["t", "vx", "vy", "vz"], [1000 * at, np.tile([1.8, 3.6, -7.2], (6, 1))])
    spec = changed(MAP, "imu", kind=kind, gyro_unit=gyro, accel_unit=accel)
    log = read(path, columns=changed(spec, "aid", unit="km/h", time_unit="ms", sd=0.03))
    np.testing.assert_allclose(log.dtheta, np.tile(RATE * 0.01, (500, 1)), rtol=1e-11)
    np.testing.assert_allclose(log.dvel, np.tile(FORCE * 0.01, (500, 1)), rtol=1e-11)
    np.testing.assert_allclose(log.aids[0].value, np.tile([0.5, 1.0, -2.0], (6, 1)), rtol=1e-14)
    assert log.aids[0].sd == 0.03


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_clocks_need_not_coincide(tmp_path, kind):
    t = 1000.0 + np.arange(2000) / 128.0 + 0.003
    aid_t = 1000.7 + 0.4 * np.arange(30)
    path = constant_files(tmp_path, t, aid_t, kind)
    spec = changed(
        MAP, "imu", **({"kind": kind, "gyro_unit": "rad", "accel_unit": "m/s"} if kind == "increment" else {})
    )
    log = read(path, columns=spec)
    assert log.t0 == pytest.approx(1000.7, abs=1e-9)
    assert log.epoch_samples == 51  # 0.4 s at 128 Hz is 51.2
    assert log.dt * log.epoch_samples == pytest.approx(0.4, abs=1e-9)
    assert log.epochs == 29
    total = 29 * 0.4
    np.testing.assert_allclose(log.dtheta.sum(axis=0), RATE * total, rtol=1e-9)
    np.testing.assert_allclose(log.dvel.sum(axis=0), FORCE * total, rtol=1e-9)
    np.testing.assert_allclose(log.dvel, np.tile(FORCE * log.dt, (len(log.dvel), 1)), rtol=1e-8)
    np.testing.assert_allclose(log.aids[0].value[:, 0], 0.01 * aid_t, rtol=1e-9)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), jitter=st.floats(0, 0.4), offset=st.floats(0, 0.5))
def test_resampling_keeps_the_total(seed, jitter, offset):
    rng = np.random.default_rng(seed)
    t = 0.01 * (np.arange(400) + jitter * rng.uniform(-1, 1, 400))
    x = rng.standard_normal((400, 6))
    for nodes, sums in (cumulate_increments(t, x, 0.01), cumulate_rates(t, x)):
        grid = np.linspace(nodes[0] + offset, nodes[-1], 257)
        parts = onto_grid(nodes, sums, grid)
        inner = sums[-1] - [np.interp(grid[0], nodes, sums[:, k]) for k in range(6)]
        np.testing.assert_allclose(parts.sum(axis=0), inner, rtol=0, atol=1e-11)
        np.testing.assert_allclose(onto_grid(nodes, sums, nodes), np.diff(sums, axis=0), rtol=0, atol=1e-12)
        # a finer grid that holds the coarse one adds up to it
        fine = onto_grid(nodes, sums, np.unique(np.concatenate([grid, 0.5 * (grid[1:] + grid[:-1])])))
        np.testing.assert_allclose(fine[::2] + fine[1::2], parts, rtol=0, atol=1e-12)


def test_increments_on_their_own_clock_pass_untouched(tmp_path):
    rng = np.random.default_rng(2)
    t = np.arange(1, 1001) * 0.01
    x = np.column_stack([1e-4 * rng.standard_normal((1000, 3)), [0, 0, 0.098] + 1e-3 * rng.standard_normal((1000, 3))])
    path = table(tmp_path / "imu.csv", ["t", "wx", "wy", "wz", "fx", "fy", "fz"], [t, x])
    table(tmp_path / "dvl.csv", ["t", "vx", "vy", "vz"], [np.arange(11.0), np.ones((11, 3))])
    spec = changed(MAP, "imu", kind="increment", gyro_unit="rad", accel_unit="m/s")
    log = read(path, columns=spec)
    assert (log.epochs, log.t0) == (10, pytest.approx(0.0, abs=1e-12))
    np.testing.assert_allclose(np.hstack([log.dtheta, log.dvel]), x, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_a_short_loss_is_bridged_and_told(tmp_path, kind):
    t = np.delete(np.arange(1001) * 0.01, [300, 301, 302, 500])
    n = len(t)
    size = 1.0 if kind == "rate" else 0.01  # an increment is over one sample, also after a gap
    names = ["t", "wx", "wy", "wz", "fx", "fy", "fz"]
    path = table(tmp_path / "imu.csv", names, [t, np.tile(RATE * size, (n, 1)), np.tile(FORCE * size, (n, 1))])
    table(tmp_path / "dvl.csv", ["t", "vx", "vy", "vz"], [np.arange(11.0), np.ones((11, 3))])
    spec = changed(
        MAP, "imu", **({"kind": kind, "gyro_unit": "rad", "accel_unit": "m/s"} if kind == "increment" else {})
    )
    log = read(path, columns=spec)
    np.testing.assert_allclose(log.dvel, np.tile(FORCE * 0.01, (1000, 1)), rtol=1e-10)
    assert len(log.warnings) == 1
    assert "4 IMU samples missing in 2 gaps" in log.warnings[0]
    assert "longest 3 after 2.99 s" in log.warnings[0]


def test_missing_aid_samples_are_nan_where_the_clock_is_even(tmp_path):
    aid_t = np.array([0.25, 1.25, 2.25, 5.25, 6.25, 7.25, 8.25, 9.25])
    path = constant_files(tmp_path, np.arange(1101) * 0.01, aid_t)
    log = read(path, columns=changed(MAP, "aid", interval=1.0))
    assert log.t0 == pytest.approx(0.25)
    (one,) = log.aids
    assert list(np.flatnonzero(one.missing)) == [3, 4]
    np.testing.assert_allclose(one.value[~one.missing, 0], 0.01 * (0.25 + np.arange(10.0))[~one.missing], rtol=1e-12)


def test_an_aid_keeps_its_own_times(tmp_path):
    aid_t = np.array([0.25, 1.25, 2.25, 3.29, 5.25, 6.25, 7.303, 8.25, 9.25])
    path = constant_files(tmp_path, np.arange(1101) * 0.01, aid_t)
    (one,) = read(path, columns=changed(MAP, "aid", interval=1.0)).aids
    np.testing.assert_allclose(one.time, aid_t - 0.25, atol=1e-12)
    np.testing.assert_allclose(one.value[:, 0], 0.01 * aid_t, rtol=1e-12)


def test_nominal_interval_counts_lost_stamps():
    rng = np.random.default_rng(0)
    t = np.delete(np.arange(1000) * 0.0078125, [5, 6, 77, 500])
    assert nominal_interval(t) == pytest.approx(0.0078125, rel=1e-12)
    assert nominal_interval(np.round(t, 3)) == pytest.approx(0.0078125, rel=1e-3)
    assert nominal_interval(t + 1e-4 * rng.standard_normal(len(t))) == pytest.approx(0.0078125, rel=1e-3)


def test_aid_in_the_same_file_with_empty_cells(tmp_path):
    t = np.arange(1001) * 0.01
    lines = [
        "# made by a logger",
        "time;gyro_x;gyro_y;gyro_z;accel_x;accel_y;accel_z;vel_x;vel_y;vel_z;lat_deg;note",
    ]
    for k, x in enumerate(t):
        aid = f"{k / 100};2.0;nan" if k == 300 else f"{k / 100};2.0;0.5" if k % 100 == 0 else ";;"
        lines.append(f"{x:.2f};0.01;-0.02;0.03;0.3;-0.2;9.75;{aid};{LAT_DEG if k == 0 else ''};ok")
    path = tmp_path / "run.csv"
    path.write_text("\n\n".join(lines) + "\n")
    log = read(path)  # default names
    assert (log.aids[0].name, log.epochs) == ("body", 10)
    assert log.aids[0].partial
    assert list(np.argwhere(np.isnan(log.aids[0].value))[0]) == [3, 2]
    np.testing.assert_allclose(log.aids[0].value[[1, 5]], [[1, 2, 0.5], [5, 2, 0.5]])
    assert log.lat == pytest.approx(np.radians(LAT_DEG))
    np.testing.assert_allclose(log.dtheta, np.tile(RATE * 0.01, (1000, 1)), rtol=1e-11)


def test_a_file_without_aid_is_static_and_a_map_beside_it_is_found(tmp_path):
    names = ["# t", "wx", "wy", "wz", "fx", "fy", "fz"]
    t = np.arange(601) * 10000
    n = len(t)
    path = table(tmp_path / "run.txt", names, [t, np.tile(RATE, (n, 1)), np.tile(FORCE, (n, 1))], "\t")
    (tmp_path / "run.toml").write_text(
        '[imu]\ntime = "t"\ntime_unit = "us"\ngyro = ["wx", "wy", "wz"]\naccel = ["fx", "fy", "fz"]\n'
        "epoch = 0.5\n[site]\nlat = 0.5\n"
    )
    log = read(path)
    assert (log.standing, log.epoch_samples, log.epochs, log.lat) == (True, 50, 12, 0.5)
    assert log.dt == pytest.approx(0.01, rel=1e-12)
    assert_same(read(path, columns=tmp_path / "run.toml"), log)


def test_times_as_large_as_unix_nanoseconds(tmp_path):
    t = np.arange(501) * 0.01
    names = ["t", "wx", "wy", "wz", "fx", "fy", "fz"]
    lines = [",".join(names)]
    start = 1_700_000_000_000_000_000
    lines += [f"{start + 10_000_000 * k},0.01,-0.02,0.03,0.3,-0.2,9.75" for k in range(len(t))]
    path = tmp_path / "imu.csv"
    path.write_text("\n".join(lines))
    table(tmp_path / "dvl.csv", ["t", "vx", "vy", "vz"], [1_700_000_000.0 + np.arange(6.0), np.ones((6, 3))])
    log = read(path, columns=changed(changed(MAP, "imu", time_unit="ns"), "aid", time_unit="s"))
    assert log.epochs == 5
    assert log.t0 == pytest.approx(1.7e9, abs=1e-6)
    np.testing.assert_allclose(log.dvel.sum(axis=0), FORCE * 5.0, rtol=1e-6)


def test_sixty_thousand_rows_are_read_fast(tmp_path):
    t = np.arange(60001) * 0.005
    w, f, _ = motion(t)
    names = ["t", "wx", "wy", "wz", "fx", "fy", "fz"]
    path = table(tmp_path / "imu.csv", names, [t, w, f])
    table(tmp_path / "dvl.csv", ["t", "vx", "vy", "vz"], [np.arange(301.0), motion(np.arange(301.0))[2]])
    start = time.perf_counter()
    log = read(path, columns=MAP)
    assert time.perf_counter() - start < 3.0  # about 0.2 s; two workers may share the core
    assert (log.epochs, log.epoch_samples) == (300, 200)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Coil(AbstractAid):
    """Three components that are no velocity, in a unit of its own."""

    turns: int = 1

    kind = "coil-of-test-csv"
    unit = "uT"

    @property
    def components(self):
        return "x", "y", "z"

    def predict(self, motion, unknowns):
        return self.turns * motion.axes[0]


def test_an_aid_of_ones_own_is_in_its_unit_and_not_turned(tmp_path):
    path, _ = swaying_files(tmp_path)
    columns = {"file": "dvl.csv", "values": ["vx", "vy", "vz"], "kind": Coil.kind, "turns": 3, "axes": "NED/FRD"}
    log = read(path, columns=MAP | {"aid": columns})
    assert log.aids[0].aid == Coil(turns=3)
    np.testing.assert_allclose(log.aids[0].value, motion(np.arange(13.0))[2], atol=1e-12)
    for wrong, words in (
        ({"unit": "m/s"}, ["unit = 'm/s'", "uT"]),
        ({"turn": 2}, ["unknown key 'turn'", "mean 'turns'"]),
        ({"turns": {"a": 1}}, ["must be names, numbers or tuples"]),
        ({"name": ["coil"]}, ["a text is expected"]),
        ({"kind": "body", "components": 1, "turns": None}, ["components are 1"]),
        ({"kind": "static"}, ["has no values", "leave the table out"]),
    ):
        changed_map = {key: x for key, x in (columns | wrong).items() if x is not None}
        refused(path, *words, columns=MAP | {"aid": changed_map})
    refused(path, "values is missing", columns=MAP | {"aid": {"kind": "non-holonomic", "file": "slip.csv"}})
    refused(path, "unknown key 'kidn'", "mean 'kind'", columns=MAP | {"aid": {"kidn": "body"}})


def test_deviations_are_in_the_order_of_the_columns(tmp_path):
    path, _ = swaying_files(tmp_path)
    stated = changed(MAP, "aid", sd=[0.1, 0.2, 0.3], axes="NED/FRD")
    np.testing.assert_array_equal(read(path, columns=stated).aids[0].sd, [0.2, 0.1, 0.3])
    np.testing.assert_array_equal(
        read(path, columns=changed(MAP, "aid", sd=[0.1, 0.2, 0.3])).aids[0].sd, [0.1, 0.2, 0.3]
    )


def test_named_components_go_by_their_names(tmp_path):
    """Also where the axes of the file are others: only the sense of "up" turns."""
    path, _ = swaying_files(tmp_path)
    plain = read(path, columns=MAP).aids[0].value
    named = changed(MAP, "aid", axes="NED/FRD", components=["right", "forward", "up"])
    np.testing.assert_array_equal(read(path, columns=named).aids[0].value, plain * [1.0, 1.0, -1.0])
