"""The real logs: within what independent toolboxes and references say."""

import numpy as np
import pytest

from jaxalign import align, read
from jaxalign.cli.main import main
from jaxalign.methods import build
from jaxalign.metrics import attitude_error_deg


def slow(value):
    return pytest.param(value, marks=pytest.mark.slow)


# Of one length each: programs of their own.
@pytest.mark.parametrize("number", [*(slow(x) for x in ("02", "03", "05", "10", "12", "13"))])
def test_auv(shared, number):
    log = read(shared / "data" / "real_akit" / f"real_akit_{number}.npz")
    found = align(build("oba", "body"), log, every=100)
    error = attitude_error_deg(found, log)[np.flatnonzero(np.asarray(found.time) == 300)[0]]
    assert abs(error[2]) < 1.5
    assert np.linalg.norm(error[:2]) < 0.03
    assert 0.002 < float(found.aid_sd[-1]) < 0.008  # 4-6 mm/s horizontal, 2 mm/s vertical


@pytest.mark.parametrize("recipe", ["gravity_q", slow("velocity_q")])
def test_ring_laser_from_the_native_format(shared, recipe):
    log = read(shared / "data" / "lasergyro" / "lasergyro_first_half.imu")
    found = align(build(recipe), log, every=100)
    pitch, roll, yaw = found.euler_deg[np.flatnonzero(np.asarray(found.time) == 300)[0]]
    assert yaw == pytest.approx(-90.60, abs=0.03)
    assert pitch == pytest.approx(0.804, abs=0.01)
    assert roll == pytest.approx(0.311, abs=0.01)


@pytest.mark.slow
def test_car_windows(shared):
    """3.8 deg median with the gyro bias, 0.57 without (un-normalised OBA)."""
    import dataclasses

    log = read(shared / "data" / "n380_car" / "n380_hill.npz")
    with np.load(shared / "data" / "n380_car" / "n380_hill.npz") as z:
        bias = z["gyro_bias_vs_ins_rad_s"]
    for data, expected in ((log, 3.8), (dataclasses.replace(log, dtheta=log.dtheta - bias * log.dt), 0.57)):
        errors = []
        for start in range(0, int(log.duration) - 60, 10):
            part = data.crop(start, start + 60)
            if np.linalg.norm(part.aids[0].value[-1] - part.aids[0].value[0]) > 8:
                found = align(build("oba", "nav"), part, every=10**6)
                errors.append(abs(attitude_error_deg(found, part)[-1, 2]))
        assert np.median(errors) == pytest.approx(expected, rel=0.05)


@pytest.mark.slow
def test_command_on_every_log(shared, tmp_path, capsys):
    """`info` runs on everything there is, `align` with the default method on a log of each kind (see test_auto.py)."""
    logs = sorted(path for path in (shared / "data").rglob("*") if path.suffix in (".npz", ".imu"))
    assert len(logs) > 10
    for path in logs:
        assert main(["info", str(path)]) == 0
    for path in {(path.parent, path.suffix): path for path in reversed(logs)}.values():
        assert main(["align", str(path), "--output", str(tmp_path / "out.npz")]) == 0
        with np.load(tmp_path / "out.npz") as z:
            assert np.isfinite(z["C_nb"][-1]).all()
            assert np.isnan(z["C_nb"][0]).all()
        (tmp_path / "out.npz").unlink()
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "warning: " not in captured.out
    assert "do not trust the heading" not in captured.out
    # A method without biases says of the two low-cost units that it does not fit.
    for path in ("n380_car/n380_hill.npz", "fog_mems/psins_fog_mems.npz"):
        assert main(["align", str(shared / "data" / path), "--method", "oba", "--every", "10"]) == 0
        assert "do not trust the heading" in capsys.readouterr().out
