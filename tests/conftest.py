import gc
import itertools
import os
import re
import signal
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import cache
import jax
import pytest
from jaxtyping import install_import_hook
from times import Times

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_traceback_in_locations_limit", 0)  # nobody reads where an operation came from
gc.set_threshold(100_000, 50, 100)  # what JAX traces are many small objects that are soon gone
# The shapes in the annotations are checked in the tests, not in production: in the rooms that handle arrays (those that
# parse what users type have messages of their own, which a type checker would forestall).
ARRAYS = ("vector", "rotation", "earth", "linear", "observability", "solution", "metrics")
OBSERVE = ("base", "nav_velocity", "window")
ESTIMATE = ("base", "eigenproblem", "profile", "qmethod", "triad")
install_import_hook(
    [f"jaxalign.{name}" for name in ARRAYS]
    + [f"jaxalign.observe.{name}" for name in OBSERVE]
    + [f"jaxalign.estimate.{name}" for name in ESTIMATE],
    "beartype.beartype",
)


# Tests compile more than they run. Less: half of the time to compile, code as fast; none: a third, code half as fast.
# A program compiled in one piece takes a fifth less in all.
LESS = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
NONE = f"{LESS} --xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
OPTIMISE = {"all": "", "less": LESS, "none": NONE}


def pytest_addoption(parser):
    parser.addoption("--optimise", choices=OPTIMISE, default="all", help="by XLA, where it knows how (%(default)s)")
    parser.addoption("--times", action="store_true", help="print the CPU seconds of every file and room")


def pytest_configure(config):
    if not hasattr(config, "workerinput"):
        flags = os.environ.get("XLA_FLAGS") or OPTIMISE[config.getoption("optimise")]
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its matrices are small; its threads wait by turning
        if cache.tried(flags):  # XLA aborts on a flag that it does not know
            os.environ["XLA_FLAGS"] = flags  # workers and commands inherit them
    cache.use()
    if config.getoption("times"):
        config.pluginmanager.register(Times())


def pytest_collection_finish():
    gc.freeze()  # modules and tests stay: not looked through again


# Files that share what they compile go to one worker.
TOGETHER = {
    "tests/cli/test_align_command.py": "tests/cli/test_cli.py",
    "tests/cli/test_study_command.py": "tests/study",
    "tests/study/test_study_store.py": "tests/study",
    "tests/study/test_study.py": "tests/study",
}


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A file goes to one worker, which compiles once what its tests share; of the contract, the rows of one recipe."""
    from xdist.scheduler import LoadScopeScheduling

    class ByPrograms(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            path, _, name = nodeid.partition("::")
            recipe = re.search(r"\[(\w+-(?:body|nav|static))\b", name)
            return recipe[1] if recipe else TOGETHER.get(path, path)

    return ByPrograms(config, log)


def roomy(call, /, *arguments, **named):
    return call(*arguments, **named)


# CPython keeps its frames in chunks of 16 KiB; where a loop of calls straddles the end of one, every call maps and
# unmaps memory, and costs 100 times as much. A frame that asks for much gets a chunk of a size to hold all the others.
roomy.__code__ = roomy.__code__.replace(co_stacksize=1 << 17)


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem):
    pyfuncitem.obj = partial(roomy, pyfuncitem.obj)
    return (yield)


@pytest.fixture(scope="module")
def heard():
    """Ctrl-C reaches the processes also where these tests run in the background of a shell, which has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True)
def compiles_itself(request):
    """No programs of another run where they are what is tested."""
    marks = (request.node.get_closest_marker(name) for name in ("exact", "uncached"))
    with cache.unused() if any(marks) else nullcontext():
        yield


MAPS = Path("/proc/self/maps")
count = itertools.count()


def pytest_runtest_teardown(item, nextitem):
    """Every compiled program maps memory (a recipe some 1000 times); at 65530 (vm.max_map_count) XLA crashes."""
    if next(count) % 5 == 0 and MAPS.exists():
        with MAPS.open("rb") as lines:
            crowded = sum(1 for _ in lines) > 40_000
        if crowded:
            jax.clear_caches()


ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with the frozen cases and the real logs; tests that need it skip where it is absent."""
    path = Path(os.environ.get("JAXALIGN_SHARED", ROOT.parent / "shared"))
    if not (path / "cases").is_dir():
        pytest.skip("no shared cases and logs here (set JAXALIGN_SHARED to their folder)")
    return path
