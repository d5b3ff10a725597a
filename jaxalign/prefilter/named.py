"""The filters by name."""

from __future__ import annotations

from jaxalign.prefilter.fir import Fir
from jaxalign.prefilter.vondrak_filter import Vondrak
from jaxalign.prefilter.wavelet import Wavelet

__all__ = ["PREFILTERS"]

PREFILTERS = {"vondrak": Vondrak, "fir": Fir, "wavelet": Wavelet}
"""The filters by name."""
