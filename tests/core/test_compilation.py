"""The store of compiled programs: nothing that is wrong with it changes an answer, or says more than a line."""

import os
import subprocess
import sys
import textwrap

import pytest

from jaxalign.compilation import flags, folder, probe
from jaxalign.compilation.entries import Entries, prune

PROGRAM = """
    import jax, sys
    jax.config.update("jax_enable_x64", True)
    events = []
    jax.monitoring.register_event_listener(lambda event, **_: events.append(event.rpartition("/")[2]))
    from jaxalign import compilation
    print(compilation.configure())
    {before}
    x = jax.jit(lambda x: jax.lax.scan(lambda c, y: (c * y + 1.0, None), x, x * jax.numpy.ones(5))[0])(2.0)
    x = jax.jit(lambda x: x + 1.0)(jax.jit(lambda x: x - 1.0)(x))
    x = jax.jit(lambda x: x * 3.0)(jax.jit(lambda x: x / 3.0)(x))
    print(float(x), events.count("cache_hits"), events.count("cache_misses"))
"""


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("JAXALIGN_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def program(before=""):
    """A program of its own: where it keeps compiled programs, its answer, hits, misses; what it says on stderr."""
    text = textwrap.dedent(PROGRAM).format(before=before)
    run = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    where, numbers = run.stdout.split("\n")[:2]
    answer, hits, misses = numbers.split()
    assert float(answer) == 95.0  # 2 * 2 + 1 = 5, 11, 23, 47, 95
    return where, int(hits), int(misses), run.stderr


def known(cache, verdict="accepted"):
    """The folder of this machine and version, with nothing but a verdict in it."""
    where = program()[0]
    for file in (cache / where).iterdir():
        file.unlink()
    (cache / where / verdict).touch()
    return cache / where


def test_programs_are_found_again_and_damaged_ones_made_anew(cache):
    place = known(cache)
    assert place.stat().st_mode & 0o777 == cache.stat().st_mode & 0o777 == 0o700
    assert program() == (str(place), 0, 5, "")
    files = sorted(place.glob("*.program"))
    whole = {file: file.read_bytes() for file in files}
    for i, file in enumerate(files):  # cut off, of another content, empty, and whole but no program
        key, data = file.name.removesuffix(".program"), whole[file]
        foreign = Entries(place, True)._digest(key, b"of another jaxlib") + b"of another jaxlib"
        file.write_bytes([data[: len(data) // 2], data[:-1] + b"?", b"", foreign][i % 4])
    assert len(files) == 5
    assert program() == (str(place), 0, 5, "")
    assert program() == (str(place), 5, 0, "")
    # Whole again; not of the same length to the byte: an entry holds the time that it took to compile.
    assert all(len(file.read_bytes()) > 0.9 * len(whole[file]) for file in files)


def test_where_stored_programs_are_refused_none_are_kept(cache):
    known(cache, "rejected")
    assert program() == ("None", 0, 0, "")


def test_until_it_is_known_programs_are_written_only(cache):
    place = known(cache)
    (place / "accepted").unlink()
    assert program() == (str(place), 0, 5, "")
    assert probe.verdict(place) is not None


REFUSED = "Target machine feature +prefer-no-gather is not supported on the host machine."


@pytest.mark.parametrize(
    ("does", "verdict"),
    [("None", True), ("1 / 0", False), (f"os.write(2, b{REFUSED!r})", False)],
)
def test_the_probe_tells_and_is_silent(tmp_path, does, verdict):
    """Programs that load, that do not, and of which XLA says on standard error that they do not fit."""
    text = f"""
        import os
        from jax.experimental import serialize_executable
        from jaxalign.compilation import probe
        load = serialize_executable.deserialize_and_load
        serialize_executable.deserialize_and_load = lambda *stored: ({does}, load(*stored))
        probe.settle(probe.Path({str(tmp_path)!r}))
    """
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(text)], capture_output=True, text=True, check=True)
    assert (run.stdout, run.stderr) == ("", "")
    assert probe.verdict(tmp_path) is verdict


@pytest.mark.parametrize("limit", ["full", "file"])
def test_what_cannot_be_written_costs_one_line(cache, limit):
    before = ""
    if limit == "full":  # as a full disk: every write fails
        before = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))"
    else:
        cache.write_text("a file where a folder should be")
    said = program(before)[-1]
    assert said.count("\n") == 1
    assert "compiled programs are not kept" in said
    assert not list(cache.parent.glob("cache/*/.*"))


