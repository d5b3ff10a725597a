"""`python -m benchmarks.tuning`: what gradients cost, beside the study that they are gradients of.

Time over that of the forward study of the same runs (their noise drawn, aligned, compared), in one process; memory that
the compiled program asks for, per run; compile time apart.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

RUNS = 256
METHODS = {
    "roba": ("dvl-sturn", {}),
    "moba": ("dvl-sturn", {"weight.gate": "smooth"}),
    "rkf_oba": ("dvl-sturn", {}),
    "request": ("gps-zigzag", {}),
    "optimal_request": ("gps-zigzag", {"estimate.measurement_noise": "constant", "estimate.process_variance": 1e-4}),
    "vo_tvk": ("gps-zigzag", {"estimate.measurement_noise": "constant"}),
}
HEAD = "| method | numbers | forward ms per run | mode | times forward | kB per run | compile s |"


def best(f: Any, *arguments: Any, repeats: int = 5) -> float:
    """Least seconds."""
    out = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(f(*arguments))
        out.append(time.perf_counter() - start)
    return min(out)


def measure(name: str) -> list[dict[str, Any]]:
    """One method: the first number forward, all of them in both modes."""
    import jax.numpy as jnp

    from jaxalign.methods import build
    from jaxalign.parametrization import tunables
    from jaxalign.study.epochs_spec import epochs_spec, run_keys, run_model
    from jaxalign.tune import Tune, prepared
    from jaxalign.tune.objective import Mode, loss_and_slope

    scenario, settings = METHODS[name]
    aid = "nav" if scenario == "gps-zigzag" else "body"
    method = build(name, aid, settings)
    every = list(tunables(method))
    rows = []
    asked: list[tuple[list[str], Mode]] = [(every[:1], "forward"), (every, "reverse")]
    if len(every) > 1:
        asked.insert(1, (every, "forward"))
    for paths, mode in asked:
        tune = Tune(scenario, method, paths, runs=RUNS, held_out=2)
        ready = prepared(tune)
        spec = epochs_spec(method, tune.scenario)
        model = run_model(tune.scenario, spec, jax.random.key(0), "increments")
        keys = run_keys(jax.random.key(0), jnp.arange(RUNS))
        free = tune.space.origin
        drawing = jax.jit(lambda keys, model=model: model.epochs(keys)).lower(keys).compile()
        forward = jax.jit(lambda free, batch, of=ready.objective: of(free, batch)).lower(free, ready.batch).compile()
        start = time.perf_counter()

        def slope(free: Any, batch: Any, of: Any = ready.objective, mode: Mode = mode) -> Any:
            return loss_and_slope(of, free, batch, mode)

        graded = jax.jit(slope)
        graded = graded.lower(free, ready.batch).compile()
        compiled = time.perf_counter() - start
        study = best(drawing, keys) + best(forward, free, ready.batch)
        rows.append(
            {
                "method": name,
                "numbers": len(paths),
                "study": 1e3 * study / RUNS,
                "mode": mode,
                "ratio": (best(drawing, keys) + best(graded, free, ready.batch)) / study,
                "memory": getattr(graded.memory_analysis(), "temp_size_in_bytes", np.nan) / RUNS / 1e3,
                "compile": compiled,
            }
        )
    return rows


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "tuning.md")
    parser.add_argument("--one", metavar="METHOD", choices=METHODS, help="measure one method, in this process")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.one:
        print(json.dumps(measure(options.one)))
        return
    from benchmarks.machine import machine

    lines = [
        "# What gradients cost",
        "",
        f"Written by `python -m benchmarks.tuning` on {machine()}.",
        "",
        f"{RUNS} runs, read out every 10 epochs, loss: RMSE of the heading over the last 50 s. Forward: the study of",
        "the same runs (noise drawn, aligned, compared). The epochs themselves, 25 kB a run, are not in the memory.",
        "",
        HEAD,
        "|---|---|---|---|---|---|---|",
    ]
    for name in METHODS:
        command = [sys.executable, "-m", "benchmarks.tuning", "--one", name]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        for row in json.loads(done.stdout.splitlines()[-1]):
            cells = [row["method"], str(row["numbers"]), f"{row['study']:.3f}", row["mode"], f"{row['ratio']:.2f}"]
            lines.append("| " + " | ".join([*cells, f"{row['memory']:.1f}", f"{row['compile']:.1f}"]) + " |")
            print(lines[-1], flush=True)
        options.output.write_text("\n".join([*lines, ""]))
    print(f"wrote {options.output}")


if __name__ == "__main__":
    main()
