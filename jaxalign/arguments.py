"""Checks of what a user gives, one line of advice each; of nothing but Python, so that any command can afford them."""

from __future__ import annotations

from collections.abc import Iterable
from operator import index
from typing import Any

from jaxalign.errors import UserError, close_names

__all__ = ["check_choice", "nearest", "whole_number"]


def nearest(word: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown word: the nearest known ones first, or all of them."""
    known = list(known)
    close = close_names(word, known)
    if close:
        return f"did you mean {' or '.join(repr(k) for k in close)}? (known: {', '.join(known)})"
    return f"known: {', '.join(known) or 'none'}"


def check_choice(what: str, value: Any, known: Iterable[Any]) -> Any:
    """The value, if it is one of the known ones.

    Args:
        what: is chosen, for people.
        value: given.
        known: what may be given; of the same type (1 is not True).

    Raises:
        UserError: otherwise, naming the nearest.
    """
    known = list(known)
    if any(type(value) is type(k) and value == k for k in known):
        return value
    words = [str(k) for k in known]
    close = close_names(str(value), words, most=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise UserError(f"{what} = {value!r}: must be one of {', '.join(words)}{hint}")


def whole_number(
    what: str, value: Any, low: int = 1, high: int | None = None, of: str = "", floats: bool = False
) -> int:
    """The value, if it is a whole number within these bounds; an array of one number is that number.

    Args:
        what: is counted, for people.
        value: given.
        low: the least.
        high: the largest; None: any.
        of: the unit, such as "epochs".
        floats: whether 2.0 will do (a file, or an argument that may come from a computation), or only integers.

    Raises:
        UserError: otherwise.
    """
    number: Any = value.item() if getattr(value, "size", 0) == 1 and hasattr(value, "item") else value
    if floats and isinstance(number, float) and number.is_integer():
        number = int(number)
    try:
        whole = None if isinstance(number, bool | float) else index(number)
    except TypeError:
        whole = None
    if whole is None or whole < low or (high is not None and whole > high):
        limits = f", at least {low}" if high is None else f" from {low} to {high}"
        raise UserError(f"{what} = {value!r}: must be a whole number{f' of {of}' if of else ''}{limits}")
    return whole
