"""The options that several commands share: what they are called, and what they say in the help."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from tridentify.record.checks import samples
from tridentify.record.formats import assemble

record_option = partial(typer.Option, rich_help_panel="The record")
model_option = partial(typer.Option, rich_help_panel="The model")
known_option = partial(typer.Option, rich_help_panel="What is known; each may be repeated")
result_option = partial(typer.Option, rich_help_panel="The result")


Choice = Literal["auto", "yes", "no"]
"""Whether a nuisance term is estimated along."""


def answered(choice: Choice) -> bool | Literal["auto"]:
    """A choice as `Structure` wants it."""
    return "auto" if choice == "auto" else choice == "yes"


# ------------------------------------------------------------------------------------- the record
Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE",
        help="CSV, Excel, Parquet, Feather, NPZ, MATLAB, ULog or MDF4; several are several "
        "experiments of one model.",
    ),
]
Inputs = Annotated[
    list[str],
    record_option("--input", metavar="NAME", help="Column of an input; may be repeated."),
]
Outputs = Annotated[
    list[str],
    record_option("--output", metavar="NAME", help="Column of an output; may be repeated."),
]
NamedInputs = Annotated[
    list[str] | None,
    record_option("--input", metavar="NAME", help="Column of an input; may be repeated."),
]
NamedOutputs = Annotated[
    list[str] | None,
    record_option("--output", metavar="NAME", help="Column of an output; may be repeated."),
]
"""As `Inputs` and `Outputs`, for commands that say what the file may mean where they are left out
(`load.asked_channels`)."""
Time = Annotated[
    str | None,
    record_option(metavar="NAME", help="Column of time; by default the one called t or time."),
]
Step = Annotated[
    float | None,
    record_option(
        metavar="SECONDS",
        help="Uniform sampling interval; with --time, which must agree to 5 percent, or alone. "
        "Without it time is taken as it is recorded, uneven steps too.",
    ),
]
Intersample = Annotated[
    samples.Intersample,
    record_option(
        metavar="HOW",
        help="What the input does between samples: zoh (held), foh (joined by lines) or "
        "band-limited (nothing above half the sampling rate; uniform time).",
    ),
]
Instants = Annotated[
    assemble.Instants,
    record_option(
        metavar="HOW",
        help="Where channels of several clocks meet: at the instants of the outputs, at all "
        "instants, or auto (all if they lie on one raster).",
    ),
]
References = Annotated[
    list[str] | None,
    record_option(
        "--reference",
        metavar="NAME",
        help="Column of what drove the loop from outside, where a controller set the input: a set "
        "point, or what was added to the controller's output; may be repeated.",
    ),
]
ReferenceIntersample = Annotated[
    samples.Intersample | None,
    record_option(
        metavar="HOW",
        help="What the references do between samples: zoh, foh, band-limited or auto; by default "
        "as --intersample, with auto by their samples.",
    ),
]
Missing = Annotated[
    list[str] | None,
    record_option(
        metavar="RULE",
        help='Output samples that do not count, such as "q>=9.99" of a saturated sensor; may be '
        "repeated.",
    ),
]
Ranges = Annotated[
    list[str] | None,
    record_option(
        "--range",
        metavar="FROM:TO",
        help="A stretch of every file, in seconds, as an experiment of its own; may be repeated.",
    ),
]
Masked = Annotated[
    list[str] | None,
    record_option(
        "--mask",
        metavar="FROM:TO",
        help="A stretch, in seconds, whose output samples do not count; may be repeated.",
    ),
]
Units = Annotated[
    list[str] | None,
    record_option(
        "--unit",
        metavar="NAME=U",
        help="Unit of a column, before that of the file; may be repeated.",
    ),
]
Start = Annotated[
    float | None, record_option("--from", metavar="SECONDS", help="Leave out what is before.")
]
Stop = Annotated[
    float | None, record_option("--to", metavar="SECONDS", help="Leave out what is after.")
]

# -------------------------------------------------------------------------------------- the model
Poles = Annotated[
    list[str],
    model_option(
        metavar="N",
        help="Degree of the denominator that all channels share; or denominators of their own: "
        "once for each output with a number for each input (--poles 2,1).",
    ),
]
Zeros = Annotated[
    list[str],
    model_option(
        metavar="M",
        help="Degree of the numerators: once for all channels, or once for each output in "
        "their order (--zeros 1 --zeros 0); with several inputs also a number for each of "
        "them (--zeros 1,0).",
    ),
]
PolesOrAuto = Annotated[
    list[str] | None,
    model_option(
        "--poles",
        metavar="N",
        help="Degree of the denominator that all channels share; or denominators of their own: "
        "once for each output with a number for each input (--poles 2,1). Left out, or auto: "
        "orders are chosen as tridentify select does.",
    ),
]
ZerosOrAuto = Annotated[
    list[str] | None,
    model_option(
        "--zeros",
        metavar="M",
        help="Degree of the numerators: once for all channels, or once for each output in "
        "their order (--zeros 1 --zeros 0); with several inputs also a number for each of "
        "them (--zeros 1,0). Left out with --poles.",
    ),
]
Delay = Annotated[
    list[str] | None,
    model_option(
        metavar="SECONDS",
        help="Known dead time: once, or a number for each input (--delay 0.1,0), or once for each "
        "output; free to estimate one for each input.",
    ),
]
Offset = Annotated[
    Choice,
    model_option(metavar="HOW", help="A constant on every output: yes, no, or auto (by AICc)."),
]
Drift = Annotated[
    Choice | None,
    model_option(
        metavar="HOW", help="A slope in time on every output: yes, no, or auto (by AICc)."
    ),
]
InitialState = Annotated[
    Literal["auto", "rest", "equilibrium", "free"],
    model_option(
        metavar="HOW",
        help="State at the first sample: rest (all zero), equilibrium (steady under the first "
        "input value, as in trim), free (any), or auto (by AICc).",
    ),
]
Method = Annotated[
    str, model_option(metavar="NAME", help="Estimation method; a wrong name lists them.")
]
NoiseModel = Annotated[
    Literal["auto", "white", "ar"],
    model_option(
        metavar="HOW",
        help="Measurement noise: white, ar (autoregressive; the samples are whitened), or auto "
        "(ar where the residual is not white).",
    ),
]
Routes = Annotated[
    Literal["auto", "open-loop", "reference", "direct"],
    model_option(
        "--route",
        metavar="WAY",
        help="What to make of a controller that set the input: reference (both signals fitted by "
        "what drove the loop; needs --reference), direct (a noise model), open-loop (none was "
        "running), or auto (reference where there is one).",
    ),
]
Controllers = Annotated[
    Literal["unknown", "sampled", "continuous"],
    model_option(
        "--controller",
        metavar="HOW",
        help="How that controller worked, for the reference route: sampled (the input is held), "
        "continuous, or unknown.",
    ),
]
Losses = Annotated[
    Literal["squared", "huber", "student"],
    model_option(
        metavar="HOW",
        help="What is minimised: squared, or huber or student (robust, for outliers and noise "
        "with heavy tails).",
    ),
]

# ---------------------------------------------------------------------------------- what is known
Fixed = Annotated[
    list[str] | None,
    known_option("--fix", metavar="A=X", help="A coefficient that is known, such as a0=3."),
]
Limits = Annotated[
    list[str] | None,
    known_option(
        "--bound", metavar="A=LO:HI", help="Limits of a coefficient: b0=0:5, b0=0: or b0=:5."
    ),
]
Priors = Annotated[
    list[str] | None,
    known_option(
        "--prior",
        metavar="A=X+-S",
        help="What is known before: mean and standard deviation, such as a0=3+-0.1.",
    ),
]
Gains = Annotated[
    list[str] | None,
    known_option(
        "--gain",
        metavar="G",
        help="Known static gain b0 / a0: once for all channels, or once for each output with a "
        "number for each input (--gain 1.5,?), ? where it is unknown.",
    ),
]

# ------------------------------------------------------------------------------------- the result
Out = Annotated[
    Path | None,
    result_option(
        metavar="DIR", help="Write model.json, report.html and the figures into this folder."
    ),
]
Title = Annotated[str | None, result_option(metavar="TEXT", help="Heading of the report.")]
AsJson = Annotated[bool, result_option("--json", help="Print one JSON object instead of tables.")]
Verbose = Annotated[
    bool,
    result_option(
        "--verbose", help="Also tell by how much every decision was won, and why the search ended."
    ),
]
