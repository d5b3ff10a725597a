"""The command line that the experiments share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from experiments.page import Page
from jaxalign import UserError, compilation, plots
from jaxalign.cli.interrupt import guard

__all__ = ["run"]

QUICK_RUNS = 4


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """One line, without the usage."""
        self.exit(2, f"{self.prog}: error: {message}\n")


def _whole(low: int, high: int = 2**63 - 1) -> Callable[[str], int]:
    def number(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {low}")
        return value

    return number


def run(
    package: str,
    doc: str,
    here: Path,
    study: Callable[[int, int], Page],
    arguments: Sequence[str] | None = None,
    runs: int = 100,
) -> int:
    """Parse the arguments, do the study, write its files.

    Args:
        package: "experiments.name".
        doc: what the experiment is.
        here: its folder.
        study: (runs, seed) -> page.
        arguments: of the command line.
        runs: default number of runs.

    Returns:
        The exit code: 0 done, 2 bad arguments or an unwritable folder, 130 interrupted.
    """
    name = package.rpartition(".")[2]
    parser = _Parser(prog=f"python -m {package}", description=doc.split("\n")[0])
    parser.add_argument("--runs", type=_whole(2), help=f"Monte Carlo runs (default: {runs}; quick: {QUICK_RUNS})")
    parser.add_argument("--seed", type=_whole(0), default=0, help="of all the runs (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="a few runs, to see that it works; not into its folder")
    parser.add_argument("--output", type=Path, help=f"folder to write into (default: {here}; quick: out/{name})")
    options = parser.parse_args(arguments)
    out = options.output or (Path("out") / name if options.quick else here)
    if options.quick and out.resolve() == here.resolve():
        parser.error(f"argument --output: {out} holds the results of the full run; give another folder for --quick")
    if out.exists() and not out.is_dir():
        parser.error(f"argument --output: {out} is not a folder")
    if arguments is None:  # the process is there for it alone
        guard()
        compilation.configure()
    try:
        plots.require()
        page = study(options.runs or (QUICK_RUNS if options.quick else runs), options.seed)
        for path in page.write(out):
            print(f"wrote {path}")
    except (UserError, OSError) as error:
        print(f"{parser.prog}: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{parser.prog}: interrupted", file=sys.stderr)
        return 130
    return 0
