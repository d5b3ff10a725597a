"""The command and its store of compiled programs: the same answer whatever is wrong with it, at most one quiet line."""

import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

from jaxalign.io import write_npz
from jaxalign.log import Log

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="made for Linux")]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "log.npz"
    rng = np.random.default_rng(0)
    rates, forces = np.array([0.0, 6.1e-5, 4.0e-5]), np.array([0.0, 0.0, 9.79])
    dtheta = rng.normal(rates * 0.01, 1e-7, (6000, 3))
    write_npz(Log(dtheta, rng.normal(forces * 0.01, 1e-5, (6000, 3)), 0.01, 100, 0.58), path)
    return path


def begun(log, store, **settings):
    """`jaxalign align` with a store."""
    command = [sys.executable, "-m", "jaxalign", "align", str(log), "--method", "velocity_q"]
    environment = {**os.environ, "JAXALIGN_CACHE": str(store)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, env=environment, **pipes, **settings)


def answered(process):
    """What it prints and says."""
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out, err


@pytest.fixture(scope="module")
def answer(log):
    out, err = answered(begun(log, "off"))
    assert err == ""
    return out


@pytest.fixture(scope="module")
def filled(log, answer, tmp_path_factory):
    """A store that two commands have filled at once."""
    store = tmp_path_factory.mktemp("stores") / "store"
    for process in [begun(log, store) for _ in range(2)]:
        assert answered(process) == (answer, "")
    return store


def programs(store):
    return sorted(store.glob("xla-*/*.program"))


def test_two_at_once_on_an_empty_store(log, answer, filled):
    files = {file: file.stat().st_ino for file in programs(filled)}
    assert files
    assert not list(filled.glob("*/.*"))
    assert answered(begun(log, filled)) == (answer, "")
    assert {file: file.stat().st_ino for file in programs(filled)} == files  # read, not written again


def test_the_default_method_compiles_nothing_small(log, tmp_path):
    """Only the steps of the search, and the vectors that tell the noise."""
    environment = {**os.environ, "JAXALIGN_CACHE": str(tmp_path), "JAX_LOG_COMPILES": "1"}
    command = [sys.executable, "-m", "jaxalign", "align", str(log), "--every", "60"]
    run = subprocess.run(command, text=True, env=environment, capture_output=True, timeout=300, check=True)
    compiled = re.findall(r"Finished XLA compilation of jit\((\w+)\)", run.stderr)
    assert {"begin_search", "step"} <= set(compiled) <= {"begin_search", "step", "with_heading", "_best", "_jitted"}


def test_entries_cut_off_and_those_of_another_jaxlib(log, answer, filled, tmp_path):
    store = tmp_path / "store"
    shutil.copytree(filled, store)
    (place,) = store.glob("xla-*")
    for file in programs(store):
        file.write_bytes(file.read_bytes()[:1000])
    assert answered(begun(log, store)) == (answer, "")
    assert min(file.stat().st_size for file in place.glob("host-_jitted*")) > 1000
    shutil.copytree(place, store / "xla-0123456789abcdef")  # whole entries, under the names of this one
    for file in (store / "xla-0123456789abcdef").glob("*.program"):
        shutil.copy(file, place / file.name)
        data = bytearray((place / file.name).read_bytes())
        data[0] ^= 1  # signed for another folder
        (place / file.name).write_bytes(data)
    assert answered(begun(log, store)) == (answer, "")


def test_no_folder_can_be_made(log, answer, tmp_path):
    (tmp_path / "file").write_text("")
    out, err = answered(begun(log, tmp_path / "file" / "store"))
    assert out == answer
    assert err.count("\n") == 1
    assert err.startswith("jaxalign: compiled programs are not kept")


def test_a_full_disk(log, answer, tmp_path):
    small = tmp_path / "small"
    small.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(small)], capture_output=True)
    if made.returncode:
        pytest.skip("no small disk can be made here")
    try:
        out, err = answered(begun(log, small / "store"))
        left = list(small.glob("store/*/.*"))
    finally:
        subprocess.run(["umount", str(small)], check=True)
    assert out == answer
    assert err.count("\n") == 1
    assert "No space left" in err
    assert left == []
