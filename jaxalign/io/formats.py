"""The formats of logs, and which of them a file has."""

from __future__ import annotations

from pathlib import Path

from jaxalign.errors import UserError

__all__ = ["FORMATS", "format_of"]

FORMATS = ("auto", "npz", "psins", "csv")
"""What :func:`jaxalign.read` takes as `format`."""
_SUFFIXES = {".npz": "npz", ".imu": "psins", ".csv": "csv", ".tsv": "csv"}


def format_of(path: Path) -> str:
    """The format of a file, by its suffix, else by its content.

    Raises:
        UserError: it cannot be read, or is like none of them.
    """
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
