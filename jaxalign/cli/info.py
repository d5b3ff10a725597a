"""``jaxalign info``: what a log is, and what looks wrong with it."""

from __future__ import annotations

import argparse
from typing import Any

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the sub-command."""
    from jaxalign.cli.report import add_log_arguments

    command = commands.add_parser(
        "info",
        help="say what a log is: rates, gaps, gravity, Earth rate, likely mistakes",
        description="Say what a log is: rates, duration, gaps, mean specific force against gravity, mean rotation "
        "against the Earth's, likely mistakes of axes or units, and what its data contradict: zeros, stuck, repeated "
        "and single wild samples, the Earth turning the wrong way, the course turning against the gyroscopes.",
    )
    add_log_arguments(command)
    command.set_defaults(run=_run, needs_jax=False)


def _run(options: argparse.Namespace) -> int:
    from jaxalign.cli.report import read_log
    from jaxalign.info import describe

    log = read_log(options)
    lines = describe(log)
    width = max(len(label) for label, _ in lines)
    for label, value in lines:
        print(f"{label:{width}s}  {value}")
    return 0
