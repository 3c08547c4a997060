"""What is worked out once: properties, and what belongs to an object of another room.

`cached_property` is that of `functools` without its lock before Python 3.12. That lock is one for
all objects of a class: what one thread works out in machine code, with the interpreter's lock
released, keeps every other thread from its own. And taking it costs more than most small
properties. Two threads that ask one object at a time may both work it out, with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from operator import is_
from typing import TYPE_CHECKING, Any, Generic, TypeVar
from weakref import ref

T = TypeVar("T")

if TYPE_CHECKING:
    from functools import cached_property
else:

    class cached_property:
        """As `functools.cached_property`.

        Examples
        --------
        >>> class Square:
        ...     side = 3.0
        ...     @cached_property
        ...     def area(self):
        ...         return self.side**2
        >>> square = Square()
        >>> square.area, vars(square)
        (9.0, {'area': 9.0})
        """

        def __init__(self, make: Any) -> None:
            self.make, self.__doc__ = make, make.__doc__

        def __set_name__(self, owner: type, name: str) -> None:
            self.name = name

        def __get__(self, whole: Any, owner: type | None = None) -> Any:
            if whole is None:
                return self
            found = whole.__dict__[self.name] = self.make(whole)
            return found


def varied(whole: T, kept: frozenset[str], /, **changes: Any) -> T:
    """A frozen dataclass with other fields, and what was worked out that they do not change.

    `dataclasses.replace` forgets all that was worked out, and hands over every field on its own.

    Parameters
    ----------
    whole : dataclass
        Without checks of its own: none is made.
    kept : frozenset of str
        Properties, worked out or not, that are those of the new one.
    **changes
        Fields.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Box:
    ...     side: float
    ...     colour: str
    ...     @cached_property
    ...     def area(self):
    ...         return self.side**2
    >>> box = Box(3.0, "red")
    >>> box.area, vars(varied(box, frozenset({"area"}), colour="blue"))
    (9.0, {'side': 3.0, 'colour': 'blue', 'area': 9.0})
    """
    fields, own = type(whole).__dataclass_fields__, vars(whole)  # type: ignore[attr-defined]
    found = object.__new__(type(whole))
    same = {name: own[name] for name in own if name in fields or name in kept}
    vars(found).update(same | changes)
    return found


class Beside(Generic[T]):
    """What was worked out of an object and others: of the last one, and no longer than that lives.

    Whoever asks next of the same objects is given it. It goes into no file and to no other process.

    Parameters
    ----------
    name : str
        Under which it lies beside the attributes of the object.

    Examples
    --------
    >>> class Model: ...
    >>> roots, model, record = Beside[list[float]]("roots"), Model(), Model()
    >>> found = roots.keep([1.0], model, (record,), "free")
    >>> roots.find(model, (record,), "free") is found, roots.find(model, (model,), "free")
    (True, None)
    >>> other = roots.keep([2.0], Model(), ())
    >>> roots.find(model, (record,), "free") is None
    True
    """

    def __init__(self, name: str) -> None:
        self.name = f"_{name}_beside"
        self._owner: Callable[[], Any] = lambda: None

    def find(self, owner: object, parts: tuple[object, ...], how: Hashable = None) -> T | None:
        """What is kept of these very objects, worked out in this way."""
        kept: _Kept[T] = vars(owner).get(self.name, _NOTHING)
        same = len(kept.parts) == len(parts) and kept.how == how
        return kept.found if same and all(map(is_, kept.parts, parts)) else None

    def keep(self, found: T, owner: object, parts: tuple[object, ...], how: Hashable = None) -> T:
        """Keep something, in place of what was kept before."""
        self.drop()
        vars(owner)[self.name] = _Kept(parts, how, found)
        self._owner = ref(owner)
        return found

    def drop(self) -> None:
        """Keep nothing."""
        owner = self._owner()
        if owner is not None:
            vars(owner).pop(self.name, None)


class _Kept(Generic[T]):
    """Beside an object; a copy of it is empty."""

    def __init__(
        self, parts: tuple[object, ...] = (), how: Hashable = None, found: T | None = None
    ) -> None:
        self.parts, self.how, self.found = parts, how, found

    def __reduce__(self) -> tuple[type[_Kept[T]], tuple[()]]:
        return type(self), ()


_NOTHING: _Kept[Any] = _Kept()


__all__ = ["Beside", "cached_property", "varied"]
