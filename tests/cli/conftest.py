"""Files for the command line."""

import numpy as np
import pytest

import jaxalign as ja


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A short simulated log and ways to spoil it."""
    folder = tmp_path_factory.mktemp("logs")
    log = ja.simulate.simulate(ja.simulate.scenario("dvl-sturn", duration=60.0), 3)
    ja.io.write_npz(log, folder / "good.npz")
    with np.load(folder / "good.npz") as z:
        arrays = {key: z[key] for key in z.files}

    def spoilt(name, **changes):
        np.savez(folder / name, **{k: v for k, v in (arrays | changes).items() if v is not None})

    gone = arrays["dvel"].copy()
    gone[700:720] = np.nan
    spoilt("nan.npz", dvel=gone)
    spoilt("no_aid.npz", aid_v=np.full_like(arrays["aid_v"], np.nan))
    spoilt("in_g.npz", dvel=arrays["dvel"] / 9.80665)
    spoilt("deg.npz", dtheta=np.rad2deg(arrays["dtheta"]))
    spoilt("swapped.npz", dvel=arrays["dvel"] * [1, -1, -1], dtheta=arrays["dtheta"] * [1, -1, -1])
    spoilt("pole.npz", lat=np.deg2rad(89.7))
    spoilt("lat_deg.npz", lat=32.06)
    spoilt("short.npz", dtheta=arrays["dtheta"][:400], dvel=arrays["dvel"][:400], aid_v=arrays["aid_v"][:3])
    spoilt("keys.npz", dvel=None)
    (folder / "damaged.npz").write_bytes((folder / "good.npz").read_bytes()[:5000])
    (folder / "unknown.bin").write_bytes(bytes(range(256)))
    csv(folder, "good.csv", log)
    time = np.arange(len(log.dtheta)) * log.dt
    time[500] = time[499]
    csv(folder, "twice.csv", log, time)
    time[500] = time[498]
    csv(folder, "back.csv", log, time)
    csv(folder, "gap.csv", log, drop=slice(1000, 1010))
    (folder / "map.toml").write_text('[imu]\ntime = "tt"\n')
    return folder


def csv(folder, name, log, time=None, drop=slice(0, 0)):
    time = np.arange(len(log.dtheta)) * log.dt if time is None else time
    table = np.column_stack([time, log.dtheta / log.dt, log.dvel / log.dt, np.full(len(time), np.rad2deg(log.lat))])
    head = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,lat_deg"
    np.savetxt(folder / name, np.delete(table, drop, axis=0), delimiter=",", header=head, comments="", fmt="%.12g")
