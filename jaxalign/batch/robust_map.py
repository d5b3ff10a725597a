"""The robust batch estimator: the most probable attitude, first velocity and biases, with outliers among the fixes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, ClassVar, Literal, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer, eval_context
from jaxtyping import Array, Float

from jaxalign.aids import AbstractAid, BodyVelocity, Unknown, aids_of
from jaxalign.arguments import check_choice, whole_number
from jaxalign.batch.iterate import LANES, RowSolutions, solve_on_host, solve_traced
from jaxalign.batch.measurement import Unknowns, first_velocity, unknowns_of
from jaxalign.batch.problem import Model, Problem
from jaxalign.earth import Site
from jaxalign.epochs import Epoch, Epochs, row_numbers
from jaxalign.errors import UserError
from jaxalign.front_end import FrontEnd
from jaxalign.inertial_unit import PER_SAMPLE, ImuErrors, imu_errors
from jaxalign.method import AbstractMethod
from jaxalign.nav_estimate import Block, blocks_of
from jaxalign.parametrization import Numbers, optional_count, tunable, words
from jaxalign.precision import require_x64
from jaxalign.solution import Solution, assembled
from jaxalign.wgs84 import SEMI_MAJOR_AXIS, curvature

__all__ = ["FEWEST_FIXES", "RobustMap", "assembled_rows"]

FEWEST_FIXES = 3
"""That an attitude takes."""
_DEG = float(np.deg2rad(1.0))
_BLIND = 20.0 * _DEG
_MOST_ITERATIONS = 1000
_STARTS = 4


class RobustMap(AbstractMethod):
    """The most probable attitude by all fixes up to an epoch, with outliers.

    Unknown are attitude, first velocity, the biases of the inertial unit (with priors) and its white noise. The noise
    of a fix is normal, or with a small probability normal with a much larger standard deviation: each fix counts by the
    probability that it is none of those, found together with the rest (iterated reweighting). One Gauss-Newton step is
    a Kalman filter, a disturbance smoother and a pass forward over the errors of a trajectory with a state at every
    epoch. Derivatives are those of a solution that has converged.

    A standing vehicle has the velocity zero; the noise is then its disturbance, and the stated figure (of the force
    over an interval, ``Epochs.aid_sd``) the least of it.

    In its solutions ``aid_sd`` is the noise found (white noise with the same density at low frequencies), ``residual``
    the noise of the fix of that row, and ``filter.covariance`` that of the best solution, where there are several.

    Attributes:
        imu: errors of the inertial unit: the standard deviations of its biases beforehand, its white noise, and the
            random walk of its biases, which are taken as constant over an interval between epochs.
        outlier_probability: beforehand, of a fix.
        outlier_ratio: standard deviation of outliers over that of the others.
        aid_noise: standard deviation of the aid. "at_least" (default): the stated one, or that of the data where it is
            larger; "estimated": that of the data, the stated one being worth a few fixes; "stated": as it is. Data tell
            of white noise alone: where a stated figure covers slow errors too, the estimate is too small.
        calibrate: names of the unknowns of the aids that are estimated too, such as "latency" or "lever" (of every
            aid that has it), or "dvl.lever" (of the aid of that name). What there is: ``AbstractAid.unknowns``. A
            latency is resolved to a fraction of the interval between epochs.
        priors: standard deviations of the unknowns beforehand, by aid and name ("body.lever"; angles with "_deg"), and
            for a slow error the time after which it has renewed itself ("body.slow_seconds"); by default those of the
            aid's class.
        headings: how many to start from. 1: the one found without a guess. 4 for low-cost units, whose biases may hide
            the turn of the Earth: more than one heading may fit, and the covariance has them all in mind. None
            (default): 1 where an aid measures a whole velocity or the vehicle stands, else 4: a guess by a part of
            it may be far off.
        iterations: Gauss-Newton steps, at most; fewer where it has converged. Up to 1000.
        tolerance: it has converged where a step moves it by less, in standard deviations, and the noise by less of
            itself. Derivatives hold to about a hundred times as much; with a navigation aid, those of the covariance
            and of the likelihood are approximate: they leave out how the velocities that are taken for steady depend on
            the gains of the filter.
        aids: that it observes.
        front_end: makes epochs of a log.

    Source: none of the papers.
    """

    has_covariance: ClassVar[bool] = True
    rows_are_costly: ClassVar[bool] = True
    takes_components: ClassVar[bool] = True
    finds_noise: ClassVar[bool] = True
    judges_by_covariance: ClassVar[bool] = True
    needs: ClassVar[str] = "three usable fixes"
    takes_prefilter: ClassVar[bool] = False
    imu: ImuErrors = eqx.field(default_factory=partial(imu_errors, "navigation"), metadata={"hides": PER_SAMPLE})
    outlier_probability: Float[Array, ""] = tunable(0.05, unit="1", bounds=(1e-4, 0.5))
    outlier_ratio: Float[Array, ""] = tunable(30.0, unit="1", bounds=(3.0, 1e3))
    aid_noise: Literal["at_least", "estimated", "stated"] = eqx.field(static=True, default="at_least")
    calibrate: tuple[str, ...] = eqx.field(static=True, default=())
    priors: Numbers = None  # type: ignore[assignment]  # made of the aids
    headings: int | None = optional_count()
    iterations: int = eqx.field(static=True, default=12)
    tolerance: float = eqx.field(static=True, default=1e-5)
    aids: tuple[AbstractAid, ...] = eqx.field(static=True, default=(BodyVelocity(),), metadata={"given": True})
    front_end: FrontEnd = eqx.field(default_factory=FrontEnd, kw_only=True)

    def __post_init__(self):
        self.aids = aids_of(self.aids)
        named = words(self.calibrate)
        if named is None:
            raise UserError(f"calibrate = {self.calibrate!r}: must be names of unknowns, such as ('latency', 'lever')")
        self.calibrate = named
        self.priors = Numbers.of((spec for aid in self.aids for spec in _priors_of(aid)), self.priors)

    def __check_init__(self):
        self.imu.check_densities()
        check_choice("aid_noise", self.aid_noise, ("at_least", "estimated", "stated"))
        for name in ("headings", "iterations"):
            if getattr(self, name) is not None:
                whole_number(name, getattr(self, name))
        if self.iterations > _MOST_ITERATIONS:
            raise UserError(f"iterations = {self.iterations}: at most {_MOST_ITERATIONS}; 12 do for nearly all logs")
        if not 0 < self.tolerance < 1:
            raise UserError(f"tolerance = {self.tolerance}: must be above 0 and below 1")
        for aid in self.aids:
            slow = aid.known_unknowns.get("slow")
            if slow is not None and slow.size < len(aid.components):
                raise UserError(f"aid {aid.name}: slow has {slow.size} numbers for {len(aid.components)} components")
        known = [name for aid in self.aids for own in aid.unknowns for name in (own.name, f"{aid.name}.{own.name}")]
        for name in self.calibrate:
            if "+" in name:
                raise UserError(f"calibrate: {name!r}: commas are between names: write {name.replace('+', ',')}")
            if name not in known:
                there = ", ".join(dict.fromkeys(name for name in known if "." not in name)) or "nothing to calibrate"
                of = " and ".join(aid.name for aid in self.aids)
                raise UserError(f"calibrate: {name!r} is no unknown of {of}: there is {there}")

    @property
    def heading_count(self) -> int:
        """How many headings the search starts from."""
        return self.headings or (1 if any(aid.full_velocity for aid in self.aids) else _STARTS)

    @property
    def estimated(self) -> Unknowns:
        """Of each aid the names of the unknowns that are estimated."""
        return tuple(aid.estimated(self.calibrate) for aid in self.aids)

    @property
    def unknowns(self) -> dict[str, slice]:
        """Where in ``Solution.filter.calibration`` the unknowns are, by name (of several aids: aid.name)."""
        places = zip(self.aids, unknowns_of(self.aids, self.estimated), strict=True)
        if len(self.aids) == 1:
            return next(places)[1]
        return {f"{aid.name}.{name}": where for aid, own in places for name, where in own.items()}

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Of the covariance of its solutions."""
        sizes = {name: where.stop - where.start for name, where in self.unknowns.items()}
        return blocks_of(attitude=3, velocity=3, gyro_bias=3, accel_bias=3, **sizes)

    @property
    def model(self) -> Model:
        """What it knows beforehand, without what does not change a step."""
        sd, fade = [], []
        for aid, names in zip(self.aids, self.estimated, strict=True):
            for name, unknown in aid.known_unknowns.items():
                if name in names:
                    sd += [_number(self.priors[f"{aid.name}.{_key(unknown)}"]) * _unit(unknown)] * unknown.size
                    slow = unknown.seconds is not None
                    fade += [self.priors[f"{aid.name}.{name}_seconds"] if slow else jnp.inf] * unknown.size
        sd, fade, limit = _stacked(sd), _stacked(fade), np.float64(self.tolerance)
        return Model(
            self.imu,
            self.outlier_probability,
            self.outlier_ratio,
            sd,
            fade,
            limit,
            self.estimated,
            self.aid_noise,
            self.aids,
        )

    def with_imu(self, imu: ImuErrors) -> Self:
        """With these figures of the inertial unit."""
        return dataclasses.replace(self, imu=imu)

    def counted(self, solution: Solution) -> np.ndarray:
        """(K,) rows whose fix is rather none of the outliers, which keep a little weight."""
        return np.asarray(solution.defined) & (np.asarray(solution.weight) > 0.5)

    def solve(self, epochs: Epochs, rows: Any = 1, done: Callable[[int], None] | None = None) -> Solution:
        """Align epochs, each row by the fixes up to it.

        Args:
            epochs: of one log.
            rows: epochs between two rows, see :func:`jaxalign.align`, or the numbers of the epochs to read out.
            done: told how many rows are finished, now and then; not inside traced code.

        Raises:
            UserError: float32, rows that are no epochs.
        """
        require_x64(epochs)
        numbers = row_numbers(len(epochs), rows)
        if any(isinstance(x, Tracer) for x in jax.tree.leaves((self, epochs))):
            return assembled_rows(self, epochs.site, epochs.rows, numbers, _rows_of(self, epochs, numbers))
        lanes = min(LANES, 1 << (len(numbers) - 1).bit_length())
        with eval_context():  # inside traced code too, where both are constants
            found = solve_on_host(
                self.model, epochs, numbers, self.iterations, self.heading_count, lanes=lanes, done=done
            )
            return assembled_rows(self, epochs.site, epochs.rows, numbers, found)

    def solve_runs(self, epochs: Epochs, rows: Any = 1) -> Solution:
        """Align many runs side by side: leaves of ``epochs.rows`` that differ have the runs on the last axis. Pure.

        The same as ``jax.vmap`` of :meth:`solve` over that axis, faster.

        Returns:
            A solution whose leaves have the runs on a first axis.

        Raises:
            UserError: float32, rows that are no epochs, epochs of one log.
        """
        require_x64(epochs)
        if epochs.rows.dvel.x.ndim != 2:
            raise UserError("these are the epochs of one log: solve_runs takes runs on the last axis, solve one log")
        numbers = row_numbers(len(epochs), rows)
        return _runs_of(self, epochs, numbers)


