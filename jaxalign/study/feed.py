"""What a method sees of a simulated run: epochs of its length, with its aid and its filter, at either fidelity."""

from __future__ import annotations

import dataclasses
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxalign.alignment import estimate_aid_sd
from jaxalign.epochs import Epochs, epochs_from_arrays
from jaxalign.errors import UserError
from jaxalign.method import AbstractMethod
from jaxalign.parametrization import parameters
from jaxalign.prefilter import AbstractPrefilter
from jaxalign.simulate import Intervals, Scenario, Truth, intervals_of, measure, measure_epochs, sample_epochs, truth

__all__ = ["FIDELITIES", "Feed", "Fidelity", "World", "feed_of", "run_axes", "run_keys", "world_of"]

Fidelity = Literal["increments", "samples"]
FIDELITIES = ("increments", "samples")
_LEAST_SD = 1e-6  # m/s, of a perfect aid: methods divide by it
_WIDE_LANES = 4096  # on a GPU: 40 MB an interval
_FEW = 4  # runs that go one by one, their intervals side by side
_INTEGRATED_LANES, _FILTERED_LANES = 64, 8  # runs side by side at IMU rate: an interval of each, or all 3 MB


def run_keys(seed: PRNGKeyArray, numbers: Int[Array, " runs"]) -> PRNGKeyArray:
    """The keys of the runs with these numbers: the same for every method, chunk and device."""
    return jax.vmap(lambda i: jax.random.fold_in(seed, i))(numbers)


class Feed(eqx.Module):
    """What a method wants of a run.

    Attributes:
        aid: "static", "body" or "nav".
        samples: IMU samples per epoch.
        prefilter: of the force, or None.
    """

    aid: str = eqx.field(static=True)
    samples: int = eqx.field(static=True)
    prefilter: AbstractPrefilter | None = None

    @property
    def name(self) -> str:
        """The same for methods that share their epochs."""
        numbers = self.prefilter and (type(self.prefilter).__name__, parameters(self.prefilter))
        return repr((self.aid, self.samples, numbers))


def feed_of(method: AbstractMethod, made: Scenario) -> Feed:
    """What a method wants of a scenario.

    Raises:
        UserError: it observes another aid, or its epochs do not fit between those of the scenario.
    """
    samples = method.interval_samples or made.aid_every
    if method.aid not in ("static", made.aid):
        raise UserError(f"{made.name} has a {made.aid!r} aid, the method observes {method.aid!r}")
    if method.aid != "static" and made.aid_every % samples:
        raise UserError(f"interval_samples = {samples} must divide the {made.aid_every} IMU samples between fixes")
    return Feed(method.aid, samples, method.prefilter)


class World(eqx.Module):
    """What the runs of a scenario have in common, for one feed.

    Attributes:
        scenario: what is simulated.
        exact: its truth.
        feed: what the method wants.
        intervals: the truth preintegrated for noise per interval; None: noise per IMU sample.
        aid_sd: noise of the aid that the methods are told, m/s.
    """

    scenario: Scenario
    exact: Truth
    feed: Feed
    intervals: Intervals | None
    aid_sd: Float[Array, ""]

    def epochs(self, keys: PRNGKeyArray) -> Epochs:
        """Epochs of a block of runs: the leaves that differ between them have them on the last axis. Pure."""
        if self.intervals is None:
            epochs = _sampled(self.exact, self.scenario, self.feed, keys)
        else:
            epochs = measure_epochs(self.intervals, self.scenario, keys)
        return eqx.tree_at(lambda e: e.aid_sd, epochs, self.aid_sd)


def run_axes(epochs: Epochs) -> Epochs:
    """The axis of the runs in each leaf, for `vmap`: the last one, or none where all have the same."""
    axes = jax.tree.map(lambda _: None, epochs)
    rows = jax.tree.map(lambda x: -1 if x.ndim > 1 else None, epochs.rows)
    return eqx.tree_at(lambda e: e.rows, axes, rows, is_leaf=lambda x: x is None)


