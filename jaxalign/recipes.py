"""What a recipe is: a method by name. The recipes themselves: :mod:`jaxalign.methods`, :mod:`jaxalign.published`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from jaxalign.aids import AbstractAid, Standing

__all__ = ["Contract", "Recipe", "registering"]


@dataclass(frozen=True)
class Contract:
    """What a recipe is held to by the tests of all recipes (``tests/vectors``), where it differs from the others.

    They run it on simulated logs of 300 s at 60 epochs. A new recipe starts with none of this; what it then needs is a
    property of its method, and its docstring says why.

    Attributes:
        closure_deg: how near the truth the attitude comes without noise from 150 s on, deg. None: 0.02 with a velocity
            in b (its trapezoid over 5 s), else 0.001; infinite: not on this problem.
        rounding: what the last bits do to an attitude, rad, beyond turning an eigenvector over its gap, if more than
            1e-8 between two programs, 1e-9 between two rows of one.
        mounting: change of the attitude at the end by another mounting of the unit, rad; zero: rounding, at any epoch.
        forgets: whether early fixes fade, so that one of them counts for much.
        sensitive: whether a wide first covariance, or a search, makes much of the last bits: programs that do the same
            must then be compiled alike.
        uses_latitude: whether the attitude depends on the latitude.
        smooth: path -> value by which a robust weight has no corners, for its derivatives by the data.
        velocity_steps: of central differences by the velocities of the aid, m/s: larger ones meet corners and gates of
            robust weights, smaller ones the rounding of an eigenvector.
        latitude_steps: of those by the latitude, rad.
        number_steps: of those by the tunable numbers, relative.
        slope_rounding: of a derivative by the data.
        small_gap: whether the rounding of an eigenvector shows in steps as small as these.
        free: variance of what no fix tells at first over that of a fix, by which the rounding of derivatives grows.
    """

    closure_deg: float | None = None
    rounding: float = 0.0
    mounting: float = 0.0
    forgets: bool = False
    sensitive: bool = False
    uses_latitude: bool = True
    smooth: Mapping[str, Any] = field(default_factory=dict)
    velocity_steps: tuple[float, float] = (2e-4, 5e-5)
    latitude_steps: tuple[float, float] = (5e-5, 2e-5)
    number_steps: tuple[float, float] = (1e-3, 3e-4)
    slope_rounding: float = 1e-8
    small_gap: bool = False
    free: float = 0.0


@dataclass(frozen=True)
class Recipe:
    """A method by name.

    Attributes:
        name: as in the papers' vocabulary.
        make: aid (of a method that takes several: a tuple of them) -> method.
        aids: the kinds of aid it takes, the first being the default.
        source: paper and equations.
        summary: one line for people.
        published: whether it is there only to reproduce what a paper prints.
        contract: what the tests of all recipes hold it to; None: nothing, it does not work and is there for the record.
        several: whether it takes any aids, and several at once.
    """

    name: str
    make: Callable[..., Any]
    aids: tuple[type[AbstractAid], ...]
    source: str
    summary: str
    published: bool = False
    contract: Contract | None = None
    several: bool = False

    @property
    def stands_only(self) -> bool:
        """Whether it takes no aid at all: it is for a standing vehicle."""
        return self.aids == (Standing,)

    def takes(self, aid: AbstractAid) -> bool:
        """Whether it observes such an aid."""
        return self.several or type(aid) in self.aids


_USUAL = Contract()


def registering(book: dict[str, Recipe], published: bool = False) -> Callable[..., Any]:
    """A decorator that enters functions into a book of recipes, under their own names.

    Args:
        book: name -> recipe.
        published: see :class:`Recipe`.

    Returns:
        ``recipe(*aids, source=..., contract=..., several=...)``, which decorates aid -> method. The first line of the
        docstring is the summary.
    """

    def recipe(
        *aids: type[AbstractAid], source: str, contract: Contract | None = _USUAL, several: bool = False
    ) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        def register(make: Callable[..., Any]) -> Callable[..., Any]:
            summary = (make.__doc__ or "").split("\n")[0]
            book[make.__name__] = Recipe(make.__name__, make, aids, source, summary, published, contract, several)
            return make

        return register

    return recipe
