"""A file in TOML -> a declared study, or one line on what is wrong with it.

Files of studies that come with the package.
"""

from __future__ import annotations

import os
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tridentify.errors import OptionError, UnreadableFileError, shown
from tridentify.studies.declared import draw, nouns
from tridentify.studies.declared.methods import KINDS, checked_for, options_of

DRAWS = 200
"""Where a file does not say how many."""
MOST_DRAWS = 100_000
"""Far beyond what a statistic of an estimator needs; more is a slip."""
MOST_SEED = 2**63
"""Seeds are stored as signed numbers of 64 bits."""
MOST_SAMPLES = 1_000_000
"""Of a simulated record, which every draw holds in memory."""
MOST_DEGREES = 20
"""Poles of a simulated system: beyond, the coefficients do not hold their roots in double
precision."""
MEASURES = ("std", "ratio", "snr")
PARTS = ("systems", "inputs", "noises", "methods")
STRUCTURE = nouns.Offered(("offset", "drift", "initial_state"))
LARGEST_FILE = 1_000_000
"""Bytes: ten thousand times a study; whoever has more has another file."""


@dataclass
class _Section:
    """A table of the file, from which everything is taken once; what is left is unknown."""

    where: str
    left: dict[str, Any]
    known: list[str] = field(default_factory=list)

    def take(self, key: str, check: Callable[[object], Any], expected: str, *default: Any) -> Any:
        """The value of a key, checked; a missing one is refused if there is no default."""
        self.known.append(key)
        if key not in self.left:
            if default:
                return default[0]
            raise OptionError(
                f"{self.where}: found no {key}; expected {expected}; add it to the file"
            )
        value = self.left.pop(key)
        try:
            return check(value)
        except (TypeError, ValueError, OverflowError):
            raise OptionError(
                f"{self.where}: found {key} = {shown(value)}; expected {expected}; correct it"
            ) from None

    def rest(self, offered: nouns.Offered) -> nouns.Options:
        """Options whose values another place checks, hashable."""
        self.known += offered.names
        missing = [name for name in offered.needed if name not in self.left]
        if missing:
            raise OptionError(
                f"{self.where}: found no {missing[0]}; expected one, as this kind cannot do "
                "without it; add it to the file"
            )
        return tuple((n, _frozen(self.left.pop(n))) for n in offered.names if n in self.left)

    def finish(self) -> None:
        """Refuse what nobody has asked for."""
        if self.left:
            raise OptionError(
                f"{self.where}: found the unknown key {shown(next(iter(self.left)))}; expected one "
                f"of {', '.join(sorted(self.known))}; correct or remove it"
            )


