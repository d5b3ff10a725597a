"""Checks that can fail, of an answer and what it rests on; so far those of the log itself, which need no alignment.

On the host, in NumPy: nothing here imports JAX. Each file is one check and says where its limits come from.
"""

from __future__ import annotations

from jaxalign.log import Log
from jaxalign.trust.aid_values import aid_findings
from jaxalign.trust.earth_rate import earth_rate_findings
from jaxalign.trust.finding import Finding
from jaxalign.trust.held import held_findings
from jaxalign.trust.spikes import spike_findings
from jaxalign.trust.standing import Stretch, stretches
from jaxalign.trust.stuck import stuck_findings
from jaxalign.trust.turning import turning_findings

__all__ = ["Finding", "Stretch", "log_findings", "stretches"]

_CHECKS = (stuck_findings, spike_findings, held_findings, aid_findings, earth_rate_findings, turning_findings)


def log_findings(log: Log) -> tuple[Finding, ...]:
    """All findings of a log, those that an answer cannot be trusted with first; none where it is sound."""
    found = [finding for check in _CHECKS for finding in check(log)]
    return tuple(sorted(found, key=lambda finding: finding.trusted))
