"""Compiled programs as files: whole or not there, checked when read, the longest unused removed first.

JAX's own store writes its files in place, so that a crash, a full disk or a second process leaves half of one, which it
then neither reads nor replaces; and it is bounded only with a package more.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from jaxalign.errors import UserError
from jaxalign.files import replacing

__all__ = ["Entries", "prune"]

_LOG = logging.getLogger("jaxalign")
_MOST = 512 * 2**20
"""Bytes that all programs of all machines and versions may take."""
_LEFT = 0.75
"""The share of it that is kept when there are more."""
_AT_ONCE = 64 * 2**20
"""Bytes that a process writes before it looks again."""
_SUFFIX = ".program"
_ABANDONED_S = 3600.0
_DIGEST = 32
_NAME = 150


class Entries:
    """The store that JAX reads and writes: `get` and `put` never raise.

    An entry is the SHA-256 of its folder's name, its key and its content, and then the content: one that is cut off,
    damaged, or of another machine, version or program is as if it were not there, and is replaced.

    Attributes:
        folder: where.
        readable: whether what is there may be read; if not, it is only written.
    """

    def __init__(self, folder: Path, readable: bool):
        self.folder, self.readable = folder, readable
        self._path = folder  # JAX wants to see it
        self._lock = threading.Lock()
        self._written: int | None = None
        self._broken = False
        self._here = threading.local()

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Nothing is found or kept in this thread."""
        self._here.hidden = True
        try:
            yield
        finally:
            self._here.hidden = False

    def get(self, key: str) -> bytes | None:
        """The content, or None."""
        if not self.readable or getattr(self._here, "hidden", False):
            return None
        path = self._file(key)
        try:
            data = path.read_bytes()
        except OSError:
            return None
        content = data[_DIGEST:]
        if data[:_DIGEST] != self._digest(key, content):
            return None
        with suppress(OSError):
            os.utime(path)  # the time of the last use: access times are often not kept
        return content

    def put(self, key: str, value: bytes) -> None:
        """Keep a content, whatever there is now; after a failure nothing more."""
        with self._lock:
            if self._broken or getattr(self._here, "hidden", False):
                return
            try:
                with replacing(self._file(key)) as stream:
                    stream.write(self._digest(key, value))
                    stream.write(value)
            except UserError as error:
                self._broken = True
                _LOG.warning("jaxalign: compiled programs are not kept: %s", error)
                return
            if self._written is None or self._written > _AT_ONCE:
                prune(self.folder.parent)
                self._written = 0
            self._written += len(value)

    def _file(self, key: str) -> Path:
        name = re.sub(r"[^\w.-]", "_", key)[-_NAME:]
        return self.folder / f"{name}{_SUFFIX}"

    def _digest(self, key: str, content: bytes) -> bytes:
        made = hashlib.sha256(f"{self.folder.name}\0{key}\0".encode())
        made.update(content)
        return made.digest()


def prune(root: Path, most: int = _MOST) -> None:
    """Remove what was used longest ago where the folders of all machines and versions hold too much, and leftovers."""
    found: list[tuple[float, int, Path]] = []
    for path in root.glob(f"xla-*/*{_SUFFIX}*"):
        with suppress(OSError):
            about = path.stat()
            if path.suffix == _SUFFIX:
                found.append((about.st_mtime, about.st_size, path))
            elif about.st_mtime < time.time() - _ABANDONED_S:  # of a process that was killed while it wrote
                path.unlink()
    total = sum(size for _, size, _ in found)
    if total <= most:
        return
    for _, size, path in sorted(found):
        with suppress(OSError):
            path.unlink()
        total -= size
        if total <= _LEFT * most:
            return
