"""Packages whose names are imported when they are first used (PEP 562): a command waits for what it needs alone."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any

__all__ = ["lazily"]


def lazily(package: str, homes: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package.

    Its modules are attributes too. No name of ``homes`` may be that of a module beside it: the import system would put
    the module in its place.

    Args:
        package: its ``__name__``; ``__all__`` is set already.
        homes: module of the package -> the names that it gives, with blanks between.
    """
    home = {name: f"{package}.{module}" for module, names in homes.items() for name in names.split()}

    here = sys.modules[package]

    def get(name: str) -> Any:
        if name in home:
            value = getattr(import_module(home[name]), name)
            setattr(here, name, value)
            return value
        if name.startswith("_") or find_spec(f"{package}.{name}") is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return import_module(f"{package}.{name}")

    def names() -> list[str]:
        return sorted({*vars(here), *here.__all__})

    return get, names