def _key(unknown: Unknown) -> str:
    """The name of an unknown in files and options, where angles are in degrees."""
    return f"{unknown.name}_deg" if unknown.unit == "rad" else unknown.name


def _unit(unknown: Unknown) -> float:
    return _DEG if unknown.unit == "rad" else 1.0


def _priors_of(aid: AbstractAid) -> Iterator[tuple[str, float, str, tuple[float, float]]]:
    """Name, value, unit and bounds of what is known of its unknowns beforehand."""
    for unknown in aid.unknowns:
        unit = _unit(unknown)
        low, high = (x / unit for x in unknown.bounds)
        yield (
            f"{aid.name}.{_key(unknown)}",
            unknown.sd / unit,
            "deg" if unknown.unit == "rad" else unknown.unit,
            (low, high),
        )
        if unknown.seconds is not None:
            yield f"{aid.name}.{unknown.name}_seconds", unknown.seconds, "s", (1.0, 1e6)


def _number(x: Any) -> Any:
    """On the host without a program of its own for what is done with it."""
    return x if isinstance(x, Tracer) else np.float64(x)


def _stacked(numbers: list[Any]) -> Any:
    """(n,); on the host without a program of its own for a few numbers."""
    if any(isinstance(x, Tracer) for x in numbers):
        return jnp.stack([jnp.asarray(x, jnp.float64) for x in numbers])
    return np.array([float(x) for x in numbers], np.float64)


