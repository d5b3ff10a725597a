"""Readers: files to the checked `Log`, and back."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxalign.errors import UserError
from jaxalign.io.csv import read_csv
from jaxalign.io.files import existing_file, replacing
from jaxalign.io.npz import read_npz, write_npz
from jaxalign.io.psins import read_psins
from jaxalign.log import Log

__all__ = ["FORMATS", "read", "read_csv", "read_npz", "read_psins", "replacing", "write_npz"]

FORMATS = ("auto", "npz", "psins", "csv")
"""What `read` takes as `format`."""
_SUFFIXES = {".npz": "npz", ".imu": "psins", ".csv": "csv", ".tsv": "csv"}


def read(
    path: str | os.PathLike[str],
    format: str = "auto",
    columns: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    aid_sd: float | None = None,
) -> Log:
    """Reads a log of any format.

    Args:
        path: the file.
        format: "npz" (`jaxalign.io.npz`), "psins" (`jaxalign.io.psins`), "csv" (`jaxalign.io.csv`), or
            "auto": by suffix, else by content.
        columns: column map of a CSV file (`jaxalign.io.columns`).
        aid_sd: standard deviation of the aid's white noise per axis, m/s; replaces the file's.

    Raises:
        UserError: unknown format, missing file, a folder, a damaged file, or what the reader of the format
            refuses.
    """
    if format not in FORMATS:
        raise UserError(f"format {format!r} is unknown: it must be one of {', '.join(FORMATS)}")
    path = existing_file(path)
    kind = _guess(path) if format == "auto" else format
    if columns is not None and kind != "csv":
        raise UserError(
            f"{path}: a column map is for CSV files, this one is read as {kind}: leave it out, or give format csv"
        )
    readers = {"npz": read_npz, "psins": read_psins, "csv": lambda path: read_csv(path, columns)}
    log = readers[kind](path)
    return log if aid_sd is None else dataclasses.replace(log, aid_sd=aid_sd)


def _guess(path: Path) -> str:
    if found := _SUFFIXES.get(path.suffix.lower()):
        return found
    try:
        with open(path, "rb") as stream:
            head = stream.read(4096)
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from None
    if head.startswith(b"PK"):
        return "npz"
    if b"\0" not in head:
        lines = [line.strip() for line in head.decode("latin-1").splitlines() if line.strip()]
        if lines and lines[0].startswith("%"):
            return "psins"
        if any(separator in line for line in lines[:1] for separator in ",;\t"):
            return "csv"
    raise UserError(f"{path}: unknown format: give format npz, psins or csv (--format)")
