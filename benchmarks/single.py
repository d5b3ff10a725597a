"""`python -m benchmarks.single`: one log, from arrays on the host to attitudes; into results.md.

Compile time (tracing and XLA, in a fresh cache) apart from run time. Run on an idle machine.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from benchmarks.machine import best_ms, machine  # noqa: E402
from jaxalign import align, epochs_from_log  # noqa: E402
from jaxalign.aids import BodyVelocity, NavVelocity, Standing  # noqa: E402
from jaxalign.methods import RECIPES, build  # noqa: E402
from jaxalign.simulate import scenario, simulate  # noqa: E402

SCENARIOS = {BodyVelocity: "dvl-sturn", NavVelocity: "gps-zigzag", Standing: "sway"}


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results.md")
    options = parser.parse_args()
    logs = {
        aid: simulate(scenario(name, **({"duration": 300.0} if aid is Standing else {})), 1)
        for aid, name in SCENARIOS.items()
    }
    logs[Standing] = logs[Standing].with_epochs(100)
    lines = [
        "# One log",
        "",
        f"Written by `python -m benchmarks.single` on {machine()}.",
        "",
        "From NumPy arrays to attitudes, preintegration included; smallest of 30 calls (median in brackets), ms.",
        "",
        "| recipe | aid | log | epochs | every epoch: compile s | run ms | every 10: compile s | run ms |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, recipe in RECIPES.items():
        for aid in () if recipe.published else recipe.aids:
            log, method, cells = logs[aid], build(name, aid()), []
            epochs_from_log(log, aids=aid())  # compiled once for all methods: its own row below
            for every in (1, 10):
                jax.clear_caches()
                epochs = jax.block_until_ready(epochs_from_log(log, aids=aid()))
                start = time.perf_counter()
                jax.block_until_ready(method.solve(epochs, every))
                compiled = time.perf_counter() - start
                low, median = best_ms(
                    lambda log=log, method=method, every=every: method.solve(method.epochs(log), every)
                )
                cells += [f"{compiled:.2f}", f"{low:.2f} ({median:.2f})"]
            shape = f"{log.duration:g} s, {1 / log.dt:g} Hz"
            lines.append(f"| {name} | {aid.kind} | {shape} | {log.epochs} | {' | '.join(cells)} |")
            print(lines[-1])
    jax.clear_caches()
    log = logs[BodyVelocity]
    start = time.perf_counter()
    jax.block_until_ready(epochs_from_log(log))
    compiled = time.perf_counter() - start
    low, median = best_ms(lambda: epochs_from_log(log))
    lines += [
        "",
        "Preintegration alone, 60,000 samples to 300 intervals: "
        f"compile {compiled:.2f} s, run {low:.2f} ({median:.2f}) ms.",
    ]
    sturn = build("oba", "body")
    solution = align(sturn, log)
    moments = jax.jit(lambda e: sturn.solve(e, 1)).lower(epochs_from_log(log)).compile().memory_analysis()
    assert moments is not None
    lines += [
        f"Memory of oba on 301 epochs, read out at each: {moments.temp_size_in_bytes / 1024:.0f} kB temporary, "
        f"{sum(x.nbytes for x in jax.tree.leaves(solution)) / 1024:.0f} kB of results.",
        "",
    ]
    options.output.write_text("\n".join(lines))
    print("\n".join(lines[-3:]))
    print(f"wrote {options.output}")


if __name__ == "__main__":
    main()
