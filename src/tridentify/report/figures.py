"""The figures of a report, as drawings, as inline SVG, and as files."""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tridentify.errors import OptionError, StepNotTakenError, TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.advice import FrequencyResponse, frequency_response
from tridentify.judgement.causes.first_samples import beginning
from tridentify.judgement.validation import Validation
from tridentify.plots import (
    plot_bode,
    plot_convergence,
    plot_fit,
    plot_pole_zero,
    plot_record,
    plot_residual,
    plot_residual_tests,
    plot_step,
)
from tridentify.plots.diagrams import (
    draw_flow_chart,
    draw_parallel,
    draw_series,
    draw_series_parallel,
)
from tridentify.record.record import Record
from tridentify.writing.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")
RESOLUTION = 150
"""Of the pixels in saved figures [1/inch]."""

LONGEST = 20_000
"""Samples of each record that the measured frequency response is made of: below a second."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure with the stem of its file name, its heading and what to see in it.

    ``on_page`` and ``is_file`` say where it belongs. Its places are worked out once, when it is
    made, for all formats it is saved in.
    """

    stem: str
    heading: str
    caption: str
    figure: Figure
    on_page: bool = True
    is_file: bool = True


def draw_figures(
    estimate: Estimate,
    records: Sequence[Record],
    *,
    with_record: bool = False,
    validation: Validation | None = None,
    with_residual: bool = False,
) -> Iterator[Drawing]:
    """Draw the figures of a report, one at a time.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        The experiments, in the order in which they were identified.
    with_record : bool
        Also draw the records by themselves.
    validation : Validation, optional
        Draw its tests in place of the residuals alone.
    with_residual : bool
        Draw the residuals alone beside the tests too.

    Yields
    ------
    Drawing
    """
    for number, record in enumerate(records):
        several = len(records) > 1
        tail, where = (f"-{number + 1}", f", experiment {number + 1}") if several else ("", "")
        if with_record:
            yield replace(
                _drawing(f"record{tail}", f"Record{where}", "", plot_record(record)[0]),
                on_page=False,
            )
        yield _drawing(
            f"fit{tail}",
            f"Record and model response{where}",
            "Recorded output, response of the model to the recorded input with the offset, drift "
            "and initial state that were estimated along, and the input.",
            plot_fit(estimate, record, experiment=number)[0],
        )
        if validation is not None and not with_residual:
            continue
        residual = _drawing(
            f"residual{tail}",
            f"Residual{where}",
            "What the model leaves unexplained. If its autocorrelation leaves the bounds at more "
            "than a few lags, the noise is coloured or the model misses some of the response, and "
            "the standard errors are not to be trusted.",
            plot_residual(estimate, record, experiment=number)[0],
        )
        yield replace(residual, on_page=validation is None)
    if validation is not None:
        tests = _drawing(
            "residual-tests",
            "Residual and its tests",
            "What the model leaves unexplained: its course, its autocorrelation, its correlation "
            "with the inputs, and its distribution. Where the noise has a model, correlations and "
            "distribution are those of the whitened residual.",
            plot_residual_tests(validation)[0],
        )
        yield replace(tests, is_file=False)
    drawn = bool(len(estimate.draws))
    measured = _measured(records)
    origin = (
        "between quantiles of the models that explain the record"
        if drawn
        else "propagated to first order from the covariance of the coefficients"
    )
    yield _drawing(
        "bode",
        "Frequency response",
        f"Pointwise 95 % confidence band, {origin}. Beyond the frequencies that the input excites "
        f"it holds only if the structure is right.{_OF_POINTS if measured else ''}",
        plot_bode(estimate, measured=measured)[0],
    )
    yield _drawing(
        "step",
        "Step response",
        "To a step of one unit of the input, from rest, with its 95 % band.",
        plot_step(estimate)[0],
    )
    yield _drawing(
        "pole-zero",
        "Poles and zeros",
        "Dots: poles of models that explain the record; zeros with 95 % regions to first order. "
        "The right half-plane is grey."
        if drawn
        else "95 % ellipses around complex poles and zeros, 95 % intervals around real ones, "
        "to first order; the right half-plane is grey.",
        plot_pole_zero(estimate),
    )
    yield _drawing(
        "convergence",
        "Convergence of the passes",
        "A coefficient below the dashed line is closer to its final value than its standard error.",
        plot_convergence(estimate)[0],
    )


_OF_POINTS = (
    " Points: measured without a model, with 95 % error bars, faded where the coherence is poor; "
    "shaded: the frequencies that the input excites."
)


def _measured(records: Sequence[Record]) -> FrequencyResponse | None:
    """The frequency response without a model, where the records are long enough for one."""
    try:
        return frequency_response([beginning(record, LONGEST) for record in records])
    except TridentifyError:
        return None


