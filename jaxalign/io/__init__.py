"""Readers: files to the checked `Log`, and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.io.csv import read_csv
    from jaxalign.io.formats import FORMATS
    from jaxalign.io.npz import read_npz, write_npz
    from jaxalign.io.psins import read_psins
    from jaxalign.io.reader import read
    from jaxalign.io.streams import log_from_streams

__all__ = ["FORMATS", "log_from_streams", "read", "read_csv", "read_npz", "read_psins", "write_npz"]

_HOMES = {
    "csv": "read_csv",
    "formats": "FORMATS",
    "npz": "read_npz write_npz",
    "psins": "read_psins",
    "reader": "read",
    "streams": "log_from_streams",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
