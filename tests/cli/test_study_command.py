"""The command `jaxalign study`: over cores and processes, killed, with wrong flags."""

import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from studies import RUNS, arrays, result_of_small

from jaxalign import UserError


@pytest.fixture(scope="module")
def result():
    return result_of_small()


COMMAND = [sys.executable, "-m", "jaxalign", "study", "dvl-sturn", "--set", "outliers=fixed", "--set", "duration=60"]


SAME = ["--methods", "oba,roba", "--runs", str(RUNS), "--seed", "4", "--tolerance", "20", "--window", "30", "60"]


@pytest.mark.slow
def test_command_on_all_cores_is_the_same_to_the_last_bit(result, tmp_path):
    """The command takes each core as a device of its own. The first of the two methods: each device compiles it."""
    command = [*COMMAND, *SAME, "--methods", "oba", "--output", tmp_path, "--plot"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "wrote" in done.stdout
    assert "oba" in done.stdout
    with np.load(tmp_path / "results.npz") as file:
        for key, value in arrays(result).items():
            np.testing.assert_array_equal(file[key], value[: len(file[key])], err_msg=key)


@pytest.mark.slow
def test_two_processes_are_the_same_to_the_last_bit(result, tmp_path):

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    together = ["--distributed", f"127.0.0.1:{port}", "--processes", "2"]
    both = [
        subprocess.Popen(
            [*COMMAND, *SAME, "--output", tmp_path, "--chunk", "32", *together, "--rank", str(rank)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in (0, 1)
    ]
    said = [process.communicate(timeout=300) for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    assert "roba" in said[0][0]
    assert "oba" not in said[1][0]  # (Gloo has a line of its own)
    with np.load(tmp_path / "results.npz") as file:
        for key, value in arrays(result).items():
            np.testing.assert_array_equal(file[key], value, err_msg=key)


@pytest.mark.slow
def test_processes_with_different_flags_refuse(tmp_path):

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    together = ["--distributed", f"127.0.0.1:{port}", "--processes", "2"]
    both = [
        subprocess.Popen(
            [*COMMAND, "--runs", str(100 + rank), *together, "--rank", str(rank)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in (0, 1)
    ]
    said = [process.communicate(timeout=120) for process in both]
    assert [process.returncode for process in both] == [2, 2], said
    assert all("use the same flags" in errors and "Traceback" not in errors for _, errors in said)


@pytest.mark.slow
@pytest.mark.usefixtures("heard")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_killed_and_resumed(how, tmp_path):
    """At any moment, here as soon as a chunk is there; the resumed study is the one that was never stopped."""
    many = [*COMMAND, "--methods", "oba", "--runs", "40000", "--chunk", "2048"]
    process = subprocess.Popen([*many, "--output", tmp_path / "a"], stderr=subprocess.PIPE, text=True)
    while not list((tmp_path / "a" / "chunks").glob("0*.npz")):
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(how)
    _, said = process.communicate(timeout=60)
    if how == signal.SIGINT:
        assert process.returncode == 130
        assert "go on with --resume" in said
        assert "Traceback" not in said
    kept = list((tmp_path / "a" / "chunks").glob("0*.npz"))
    assert 0 < len(kept) < 20
    subprocess.run([*many, "--output", tmp_path / "a", "--resume"], check=True, capture_output=True)
    subprocess.run([*many, "--output", tmp_path / "b"], check=True, capture_output=True)
    with np.load(tmp_path / "a" / "results.npz") as one, np.load(tmp_path / "b" / "results.npz") as two:
        assert set(one) == set(two)
        for key in one:
            np.testing.assert_array_equal(one[key], two[key], err_msg=key)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods", "obba"], "did you mean"),
        (["--methods", "oba,oba"], "named twice"),
        (["--methods", "oba", "--set", "weight.threshold=3"], "weight.threshold"),
        (["--methods", "oba", "--set", "rba:weight.threshold=3"], "no method 'rba' in --methods"),
        (["--set", "outlier=fixed"], "no option 'outlier'; did you mean"),
        (["--runs", "1"], "runs = 1"),
        (["--fidelity", "x"], "fidelity = 'x'"),
        (["--plot"], "--plot needs a folder"),
        (["--resume"], "--resume needs a folder"),
        (["--rank", "1"], "go with --distributed"),
        (["--distributed", "127.0.0.1:9", "--processes", "2"], "the rank of this one"),
        (["--distributed", "here", "--processes", "2", "--rank", "0"], "write it as host:port"),
        (["--output", "/dev/null/x"], "cannot be used"),
        (["--set", "name=x"], "no option 'name'"),
        (["--distributed", "7777", "--processes", "2", "--rank", "0"], "write it as host:port"),
        (["--output", "/dev/null"], "is not a folder"),
    ],
)
def test_wrong_flags(arguments, message, capsys):
    from jaxalign.cli.main import main

    assert main(["study", "dvl-sturn", "--set", "duration=60", "--runs", "4", *arguments]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_variants_of_one_method():
    from jaxalign.cli.study import _methods

    found = _methods("roba, wide=roba,oba", "body", None, {"weight.threshold": "3", "wide:weight.threshold": "5"})
    assert list(found) == ["roba", "wide", "oba"]
    assert (float(found["roba"].weight.threshold), float(found["wide"].weight.threshold)) == (3.0, 5.0)


def test_settings_find_their_place():
    from jaxalign.cli.report import split_settings

    given = {"outliers": "fixed", "weight.threshold": "3", "b:gap": "1", "heading_margin": "2", "duration": "60"}
    of_scenario, of_methods = split_settings(given, "dvl-sturn")
    assert list(of_scenario) == ["outliers", "duration"]
    assert list(of_methods) == ["weight.threshold", "b:gap", "heading_margin"]


def test_nobody_answers(monkeypatch):
    from jaxalign.study import devices

    monkeypatch.setattr(devices, "_PATIENCE_S", 0)
    with pytest.raises(UserError, match="nobody answers at 127"):
        devices.join("127.0.0.1:9", 2, 1)
