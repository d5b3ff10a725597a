"""What comes out, in words around computed numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments import dvl
from experiments.monte_carlo import Errors
from experiments.statistics import mean, per_run, rms
from experiments.xu2020_rkf_dvl.pictures import Vectors
from jaxalign import align
from jaxalign.earth import EARTH_RATE, radii
from jaxalign.metrics import attitude_error_deg
from jaxalign.simulate import scenario, simulate, truth

__all__ = ["early_findings", "findings"]


def predicted_shift(name: str) -> float:
    """Yaw error (deg) of a neglected transport rate: the mean north velocity looks like a turn about east."""
    made = scenario(name)
    north = float(np.mean(truth(made).velocity_n[:, 1]))
    meridian = float(radii(made.site.lat)[0]) + float(made.site.h)
    return -float(np.rad2deg(north / (meridian * EARTH_RATE * np.cos(float(made.site.lat)))))


def noise_free_shift(name: str, choice: dvl.Choice) -> float:
    """Yaw error (deg) at the end of a run with perfect sensors."""
    log = simulate(name, 0, noise=False)
    error = attitude_error_deg(align(dvl.methods({"it": choice})["it"], log, aid_sd=0.1), log)
    assert error is not None
    return -float(error[-1, 2])  # phi is clockwise


def scatter(vectors: Vectors, good: np.ndarray) -> float:
    """Standard deviation of the vectors about the true ones (m/s, mean of the axes), outliers and first 100 s apart."""
    wrong = vectors.wrong[good & (vectors.time > 100.0)]
    return float(np.sqrt(wrong.var(axis=0).mean()))


def findings(
    found: dict[str, dict[str, Errors]],
    seen: dict[str, Vectors],
    hit: np.ndarray,
    name: str,
    methods: dict[str, dvl.Choice],
) -> str:
    """All but the early outliers."""
    clean, fixed = ({label: dvl.accuracy(e)[2] for label, e in found[c].items()} for c in ("clean", "fixed"))
    roll = dvl.accuracy(found["clean"]["rkf_oba, as published"])[1]
    both = (dvl.last(found["clean"][label])[..., 2] for label in ("oba", "oba, as published"))
    gained = mean(np.subtract(*both))
    measured, reconstructed = (scatter(seen[x], ~hit[1:]) for x in ("measured", "reconstructed"))
    free = noise_free_shift(name, methods["oba, as published"])
    return f"""\
- Fixed outliers: `oba` {fixed["oba"]} deg of yaw, `rkf_oba` {fixed["rkf_oba"]} deg, against {clean["rkf_oba"]} deg
  without outliers. This is the paper's main claim, and it holds for the filter that puts the weight into the noise of
  the measurement, with Joseph's covariance. Huber's weight on the residual, without a filter, does the same: `roba`
  {fixed["roba"]} deg.
- Without outliers the filter brings next to nothing over plain `oba`: {clean["rkf_oba"]} and {clean["oba"]} deg. The
  q-method is a least-squares fit already. What is left is the noise of the first velocity, which enters every vector;
  the fit keeps it as its constant. The paper says that the filter takes the noise out of the vectors; of the run drawn
  below, the good ones after 100 s scatter by {measured:.3f} m/s as measured, {reconstructed:.3f} m/s as reconstructed.
- The filter as printed, (33)-(39) from zero coefficients, does not work: {clean["rkf_oba, as published"]} deg of yaw
  and {roll} deg of roll without any outlier. The innovation is divided by the noise of the velocity alone, so that the
  first vectors count as outliers, while the covariance shrinks as if they had been taken whole.
- With the fitted constant left out of the vector (`zero start`), the noise of the first velocity goes with it:
  {clean["rkf_oba, zero start"]} deg without outliers, {fixed["rkf_oba, zero start"]} deg with fixed ones. More than the
  others it needs the first seconds to be good (below).
- `centred_oba` keeps the first velocity free: {clean["centred_oba"]} deg without outliers. It has no weights, and
  {fixed["centred_oba"]} deg with fixed ones.
- Neglecting the transport rate, as the paper does, shifts yaw by {free:.2f} deg with perfect sensors; the mean north
  velocity over the meridian radius and the horizontal Earth rate gives {predicted_shift(name):.2f} deg. Feeding it back
  moves the mean yaw error by {gained} deg: not by all of it, as early on the velocity is turned by a heading that is
  not known yet."""


def early_findings(groups: dict[str, dict[str, np.ndarray]], hit_share: float, runs: int, bad: float) -> str:
    """How much a few runs rule the RMSE."""
    late, early, *first = groups.values()
    count = len(early["oba"])
    lines = [
        f"Of {runs} runs with fixed outliers, {count} have one in the first seconds (their first velocity is good): "
        "the second group of the table.",
        "",
    ]
    for label in ("rkf_oba", "rkf_oba, zero start", "roba"):
        each, usual = per_run(early[label]), rms(late[label]).value
        pooled = np.sqrt(hit_share * rms(early[label]).value ** 2 + (1 - hit_share) * usual**2)
        lines.append(
            f"- `{label}`: {int((each > bad).sum())} of these {count} end above {bad:g} deg, the worst at "
            f"{each.max():.3g} deg, the median at {np.median(each):.3g} deg. RMSE over all {runs} runs {pooled:.3g} "
            f"deg, over those not hit early {usual:.3g} deg."
        )
    if first:
        median = {label: np.median(per_run(e)) for label, e in first[0].items()}
        lost = [label for label, x in median.items() if x > 3 * np.median(per_run(late[label]))]
        kept = [label for label in median if label not in lost]
        lines += [
            "",
            "The first velocity enters every vector. Where it is an outlier too, the median run is more than three "
            f"times as bad with {_listed(lost)}, and not so with {_listed(kept)}.",
        ]
    return "\n".join(lines)


def _listed(labels: list[Any]) -> str:
    return ", ".join(f"`{label}`" for label in labels) or "none"
