"""What comes out, in words around computed numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.embedding.doppler import DOPPLER, INJECTED, LABELS, SD, UNITS, LogRun, Simulated
from experiments.embedding.outliers import HUBER, LEARNED, OTHER, OTHER_BAD, SMALL, TRAINED, Weights
from experiments.statistics import compared, mean, rms
from jaxalign.tables import Estimate

__all__ = ["on_logs", "on_simulations", "on_weights"]

TURNS_DEG = 360.0  # a log that turns less says little
WORSE_DEG = 0.02
BEYOND_DEG = 1.0
FAR = 20.0  # standard deviations


def _scaled(errors: np.ndarray, sd: np.ndarray) -> list[Estimate]:
    """RMS of errors over stated standard deviations, by unknown."""
    return [rms((errors / sd[:, :DOPPLER])[:, i : i + 1]) for i in range(DOPPLER)]


def _observable(found: Mapping[str, Simulated]) -> str:
    honest, left = [], []
    for name, one in found.items():
        z = [x.value for x in _scaled(one.found.values[:, :DOPPLER] - one.truth, one.found.sd)]
        honest.append(f"{min(z):.2f} to {max(z):.2f} on `{name}`")
        share = 100 * np.median(one.found.sd[:, :DOPPLER], axis=0) / SD
        left.append(f"`{name}` {' / '.join(f'{x:.0f}' for x in share[:4])} %")
    return f"""\
- Stated against true: the RMS of error over standard deviation (1: they hold), unknown by unknown, is
  {", ".join(honest)}.
- What is observable depends on the manoeuvres: the first velocity is free, and an error of the velocity that is
  constant in b0 hides in it. Of the standard deviation beforehand there is left, scale / mounting about x / y / z:
  {", ".join(left)}. S-turns at constant speed say next to nothing on the pitch of the mounting (x); changes of speed
  do. The roll of the mounting (y) is about the direction of travel: the velocity does not feel it in either."""


def _worth(slopes: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> str:
    parts = [f"{x[-1, 0]:+.3f} and {x[-1, 3]:+.3f} deg (`{name}`)" for name, (_, x) in slopes.items()]
    return f"""\
- What a calibration can be worth: by the derivative of `align` without noise, 1 % of scale and 1 deg of mounting about
  z change the heading of `centred_oba` at the end of the run by {", ".join(parts)}. After whole periods of S-turns the
  effects cancel, after single turns they do not (second picture)."""


def _heading(name: str, one: Simulated) -> str:
    perfect, raw, alone, inertial, both = (one.heading[label] for label in LABELS)
    return f"""\
- Heading on `{name}`: {rms(perfect)} deg with a perfect Doppler log, {rms(raw)} deg with its errors; calibrated
  {rms(both)} deg, {compared(both, raw)} the second and {compared(both, perfect)} the first (equal: within twice the
  standard error). With the errors of the Doppler log alone among the unknowns {rms(alone)} deg, with those of the
  inertial unit alone {rms(inertial)} deg."""


def _pitfalls(found: Mapping[str, Simulated]) -> str:
    names, alone, naive = list(found), [], []
    for name, one in found.items():
        z = _scaled(one.alone.values[:, :DOPPLER] - one.truth, one.alone.sd)
        alone.append(f"{z[0]}, {z[1]} and {z[3]} on `{name}`")
        wrong, right = (mean((f.values[:, :1] - one.truth[:, :1]) / UNITS[0]) for f in (one.naive, one.found))
        naive.append(f"{wrong} % instead of {right} % on `{names[len(naive)]}`")
    return f"""\
- Whether the biases of the inertial unit may be left out depends on how much the rest is known: with the unit taken as
  perfect, the RMS of error over standard deviation is, for scale and mounting about x and z, {"; ".join(alone)}.
- The residuals must be turned into the axes and the scale of the Doppler log. Left in the vehicle's axes, the scale
  sought multiplies the noise too, and the sum of squares gets small by making the velocity small. Mean error of the
  scale: {", ".join(naive)}."""


def on_simulations(found: Mapping[str, Simulated], slopes: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> str:
    """Estimates, what is observable, heading."""
    headings = [_heading(name, one) for name, one in found.items()]
    return "\n".join([_observable(found), _worth(slopes), *headings, _pitfalls(found)])


def _straight(found: Sequence[LogRun]) -> str:
    if not found:
        return ""
    least = min(float(x.sd[3]) for x in found) / UNITS[3]
    return f"\n- The other {len(found)} logs say so themselves: they state {least:.2f} deg or more for the mounting z."


def on_logs(found: Sequence[LogRun]) -> str:
    """Agreement between logs, with the reference, and heading."""
    curved = [x for x in found if x.turned > TURNS_DEG]
    straight = [x for x in found if x.turned <= TURNS_DEG]
    own = np.array([x.values - INJECTED for x in curved]) / UNITS
    off = np.array([x.values - x.reference for x in curved])
    sd = np.array([x.sd for x in curved])
    names = {0: "scale, %", 1: "mounting x, deg", 2: "y", 3: "z", 6: "lever arm z, m"}
    middle, spread, stated = own.mean(axis=0), own.std(axis=0, ddof=1), np.median(sd, axis=0) / UNITS
    text = "; ".join(f"{n} {middle[i]:+.2f} ({spread[i]:.2f}, {stated[i]:.2f})" for i, n in names.items())
    mean_off, z = (off / UNITS).mean(axis=0), np.sqrt(np.mean((off / sd) ** 2, axis=0))
    square = {k: float(np.sqrt(np.mean([x.heading[k] ** 2 for x in found]))) for k in found[0].heading}
    worse = [x.name for x in found if abs(x.heading["calibrated"]) > abs(x.heading["as it was"]) + WORSE_DEG]
    return f"""\
