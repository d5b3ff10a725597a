"""Where compiled programs are kept: the user's cache folder, one folder in it for each kind of machine and version."""

from __future__ import annotations

import hashlib
import os
import platform
import stat
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

__all__ = ["Unusable", "chosen", "kind_of_machine", "opened", "subfolder"]

_OFF = ("off", "0", "no", "none", "false")
_PROCESSOR = (
    *("vendor_id", "cpu family", "model", "model name", "stepping", "flags"),
    *("CPU implementer", "CPU architecture", "CPU variant", "CPU part", "Features"),
)


class Unusable(Exception):
    """Nothing can be kept there; the message says why."""


def chosen() -> Path | None:
    """What ``JAXALIGN_CACHE`` says (off, or a folder), else ``jaxalign`` in the user's cache folder; None: off."""
    text = os.environ.get("JAXALIGN_CACHE", "")
    if text.lower() in _OFF:
        return None
    if text:
        return Path(text)
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "win32":
        caches = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        caches = home / "Library" / "Caches"
    else:
        given = Path(os.environ.get("XDG_CACHE_HOME", ""))
        caches = given if given.is_absolute() else home / ".cache"  # relative ones are invalid, says the standard
    return caches / "jaxalign"


def opened(folder: Path) -> Path:
    """The folder, made if need be, for this user alone: who writes there runs code as the user.

    Raises:
        Unusable: it cannot be made, belongs to somebody else, or others may write to it.
    """
    folder = Path(os.path.realpath(folder))
    try:
        if not folder.is_dir():
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.stat()
    except OSError as error:
        raise Unusable(f"{folder}: {error.strerror or error}") from None
    if hasattr(os, "geteuid"):
        if found.st_uid != os.geteuid():
            raise Unusable(f"{folder} belongs to another user")
        if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise Unusable(f"others may write to {folder}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise Unusable(f"{folder}: no permission to write")
    return folder


def kind_of_machine() -> str:
    """What compiled programs depend on: the processor and what it can do."""
    fields = [platform.system(), platform.machine(), platform.processor()]
    with suppress(OSError):
        first = Path("/proc/cpuinfo").read_text().partition("\n\n")[0]
        lines = dict(line.split(":", 1) for line in first.splitlines() if ":" in line)
        known = {key.strip(): value.strip() for key, value in lines.items()}
        fields += [f"{key}: {known[key]}" for key in _PROCESSOR if key in known]
    if sys.platform == "darwin":
        with suppress(OSError):
            command = ["sysctl", "-n", "machdep.cpu.brand_string"]
            fields.append(subprocess.run(command, capture_output=True, text=True).stdout.strip())
    return "\n".join(fields)


def subfolder(*versions: str) -> str:
    """Name of the folder for this kind of machine, this Python, these versions and the flags given to XLA."""
    python = f"{sys.version_info.major}.{sys.version_info.minor}"  # JAX compresses by what Python has
    parts = (kind_of_machine(), python, *versions, os.environ.get("XLA_FLAGS", ""))
    return "xla-" + hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]