@dataclass(frozen=True)
class Chart:
    """A diagram with the stem of its file name, its heading and what it shows."""

    stem: str
    heading: str
    caption: str
    svg: str


CHARTS = (
    ("parallel-model", "Step 1: the parallel model", draw_parallel,
     "Orthogonal operators whose weights are fitted to the output: noise does not bias them."),
    ("series-parallel-model", "Step 2: the series-parallel model", draw_series_parallel,
     "The coefficients, fitted to the noise-free output of Step 1."),
    ("series-model", "Step 3: the series model", draw_series,
     "What is still missing; at a stationary point it corrects nothing, beta is (1, 0, ..., 0)."),
    ("flow-chart", "The way to the estimate", draw_flow_chart,
     "Step 4 repeats the three; beside it what every pass came to."),
)  # fmt: skip


def draw_diagrams(estimate: Estimate) -> list[Chart]:
    """Draw the steps that ran, with their numbers, and the flow chart.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of Chart
        Without the diagrams of steps that did not run.
    """
    found = []
    for stem, heading, draw, caption in CHARTS:
        with suppress(StepNotTakenError):
            # as wide as its place
            svg = re.sub(r' width="[^"]*" height="[^"]*"', "", str(draw(estimate)), count=1)
            found.append(Chart(stem, heading, caption, svg))
    return found


def _drawing(stem: str, heading: str, caption: str, ax: Any) -> Drawing:
    import matplotlib as mpl

    figure = ax.figure
    engine = figure.get_layout_engine()
    if engine is not None:
        # for every saving by itself the places cost more than the drawing
        engine.execute(figure)
        with mpl.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
            figure.set_layout_engine(None)
    return Drawing(stem, heading, caption, figure)


def inline_svg(drawing: Drawing) -> str:
    """SVG element to stand inside a page: as wide as its place, text as text, no outside names.

    Parameters
    ----------
    drawing : Drawing

    Returns
    -------
    str
    """
    import matplotlib as mpl

    buffer = io.StringIO()
    # text stays text (small, searchable); the salt keeps the ids of several figures apart
    options: dict[Any, Any] = {"svg.fonttype": "none", "svg.hashsalt": drawing.stem}
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with mpl.rc_context(options), _quiet_about_glyphs():
        drawing.figure.savefig(buffer, format="svg", metadata=metadata)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # this sheet would apply to the whole page, which has the same rule for its figures only
    text = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", text, flags=re.DOTALL)
    text = re.sub(r'<g id="[^"]*">', "<g>", text)
    head, body = text.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', head)
    frame = box[0] if box else ""
    links = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    return f'<svg {links} {frame} role="img" aria-label="{drawing.heading}">{body.strip()}'


def save_figures(
    estimate: Estimate,
    record: Record | Sequence[Record],
    folder: str | os.PathLike[str],
    *,
    formats: Sequence[str] = ("png",),
) -> tuple[Path, ...]:
    """Write every figure of the report as files of its own.

    Parameters
    ----------
    estimate : Estimate
    record : Record or sequence of Record
        What was identified; several experiments in their order.
    folder : path-like
        Made if it does not exist.
    formats : sequence of {"png", "svg", "pdf"}
        One file per figure and format.

    Returns
    -------
    tuple of Path
        ``record``, ``fit``, ``residual``, ``bode``, ``step``, ``pole-zero``, ``convergence``.

    Raises
    ------
    OptionError
        Another format is asked for.
    OutputPathError
        The folder or a file cannot be written.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise OptionError(
            f"found the figure format {unknown[0]!r}; expected one of {', '.join(FORMATS)}; "
            "choose one of them"
        )
    given = (record,) if isinstance(record, Record) else tuple(record)
    records = tuple(one.settled(estimate.intersample) for one in given)
    written = []
    for drawing in draw_figures(estimate, records, with_record=True):
        written += [save_drawing(drawing, folder, name) for name in formats]
    return tuple(written)


def save_drawing(drawing: Drawing, folder: str | os.PathLike[str], name: str) -> Path:
    """Write one figure as a file of a format of `FORMATS`.

    Raises
    ------
    OutputPathError
        The folder or the file cannot be written.
    """
    buffer = io.BytesIO()
    with _quiet_about_glyphs():
        drawing.figure.savefig(buffer, format=name, dpi=RESOLUTION)
    return write_atomically(Path(folder) / f"{drawing.stem}.{name}", buffer.getvalue())


@contextmanager
def _quiet_about_glyphs() -> Iterator[None]:
    """A channel name in a script that the font lacks is no reason to warn about the estimate."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        yield