def test_import_changes_nothing():
    text = """
        import os
        before = dict(os.environ)
        import jax, jaxalign, jaxalign.study, jaxalign.tune
        assert jax.config.jax_compilation_cache_dir is None
        assert dict(os.environ) == before
    """
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("JAXALIGN", "XLA"))}
    subprocess.run([sys.executable, "-c", textwrap.dedent(text)], check=True, env=environment)


def test_an_entry_of_another_folder_or_key_is_not_there(tmp_path):
    here, there = Entries(tmp_path / "xla-a", True), Entries(tmp_path / "xla-b", True)
    for store in (here, there):
        store.folder.mkdir()
    here.put("key", b"content")
    assert here.get("key") == b"content"
    assert here.get("other") is None
    (there.folder / "key.program").write_bytes((here.folder / "key.program").read_bytes())
    assert there.get("key") is None
    (here.folder / "other.program").write_bytes((here.folder / "key.program").read_bytes())
    assert here.get("other") is None
    there.put("key", b"new")
    assert there.get("key") == b"new"
    assert Entries(here.folder, readable=False).get("key") is None


def test_the_longest_unused_go_first(tmp_path):
    store = Entries(tmp_path / "xla-a", True)
    store.folder.mkdir()
    stranger = tmp_path / "xla-a" / "notes.txt"
    stranger.write_text("not ours")
    for i in range(8):
        store.put(f"{i}", bytes(1000))
        os.utime(store.folder / f"{i}.program", (i, i))
    left = store.folder / ".9.program.1.part"
    left.write_bytes(b"of a process that was killed")
    os.utime(left, (0, 0))
    assert store.get("0") is not None  # used just now
    prune(tmp_path, 100_000)
    assert len(list(store.folder.glob("*.program"))) == 8
    assert not left.exists()
    prune(tmp_path, 8000)  # 8 x 1032 bytes
    assert sorted(file.stem for file in store.folder.glob("*.program")) == ["0", "4", "5", "6", "7"]
    assert stranger.exists()


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system has no such permissions")
def test_a_folder_that_others_could_write_to_is_refused(tmp_path, monkeypatch):
    place = tmp_path / "cache"
    place.mkdir()
    for mode in (0o770, 0o707):
        place.chmod(mode)
        with pytest.raises(folder.Unusable, match="others may write"):
            folder.opened(place)
    place.chmod(0o755)
    assert folder.opened(place) == place.resolve()
    monkeypatch.setattr(os, "geteuid", lambda: place.stat().st_uid + 1)
    with pytest.raises(folder.Unusable, match="another user"):
        folder.opened(place)


def test_where_the_store_is(monkeypatch, tmp_path):
    for text in ("off", "OFF", "0"):
        monkeypatch.setenv("JAXALIGN_CACHE", text)
        assert folder.chosen() is None
    monkeypatch.setenv("JAXALIGN_CACHE", str(tmp_path))
    assert folder.chosen() == tmp_path
    monkeypatch.delenv("JAXALIGN_CACHE")
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert folder.chosen() == tmp_path / "jaxalign"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert folder.chosen() == tmp_path / ".cache" / "jaxalign"


def test_versions_and_flags_have_folders_of_their_own(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "")
    names = [folder.subfolder("0.10.2", "0.10.2"), folder.subfolder("0.10.2", "0.10.1")]
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_max_isa=AVX2")
    names.append(folder.subfolder("0.10.2", "0.10.2"))
    assert len(set(names)) == 3


@pytest.mark.parametrize(
    ("given", "then"),
    [
        (None, "--xla_backend_extra_options=OURS"),
        ("--xla_a=1", "--xla_a=1 --xla_backend_extra_options=OURS"),
        ("--xla_backend_extra_options=xla_a=1 --xla_b=2", "--xla_backend_extra_options=xla_a=1,OURS --xla_b=2"),
        ("--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=5", None),
    ],
)
def test_the_flag_joins_those_of_the_user(monkeypatch, given, then):
    monkeypatch.setenv("XLA_FLAGS", given or "")
    flags.add_fast_loops()
    ours = "xla_cpu_small_while_loop_byte_threshold=100000000"
    assert os.environ["XLA_FLAGS"] == (given if then is None else then.replace("OURS", ours))
    flags.add_fast_loops()
    assert os.environ["XLA_FLAGS"].count("small_while_loop") == 1
