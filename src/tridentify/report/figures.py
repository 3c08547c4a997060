"""The figures of a report: what each shows, and where it stands."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from tridentify.errors import StepNotTakenError, TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.advice import FrequencyResponse, frequency_response
from tridentify.judgement.causes.attempts.first_samples import beginning
from tridentify.judgement.validation import Validation, validate
from tridentify.judgement.validation.residuals import View
from tridentify.numerics.arrays import Array
from tridentify.plots import (
    plot_bode,
    plot_convergence,
    plot_pole_zero,
    plot_residual_tests,
)
from tridentify.plots.diagrams import (
    draw_flow_chart,
    draw_parallel,
    draw_series,
    draw_series_parallel,
)
from tridentify.plots.fit import draw_inputs, draw_output, draw_residual
from tridentify.plots.over_time import STEP, Courses, draw_step, replies_of
from tridentify.plots.style import legend, outliers_of
from tridentify.record.record import Record
from tridentify.report.pictures import Drawing, Picture, check_formats, picture_of, save_drawing
from tridentify.report.sheet import Sheet
from tridentify.writing.layout import IN_PICTURES, short

LONGEST = 20_000
"""Samples of each record that the measured frequency response is made of: below a second."""

MOST_COLUMNS = 3
"""Channels beside each other; more could not be read."""

OUTPUT, RESIDUAL, INPUT = 1.7, 0.55, 0.8
"""Heights of axes of a fit [inch]."""
MAGNITUDE, PHASE, RESPONSE = 1.5, 1.2, 1.6
"""Heights of axes of responses [inch]."""
ALONE = 1.3
"""A single channel has so much more height, beside step response and poles."""
ROOTS = 2.3
"""Height of the frame of poles and zeros [inch]."""
TEST = 1.15
"""Height of axes of a test [inch]."""
PASSES = 1.7, 1.0, 1.2
"""Heights of the axes of the passes [inch]."""


def draw_figures(
    estimate: Estimate, records: Sequence[Record], validation: Validation | None = None
) -> Iterator[Drawing]:
    """Draw the figures of a report, one at a time.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        The experiments, in the order in which they were identified.
    validation : Validation, optional
        Draw its tests too.

    Yields
    ------
    Drawing
    """
    yield from draw_model(estimate, records)
    if validation is not None:
        yield from draw_tests(validation)


@dataclass(frozen=True, eq=False)
class Numbers:
    """What simulations tell of a model, so that who draws it need not simulate.

    Attributes
    ----------
    responses : tuple of (n_samples, n_outputs) arrays
        What it answers in each of the records that were identified.
    step : Courses
        Its step responses.
    """

    responses: tuple[Array, ...]
    step: Courses

    @classmethod
    def of(cls, estimate: Estimate, records: Sequence[Record]) -> Numbers:
        """Those of a model and the records that it was identified from."""
        return cls(tuple(_responses(estimate, records)), replies_of(estimate, STEP))


def draw_model(
    estimate: Estimate, records: Sequence[Record], numbers: Numbers | None = None
) -> Iterator[Drawing]:
    """Draw what needs no judgement: fits, responses, poles, passes.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
    numbers : Numbers, optional
        Where they are known.

    Yields
    ------
    Drawing
    """
    known = Numbers.of(estimate, records) if numbers is None else numbers
    yield from _identified(estimate, records, known.responses)
    yield _bode(estimate, records)
    yield _step(estimate, known.step)
    yield _pole_zero(estimate)
    yield _convergence(estimate)


def _responses(estimate: Estimate, records: Sequence[Record]) -> Iterator[Array]:
    return (estimate.predict(record, experiment=k) for k, record in enumerate(records))


def _identified(
    estimate: Estimate, records: Sequence[Record], responses: Iterable[Array]
) -> Iterator[Drawing]:
    for number, (record, response) in enumerate(zip(records, responses, strict=True)):
        yield draw_fit(record, response, estimate=estimate, place=(number, len(records)))


def identified_fits(estimate: Estimate, records: Sequence[Record]) -> list[Picture]:
    """The records that were identified against the model, as SVG."""
    drawings = _identified(estimate, records, _responses(estimate, records))
    return [picture_of(drawing) for drawing in drawings]


def fits_of_view(view: View) -> list[Picture]:
    """Measured against what a judgement simulated, an experiment each."""
    drawn = []
    for number, record in enumerate(view.records):
        residual = np.stack([output.residual[number] for output in view.outputs], axis=1)
        place = (number, len(view.records))
        drawn.append(picture_of(draw_fit(record, record.y - residual, place=place)))
    return drawn


def model_pictures(
    estimate: Estimate, records: Sequence[Record], numbers: Numbers | None = None
) -> list[Picture]:
    """What `draw_model` draws, as SVG."""
    return [picture_of(drawing) for drawing in draw_model(estimate, records, numbers)]


def tests_pictures(validation: Validation) -> list[Picture]:
    """What `draw_tests` draws, as SVG."""
    return [picture_of(drawing) for drawing in draw_tests(validation)]


class Artist(Protocol):
    """Who draws the figures of a report: this process, or another one beside it."""

    def model(self, estimate: Estimate, records: Sequence[Record]) -> list[Picture]:
        """As `model_pictures`."""

    def tests(self, validation: Validation) -> Callable[[], list[Picture]]:
        """As `tests_pictures`, to be called for when they are needed."""


class Here:
    """Draws in this process, when it is asked to."""

    def model(self, estimate: Estimate, records: Sequence[Record]) -> list[Picture]:
        """As `model_pictures`."""
        return model_pictures(estimate, records)

    def tests(self, validation: Validation) -> Callable[[], list[Picture]]:
        """As `tests_pictures`, to be called for when they are needed."""
        return partial(tests_pictures, validation)


def draw_fit(
    record: Record,
    response: Array,
    *,
    estimate: Estimate | None = None,
    place: tuple[int, int] = (0, 1),
) -> Drawing:
    """Draw measured outputs against the model's, what is left beneath each, and the inputs.

    Parameters
    ----------
    record : Record
    response : ndarray, shape (n_samples, n_outputs)
    estimate : Estimate, optional
        Whose outliers are marked.
    place : (int, int)
        Position of the experiment, and how many there are.

    Returns
    -------
    Drawing
    """
    experiment, count = place
    n = record.n_outputs
    sheet = Sheet([OUTPUT, RESIDUAL] * n + [INPUT] * record.n_inputs)
    axes = sheet.axes
    none = np.zeros(0, dtype=np.intp)
    for i in range(n):
        far = none if estimate is None else outliers_of(estimate, record, experiment, i)
        draw_output(axes[2 * i], record, response[:, i], i, far)
        draw_residual(axes[2 * i + 1], record, record.y[:, i] - response[:, i], i)
    legend(axes[0])
    draw_inputs(record, axes[2 * n :])
    several = count > 1
    where = f", experiment {experiment + 1}" if several else ""
    named = f": {short(record.name, IN_PICTURES)}" if several and record.name else ""
    return Drawing(
        f"fit-{experiment + 1}" if several else "fit",
        f"Measured against model{where}{named}",
        "Recorded output and response of the model to the recorded input alone, with the offset, "
        "drift and initial state that were estimated along; beneath, the difference.",
        sheet.settle(),
        "fit",
    )


def draw_tests(validation: Validation) -> Iterator[Drawing]:
    """Draw the tests of the residual, one figure an output.

    Parameters
    ----------
    validation : Validation

    Yields
    ------
    Drawing
    """
    names = validation.output_names
    several = len(names) > 1
    for i, name in enumerate(names):
        count = len(validation.input_names) + 3
        sheet = Sheet([TEST] * -(-count // 2), 2, share=False)
        plot_residual_tests(_of_output(validation, i), axes=sheet.axes[:count])
        where = f" of {short(name, IN_PICTURES)}" if several else ""
        yield Drawing(
            f"residual-tests-{i + 1}" if several else "residual-tests",
            f"Residual{where} and its tests",
            "What the model leaves unexplained. Of a right model its correlations with itself and "
            "with the inputs stay in the grey bounds but for a few, its distribution is on the "
            "line, and neither level nor size changes. Where the noise has a model, correlations "
            "and distribution are those of what the model of the noise leaves too.",
            sheet.settle(),
            "test",
        )


def _of_output(validation: Validation, i: int) -> Validation:
    """The same of one output alone."""
    tested = bool(validation.whiteness)
    n_inputs = len(validation.input_names)
    return replace(
        validation,
        output_names=(validation.output_names[i],),
        whiteness=validation.whiteness[i : i + 1],
        cross_correlation=validation.cross_correlation[n_inputs * i : n_inputs * (i + 1)],
        normality=validation.normality[i : i + 1],
        residual=tuple(np.array(one[:, [i]]) for one in validation.residual),
        innovations=tuple(np.array(one[:, [i]]) for one in validation.innovations)
        if tested
        else validation.innovations,
    )


def _columns(estimate: Estimate) -> int:
    """Channels beside each other: inputs across, or two outputs of one input."""
    n_outputs, n_inputs = len(estimate.output_names), len(estimate.input_names)
    return min(n_inputs, MOST_COLUMNS) if n_inputs > 1 else min(n_outputs, 2)


def _bode(estimate: Estimate, records: Sequence[Record]) -> Drawing:
    count, columns = len(estimate.output_names) * len(estimate.input_names), _columns(estimate)
    rows = -(-count // columns)
    taller = ALONE if count == 1 else 1.0
    sheet = Sheet([taller * MAGNITUDE, taller * PHASE] * rows, columns)
    cells = [divmod(k, columns) for k in range(count)]
    axes = [sheet.grid[2 * row + part][column] for row, column in cells for part in (0, 1)]
    measured = _measured(records)
    plot_bode(estimate, measured=measured, axes=axes)
    for ax in sheet.grid[-1]:
        ax.set_xlabel("angular frequency [rad/s]", fontsize=9)
    drawn = bool(len(estimate.draws))
    origin = (
        "between quantiles of the models that explain the record"
        if drawn
        else "from the covariance of the coefficients"
    )
    return Drawing(
        "bode",
        "Frequency response",
        f"With its 95 % band, {origin}. Beyond the frequencies that the input excites it holds "
        f"only if the structure is right.{_OF_POINTS if measured else ''}",
        sheet.settle(),
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


def _step(estimate: Estimate, replies: Courses) -> Drawing:
    count = len(estimate.output_names) * len(estimate.input_names)
    columns = _columns(estimate) if count > 2 else 1
    sheet = Sheet([RESPONSE] * -(-count // columns), columns)
    draw_step(replies, axes=sheet.axes[:count])
    for ax in sheet.grid[-1]:
        ax.set_xlabel("time after the step [s]", fontsize=9)
    return Drawing(
        "step",
        "Step response",
        "To a step of one unit of the input, from rest, with its 95 % band.",
        sheet.settle(),
    )


def _pole_zero(estimate: Estimate) -> Drawing:
    sheet = Sheet([ROOTS])
    plot_pole_zero(estimate, axes=sheet.axes[0])
    return Drawing(
        "pole-zero",
        "Poles and zeros",
        "Dots: poles of models that explain the record; zeros with 95 % regions to first order. "
        "The right half-plane is grey."
        if len(estimate.draws)
        else "With 95 % regions: ellipses around complex ones, intervals around real ones; the "
        "right half-plane is grey.",
        sheet.settle(),
    )


def _convergence(estimate: Estimate) -> Drawing:
    sheet = Sheet(PASSES)
    plot_convergence(estimate, axes=sheet.axes)
    return Drawing(
        "convergence",
        "Convergence of the passes",
        "A coefficient below the dashed line is closer to its final value than its standard error.",
        sheet.settle(),
        "course",
    )


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


def save_figures(
    estimate: Estimate,
    record: Record | Sequence[Record],
    folder: str | os.PathLike[str],
    *,
    formats: Sequence[str] = ("svg",),
) -> tuple[Path, ...]:
    """Write every figure of the report as files of its own.

    Parameters
    ----------
    estimate : Estimate
    record : Record or sequence of Record
        What was identified; several experiments in their order.
    folder : path-like
        Made if it does not exist.
    formats : sequence of {"svg", "png", "pdf"}
        One file per figure and format.

    Returns
    -------
    tuple of Path
        ``fit``, ``bode``, ``step``, ``pole-zero``, ``convergence``, ``residual-tests``; of several
        experiments or outputs ``fit-1``, ``residual-tests-1`` and so on. Without the last where the
        record is too short to test.

    Raises
    ------
    OptionError
        Another format is asked for.
    OutputPathError
        The folder or a file cannot be written.
    """
    check_formats(tuple(formats))
    given = (record,) if isinstance(record, Record) else tuple(record)
    records = tuple(one.settled(estimate.intersample) for one in given)
    try:
        checked = validate(estimate, records)
    except TridentifyError:
        checked = None
    written = []
    for drawing in draw_figures(estimate, records, checked):
        written += [save_drawing(drawing, folder, name) for name in formats]
    return tuple(written)
