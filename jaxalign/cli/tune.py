"""``jaxalign tune``: the numbers of a method, by gradient descent over simulated runs."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from typing import TYPE_CHECKING, Any

from jaxalign.errors import UserError

if TYPE_CHECKING:
    from jaxalign.aids import AbstractAid

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the sub-command."""
    from jaxalign.cli.report import add_scenario_argument

    command = commands.add_parser(
        "tune",
        help="fit numbers of a method by gradient descent over simulated runs",
        description="Fit numbers of a method (Huber's threshold, noise of a filter, a prefilter's cut-off) by gradient "
        "descent through simulation, alignment and score. The best numbers over runs held out are kept, and written "
        "with --output for the --method-file of `jaxalign align` and `jaxalign study`.",
        epilog="Losses: rmse (default) and log-rmse of an angle over the window; quantile: what most runs stay below; "
        "convergence: seconds outside a tolerance; misfit: of a prefilter alone. What can be tuned: `jaxalign methods "
        "NAME`.",
    )
    add_scenario_argument(command)
    command.add_argument("--method", metavar="NAME", help="see `jaxalign methods`")
    command.add_argument("--method-file", metavar="FILE", help="start from a method that was tuned before (JSON)")
    command.add_argument(
        "--param",
        action="append",
        default=[],
        metavar="PATH",
        help="a number to tune, e.g. weight.threshold; may be repeated, or several with commas",
    )
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an option of the scenario (outliers=fixed) or a number of the method to start from (weight.threshold=3); "
        "may be repeated",
    )
    command.add_argument("--prefilter", metavar="NAME", help="in front of the method, see `jaxalign methods`")
    command.add_argument("--loss", default="rmse", metavar="NAME", help="what is made small (default: %(default)s)")
    command.add_argument("--angle", metavar="A", help="of the loss: pitch, roll, yaw (default) or level")
    command.add_argument("--tolerance", type=float, metavar="DEG", help="of the loss convergence (default: 1)")
    command.add_argument("--share", type=float, metavar="P", help="of the runs, for the loss quantile (default: 0.95)")
    command.add_argument("--split", type=float, metavar="HZ", help="of the loss misfit (default: 0.5)")
    command.add_argument("--runs", type=int, default=256, metavar="N", help="to learn from (default: %(default)s)")
    command.add_argument("--batch", type=int, metavar="N", help="runs of a step (default: all)")
    command.add_argument(
        "--held-out", type=int, default=1024, metavar="N", help="runs to judge by (default: %(default)s)"
    )
    command.add_argument("--steps", type=int, default=100, metavar="N", help="at most (default: %(default)s)")
    command.add_argument(
        "--rate", type=float, default=0.1, metavar="R", help="relative change in a step (default: %(default)s)"
    )
    command.add_argument(
        "--patience",
        type=int,
        default=6,
        metavar="N",
        help="looks (one every 5 steps) at the runs held out without anything better, then stop; 0: never "
        "(default: %(default)s)",
    )
    command.add_argument("--seed", type=int, default=0, metavar="S", help="of all the runs (default: %(default)s)")
    command.add_argument("--every", type=int, default=10, metavar="N", help="epochs between read-outs (default: 10)")
    command.add_argument(
        "--fidelity",
        default="increments",
        metavar="F",
        help="noise per epoch: increments (default); or per IMU sample: samples (for prefilters and shaken bases)",
    )
    command.add_argument(
        "--window",
        type=float,
        nargs=2,
        metavar=("START", "STOP"),
        help="seconds over which the loss is taken (default: the last 50 s; convergence: all)",
    )
    command.add_argument("--mode", default="auto", metavar="M", help="of differentiation: auto, forward or reverse")
    command.add_argument("--output", metavar="OUT.json", help="write the tuned method")
    command.add_argument("--plot", metavar="OUT.png", help="write a picture: .png, .pdf or .svg (needs matplotlib)")
    command.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    from jaxalign.cli.interrupt import patience
    from jaxalign.cli.report import assignments, check_outputs, chosen_scenario, split_settings
    from jaxalign.files import replacing
    from jaxalign.tables import aligned
    from jaxalign.tune import Tune, run

    of_scenario, of_method = split_settings(assignments(options.set), options.scenario)
    made = chosen_scenario(options.scenario, of_scenario)
    name, method = _method(options, tuple(one.aid for one in made.aids), of_method)
    paths = [path.strip() for text in options.param for path in text.split(",") if path.strip()]
    tune = Tune(
        made,
        method,
        paths,
        _loss(options),
        options.runs,
        options.batch,
        options.held_out,
        options.steps,
        options.rate,
        patience=options.patience,
        seed=options.seed,
        every=options.every,
        fidelity=options.fidelity,
        window=None if options.window is None else tuple(options.window),  # pyright: ignore[reportArgumentType]
        mode=options.mode,
        recipe=name,
    )
    plots = None
    if options.plot:
        from jaxalign import plots

        plots.require()
    check_outputs(options, [options.method_file])

    def warn(line: str) -> None:
        print(f"jaxalign: warning: {line}", file=sys.stderr)

    with patience():
        tuned = run(tune, progress=True, warn=warn)
    written = []
    if options.output:
        tuned.write(options.output)
        written.append(options.output)
    if plots is not None:
        from jaxalign.tune.picture import picture

        figure = picture(tuned)
        with replacing(options.plot) as stream:
            figure.savefig(stream, format=options.plot.rpartition(".")[2].lower())
        written.append(options.plot)
    print(f"{name} on {made.name}, {tune.runs} runs, {tuned.mode} mode, {tuned.seconds:.1f} s")
    print(aligned(*tuned.rows()))
    print(tuned.summary)
    for path in written:
        print(f"wrote {path}")
    if tuned.stopped.startswith("interrupted"):
        return 130
    return 1 if "not finite" in tuned.stopped else 0


def _method(options: argparse.Namespace, aids: tuple[AbstractAid, ...], settings: dict[str, str]) -> tuple[str, Any]:
    from jaxalign.method_file import read_method
    from jaxalign.methods import build_for, with_settings

    if (options.method is None) == (options.method_file is None):
        raise UserError("name a method to tune: --method NAME (see `jaxalign methods`), or --method-file FILE")
    if options.method_file is not None:
        if options.prefilter is not None:
            raise UserError("--prefilter goes with --method: the method of a file has its own or none")
        name, method, _ = read_method(options.method_file)
        return name, with_settings(name, method, settings)
    return options.method, build_for(aids, options.method, settings, options.prefilter)


def _loss(options: argparse.Namespace) -> Any:
    """The loss by name with the flags that are its own."""
    from jaxalign.tune.losses import LOSSES, loss_of

    made = loss_of(options.loss)
    flags = {"angle": "angle", "tolerance": "tolerance_deg", "share": "share", "split": "split"}
    given = {field: value for flag, field in flags.items() if (value := getattr(options, flag)) is not None}
    known = {field.name for field in dataclasses.fields(made)}
    for flag, field in flags.items():
        if field in given and field not in known:
            takers = [name for name, kind in LOSSES.items() if field in {f.name for f in dataclasses.fields(kind)}]
            raise UserError(f"--{flag} does not go with --loss {options.loss}, but with {', '.join(takers)}")
    return dataclasses.replace(made, **given)
