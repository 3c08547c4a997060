"""What a fleet is made of: files, a Parquet data set, a data frame, or records one after the other.

Every source is turned into items, one a unit, in an order of its own that is always the same. Only
keys and places are looked at here; what is to be read is read by the workers.
"""

from __future__ import annotations

import glob as patterns
import hashlib
import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from tridentify.errors import DataError, MissingColumnError, OptionError, shown
from tridentify.fleet.job import Item
from tridentify.fleet.places import File, FrameRows, Rows, Unusable, place_of
from tridentify.record.record import Record

MOST_SPANS = 1000
"""Pieces that the rows of one key may lie in: more mean that the file is not sorted by key, and
that each record would be picked from all of the file."""

Span = tuple[str, int, int]

Source = str | os.PathLike[str] | Mapping[str, Any] | Iterable[Any]
"""A glob, a folder or file of Parquet with a key column, a data frame with one, records by key, or
an iterable of records, of (key, record) or of files."""


def items_of(source: Any, key: str | None = None) -> tuple[Iterator[Item], int | None]:
    """The units of a source, and how many they are where that is known beforehand.

    Parameters
    ----------
    source : Source
    key : str, optional
        Column of the key, for a data set or a frame.

    Returns
    -------
    items : iterator of Item
        Every key once.
    total : int or None

    Raises
    ------
    OptionError
        It is none of these, or `key` is missing or out of place.
    DataError
        No file fits.
    """
    if isinstance(source, Record):
        raise OptionError(
            "found one record; expected many; put it into a list, or write identify(record, ...)"
        )
    if isinstance(source, str | os.PathLike):
        found = list(_of_data_set(Path(source), key) if key else _of_files(os.fspath(source)))
        return distinct(found), len(found)
    if hasattr(source, "columns") or hasattr(source, "column_names"):
        return _of_frame(source, key)
    if key is not None:
        raise OptionError(
            f"found key={shown(key)} with {type(source).__name__}; expected a column of a data set "
            "or a frame; give pairs (key, record) in place of it"
        )
    if isinstance(source, Mapping):
        return distinct(Item(str(k), place_of(v)) for k, v in source.items()), len(source)
    if not isinstance(source, Iterable):
        raise OptionError(
            f"found {type(source).__name__}; expected a pattern of files, a Parquet data set, a "
            "data frame, or an iterable of records; put one record into a list"
        )
    total = len(source) if isinstance(source, Sized) else None
    return distinct(_of_iterable(source)), total


def distinct(items: Iterable[Item]) -> Iterator[Item]:
    """Every key once: a second unit of a key is refused under a name of its own.

    Examples
    --------
    >>> twice = [Item("a", File("a.csv")), Item("a", File("other/a.csv"))]
    >>> [item.key for item in distinct(twice)]
    ['a', 'a#2']
    """
    seen: dict[bytes, int] = {}
    for item in items:
        mark = hashlib.blake2b(item.key.encode("utf-8", "surrogatepass"), digest_size=12).digest()
        count = seen[mark] = seen.get(mark, 0) + 1
        if count == 1:
            yield item
            continue
        text = (
            f"found the key {shown(item.key)} {count} times; expected every unit to have one of "
            "its own; correct the keys"
        )
        yield Item(f"{item.key}#{count}", Unusable(text, "DataError", item.place.label))


# -------------------------------------------------------------------------------------------- files
def _of_files(pattern: str) -> Iterator[Item]:
    """Files by their path below what the pattern does not leave open."""
    if Path(pattern).is_dir():
        raise OptionError(
            f"found the folder {shown(pattern)} and no key; expected a pattern of files such as "
            f"{shown(os.path.join(pattern, '**', '*.csv'), 80)}, or key=COLUMN for a data set"
        )
    found = sorted(path for path in patterns.iglob(pattern, recursive=True) if os.path.isfile(path))
    if not found:
        raise DataError(
            f"found no file for {shown(pattern, 120)}; expected at least one; check the pattern "
            "(** stands for folders), in quotation marks on a command line"
        )
    root = _root(pattern)
    for path in found:
        yield Item(Path(os.path.relpath(path, root)).as_posix(), File(os.path.abspath(path)))


def _root(pattern: str) -> str:
    """The folder above the first part with a wildcard, or above a single file."""
    path = Path(pattern)
    kept = []
    for part in path.parts[:-1]:
        if patterns.has_magic(part):
            break
        kept.append(part)
    return str(Path(*kept)) if kept else "."


