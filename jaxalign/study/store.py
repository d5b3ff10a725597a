"""The folder of a study: its settings, a file for each finished chunk of runs, and what is read back of them.

    DIR/study.json              all that decides the numbers
    DIR/chunks/FIRST-LAST.npz   the blocks of these runs, whole or not there: written beside and renamed

A chunk says which runs of which study it holds (a hash of the settings): copied elsewhere or renamed it is refused.
A kill at any moment leaves the finished chunks, and perhaps a part of one that the next study removes.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from jaxalign.errors import UserError
from jaxalign.files import first_line, replacing
from jaxalign.study.block_sums import BlockSums

__all__ = ["Store"]

_NAME = re.compile(r"(\d{9})-(\d{9})\.npz")
_FIELDS = tuple(BlockSums.__dataclass_fields__)

Chunk = dict[str, BlockSums]
"""Label -> the blocks of a chunk (first axis of each leaf)."""


class Store:
    """A folder that holds one study.

    Args:
        folder: where; made if it is not there.
        settings: all that decides the numbers, JSON-ready.
        resume: go on with the study that is there.

    Raises:
        UserError: it cannot be written; a study is running in it; it holds one and `resume` is not set, or one with
            other settings.
    """

    def __init__(self, folder: str | os.PathLike[str], settings: Mapping[str, Any], resume: bool):
        self.folder, self.chunks = Path(folder), Path(folder) / "chunks"
        if self.folder.exists() and not self.folder.is_dir():
            raise UserError(f"{folder} is not a folder: name another one for the study")
        path = self.folder / "study.json"
        wanted = json.loads(json.dumps(settings))
        self._study = hashlib.sha256(json.dumps(wanted, sort_keys=True).encode()).hexdigest()
        if path.exists():
            if not resume:
                raise UserError(f"{folder} holds a study already: go on with it (--resume), or name another folder")
            if changed := list(_differences(_settings(path), wanted)):
                more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
                raise UserError(
                    f"{folder} holds a study with other settings ({'; '.join(changed[:3])}{more}): give those to "
                    "resume it, or name another folder"
                )
        else:
            for there in (*self.folder.glob("results.*"), *self.chunks.glob("*.npz")):
                raise UserError(f"{there}: of another study, whose study.json is missing: name another folder")
        try:
            self.chunks.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(self.folder / ".lock")
            for rest in (*self.folder.glob(".*.part"), *self.chunks.glob(".*.part")):  # of a write that was killed
                rest.unlink(missing_ok=True)
        except OSError as error:
            raise UserError(f"{folder}: cannot be used: {error.strerror or error}") from None
        if not path.exists():
            with replacing(path) as stream:
                stream.write(json.dumps(wanted, indent=1).encode())

    def close(self) -> None:
        """Let another study have the folder."""
        self._lock.close()

    def write(self, first: int, stop: int, chunk: Chunk) -> None:
        """Put the blocks of the runs first ... stop - 1 on disk.

        Raises:
            UserError: the file cannot be written.
        """
        arrays = {
            f"{i}.{field}": getattr(tallied, field) for i, tallied in enumerate(chunk.values()) for field in _FIELDS
        }
        own = {"labels": np.array(list(chunk)), "study": np.array(self._study), "runs": np.array([first, stop - 1])}
        with replacing(self.chunks / f"{first:09d}-{stop - 1:09d}.npz") as stream:
            np.savez_compressed(stream, **own, **arrays)

    def read(self) -> tuple[dict[tuple[int, int], Chunk], list[str]]:
        """The finished chunks by (first, stop), and a line on each file that was damaged, which is removed.

        Raises:
            UserError: the folder cannot be read, or a chunk in it is of another study or of other runs than its name
                says.
        """
        found, damaged = {}, []
        try:
            paths = sorted(self.chunks.iterdir())
        except OSError as error:
            raise UserError(f"{self.chunks}: cannot be read: {error.strerror or error}") from None
        for path in paths:
            name = _NAME.fullmatch(path.name)
            if name is None:
                continue
            try:
                study, runs, chunk = _read(path)
            except Exception as error:  # a flipped bit of a zip file raises a dozen kinds
                damaged.append(f"{path} is damaged ({first_line(error)}): its runs are done again")
                with suppress(OSError):
                    path.unlink()
                continue
            if study != self._study:
                raise UserError(f"{path}: of another study, with other settings: take it out of this folder")
            if runs != (int(name[1]), int(name[2])):
                raise UserError(
                    f"{path}: holds the runs {runs[0]} to {runs[1]}, not those of its name: name it "
                    f"{runs[0]:09d}-{runs[1]:09d}.npz, or take it out of this folder"
                )
            found[runs[0], runs[1] + 1] = chunk
        return found, damaged


def _read(path: Path) -> tuple[str, tuple[int, int], Chunk]:
    """Of a chunk: the hash of its study's settings, its first and its last run, and the tallies by label."""
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        first, last = (int(x) for x in file["runs"])
        tallies = {
            str(label): BlockSums(**{field: file[f"{i}.{field}"] for field in _FIELDS})
            for i, label in enumerate(file["labels"])
        }
        return str(file["study"]), (first, last), tallies


def _locked(path: Path) -> IO[bytes]:
    """A lock that ends with the process, however it ends.

    Raises:
        UserError: another process has it.
    """
    stream = path.open("ab")
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        return stream
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        stream.close()
        raise UserError(f"{path.parent}: a study is running in it: wait for its end") from None
    except OSError:  # a file system without locks
        pass
    return stream


def _settings(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: not the settings of a study ({error}): name another folder") from None


def _differences(old: Any, new: Any, path: str = "") -> Any:
    """A line for each setting that differs."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in (*old, *(k for k in new if k not in old)):
            yield from _differences(old.get(key), new.get(key), f"{path}.{key}" if path else key)
    elif old != new:
        yield f"{path} was {_short(old)}, is {_short(new)}"


def _short(value: Any) -> str:
    text = "absent" if value is None else json.dumps(value)
    return text if len(text) < 40 else f"{text[:37]}..."
