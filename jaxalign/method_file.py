"""A method with all its numbers as a JSON file: written by tuning, read by the commands."""

from __future__ import annotations

import json
import os
from typing import Any, NamedTuple

from jaxalign.errors import UserError
from jaxalign.io.files import existing_file, first_line, read_text, replacing
from jaxalign.methods import RECIPES, build
from jaxalign.parametrization import parameters
from jaxalign.prefilter import PREFILTERS

__all__ = ["Named", "method_entries", "read_method", "write_method"]


class Named(NamedTuple):
    """A method and the recipe that it was made by.

    Attributes:
        name: of the recipe.
        method: with the numbers of the file.
        prefilter: the name of its prefilter, or None.
    """

    name: str
    method: Any
    prefilter: str | None


def method_entries(name: str, method: Any) -> dict[str, Any]:
    """What makes a method again, JSON-ready: recipe, aid, prefilter, parameters."""
    prefilter = method.prefilter
    names = [key for key, kind in PREFILTERS.items() if type(prefilter) is kind]
    return {
        "method": name,
        "aid": method.aid,
        "prefilter": names[0] if names else None,
        "parameters": parameters(method),
    }


def write_method(path: str | os.PathLike[str], name: str, method: Any, **more: Any) -> None:
    """Write a method of a recipe.

    Args:
        path: to write.
        name: of the recipe.
        method: made by it.
        **more: what else the file shall say (JSON-ready).

    Raises:
        UserError: the file cannot be written.
    """
    content = json.dumps({**method_entries(name, method), **more}, indent=1)
    with replacing(path) as stream:
        stream.write(content.encode() + b"\n")


def read_method(path: str | os.PathLike[str]) -> Named:
    """Read a method.

    Raises:
        UserError: no such file, not JSON, not of a method, or parameters that the recipe does not have.
    """
    text = read_text(existing_file(path, "method file (JSON)"))
    try:
        content = json.loads(text)
        name, aid, prefilter, values = (content[key] for key in ("method", "aid", "prefilter", "parameters"))
    except (ValueError, KeyError, TypeError) as error:
        wrong = f"no JSON ({first_line(error)})" if isinstance(error, ValueError) else f"it has no entry {error}"
        raise UserError(f"{path}: not a method file: {wrong}; `jaxalign tune ... --output FILE` writes one") from None
    if name not in RECIPES or not isinstance(values, dict):
        raise UserError(f"{path}: there is no method {name!r}: it was not made by a recipe of this version")
    try:
        return Named(name, build(name, aid, values, prefilter), prefilter)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
