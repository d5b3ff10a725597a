import pytest
from log_files import IMU, LAT_DEG, MAP, changed, refused, swaying_files


@pytest.fixture
def files(tmp_path):
    return swaying_files(tmp_path)[0]


def edit(path, number, text):
    """Replaces line `number` (from 1) of a file, or inserts nothing where text is None."""
    lines = path.read_text().splitlines()
    lines[number - 1 : number] = [] if text is None else [text]
    path.write_text("\n".join(lines) + "\n")
    return path


def line(path, number):
    return path.read_text().splitlines()[number - 1]


MAPS = {
    "column": (
        changed(MAP, "imu", gyro=["wx", "wy", "w_z"]),
        ["no column 'w_z'", "mean 'wz'", "known: t, wx, wy, wz, fx"],
    ),
    "aid column": (
        changed(MAP, "aid", velocity=["vx", "vy", "v"]),
        ["dvl.csv", "no column 'v'", "known: t, vx, vy, vz"],
    ),
    "aid file": (changed(MAP, "aid", file="gps.csv"), ["gps.csv", "no such aid file"]),
    "unknown key": (changed(MAP, "imu", gyros_unit="deg/s"), ["[imu]", "'gyros_unit'", "mean 'gyro_unit'"]),
    "unknown section": (MAP | {"sites": {}}, ["unknown key 'sites'", "mean 'site'"]),
    "unit": (
        changed(MAP, "imu", gyro_unit="deg/sec"),
        ["[imu]", "gyro_unit = 'deg/sec'", "mean 'deg/s'", "rad/s"],
    ),
    "unit of the kind": (
        changed(MAP, "imu", kind="increment", gyro_unit="deg/s"),
        ["gyro_unit = 'deg/s'", "rad, deg, arcsec"],
    ),
    "kind": (changed(MAP, "imu", kind="increments"), ["kind = 'increments'", "mean 'increment'"]),
    "frame": (MAP | {"frame": "FRD"}, ["frame = 'FRD'", "ENU/RFU, NED/FRD"]),
    "aid frame": (changed(MAP, "aid", frame="ned"), ["[aid]", "frame = 'ned'", "body, nav"]),
    "aid frame missing": (changed(MAP, "aid", frame=None), ["[aid]", "frame is missing"]),
    "three columns": (changed(MAP, "imu", accel=["fx", "fy"]), ["accel", "three column names"]),
    "time missing": (changed(MAP, "imu", time=None), ["[imu]", "time is missing"]),
    "site missing": ({"imu": IMU}, ["lat_deg", "missing"]),
    "lat twice": (changed(MAP, "site", lat=0.5), ["both lat and lat_deg"]),
    "lat no number": (changed(MAP, "site", lat_deg=True), ["lat_deg is True"]),
    "lat as degrees": (changed(MAP, "site", lat=LAT_DEG, lat_deg=None), ["latitude is 32.06 rad", "degrees"]),
    "pole": (changed(MAP, "site", lat_deg=89.9), ["89.900 deg", "beyond 89.5"]),
    "sd": (changed(MAP, "aid", sd=-1.0), ["sd is -1.0", "positive"]),
    "section no table": (MAP | {"imu": 3}, ["[imu]", "table"]),
    "time unit": (changed(MAP, "imu", time_unit="us"), ["1e-08 s", "time_unit"]),
    "time offset": (
        changed(MAP, "aid", time_offset=500.0),
        ["no body sample within", "IMU 0 to 12", "body 500 to 512"],
    ),
    "interval": (changed(MAP, "aid", interval=0.001), ["0.001 s", "closer than the IMU"]),
    "g": (changed(MAP, "imu", accel_unit="g"), ["|f| = 96", "expected about 9.8"]),
    "increments": (
        changed(MAP, "imu", kind="increment"),
        ["|f| = 98", "rates (m/s^2) given as increments"],
    ),
}


@pytest.mark.parametrize("case", MAPS)
def test_a_wrong_map_has_its_message(files, case):
    columns, parts = MAPS[case]
    refused(files, *parts, columns=columns)


