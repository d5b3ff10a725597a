"""``jaxalign study``: which method, how accurate, how sure."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxalign.errors import UserError, close_names

if TYPE_CHECKING:
    from jaxalign.aids import AbstractAid
    from jaxalign.method_file import Named

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the sub-command."""
    from jaxalign.cli.report import add_scenario_argument

    command = commands.add_parser(
        "study",
        help="thousands of simulated runs of several methods, with statistics",
        description="Simulate a scenario many times, align every run with every method, and print how accurate they "
        "are and how sure that is. All methods see the same runs; the same seed gives the same runs and the same "
        "result, to the last bit, for any chunk, number of devices or processes, and after an interruption.",
        epilog="On several processes: the same command in each with --distributed HOST:PORT --processes N --rank R; "
        "under SLURM --distributed alone. Process 0 prints and writes.",
    )
    add_scenario_argument(command)
    command.add_argument(
        "--methods",
        metavar="M1,M2,...",
        help="names (see `jaxalign methods`), or LABEL=NAME for variants of one (default: oba,centred_oba; without an "
        "aid gravity_q,velocity_q)",
    )
    command.add_argument(
        "--method-file",
        action="append",
        default=[],
        metavar="FILE",
        help="a method with its numbers, as written by `jaxalign tune --output`, labelled by the name of the file; may "
        "be repeated (default of --methods then: the same methods untuned)",
    )
    command.add_argument("--runs", type=int, default=1000, metavar="N", help="how many (default: %(default)s)")
    command.add_argument("--seed", type=int, default=0, metavar="S", help="of all the runs (default: %(default)s)")
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an option of the scenario (outliers=fixed), a parameter of all methods that have it (weight.threshold=3) "
        "or of one (LABEL:weight.threshold=3); may be repeated",
    )
    command.add_argument(
        "--prefilter", metavar="NAME", help="in front of methods for a standing vehicle, see `jaxalign methods`"
    )
    command.add_argument("--every", type=int, metavar="N", help="epochs between read-outs (default: 10)")
    command.add_argument(
        "--fidelity",
        default="increments",
        metavar="F",
        help="noise per epoch: increments (default; the same distribution, far cheaper); or per IMU "
        "sample: samples (for prefilters and shaken bases)",
    )
    command.add_argument(
        "--tolerance", type=float, default=1.0, metavar="DEG", help="of convergence, deg (default: %(default)s)"
    )
    command.add_argument(
        "--window",
        type=float,
        nargs=2,
        metavar=("START", "STOP"),
        help="seconds from which the accuracy is taken (default: the last 50 s)",
    )
    command.add_argument("--chunk", type=int, metavar="C", help="runs between two writes to DIR (default: 8192)")
    command.add_argument(
        "--output",
        metavar="DIR",
        help="folder for results.npz, .csv, .md and the finished chunks (default: print only)",
    )
    command.add_argument("--resume", action="store_true", help="complete the study in DIR")
    command.add_argument("--plot", action="store_true", help="also DIR/results.png (needs matplotlib)")
    command.add_argument(
        "--distributed",
        nargs="?",
        const="",
        metavar="HOST:PORT",
        help="one of several processes: where process 0 listens; nothing under SLURM",
    )
    command.add_argument("--processes", type=int, metavar="N", help="with --distributed: how many")
    command.add_argument("--rank", type=int, metavar="R", help="with --distributed: which of them this is, from 0")
    command.set_defaults(run=_run, devices=_devices)


def _devices(options: argparse.Namespace) -> None:
    """Before anything of JAX runs: use all cores, join the other processes."""
    from jaxalign.study import devices

    if options.distributed is None and (options.processes is not None or options.rank is not None):
        raise UserError("--processes and --rank go with --distributed HOST:PORT")
    devices.use_all_cores()
    if options.distributed is not None:
        devices.join(options.distributed or None, options.processes, options.rank)


