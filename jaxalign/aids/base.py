"""What an aid is: what it measures of a moving vehicle, its unknowns, and how it is called.

Nothing here imports JAX: a log knows its aids, and to look at a log takes no compiler.
"""

from __future__ import annotations

import dataclasses
import enum
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from jaxalign.errors import UserError, close_names

if TYPE_CHECKING:
    from jaxalign.aids.linearized import Linearized
    from jaxalign.aids.motion import Motion

__all__ = [
    "LATENCY",
    "AbstractAid",
    "Axes",
    "Unknown",
    "aid_of",
    "aids_of",
    "check_components",
    "from_plain",
    "kind_of",
    "plain",
    "slow_error",
]


class Axes(enum.Enum):
    """The axes that a velocity is measured in."""

    BODY = "b: right, forward, up"
    NAV = "n: east, north, up"


@dataclass(frozen=True)
class Unknown:
    """A quantity of an aid that may be estimated with the attitude.

    Attributes:
        name: of it.
        size: how many numbers it is.
        sd: standard deviation of each beforehand, in its unit.
        unit: of the numbers.
        bounds: of a sensible standard deviation.
        seconds: after so long it has renewed itself (Gauss-Markov); None: it is constant.
        always: it is estimated whether asked for or not: the aid means nothing without it.
        decades: how well ``sd`` itself is known, where a method fits it to the data: one standard deviation of its
            decimal logarithm.
    """

    name: str
    size: int
    sd: float
    unit: str = "1"
    bounds: tuple[float, float] = (1e-9, 1e6)
    seconds: float | None = None
    always: bool = False
    decades: float = 0.5


LATENCY = Unknown("latency", 1, 0.1, "s", (1e-4, 5.0))
"""The values are of so long ago. The core takes care of it."""


def slow_error(size: int, sd: float, unit: str, bounds: tuple[float, float], decades: float = 0.5) -> Unknown:
    """An error of every component that fades and renews itself. The core takes care of it."""
    return Unknown("slow", size, sd, unit, bounds, seconds=300.0, decades=decades)


STATE_VECTORS = ("attitude", "velocity", "gyro_bias", "accel_bias", "position")
"""Names of the vectors of a navigation state, in the order of a covariance: no unknown of an aid is called so."""
_KINDS: dict[str, type[AbstractAid]] = {}


