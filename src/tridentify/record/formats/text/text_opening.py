"""How a delimited text file begins: its encoding, separator, comments and header."""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass
from pathlib import Path

from tridentify.errors import UnreadableFileError, shown
from tridentify.record.formats.text.cells import SEPARATORS
from tridentify.record.formats.text.number_rows import table_place
from tridentify.record.formats.text.title_lines import LOOKED_AT, header_place, separator_of

COMMENTS = ("#", "%")
LONGEST_ROW = 1 << 24
"""Characters in a row (or a line) beyond which the file is no table: a million columns of 16."""
CHUNK = 1 << 20
"""Bytes at a time: no text is held twice in memory."""


_CONTROLS = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f-\x9f]")


EXCEL = re.compile(r"sep=.")


_LONGEST_TITLE = 1 << 16
"""Characters in a line behind which no header is looked for."""


FIRST_LINES = 4 * LOOKED_AT
"""Lines in which the numbers are looked for where no table follows the header."""


LATER_BYTES = "tridentify.latin-1"


def check_readable(file: Path) -> bytes:
    """Give the first bytes of a file, or say why it cannot be read.

    Raises
    ------
    UnreadableFileError
        The file is missing, no regular file, or not permitted.
    """
    start = b""
    try:
        if file.is_dir():
            problem = "a directory"
        elif not file.exists():
            problem = "no such file"
        elif not file.is_file():
            problem = "no regular file"
        else:
            problem = ""
            with file.open("rb") as stream:
                start = stream.read(256)
    except (OSError, ValueError) as error:
        problem = getattr(error, "strerror", None) or str(error)
    if problem:
        raise UnreadableFileError(
            f"found {problem} at {shown(str(file), 200)}; expected a file that can be read; check "
            "the path and the permission"
        )
    return start


def not_text(file: Path, reason: str) -> UnreadableFileError:
    """The error that says why a file cannot be read as text."""
    return UnreadableFileError.found(
        f"{reason} in ", file.name, "CSV text in UTF-8", "save the file as CSV in UTF-8"
    )


def encoding_of(file: Path) -> str:
    """Tell the encoding by the first MiB: by its mark, as UTF-8, else Latin-1 if it may be text."""
    try:
        with file.open("rb") as stream:
            piece = stream.read(CHUNK)
    except OSError as error:
        raise not_text(file, f"a read error ({error.strerror})") from error
    if piece[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    try:
        # a character may be cut at the end of the piece
        codecs.getincrementaldecoder("utf-8")().decode(piece, final=len(piece) < CHUNK)
    except UnicodeDecodeError:
        if found := _CONTROLS.search(piece):
            raise not_text(file, f"binary content or another encoding ({found[0]!r})") from None
        return "latin-1"
    return "utf-8-sig"


def as_latin_1(error: UnicodeError) -> tuple[str, int]:
    """Decode what is no UTF-8 behind the piece that told the encoding."""
    if not isinstance(error, UnicodeDecodeError) or not error.encoding.startswith("utf-8"):
        raise error
    return error.object[error.start : error.end].decode("latin-1"), error.end


@dataclass(frozen=True)
class Opening:
    """How a file begins: its separator, the line of its header, the comment and titles above.

    `numbers` is the line of the first numbers where more than names and units stand above it, else
    0; `preamble` are the titles as they stand in the file.
    """

    separator: str
    first_line: int
    comment: str
    titles: tuple[str, ...] = ()
    numbers: int = 0
    preamble: tuple[str, ...] = ()


def read_opening(file: Path, encoding: str) -> Opening:
    """Find the header, and what separates its cells."""
    comment, number = "", 0
    found: list[tuple[str, int]] = []
    try:
        with file.open(encoding=encoding, errors=LATER_BYTES, newline=None) as stream:
            for number in range(1, 10_000):
                line = stream.readline(LONGEST_ROW)
                check_row(file, len(line), number)
                text = line.strip()
                if not line:
                    break
                if not text or text.startswith(COMMENTS) or EXCEL.fullmatch(text):
                    above = text.startswith(COMMENTS) and not found
                    comment = text.lstrip("#% ") if above else comment
                    continue
                found.append((line.rstrip("\r\n"), number))
                if len(line) > _LONGEST_TITLE or len(found) == FIRST_LINES:
                    break
    except UnreadableFileError:
        raise
    except UnicodeError as error:
        raise not_text(file, "binary content or another encoding") from error
    except OSError as error:
        raise not_text(file, f"a read error ({error.strerror})") from error
    lines = [line for line, _ in found]
    if not found:
        return Opening(",", number, comment)
    place = header_place(lines[:LOOKED_AT])
    other = table_place(lines, place)
    place = place if other is None else other.names
    # a workbook fills a title up to the width of the table
    titles = tuple(line.strip().strip(SEPARATORS) for line in lines[:place])
    separator = separator_of(lines[place:]) if other is None else other.separator
    first = 0 if other is None else found[other.numbers][1]
    return Opening(separator, found[place][1], comment, titles, first, tuple(lines[:place]))


def check_row(file: Path, length: int, line: int) -> None:
    """Refuse what goes on without an end, before it fills the memory."""
    if length >= LONGEST_ROW:
        raise UnreadableFileError(
            f"found a row of more than {LONGEST_ROW:,} characters at line {line} of "
            f"{shown(file.name)}; expected shorter ones; split the table, or repair the quotes or "
            "line ends that are missing"
        )


REMARKS = ("comment", "comments", "remark", "remarks")
"""Names of a last column that loggers fill in few rows."""


@dataclass(frozen=True)
class TextTable:
    """A delimited text file whose header has been read.

    Attributes
    ----------
    path : Path
        The file.
    encoding : str
        Of its text.
    separator : str
        What stands between two cells.
    names : tuple of str
        The cells of the header, without surrounding blanks.
    units : tuple of str
        The cells of the line of units; blank without one.
    first_line : int
        Number of the first line that is no comment, or of the header in a comment.
    header_lines : int
        Number of the line that the header, or the line of units, ends on.
    titles : tuple of str
        Lines above the header that are no comments.
    dated : tuple of bool
        Which columns hold dates or times, to judge by the first row that says so.
    textual : tuple of bool
        Which hold texts, likewise.
    """

    path: Path
    encoding: str
    separator: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    first_line: int
    header_lines: int
    titles: tuple[str, ...] = ()
    dated: tuple[bool, ...] = ()
    textual: tuple[bool, ...] = ()

    @property
    def width(self) -> int:
        """Cells that a row has at least: that of a remark, the last one, may be left out."""
        return len(self.names) - (len(self.names) > 1 and self.names[-1].casefold() in REMARKS)
