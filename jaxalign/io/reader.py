"""One reader for logs of all formats."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from typing import Any

from jaxalign.errors import UserError
from jaxalign.files import existing_file
from jaxalign.io.formats import FORMATS, format_of
from jaxalign.log import Log

__all__ = ["read"]


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
    kind = format_of(path) if format == "auto" else format
    if columns is not None and kind != "csv":
        raise UserError(
            f"{path}: a column map is for CSV files, this one is read as {kind}: leave it out, or give format csv"
        )
    if kind == "npz":
        from jaxalign.io.npz import read_npz

        log = read_npz(path)
    elif kind == "psins":
        from jaxalign.io.psins import read_psins

        log = read_psins(path)
    else:
        from jaxalign.io.csv import read_csv

        log = read_csv(path, columns)
    if aid_sd is None:
        return log
    if len(log.aids) != 1:
        names = " and ".join(one.name for one in log.aids) or "no aids: give it to align, for the noise of the force"
        raise UserError(f"{path}: aid_sd is one number, but there are {names}")
    (one,) = log.aids
    return log.with_aid(dataclasses.replace(one, sd=aid_sd))
