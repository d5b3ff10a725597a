"""``jaxalign simulate``: a synthetic log with its true attitude."""

from __future__ import annotations

import argparse
from typing import Any

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the sub-command."""
    from jaxalign.cli.report import add_scenario_argument

    command = commands.add_parser(
        "simulate",
        help="write a synthetic log of a named scenario",
        description="Simulate a scenario: exact IMU increments along an analytic trajectory, sensor errors, aid noise "
        "and outliers; the log holds the true attitude as its reference.",
        epilog="Some options: outliers=none|fixed|segment (DVL scenarios) or none|jump (gps-zigzag); "
        "gaps=[[30,40]] drops the aid between two times (s); bias=sign|gaussian|fixed; duration=120. A wrong "
        "value names the right ones.",
    )
    add_scenario_argument(command, nargs="?")
    command.add_argument("--list", action="store_true", help="list the scenarios and their options")
    command.add_argument("--seed", type=int, default=0, metavar="N", help="random seed (default 0)")
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="OPTION=VALUE",
        help="an option of the scenario, e.g. outliers=fixed; may be repeated",
    )
    command.add_argument("--no-noise", action="store_true", help="perfect sensors")
    command.add_argument("--output", metavar="LOG.npz", help="where to write the log")
    command.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    from jaxalign.cli.report import assignments, chosen_scenario
    from jaxalign.errors import UserError
    from jaxalign.io import write_npz
    from jaxalign.simulate import scenario_options, scenarios, simulate

    if options.list:
        for name, summary in scenarios().items():
            settable = ", ".join(f"{option}={value}" for option, value in scenario_options(name).items())
            print(f"{name:14s}{summary}\n{'':14s}{settable.lower()}")
        return 0
    if options.scenario is None:
        raise UserError(f"name a scenario: {', '.join(scenarios())}")
    made = chosen_scenario(options.scenario, assignments(options.set))
    if options.output is None:
        raise UserError("say where to write the log: --output LOG.npz")
    log = simulate(made, options.seed, noise=not options.no_noise)
    write_npz(log, options.output)
    print(f"wrote {options.output}: {log.name}, {log.duration:g} s, {log.epochs + 1} epochs, seed {options.seed}")
    return 0
