"""Ctrl-C ends a command within two seconds, wherever it is, and leaves nothing half-written."""

import os
import signal
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest

from jaxalign.io import write_npz
from jaxalign.log import Log

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="signals are sent otherwise there"),
    pytest.mark.usefixtures("heard"),
]


def started(*arguments, **environment):
    """A process with pipes, whose compiled programs are not kept."""
    settings = {**os.environ, "JAXALIGN_CACHE": "off", **environment}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, *arguments], text=True, env=settings, **pipes)


def interrupted(process):
    """Press Ctrl-C: what it says on standard output and on standard error."""
    process.send_signal(signal.SIGINT)
    begun = time.monotonic()
    try:
        out, err = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    assert time.monotonic() - begun < 2.0
    assert process.returncode == 130
    assert "Traceback" not in err
    assert err.endswith("\n")
    return out, err


def guarded(text):
    """A program under the guard of the command line, as soon as it prints that it is ready."""
    begin = "from jaxalign.cli.interrupt import guard, patience\nguard()\n"
    process = started("-c", begin + textwrap.dedent(text))
    assert process.stdout.readline() == "ready\n"
    time.sleep(0.3)
    return process


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "log.npz"
    samples = 3000
    w = np.array([0.0, 6e-5, 4e-5])
    write_npz(
        Log(np.tile(w * 0.01, (samples, 1)), np.tile([0, 0, 9.8 * 0.01], (samples, 1)), 0.01, 100, 0.6),
        path,
    )
    return path


@pytest.mark.parametrize("seconds", [0.12, 0.3, 0.7])
def test_at_start_up(log, seconds):
    process = started("-m", "jaxalign", "align", str(log))
    time.sleep(seconds)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode in (130, -signal.SIGINT)  # the latter before Python itself has begun
    assert "Traceback" not in err


def test_in_compilation(log):
    process = started("-m", "jaxalign", "align", str(log), "--method", "velocity_q", JAX_LOG_COMPILES="1")
    for line in process.stderr:
        if "Finished jaxpr to MLIR module conversion jit(_jitted)" in line:
            break
    else:
        pytest.fail("nothing was compiled")
    time.sleep(0.2)
    assert interrupted(process)[1].endswith("jaxalign: interrupted\n")


LOOP = "jax.jit(lambda: jax.lax.while_loop(lambda x: x > 0.0, lambda x: x + 1e-9, 1.0))().block_until_ready()"


def test_in_a_long_compiled_step():
    text = f"""
        import jax
        print("ready", flush=True)
        {LOOP}
    """
    assert interrupted(guarded(text)) == ("", "jaxalign: interrupted\n")


@pytest.mark.slow
def test_in_a_long_compiled_step_of_a_command_that_may_save_something():
    text = f"""
        import jax
        with patience("go on with --resume"):
            print("ready", flush=True)
            {LOOP}
    """
    assert interrupted(guarded(text)) == ("", "jaxalign: interrupted; go on with --resume\n")


def test_what_can_be_saved_is_saved(tmp_path):
    text = f"""
        import time
        from pathlib import Path
        try:
            with patience():
                print("ready", flush=True)
                time.sleep(60)
        except KeyboardInterrupt:
            Path({str(tmp_path / "saved")!r}).write_text("so far")
        time.sleep(60)
    """
    interrupted(guarded(text))
    assert (tmp_path / "saved").read_text() == "so far"


def test_nothing_half_written_is_left(tmp_path):
    text = f"""
        import time
        from jaxalign.files import replacing
        with replacing({str(tmp_path / "file")!r}) as stream:
            stream.write(b"half")
            stream.flush()
            print("ready", flush=True)
            time.sleep(60)
    """
    process = guarded(text)
    assert len(list(tmp_path.iterdir())) == 1
    interrupted(process)
    assert list(tmp_path.iterdir()) == []


def test_a_process_that_ignores_it_goes_on():
    text = """
        import signal
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        from jaxalign.cli.interrupt import guard, patience
        guard()
        with patience():
            print("ready", flush=True)
            input()
    """
    settings = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(text)], text=True, **settings)
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    time.sleep(0.3)
    process.communicate("\n", timeout=30)
    assert process.returncode == 0


@pytest.mark.slow
def test_in_a_study(tmp_path):
    """Finished chunks stay, and say so; the study goes on from them."""
    study = (
        "-m",
        "jaxalign",
        "study",
        "dvl-sturn",
        "--set",
        "duration=30",
        "--methods",
        "oba",
        "--output",
        str(tmp_path / "s"),
    )
    more = ("--runs", "4000000", "--chunk", "64")
    process = started(*study, *more, XLA_FLAGS="--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0")
    end = time.monotonic() + 240
    while not list(tmp_path.glob("s/chunks/*.npz")) and process.poll() is None and time.monotonic() < end:
        time.sleep(0.1)
    out, err = interrupted(process)
    assert "oba" in out
    assert "runs, on disk in" in err
    assert list(tmp_path.glob("s/chunks/*.npz"))
    assert not list(tmp_path.glob("s/**/.*.part"))
