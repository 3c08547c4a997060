"""The options of ``tridentify excite``: what they are called, and what they say in the help."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Signal(StrEnum):
    """What is made."""

    PRBS = "prbs"
    MULTISINE = "multisine"
    THREE_TWO_ONE_ONE = "3-2-1-1"
    DOUBLET = "doublet"
    CHIRP = "chirp"
    OPTIMAL = "optimal"


What = Annotated[Signal, typer.Argument(help="What to make.")]
Step = Annotated[float, typer.Option(metavar="SECONDS", help="Sampling interval.")]
PlanFile = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write time and inputs there, as CSV.")
]
Amplitude = Annotated[
    str | None,
    typer.Option(
        metavar="A",
        help="Largest magnitude about the trim, in the unit of the input or with one of its "
        "own, such as 1.5deg.",
    ),
]
Duration = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Of a chirp, or of a multisine's period."),
]
Band = Annotated[
    str | None,
    typer.Option(metavar="LOW,HIGH", help="Of a chirp or multisine, in rad/s."),
]
Width = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Of a doublet's or 3-2-1-1's unit.")
]
ForFrequency = Annotated[
    float | None,
    typer.Option(metavar="RAD/S", help="In place of --width: the mode to be excited."),
]
Stages = Annotated[int | None, typer.Option(help="Stages of a PRBS; 7 by default.")]
Clock = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Time that a PRBS holds a bit.")
]
Lead = Annotated[float | None, typer.Option(metavar="SECONDS", help="Rest before pulses.")]
Tail = Annotated[float | None, typer.Option(metavar="SECONDS", help="Rest after pulses.")]
Periods = Annotated[int | None, typer.Option(help="How often it is repeated.")]
InputNames = Annotated[
    list[str] | None,
    typer.Option("--input", metavar="NAME", help="Name of an input; may be repeated."),
]
Plant = Annotated[
    Path | None,
    typer.Option(
        metavar="MODEL",
        help="model.json of the plant, or the folder of identify --out: say what precision to "
        "expect.",
    ),
]
SensorNoise = Annotated[
    list[str] | None,
    typer.Option(
        metavar="STD",
        help="Noise on the outputs: once for all of them, or once for each, by name "
        "(--noise q=0.2) or in their order; that of the estimate by default.",
    ),
]
Coefficients = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="Of interest to the optimal input; may be repeated."),
]
TwoLevels = Annotated[
    bool | None,
    typer.Option("--binary", help="The optimal input as a signal of two levels."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
