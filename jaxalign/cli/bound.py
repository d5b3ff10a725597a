"""``jaxalign bound``: what no unbiased estimator can beat in a scenario."""

from __future__ import annotations

import argparse
import csv
import io
from typing import Any

__all__ = ["add"]

_ROWS = 12


def add(commands: Any) -> None:
    """Add the sub-command."""
    from jaxalign.cli.report import add_scenario_argument

    command = commands.add_parser(
        "bound",
        help="the Cramer-Rao bound of the attitude over time in a scenario",
        description="The least standard deviations of pitch, roll and yaw that any unbiased estimator can reach over "
        "time, from the noise of the aid, the noise of the inertial sensors and their biases (the scenario's size as "
        "standard deviation); attitude and first velocity unknown. Outliers are left out, gaps are not.",
    )
    add_scenario_argument(command)
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="OPTION=VALUE",
        help="an option of the scenario, e.g. duration=600; may be repeated",
    )
    command.add_argument(
        "--every", type=int, metavar="N", help=f"epochs between the lines printed (default: {_ROWS} lines)"
    )
    command.add_argument("--output", metavar="FILE.csv", help="all epochs")
    command.add_argument("--plot", metavar="FILE.png", help="a picture (needs matplotlib)")
    command.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    import numpy as np

    from jaxalign.bounds import bound
    from jaxalign.cli.report import assignments, check_outputs, chosen_scenario
    from jaxalign.epochs import check_every
    from jaxalign.files import replacing
    from jaxalign.tables import aligned

    check_outputs(options, [options.scenario])
    if options.plot:
        from jaxalign import plots

        plots.require()
    made = chosen_scenario(options.scenario, assignments(options.set))
    if options.every is not None:
        check_every(options.every)
    found = bound(made)
    time, angles = np.asarray(found.time), np.asarray(found.euler_deg)
    last = len(time) - 1
    if options.every is None:
        rows = np.unique(np.linspace(0, last, _ROWS + 1)[1:].round().astype(int))
    else:
        rows = np.unique([*range(options.every, last, options.every), last])
    print(f"{made.name}: least standard deviations (deg) of an unbiased estimator; 104 deg: an angle is unknown")
    lines = [(f"{time[i]:g}", *(f"{x:.4g}" for x in angles[i])) for i in rows]
    print(aligned(("time (s)", "pitch", "roll", "yaw"), lines))
    if options.output:
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["time_s", "pitch_deg", "roll_deg", "yaw_deg"])
        writer.writerows([f"{t:.9g}", *(f"{x:.8g}" for x in a)] for t, a in zip(time, angles, strict=True))
        with replacing(options.output) as file:
            file.write(stream.getvalue().encode())
        print(f"wrote {options.output}")
    if options.plot:
        with replacing(options.plot) as stream:
            plots.bound(found, made.name).savefig(stream, format=options.plot.rpartition(".")[2].lower())
        print(f"wrote {options.plot}")
    return 0
