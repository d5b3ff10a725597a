"""Scenarios with another aid."""

from __future__ import annotations

import dataclasses
from typing import Any

from jaxalign.simulate import Scenario

__all__ = ["with_aid"]


def with_aid(made: Scenario, **changes: Any) -> Scenario:
    """A scenario with one aid, some fields of that (``sd``, ``faults``) replaced."""
    (aid,) = made.aids
    return dataclasses.replace(made, aids=(dataclasses.replace(aid, **changes),))
