"""``jaxalign methods``: what there is, by name."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
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


def _parts(module: Any) -> Iterator[Any]:
    """A module and its slots, each before its own."""
    import equinox as eqx

    yield module
    for part in vars(module).values():
        if isinstance(part, eqx.Module):
            yield from _parts(part)


def _run(options: argparse.Namespace) -> int:
    import inspect
    import re

    from jaxalign.errors import UserError
    from jaxalign.methods import RECIPES, build
    from jaxalign.prefilter import PREFILTERS

    if options.name:
        build(options.name)  # one message for an unknown name
    shown = [recipe for recipe in RECIPES.values() if options.name in (None, recipe.name)]
    width = max(len(recipe.name) for recipe in shown) + 2
    for before, recipe in zip([None, *shown], shown, strict=False):
        if before and recipe.published and not before.published:
            print("\nas published, to reproduce what papers print:")
        print(f"{recipe.name:{width}s}{recipe.summary}")
        kinds = ", ".join(aid.kind for aid in recipe.aids) + " and any others, several at once" * recipe.several
        print(f"{'':{width}s}aids: {kinds}; source: {recipe.source}")
        for aid in recipe.aids:
            method = build(recipe.name, aid)
            print(f"{'':{width}s}{aid.kind}: {_settable(method)}")
            if options.name:
                for part in _parts(method):
                    print(f"\n[{type(part).__name__}]\n{inspect.getdoc(type(part))}\n")
    if not options.name:
        print("\nprefilters (--prefilter NAME, --set front_end.prefilter.FIELD=VALUE), for a standing vehicle:")
        for name, kind in PREFILTERS.items():
            summary = re.sub(r" \(:func:.*?\)", "", (inspect.getdoc(kind) or "").splitlines()[0])
            try:
                settable = _settable(kind())
            except UserError as error:  # its library is not installed
                settable = str(error)
            print(f"{name:{width}s}{summary}\n{'':{width}s}{settable}")
    return 0
