"""``jaxalign``: sub-commands, exit codes, one line for a user's error.

Exit codes: 0 done, 2 user error (also of argparse), 130 interrupted.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from jaxalign.errors import UserError

__all__ = ["entry", "main", "parser"]

_COMMANDS = ("align", "info", "methods", "simulate")


def parser() -> argparse.ArgumentParser:
    """The parser with all its sub-commands."""
    top = argparse.ArgumentParser(
        prog="jaxalign",
        description="Initial alignment of strapdown inertial navigation systems: the attitude of a vehicle that has "
        "just been switched on, from its gyroscopes and accelerometers and a velocity aid.",
        epilog="Exit codes: 0 done, 2 bad input or arguments, 130 interrupted.",
    )
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in _COMMANDS:
        importlib.import_module(f"jaxalign.cli.{name}").add(commands)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit code."""
    import jax

    jax.config.update("jax_enable_x64", True)  # an application may; the library itself never does
    options = parser().parse_args(arguments)
    try:
        return options.run(options)
    except UserError as error:
        print(f"jaxalign: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("jaxalign: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has gone (head, less): not an error
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def entry() -> None:
    """Console script."""
    sys.exit(main())
