"""The one exception for what a user can mend, and help with misspelt names."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

__all__ = ["UserError", "close_names"]


class UserError(ValueError):
    """Bad input: the message says what is wrong, where, and how to mend it, in one line.

    The command line prints it without a traceback and exits with 2.
    """


def close_names(word: str, known: Iterable[str], most: int = 3) -> list[str]:
    """The known names most like a word, whatever the case; none where none is alike."""
    by_lower = {name.lower(): name for name in reversed(list(known))}
    return [by_lower[name] for name in get_close_matches(word.lower(), list(by_lower), n=most, cutoff=0.4)]
