"""A bar on standard error."""

from __future__ import annotations

import sys
import time

__all__ = ["Progress"]


class Progress:
    """Share done, alignments per second, time left: redrawn on a terminal, one line at the end elsewhere."""

    def __init__(self, title: str, total: int):
        self.title, self.total, self.done = title, total, 0
        self.start = time.perf_counter()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self._write("\n")
        elif sys.stderr.isatty():
            print(file=sys.stderr)

    def advance(self, count: int) -> None:
        """So many more are done."""
        self.done += count
        if sys.stderr.isatty():
            self._write("")

    def _write(self, end: str) -> None:
        spent = time.perf_counter() - self.start
        bar = "#" * (20 * self.done // self.total)
        left = spent / max(self.done, 1) * (self.total - self.done)
        print(
            f"\r{self.title:40.40s} [{bar:20s}] {self.done}/{self.total} alignments, {self.done / spent:.0f}/s, "
            f"{left:.0f} s left ",
            end=end,
            file=sys.stderr,
            flush=True,
        )
