"""``tridentify identify``: a file and a structure in, coefficients with standard errors out."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

from tridentify.checks.samples import Intersample
from tridentify.cli import tables
from tridentify.cli.knowledge import known_from
from tridentify.cli.results import ResultFolder
from tridentify.cli.terminal import Activity, paragraph, show, show_json
from tridentify.errors import (
    ChannelCountError,
    ConvergenceError,
    DataError,
    NonUniformTimeError,
    OptionError,
    OrderError,
    SamplingError,
    shown,
)
from tridentify.estimate import Estimate
from tridentify.formats.assemble import JITTER, Wanted, find_channel, record_from
from tridentify.formats.channels import SECONDS, Channel, OpenFile
from tridentify.formats.read import opened
from tridentify.record import Record
from tridentify.structure import Structure

TIME_NAMES = ("t", "time")

_record = partial(typer.Option, rich_help_panel="The record")
_model = partial(typer.Option, rich_help_panel="The model")
_known = partial(typer.Option, rich_help_panel="What is known; each may be repeated")
_result = partial(typer.Option, rich_help_panel="The result")


class Between(StrEnum):
    """What the input does between samples."""

    ZOH = "zoh"
    FOH = "foh"


class Choice(StrEnum):
    """Whether a nuisance term is estimated along."""

    AUTO = "auto"
    YES = "yes"
    NO = "no"

    @property
    def answer(self) -> bool | Literal["auto"]:
        """As `Structure` wants it."""
        return "auto" if self is Choice.AUTO else self is Choice.YES


class Beginning(StrEnum):
    """How the record begins."""

    AUTO = "auto"
    REST = "rest"
    EQUILIBRIUM = "equilibrium"
    FREE = "free"


class Noise(StrEnum):
    """What the measurement noise is taken for."""

    AUTO = "auto"
    WHITE = "white"
    AR = "ar"


class Loss(StrEnum):
    """What is minimised."""

    SQUARED = "squared"
    HUBER = "huber"
    STUDENT = "student"


@dataclass(frozen=True)
class Source:
    """Which part of which file is the record."""

    file: Path
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    time: str | None = None
    dt: float | None = None
    intersample: Intersample = "zoh"
    start: float | None = None
    stop: float | None = None


def identify(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="CSV, Parquet, Feather, NPZ, MATLAB, ULog or MDF4 file."
        ),
    ],
    inputs: Annotated[
        list[str], _record("--input", metavar="NAME", help="Column of an input; may be repeated.")
    ],
    outputs: Annotated[
        list[str], _record("--output", metavar="NAME", help="Column of an output; may be repeated.")
    ],
    poles: Annotated[
        int, _model(metavar="N", help="Degree of the denominator, shared by all channels.")
    ],
    zeros: Annotated[
        list[str],
        _model(
            metavar="M",
            help="Degree of the numerators: once for all channels, or once for each output in "
            "their order (--zeros 1 --zeros 0); with several inputs also a number for each of "
            "them (--zeros 1,0).",
        ),
    ],
    time: Annotated[
        str | None,
        _record(metavar="NAME", help="Column of time; by default the one called t or time."),
    ] = None,
    dt: Annotated[
        float | None,
        _record(
            metavar="SECONDS",
            help="Uniform sampling interval; with --time, which must agree to 5 percent, or alone.",
        ),
    ] = None,
    intersample: Annotated[
        Between,
        _record(
            metavar="HOW",
            help="What the input does between samples: zoh (held) or foh (joined by lines).",
        ),
    ] = Between.ZOH,
    start: Annotated[
        float | None, _record("--from", metavar="SECONDS", help="Leave out what is before.")
    ] = None,
    stop: Annotated[
        float | None, _record("--to", metavar="SECONDS", help="Leave out what is after.")
    ] = None,
    offset: Annotated[
        Choice,
        _model(metavar="HOW", help="A constant on every output: yes, no, or auto (by AICc)."),
    ] = Choice.AUTO,
    drift: Annotated[
        Choice,
        _model(metavar="HOW", help="A slope in time on every output: yes, no, or auto (by AICc)."),
    ] = Choice.NO,
    initial_state: Annotated[
        Beginning,
        _model(
            metavar="HOW",
            help="State at the first sample: rest (all zero), equilibrium (steady under the first "
            "input value, as in trim), free (any), or auto (by AICc).",
        ),
    ] = Beginning.AUTO,
    fixed: Annotated[
        list[str] | None,
        _known("--fix", metavar="A=X", help="A coefficient that is known, such as a0=3."),
    ] = None,
    bounds: Annotated[
        list[str] | None,
        _known(
            "--bound", metavar="A=LO:HI", help="Limits of a coefficient: b0=0:5, b0=0: or b0=:5."
        ),
    ] = None,
    priors: Annotated[
        list[str] | None,
        _known(
            "--prior",
            metavar="A=X+-S",
            help="What is known before: mean and standard deviation, such as a0=3+-0.1.",
        ),
    ] = None,
    gains: Annotated[
        list[str] | None,
        _known(
            "--gain",
            metavar="G",
            help="Known static gain b0 / a0: once for all channels, or once for each output with a "
            "number for each input (--gain 1.5,?), ? where it is unknown.",
        ),
    ] = None,
    method: Annotated[
        str, _model(metavar="NAME", help="Estimation method; a wrong name lists them.")
    ] = "three-model",
    noise: Annotated[
        Noise,
        _model(
            metavar="HOW",
            help="Measurement noise: white, ar (autoregressive; the samples are whitened), or auto "
            "(ar where the residual is not white).",
        ),
    ] = Noise.AUTO,
    loss: Annotated[
        Loss,
        _model(
            metavar="HOW",
            help="What is minimised: squared, or huber or student (robust, for outliers and noise "
            "with heavy tails).",
        ),
    ] = Loss.SQUARED,
    out: Annotated[
        Path | None,
        _result(
            metavar="DIR", help="Write model.json, report.html and the figures into this folder."
        ),
    ] = None,
    title: Annotated[str | None, _result(metavar="TEXT", help="Heading of the report.")] = None,
    as_json: Annotated[
        bool, _result("--json", help="Print one JSON object instead of tables.")
    ] = False,
) -> None:
    """Identify the coefficients of a model from a record in a file.

    Example: tridentify identify flight.csv --input elevator --output q --poles 2 --zeros 1
    """
    source = Source(
        file,
        tuple(inputs),
        tuple(outputs),
        time,
        dt,
        intersample.value,
        start,
        stop,
    )
    structure = Structure(
        poles,
        nested_zeros(zeros, len(outputs), len(inputs)),
        offset=offset.answer,
        drift=drift.answer,
        initial_state=initial_state.value,
        **known_from(fixed or (), bounds or (), priors or (), gains or ()),
    )
    check_method(method, noise, loss)
    written: Sequence[Path] = ()
    with ExitStack() as stack:
        results = None if out is None else stack.enter_context(ResultFolder(out))
        activity = stack.enter_context(Activity())
        record = load(source, activity)
        load_sample_loop(activity)
        estimate = estimate_model(record, structure, method, activity.stage, noise, loss)
        if results is not None:
            write_results(estimate, record, results.draft, activity, title)
            written = results.publish()
    if as_json:
        document = tables.estimate_document(estimate, record)
        show_json(document | {"files": [str(path) for path in written]})
    else:
        show_estimate(estimate, record, written)


def nested_zeros(given: Sequence[str], n_outputs: int, n_inputs: int) -> int | list[list[int]]:
    """Read the numbers of zeros.

    Parameters
    ----------
    given : sequence of str
        One number; or for each output a number, or a number for each input with commas between.
    n_outputs, n_inputs : int

    Returns
    -------
    int or list of list of int, ``[output][input]``

    Raises
    ------
    OrderError, ChannelCountError
        Something else is given, or for other numbers of channels.

    Examples
    --------
    >>> nested_zeros(["1"], 2, 1), nested_zeros(["1", "0"], 2, 1), nested_zeros(["1,0"], 1, 2)
    (1, [[1], [0]], [[1, 0]])
    """
    rows = []
    for text in given:
        if not re.fullmatch(r"\s*\d{1,4}\s*(,\s*\d{1,4}\s*)*", text):
            raise OrderError(
                f"found --zeros {shown(text)}; expected a whole number such as 1, or one for each "
                "input such as 1,0; correct it"
            )
        rows.append([int(number) for number in text.split(",")])
    if len(rows) == 1 and len(rows[0]) == 1:
        return rows[0][0]
    if len(rows) == 1:
        rows = rows * n_outputs
    if len(rows) != n_outputs or any(len(row) not in (1, n_inputs) for row in rows):
        raise ChannelCountError(
            f"found --zeros {' --zeros '.join(given)} for {n_outputs} outputs and {n_inputs} "
            "inputs; expected it once, or once for each output, with one number or one for each "
            "input; correct it"
        )
    return [row * n_inputs if len(row) == 1 else row for row in rows]


def check_method(name: str, noise: Noise = Noise.AUTO, loss: Loss = Loss.SQUARED) -> None:
    """Refuse a method that does not exist, or that has no choice of the noise or the loss."""
    from tridentify.identify import METHODS

    if name not in METHODS:
        raise OptionError(
            f"found --method {shown(name)}; expected one of {', '.join(METHODS)}; choose one"
        )
    asked = {"noise": noise.value} if noise is not Noise.AUTO else {}
    asked |= {"loss": loss.value} if loss is not Loss.SQUARED else {}
    for option, value in asked.items():
        if not hasattr(METHODS[name](), option):
            able = ", ".join(key for key, make in METHODS.items() if hasattr(make(), option))
            raise OptionError(
                f"found --{option} {value} with --method {name}; expected one of {able}; leave "
                f"--{option} out or choose another method"
            )


def load(source: Source, activity: Activity) -> Record:
    """Read the record; without a stated sampling, look for a column of time by its name.

    Raises
    ------
    DataError
        The file or the record in it cannot be used.
    """
    activity.stage(f"reading {source.file.name or source.file}")
    with opened(source.file) as table:
        time = source.time
        if time is None and source.dt is None:
            time = find_time(table, [*source.inputs, *source.outputs])
            if time is not None:
                activity.note(f"taking column {time!r} as time, by its name")
        record = _read(table, source, time)
        if record.dt is None:
            raise _not_uniform(record, time, cut=(source.start, source.stop) != (None, None))
        if time is None and source.dt is not None:
            _compare_unused_time(table, source.dt, activity)
    return record


def _read(table: OpenFile, source: Source, time: str | None) -> Record:
    wanted = Wanted(
        source.inputs,
        source.outputs,
        time,
        source.dt,
        source.intersample,
        start=source.start,
        stop=source.stop,
    )
    try:
        return record_from(table, wanted, source.file.stem)
    except NonUniformTimeError as error:
        found = str(error).rpartition(";")[0]
        raise NonUniformTimeError(
            f"{found}; correct --dt, interpolate the file to a uniform step, or leave --time out "
            "if only the time stamps are inexact"
        ) from error


def _not_uniform(record: Record, time: str | None, *, cut: bool) -> NonUniformTimeError:
    """Say how the steps of recorded time differ, and which way on there is."""
    steps, mean = np.diff(record.t), record.duration / (record.n_samples - 1)
    small = bool(np.all(np.abs(steps - mean) < JITTER * mean))
    named = f"--time {shlex.quote(time)} " if time else ""
    advice = (
        f"the jitter is small: give {named}--dt {mean:.6g}"
        if small and not cut
        else f"interpolate the file to a uniform step, or give --dt {mean:.6g}, the mean, without "
        "--time if only the time stamps are inexact"
    )
    return NonUniformTimeError(
        f"found steps between {steps.min():.6g} and {steps.max():.6g} s in "
        f"{f'column {shown(time)}' if time else 'the time of the file'}; "
        f"expected a uniform step; {advice}"
    )


def _compare_unused_time(table: OpenFile, dt: float, activity: Activity) -> None:
    """Caution if a column of time that is not used tells of another step."""
    found = time_channels(table)
    if len(found) != 1:
        return
    scale = SECONDS.get(found[0].unit)
    try:
        values = table.read([table.channels.index(found[0])])[0]
    except DataError:
        return
    mean = math.nan if scale is None else scale * float(values[-1] - values[0])
    mean /= max(len(values) - 1, 1)
    if abs(mean - dt) > JITTER * dt:
        activity.note(
            f"caution: column {shown(found[0].header)} is not used; its mean step is {mean:.6g} s, "
            f"not {dt:.6g} s"
        )


def time_channels(table: OpenFile) -> list[Channel]:
    """Give the channels that are called t or time, in any case."""
    return [channel for channel in table.channels if channel.name.casefold() in TIME_NAMES]


def find_time(table: OpenFile, wanted: Sequence[str]) -> str | None:
    """Find the column that is called t or time, in any case, with or without a unit in brackets.

    Parameters
    ----------
    table : OpenFile
    wanted : sequence of str
        Channels that it should be the time of.

    Returns
    -------
    str or None
        None if all of them have a time of their own in the file.

    Raises
    ------
    SamplingError
        There is none, or more than one.
    """
    if all(find_channel(table, name).clock for name in wanted):
        return None
    names = [channel.header for channel in table.channels if channel.header]
    found = [channel.header for channel in time_channels(table) if not channel.clock]
    if len(found) != 1:
        what = f"the columns {' and '.join(found)}" if found else "no column called t or time"
        raise SamplingError(
            f"found {what} in {shown(table.path.name)}, and neither --time nor --dt; expected to "
            f"know the sampling; give --time NAME (of {shown(', '.join(names), 200)[1:-1]}) or "
            "--dt SECONDS"
        )
    return found[0]


def load_sample_loop(activity: Activity) -> None:
    """Load the compiled recursion over samples; the first time on a machine it is compiled."""
    from tridentify.numerics.propagate import warm_up

    said = "loading the sample loop (compiled once per machine, which takes seconds)"
    with activity.brief_stage(said):
        warm_up()


def estimate_model(
    record: Record,
    structure: Structure,
    method: str = "three-model",
    progress: Callable[[str], None] | None = None,
    noise: Noise = Noise.AUTO,
    loss: Loss = Loss.SQUARED,
) -> Estimate:
    """Identify one record.

    Raises
    ------
    DataError, StructureError, IdentifiabilityError
        As the method refuses.
    ConvergenceError
        The method ended without a usable estimate.
    """
    from tridentify.identify import METHODS
    from tridentify.identify import identify as run

    chosen: Any = METHODS[method]()
    if noise is not Noise.AUTO:
        chosen = replace(chosen, noise=noise.value)
    if loss is not Loss.SQUARED:
        chosen = replace(chosen, loss=loss.value)
    estimate = run([record], structure, chosen, throw=False, progress=progress)
    if not estimate.status.ok:
        raise ConvergenceError(
            f"found no usable estimate: {estimate.status.message}; expected a minimum that the "
            f"data can tell; {estimate.status.remedy}"
        )
    return estimate


def write_results(
    estimate: Estimate, record: Record, folder: Path, activity: Activity, title: str | None
) -> None:
    """Write model.json, report.html and the figures into a folder."""
    from tridentify.report import save_figures, write_report

    activity.stage("writing the report and the figures")
    estimate.save(folder / "model.json")
    write_report(estimate, record, folder / "report.html", title=title)
    save_figures(estimate, record, folder)


def show_estimate(estimate: Estimate, record: Record, written: Sequence[Path]) -> None:
    """Print the tables."""
    show(
        tables.describe_record(record),
        tables.describe_status(estimate, record),
        estimate.model_text(),
        tables.coefficient_table(estimate),
        tables.fit_table(estimate),
        *tables.describe_notes(estimate),
        *describe_files(written),
    )


def describe_files(written: Sequence[Path]) -> list[str]:
    """Say which files were written, in one line; nothing if none were."""
    if not written:
        return []
    names = ", ".join(path.name for path in written)
    return [paragraph(f"written to {written[0].parent}: {names}", rest="  ")]
