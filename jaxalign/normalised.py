"""Fields of a dataclass that take more than they hold: each stands once, with its default."""

from __future__ import annotations

from typing import Any, Generic, TypeVar, overload

__all__ = ["Normalised"]

Taken = TypeVar("Taken")
Held = TypeVar("Held")
_NONE = object()


class Normalised(Generic[Taken, Held]):
    """A field that is given as one type and read as another; ``__post_init__`` turns the one into the other.

    ``every: Normalised[int | None, int] = Normalised(None)`` takes None, its default, and is a number once
    ``__post_init__`` has put one in its place (by ``object.__setattr__`` where the class is frozen).

    Args:
        default: taken where none is given; without it the field must be given.
    """

    def __init__(self, default: Any = _NONE):
        self.default = default
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> Taken: ...
    @overload
    def __get__(self, instance: Any, owner: type) -> Held: ...
    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is not None:
            return instance.__dict__[self.name]
        if self.default is _NONE:
            raise AttributeError(f"{owner.__name__}.{self.name} has no default")
        return self.default

    def __set__(self, instance: Any, value: Taken) -> None:
        instance.__dict__[self.name] = value
