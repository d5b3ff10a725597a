"""A method with all its numbers as a JSON file: written by tuning, read by the commands."""

from __future__ import annotations

import json
import os
from typing import Any, NamedTuple

from jaxalign.aids import from_plain, plain
from jaxalign.errors import UserError
from jaxalign.files import existing_file, first_line, read_text, replacing
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
    """What makes a method again, JSON-ready: recipe, aids, prefilter, parameters."""
    prefilter = method.front_end.prefilter
    names = [key for key, kind in PREFILTERS.items() if type(prefilter) is kind]
    return {
        "method": name,
        "aids": [plain(aid) for aid in method.aids],
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
    except ValueError as error:
        raise UserError(_NO_FILE.format(path, f"no JSON ({first_line(error)})")) from None
    name, aids, prefilter, values = _entries(path, content)
    if name not in RECIPES:
        raise UserError(f"{path}: there is no method {name!r}: it was not made by a recipe of this version")
    try:
        return Named(name, build(name, tuple(from_plain(aid) for aid in aids), values, prefilter), prefilter)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


_NO_FILE = "{}: not a method file: {}; `jaxalign tune ... --output FILE` writes one"


def _entries(path: Any, content: Any) -> tuple[str, list[Any], str | None, dict[str, Any]]:
    """What a file says, each of its type."""
    if not isinstance(content, dict):
        raise UserError(_NO_FILE.format(path, "it is no table of entries"))
    if "aid" in content and "aids" not in content:
        line = f'put "aids": [{{"kind": "{content["aid"]}"}}] in place of "aid"'
        values = content.get("parameters")
        if isinstance(values, dict) and values.get("calibrate") == "mounting":  # it was the scale too
            line += ', and "calibrate": "scale,mounting" in place of "mounting"'
        raise UserError(f"{path}: written by an older version: {line}")
    out = []
    for key, kind, what in (
        ("method", str, "a name"),
        ("aids", list, "a list of aids"),
        ("prefilter", str | None, "a name or null"),
        ("parameters", dict, "a table of numbers"),
    ):
        if key not in content:
            raise UserError(_NO_FILE.format(path, f"it has no entry {key!r}"))
        if not isinstance(content[key], kind):
            raise UserError(f"{path}: {key} is {content[key]!r}: {what} is expected")
        out.append(content[key])
    return tuple(out)
