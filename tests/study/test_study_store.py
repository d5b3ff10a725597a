"""Studies on disk: cut into chunks, killed, resumed, they end in the identical result."""

import shutil
import signal
import time

import numpy as np
import pytest
from studies import RUNS, assert_identical, result_of_small, small

from jaxalign import UserError, with_parameters
from jaxalign.study import Interrupted, Study, engine, run
from jaxalign.study.worker import Worker


@pytest.fixture(scope="module")
def study():
    return small()


@pytest.fixture(scope="module")
def result():
    return result_of_small()


def test_chunks_make_no_difference(study, result, tmp_path):
    assert study.block == 32
    assert_identical(run(study, chunk=1, out=tmp_path / "a"), result)
    assert len(list((tmp_path / "a" / "chunks").iterdir())) == 4


def test_resume_completes_to_the_identical_result(study, result, tmp_path):
    run(study, chunk=32, out=tmp_path)
    files = sorted((tmp_path / "chunks").iterdir())
    files[1].unlink()  # never written
    whole = files[2].read_bytes()
    files[2].write_bytes(whole[: len(whole) // 2])  # cut off
    (tmp_path / "chunks" / ".000000000-000000031.npz.77.part").write_bytes(b"half")  # killed while writing
    said = []
    assert_identical(run(study, chunk=64, out=tmp_path, resume=True, warn=said.append), result)
    assert len(said) == 1
    assert files[2].name in said[0]
    assert "done again" in said[0]
    assert not list((tmp_path / "chunks").glob(".*"))


def test_a_flipped_bit_is_noticed(study, result, tmp_path):
    run(study, out=tmp_path)
    path = next((tmp_path / "chunks").iterdir())
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    said = []
    assert_identical(run(study, out=tmp_path, resume=True, warn=said.append), result)
    assert len(said) == 1


def _other_seed(study):
    return Study(study.scenario, study.methods, RUNS, 5, tolerance_deg=20.0, window=(30.0, 60.0))


def test_a_chunk_of_another_study_is_refused(study, tmp_path):
    run(study, chunk=32, out=tmp_path / "a")
    run(_other_seed(study), chunk=32, out=tmp_path / "b")
    name = "000000032-000000063.npz"
    shutil.copy(tmp_path / "b" / "chunks" / name, tmp_path / "a" / "chunks" / name)
    with pytest.raises(UserError, match=rf"{name}: of another study, with other settings: take it out") as found:
        run(study, out=tmp_path / "a", resume=True)
    assert "\n" not in str(found.value)
    assert (tmp_path / "a" / "chunks" / name).exists()  # it is somebody's


def test_a_chunk_under_another_name_is_refused(study, result, tmp_path):
    run(study, chunk=32, out=tmp_path)
    chunks = tmp_path / "chunks"
    (chunks / "000000064-000000095.npz").unlink()
    (chunks / "000000032-000000063.npz").rename(chunks / "000000064-000000095.npz")
    with pytest.raises(UserError, match="holds the runs 32 to 63, not those of its name: name it 000000032") as found:
        run(study, out=tmp_path, resume=True)
    assert "\n" not in str(found.value)
    (chunks / "000000064-000000095.npz").rename(chunks / "000000032-000000063.npz")
    assert_identical(run(study, out=tmp_path, resume=True), result)


def test_nothing_is_left_to_do(study, result, tmp_path):
    run(study, out=tmp_path)
    start = time.perf_counter()
    assert_identical(run(study, out=tmp_path, resume=True), result)
    assert time.perf_counter() - start < 60


def test_a_folder_in_use_is_refused(study, tmp_path):
    run(study, out=tmp_path)
    with pytest.raises(UserError, match="holds a study already"):
        run(study, out=tmp_path)
    with pytest.raises(UserError, match=r"other settings \(seed was 4, is 5\)"):
        run(_other_seed(study), out=tmp_path, resume=True)
    tuned = {"oba": study.methods["oba"], "roba": with_parameters(study.methods["roba"], {"weight.threshold": 3.0})}
    changed = Study(study.scenario, tuned, RUNS, 4, tolerance_deg=20.0, window=(30.0, 60.0))
    with pytest.raises(UserError, match=r"methods.roba.weight.threshold was 2.5, is 3.0"):
        run(changed, out=tmp_path, resume=True)


def test_other_flags_of_the_compiler_are_refused(study, tmp_path, monkeypatch):
    """The last bits depend on them, but not on a number of devices."""
    from jaxalign.study.store import Store

    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false")
    Store(tmp_path, study.settings, resume=False).close()
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false --xla_force_host_platform_device_count=7")
    Store(tmp_path, study.settings, resume=True).close()
    monkeypatch.setenv("XLA_FLAGS", "")
    with pytest.raises(UserError, match=r'other settings \(xla_flags was \["--xla_cpu_enable_fast_math=false"\], is'):
        Store(tmp_path, study.settings, resume=True)


@pytest.mark.parametrize("content", ["file", "json", "chunks", "results"])
def test_a_folder_of_something_else_is_refused(study, tmp_path, content):
    folder = tmp_path / "there"
    if content == "file":
        folder.write_text("x")
    else:
        (folder / "chunks").mkdir(parents=True)
        name = {"json": "study.json", "chunks": "chunks/000000000-000000031.npz", "results": "results.npz"}[content]
        (folder / name).write_text("{")
    with pytest.raises(UserError, match="name another"):
        run(study, out=folder, resume=content == "json")


def test_a_full_disk(study, result, tmp_path, monkeypatch):
    """The third write fails: two chunks stay, and the study can be completed."""
    writes = []
    save = np.savez_compressed

    def failing(*args, **kwargs):
        writes.append(1)
        if len(writes) == 3:
            raise OSError(28, "No space left on device")
        save(*args, **kwargs)

    monkeypatch.setattr(np, "savez_compressed", failing)
    with pytest.raises(UserError, match=r"No space left on device; 64 of 100 runs are on disk: .*--resume"):
        run(study, chunk=32, out=tmp_path)
    assert len(list((tmp_path / "chunks").iterdir())) == 2
    assert_identical(run(study, chunk=32, out=tmp_path, resume=True), result)


def test_interrupted(study, result, tmp_path, monkeypatch):
    """Ctrl-C in the third block: the finished blocks are on disk, and their statistics come with the error."""
    work = Worker.__call__

    def interrupted(worker, block):
        if block == 2:
            raise KeyboardInterrupt
        return work(worker, block)

    monkeypatch.setattr(Worker, "__call__", interrupted)
    with pytest.raises(Interrupted, match="interrupted after 64 of 100 runs, on disk") as found:
        run(study, out=tmp_path)
    assert found.value.result.runs == 64
    np.testing.assert_array_equal(found.value.result["oba"].end, result["oba"].end[:64])
    monkeypatch.undo()
    assert_identical(run(study, out=tmp_path, resume=True), result)


def test_a_folder_has_one_study_at_a_time(study, tmp_path):
    from jaxalign.study.store import Store

    first = Store(tmp_path, study.settings, resume=False)
    with pytest.raises(UserError, match="a study is running in it"):
        run(study, out=tmp_path, resume=True)
    first.close()
    run(study, out=tmp_path, resume=True)


def test_nothing_to_resume_is_said(study, tmp_path):
    said = []
    run(study, out=tmp_path / "new", resume=True, warn=said.append)
    assert "holds no study to resume" in said[0]


def test_interrupted_while_writing(study, result, tmp_path, monkeypatch):
    """Ctrl-C waits until the chunk is on disk."""
    write = engine.Store.write

    def slow(store, *what):
        signal.raise_signal(signal.SIGINT)
        write(store, *what)

    monkeypatch.setattr(engine.Store, "write", slow)
    with pytest.raises(Interrupted, match="interrupted after 32 of 100 runs, on disk"):
        run(study, out=tmp_path, chunk=32)
    monkeypatch.undo()
    assert len(list((tmp_path / "chunks").iterdir())) == 1
    assert_identical(run(study, out=tmp_path, resume=True), result)