@dataclass(frozen=True, kw_only=True)
class AbstractAid(ABC):
    """An aid: what it measures as a function of the motion of the vehicle, and of unknowns of its own.

    A class for each kind of aid; subclasses are abstract or final, frozen dataclasses whose fields are plain values.
    An aid of one's own states ``components`` and :meth:`predict`; all else has defaults: it can be in a log, be
    simulated in a scenario, bounded, and taken by ``robust_map``. Numbers go with the data
    (:class:`jaxalign.Measurements`: values, standard deviations) or with the method (deviations of the unknowns).

    Attributes:
        name: of this aid among those of a log; by default its kind.
    """

    name: str = ""

    kind: ClassVar[str] = ""
    """How files call this class; by default the name of the class."""
    unit: ClassVar[str] = "m/s"
    """Of its values."""
    periodic: ClassVar[bool] = False
    """Its values are angles, rad: differences are within half a turn."""
    needs_north: ClassVar[bool] = True
    """Whether it must be told where east and north are; False for one that would measure the same in any level axes."""
    implied: ClassVar[bool] = False
    """Whether it is an assumption about the vehicle, whose values no log has to hold."""
    unknowns: ClassVar[tuple[Unknown, ...]] = ()
    """What may be estimated, in the order of the states; :data:`LATENCY` and :func:`slow_error` may be listed."""
    usual: ClassVar[tuple[str, ...]] = ()
    """Of the unknowns those that an automatic choice estimates."""
    zeros: ClassVar[bool] = False
    """Whether its values are zeros where a file has none."""
    most: ClassVar[float] = 1e4
    """No value is larger (unit of the values)."""

    def __init_subclass__(cls, **rest: Any) -> None:
        super().__init_subclass__(**rest)
        if "kind" not in vars(cls):
            cls.kind = cls.__name__
        if not cls.__name__.startswith("Abstract"):
            before, own = _KINDS.get(cls.kind), __name__.partition(".")[0]
            if before is not None and before.__module__.partition(".")[0] == own != cls.__module__.partition(".")[0]:
                raise UserError(
                    f"aid {cls.__name__}: kind {cls.kind!r} is that of {own}.{before.__name__}: choose another"
                )
            _KINDS[cls.kind] = cls

    def __post_init__(self):
        if not isinstance(self.name, str):
            raise UserError(f"name of an aid: {self.name!r}: a text is expected")
        if not self.name:
            object.__setattr__(self, "name", self.kind)
        if self.name == "aid":  # files of results have a key aid_sd of their own
            raise UserError("an aid cannot be called 'aid': give it another name (name=...)")
        self._check_unknowns()
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, _as_field(getattr(self, field.name)))
        try:
            hash(self)
        except TypeError:
            fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
            raise UserError(f"aid {self.kind}: its fields must be names, numbers or tuples of them: {fields}") from None

    def _check_unknowns(self) -> None:
        own = self.unknowns
        if not isinstance(own, tuple) or not all(isinstance(one, Unknown) for one in own):
            raise UserError(f"aid {self.kind}: unknowns must be a tuple of Unknown, got {own!r}")
        names = [one.name for one in own]
        for name in names:
            if name in STATE_VECTORS or names.count(name) > 1:
                why = "is a state of the vehicle" if name in STATE_VECTORS else "is there twice"
                raise UserError(f"aid {self.kind}: unknown {name!r} {why}: call it otherwise")

    @property
    @abstractmethod
    def components(self) -> tuple[str, ...]:
        """Names of its components."""

    @abstractmethod
    def predict(self, motion: Motion, unknowns: dict[str, Any]) -> Any:
        """What it should measure.

        Args:
            motion: of the vehicle; numbers or arrays of any shape.
            unknowns: those that are estimated, by name: a number, a Vec3 for three, else a tuple.

        Returns:
            A number, a Vec3, or a tuple of as many as there are components, in its unit.
        """

    def linearize(self, motion: Motion, unknowns: dict[str, Any]) -> Linearized:
        """The prediction and its slopes; by default those of :meth:`predict`, by forward mode."""
        from jaxalign.aids.linearization import forward_mode

        return forward_mode(self, motion, unknowns)

    def velocity(self, values: tuple[Any, ...]) -> tuple[Axes, tuple[Any, Any, Any]] | None:
        """The velocity that its values speak of, roughly, m/s, None for components that they do not tell; or None.

        An estimator that needs no guess begins with it. Values are numbers or arrays, NaN where they are missing.
        """
        return None

    @property
    def described(self) -> str:
        """One line for people."""
        return f"{self.kind} ({', '.join(self.components)}; {self.unit})"

    @property
    def velocity_axes(self) -> Axes | None:
        """The axes in which its values speak of the velocity; None if they do not."""
        seen = self.velocity(tuple(0.0 for _ in self.components))
        return None if seen is None else seen[0]

    @property
    def measures_velocity(self) -> bool:
        """Whether its values are parts of the velocity, m/s: then their noise says how well it is known."""
        return self.unit == AbstractAid.unit and self.velocity_axes is not None

    @property
    def full_velocity(self) -> bool:
        """Whether it measures all three components of the velocity."""
        seen = self.velocity(tuple(0.0 for _ in self.components))
        return seen is not None and all(x is not None for x in seen[1])

    def estimated(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Of its unknowns the needed, and those of some names ("lever", or "dvl.lever" for this aid alone)."""
        return tuple(
            unknown.name
            for unknown in self.unknowns
            if unknown.always or unknown.name in names or f"{self.name}.{unknown.name}" in names
        )

    @property
    def known_unknowns(self) -> dict[str, Unknown]:
        """All that may be estimated, by name, in the order of the states."""
        return {unknown.name: unknown for unknown in self.unknowns}


def aid_of(given: Any) -> AbstractAid:
    """An aid, or that of a kind, or of a description of :func:`plain`.

    Raises:
        UserError: there is no such kind.
    """
    if isinstance(given, AbstractAid):
        return given
    if isinstance(given, type) and issubclass(given, AbstractAid):
        return given()
    if isinstance(given, Mapping):
        return from_plain(given)
    return from_plain({"kind": given})


def kind_of(name: Any) -> type[AbstractAid]:
    """The class that files call so.

    Raises:
        UserError: there is none.
    """
    import jaxalign.aids  # noqa: F401  # the kinds that the library knows

    if not isinstance(name, str) or name not in _KINDS:
        near = close_names(str(name), _KINDS) or list(_KINDS)
        raise UserError(f"no aid {name!r}: did you mean {', '.join(near)}?")
    return _KINDS[name]


def _as_field(x: Any) -> Any:
    """Lists, as a file has them, are tuples, and numbers of NumPy plain ones."""
    if isinstance(x, list | tuple):
        return tuple(map(_as_field, x))
    return x.item() if hasattr(x, "item") and not getattr(x, "shape", (1,)) else x


def check_components(name: str, given: Any, known: tuple[str, ...]) -> None:
    """Some of the known ones, in their order.

    Raises:
        UserError: they are not.
    """
    if not isinstance(given, tuple | list) or not given or [x for x in known if x in given] != list(given):
        raise UserError(f"{name}: components are {given!r}: some of {', '.join(known)}, in this order")


def plain(aid: AbstractAid) -> dict[str, Any]:
    """An aid as names and plain values, for a file."""
    fields = {field.name: getattr(aid, field.name) for field in dataclasses.fields(aid)}
    return {"kind": aid.kind, **{k: list(v) if isinstance(v, tuple) else v for k, v in fields.items()}}


def from_plain(given: Any) -> AbstractAid:
    """The aid that :func:`plain` has written.

    Raises:
        UserError: it is none, or of a kind that is not known.
    """
    if not isinstance(given, Mapping) or "kind" not in given:
        raise UserError(f"{given!r} is no aid: a kind and its options are expected, such as kind = 'body'")
    kind = kind_of(given["kind"])
    options = {k: v for k, v in given.items() if k != "kind"}
    fields = {field.name: field for field in dataclasses.fields(kind)}
    for name in options:
        if name not in fields:
            raise UserError(f"aid {kind.kind}: no option {name!r}: there is {', '.join(fields)}")
    for name, field in fields.items():
        if name not in options and field.default is field.default_factory is dataclasses.MISSING:
            raise UserError(f"aid {kind.kind}: {name} is missing")
    return kind(**options)  # pyright: ignore[reportArgumentType]


def aids_of(given: Any) -> tuple[AbstractAid, ...]:
    """Aids: one of them, the kind of one, or several.

    Raises:
        UserError: there is no such kind, or two have one name.
    """
    some = given if isinstance(given, tuple | list) else (given,)
    aids = tuple(aid_of(x) for x in some)
    names = [aid.name for aid in aids]
    if twice := [name for name in names if names.count(name) > 1]:
        raise UserError(f"two aids are called {twice[0]!r}: give them names of their own (name=...)")
    return aids