def _rows_of(method: RobustMap, epochs: Epochs, numbers: np.ndarray) -> RowSolutions:
    """Rows of one log as lanes, a group at a time."""
    one = jax.tree.map(lambda x: x[:, None], epochs.rows)

    def group(last: Any) -> RowSolutions:
        return solve_traced(
            method.model, Problem(one, epochs.site, epochs.sd, last), method.iterations, method.heading_count
        )

    if len(numbers) <= 2 * LANES:
        return group(jnp.asarray(numbers))
    index = np.minimum(np.arange(-(-len(numbers) // LANES) * LANES), len(numbers) - 1)
    found = jax.lax.map(group, jnp.asarray(numbers[index].reshape(-1, LANES)))
    joined = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], index.size), found)
    return jax.tree.map(lambda x: x[..., : len(numbers)], joined)


def _runs_of(method: RobustMap, epochs: Epochs, numbers: np.ndarray) -> Solution:
    """Runs as lanes, and rows beside them where there are few runs; a group at a time.

    The same row of many runs: they need about as many steps, and nothing of what comes later.
    """
    runs, count = epochs.rows.dvel.x.shape[-1], len(numbers)
    together = min(runs, LANES)
    beside = min(count, max(1, LANES // together))
    of_runs, of_rows = (
        np.minimum(np.arange(-(-n // size) * size), n - 1).reshape(-1, size)
        for n, size in ((runs, together), (count, beside))
    )

    def group(some: Any) -> RowSolutions:
        chosen, lasts = some

        def lanes(x: Any) -> Any:
            if x.ndim == 1:
                return x[:, None]
            return jnp.broadcast_to(x[:, chosen][:, :, None], (len(x), together, beside)).reshape(len(x), -1)

        problem = Problem(jax.tree.map(lanes, epochs.rows), epochs.site, epochs.sd, jnp.tile(lasts, together))
        found = solve_traced(method.model, problem, method.iterations, method.heading_count)
        return jax.tree.map(lambda x: jnp.moveaxis(x.reshape(*x.shape[:-1], together, beside), -2, 0), found)

    pairs = np.repeat(of_runs, len(of_rows), axis=0), np.tile(numbers[of_rows], (len(of_runs), 1))
    found = jax.lax.map(group, jax.tree.map(jnp.asarray, pairs))

    def by_run(x: Any) -> Any:
        """(groups, runs, ..., rows) of each to (runs, ..., rows) of all."""
        x = jnp.moveaxis(x.reshape(len(of_runs), len(of_rows), *x.shape[1:]), 1, -2)
        return x.reshape(of_runs.size, *x.shape[2:-2], of_rows.size)[:runs, ..., :count]

    rows = jax.tree.map(lambda x: x.T if x.ndim > 1 else jnp.broadcast_to(x, (runs, len(x))), epochs.rows)
    return jax.vmap(lambda rows, found: assembled_rows(method, epochs.site, rows, numbers, found))(
        rows, jax.tree.map(by_run, found)
    )


def assembled_rows(
    method: RobustMap, site: Site, rows: Epoch, numbers: np.ndarray, found: RowSolutions, figures: Any = None
) -> Solution:
    """Rows on the first axis, and what to say of each; on the host with NumPy, to compile nothing.

    Args:
        method: whose unknowns and aids they have.
        site: of the epochs.
        rows: the epochs.
        numbers: of those that are read out.
        found: their solutions.
        figures: (p, rows) that were fitted, or None.
    """
    given = rows.dt, rows.fixes, found, site
    xp = jnp if any(isinstance(x, Tracer) for x in jax.tree.leaves(given)) else np
    dt, fixes, (read, alpha, beta), site = jax.tree.map(xp.asarray, given)
    read, alpha, beta = jax.tree.map(lambda x: xp.moveaxis(x, -1, 0), (read, alpha, beta))
    finite = xp.all(xp.isfinite(read.q_nb), axis=1) & xp.all(xp.isfinite(read.tilt), axis=(1, 2))
    aided = fixes[0].valid
    for fix in fixes[1:]:
        aided = aided | fix.valid
    aids = {
        aid.name: (residual, weight, sd, fix.valid[numbers])
        for aid, fix, residual, weight, sd in zip(method.aids, fixes, read.residual, read.weight, read.sd, strict=True)
    }
    first = aids[method.aids[first_velocity(method.aids)].name]
    of_filter = {
        "gyro_bias": read.gyro,
        "accel_bias": read.accel,
        "covariance": read.covariance,
        "log_likelihood": read.log_likelihood,
        "calibration": read.unknowns if method.unknowns else None,
        "figures": None if figures is None else xp.asarray(figures).T,
    }
    return assembled(
        time=xp.cumsum(dt)[numbers],
        q_nb=read.q_nb,
        defined=xp.cumsum(aided)[numbers] >= FEWEST_FIXES,
        observable=read.tilt[:, 2, 2] < _BLIND**2,
        finite=finite,
        aided=aided[numbers],
        residual=read.residual_n0,
        weight=first[1],
        alpha=alpha,
        beta=beta,
        covariance=read.tilt,
        aid_sd=first[2],
        filter=of_filter,
        nav={
            "velocity": read.velocity,
            "position": _position(site, read.displacement, xp),
            "unknowns": read.unknowns,
            "covariance": read.covariance,
        },
        blocks=method.blocks,
        aids=aids,
        xp=xp,
        put=(lambda tree: jax.device_put(tree, _device(rows))) if xp is np else (lambda tree: tree),
    )


def _position(site: Site, way: Any, xp: Any) -> Any:
    """(K, 3) latitude, longitude (rad) and height (m) after a way (K, 3), m, n."""
    lat, lon, h = (xp.asarray(x) for x in (site.lat, site.lon, site.h))
    middle = lat + 0.5 * way[:, 1] / (SEMI_MAJOR_AXIS + h)
    meridian, prime_vertical = curvature(xp.sin(middle), xp.sqrt)
    east = way[:, 0] / ((prime_vertical + h) * xp.cos(middle))
    return xp.stack([lat + way[:, 1] / (meridian + h), lon + east, h + way[:, 2]], axis=1)


def _device(rows: Epoch) -> Any:
    """Where the epochs must stay; None: anywhere."""
    kept = [x for x in jax.tree.leaves(rows) if isinstance(x, jax.Array) and x.committed]
    return kept[0].sharding if kept else None
