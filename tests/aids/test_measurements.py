"""What an aid has measured: its checks, and how a log finds and cuts it."""

import dataclasses

import numpy as np
import pytest
from logs import fields, log_of

from jaxalign import AbstractAid, BodyVelocity, Heading, Measurements, NavVelocity, NonHolonomic, Unknown, UserError
from jaxalign.aids import aid_of, aids_of, from_plain, plain
from jaxalign.io import read, write_npz

TIME = np.arange(0.0, 20.5, 0.5)
ODOMETER = Measurements(BodyVelocity(components=("forward",), name="odometer"), TIME, np.ones(41), 0.05)
COMPASS = Measurements(Heading(), TIME + 0.123, np.linspace(3.0, 3.3, 41)[:, None], 0.01)


@pytest.fixture
def log():
    compass = dataclasses.replace(COMPASS, time=TIME[:-1] + 0.123, value=COMPASS.value[:-1])
    return log_of(**fields(aids=(ODOMETER, compass)))


BAD = {
    "short": (("body", [0, 1], np.zeros((3, 3))), "2 times and values of shape \\(3, 3\\): \\(2, 3\\) is expected"),
    "back": (("body", [0, 1, 1], np.zeros((3, 3))), "must be finite and increase"),
    "infinite": (("nav", [0, 1], [[0, 0, 0], [0, np.inf, 0]]), "nav is infinite at 1 s: use NaN"),
    "absurd": (("nav", [0, 1], [[0, 0, 0], [0, 2e4, 0]]), "nav is 2e\\+04 m/s at 1 s"),
    "degrees": (("heading", [0, 1], [10.0, 350.0]), "heading is 350 rad at 1 s"),
    "nothing": (("body", [0, 1], np.full((2, 3), np.nan)), "all 2 values of body are missing"),
    "unknown": (("gps", [0, 1], np.zeros((2, 3))), "no aid 'gps': did you mean"),
    "assumed": (("static", [0, 1], np.zeros((2, 3))), "has no values"),
    "text": (("body", [0, 1], [["a"] * 3] * 2), "value must be an array of numbers"),
    "no deviation": (("body", [0, 1], np.zeros((2, 3)), 0.0), "standard deviation \\(m/s\\) must be positive"),
    "two deviations": (("body", [0, 1], np.zeros((2, 3)), [1.0, 2.0]), "one number, or one for each component"),
}


@pytest.mark.parametrize("case", BAD)
def test_each_bad_value_has_its_message(case):
    given, message = BAD[case]
    with pytest.raises(UserError, match=message):
        Measurements(*given)


def test_a_log_finds_its_aids(log):
    assert log.measured("odometer") is ODOMETER
    assert log.measured(BodyVelocity()) is ODOMETER  # the only one of its class
    assert log.measured(NavVelocity()) is None
    assert log.velocity_aid is None
    assert log.only("heading").aids[0].name == "heading"
    with pytest.raises(UserError, match="has no aid 'dvl': it has odometer, heading"):
        log.only("dvl")
    second = dataclasses.replace(ODOMETER, aid=dataclasses.replace(ODOMETER.aid, name="second"))
    with pytest.raises(UserError, match="has odometer and second, all body: say which"):
        log.with_aid(second).measured(BodyVelocity())
    with pytest.raises(UserError, match="two aids are called 'odometer'"):
        dataclasses.replace(log, aids=(*log.aids, ODOMETER))


def test_a_part_keeps_the_values_of_its_time(log):
    part = log.crop(4, 9)
    for whole, cut in zip(log.aids, part.aids, strict=True):
        inside = (whole.time >= 4 - 1e-9) & (whole.time <= 9 + 1e-9)
        np.testing.assert_allclose(cut.time, whole.time[inside] - 4, atol=1e-9)
        np.testing.assert_array_equal(cut.value, whole.value[inside])
    gone = dataclasses.replace(ODOMETER, value=np.where(TIME[:, None] < 10, np.nan, 1.0))
    with pytest.raises(UserError, match="all values of odometer are missing from 1 to 8 s"):
        log.with_aid(gone).crop(1, 8)


def test_a_file_keeps_several_aids(log, tmp_path):
    both = log.with_aid(Measurements(NonHolonomic(), TIME, np.zeros((41, 2)), [0.1, 0.2]))
    write_npz(both, tmp_path / "car.npz")
    again = read(tmp_path / "car.npz")
    for one, other in zip(both.aids, again.aids, strict=True):
        assert one.aid == other.aid
        np.testing.assert_array_equal(one.time, other.time)
        np.testing.assert_array_equal(one.value, other.value)
        np.testing.assert_array_equal(one.sd, other.sd)
    with pytest.raises(UserError, match="aid_sd is one number, but there are odometer and heading"):
        read(tmp_path / "car.npz", aid_sd=0.1)


def test_aids_by_name_and_in_files():
    aids = aids_of((BodyVelocity(components=("forward",), name="odometer"), "heading", NonHolonomic))
    assert [from_plain(plain(aid)) for aid in aids] == list(aids)
    assert aid_of("nav") == NavVelocity()
    with pytest.raises(UserError, match="two aids are called 'body'"):
        aids_of(("body", "body"))
    with pytest.raises(UserError, match="no option 'axes'"):
        from_plain({"kind": "body", "axes": 2})
    with pytest.raises(UserError, match="some of right, forward, up, in this order"):
        BodyVelocity(components=("up", "right"))


def aid_with(unknowns):
    """A class of one's own with some unknowns."""

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Own(AbstractAid):
        components = ("one",)

        def predict(self, motion, unknowns):
            return motion.velocity.x

    Own.unknowns = unknowns
    return Own


@pytest.mark.parametrize(
    ("unknowns", "says"),
    [
        ((Unknown("velocity", 1, 1.0),), "'velocity' is a state of the vehicle"),
        ((Unknown("wind", 1, 1.0), Unknown("wind", 1, 1.0)), "'wind' is there twice"),
        (("wind",), "must be a tuple of Unknown"),
        (Unknown("wind", 1, 1.0), "must be a tuple of Unknown"),
    ],
)
def test_unknowns_of_ones_own(unknowns, says):
    with pytest.raises(UserError, match=says):
        aid_with(unknowns)()


def test_a_kind_of_the_library_is_not_taken_over():
    with pytest.raises(UserError, match=r"kind 'heading' is that of jaxalign.Heading"):
        type("Compass", (AbstractAid,), {"kind": "heading"})
    assert type(aid_of("heading")) is Heading


def test_names_and_fields_of_aids():
    with pytest.raises(UserError, match="cannot be called 'aid'"):
        BodyVelocity(name="aid")
    assert type(aid_with((Unknown("wind", 1, np.float64(2.0)),))().name) is str
