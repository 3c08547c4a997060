r"""Foreign text in exported code: what it may hold, whatever a name or a unit is.

The names and units of a record are checked where they come in. Here nothing is taken for granted:
a comment or a string literal must not end before its time in any of the languages. A line break
ends a comment of MATLAB and begins a line of code; in C a backslash at the end of a line joins it
with the next, ``*/`` ends a comment, and ``??/`` is a backslash. So each such character is written
by its number, ``<U+005C>``.
"""

from __future__ import annotations

import re

_NOT_FOR_C = re.compile(r"[^ -\[\]-~]")
_PAIRS_OF_C = re.compile(r"(?<=\*)(?=/)|(?<=/)(?=\*)|(?<=\?)(?=\?)")


def in_c_comment(text: str) -> str:
    r"""Text for a comment in C: ASCII, no backslash, nothing that ends a comment or is a trigraph.

    Compilers differ in how they read other characters, so none is left.

    Examples
    --------
    >>> in_c_comment("*/ int x; /*")
    '* / int x; / *'
    >>> in_c_comment("u [°\\]"), in_c_comment("???/")
    ('u [<U+00B0><U+005C>]', '? ? ?/')
    """
    return _PAIRS_OF_C.sub(" ", _NOT_FOR_C.sub(_number, text))


def in_matlab_comment(text: str) -> str:
    r"""Text for the rest of a line after ``%``: what is printable, on this one line.

    Examples
    --------
    >>> in_matlab_comment("m/s\nsystem('ls')"), in_matlab_comment("°")
    ("m/s<U+000A>system('ls')", '°')
    """
    return "".join(one if one.isprintable() else _number(one) for one in text)


def matlab_string(text: str) -> str:
    r"""A literal of MATLAB and Octave; in single quotes neither has other escapes than ``''``.

    Examples
    --------
    >>> print(matlab_string("it's"), matlab_string("a\rb"))
    'it''s' 'a<U+000D>b'
    """
    return "'" + in_matlab_comment(text).replace("'", "''") + "'"


def _number(found: str | re.Match[str]) -> str:
    return f"<U+{ord(found if isinstance(found, str) else found[0]):04X}>"
