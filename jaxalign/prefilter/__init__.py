"""Filters of whole records; they know nothing of alignment."""

from jaxalign.prefilter.vondrak import (
    Factor,
    cutoff_from_theta,
    factor,
    gain,
    smooth,
    solve,
    theta_from_cutoff,
)

__all__ = ["Factor", "cutoff_from_theta", "factor", "gain", "smooth", "solve", "theta_from_cutoff"]
