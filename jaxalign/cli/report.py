"""What the commands share: the arguments that name a log, assignments, tables."""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxalign.errors import UserError

if TYPE_CHECKING:
    from jaxalign.log import Log
    from jaxalign.simulate import Scenario

__all__ = [
    "add_log_arguments",
    "add_scenario_argument",
    "assignments",
    "check_outputs",
    "chosen_scenario",
    "read_log",
    "split_settings",
]

PICTURES = (".png", ".pdf", ".svg")


def add_log_arguments(command: argparse.ArgumentParser) -> None:
    """FILE and how to read it."""
    from jaxalign.io.formats import FORMATS

    command.add_argument("file", metavar="FILE", help="the log: .npz, PSINS .imu or .csv")
    command.add_argument("--format", choices=FORMATS, default="auto", help="of the log (default: auto)")
    command.add_argument("--columns", metavar="MAP", help="column map (TOML) of a CSV log: names, units, frame, site")
    command.add_argument(
        "--aid",
        action="append",
        metavar="NAME",
        help="of the aids of the log take this one alone (may be repeated; `jaxalign info FILE` names them)",
    )
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

    log = read(options.file, format=options.format, columns=options.columns)
    if options.aid:
        log = log.only(*options.aid)
    if options.aid_sd is not None and len(log.aids) > 1:
        names = ", ".join(one.name for one in log.aids)
        raise UserError(f"--aid-sd: the log has {names}: name one with --aid, or state their noise in the file")
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
    """The argument SCENARIO."""
    command.add_argument(
        "scenario",
        metavar="SCENARIO",
        help="name (see `jaxalign simulate --list`), or a TOML file (`python -m pydoc jaxalign.simulate.file`)",
        **how,
    )


def split_settings(given: Mapping[str, str], scenario: str) -> tuple[dict[str, str], dict[str, str]]:
    """Settings of the scenario, and of methods: what has a dot or a colon, or is the name of a parameter alone."""
    from jaxalign.methods import RECIPES
    from jaxalign.parametrization import parameters
    from jaxalign.simulate import scenario_options, scenarios

    known = scenario_options(scenario) if scenario in scenarios() else {}
    bare = {
        path for recipe in RECIPES.values() for path in parameters(recipe.make(recipe.aids[0]())) if "." not in path
    }
    mine = {k: v for k, v in given.items() if "." in k or ":" in k or (k in bare and k not in known)}
    return {k: v for k, v in given.items() if k not in mine}, mine


def check_outputs(options: argparse.Namespace, inputs: Sequence[str | None]) -> None:
    """Refuse outputs that cannot be written, or that would destroy something, before anything is computed.

    Args:
        options: with `output` and `plot`.
        inputs: files that are read.

    Raises:
        UserError: a folder, no folder to write in, an input, or no picture's name.
    """
    outputs = [path for path in (options.output, options.plot) if path]
    for text in outputs:
        place = Path(os.path.realpath(text))
        if place.is_dir():
            raise UserError(f"{text} is a folder: name a file to write")
        if not place.parent.is_dir():
            raise UserError(f"{text}: cannot be written: there is no folder {place.parent}")
        for given in inputs:
            if given and place == Path(os.path.realpath(given)):
                raise UserError(f"{text} is an input: name another file to write")
        try:
            tempfile.TemporaryFile(dir=place.parent).close()
        except OSError as error:
            raise UserError(f"{text}: cannot be written: {error.strerror or error}") from None
    if len(outputs) == 2 and os.path.realpath(outputs[0]) == os.path.realpath(outputs[1]):
        raise UserError(f"--output and --plot are both {options.output}: name two files")
    if options.plot and Path(options.plot).suffix.lower() not in PICTURES:
        raise UserError(f"--plot {options.plot}: the name must end in {', '.join(PICTURES)}")


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
