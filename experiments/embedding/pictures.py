"""Pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from experiments.embedding.doppler import INJECTED, NAMES, UNITS, LogRun, Simulated
from experiments.embedding.outliers import HUBER, LEARNED, TUNED, Weights
from experiments.figures import finish, panels
from experiments.statistics import rms

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["estimates", "of_logs", "sensitivities", "training", "tried"]

IN = ("%", "deg", "deg", "deg", "m", "m", "m")


def estimates(found: Mapping[str, Simulated]) -> Figure:
    """Found against true, run by run: a row per scenario."""
    axes = panels(len(found), 4, width=12.0, height=3.2 * len(found))
    for row, (name, one) in enumerate(found.items()):
        for i in range(4):
            axis, unit = axes[row, i], UNITS[i]
            x, y, sd = (z[:, i] / unit for z in (one.truth, one.found.values, one.found.sd))
            axis.errorbar(x, y, sd, fmt=".", markersize=4, elinewidth=0.6, alpha=0.7, label="found, with its sd")
            ends = np.array([x.min(), x.max()])
            axis.plot(ends, ends, "k", linewidth=0.8, label="true")
            axis.set_title(f"{name}: {NAMES[i]}", fontsize="medium")
            axis.set_xlabel(f"put in ({IN[i]})")
        axes[row, 0].set_ylabel("found (unit of the axis below)")
    return finish(axes, "scale and mounting of the Doppler log (x right, y forward, z up)")


def sensitivities(found: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    """Heading by each error of the Doppler log, over time."""
    axes = panels(1, len(found), width=11.0, height=4.5)
    for axis, (name, (time, slope)) in zip(axes[0], found.items(), strict=True):
        late = time >= 30.0
        for i, label in enumerate(NAMES):
            axis.plot(time[late], slope[late, i], label=f"{label}, 1 {IN[i]}", linestyle="-" if i < 4 else "--")
        axis.set_title(name, fontsize="medium")
        axis.set_xlabel("time (s)")
        axis.set_yscale("symlog", linthresh=0.1)
    axes[0, 0].set_ylabel("change of the heading (deg)")
    return finish(axes, "centred_oba: heading by errors of the Doppler log, from the derivative of align", 4)


def of_logs(found: Sequence[LogRun]) -> Figure:
    """Scale, mounting, lever arm of the logs, without what was put in."""
    axes = panels(1, 4, width=12.0, height=4.2, sharey=True)
    rows = np.arange(len(found))
    for axis, i in zip(axes[0], (0, 1, 3, 6), strict=True):
        unit = UNITS[i]
        value, sd, reference = (
            np.array([x[i] for x in column]) / unit
            for column in (
                [r.values - INJECTED for r in found],
                [r.sd for r in found],
                [r.reference - INJECTED for r in found],
            )
        )
        axis.errorbar(value, rows, xerr=sd, fmt="o", capsize=3, label="found minus put in, with its sd")
        axis.plot(reference, rows, "kx", label="fit to the velocity of the reference")
        axis.set_xlabel(f"{NAMES[i]} ({IN[i]})")
    axes[0, 0].set_yticks(rows, [r.name for r in found])
    return finish(axes, "logs of an AUV: what its Doppler log has of its own (x right, z up)")


def training(found: Weights) -> Figure:
    """What the network learned."""
    axes = panels(1, 2, width=11.0, height=4.5)
    size = np.geomspace(0.1, 300.0, 300)
    net = found.learned.method.weight
    for i, share in enumerate((0.0, 0.5, 1.0)):
        given = jnp.asarray(size), jnp.asarray(share * size)
        weight = jax.vmap(lambda r, m: net.weight(r, m, True))(*given)
        axes[0, 0].semilogx(size, weight, label=f"learned, misfit in length {share:g} of the residual", color=f"C{i}")
    for gamma, label, style in ((2.5, HUBER, "k:"), (found.tuned.values["weight.threshold"], TUNED, "k--")):
        axes[0, 0].semilogx(size, np.minimum(1.0, gamma / size), style, label=label)
    axes[0, 0].set_xlabel("size of the residual (standard deviations of the pair)")
    axes[0, 0].set_ylabel("weight (1)")
    for i, one in enumerate((found.learned, found.tuned)):
        kind = (LEARNED, TUNED)[i]
        axes[0, 1].plot(one.history.loss, color=f"C{i}", linewidth=1.0, label=f"{kind}: runs trained on")
        axes[0, 1].plot(
            one.history.steps, one.history.held, "o", color=f"C{i}", markersize=3, label=f"{kind}: held out"
        )
    axes[0, 1].legend(fontsize="small")
    axes[0, 1].set_xlabel("step (1)")
    axes[0, 1].set_ylabel("mean of ln(heading RMSE / 1 deg)")
    return finish(axes, "dvl-sturn, 2 % of the velocities 300 times as noisy", 3)


def tried(found: Weights) -> Figure:
    """Heading RMSE of every method under every condition."""
    axes = panels(1, 2, width=12.0, height=5.5, sharey=True)
    names = list(found.errors)
    methods = list(next(iter(found.errors.values())))
    for k, label in enumerate(methods):
        rows = np.arange(len(names)) + 0.09 * (k - (len(methods) - 1) / 2)
        every = [rms(found.errors[c][label]) for c in names]
        style = {"fmt": "*" if label == LEARNED else "o", "markersize": 9 if label == LEARNED else 4, "color": f"C{k}"}
        axes[0, 0].errorbar([x.value for x in every], rows, xerr=[x.error for x in every], label=label, **style)
        middle = [float(np.median(found.errors[c][label])) for c in names]
        axes[0, 1].plot(middle, rows, style["fmt"], color=f"C{k}", markersize=style["markersize"])
    for axis, what in zip(axes[0], ("RMSE over the runs", "median of the runs' RMSE"), strict=True):
        axis.set_xscale("log")
        axis.set_xlabel(f"heading: {what} (deg)")
    axes[0, 0].set_yticks(range(len(names)), names)
    axes[0, 0].invert_yaxis()
    return finish(axes, "runs held out: heading over the last 50 s, by outliers", 4)