def read_study(path: str | os.PathLike[str]) -> nouns.DeclaredStudy:
    """Read a study from a TOML file.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    DeclaredStudy

    Raises
    ------
    UnreadableFileError
        The file is missing, too large or no TOML.
    OptionError
        It does not declare a study.

    Examples
    --------
    >>> from tridentify.studies import shipped_study
    >>> read_study(shipped_study("aircraft")).draws
    200
    """
    place = Path(path)
    try:
        with open(place, "rb") as stream:
            raw = stream.read(LARGEST_FILE + 1)
        if len(raw) > LARGEST_FILE:
            raise OSError(f"more than {LARGEST_FILE} bytes")
        document = tomllib.loads(raw.decode("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise UnreadableFileError(
            f"found no study in {shown(str(path), 80)} ({reason}); expected a TOML file; "
            "correct or choose another"
        ) from error
    return study_from(document, place.stem)


def study_from(document: Mapping[str, Any], name: str = "study") -> nouns.DeclaredStudy:
    """Make a study of what a file says.

    Parameters
    ----------
    document : mapping
        As `tomllib` gives it.
    name : str
        Where the document has none.

    Returns
    -------
    DeclaredStudy

    Raises
    ------
    OptionError
        An unknown key, a wrong type, an unknown kind, a cell that cannot be simulated.
    """
    top = _Section("the study", dict(document))
    name = top.take("name", _name, "a short text of one line", name)
    description = top.take("description", _text, "a text", "")
    draws = top.take("draws", _count(1, MOST_DRAWS), "a whole number from 1", DRAWS)
    seed = top.take("seed", _count(0, MOST_SEED), "a whole number from 0", 0)
    systems = tuple(map(_system, _sections(top, "systems")))
    inputs = tuple(map(_input, _sections(top, "inputs")))
    families = {_named(section): _noises(section) for section in _sections(top, "noises")}
    methods = tuple(map(_method, _sections(top, "methods")))
    names = {
        "systems": tuple(one.name for one in systems),
        "inputs": tuple(one.name for one in inputs),
        "noises": tuple(families),
        "methods": tuple(one.name for one in methods),
    }
    levels = {family: tuple(one.name for one in own) for family, own in families.items()}
    grids = _grids(top, names, levels)
    top.finish()
    noises = tuple(noise for own in families.values() for noise in own)
    study = nouns.DeclaredStudy(
        name, description, draws, seed, systems, inputs, noises, methods, grids
    )
    _check(study)
    return study


# ------------------------------------------------------------------------------------- sections
def _sections(top: _Section, key: str) -> list[_Section]:
    """The tables of one part; there is at least one."""
    found = top.take(key, _table, f"at least one table [{key}.NAME]")
    for name, content in found.items():
        if not isinstance(content, dict):
            raise OptionError(
                f"[{key}]: found {shown(name)} = {shown(content)}; expected a table; write "
                f"[{key}.{name if name.isidentifier() else 'NAME'}] above its keys"
            )
        if not name.strip() or not name.isprintable() or " / " in name:
            raise OptionError(
                f"[{key}]: found the name {shown(name)}; expected printable characters without "
                "' / '; rename it"
            )
    return [_Section(f"[{key}.{name}]", dict(content)) for name, content in found.items()]


def _named(section: _Section) -> str:
    return section.where.partition(".")[2][:-1]


def _system(section: _Section) -> nouns.DeclaredSystem:
    num = section.take("num", _coefficients, "numbers in descending powers, the first not zero")
    den = section.take("den", _coefficients, "numbers in descending powers, the first not zero")
    section.finish()
    if not 1 <= len(den) - 1 <= MOST_DEGREES or len(num) > len(den):
        raise OptionError(
            f"{section.where}: found degrees {len(num) - 1} over {len(den) - 1}; expected 1 to "
            f"{MOST_DEGREES} poles and at most as many zeros; correct num and den"
        )
    scaled = (tuple(value / den[0] for value in row) for row in (num, den))
    return nouns.DeclaredSystem(_named(section), *scaled)


def _input(section: _Section) -> nouns.DeclaredInput:
    kind = section.take("kind", _one_of(draw.INPUTS), _listed(draw.INPUTS))
    dt = section.take("dt", _above(0), "a number above zero [s]")
    count = _count(1, MOST_SAMPLES)
    missing = () if kind == draw.STEP else (None,)
    samples = section.take("samples", count, f"a whole number from 1 to {MOST_SAMPLES}", *missing)
    options = section.rest(draw.input_options(kind))
    section.finish()
    signal = nouns.DeclaredInput(_named(section), kind, dt, samples, options)
    if kind == draw.STEP and not all(_is_number(value) for _, value in options):
        raise OptionError(
            f"{section.where}: found amplitude = {shown(options[0][1])}; expected a number; "
            "correct it"
        )
    draw.samples_of(signal)
    return signal


def _noises(section: _Section) -> tuple[nouns.DeclaredNoise, ...]:
    """One noise for each level; where there are several, the level is part of the name."""
    kind = section.take("kind", _one_of(tuple(draw.NOISES)), _listed(tuple(draw.NOISES)), "white")
    given = [measure for measure in MEASURES if measure in section.left]
    if len(given) != 1:
        raise OptionError(
            f"{section.where}: found {' and '.join(given) or 'no level'}; expected one of "
            f"{', '.join(MEASURES)}, as a number or a list of numbers; state one"
        )
    section.known += MEASURES
    levels = section.take(
        given[0], _levels(given[0]), "a number or a list of numbers, not below zero but for snr"
    )
    options: nouns.Options = ()
    if kind == draw.STUDENT:
        options = (("degrees", section.take("degrees", _above(2), "a number above 2")),)
    elif kind == draw.ARMA:
        expected = "numbers, the first not zero"
        options = tuple(
            (n, section.take(n, _coefficients, expected, (1.0,))) for n in draw.NOISES[draw.ARMA]
        )
    section.finish()
    name, several = _named(section), isinstance(levels, tuple)
    found = tuple(
        nouns.DeclaredNoise(
            f"{name} {given[0]} {level:g}" if several else name, kind, given[0], level, options
        )
        for level in (levels if several else (levels,))
    )
    draw.drawn(found[0], np.random.default_rng(0), 1)
    return found


def _method(section: _Section) -> nouns.DeclaredMethod:
    kind = section.take("kind", _one_of(KINDS), _listed(KINDS))
    structure = section.rest(STRUCTURE)
    options = section.rest(options_of(kind))
    section.finish()
    return nouns.DeclaredMethod(_named(section), kind, structure, options)


def _grids(
    top: _Section, names: Mapping[str, tuple[str, ...]], levels: Mapping[str, tuple[str, ...]]
) -> tuple[nouns.DeclaredGrid, ...]:
    """Who meets whom: all, unless the file has [[cells]]."""
    given = top.take("cells", _tables, "tables [[cells]]", [{}])
    found = []
    for number, content in enumerate(given, 1):
        section = _Section(f"[[cells]] number {number}", dict(content))
        chosen = {
            key: section.take(
                key,
                _subset(names[key]),
                f"a list of names among {', '.join(names[key])}",
                names[key],
            )
            for key in PARTS
        }
        section.finish()
        chosen["noises"] = tuple(one for family in chosen["noises"] for one in levels[family])
        found.append(nouns.DeclaredGrid(**chosen))
    return tuple(found)


def _check(study: nouns.DeclaredStudy) -> None:
    """Refuse what shows only when the parts come together."""
    for cell in nouns.cells(study):
        draw.prepare(cell)
    for system, method in dict.fromkeys(
        (cell.system, method) for cell, method in nouns.meetings(study)
    ):
        checked_for(method, system)


# --------------------------------------------------------------------------------------- values
def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _name(value: object) -> str:
    name = _text(value)
    if not (name.strip() and name.isprintable() and len(name) <= 60 and not set(name) & set("/\\")):
        raise ValueError
    return name


def _table(value: object) -> dict[str, Any]:
    if not isinstance(value, dict) or not value:
        raise TypeError
    return value


def _tables(value: object) -> list[dict[str, Any]]:
    if not isinstance(value, list) or not value or not all(isinstance(one, dict) for one in value):
        raise TypeError
    return value


def _is_number(value: object) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max
    )


