"""What comes out, in words around computed numbers."""

from __future__ import annotations

import numpy as np

from experiments import dvl
from experiments.monte_carlo import Errors
from experiments.statistics import compared, few_runs, rms

__all__ = ["findings"]

Numbers = tuple[float, float, float]
Paper = dict[str, dict[str, Numbers]]


def _heading(of: dict[str, Errors]) -> dict[str, np.ndarray]:
    return {label: dvl.last(errors)[..., 2] for label, errors in of.items()}


def _agreement(found: dict[str, dict[str, np.ndarray]], paper: Paper, few: int) -> str:
    """Which of the paper's headings so few runs of ours may give."""
    inside, outside = [], []
    for simulation, rows in paper.items():
        for label, numbers in rows.items():
            low, high = few_runs(found["clean"]["oba"] if label == "OBAr" else found[simulation][label], few)
            name = label if label == "OBAr" else label.upper()
            (inside if low <= numbers[2] <= high else outside).append(f"{name} {simulation}")
    return (
        f"- As published, {few} of our runs give with 95 % probability a heading like the paper's for: "
        f"{', '.join(inside) or 'none'}. They do not for: {', '.join(outside) or 'none'}. "
        "An agreement of MOBA alone says little: look at its gain over OBA, next."
    )


def _ranking(simulation: str, clean: np.ndarray, here: dict[str, np.ndarray], paper: dict[str, Numbers]) -> str:
    """The order of the methods over the same runs, and what moba gains."""
    oba, roba, moba = (paper[label][2] for label in ("oba", "roba", "moba"))
    square = [rms(x).value ** 2 for x in (here["oba"], here["moba"], clean)]
    gain, removed = (square[0] / square[1]) ** 0.5, 100 * (square[0] - square[1]) / (square[0] - square[2])
    order = ", ".join(f"{compared(here['moba'], here[x])} `{x}`" for x in ("oba", "roba", "roba, norm"))
    numbers = ", ".join(f"`{x}` {rms(here[x])}" for x in ("oba", "roba", "roba, norm", "moba"))
    return (
        f"- {simulation}: the paper has OBA {oba:g}, ROBA {roba:g}, MOBA {moba:g} deg. Here, as published: {numbers} "
        f"deg. Over the same runs the RMSE of `moba` is {order} (equal: within twice the standard error). It gains a "
        f"factor of {gain:.2g} over `oba`, in the paper {oba / moba:.2g}; it takes away {removed:.0f} % of what the "
        "outliers add to the mean square of `oba`."
    )


def findings(found: dict[str, dict[str, dict[str, Errors]]], single: dict[str, Errors], paper: Paper, few: int) -> str:
    """What reproduces and what does not."""
    published, fed = ({c: _heading(of) for c, of in found[v].items()} for v in ("neglected", "fed back"))
    inliers, window = "moba, inliers, 60 s window", "oba, 60 s window"
    ratio = rms(published["Sim1"]["oba"]).value / rms(published["Sim2"]["oba"]).value
    ratio_paper = paper["Sim1"]["oba"][2] / paper["Sim2"]["oba"][2]
    alone = _heading(single)
    rest = f"""\
- `oba` in Sim1 over Sim2: {ratio:.2f} here, {ratio_paper:.2f} in the paper. Table 3 has fewer or smaller outliers than
  Sim1 in all but its last minute, so that a ratio of one is not to be expected.
- The transport rate: `oba` without outliers has {rms(published["clean"]["oba"])} deg where it is neglected and
  {rms(fed["clean"]["oba"])} deg where it is fed back. `centred_oba`, which keeps the first velocity free but has no
  weights: {rms(fed["clean"]["centred_oba"])} deg without outliers, {rms(fed["Sim1"]["centred_oba"])} deg in Sim1.
- `roba` has {rms(fed["clean"]["roba"])} deg without outliers, {compared(fed["clean"]["roba"], fed["clean"]["oba"])}
  `oba` with {rms(fed["clean"]["oba"])} deg. The accelerometer bias grows along the vectors (100 ug are 0.3 m/s after
  300 s) past the threshold of Huber's weight, which the noise of the velocity alone sets: the last picture.
- What `moba` leaves: mean and deviation of the distances hold the outliers too, (14) and (15), so that large ones mask
  smaller ones. With the statistics of the inliers alone and a window of 60 s it has
  {rms(fed["Sim1"][inliers])} deg in Sim1 and {rms(fed["Sim2"][inliers])} deg in Sim2, {rms(fed["clean"][inliers])} deg
  without outliers (transport rate fed back). Part of that is the window, which spreads the noise of the first velocity:
  `oba` with it has {rms(fed["clean"][window])} deg without outliers, but {rms(fed["Sim1"][window])} deg in Sim1.
- The distance sees the length of a vector, which is nearly vertical. With each outlier on one axis only, `moba` has
  {rms(alone["moba"])} deg, {compared(alone["moba"], alone["oba"])} `oba` with {rms(alone["oba"])} deg (equal: within
  twice the standard error); `roba, norm`, which sees the same, {rms(alone["roba, norm"])} deg, and `roba`, which sees
  all directions, {rms(alone["roba"])} deg."""
    ranking = [_ranking(s, published["clean"]["oba"], published[s], rows) for s, rows in paper.items()]
    return "\n".join([_agreement(published, paper, few), *ranking, rest])
