"""What a method sees of a simulated run: epochs of its length, with its aid and its filter, at either fidelity."""

from __future__ import annotations

import dataclasses
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxalign.aids import AbstractAid, Standing
from jaxalign.alignment import estimate_aid_sd
from jaxalign.epochs import Epochs
from jaxalign.errors import UserError
from jaxalign.front_end import epochs_from_arrays, is_standing
from jaxalign.method import AbstractMethod
from jaxalign.parametrization import parameters
from jaxalign.prefilter import AbstractPrefilter
from jaxalign.simulate import (
    Intervals,
    Scenario,
    Truth,
    imu_increments,
    intervals_of,
    measure_epochs,
    sample_epochs,
    truth,
)
from jaxalign.simulate.aggregate import fixes_of, observed

__all__ = ["FIDELITIES", "EpochsSpec", "Fidelity", "RunModel", "epochs_spec", "run_axes", "run_keys", "run_model"]

Fidelity = Literal["increments", "samples"]
FIDELITIES = ("increments", "samples")
_LEAST_SD = 1e-6  # m/s, of a perfect aid: methods divide by it
_WIDE_LANES = 4096  # on a GPU: 40 MB an interval
_FEW = 4  # runs that go one by one, their intervals side by side
_INTEGRATED_LANES, _FILTERED_LANES = 64, 8  # runs side by side at IMU rate: an interval of each, or all 3 MB


def run_keys(seed: PRNGKeyArray, numbers: Int[Array, " runs"]) -> PRNGKeyArray:
    """The keys of the runs with these numbers: the same for every method, chunk and device."""
    return jax.vmap(lambda i: jax.random.fold_in(seed, i))(numbers)


class EpochsSpec(eqx.Module):
    """What a method wants of a run.

    Attributes:
        aids: that it observes.
        samples: IMU samples per epoch.
        prefilter: of the force, or None.
    """

    aids: tuple[AbstractAid, ...] = eqx.field(static=True)
    samples: int = eqx.field(static=True)
    prefilter: AbstractPrefilter | None = None

    @property
    def name(self) -> str:
        """A text that is the same for methods that share their epochs."""
        numbers = self.prefilter and (type(self.prefilter).__name__, parameters(self.prefilter))
        return repr((self.aids, self.samples, numbers))


def epochs_spec(method: AbstractMethod, made: Scenario) -> EpochsSpec:
    """What a method wants of a scenario.

    Raises:
        UserError: it observes another aid, or its epochs do not fit between those of the scenario.
    """
    samples = method.front_end.interval_samples or made.epoch_samples
    chosen = tuple(aid for aid, _ in observed(made, method.aids))
    for aid in chosen:
        if not (method.takes_components or aid.full_velocity):
            raise UserError(
                f"{made.name}: {aid.name} is {aid.described}, and the method needs a whole velocity; robust_map takes "
                "what there is"
            )
    if not method.standing and made.epoch_samples % samples:
        raise UserError(
            f"front_end.interval_samples = {samples} must divide the {made.epoch_samples} IMU samples between fixes"
        )
    return EpochsSpec(chosen, samples, method.front_end.prefilter)


class RunModel(eqx.Module):
    """What the runs of a scenario have in common, for methods that want the same epochs.

    Attributes:
        scenario: what is simulated.
        exact: its truth.
        spec: what the method wants.
        intervals: the truth preintegrated for noise per interval; None: noise per IMU sample.
        sd: of each aid the noise that the methods are told.
    """

    scenario: Scenario
    exact: Truth
    spec: EpochsSpec
    intervals: Intervals | None
    sd: tuple[Float[Array, "*m"], ...]

    def epochs(self, keys: PRNGKeyArray) -> Epochs:
        """Epochs of a block of runs: the leaves that differ between them have them on the last axis. Pure."""
        if self.intervals is None:
            epochs = _sampled(self.exact, self.scenario, self.spec, keys)
        else:
            epochs = measure_epochs(self.intervals, self.scenario, keys, self.spec.aids)
        return eqx.tree_at(lambda e: e.sd, epochs, self.sd)


def run_axes(epochs: Epochs) -> Epochs:
    """The axis of the runs in each leaf, for `vmap`: the last one, or none where all have the same."""
    axes = jax.tree.map(lambda _: None, epochs)
    rows = jax.tree.map(lambda x: -1 if x.ndim > 1 else None, epochs.rows)
    return eqx.tree_at(lambda e: e.rows, axes, rows, is_leaf=lambda x: x is None)