def test_a_wrong_map_file_has_its_message(files, tmp_path):
    refused(files, "nomap.toml: no such column map", columns=tmp_path / "nomap.toml")
    (tmp_path / "map.toml").write_text("[imu\n")
    refused(files, "map.toml: not a TOML file", columns=tmp_path / "map.toml")
    refused(files, "no column map given", "time, gyro_x", "lat_deg", "has t, wx")


CELLS = {
    "text": ((50, "0.48,0,0,x7,0,0,9.8"), ["line 50, column 'wz': 'x7' is not a number"]),
    "empty": ((50, "0.48,0,0,,0,0,9.8"), ["line 50, column 'wz': '' is not a number"]),
    "long row": ((50, "0.48,0,5,0,0,0,0,9.8"), ["line 50 has 8 cells, the header 7"]),
    "short row": ((50, "0.48,0,0"), ["line 50 has 3 cells, the header 7"]),
    "NaN": ((50, "0.48,0,0,nan,0,0,9.8"), ["NaN or infinity in 1 rows", "line 50", "time 0.48 s"]),
    "infinity": ((50, "0.48,0,0,0,0,0,inf"), ["NaN or infinity", "line 50"]),
    "NaN time": ((50, "nan,0,0,0,0,0,9.8"), ["line 50, column 't': time is not a finite"]),
    "repeated": ((50, "0.47,0,0,0,0,0,9.8"), ["line 50, column 't': time 0.47 repeats", "1 such rows"]),
    "backwards": ((50, "0.41,0,0,0,0,0,9.8"), ["line 50, column 't': time 0.41 goes back from 0.47"]),
    "no header": ((1, "1,2,3,4,5,6,7"), ["line 1 is numbers", "header"]),
    "name twice": ((1, "t,wx,wy,wx,fx,fy,fz"), ["'wx' is there 2 times"]),
}


@pytest.mark.parametrize("case", CELLS)
def test_a_bad_cell_is_named(files, case):
    change, parts = CELLS[case]
    refused(edit(files, *change), "imu.csv", *parts, columns=MAP)


def test_a_nan_run_is_measured(files):
    for number in range(50, 60):
        edit(files, number, line(files, number).rsplit(",", 1)[0] + ",nan")
    refused(files, "10 rows", "10 long at line 50", columns=MAP)


def test_a_gap_is_refused(files):
    for _ in range(4):
        edit(files, 52, None)
    refused(files, "gap in the IMU of 0.05 s (4 samples, at most 3) after line 51", "time 0.49 s", columns=MAP)


def test_too_short_and_empty_files(files, tmp_path):
    whole = files.read_text().splitlines()
    files.write_text("\n".join(whole[:150]))
    refused(files, "too short", columns=MAP)
    files.write_text("\n".join(whole[:250]))
    refused(files, "too short: 2 epoch intervals", columns=MAP)
    files.write_text("\n".join(whole[:3]))
    refused(files, "too short: 2 rows", columns=MAP)
    files.write_text(whole[0] + "\n")
    refused(files, "no rows after the header", columns=MAP)
    files.write_text("")
    refused(files, "no rows", columns=MAP)


def test_a_bad_aid_file_is_named(files, tmp_path):
    dvl = tmp_path / "dvl.csv"
    good = dvl.read_text()
    refused_with = {"columns": MAP}
    edit(dvl, 5, "2.0,0,0,0")
    refused(files, "dvl.csv: line 5, column 't': time 2 repeats", **refused_with)
    dvl.write_text(good)
    edit(dvl, 5, "3.0,0,none,0")
    refused(files, "dvl.csv: line 5, column 'vy': 'none' is not a number", **refused_with)
    dvl.write_text("t,vx,vy,vz\n" + "".join(f"{k},,,\n" for k in range(13)))
    refused(files, "dvl.csv: all aid samples are missing", **refused_with)
    dvl.write_text("t,vx,vy,vz\n1,2,3,4\n")
    refused(files, "only one aid sample", **refused_with)
