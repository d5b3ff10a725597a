"""What the commands share: the arguments that name a log, assignments, tables."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from jaxalign.errors import UserError

if TYPE_CHECKING:
    from jaxalign.log import Log
    from jaxalign.simulate import Scenario

__all__ = ["add_log_arguments", "add_scenario_argument", "assignments", "chosen_scenario", "read_log", "table"]


def add_log_arguments(command: argparse.ArgumentParser) -> None:
    """FILE and how to read it."""
    from jaxalign.io import FORMATS

    command.add_argument("file", metavar="FILE", help="the log: .npz, PSINS .imu or .csv")
    command.add_argument("--format", choices=FORMATS, default="auto", help="of the log (default: auto)")
    command.add_argument("--columns", metavar="MAP", help="column map (TOML) of a CSV log: names, units, frame, site")
    command.add_argument("--start", type=float, metavar="S", help="begin S seconds after the first epoch")
    command.add_argument("--end", type=float, metavar="S", help="end S seconds after the first epoch")
    command.add_argument(
        "--aid-sd",
        type=float,
        metavar="V",
        help="standard deviation of the velocity aid's white noise, m/s; for a method that takes the vehicle as "
        "standing, of the force integrated over an epoch (default: what the log says, else estimated from it)",
    )


def read_log(options: argparse.Namespace) -> Log:
    """Read the log that the arguments name, and cut it."""
    from jaxalign.io import read

    log = read(options.file, format=options.format, columns=options.columns, aid_sd=options.aid_sd)
    if options.start is not None or options.end is not None:
        log = log.crop(options.start or 0.0, options.end)
    return log


def assignments(texts: Sequence[str]) -> dict[str, str]:
    """``["a.b=1", ...]`` as a dictionary.

    Raises:
        UserError: no equals sign, or a name given twice.
    """
    out: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip()
        if not equals or not name or not value.strip():
            raise UserError(f"--set {text!r}: write it as name=value")
        if name in out:
            raise UserError(f"--set {name} is given twice")
        out[name] = value.strip()
    return out


def add_scenario_argument(command: argparse.ArgumentParser, **how: Any) -> None:
    """SCENARIO."""
    command.add_argument(
        "scenario",
        metavar="SCENARIO",
        help="name (see `jaxalign simulate --list`), or a TOML file (`python -m pydoc jaxalign.simulate.file`)",
        **how,
    )


def chosen_scenario(text: str, options: Mapping[str, str]) -> Scenario:
    """The scenario of a name with its options, or of a TOML file.

    Raises:
        UserError: unknown, a bad file, or options for a file.
    """
    from jaxalign.simulate import scenario, scenario_file

    if not text.endswith(".toml"):
        return scenario(text, **options)
    if options:
        raise UserError(f"--set {next(iter(options))}: options of a scenario from a file stand in the file ({text})")
    return scenario_file(text)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Right-aligned columns."""
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    return "\n".join("  ".join(f"{cell:>{w}s}" for cell, w in zip(row, widths, strict=True)) for row in (head, *rows))
