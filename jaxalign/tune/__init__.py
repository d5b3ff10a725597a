"""Tuning: any number of a method, by gradient descent through simulation, alignment and score."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.tune.engine import Prepared, prepared, run
    from jaxalign.tune.losses import (
        ANGLES,
        LOSSES,
        AbstractLoss,
        Convergence,
        LogRmse,
        Misfit,
        Quantile,
        Rmse,
        RunErrors,
    )
    from jaxalign.tune.result import History, Tuned
    from jaxalign.tune.settings import Tune
    from jaxalign.tune.space import Space, space_of

__all__ = [
    "ANGLES",
    "LOSSES",
    "AbstractLoss",
    "Convergence",
    "History",
    "LogRmse",
    "Misfit",
    "Prepared",
    "Quantile",
    "Rmse",
    "RunErrors",
    "Space",
    "Tune",
    "Tuned",
    "prepared",
    "run",
    "space_of",
]

_HOMES = {
    "engine": "Prepared prepared run",
    "losses": "ANGLES LOSSES AbstractLoss Convergence LogRmse Misfit Quantile Rmse RunErrors",
    "result": "History Tuned",
    "settings": "Tune",
    "space": "Space space_of",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