- What the Doppler log has of its own, by the {len(curved)} logs with more than {TURNS_DEG:g} deg of turns: mean of
  found minus put in, in brackets the standard deviation between these logs and the median of the stated one: {text}.
- Against the fit to the velocity of the reference, the same logs are off by {mean_off[0]:+.2f} % in scale and
  {mean_off[3]:+.2f} deg about z in the mean, {z[0]:.1f} and {z[3]:.1f} stated standard deviations (RMS). The fit has
  errors of its own; but a delay of the Doppler log, or scale errors of the inertial unit, are among no unknowns either.
  What is stated is how well a log determines the numbers of this model, not how true the model is.{_straight(straight)}
- Heading at the end, RMS over the {len(found)} logs:
  {", ".join(f"{x:.2f} deg {k}" for k, x in square.items())}. The size of the error is larger than that of the log as it
  was (by more than {WORSE_DEG:g} deg) in {len(worse)} of them: {_listed(worse)}. Of so few logs, with little to gain,
  no more can be said."""


def on_weights(found: Weights) -> str:
    """Where the network wins, and where it does not."""
    huber: dict[str, list[str]] = {"below": [], "equal to": [], "above": []}
    best: dict[str, list[str]] = {"below": [], "equal to": [], "above": []}
    others = {condition: errors for condition, errors in found.errors.items() if condition != TRAINED}
    for condition, errors in others.items():
        huber[compared(errors[LEARNED], errors[HUBER])].append(condition)
        other = min((x for x in errors if x != LEARNED), key=lambda x, errors=errors: rms(errors[x]).value)
        best[compared(errors[LEARNED], errors[other])].append(f"{condition} (`{other}`)")
    home, learned, tuned = found.errors[TRAINED], found.learned, found.tuned
    first = next(errors for condition, errors in others.items() if "first velocity" in condition)
    lost, middle = (
        [f(home[x]) for x in (HUBER, LEARNED)] for f in (lambda e: 100 * np.mean(e > BEYOND_DEG), np.median)
    )
    small = found.errors[SMALL]
    blind, seeing = (float(learned.method.weight.weight(FAR, part * FAR, True)) for part in (0.0, 1.0))
    text = f"""\
- {len(learned.history.loss)} steps of gradient descent through the recursion bring the network's loss over runs held
  out from {learned.history.held[0]:.2f} to {learned.best:.2f} (mean of ln of a run's heading RMSE in deg). Tuning
  Huber's threshold in the same way, from {tuned.start["weight.threshold"]:.2f}, {_tuned(found)}.
- On the outliers that it was trained on, in other runs: {", ".join(f"`{x}` {rms(home[x])}" for x in home)} deg.
- On the {len(others)} conditions that it was not trained on, the RMSE with the network against that with Huber's weight
  in the same alignment is below for: {_listed(huber["below"])}; equal (within twice the standard error) for:
  {_listed(huber["equal to"])}; above for: {_listed(huber["above"])}.
- Against the best of all other methods (in brackets) it is below for: {_listed(best["below"])}; equal for:
  {_listed(best["equal to"])}; above for: {_listed(best["above"])}.
- On the outliers trained on, {lost[0]:.3g} % of the runs end beyond {BEYOND_DEG:g} deg with Huber's weight and
  {lost[1]:.3g} % with the network; the medians are {middle[0]:.3f} and {middle[1]:.3f} deg. The few runs that are lost
  make the RMSE. With Huber's weight the pull of an outlier does not fall with its size; the network lets go of it.
- Its inputs are sizes. To a residual of {FAR:g} standard deviations it gives the weight {seeing:.2g} where the lengths
  of the vectors misfit by as much, as with outliers on all axes, but {blind:.2g} where they agree, as with outliers
  across the vectors. Small outliers ({SMALL}): {rms(small[LEARNED])} deg, with Huber's weight {rms(small[HUBER])} deg.
- Where the first velocity can be an outlier, which stands in every vector: {rms(first[LEARNED])} deg with the network,
  {rms(first[HUBER])} deg with Huber's weight. The medians of the runs, most of which begin well, are
  {np.median(first[LEARNED]):.3f} and {np.median(first[HUBER]):.3f} deg."""
    if OTHER not in found.errors:
        return text
    clean, bad = found.errors[OTHER], found.errors[OTHER_BAD]
    return f"""\
{text}
- On `{OTHER}`, another trajectory, unit and Doppler log: {rms(clean[LEARNED])} deg without outliers,
  {rms(bad[LEARNED])} deg with them; with Huber's weight {rms(clean[HUBER])} and {rms(bad[HUBER])} deg; without weights
  {rms(clean["centred_oba"])} and {rms(bad["centred_oba"])} deg."""


def _tuned(found: Weights) -> str:
    """What tuning did."""
    tuned = found.tuned
    if tuned.best >= tuned.history.held[0]:
        return f"finds nothing better than the start ({tuned.best:.2f})"
    return f"brings {tuned.history.held[0]:.2f} to {tuned.best:.2f}, at {tuned.values['weight.threshold']:.2f}"


def _listed(names: Sequence[str]) -> str:
    return "; ".join(names) or "none"
