"""Filters of whole records, their spectra and what to choose them by; they know nothing of alignment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.prefilter.banded import Factor, factor, smooth, solve
    from jaxalign.prefilter.base import AbstractPrefilter
    from jaxalign.prefilter.fir import Fir
    from jaxalign.prefilter.force import filtered_force
    from jaxalign.prefilter.named import PREFILTERS
    from jaxalign.prefilter.objectives import misfit
    from jaxalign.prefilter.spectrum import multitaper
    from jaxalign.prefilter.vondrak_filter import Vondrak, cutoff_from_theta, gain, theta_from_cutoff, vondrak
    from jaxalign.prefilter.wavelet import Wavelet

__all__ = [
    "PREFILTERS",
    "AbstractPrefilter",
    "Factor",
    "Fir",
    "Vondrak",
    "Wavelet",
    "cutoff_from_theta",
    "factor",
    "filtered_force",
    "gain",
    "misfit",
    "multitaper",
    "smooth",
    "solve",
    "theta_from_cutoff",
    "vondrak",
]

_HOMES = {
    "banded": "Factor factor smooth solve",
    "base": "AbstractPrefilter",
    "fir": "Fir",
    "force": "filtered_force",
    "named": "PREFILTERS",
    "objectives": "misfit",
    "spectrum": "multitaper",
    "vondrak_filter": "Vondrak cutoff_from_theta gain theta_from_cutoff vondrak",
    "wavelet": "Wavelet",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
