"""Tables as text: for a terminal, and as Markdown; and how a number stands in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

__all__ = ["Estimate", "aligned", "markdown"]


class Estimate(NamedTuple):
    """A number and its standard error; or arrays of them, of one shape.

    Attributes:
        value: of the number.
        error: its standard error; NaN where it is not known.
    """

    value: Any
    error: Any

    def __str__(self) -> str:
        """One number, to two digits of its standard error; by itself where that is zero or not known."""
        if math.isinf(self.error):
            return f"{self.value:.3g} ± inf"
        if not (math.isfinite(self.error) and self.error > 0):
            return f"{self.value:.3g}"
        digits = 1 - math.floor(math.log10(self.error))
        shown = max(0, digits)
        return f"{self.value:.{shown}f} ± {round(float(self.error), digits):.{shown}f}"


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Right-aligned columns."""
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    return "\n".join("  ".join(f"{cell:>{w}s}" for cell, w in zip(row, widths, strict=True)) for row in (head, *rows))


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows))