def _sampled(exact: Truth, made: Scenario, feed: Feed, keys: PRNGKeyArray) -> Epochs:
    """A few runs at a time, whose samples fit into the cache (or, where they are filtered, into memory)."""
    whole = feed.prefilter is None and made.force is None and feed.samples > 1
    whole = whole and len(keys) > _FEW
    wide = jax.default_backend() != "cpu"  # no cache to fit into, and each kernel has its price
    most = (
        1 if len(keys) <= _FEW else _WIDE_LANES if whole and wide else _INTEGRATED_LANES if whole else _FILTERED_LANES
    )
    lanes = max(n for n in range(1, min(most, len(keys)) + 1) if len(keys) % n == 0)
    groups = keys.reshape(-1, lanes)

    def group(keys: PRNGKeyArray) -> Epochs:
        if whole:
            return sample_epochs(exact, made, keys, feed.samples)
        drawn = jax.vmap(lambda key: _sampled_run(exact, made, feed, key))(keys)
        rows = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), drawn.rows)
        common = jax.tree.map(lambda x: x[0], drawn)
        return eqx.tree_at(lambda e: e.rows, common, eqx.tree_at(lambda r: r.dt, rows, common.rows.dt))

    drawn = jax.lax.map(group, groups)

    def joined(x: jax.Array) -> jax.Array:  # (groups, M + 1, lanes) -> (M + 1, runs); what is common is that of a group
        return jnp.moveaxis(x, 0, -2).reshape(x.shape[1], -1) if x.ndim > 2 else x[0]

    return jax.tree.map(joined, drawn)


def _sampled_run(exact: Truth, made: Scenario, feed: Feed, key: PRNGKeyArray) -> Epochs:
    dtheta, dvel, velocity = measure(exact, made, key)
    if feed.aid == "static":
        velocity = None
    elif made.aid_every != feed.samples:  # epochs between two fixes have no aid
        ratio = made.aid_every // feed.samples
        velocity = jnp.full((made.epochs * ratio + 1, 3), jnp.nan).at[::ratio].set(velocity)
    used = made.samples // feed.samples * feed.samples
    return epochs_from_arrays(
        dtheta[:used],
        dvel[:used],
        velocity,
        dt=1.0 / made.imu_rate,
        every=feed.samples,
        site=made.site,
        aid=feed.aid,  # pyright: ignore[reportArgumentType]
        aid_sd=made.aid_sd,  # pyright: ignore[reportArgumentType]
        prefilter=feed.prefilter,
    )


_known: list[tuple[Truth, Intervals]] = []


def _intervals(exact: Truth, samples: int) -> Intervals:
    """A truth preintegrated; the last one is kept, as the truth itself is."""
    if not (_known and _known[0][0] is exact and _known[0][1].samples == samples):
        _known[:] = [(exact, intervals_of(exact, samples))]
    return _known[0][1]


_first = eqx.filter_jit(lambda world, keys: world.epochs(keys))


def world_of(made: Scenario, feed: Feed, seed: PRNGKeyArray, fidelity: Fidelity, exact: Truth | None = None) -> World:
    """Prepare the runs of a scenario for a feed.

    The noise of a standing vehicle, or of an aid without a stated one (``aid_sd`` 0), is estimated from run 0 as
    measured, as :func:`jaxalign.align` does with a log.

    Args:
        made: what to simulate.
        feed: what the method wants.
        seed: key of the study.
        fidelity: noise per "increments" of an epoch or per "samples" of the IMU.
        exact: the truth, if it is at hand.

    Raises:
        UserError: a prefilter or a disturbance of the force with noise per interval, or a static method on a vehicle
            that moves.
    """
    exact = truth(made) if exact is None else exact
    if feed.aid == "static" and (speed := float(jnp.max(jnp.abs(exact.velocity_n)))) > 0.5:
        raise UserError(
            f"the method takes the vehicle as standing, but in {made.name} it moves at up to {speed:.1f} m/s"
        )
    if fidelity == "increments" and (feed.prefilter is not None or made.force is not None):
        what = "a prefilter looks" if feed.prefilter is not None else "a disturbance of the base acts"
        raise UserError(f"{what} at single IMU samples: choose the fidelity 'samples' (--fidelity samples)")
    if made.aid != feed.aid:  # a standing vehicle has no use for its aid
        made = dataclasses.replace(made, aid=feed.aid)
    intervals = _intervals(exact, feed.samples) if fidelity == "increments" else None
    world = World(made, exact, feed, intervals, made.aid_sd)
    if feed.aid != "static" and float(made.aid_sd) > 0:
        return world
    raw = World(made, exact, Feed(feed.aid, feed.samples), intervals, jnp.ones(()))
    epochs = jax.tree.map(lambda x: x[..., 0] if x.ndim > 1 else x, _first(raw, run_keys(seed, jnp.zeros(1, int))))
    return eqx.tree_at(lambda w: w.aid_sd, world, jnp.asarray(max(_LEAST_SD, estimate_aid_sd(epochs)), jnp.float64))
