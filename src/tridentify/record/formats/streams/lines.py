"""Whole lines out of pieces of bytes, in bounded memory.

A line is what ends with a line feed. What has none yet is kept until more arrives, so that half a
line of a file that is being written is never taken for a whole one. A line longer than
`LONGEST_LINE` is dropped while it arrives; in its place stands a `WholeLines` without text.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

LONGEST_LINE = 1 << 16
"""Bytes in a line beyond which it is no line of samples."""


@dataclass(frozen=True)
class WholeLines:
    """Consecutive whole lines, or one that is too long.

    Attributes
    ----------
    text : bytes
        The lines, each with its line feed; empty in place of a line that is too long.
    start, stop : int
        Positions of the first byte and behind the last one in the source.
    """

    text: bytes
    start: int
    stop: int

    @property
    def too_long(self) -> bool:
        """Whether this stands for one line that is too long."""
        return not self.text


class LineCutter:
    r"""Cuts whole lines out of pieces.

    Parameters
    ----------
    position : int
        Where in the source the first piece begins.

    Examples
    --------
    >>> cutter = LineCutter()
    >>> [lines.text for lines in cutter.cut(b"1,2\n3")], [x.text for x in cutter.cut(b",4\n")]
    ([b'1,2\n'], [b'3,4\n'])
    """

    def __init__(self, position: int = 0) -> None:
        self._kept: list[bytes] = []
        self._length = 0
        self._start = self._position = position

    @property
    def held(self) -> int:
        """Bytes that are kept, of a line without an end."""
        return sum(map(len, self._kept))

    def begin_at(self, position: int) -> None:
        """Forget half a line, since another file or part of it follows."""
        self._kept, self._length = [], 0
        self._start = self._position = position

    def cut(self, piece: bytes) -> Iterator[WholeLines]:
        """Give the whole lines that end in this piece.

        Parameters
        ----------
        piece : bytes
            What follows the piece before.

        Yields
        ------
        WholeLines
        """
        begin = 0
        if self._length:
            first = piece.find(b"\n") + 1
            if not first:
                self._keep(piece)
                return
            self._keep(piece[:first])
            yield self._line()
            begin = first
        end = piece.rfind(b"\n") + 1
        if end > begin:
            yield from self._whole(piece[begin:end])
        if len(piece) > max(begin, end):
            self._keep(piece[max(begin, end) :])

    def rest(self) -> Iterator[WholeLines]:
        """Give what is left as the last line, at an end that is known to be one."""
        if self._length:
            self._keep(b"\n")
            yield self._line()

    def _keep(self, piece: bytes) -> None:
        self._length += len(piece)
        self._position += len(piece)
        if self._length > LONGEST_LINE:
            self._kept = []
        else:
            self._kept.append(piece)

    def _line(self) -> WholeLines:
        line = WholeLines(b"".join(self._kept), self._start, self._position)
        self._kept, self._length, self._start = [], 0, self._position
        return line

    def _whole(self, text: bytes) -> Iterator[WholeLines]:
        """Give lines that are whole, those that are too long on their own."""
        begin = 0
        while begin < len(text):
            end = self._end_of_short(text, begin)
            if end > begin:
                yield self._passed(text[begin:end], end - begin)
            begin = end
            if begin < len(text):
                end = text.index(b"\n", begin) + 1
                yield self._passed(b"", end - begin)
                begin = end

    def _passed(self, text: bytes, length: int) -> WholeLines:
        start = self._position
        self._position = self._start = start + length
        return WholeLines(text, start, self._position)

    @staticmethod
    def _end_of_short(text: bytes, begin: int) -> int:
        """Where the lines from `begin` on that are not too long end."""
        while begin < len(text):
            # the last line feed within the longest line's reach
            end = text.rfind(b"\n", begin, begin + LONGEST_LINE) + 1
            if not end:
                return begin
            begin = end
        return begin
