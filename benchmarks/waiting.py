"""`python -m benchmarks.waiting`: what a person waits for, cold and warm; into waiting.md.

Each command is a process of its own. Cold: with an empty store of compiled programs; warm: the same again. With
`--against DIR` (another checkout, such as a worktree of the commit before) that one aligns the same log right before,
without `--method`, and the ratio to its CPU time is given: CPU times of one machine at one time compare, others do not.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["main"]

HERE = Path(__file__).resolve().parents[1]
SIMULATE = ("simulate", "dvl-sturn", "--set", "outliers=fixed")
STUDY = (
    *("study", "dvl-sturn", "--set", "outliers=fixed", "--runs", "1000", "--every", "20"),
    *("--methods", "oba,roba,moba,rkf_oba,centred_oba,revising_oba,robust_map"),
)
DEAR = ("align HOURS", "study DVL-STURN")


@dataclass(frozen=True)
class Cost:
    """Of one process: CPU and wall s, peak memory in MB."""

    cpu: float
    wall: float
    memory: float


def measured(code: Path, arguments: Sequence[str], store: Path | str, out: Path) -> Cost:
    """Run a command of a checkout.

    Raises:
        SystemExit: it failed.
    """
    environment = {**os.environ, "PYTHONPATH": str(code), "JAXALIGN_CACHE": str(store)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package has its bytecode
    environment["PYTHONPYCACHEPREFIX"] = str(out.parent / "bytecode")
    command = [sys.executable, "-m", "jaxalign", *arguments]
    begun = time.perf_counter()
    with open(out, "wb") as stream:
        process = subprocess.Popen(command, cwd=code, env=environment, stdout=stream, stderr=subprocess.STDOUT)
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - begun
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ({code}): {process.returncode}\n{out.read_text()[-2000:]}")
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return Cost(used.ru_utime + used.ru_stime, wall, used.ru_maxrss / unit)


def cells(cost: Cost, unit: Cost | None) -> str:
    """Columns of the table."""
    ratio = "" if unit is None else f"{cost.cpu / unit.cpu:.3f}"
    return f"{cost.cpu:.2f} | {ratio} | {cost.wall:.2f} | {cost.memory:.0f}"


def surroundings(folder: Path) -> list[str]:
    """What it was measured on, and whether this machine loads what it has stored; last: JAX takes memory."""
    from benchmarks.machine import machine
    from jaxalign.compilation import probe

    folder.mkdir()
    probe.settle(folder)
    answer = {True: "are loaded again", False: "are REJECTED when they are loaded", None: "cannot be tried"}
    return [
        f"Written by `python -m benchmarks.waiting` on {machine()}.",
        f"Programs that are stored on this machine {answer[probe.verdict(folder)]}.",
    ]


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--against", type=Path, metavar="DIR", help="another checkout, to compare with")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="the middle one counts (default: 3)")
    parser.add_argument("--long", action="store_true", help="also two hours at 200 Hz with an aid of 1 Hz")
    parser.add_argument("--study", action="store_true", help="also the study of `make run`")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_suffix(".md"))
    options = parser.parse_args()
    against = None if options.against is None else options.against.resolve()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        log, hours, text = folder / "log.npz", folder / "hours.npz", folder / "out.txt"
        measured(HERE, (*SIMULATE, "--output", str(log)), "off", text)
        commands = [
            ("--help", ("--help",)),
            ("info LOG", ("info", str(log))),
            ("align LOG --method oba", ("align", str(log), "--method", "oba")),
            ("align LOG", ("align", str(log))),
        ]
        if options.long:
            measured(HERE, (*SIMULATE, "--set", "duration=7200", "--output", str(hours)), "off", text)
            commands.append((DEAR[0], ("align", str(hours))))
        if options.study:
            commands.append((DEAR[1], STUDY))
        lines: list[str] = []
        for name, arguments in commands:
            rows: dict[str, list[tuple[Cost, Cost | None]]] = {"cold": [], "warm": []}
            for repeat in range(1 if name in DEAR else options.repeats):
                store = folder / f"store-{len(lines)}-{repeat}"
                unit = None if against is None else measured(against, ("align", str(log)), "off", text)
                for runs in rows.values():
                    runs.append((measured(HERE, arguments, store, text), unit))
            for state, runs in rows.items():
                cost, unit = sorted(runs, key=lambda run: run[0].cpu / (run[1].cpu if run[1] else 1.0))[len(runs) // 2]
                lines.append(f"| `{name}` | {state} | {cells(cost, unit)} |")
                print(lines[-1], flush=True)
        head = [
            "# What a person waits for",
            "",
            *surroundings(folder / "probe"),
            "",
            f"The middle one of {options.repeats} runs ({' and '.join(DEAR)}: one run). LOG: 300 s at 200 Hz, 301 "
            "epochs; HOURS: two hours of it; the study is that of `make run`. Cold: no program is stored (but Python's "
            "bytecode, as of an installed package). Ratio: "
            "to the CPU time of `align LOG` by the other checkout, in the same minutes.",
            "",
            "| command | | CPU s | ratio | wall s | peak MB |",
            "|---|---|---|---|---|---|",
        ]
    options.output.write_text("\n".join([*head, *lines]) + "\n")
    print(f"wrote {options.output}")


if __name__ == "__main__":
    main()