# ----------------------------------------------------------------------------------------- data set
def _of_data_set(path: Path, key: str) -> Iterator[Item]:
    """Units of a Parquet file or a folder of them, by a column or by ``key=value`` folders."""
    files = sorted(path.rglob("*.parquet")) if path.is_dir() else [path]
    files = [file for file in files if file.is_file()]
    if not files:
        raise DataError(
            f"found no Parquet file in {shown(str(path), 120)}; expected one, or a folder of them; "
            "check the path"
        )
    units: dict[str, list[Span]] = {}
    damaged: list[Item] = []
    for file in files:
        try:
            for name, span in _runs(file, key):
                units.setdefault(name, []).append(span)
        except (OptionError, MissingColumnError):
            raise
        except Exception as error:  # a damaged file is one unit that cannot be read
            text = (
                f"found no readable index in {shown(file.name)} ({shown(str(error), 80)}); "
                "expected a sound Parquet file; write it anew"
            )
            name = file.relative_to(path).as_posix() if path.is_dir() else file.name
            damaged.append(Item(name, Unusable(text, "UnreadableFileError", os.path.abspath(file))))
    for name, spans in units.items():
        _check_sorted(name, spans, key)
        yield Item(name, Rows(tuple(spans)))
    yield from damaged


def _check_sorted(name: str, spans: Sequence[Span], key: str) -> None:
    if len(spans) > MOST_SPANS:
        raise OptionError(
            f"found the rows of {shown(name)} in {len(spans)} places; expected at most "
            f"{MOST_SPANS}: rows sorted by {shown(key)}; sort the data set"
        )


def _runs(file: Path, key: str) -> Iterator[tuple[str, Span]]:
    """Key and (path, start, count) of rows that follow each other."""
    import polars as pl

    label = os.path.abspath(file)
    lazy = pl.scan_parquet(file, glob=False, hive_partitioning=False)
    names = lazy.collect_schema().names()
    if key not in names:
        value = next((p.partition("=")[2] for p in file.parts if p.startswith(f"{key}=")), None)
        if value is None:
            raise MissingColumnError(
                f"found no column {shown(key)} in {shown(file.name)}; expected one of "
                f"{shown(', '.join(names), 300)[1:-1]}, or a folder {key}=...; correct the key"
            )
        yield unquote(value), (label, 0, int(lazy.select(pl.len()).collect().item()))
        return
    runs = lazy.select(pl.col(key).cast(pl.String).rle().alias("run")).collect()["run"].struct
    start = 0
    for value, count in zip(runs.field("value"), runs.field("len"), strict=True):
        yield "" if value is None else value, (label, start, count)
        start += count


# -------------------------------------------------------------------------------------------- frame
def _of_frame(frame: Any, key: str | None) -> tuple[Iterator[Item], int]:
    """Units of a data frame in hand, in the order in which they first appear."""
    import narwhals as nw

    try:
        table = nw.from_native(frame, eager_only=True)
    except TypeError as error:
        raise OptionError(
            f"found {type(frame).__name__}; expected an eager data frame of pandas, polars or "
            "pyarrow; collect it first, or give the folder of a Parquet data set"
        ) from error
    if key is None or key not in table.columns:
        raise OptionError(
            f"found key={shown(key)} for a data frame with the columns "
            f"{shown(', '.join(map(str, table.columns)), 200)[1:-1]}; expected the one that tells "
            "its units apart; give key=COLUMN"
        )
    groups = table.to_polars().partition_by(
        key, maintain_order=True, include_key=False, as_dict=True
    )
    return distinct(_of_groups(groups)), len(groups)


def _of_groups(groups: Mapping[Any, Any]) -> Iterator[Item]:
    for (value,), rows in groups.items():
        content = io.BytesIO()
        rows.write_ipc(content)
        yield Item("" if value is None else str(value), FrameRows(content.getvalue()))


# ----------------------------------------------------------------------------------------- iterable
def _of_iterable(source: Iterable[Any]) -> Iterator[Item]:
    """Units by the key they come with; a file by its path, a bare record by its number from 0."""
    for number, thing in enumerate(source):
        if isinstance(thing, tuple) and len(thing) == 2 and isinstance(thing[0], str | int):
            yield Item(str(thing[0]), place_of(thing[1]))
        elif isinstance(thing, str | os.PathLike):
            yield Item(os.fspath(thing), File(os.path.abspath(thing)))
        else:
            yield Item(str(number), place_of(thing))
