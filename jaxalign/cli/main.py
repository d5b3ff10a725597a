"""``jaxalign``: sub-commands, exit codes, one line for a user's error.

Exit codes: 0 done, 1 stopped early (tune: a loss that is no number), 2 user error (also of argparse), 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

__all__ = ["entry", "main", "parser"]

_COMMANDS = ("align", "bound", "info", "methods", "simulate", "study", "tune")


def parser() -> argparse.ArgumentParser:
    """The parser with all its sub-commands."""
    import argparse
    from importlib import import_module

    top = argparse.ArgumentParser(
        prog="jaxalign",
        description="Initial alignment of strapdown inertial navigation systems: the attitude of a vehicle that has "
        "just been switched on, from its gyroscopes and accelerometers and a velocity aid.",
        epilog="Exit codes: 0 done, 1 stopped early (tune), 2 bad input or arguments, 130 interrupted.",
    )
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in _COMMANDS:
        import_module(f"jaxalign.cli.{name}").add(commands)
    return top


def _prepare(options: argparse.Namespace, own_process: bool) -> None:
    """JAX for a command that needs it: how, on which devices; before anything of it runs."""
    import jax

    from jaxalign.errors import UserError

    jax.config.update("jax_enable_x64", True)  # an application may; the library itself never does
    if own_process:
        from jaxalign.compilation import configure

        configure()
    if hasattr(options, "devices"):
        options.devices(options)
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:
        where = os.environ.get("JAX_PLATFORMS", "")
        raise UserError(f"JAX finds no device (JAX_PLATFORMS={where!r}): unset it or set it to cpu; {error}") from None


def _left(code: int) -> int:
    """The exit code; one of several processes goes at once: JAX would first wait for the others, and they for it."""
    jax: Any = sys.modules.get("jax")
    if jax is not None and jax.distributed.is_initialized():
        _go(code)
    return code


def _go(code: int) -> None:
    """End at once, whatever other threads do."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def main(arguments: Sequence[str] | None = None, own_process: bool = False) -> int:
    """Run one command; return the exit code.

    Args:
        arguments: of the command line; None: of the process.
        own_process: whether the process is there for it alone, so that its settings may be changed
            (:func:`jaxalign.compilation.configure`).
    """
    from jaxalign.errors import UserError

    options = parser().parse_args(arguments)
    try:
        if getattr(options, "needs_jax", True):
            _prepare(options, own_process)
        code = options.run(options)
        sys.stdout.flush()
        return code
    except UserError as error:
        print(f"jaxalign: error: {' '.join(str(error).split())}", file=sys.stderr)
        return _left(2)
    except KeyboardInterrupt:
        print("jaxalign: interrupted", file=sys.stderr)
        return _left(130)
    except OSError as error:
        if isinstance(error, BrokenPipeError):  # the reader of our output has gone (head, less): not an error
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        print(f"jaxalign: error: cannot write the output: {error.strerror or error}", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 2


def entry() -> None:
    """Console script."""
    import gc

    from jaxalign.cli.interrupt import EXIT_CODE, guard

    guard()
    gc.set_threshold(100_000)  # nothing that is imported or traced becomes garbage: looking for it takes a tenth
    code = main(own_process=True)
    if code == EXIT_CODE:
        _go(code)  # a study's threads would finish their blocks first
    sys.exit(code)
