"""The command line: results, files, exit codes, one line for every user error."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import jaxalign as ja
from jaxalign.cli.main import main

PNG = b"\x89PNG\r\n\x1a\n"


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


def refused(capsys, arguments):
    """The one line of a user error; nothing on standard output but what was printed before it was found."""
    assert main([str(a) for a in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("jaxalign: error: ")
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing.npz", ["missing.npz", "no such"]),
        ("", ["folder"]),
        ("unknown.bin", ["unknown format", "--format"]),
        ("damaged.npz", ["damaged.npz"]),
        ("keys.npz", ["dvel"]),
        ("nan.npz", ["700", "20"]),
        ("no_aid.npz", ["missing"]),
        ("in_g.npz", ["g", "9.8"]),
        ("deg.npz", ["deg"]),
        ("pole.npz", ["89.7", "89.5"]),
        ("lat_deg.npz", ["32.06", "rad"]),
        ("short.npz", ["short"]),
        ("twice.csv", ["time", "502"]),
        ("back.csv", ["time", "502"]),
        ("gap.csv", ["gap"]),
    ],
)
@pytest.mark.parametrize("command", ["align", "info"])
def test_bad_logs(files, tmp_path, capsys, command, name, words):
    extra = ["--output", tmp_path / "out.npz"] if command == "align" else []
    message = refused(capsys, [command, files / name, *extra])
    for word in words:
        assert word in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--method", "ob"], ["oba"]),
        (["--method", "gravity_q"], ["standing", "oba"]),
        (["--method", "oba", "--set", "observe.windw=3"], ["observe.window"]),
        (["--method", "oba", "--set", "observe.window"], ["name=value"]),
        (["--method", "oba", "--set", "observe.window=x"], ["number"]),
        (["--method", "oba", "--set", "observe.window=-1"], ["observe.window"]),
        (["--method", "oba", "--set", "observe.coriolis=open"], ["closed", "recursive"]),
        (["--method", "oba", "--set", "observe.interval_samples=7"], ["200"]),
        (["--every", "0"], ["every"]),
        (["--aid-sd", "-0.1"], ["aid_sd"]),
        (["--start", "50", "--end", "40"], ["40"]),
        (["--start", "100"], ["100"]),
        (["--columns", "map.toml"], ["CSV"]),
        (["--output", "no/such/folder/out.npz"], ["no folder"]),
        (["--output", "."], ["folder"]),
        (["--output", "both.png", "--plot", "both.png"], ["two files"]),
        (["--plot", "out.jpg"], [".png"]),
        (["--method", "oba", "--set", "observe.window=1e9"], ["at most"]),
        (["--plot", "no/such/folder/out.png"], ["no folder"]),
    ],
)
def test_bad_arguments(files, capsys, monkeypatch, tmp_path, arguments, words):
    monkeypatch.chdir(tmp_path)
    message = refused(capsys, ["align", files / "good.npz", *arguments])
    for word in words:
        assert word in message
    assert list(tmp_path.iterdir()) == []


def test_outputs_never_destroy(files, tmp_path, capsys):
    """Not the input, no device or pipe; a link is written through."""
    before = (files / "good.npz").read_bytes()
    message = refused(capsys, ["align", files / "good.npz", "--output", files / "good.npz"])
    assert "input" in message
    assert (files / "good.npz").read_bytes() == before
    os.mkfifo(tmp_path / "pipe")
    command = ["align", str(files / "good.npz"), "--method", "oba", "--every", "60"]
    assert main([*command, "--output", str(tmp_path / "pipe")]) == 2
    assert "ordinary" in capsys.readouterr().err
    (tmp_path / "link.npz").symlink_to(tmp_path / "real.npz")
    assert main([*command, "--output", str(tmp_path / "link.npz")]) == 0
    assert (tmp_path / "link.npz").is_symlink()
    assert (tmp_path / "real.npz").is_file()


@pytest.mark.slow
def test_a_reader_that_leaves_costs_no_results(files, tmp_path):
    """`jaxalign align ... | true`, and a full disk behind standard output."""
    arguments = [sys.executable, "-m", "jaxalign", "align", str(files / "good.npz"), "--method", "oba", "--every", "60"]
    with subprocess.Popen([*arguments, "--output", str(tmp_path / "o.npz")], stdout=subprocess.PIPE) as program:
        program.stdout.close()
        assert program.wait() == 0
    assert (tmp_path / "o.npz").is_file()
    if os.path.exists("/dev/full"):
        with open("/dev/full", "w") as full:
            run = subprocess.run(arguments, stdout=full, stderr=subprocess.PIPE, text=True)
        assert run.returncode == 2
        assert "Traceback" not in run.stderr
        assert run.stderr.startswith("jaxalign: error: ")


@pytest.mark.slow
def test_an_unknown_backend_is_no_matter(files, tmp_path):
    environment = {**os.environ, "MPLBACKEND": "nonsense"}
    arguments = ["align", str(files / "good.npz"), "--method", "oba", "--plot", str(tmp_path / "o.pdf")]
    run = subprocess.run(
        [sys.executable, "-m", "jaxalign", *arguments], env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "o.pdf").read_bytes().startswith(b"%PDF")


def test_printed_times_are_those_of_the_file(files, tmp_path, capsys):
    cut = ["--method", "oba", "--start", "20", "--every", "40", "--output", str(tmp_path / "o.npz")]
    assert main(["align", str(files / "good.npz"), *cut]) == 0
    with np.load(tmp_path / "o.npz") as z:
        np.testing.assert_allclose(z["t"], [20.0, 60.0])
    assert "at 60.0 s: pitch" in capsys.readouterr().out


def test_wrong_column_map(files, capsys):
    message = refused(capsys, ["align", files / "good.csv", "--columns", files / "map.toml"])
    assert "map" in message


def test_swapped_axes_warn(files, capsys):
    assert main(["align", str(files / "swapped.npz"), "--method", "oba", "--every", "60"]) == 0
    assert "warning: " in capsys.readouterr().out


@pytest.mark.slow
def test_csv_of_a_standing_vehicle_is_static(files, capsys):
    """No aid columns: a static log. (This vehicle moves; the command only sees sensors.)"""
    assert main(["align", str(files / "good.csv"), "--end", "20", "--every", "20", "--imu", "navigation"]) == 0
    out = capsys.readouterr().out
    assert "no aid (standing)" in out
    assert "method robust_map" in out
    assert "its velocity is zero" in out


def test_align_writes_what_it_says(files, tmp_path, capsys):
    out, png = tmp_path / "out.npz", tmp_path / "out.png"
    arguments = ["--method", "oba", "--set", "observe.window=30", "--start", "10", "--end", "50"]
    assert main(["align", str(files / "good.npz"), *arguments, "--output", str(out), "--plot", str(png)]) == 0
    printed = capsys.readouterr().out
    for word in (
        "pitch deg",
        "roll deg",
        "heading deg",
        "observable",
        "residual",
        "as stated",
        "error against the reference",
    ):
        assert word in printed
    assert png.read_bytes().startswith(PNG)
    with np.load(out) as z:
        assert z["C_nb"].shape == (41, 3, 3)
        assert z["q_nb"].shape == (41, 4)
        assert z["euler_deg"].shape == (41, 3)
        for key in ("heading_deg", "observable", "eigengap", "weight", "status", "t"):
            assert z[key].shape == (41,)
        assert z["t"][0] == pytest.approx(10.0)
        assert np.isnan(z["C_nb"][:2]).all()
        assert np.isfinite(z["C_nb"][2:]).all()
        recipe = json.loads(str(z["recipe"]))
    assert recipe["method"] == "oba"
    assert recipe["parameters"]["observe.window"] == 30.0
    assert recipe["aid_sd"] == pytest.approx(0.1)
    assert recipe["aid_sd_from"] == "log"
    # The recipe rebuilds the method.
    again = ja.methods.build(recipe["method"], recipe["aid"], recipe["parameters"])
    assert ja.parameters(again) == recipe["parameters"]


@pytest.mark.slow
def test_aid_noise_is_estimated_where_it_is_not_stated(files, tmp_path, capsys):
    with np.load(files / "good.npz") as z:
        np.savez(tmp_path / "log.npz", **{k: z[k] for k in z.files if k != "aid_sd"})
    for method, told, stated in (
        ("oba", "estimated from the data", "0.2 m/s (as stated)"),
        ("robust_map", "m/s (by the data)", "by the data; stated: 0.2)"),
    ):
        command = ["align", str(tmp_path / "log.npz"), "--method", method, "--every", "60"]
        assert main([*command, "--output", str(tmp_path / "out.npz")]) == 0
        assert told in capsys.readouterr().out
        with np.load(tmp_path / "out.npz") as z:
            assert z["aid_sd"][-1] == pytest.approx(0.1, rel=0.3)
        assert main([*command, "--aid-sd", "0.2", "--output", str(tmp_path / "out.npz")]) == 0
        assert stated in capsys.readouterr().out
        with np.load(tmp_path / "out.npz") as z:
            recipe = json.loads(str(z["recipe"]))
        assert (recipe["aid_sd"], recipe["aid_sd_from"]) == (0.2, "user")


@pytest.mark.slow
def test_a_recipe_holds_the_figures_of_the_unit(files, tmp_path, capsys):
    """--imu reaches the method that is written, and its deviations need no --imu when it is read back."""
    out = tmp_path / "out.npz"
    command = ["align", str(files / "good.npz"), "--method", "robust_map", "--every", "60"]
    assert main([*command, "--imu", "mems", "--output", str(out)]) == 0
    end = capsys.readouterr().out.splitlines()[-2]
    with np.load(out) as z:
        recipe = json.loads(str(z["recipe"]))
    assert recipe["parameters"]["imu.gyro_bias_deg_h"] == 200.0
    (tmp_path / "again.json").write_text(json.dumps(recipe))
    assert main(["align", str(files / "good.npz"), "--method-file", str(tmp_path / "again.json"), "--every", "60"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == end


def test_simulate_round_trip(tmp_path, capsys):
    path = tmp_path / "log.npz"
    options = ["--set", "outliers=jump", "--set", "gaps=[[30, 40]]"]
    assert main(["simulate", "gps-zigzag", "--seed", "4", "--output", str(path), *options]) == 0
    spoilt, clean = ja.read(path), ja.simulate.simulate("gps-zigzag", 4)
    assert spoilt.missing.sum() == 11
    assert np.nanmax(np.abs(spoilt.velocity - clean.velocity)) > 5
    assert main(["simulate", "gps-zigzag", "--seed", "4", "--output", str(path)]) == 0
    log, direct = ja.read(path), ja.simulate.simulate("gps-zigzag", 4)
    np.testing.assert_array_equal(log.dtheta, direct.dtheta)
    np.testing.assert_array_equal(log.velocity, direct.velocity)
    assert log.aid_sd == direct.aid_sd


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["dvl-turn", "--output", "x.npz"], ["dvl-sturn"]),
        ([], ["dvl-sturn"]),
        (["dvl-sturn"], ["--output"]),
        (["dvl-sturn", "--output", "x.npz", "--set", "outlier=fixed"], ["outliers"]),
        (["dvl-sturn", "--output", "x.npz", "--set", "outliers=few"], ["fixed"]),
        (["dvl-sturn", "--output", "no/x.npz"], ["no/x.npz"]),
        (["dvl-sturn", "--output", "x.npz", "--seed", str(10**20)], ["seed"]),
        (["dvl-sturn", "--output", "x.npz", "--set", "duration=1e9"], ["samples"]),
    ],
)
def test_simulate_refuses(capsys, monkeypatch, tmp_path, arguments, words):
    monkeypatch.chdir(tmp_path)
    message = refused(capsys, ["simulate", *arguments])
    for word in words:
        assert word in message
    assert list(tmp_path.iterdir()) == []


def test_lists(capsys):
    assert main(["methods"]) == 0
    listed = capsys.readouterr().out
    for name in ja.methods.RECIPES:
        assert name in listed
    assert main(["methods", "oba"]) == 0
    assert "Xu 2020" in capsys.readouterr().out
    assert main(["simulate", "--list"]) == 0
    listed = capsys.readouterr().out
    for name in ja.simulate.scenarios():
        assert name in listed
    assert "outliers" in listed
    refused(capsys, ["methods", "obaa"])


@pytest.mark.parametrize("arguments", [["--help"], *([c, "--help"] for c in ("align", "info", "methods", "simulate"))])
def test_help(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 0
    assert "usage: jaxalign" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [[], ["alain"], ["align"], ["align", "x", "--every", "two"], ["align", "x", "--bogus"]]
)
def test_wrong_usage_exits_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage: jaxalign" in capsys.readouterr().err


FLOAT32 = """
import jaxalign as ja
from jaxalign.methods import build
import numpy as np, jax
path = {path!r}

