"""Properties that are worked out once, without the lock of `functools` before Python 3.12.

That lock is one for all objects of a class: what one thread works out in machine code, with the
interpreter's lock released, keeps every other thread from its own. And taking it costs more than
most small properties. Two threads that ask one object at a time may both work it out, with the same
result.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

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


__all__ = ["cached_property"]
