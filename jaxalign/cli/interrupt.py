"""Ctrl-C ends a command at once, wherever it is.

Python runs the handler of a signal between two of its own steps, and there is none within a compiled program or while
XLA compiles. The signal's number, though, is written to a file at once (`signal.set_wakeup_fd`), and a thread that
reads it ends the process. What a command writes takes its place by a rename, so nothing is left half-written.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["EXIT_CODE", "guard", "patience"]

EXIT_CODE = 130
_PATIENCE_S = 1.5
_patient = False  # in a block of `patience`
_asked = False  # and interrupted in it
_hint = ""  # what the reader of "interrupted" can do, where that moment was too short


def guard() -> None:
    """From now on Ctrl-C ends this process; in the main thread. A process that ignores it (nohup) goes on doing so."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, lambda *_: None)  # no KeyboardInterrupt in the midst of an import
    threading.Thread(target=_watch, args=(reader,), daemon=True).start()


@contextmanager
def patience(hint: str = "") -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt in this block; what follows has a moment to save what there is.

    Args:
        hint: said after "interrupted" where that moment is over before the command has ended.
    """
    global _patient, _hint
    before: Any = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is signal.SIG_IGN:
        yield
        return
    _patient, _hint = True, hint
    signal.signal(signal.SIGINT, _raise)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        _patient = False


def _raise(*_: Any) -> None:
    global _asked
    _asked = True
    raise KeyboardInterrupt


def _watch(reader: int) -> None:
    """Wait for Ctrl-C; where the command may save something, for its end too, but not for long or a second Ctrl-C."""
    while signal.SIGINT not in os.read(reader, 1):
        pass
    if _patient or _asked:
        select.select([reader], [], [], _PATIENCE_S)
    files = sys.modules.get("jaxalign.files")
    if files is not None:
        files.discard_parts()
    os.write(2, f"jaxalign: interrupted{_hint and '; '}{_hint}\n".encode())
    os._exit(EXIT_CODE)