def of_single_precision():
    method = build('oba')
    jax.config.update('jax_enable_x64', True)
    epochs = ja.epochs_from_log(ja.read(path))
    ja.align(method, jax.tree.map(lambda x: x.astype('float32') if x.dtype == float else x, epochs))

for work in (
    lambda: ja.align(build('oba'), ja.read(path)),
    lambda: ja.epochs_from_log(ja.read(path)),
    lambda: ja.simulate.simulate('dvl-sturn', 1),
    of_single_precision,
):
    try:
        work()
    except ja.UserError as error:
        print(error)
"""


def test_float32_is_refused_with_the_way_out(files):
    """In a process of its own: importing the library must not have enabled x64."""
    text = FLOAT32.format(path=str(files / "good.npz"))
    environment = {k: v for k, v in os.environ.items() if k != "JAX_ENABLE_X64"}
    run = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, env=environment, check=True)
    said = run.stdout.splitlines()
    assert len(said) == 4
    assert all("jax_enable_x64" in line for line in said)


def test_interrupt_is_130(files, monkeypatch, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxalign.cli.report.read_log", interrupt)
    assert main(["info", str(files / "good.npz")]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_module_runs_as_a_program(files):
    run = subprocess.run(
        [sys.executable, "-m", "jaxalign", "info", str(files / "good.npz")], capture_output=True, text=True
    )
    assert run.returncode == 0
    assert "200 Hz" in run.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "aid"), [(name, aid) for name, recipe in ja.methods.RECIPES.items() for aid in recipe.aids]
)
def test_every_recipe_aligns_a_file(tmp_path, capsys, name, aid):
    scenario = {"body": "dvl-sturn", "nav": "gps-zigzag", "static": "sway"}[aid]
    log = tmp_path / "log.npz"
    assert main(["simulate", scenario, "--set", "duration=60", "--output", str(log)]) == 0
    out = tmp_path / "out.npz"
    assert main(["align", str(log), "--method", name, "--every", "10", "--output", str(out)]) == 0
    assert "at 60.0 s: pitch" in capsys.readouterr().out
    with np.load(out) as found:
        recipe = json.loads(str(found["recipe"]))
        assert np.isfinite(found["C_nb"][-1]).all()
    assert recipe["method"] == name
    ja.methods.build(recipe["method"], recipe["aid"], recipe["parameters"])  # the recipe builds the method again


def test_a_parameter_by_its_path(tmp_path, capsys):
    log, out = tmp_path / "log.npz", tmp_path / "out.npz"
    assert main(["simulate", "dvl-sturn", "--set", "duration=60", "--output", str(log)]) == 0
    assert main(["align", str(log), "--method", "moba", "--set", "weight.gamma=4", "--output", str(out)]) == 0
    with np.load(out) as found:
        assert json.loads(str(found["recipe"]))["parameters"]["weight.gamma"] == 4.0
    arguments = ["--method", "vo_tvk", "--set", "estimate.kappa=0"]
    assert main(["align", str(log), *arguments, "--every", "10"]) == 0
    said = capsys.readouterr().out
    assert "THE FILTER IS SINGULAR" in said
    assert "NO ATTITUDE" in said
    assert "nan" not in said


@pytest.mark.slow
def test_fine_behind_a_prefilter(tmp_path, capsys):
    parked, out = tmp_path / "parked.npz", tmp_path / "out.npz"
    assert (
        main(["simulate", "disturbed", "--set", "amplitude_mg=10", "--set", "duration=20", "--output", str(parked)])
        == 0
    )
    align = ["align", str(parked), "--method", "fine", "--prefilter", "vondrak", "--set", "prefilter.cutoff=0.4"]
    assert main([*align, "--every", "5", "--output", str(out)]) == 0
    said = capsys.readouterr().out
    assert "specific force behind Vondrak (frame inertial, cutoff 0.4)" in said
    assert "the filter's own standard deviations: east" in said
    assert "the standard deviations are not honest" in said
    assert "biases (right, forward, up): gyros" in said
    with np.load(out) as z:
        recipe = json.loads(str(z["recipe"]))
        assert (recipe["prefilter"], recipe["parameters"]["prefilter.cutoff"]) == ("vondrak", 0.4)
        assert z["covariance"].shape == (41, 15, 15)
        assert np.isnan(z["sd_deg"][0]).all()
        assert (z["sd_deg"][1:] > 0).all()
    for wrong, words in (
        (["--prefilter", "vondark"], "no prefilter 'vondark': did you mean vondrak"),
        (["--prefilter", "vondrak", "--set", "prefilter.cutof=1"], "did you mean prefilter.cutoff"),
        (["--set", "prefilter.cutoff=1"], "there is no prefilter to set: choose one first (--prefilter NAME)"),
        (["--prefilter", "wavelet"], "too short for 8 levels"),
    ):
        assert words in refused(capsys, ["align", parked, "--method", "fine", "--end", "5", *wrong])


def test_a_prefilter_is_for_standing_vehicles(files, capsys):
    said = refused(capsys, ["align", files / "good.npz", "--method", "oba", "--prefilter", "fir"])
    assert "smooths the force of a standing vehicle" in said


def test_methods_without_the_wavelet_library(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pywt", None)
    assert main(["methods"]) == 0
    assert "wavelet filter needs PyWavelets: pip install" in capsys.readouterr().out
