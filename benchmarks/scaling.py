"""`python -m benchmarks.scaling`: what a study costs with its runs, duration, rates, methods, devices and processes.

Each row is a process of its own; compile time (the first, smallest study of the same block) apart from run time.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax

from benchmarks.machine import peak_gb

METHODS = ("oba", "roba", "moba", "rkf_oba", "centred_oba", "request", "optimal_request", "vo_tvk")
HEAD = "| {what} | compile s | wall s | wall ms per run | CPU ms per run | memory GB |"


def measure(options: dict[str, Any]) -> dict[str, float]:
    """One study in this process."""
    from jaxalign.simulate import scenario
    from jaxalign.study import Study, run

    made = scenario(options.get("scenario", "dvl-sturn"), **options.get("options", {}))
    changes = options.get("changes", {})
    if changes:
        import dataclasses

        made = dataclasses.replace(made, **changes)
    runs, methods = options["runs"], options.get("methods", ["oba"])

    def study(count: int) -> Any:
        return run(Study(made, methods, count, every=options.get("every", 10)))

    warm = min(runs, 4096)  # the same block size as any number of runs beyond
    start = time.perf_counter()
    study(warm)
    first = time.perf_counter() - start
    start = time.perf_counter()
    study(warm)
    compiled = first - (time.perf_counter() - start)
    before, start = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
    study(runs)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"compile": compiled, "wall": wall, "cpu": cpu, "memory": peak_gb(), "runs": runs}


def child(options: dict[str, Any]) -> subprocess.Popen[str]:
    """Measure one case in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "benchmarks.scaling", "--one", json.dumps(options)],
        stdout=subprocess.PIPE,
        text=True,
    )


def found(process: subprocess.Popen[str]) -> dict[str, float]:
    """What a child has measured."""
    text, _ = process.communicate()
    if process.returncode:
        raise SystemExit(f"a measurement failed with exit code {process.returncode}")
    return json.loads(text.splitlines()[-1])


def table(title: str, what: str, rows: list[tuple[str, dict[str, Any]]]) -> list[str]:
    """A measurement for each row."""
    lines = [f"## {title}", "", HEAD.format(what=what), "|---|---|---|---|---|---|"]
    for label, options in rows:
        got = found(child(options))
        cells = [label, f"{got['compile']:.1f}", f"{got['wall']:.2f}", f"{1e3 * got['wall'] / got['runs']:.4f}"]
        cells += [f"{1e3 * got['cpu'] / got['runs']:.4f}", f"{got['memory']:.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
        print(lines[-1], flush=True)
    return [*lines, ""]


def processes(runs: int) -> list[str]:
    """One process pinned to a core against two, each pinned to one."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        return ["## Processes", "", "One core only: not measured.", ""]
    alone = found(child({"runs": runs, "core": cores[0]}))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    where = f"127.0.0.1:{port}"
    both = [child({"runs": runs, "distributed": [where, 2, i], "core": core}) for i, core in enumerate(cores)]
    together = max((found(process) for process in both), key=lambda x: x["wall"])
    ratio = alone["wall"] / together["wall"]
    print(f"two processes: {ratio:.2f} times one")
    return [
        "## Processes",
        "",
        f"{runs} runs, one process on one core: {alone['wall']:.2f} s. Two processes joined by `jax.distributed`,",
        f"each pinned to one core: {together['wall']:.2f} s, **{ratio:.2f} times faster**.",
        "",
    ]


def sections(most: int) -> list[Callable[[], list[str]]]:
    """What is measured, in this order."""
    sizes = [n for n in (1000, 10_000, 30_000, 100_000) if n <= most]
    rates = [
        (f"{r:g}", {"runs": 5000, "changes": {"imu_rate": r, "epoch_samples": int(r)}}) for r in (100.0, 200.0, 1e3)
    ]
    aids = [
        (f"{200 / n:g}", {"runs": 2000, "changes": {"epoch_samples": n}, "every": 2000 // n}) for n in (200, 40, 20)
    ]
    durations = [(f"{s:g}", {"runs": 5000, "options": {"duration": s}}) for s in (100.0, 300.0, 1200.0)]
    return [
        partial(table, "Runs", "runs", [(str(n), {"runs": n}) for n in sizes]),
        partial(table, "Devices", "devices of the CPU", [(str(d), {"runs": 20_000, "devices": d}) for d in (1, 2)]),
        partial(processes, 20_000),
        partial(table, "Read-out", "every", [(str(n), {"runs": 10_000, "every": n}) for n in (1, 5, 10, 50)]),
        partial(table, "Methods", "method", [(m, {"runs": 10_000, "methods": [m]}) for m in METHODS]),
        partial(table, "Duration", "s", durations),
        partial(table, "IMU rate, aid at 1 Hz", "Hz", rates),
        partial(table, "Aid rate, IMU at 200 Hz", "Hz", aids),
    ]


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "scaling.md")
    parser.add_argument("--most", type=int, default=100_000, help="most runs (default: 100000)")
    parser.add_argument("--one", metavar="JSON", help="measure one study, in this process")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.one:
        from jaxalign.study import devices

        one = json.loads(options.one)
        if "core" in one:
            os.sched_setaffinity(0, {one["core"]})  # before the first use of JAX, which starts its threads
        if "distributed" in one:
            devices.join(*one["distributed"])
        elif "devices" in one:
            jax.config.update("jax_num_cpu_devices", one["devices"])
        else:
            devices.use_all_cores()
        print(json.dumps(measure(one)))
        return
    from benchmarks.machine import machine

    head = [
        "# What a study costs",
        "",
        f"Written by `python -m benchmarks.scaling` on {machine()}.",
        "",
        "`oba` on dvl-sturn (300 s, IMU 200 Hz, aid 1 Hz), read out every 10 epochs, noise per increment, all cores,",
        "where nothing else is said.",
        "",
    ]
    written = [*head]
    for section in sections(options.most):
        written += section()
        options.output.write_text("\n".join(written))  # table by table: what was measured stays
    print(f"wrote {options.output}")


if __name__ == "__main__":
    main()
