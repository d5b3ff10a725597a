"""The search: gradient steps on one set of runs, judged on another."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.simulate import truth
from jaxalign.study.epochs_spec import RunModel, epochs_spec, run_keys, run_model
from jaxalign.study.errors import common_rows
from jaxalign.tune.losses import Misfit, RunErrors
from jaxalign.tune.objective import (
    AlignmentObjective,
    Mode,
    SpectralObjective,
    density_of,
    loss_and_slope,
    recorded,
    taken,
)
from jaxalign.tune.result import History, Tuned
from jaxalign.tune.settings import Tune

__all__ = ["Prepared", "prepared", "run"]

_GROUPS = 20


@eqx.filter_jit
def _drawn(model: RunModel, keys: jax.Array) -> Epochs:
    return model.epochs(keys)


@eqx.filter_jit
def _graded(objective: Any, free: Any, batch: Any, mode: Mode) -> tuple[Any, Any]:
    return loss_and_slope(objective, free, batch, mode)


@eqx.filter_jit
def _judged(objective: Any, free: Any, batch: Any) -> RunErrors:
    return objective.judged(objective.space.method(free), batch)


@eqx.filter_jit
def _loss(loss: Any, errors: RunErrors) -> Any:
    return loss(errors)


class _Judge:
    """The loss over the runs held out, and how much better one method is than another."""

    def __init__(self, tune: Tune, objective: Any, batch: Any):
        self.tune, self.objective, self.batch = tune, objective, batch

    def __call__(self, free: Any) -> tuple[float, np.ndarray]:
        """The loss, and those with each of the groups of runs left out (one of them: no more is known)."""
        if isinstance(self.objective, SpectralObjective):
            value = float(self.objective(free, self.batch))
            return value, np.array([value])
        errors = _judged(self.objective, free, self.batch)
        count = errors.euler.shape[0]
        groups = np.arange(count) * min(_GROUPS, count) // count
        # Equal sizes, so that one program serves: from a larger group that is left out, its last run stays.
        size = int(np.min(np.bincount(groups)))
        out = []
        for g in np.unique(groups):
            keep = np.delete(np.arange(count), np.flatnonzero(groups == g)[:size])
            less = RunErrors(errors.euler[keep], errors.phi[keep], errors.time)
            out.append(float(_loss(self.objective.loss, less)))
        return float(_loss(self.objective.loss, errors)), np.array(out)


class Prepared(NamedTuple):
    """A search before its first step.

    Attributes:
        objective: (free numbers, runs) -> loss; differentiable.
        batch: the runs to learn from.
        held_out: the runs to judge by.
    """

    objective: Any
    batch: Any
    held_out: Any


def prepared(tune: Tune) -> Prepared:
    """Simulate the runs of a search: for a look at the landscape, or a search of another kind.

    ``prepared(tune).objective(tune.space.origin, prepared(tune).batch)`` is the loss at the start; see :class:`Space`
    for the free numbers.

    Raises:
        UserError: the scenario has another aid than the method observes, or makes no such runs.
    """
    made = tune.scenario
    exact = truth(made)
    seed = jax.random.key(tune.seed)
    keys = run_keys(seed, jnp.arange(tune.runs))
    others = run_keys(jax.random.fold_in(seed, 2**31 - 1), jnp.arange(tune.held_out))
    if isinstance(tune.loss, Misfit):
        objective = SpectralObjective(tune.space, tune.loss.split, 1.0 / made.imu_rate, recorded(made))
        return Prepared(objective, density_of(exact, made, keys), density_of(exact, made, others))
    spec = epochs_spec(tune.method, made)
    where = common_rows(made, spec, tune.every, "method")
    model = run_model(made, spec, seed, tune.fidelity, exact)
    times = np.asarray(exact.t)[where.places]
    inside = (times > tune.window[0] + 1e-6) & (times <= tune.window[1] + 1e-6)
    where = where._replace(rows=where.rows[inside], places=where.places[inside])
    filtered = any(path.startswith("front_end.prefilter.") for path in tune.paths)
    interval = spec.samples / made.imu_rate
    objective = AlignmentObjective(
        tune.space, tune.loss, model if filtered else None, exact, where, jnp.asarray(times[inside]), interval
    )
    if filtered:
        return Prepared(objective, keys, others)
    return Prepared(objective, _drawn(model, keys), _drawn(model, others))


def _finite(tree: Any) -> bool:
    return all(bool(np.isfinite(x).all()) for x in jax.tree.leaves(tree))


def run(
    tune: Tune,
    optimiser: optax.GradientTransformation | None = None,
    progress: bool = False,
    warn: Callable[[str], None] = lambda line: None,
) -> Tuned:
    """Tune a method.

    Args:
        tune: what, on what, for what.
        optimiser: of the free numbers (an optax transformation); by default Adam with the rate of `tune`, falling to a
            tenth over the steps.
        progress: draw a bar (on stderr).
        warn: where lines go that the user should read.

    Returns:
        The best method over the runs held out, and how it was found; what was found until then after Ctrl-C, or
        where the loss or its gradient was no number (`stopped` says so).

    Raises:
        UserError: what :class:`Tune` raises; a loss that is no number from the start; a gradient of zero in all that
            is tuned.
    """
    from tqdm import tqdm

    objective, batch, held_out = prepared(tune)
    space, mode = tune.space, tune.chosen_mode
    judge = _Judge(tune, objective, held_out)
    if optimiser is None:
        optimiser = optax.adam(optax.cosine_decay_schedule(tune.rate, tune.steps, 0.1))
    free = space.origin
    state = optimiser.init(free)
    history, stopped = History(tune.paths), ""
    best, best_free, since, kept = np.inf, free, 0, free
    first_groups = best_groups = np.zeros(1)
    rng = np.random.default_rng(tune.seed)
    order: np.ndarray = np.zeros(0, int)
    clock = time.perf_counter()

    def look(step: int) -> bool:
        """At the runs held out; whether to go on."""
        nonlocal best, best_free, since, first_groups, best_groups
        value, groups = judge(free)
        history.held_out(step, value)
        if step == 0:
            first_groups = groups
        if value < best - 1e-6 * abs(best if np.isfinite(best) else 0.0):
            best, best_free, since, best_groups = value, free, 0, groups
        else:
            since += 1
        return not tune.patience or since < tune.patience

    def next_batch() -> Any:
        nonlocal order
        if tune.batch == tune.runs or isinstance(tune.loss, Misfit):
            return batch
        if len(order) < tune.batch:
            order = np.concatenate([order, rng.permutation(tune.runs)])
        some, order = order[: tune.batch], order[tune.batch :]
        return taken(batch, some)

    bar = tqdm(total=tune.steps, unit="step", disable=None if progress else True, leave=False)
    try:
        for step in range(tune.steps):
            value, slope = _graded(objective, free, next_batch(), mode)
            good = _finite((value, slope))
            if step == 0:
                _check_start(float(value), slope, tune)
                _said(slope, tune, warn)
            if not good:
                numbers = ", ".join(f"{path} = {x:.6g}" for path, x in space.values(free).items())
                what = "loss" if not _finite(value) else "gradient"
                stopped = f"the {what} is not finite at step {step} ({numbers}); the numbers before are kept"
                free = kept
                break
            history.step(float(value), space.values(free), slope, time.perf_counter() - clock)
            if step % tune.check == 0 and not look(step):
                stopped = f"nothing better over {since} looks at the runs held out"
                break
            kept = free
            update, state = optimiser.update(slope, state, free)
            free = eqx.apply_updates(free, update)
            bar.update(1)
            bar.set_postfix_str(f"loss {float(value):.4g}, held out {history.held[-1]:.4g}")
        else:
            look(tune.steps)
            stopped = f"after {tune.steps} steps"
    except KeyboardInterrupt:
        stopped = f"interrupted after {len(history.loss)} steps"
        if not history.held:
            raise
    bar.close()
    return Tuned(
        tune=tune,
        mode=mode,
        method=space.method(best_free),
        start=space.values(space.origin),
        values=space.values(best_free),
        history=history,
        best=best,
        gain=_difference(first_groups, best_groups),
        stopped=stopped,
        evaluations=len(history.loss) * tune.batch,
        seconds=time.perf_counter() - clock,
    )


def _difference(first: np.ndarray, best: np.ndarray) -> tuple[float, float]:
    """Jackknife over groups of runs: how much smaller the loss became, and the standard error of that."""
    change = best - first
    count = len(change)
    if count < 2:
        return float(change.mean()), float("nan")
    return float(change.mean()), float(np.sqrt((count - 1) / count * ((change - change.mean()) ** 2).sum()))


def _check_start(value: float, slope: Any, tune: Tune) -> None:
    names = ", ".join(tune.paths)
    if not np.isfinite(value):
        raise UserError(f"the loss is {value} at the start: there is nothing to begin with")
    if not _finite(slope):
        raise UserError(f"the gradient of the loss in {names} is not finite at the start: choose another start (--set)")
    if all(not np.any(x) for x in jax.tree.leaves(slope)):
        raise UserError(
            f"the loss does not change with {names} at the start (its gradient is exactly zero): choose another start "
            "(--set), another window, or what has an effect"
        )


def _said(slope: Any, tune: Tune, warn: Callable[[str], None]) -> None:
    """Which of the numbers have no effect."""
    for path in tune.paths:
        if all(not np.any(x) for x in jax.tree.leaves(slope[path])):
            warn(f"the loss does not change with {path} at the start (its gradient is exactly zero)")
