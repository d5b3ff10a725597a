"""``jaxalign``: sub-commands, exit codes, one line for a user's error.

Exit codes: 0 done, 1 stopped early (tune: a loss that is no number), 2 user error (also of argparse), 130 interrupted.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from types import ModuleType

from jaxalign.errors import UserError

__all__ = ["entry", "main", "parser"]

_COMMANDS = ("align", "bound", "info", "methods", "simulate", "study", "tune")


def parser() -> argparse.ArgumentParser:
    """The parser with all its sub-commands."""
    top = argparse.ArgumentParser(
        prog="jaxalign",
        description="Initial alignment of strapdown inertial navigation systems: the attitude of a vehicle that has "
        "just been switched on, from its gyroscopes and accelerometers and a velocity aid.",
        epilog="Exit codes: 0 done, 1 stopped early (tune), 2 bad input or arguments, 130 interrupted.",
    )
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in _COMMANDS:
        importlib.import_module(f"jaxalign.cli.{name}").add(commands)
    return top


def _require_device(jax: ModuleType) -> None:
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:
        where = os.environ.get("JAX_PLATFORMS", "")
        raise UserError(f"JAX finds no device (JAX_PLATFORMS={where!r}): unset it or set it to cpu; {error}") from None


def _left(code: int) -> int:
    """The exit code; one of several processes goes at once: JAX would first wait for the others, and they for it."""
    import jax

    if jax.distributed.is_initialized():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit code."""
    import jax

    jax.config.update("jax_enable_x64", True)  # an application may; the library itself never does
    options = parser().parse_args(arguments)
    try:
        if hasattr(options, "devices"):
            options.devices(options)
        _require_device(jax)
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
    sys.exit(main())
