"""Aids of any kind in scenarios, bounds and the batch estimator: those of the library, and one of the user's own."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from statistical import phi_deg

import jaxalign as ja
from examples.own_aid import AirSpeed, flight
from jaxalign.aids import Axes
from jaxalign.aids.linearization import forward_mode
from jaxalign.aids.motion import Motion
from jaxalign.batch.pool import pool_velocities
from jaxalign.epochs import Fix
from jaxalign.metrics import attitude_error_deg
from jaxalign.simulate import DeadComponent, SimulatedAid, intervals_of, measure_epochs, scenario, simulate, truth
from jaxalign.vector import Quat, Vec3

RUNS = 200


def some(size=1.0, seed=0):
    rng = np.random.default_rng(seed)
    return Vec3(*(jnp.asarray(size * rng.normal(size=3)) for _ in range(3)))


@pytest.mark.parametrize(
    ("aid", "unknowns"),
    [
        (ja.BodyVelocity(), {"scale": some(0.1, 1).x, "mounting": some(0.01, 2), "lever": some(1.0, 3)}),
        (ja.BodyVelocity(components=("forward",)), {}),
        (ja.NonHolonomic(), {"mounting": some(0.01, 4), "lever": some(1.0, 5)}),
        (ja.Standing(), {}),
        (ja.NavVelocity(components=("east", "north")), {"lever": some(0.0)}),
        (ja.Heading(), {"offset": some(1.0, 6).x}),
    ],
    ids=lambda x: getattr(x, "name", ""),
)
def test_slopes_by_hand_are_those_of_the_prediction(aid, unknowns):
    motion = Motion(Quat.exp(some(1.0, 7)), some(3.0, 8), some(0.3, 9), jnp.zeros(3))
    by_hand, by_jvp = jax.jit(lambda m, u: (aid.linearize(m, u), forward_mode(aid, m, u)))(motion, unknowns)
    zero = tuple(0.0 * row for row in by_jvp.tilt)
    for ours, theirs in ((by_hand.tilt, by_jvp.tilt), (by_hand.velocity, by_jvp.velocity)):
        for a, b in zip(zero if ours is None else ours, theirs, strict=True):
            np.testing.assert_allclose(a.array, b.array, atol=1e-12)
    for name in unknowns:
        np.testing.assert_allclose(np.array(by_hand.unknowns[name]), np.array(by_jvp.unknowns[name]), atol=1e-12)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Track(ja.AbstractAid):
    """Speed over ground, km/h, and course, rad, of a ship that does not rise."""

    kind = "track-of-test-own-aid"
    unit = "km/h, rad"
    components = ("speed", "course")

    def predict(self, motion, unknowns):
        v = motion.velocity
        return 3.6 * jnp.hypot(v.x, v.y), jnp.arctan2(v.x, v.y)

    def velocity(self, values):
        speed, course = values
        return Axes.NAV, (speed / 3.6 * jnp.sin(course), speed / 3.6 * jnp.cos(course), None)


def test_a_velocity_may_be_computed_of_the_values():
    """With another aid in the same axes, too; where one value is missing there is none."""
    yes, east = jnp.array([True, True, False]), jnp.array([3.0, 3.0, 3.0])
    track = Fix((jnp.array([36.0, 36.0, 36.0]), jnp.full(3, np.pi / 2)), yes, (yes, jnp.array([True, False, True])))
    gnss = Fix((east, 0.0 * east, 0.0 * east), yes, (yes, yes, yes))
    pool = pool_velocities((Track(), ja.NavVelocity()), (track, gnss))
    assert (pool.axes, pool.members) == (Axes.NAV, (0, 1))
    np.testing.assert_allclose(pool.velocity.x[:2], [10.0, 3.0])
    np.testing.assert_array_equal(pool.valid, [True, True, False])


@pytest.mark.slow
def test_the_noise_in_another_unit_tells_nothing_of_the_first_velocity():
    """A forward speed in km/s is as good as one in m/s, not 50 times as sure."""

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Fast(ja.AbstractAid):
        kind = "fast-of-test-own-aid"
        unit = "km/s"
        components = ("forward",)

        def predict(self, motion, unknowns):
            return (motion.velocity_b.y / 1e3,)

        def velocity(self, values):
            return Axes.BODY, (None, values[0] * 1e3, None)

    made = scenario("dvl-sturn", duration=60.0)
    sd = []
    for aid, size in ((ja.BodyVelocity(components=("forward",)), 0.05), (Fast(), 0.05e-3)):
        log = simulate(dataclasses.replace(made, aids=(SimulatedAid(aid, sd=size),)), 1)
        sd.append(float(ja.align(ja.build("robust_map", aid=aid), log, every=log.epochs).euler_sd_deg[-1, 2]))
    assert sd[1] == pytest.approx(sd[0], rel=0.1)


def test_a_prediction_of_another_size_is_told():
    class Wrong(ja.AbstractAid):
        components = ("a", "b")

        def predict(self, motion, unknowns):
            return motion.velocity

    motion = Motion(Quat.exp(some()), some(), some(), jnp.zeros(3))
    with pytest.raises(ValueError, match="Wrong: predicts 3 components, has 2"):
        forward_mode(Wrong(), motion, {})


def test_aids_by_their_names():
    """A method is built for one aid among several of a kind, and says in its solution which it was."""
    log = simulate("dvl-sturn", 1, duration=30.0)
    one, two = (dataclasses.replace(log.aids[0], aid=ja.BodyVelocity(name=name)) for name in ("dvl", "spare"))
    both = dataclasses.replace(log, aids=(one, two))
    method = ja.build("oba", two.aid)
    found = ja.align(method, both, every=30)
    assert list(found.aids) == ["spare"]
    with pytest.raises(ja.UserError, match=r"oba takes one of dvl, spare: say which \(--aid NAME"):
        ja.methods.build_for((one.aid, two.aid), "oba")
    with pytest.raises(ja.UserError, match=r"these epochs have dvl .*, the method observes spare"):
        ja.align(method, ja.epochs_from_log(both.only("dvl")))
    car = simulate("car", seed=1, duration=10.0)
    with pytest.raises(
        ja.UserError, match="odometer has forward, the method observes right, forward, up: build it for"
    ):
        ja.align(ja.build("robust_map", aid="body"), car, every=50)


def test_a_car_with_its_own_aids_and_a_part_of_a_velocity():
    """No aid tells a whole velocity: vectors have nothing to work with, the batch estimator levels the car."""
    log = simulate("car", 3, heading_sd_deg=0.5, duration=40.0)
    aids = tuple(one.aid for one in log.aids)
    method = ja.build("robust_map", aids, {"calibrate": "offset"})
    found = ja.align(dataclasses.replace(method, imu=scenario("car").imu), log, every=400)
    assert set(found.aids) == {"odometer", "non-holonomic", "heading"}
    assert found.aids["non-holonomic"].residual.shape == (2, 2)
    error, sd = attitude_error_deg(found, log)[-1], found.euler_sd_deg[-1]
    assert (np.abs(error[:2]) < 4 * sd[:2]).all()
    assert sd[:2].max() < 0.05
    assert [name for name, *_ in found.nav.blocks][4:] == ["heading.offset"]
    assert found.nav.covariance.shape == (2, 13, 13)
    with pytest.raises(ja.UserError, match="robust_map takes what there is"):
        ja.methods.build_for(aids, "oba")
    with pytest.raises(ja.UserError, match=r"has no nav .*: it has odometer"):
        ja.align(ja.build("robust_map", "nav"), log)
    with pytest.raises(ja.UserError, match=r"has no whole velocity: odometer is .* robust_map takes what there is"):
        ja.align(ja.build("oba", "body"), log)


@pytest.mark.parametrize("kind", [ja.BodyVelocity, ja.NonHolonomic])
@pytest.mark.parametrize("components", [("up", "right"), ("sideways", "up"), ()])
def test_components_are_axes_in_their_order(kind, components):
    """Else values would be taken for those of another axis."""
    with pytest.raises(ja.UserError, match="some of right, forward, up, in this order"):
        kind(components=components)


def test_an_unknown_that_is_always_there_is_zero_unless_stated():
    """A prediction counts on it."""
    assert SimulatedAid(AirSpeed(), sd=0.3).unknowns["wind"].tolist() == [0.0, 0.0]
    assert SimulatedAid(AirSpeed(), sd=0.3, unknowns={"wind": [1.0, 2.0]}).unknowns["wind"].tolist() == [1.0, 2.0]


def ends(made, method, rows, runs=RUNS):
    """Of many runs the attitude errors (runs, rows, 3), deg, their deviations, and the bound (rows, 3)."""
    exact, rows = truth(made), np.asarray(rows)
    intervals = intervals_of(exact, made.epoch_samples)
    method = dataclasses.replace(method, imu=made.imu)

    @eqx.filter_jit
    def solved(keys):
        found = method.solve_runs(measure_epochs(intervals, made, keys), rows)
        return found.q_nb, found.sd, found.filter.calibration

    q, sd, unknowns = solved(jax.random.split(jax.random.key(0), runs))
    return phi_deg(q, exact.C_nb[rows]), np.rad2deg(sd), np.asarray(ja.bound(made, exact).phi_deg)[rows], unknowns


def assert_on_the_bound(phi, sd, bound):
    """Within 10 % of it (and two standard errors), and 95 % intervals hold 90 to 99 %."""
    rms = np.sqrt(np.mean(phi**2, axis=0))
    print(np.round(rms / bound, 3), np.round(np.mean(np.abs(phi) < 1.96 * sd, axis=0), 3))
    assert (rms < bound * 1.1 * (1 + 2 / np.sqrt(2 * len(phi)))).all()
    inside = np.mean(np.abs(phi) < 1.96 * sd, axis=(0, 1))
    assert ((inside >= 0.90) & (inside <= 0.99)).all()


@pytest.mark.slow
def test_an_aid_of_ones_own_is_on_the_bound():
    made = flight()
    phi, sd, bound, _ = ends(made, ja.build("robust_map", AirSpeed()), [200, 250])
    assert_on_the_bound(phi, sd, bound)


@pytest.mark.slow
def test_a_car_without_gnss_is_on_the_bound():
    made = scenario("car", duration=150.0)
    phi, sd, bound, _ = ends(made, ja.build("robust_map", tuple(one.aid for one in made.aids)), [1000, 1500], runs=100)
    assert_on_the_bound(phi, sd, bound)


@pytest.mark.slow
@pytest.mark.parametrize("component", [0, 1])
def test_a_doppler_log_with_a_dead_axis_is_on_the_bound(component):
    """For the second half one axis of three is missing."""
    made = scenario("dvl-sturn", bias="gaussian")
    aid = dataclasses.replace(made.aids[0], faults=(DeadComponent(component, 150.0, 300.0),))
    made = dataclasses.replace(made, aids=(aid,))
    phi, sd, bound, _ = ends(made, ja.build("robust_map", "body"), [200, 250, 300])
    assert_on_the_bound(phi, sd, bound)
    whole = ja.bound(scenario("dvl-sturn", bias="gaussian"))
    assert bound[-1, 2] > 1.02 * whole.phi_deg[300, 2]


@pytest.mark.slow
def test_the_offset_of_a_heading_is_found():
    runs = 100
    made = scenario("car", heading_sd_deg=0.5, duration=150.0)
    method = ja.build("robust_map", tuple(one.aid for one in made.aids), {"calibrate": "offset"})
    phi, sd, bound, unknowns = ends(made, method, [1500], runs)
    assert_on_the_bound(phi, sd, bound)
    keys = jax.random.split(jax.random.key(0), runs)
    from jaxalign.simulate.measurement import source_keys
    from jaxalign.simulate.random import fold

    heading = made.aids[2]
    true = np.array([heading.drawn(fold(source_keys(key)[3], 2))["offset"][0] for key in keys])
    off = np.rad2deg(np.asarray(unknowns)[:, -1, 0] - true)
    print(np.std(np.rad2deg(true)), np.std(off))
    assert np.std(np.rad2deg(true)) > 2.0
    assert np.sqrt(np.mean(off**2)) < 1.1 * np.hypot(bound[0, 2], 0.5 / np.sqrt(150))  # of the unit, of the headings
