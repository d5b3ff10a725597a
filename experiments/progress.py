"""A bar on standard error."""

from __future__ import annotations

import sys

from tqdm import tqdm

__all__ = ["progress"]


def progress(title: str, total: int, unit: str = "alignment") -> tqdm:
    """Alignments done, per second, time left: redrawn on a terminal, now and then elsewhere."""
    interval = 0.1 if sys.stderr.isatty() else 60.0
    return tqdm(total=total, desc=f"{title:40.40s}", unit=unit, mininterval=interval, maxinterval=interval)
