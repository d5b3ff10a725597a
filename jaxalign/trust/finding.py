"""One thing that a check found: a number, its limit, and a line for a person."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Attributes:
        name: of the check, such as "stuck samples".
        value: the number that was found.
        limit: what it is compared with.
        trusted: False: the data contradict the model, so that an answer must not be trusted; True: a note.
        text: one line for a person: what, where (time, axis), how to mend.
    """

    name: str
    value: float
    limit: float
    trusted: bool
    text: str