def _number(value: object) -> float:
    if not _is_number(value):
        raise TypeError
    return float(value)  # type: ignore[arg-type]


def _above(limit: float) -> Callable[[object], float]:
    def check(value: object) -> float:
        number = _number(value)
        if not number > limit:
            raise ValueError
        return number

    return check


def _count(lowest: int, highest: int) -> Callable[[object], int]:
    def check(value: object) -> int:
        if not isinstance(value, int) or isinstance(value, bool):
            raise TypeError
        if not lowest <= value <= highest:
            raise ValueError
        return value

    return check


def _coefficients(value: object) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or not value:
        raise TypeError
    found = tuple(_number(one) for one in value)
    if found[0] == 0:
        raise ValueError
    return found


def _levels(measure: str) -> Callable[[object], float | tuple[float, ...]]:
    def check(value: object) -> float | tuple[float, ...]:
        several = isinstance(value, list)
        found = tuple(_number(one) for one in (value if isinstance(value, list) else [value]))
        if not found or len(set(found)) < len(found) or (measure != "snr" and min(found) < 0):
            raise ValueError
        return found if several else found[0]

    return check


def _one_of(offered: tuple[str, ...]) -> Callable[[object], str]:
    def check(value: object) -> str:
        if value not in offered:
            raise ValueError
        return str(value)

    return check


def _subset(offered: tuple[str, ...]) -> Callable[[object], tuple[str, ...]]:
    def check(value: object) -> tuple[str, ...]:
        if not isinstance(value, list) or not value or not set(map(str, value)) <= set(offered):
            raise ValueError
        return tuple(dict.fromkeys(value))

    return check


def _listed(names: Iterable[str]) -> str:
    return f"one of {', '.join(names)}"


def _frozen(value: object) -> Any:
    """Lists as tuples, so that declared things can be compared and looked up."""
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


FOLDER = Path(__file__).parents[1] / "files"
SHIPPED = tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))
"""Their names."""


def shipped_study(name: str) -> Path:
    """The file of a study that comes with the package.

    Parameters
    ----------
    name : str
        One of `SHIPPED`, with or without its ending.

    Returns
    -------
    Path
        To run, or to copy and change.

    Raises
    ------
    OptionError
        There is none of that name.

    Examples
    --------
    >>> shipped_study("aircraft").name
    'aircraft.toml'
    """
    stem = name.removesuffix(".toml")
    if stem not in SHIPPED:
        raise OptionError(
            f"found no study {shown(name)} in the package; expected one of: {', '.join(SHIPPED)}; "
            "choose one, or give the path of a file"
        )
    return FOLDER / f"{stem}.toml"
