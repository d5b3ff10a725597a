"""Pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from experiments.figures import finish, panels, sizes
from experiments.vondrak_disturbed_base.schemes import FINES, SCHEMES
from experiments.vondrak_disturbed_base.simulated import disturbed
from experiments.vondrak_disturbed_base.smoothing import CUTOFFS, OBJECTIVES, Choice, objectives
from jaxalign import read
from jaxalign.prefilter import multitaper
from jaxalign.simulate import simulate

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = ["convergence", "landscapes", "spectra", "tests"]

G = 9.80665


def _record(log: Any) -> tuple[np.ndarray, float]:
    """60 s of the force along the first axis, ug."""
    force = log.dvel[: round(60.0 / log.dt), 0] / log.dt / G * 1e6
    return force - force.mean(), log.dt


def spectra(seed: int, real: Path | None) -> Figure:
    """Force before and after the filters: condition 2 as printed and with 10 mg, the real log; and the responses."""
    records = {
        "condition 2, as printed": _record(simulate(disturbed(2, duration=60.0), seed)),
        "condition 2, 10 mg": _record(simulate(disturbed(2, 10.0, duration=60.0), seed)),
    }
    if real is not None:
        records["laser-gyro unit on a vehicle"] = _record(read(real))
    axes = panels(2, 2, width=10.0, height=8.0)
    for axis, (title, (x, dt)) in zip(axes.flat[1:], records.items(), strict=False):
        for i, (scheme, prefilter) in enumerate(SCHEMES.items()):
            y = x if prefilter is None else np.asarray(prefilter(jnp.asarray(x)[:, None], dt))[:, 0]
            f, density = multitaper(y, dt)
            axis.loglog(f[1:], np.sqrt(density[1:]), label=scheme, color=f"C{i}", linewidth=1.0)
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("frequency (Hz)")
        axis.set_ylabel("force (ug / sqrt(Hz))")
        axis.set_ylim(1e-3, None)
    f = np.geomspace(0.05, 50, 600)
    for i, (scheme, prefilter) in enumerate(SCHEMES.items()):
        gain = np.ones_like(f) if prefilter is None else np.abs(prefilter.response(f, 0.005))
        axes[0, 0].loglog(f, np.maximum(gain, 1e-9), label=scheme, color=f"C{i}")
    axes[0, 0].set_title("gain at 200 Hz", fontsize=10)
    axes[0, 0].set_xlabel("frequency (Hz)")
    axes[0, 0].set_ylabel("gain")
    axes[0, 0].set_ylim(1e-7, 3)
    if real is None:
        axes[1, 1].set_visible(False)
    return finish(axes, "the filters at 0.5 Hz, and the force before and after", 4)


def convergence(found: Mapping[tuple[int, float], Any]) -> Figure:
    """Heading errors of coarse and fine alignment over time, less what the biases leave."""
    rows = [key for key in found if key[1] in (1.0, 10.0)]
    axes = panels(len(rows), 1 + len(FINES), width=15.0, height=11.0, sharex=True, sharey=True)
    for i, (condition, amplitude) in enumerate(rows):
        of, floor = found[condition, amplitude]
        for j, what in enumerate(of["2: no filter"]):
            axis, some = axes[i, j], of["2: no filter"][what]
            curves = {scheme: of[scheme][what].phi[:, :, 2] - floor[:, None] for scheme in SCHEMES}
            sizes(axis, some.time, curves)
            axis.set_title(f"{condition}, {amplitude:g} mg; {what}", fontsize=9)
            axis.set_ylim(5e-3, 5)
        axes[i, 0].set_ylabel("|heading error less floor| (deg)")
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    return finish(axes, "condition, disturbance; method: median of the runs (solid), 95 % of them below (dashed)", 4)


def tests(found: Mapping[int, Any]) -> Figure:
    """Fig. 9: the heading error of every test, by scheme and condition."""
    what = next(iter(FINES))
    axes = panels(2, 2, width=10.0, height=7.0, sharex=True)
    for axis, (condition, of) in zip(axes.flat, found.items(), strict=False):
        for i, scheme in enumerate(SCHEMES):
            errors = of[scheme][what].phi[:, -1, 2]
            axis.plot(np.arange(1, len(errors) + 1), errors, "o-", label=scheme, color=f"C{i}", markersize=9 - 2 * i)
        axis.set_title(f"condition {condition}", fontsize=10)
        axis.set_ylabel("heading error (deg)")
    for axis in axes[-1]:
        axis.set_xlabel("test")
    for axis in axes.flat[len(found) :]:
        axis.set_visible(False)
    return finish(axes, f"{what}, after 300 s", 4)


def landscapes(seed: int, found: Mapping[tuple[int, str], tuple[Choice, dict[float, Choice]]]) -> Figure:
    """The objectives over the cut-off, and where the searches end."""
    axes = panels(3, 1, height=9.0, sharex=True)
    cutoffs = np.geomspace(*CUTOFFS, 81)
    for condition in sorted({condition for condition, _ in found}):
        made = objectives(condition, seed)
        for axis, name in zip(axes[:, 0], OBJECTIVES, strict=True):
            values = np.array([float(made[name](np.log(c))) for c in cutoffs])
            ga, gradients = found[condition, name]
            ends = {"o": [ga], "x": list(gradients.values())}
            if name == "J":
                values = np.exp(-values)
            axis.plot(cutoffs, values, color=f"C{condition}", label=f"condition {condition}")
            for marker, choices in ends.items():
                y = [np.exp(-c.value) if name == "J" else c.value for c in choices]
                axis.plot([c.cutoff for c in choices], y, marker, color=f"C{condition}", markersize=6)
    axes[0, 0].set_yscale("log")
    axes[0, 0].set_ylabel("(27) as printed")
    axes[1, 0].set_ylabel("(27) reconstructed")
    axes[1, 0].set_ylim(0, 1.05)
    axes[2, 0].set_yscale("log")
    axes[2, 0].set_ylabel("J (m²/s⁴)")
    axes[2, 0].set_xlabel("cut-off (Hz)")
    for axis in axes[:, 0]:
        axis.set_xscale("log")
        axis.axvline(0.5, color="0.5", linestyle=":")
    return finish(axes, "objectives; genetic algorithm (dots), gradient from three starts (crosses)", 4)
