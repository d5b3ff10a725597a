"""The command line: results, files, exit codes, one line for every user error."""

import os
import subprocess
import sys

import numpy as np
import pytest
from command_line import refused

import jaxalign as ja
from jaxalign.cli.main import main


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
        (["--method", "roba", "--set", "weight.residual=open"], ["vector", "norm"]),
        (["--method", "oba", "--set", "observe.coriolis=recursive"], ["observe.coriolis", "oba_as_published"]),
        (["--method", "oba", "--set", "front_end.interval_samples=7"], ["200"]),
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


def test_simulate_round_trip(tmp_path, capsys):
    path = tmp_path / "log.npz"
    options = ["--set", "outliers=jump", "--set", "gaps=[[30, 40]]"]
    assert main(["simulate", "gps-zigzag", "--seed", "4", "--output", str(path), *options]) == 0
    spoilt, clean = ja.read(path), ja.simulate.simulate("gps-zigzag", 4)
    assert spoilt.aids[0].missing.sum() == 11
    assert np.nanmax(np.abs(spoilt.aids[0].value - clean.aids[0].value)) > 5
    assert main(["simulate", "gps-zigzag", "--seed", "4", "--output", str(path)]) == 0
    log, direct = ja.read(path), ja.simulate.simulate("gps-zigzag", 4)
    np.testing.assert_array_equal(log.dtheta, direct.dtheta)
    np.testing.assert_array_equal(log.aids[0].value, direct.aids[0].value)
    assert log.aids[0].sd == direct.aids[0].sd


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


def test_methods_without_the_wavelet_library(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pywt", None)
    assert main(["methods"]) == 0
    assert "wavelet filter needs PyWavelets: pip install" in capsys.readouterr().out
