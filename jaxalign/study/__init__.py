"""Monte Carlo studies: a scenario, methods and a number of runs to statistics over time, on all devices.

    result = run(Study("dvl-sturn", ["oba", "roba"], runs=1000))

Simulate, align and reduce happen on the device, block by block: of a run nine numbers are kept, of a block its sums.
The result is the same, to the last bit, for any chunk, any number of devices or processes of one kind, and after an
interruption.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.study.engine import Interrupted, run
    from jaxalign.study.result import Result
    from jaxalign.study.settings import Study
    from jaxalign.study.statistics import AXES, PERCENTILES, MethodStatistics

__all__ = ["AXES", "PERCENTILES", "Interrupted", "MethodStatistics", "Result", "Study", "run"]

_HOMES = {
    "engine": "Interrupted run",
    "result": "Result",
    "settings": "Study",
    "statistics": "AXES PERCENTILES MethodStatistics",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