def _run(options: argparse.Namespace) -> int:
    from jaxalign.cli.interrupt import patience
    from jaxalign.cli.report import assignments, chosen_scenario, split_settings
    from jaxalign.study import Interrupted, Study, devices, run

    if options.output is None and (options.plot or options.resume):
        raise UserError(f"--{'plot' if options.plot else 'resume'} needs a folder: --output DIR")
    if options.plot:
        from jaxalign import plots

        plots.require()
    of_scenario, of_methods = split_settings(assignments(options.set), options.scenario)
    made = chosen_scenario(options.scenario, of_scenario)
    files = _of_files(options.method_file)
    usual = "gravity_q,velocity_q" if made.standing else "oba,centred_oba"
    chosen = options.methods or ",".join(dict.fromkeys(named.name for named in files.values())) or usual
    prefilters = {named.prefilter for named in files.values()} if options.methods is None else set()
    prefilter = options.prefilter or (prefilters.pop() if len(prefilters) == 1 else None)
    methods = _methods(chosen, tuple(one.aid for one in made.aids), prefilter, of_methods)
    for label, named in files.items():
        if label in methods:
            raise UserError(f"--method-file: {label} is the name of a method too: rename the file")
        methods[label] = named.method
    window = None if options.window is None else tuple(options.window)
    study = Study(
        made,
        methods,
        options.runs,
        options.seed,
        options.every,
        options.fidelity,
        options.tolerance,
        window,  # pyright: ignore[reportArgumentType]
    )

    def warn(line: str) -> None:
        print(f"jaxalign: warning: {line}", file=sys.stderr)

    kept = "" if options.output is None else f"finished chunks are in {options.output}: go on with --resume"
    try:
        with patience(kept):
            result = run(
                study, out=options.output, resume=options.resume, chunk=options.chunk, progress=True, warn=warn
            )
    except Interrupted as error:
        print(f"jaxalign: {error}", file=sys.stderr)
        if error.result is not None and devices.is_first():
            _print(error.result)
        return 130
    if result is None:  # not the first process
        return 0
    from jaxalign.study.report import write

    written = write(result, options.output, options.plot) if options.output is not None else []
    _print(result)
    for path in written:
        print(f"wrote {Path(path)}")
    return 0


def _of_files(paths: Sequence[str]) -> dict[str, Named]:
    """Label -> method, of the files."""
    from jaxalign.method_file import read_method

    out: dict[str, Named] = {}
    for path in paths:
        label = Path(path).stem
        if label in out:
            raise UserError(f"--method-file: two files are named {label}: rename one")
        out[label] = read_method(path)
    return out


def _print(result: Any) -> None:
    from jaxalign.study.report import rows
    from jaxalign.tables import aligned

    print(f"{result.title} (± Monte Carlo standard error)")
    print(aligned(*rows(result)))


def _methods(
    text: str, aids: tuple[AbstractAid, ...], prefilter: str | None, settings: Mapping[str, str]
) -> dict[str, Any]:
    """Label -> method, from ``name,label=name,...`` and settings ``path`` or ``label:path``."""
    from jaxalign.methods import build_for, with_settings
    from jaxalign.parametrization import parameters

    out: dict[str, Any] = {}
    names: dict[str, str] = {}
    for part in text.split(","):
        label, equals, name = (x.strip() for x in part.partition("="))
        name = name if equals else label
        if not label or not name:
            raise UserError(f"--methods {text!r}: write it as name,name,... or label=name,...")
        if label in out:
            raise UserError(f"--methods: {label} is named twice; give variants labels: {label}2={name}")
        out[label], names[label] = build_for(aids, name, None, prefilter), name
    for key, value in settings.items():
        label, colon, path = key.rpartition(":")
        if colon and label not in out:
            near = close_names(label, out) or list(out)
            raise UserError(f"--set {key}: no method {label!r} in --methods: did you mean {', '.join(near)}?")
        chosen = [label] if colon else [x for x, method in out.items() if path in parameters(method)]
        for one in chosen or list(out)[:1]:  # where none has it, the message of the first
            out[one] = with_settings(names[one], out[one], {path: value})
    return out