def _sampled(exact: Truth, made: Scenario, spec: EpochsSpec, keys: PRNGKeyArray) -> Epochs:
    """A few runs at a time, whose samples fit into the cache (or, where they are filtered, into memory)."""
    whole = spec.prefilter is None and made.force is None and not made.imu_faults and spec.samples > 1
    whole = whole and len(keys) > _FEW
    wide = jax.default_backend() != "cpu"  # no cache to fit into, and each kernel has its price
    most = (
        1 if len(keys) <= _FEW else _WIDE_LANES if whole and wide else _INTEGRATED_LANES if whole else _FILTERED_LANES
    )
    lanes = max(n for n in range(1, min(most, len(keys)) + 1) if len(keys) % n == 0)
    groups = keys.reshape(-1, lanes)

    def group(keys: PRNGKeyArray) -> Epochs:
        if whole:
            return sample_epochs(exact, made, keys, spec.samples, spec.aids)
        drawn = jax.vmap(lambda key: _sampled_run(exact, made, spec, key))(keys)
        rows = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), drawn.rows)
        common = jax.tree.map(lambda x: x[0], drawn)
        return eqx.tree_at(lambda e: e.rows, common, eqx.tree_at(lambda r: r.dt, rows, common.rows.dt))

    drawn = jax.lax.map(group, groups)

    def joined(x: jax.Array) -> jax.Array:  # (groups, M + 1, lanes) -> (M + 1, runs); what is common is that of a group
        return jnp.moveaxis(x, 0, -2).reshape(x.shape[1], -1) if x.ndim > 2 else x[0]

    return jax.tree.map(joined, drawn)


def _sampled_run(exact: Truth, made: Scenario, spec: EpochsSpec, key: PRNGKeyArray) -> Epochs:
    dtheta, dvel = imu_increments(exact, made, key)
    used = made.samples // spec.samples * spec.samples
    chosen = observed(made, spec.aids)
    epochs = epochs_from_arrays(
        dtheta[:used],
        dvel[:used],
        None,
        dt=1.0 / made.imu_rate,
        every=spec.samples,
        site=made.site,
        aid=Standing(),
        prefilter=spec.prefilter,
    )
    fixes = fixes_of(exact, made, key, spec.samples, len(epochs) - 1, chosen)
    rows = dataclasses.replace(epochs.rows, fixes=fixes)
    sd = tuple(jnp.ones(()) if number < 0 else made.aids[number].sd for _, number in chosen)
    return Epochs(rows, epochs.site, sd, tuple(aid for aid, _ in chosen), epochs.filtered)


_known: list[tuple[Truth, Intervals]] = []


def _intervals(exact: Truth, samples: int) -> Intervals:
    """A truth preintegrated; the last one is kept, as the truth itself is."""
    if not (_known and _known[0][0] is exact and _known[0][1].samples == samples):
        _known[:] = [(exact, intervals_of(exact, samples))]
    return _known[0][1]


def _check_no_samples(made: Scenario, spec: EpochsSpec) -> None:
    """Refuse what noise per interval cannot show."""
    needs = (
        ("a prefilter looks at", spec.prefilter is not None),
        ("a disturbance of the base acts at", made.force is not None),
        ("faults of the inertial unit (imu_faults) act on", bool(made.imu_faults)),
    )
    for what, there in needs:
        if there:
            raise UserError(f"{what} single IMU samples: choose the fidelity 'samples' (--fidelity samples)")


_first = eqx.filter_jit(lambda model, keys: model.epochs(keys))


def run_model(
    made: Scenario, spec: EpochsSpec, seed: PRNGKeyArray, fidelity: Fidelity, exact: Truth | None = None
) -> RunModel:
    """Prepare the runs of a scenario for methods that want the same epochs.

    The noise of a standing vehicle, or of an aid without a stated one (``aid_sd`` 0), is estimated from run 0 as
    measured, as :func:`jaxalign.align` does with a log.

    Args:
        made: what to simulate.
        spec: what the method wants.
        seed: key of the study.
        fidelity: noise per "increments" of an epoch or per "samples" of the IMU.
        exact: the truth, if it is at hand.

    Raises:
        UserError: a prefilter, a disturbance of the force or faults of the inertial unit with noise per interval, or a
            static method on a vehicle that moves.
    """
    exact = truth(made) if exact is None else exact
    standing = is_standing(spec.aids)
    if standing and (speed := float(jnp.max(jnp.abs(exact.velocity_n)))) > 0.5:
        raise UserError(
            f"the method takes the vehicle as standing, but in {made.name} it moves at up to {speed:.1f} m/s"
        )
    if fidelity == "increments":
        _check_no_samples(made, spec)
    intervals = _intervals(exact, spec.samples) if fidelity == "increments" else None
    stated = tuple(None if number < 0 else made.aids[number].sd for _, number in observed(made, spec.aids))
    nominal = tuple(jnp.ones(()) if sd is None else sd for sd in stated)
    model = RunModel(made, exact, spec, intervals, nominal)
    unknown = [i for i, sd in enumerate(stated) if sd is None or not float(jnp.min(sd)) > 0]
    if not unknown:
        return model
    raw = RunModel(
        made, exact, EpochsSpec(spec.aids, spec.samples), intervals, tuple(jnp.ones_like(x) for x in nominal)
    )
    epochs = jax.tree.map(lambda x: x[..., 0] if x.ndim > 1 else x, _first(raw, run_keys(seed, jnp.zeros(1, int))))
    found = {i: jnp.asarray(max(_LEAST_SD, estimate_aid_sd(epochs, i)), jnp.float64) for i in unknown}
    return eqx.tree_at(lambda w: w.sd, model, tuple(found.get(i, x) for i, x in enumerate(nominal)))
