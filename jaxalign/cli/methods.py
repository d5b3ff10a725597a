"""``jaxalign methods``: what there is, by name."""

from __future__ import annotations

import argparse
from typing import Any

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the sub-command."""
    command = commands.add_parser(
        "methods",
        help="list the methods with their sources and settable parameters",
        description="List the methods, the aids they take, their sources and what --set can change.",
    )
    command.add_argument("name", nargs="?", metavar="NAME", help="show only this one, with its documentation")
    command.set_defaults(run=_run)


def _settable(part: Any) -> str:
    from jaxalign.parametrization import parameters

    return ", ".join(f"{path}={value}".lower() for path, value in parameters(part).items())


def _run(options: argparse.Namespace) -> int:
    import inspect
    import re

    import equinox as eqx

    from jaxalign.errors import UserError
    from jaxalign.methods import RECIPES, build
    from jaxalign.prefilter import PREFILTERS

    if options.name:
        build(options.name)  # one message for an unknown name
    width = max(map(len, RECIPES)) + 2
    for recipe in RECIPES.values():
        if options.name not in (None, recipe.name):
            continue
        print(f"{recipe.name:{width}s}{recipe.summary}")
        print(f"{'':{width}s}aids: {', '.join(recipe.aids)}; source: {recipe.source}")
        for aid in recipe.aids:
            method = build(recipe.name, aid)
            print(f"{'':{width}s}{aid}: {_settable(method)}")
            if options.name:
                slots = (part for part in vars(method).values() if isinstance(part, eqx.Module))
                for part in (method, *slots):
                    print(f"\n[{type(part).__name__}]\n{inspect.getdoc(type(part))}\n")
    if not options.name:
        print("\nprefilters (--prefilter NAME, --set prefilter.FIELD=VALUE), for a standing vehicle:")
        for name, kind in PREFILTERS.items():
            summary = re.sub(r" \(:func:.*?\)", "", (inspect.getdoc(kind) or "").splitlines()[0])
            try:
                settable = _settable(kind())
            except UserError as error:  # its library is not installed
                settable = str(error)
            print(f"{name:{width}s}{summary}\n{'':{width}s}{settable}")
    return 0
