"""A figure of a report as it leaves the drawing: SVG that stands in a page and in a file alike."""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tridentify.errors import OptionError
from tridentify.plots.style import WIDTH
from tridentify.writing.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("svg", "png", "pdf")
RESOLUTION = 150
"""Of the pixels in saved figures [1/inch]."""

Place = Literal["fit", "response", "test", "course"]


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure with the stem of its file name, its heading, what to see in it, and its place.

    The places of what is in it are settled, for all formats it is saved in.
    """

    stem: str
    heading: str
    caption: str
    figure: Figure
    place: Place = "response"


@dataclass(frozen=True)
class Picture:
    """A drawing as SVG, with its size [inch]; can be handed from process to process."""

    stem: str
    heading: str
    caption: str
    place: Place
    svg: str
    width: float
    height: float

    @property
    def wide(self) -> bool:
        """Whether it takes the width of the page."""
        return self.width > 1.5 * WIDTH

    @property
    def inline(self) -> str:
        """SVG element inside a page: as wide as its place, text as text, no outside names."""
        text = self.svg[self.svg.index("<svg") :]
        text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
        # this sheet would apply to the whole page, which has the same rule for its figures only
        text = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", text, flags=re.DOTALL)
        text = re.sub(r'<g id="[^"]*">', "<g>", text)
        head, body = text.split(">", 1)
        box = re.search(r'viewBox="[^"]*"', head)
        frame = box[0] if box else ""
        links = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
        return f'<svg {links} {frame} role="img" aria-label="{self.heading}">{body.strip()}'


def picture_of(drawing: Drawing) -> Picture:
    """Draw it as SVG, whose text stays text (small, searchable).

    Parameters
    ----------
    drawing : Drawing

    Returns
    -------
    Picture
    """
    import matplotlib as mpl

    # the salt keeps the ids of several figures of a page apart
    options: dict[Any, Any] = {"svg.fonttype": "none", "svg.hashsalt": drawing.stem}
    buffer = io.StringIO()
    with mpl.rc_context(options):
        _save(drawing, buffer, "svg")
    width, height = drawing.figure.get_size_inches()
    return Picture(
        drawing.stem,
        drawing.heading,
        drawing.caption,
        drawing.place,
        buffer.getvalue(),
        float(width),
        float(height),
    )


def save_picture(picture: Picture, folder: str | os.PathLike[str]) -> Path:
    """Write the SVG as a file of its own.

    Raises
    ------
    OutputPathError
        The folder or the file cannot be written.
    """
    return write_atomically(Path(folder) / f"{picture.stem}.svg", picture.svg)


def save_drawing(drawing: Drawing, folder: str | os.PathLike[str], name: str) -> Path:
    """Write one figure as a file of a format of `FORMATS`.

    Raises
    ------
    OutputPathError
        The folder or the file cannot be written.
    """
    if name == "svg":
        return save_picture(picture_of(drawing), folder)
    buffer = io.BytesIO()
    _save(drawing, buffer, name)
    return write_atomically(Path(folder) / f"{drawing.stem}.{name}", buffer.getvalue())


def check_formats(names: tuple[str, ...]) -> None:
    """Refuse a format that is not of `FORMATS`.

    Raises
    ------
    OptionError
    """
    unknown = [name for name in names if name not in FORMATS]
    if unknown:
        raise OptionError(
            f"found the figure format {unknown[0]!r}; expected one of {', '.join(FORMATS)}; "
            "choose one of them"
        )


def _save(drawing: Drawing, buffer: Any, name: str) -> None:
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type")) if name == "svg" else None
    with _quiet_about_glyphs():
        drawing.figure.savefig(buffer, format=name, dpi=RESOLUTION, metadata=metadata)


@contextmanager
def _quiet_about_glyphs() -> Iterator[None]:
    """A channel name in a script that the font lacks is no reason to warn about the estimate."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        yield
