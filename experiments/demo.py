"""`make run`: simulate a vehicle with a DVL, align it with two methods, print a table, write a picture."""

from __future__ import annotations

import argparse
from pathlib import Path

import jax
import numpy as np


def main() -> None:
    """Simulate dvl-sturn, align with oba and centred_oba."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="out", help="folder for the picture and the log (default: out)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)

    from jaxalign import align, io, plots
    from jaxalign.methods import build
    from jaxalign.metrics import attitude_error_deg
    from jaxalign.simulate import simulate

    folder = Path(options.out)
    folder.mkdir(parents=True, exist_ok=True)
    log = simulate("dvl-sturn", options.seed)
    io.write_npz(log, folder / "dvl-sturn.npz")
    solutions = {name: align(build(name, log.aid), log) for name in ("oba", "centred_oba")}

    print(f"dvl-sturn, seed {options.seed}: attitude error in degrees (east, north, heading)")
    print("time s" + "".join(f"{name:>30s}" for name in solutions) + "   heading observable")
    for t in (10, 30, 60, 100, 150, 200, 250, 300):
        cells = ""
        for solution in solutions.values():
            row = int(np.argmin(np.abs(np.asarray(solution.time) - t)))
            error = attitude_error_deg(solution, log)
            assert error is not None
            cells += "".join(f"{x:10.4f}" for x in error[row])
        print(f"{t:6d}{cells}   {'yes' if solution.observable[row] else 'no'}")
    figure = plots.compare(solutions, log, f"dvl-sturn, seed {options.seed}")
    figure.savefig(folder / "dvl-sturn.png")
    plots.attitude(solutions["oba"], log, "dvl-sturn: oba").savefig(folder / "dvl-sturn-oba.png")
    print(f"wrote {folder / 'dvl-sturn.npz'}, {folder / 'dvl-sturn.png'}, {folder / 'dvl-sturn-oba.png'}")


if __name__ == "__main__":
    main()
