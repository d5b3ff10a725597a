"""What comes out, in words around computed numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill

import numpy as np

from experiments.tuning.searches import Searched
from experiments.tuning.trial import Tried
from jaxalign.tune import Tuned

__all__ = ["findings"]

FLAT = 0.02


def _ratio(searched: Searched) -> float:
    """Evaluations of the genetic algorithm over those of the gradient until it was as good; zero if it never was."""
    reached = searched.gradient.evaluations_to(searched.genetic.loss * (1 + 1e-4))
    return len(searched.genetic.trace) / reached


def _list(labels: Sequence[str]) -> str:
    return "; ".join(labels) if labels else "none"


def findings(
    found: Sequence[Searched],
    own: Mapping[str, Tried],
    other: Mapping[str, Tried],
    cutoffs: Mapping[tuple[int, float], Tuned],
) -> str:
    """All of it."""
    fewer = [s for s in found if _ratio(s) >= 5]
    others = [s for s in found if _ratio(s) < 5]
    not_so = [f"{s.problem.label}: {s.gradient.trace[-1]:.4g} against {s.genetic.loss:.4g} deg" for s in others]

    times = [f"{s.problem.label}: {_ratio(s):.0f} times" for s in fewer]

    def gains(tried: Mapping[str, Tried], low: float, high: float) -> list[str]:
        out = []
        for s in found:
            value, error = tried[s.problem.label].ratio["gradient"]
            if low <= value < high and (abs(value - 1) > 2 * error or (low < 1 < high)):
                out.append(f"{s.problem.label} ({value:.3f} ± {error:.3f})")
        return out

    off = [abs(tuned.values["front_end.prefilter.cutoff"] / 0.5 - 1) for tuned in cutoffs.values()]
    steps = [len(tuned.history.loss) for tuned in cutoffs.values()]
    spread = [tuned.values["front_end.prefilter.cutoff"] for tuned in cutoffs.values()]
    text = f"""\
- The gradient gets as low as the genetic algorithm ends, with at least five times fewer runs, on {len(fewer)} of
  {len(found)} problems ({_list(times)}). Not so: {_list(not_so)}.
- Where tuning pays, on new runs of the scenario tuned for (RMSE over that untuned):
  {_list(gains(own, 0.0, 1 - FLAT))}.
- Where the landscape is flat there (less than {100 * FLAT:.0f} % to gain): {_list(gains(own, 1 - FLAT, 1 + FLAT))}.
- In the other scenario, what was tuned is better by more than {100 * FLAT:.0f} % in
  {_list(gains(other, 0.0, 1 - FLAT))}; worse by more in {_list(gains(other, 1 + FLAT, np.inf))}.
- Vondrak's cut-off by the misfit J, from {min(start for _, start in cutoffs):g} and
  {max(start for _, start in cutoffs):g} Hz: {min(spread):.3f} to {max(spread):.3f} Hz, at most
  {100 * max(off):.1f} % from 0.5 Hz, in {min(steps)} to {max(steps)} steps, no run aligned."""
    bullets = text.split("\n- ")
    return "\n".join(
        fill(" ".join(x.removeprefix("- ").split()), 116, initial_indent="- ", subsequent_indent="  ") for x in bullets
    )
