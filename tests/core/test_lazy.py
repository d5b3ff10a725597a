"""Names are imported when they are used, and mean what they meant when all were imported at once."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import jaxalign

ROOT = Path(jaxalign.__file__).parent
PACKAGES = [
    ".".join(("jaxalign", *path.parent.relative_to(ROOT).parts))
    for path in sorted(ROOT.rglob("__init__.py"))
    if "lazily(" in path.read_text()
]


@pytest.mark.parametrize("package", PACKAGES)
def test_names_are_declared_alike(package):
    """`__all__`, the imports for type checkers and the table of homes say the same."""
    module = import_module(package)
    tree = ast.parse(Path(module.__file__).read_text())
    typed = {
        (node.module, name.name)
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    homes = {(f"{package}.{home}", name) for home, names in module._HOMES.items() for name in names.split()}
    modules = {(package, name) for home, name in typed if home == package}
    assert typed == homes | modules
    assert {name for _, name in typed} == set(module.__all__)
    for name in module.__all__:
        assert name in dir(module)
        assert getattr(module, name) is not None


ORDERS = [
    "import jaxalign",
    "import jaxalign.parametrization, jaxalign.mechanization, jaxalign.preintegration, jaxalign.methods",
    "from jaxalign import parameters, navigate, preintegrate, bound, build",
    "from jaxalign.methods import build; from jaxalign.cli import align, tune",
]


@pytest.mark.parametrize("first", [*ORDERS[:1], *(pytest.param(x, marks=pytest.mark.slow) for x in ORDERS[1:])])
def test_a_function_keeps_its_name_whatever_is_imported_first(first):
    text = f"""{first}
import jaxalign, jaxalign.mechanization, jaxalign.parametrization, jaxalign.preintegration
import jaxalign.estimate.eigenproblem, jaxalign.prefilter.vondrak_filter
for name in ("parameters", "navigate", "preintegrate", "bound", "build", "align", "read"):
    assert callable(getattr(jaxalign, name)), name
for name in ("study", "simulate", "methods", "bounds", "aligner", "tune", "plots", "compilation"):
    assert getattr(jaxalign, name).__name__ == "jaxalign." + name
assert callable(jaxalign.estimate.davenport) and callable(jaxalign.prefilter.vondrak)
assert callable(jaxalign.davenport)
try:
    jaxalign.nothing
except AttributeError as error:
    assert "nothing" in str(error)
else:
    raise AssertionError
"""
    subprocess.run([sys.executable, "-c", text], check=True)


@pytest.mark.parametrize("package", PACKAGES)
def test_no_function_hides_a_module(package):
    module = import_module(package)
    beside = {path.stem for path in Path(module.__file__).parent.iterdir()}
    assert not beside & {name for names in module._HOMES.values() for name in names.split()}


@pytest.mark.parametrize(
    ("command", "without"),
    [
        ("from jaxalign.cli.main import parser; parser().format_help()", ("numpy", "jax", "equinox", "scipy")),
        (
            "import jaxalign.info, jaxalign.io; jaxalign.io.read, jaxalign.io.read_csv, jaxalign.io.read_npz",
            ("jax", "equinox"),
        ),
        (
            "import jaxalign.aligner, jaxalign.methods",
            ("scipy", "optax", "matplotlib", "jaxalign.study", "jaxalign.tune"),
        ),
        ("import jaxalign.study, jaxalign.tune, jaxalign.simulate", ("jax", "optax")),
    ],
)
def test_what_is_not_needed_is_not_imported(command, without):
    text = f"{command}\nimport sys\nprint([name for name in {without} if name in sys.modules])"
    run = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"
