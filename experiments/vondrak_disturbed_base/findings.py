"""What comes out, in words around computed numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.statistics import rms
from experiments.vondrak_disturbed_base.schemes import FINES, SCHEMES
from experiments.vondrak_disturbed_base.tables import end, settling

__all__ = ["findings"]

ONE, TWO = "1: Vondrak", "2: no filter"
PUBLISHED, WRONG, RIGHT = FINES


def _worst_change(many: Any, what: str, schemes: Any = (ONE,)) -> float:
    """Largest change (percent) of the RMS against scheme 2, over conditions and schemes."""
    changes = []
    for of, _ in many.values():
        plain = rms(end(of[TWO][what])).value
        changes += [abs(rms(end(of[scheme][what])).value / plain - 1) for scheme in schemes]
    return 100 * max(changes)


def _both(of: Any, what: str) -> str:
    return f"{rms(end(of[TWO][what]))} without, {rms(end(of[ONE][what]))} with the filter"


def _searches(chosen: Any, objective: str) -> list[Any]:
    return [pair for (_, name), pair in chosen.items() if name == objective]


def _span(values: Any) -> str:
    low, high = min(values), max(values)
    return f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} to {high:.3g}"


def _smoothing(chosen: Any) -> str:
    printed, b, j = (_searches(chosen, name) for name in ("printed (27)", "reconstructed (27)", "J"))
    counts = [ga.evaluations for ga, _ in j]
    return f"""\
- The smoothing factor needs no search: theta = (2 pi 0.5 Hz)^6. (27) as printed grows without bound as everything is
  smoothed away: the genetic algorithm stops after {_span([ga.evaluations for ga, _ in printed])} evaluations at
  {_span([ga.cutoff for ga, _ in printed])} Hz, with values of {_span([ga.value for ga, _ in printed])} for a function
  that should tend to one. Turned so that it does tend to one, it chooses {_span([ga.cutoff for ga, _ in b])} Hz
  (genetic algorithm) and lets the disturbance at 1 Hz pass; whether 0.995 is reached is luck
  ({_span([ga.evaluations for ga, _ in b])} evaluations). The power J of lost signal and left disturbance has one
  minimum in all conditions: {_span([ga.cutoff for ga, _ in j])} Hz by the genetic algorithm ({_span(counts)}
  evaluations), {_span([x.cutoff for _, found in j for x in found.values()])} Hz by gradient from 0.015, 0.5 and 50 Hz
  ({_span([x.evaluations for _, found in j for x in found.values()])} evaluations, no filtering in the loop)."""


def _driven(driven: Any) -> str:
    parts = []
    for (grade, case), (mean, _) in driven.items():
        parts.append(f"{np.median(mean[0] / mean[1]):.3f} ({grade}, {case})")
    return ", ".join(parts)


def _real(segments: Any) -> str:
    if not segments:
        return ""
    length = min(length for length, _, _ in segments)

    def size(scheme: str, method: str) -> str:
        return f"{np.sqrt(np.mean(segments[length, scheme, method] ** 2)):.3f}"

    def pair(method: str) -> str:
        return f"{size(TWO, method)} without, {size(ONE, method)} with the filter"

    return f"""
- On the real vehicle, segments of {length:g} s, deg RMS: two vectors with boxcars {pair("2 vectors, T/3")}; Hann
  windows {pair("2 vectors, Hann T/3")} (samples) or {pair("the same, epochs of 0.1 s")} (epochs of 0.1 s: vibration
  leaks through a window in steps; a filter or epochs of one sample mend it); fine alignment at 1 cm/s {pair(RIGHT)},
  at 1 mm/s {pair(WRONG)}, as published at 1 mm/s
  {pair(PUBLISHED)}. TRIAD ({size(TWO, "TRIAD")} deg) is of no use there: the vehicle turns."""


def findings(many: Any, swept: Any, pairs: Any, chosen: Any, driven: Any, segments: Any) -> str:
    """All of it."""
    same = max(np.abs(end(of[ONE]["TRIAD"]) - end(of[TWO]["TRIAD"])).max() for of, _ in many.values())
    (tactical, _), (navigation, _) = swept[2, 10.0], swept[4, 10.0]
    long, short = max(pairs), min(pairs)

    def hann(length: float) -> str:
        return f"{rms(end(pairs[length][TWO]['Hann T/3']))}"

    settled = [settling(tactical[scheme][RIGHT]) for scheme in (TWO, ONE)]
    return f"""\
- "2-3 times more accurate" does not reproduce. With the disturbance as printed, Vondrak's filter changes the RMS
  heading error of the published fine alignment by at most {_worst_change(many, PUBLISHED):.2g} % (1 mm/s; any of the
  filters: at most {_worst_change(many, PUBLISHED, SCHEMES):.2g} %), with or without a disturbance. The error is what
  the gyro bias leaves
  (condition 2: {rms(many[2][1][:, None])} deg from the biases alone).
- Coarse alignment by averages cannot gain at all: the filter preserves the sums of f, t f and t^2 f exactly. TRIAD with
  and without it: at most {same:.1g} deg apart.
- The gain is real where the disturbance is large, the filter is told that it is small, and the published form takes
  the shaking for knowledge of the heading. 10 mg, tactical, 1 mm/s: {_both(tactical, PUBLISHED)} (deg); navigation
  grade: {_both(navigation, PUBLISHED)}. The form for a standing base, at the same 1 mm/s: {_both(tactical, WRONG)};
  {_both(navigation, WRONG)}. With 1 cm/s, which is what 10 mg shake the velocity by: {_both(tactical, RIGHT)};
  {_both(navigation, RIGHT)}.
- Nor does it converge sooner then: the heading stays within 0.05 deg of its end from {settled[0]:.0f} s on without and
  from {settled[1]:.0f} s on with the filter (medians, condition 2, 10 mg, 1 cm/s).
- Two vectors in inertial space are the other case: with boxcars over {long:g} s,
  {_both(pairs[long], "boxcar T/3")}; over {short:g} s, {_both(pairs[short], "boxcar T/3")} (the ends
  of a filtered record are hardly filtered). Hann windows on the raw force do better than any filter:
  {hann(long)} and {hann(short)}.
{_smoothing(chosen)}
- Half an hour of driving after it: position error with Vondrak's filter over that without, median over the runs:
  {_driven(driven)}. The paper has 0.845 (tactical) and 0.63 (navigation). Its positions of 12 and 1 m ("nm" in the
  table) after half an hour without aid are below what the gyro biases alone make of a perfect attitude here (last
  row of that table). An attitude found with the gyros' biases in it partly compensates them: the error can be smaller
  than with a perfect attitude.{_real(segments)}"""
