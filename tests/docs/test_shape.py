"""The map of the rooms in CONTRIBUTING.md is what the imports are: all rooms, and each import points down."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "jaxalign"
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
NAMES = slice(4, 37)  # columns of the map


def levels() -> dict[str, int]:
    """Room -> line of the map."""
    block = TEXT.split("also those inside functions:\n\n")[1].split("\n\nBeside the package")[0]
    lines = [line[NAMES].split() for line in block.splitlines()]
    return {name.removesuffix("/"): i for i, names in enumerate(lines) for name in names}


def modules() -> dict[str, Path]:
    """Name below the package -> file, without those that only list names."""
    out = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.name not in ("__init__.py", "__main__.py"):
            out[".".join(path.relative_to(PACKAGE).with_suffix("").parts)] = path
    return out


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """What a file imports of the package when it runs: the files, or the room where a name comes from one."""
    tree = ast.parse(path.read_text())
    typing = {
        id(node)
        for found in ast.walk(tree)
        if isinstance(found, ast.If) and "TYPE_CHECKING" in ast.dump(found.test)
        for part in found.body
        for node in ast.walk(part)
    }
    out = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and id(node) not in typing and (node.module or "").startswith("jaxalign"):
            base = (node.module or "").removeprefix("jaxalign").removeprefix(".")
            for name in node.names:
                full = f"{base}.{name.name}".removeprefix(".")
                out.add(full if full in known else base or name.name)
    return out - {"", "__version__"}


def test_imports_point_down():
    level, known = levels(), modules()
    rooms = {name.partition(".")[0] for name in known}
    assert rooms == set(level)
    for name, path in known.items():
        own = name.partition(".")[0]
        for other in imported(path, known):
            room = other.partition(".")[0]
            assert room == own or level[room] >= level[own], f"{name} imports {other}, which stands above it"


def test_no_circles_between_files():
    """Also of imports inside functions; a name that a package gives is the file that it comes from."""
    known = modules()
    graph = {name: {x for x in imported(path, known) if x in known} for name, path in known.items()}
    order = list(TopologicalSorter(graph).static_order())  # CycleError
    assert len(order) == len(known) > 150
