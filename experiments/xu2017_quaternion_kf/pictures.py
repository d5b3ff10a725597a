"""The force of a swaying base in b0, as measured and as fitted by recursive least squares."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.figures import finish, panels
from jaxalign import align
from jaxalign.methods import build
from jaxalign.simulate import simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["force_over_time"]


def force_over_time(seed: int, samples: int) -> Figure:
    """Figure 4 of the paper: components in b0, and what is wrong with them."""
    log = simulate("sway", seed, duration=300.0)
    assert log.C_nb is not None
    dt = samples * log.dt
    axes = panels(3, 2, width=11.0, height=8.0, sharex=True)
    for color, (label, name) in enumerate((("measured", "gravity_q"), ("fitted", "rls_q"))):
        found = align(build(name, "static", {"front_end.interval_samples": samples}), log, every=25)
        time, beta, alpha = (np.asarray(x)[1:] for x in (found.time, found.beta, found.alpha))
        force, wrong = beta / dt, (beta - alpha @ log.C_nb[0]) / dt
        for i, axis in enumerate("xyz"):
            style = {"color": f"C{color}", "linewidth": 0.5 + color, "label": label}
            axes[i, 0].plot(time, force[:, i], **style)
            axes[i, 1].plot(time, 1e3 * wrong[:, i], **style)
            axes[i, 0].set_ylabel(f"{axis} (m/s^2)")
            axes[i, 1].set_ylabel(f"{axis} (1e-3 m/s^2)")
    axes[0, 0].set_title("specific force in b0", fontsize="medium")
    axes[0, 1].set_title("less the true one (the bias stays)", fontsize="medium")
    for axis in axes[:, 1]:
        axis.set_ylim(-20, 20)
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    return finish(axes, "sway: force in inertial space, one run")
