"""Opening and replacing files: one clear message where that fails, and nothing half-written."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from jaxalign.errors import UserError

__all__ = ["discard_parts", "existing_file", "first_line", "read_text", "replacing"]

_parts: set[Path] = set()
"""The files beside their places that are being written."""


def first_line(error: Exception) -> str:
    """The first line of an error of another library, for a message of one line."""
    return str(error).partition("\n")[0] or type(error).__name__


def existing_file(path: str | os.PathLike[str], what: str = "file") -> Path:
    """The path, if there is a file.

    Raises:
        UserError: nothing there, or a folder.
    """
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path} is a folder: give a {what}")
    if not path.exists():
        raise UserError(
            f"{path}: no such {what}" + ("" if path.parent.is_dir() else f" (nor the folder {path.parent})")
        )
    return path


def read_text(path: Path) -> str:
    """The text of a file.

    Raises:
        UserError: it cannot be read, or is binary.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from None
    if b"\0" in raw[:4096]:
        raise UserError(f"{path}: binary data where text is expected: give the right format")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")  # never fails; only comments and names hold such letters


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A binary file that takes the place of `path` if the block ends well, and else leaves no trace.

    Raises:
        UserError: the place cannot be written to.
    """
    path = Path(os.path.realpath(path))  # write through a link, do not replace it
    if path.is_dir():
        raise UserError(f"{path} is a folder: give a file to write")
    if path.exists() and not path.is_file():
        raise UserError(f"{path} is no ordinary file: give a file to write")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        stream = open(part, "xb")  # noqa: SIM115 - closed below, before the file is put in place
        _parts.add(part)
    except OSError as error:
        why = "no such folder" if not path.parent.is_dir() else error.strerror or error
        raise UserError(f"{path}: cannot be written: {why}") from None
    try:
        try:
            with stream:
                yield stream
            os.replace(part, path)
        except OSError as error:
            raise UserError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        with suppress(FileNotFoundError):
            part.unlink()
        _parts.discard(part)


def discard_parts() -> None:
    """Remove what is half-written, for a process that ends at once."""
    for part in tuple(_parts):
        with suppress(OSError):
            part.unlink()
