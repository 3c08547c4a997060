"""The options of ``tridentify excite``: what they are called, and what they say in the help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

Signal = Literal["prbs", "multisine", "3-2-1-1", "doublet", "chirp", "optimal"]
What = Annotated[Signal, typer.Argument(help="What to make.")]
Step = Annotated[float, typer.Option(metavar="SECONDS", help="Sampling interval.")]
PlanFile = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write time and inputs there, as CSV.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


@dataclass(frozen=True)
class Wish:
    """What is asked of a signal; None where nothing is said."""

    amplitude: Annotated[
        str | None,
        typer.Option(
            metavar="A",
            help="Largest magnitude about the trim, in the unit of the input or with one of its "
            "own, such as 1.5deg.",
        ),
    ] = None
    duration: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Of a chirp, or of a multisine's period."),
    ] = None
    band: Annotated[
        str | None,
        typer.Option(metavar="LOW,HIGH", help="Of a chirp or multisine, in rad/s."),
    ] = None
    width: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Of a doublet's or 3-2-1-1's unit.")
    ] = None
    for_frequency: Annotated[
        float | None,
        typer.Option(metavar="RAD/S", help="In place of --width: the mode to be excited."),
    ] = None
    order: Annotated[int | None, typer.Option(help="Stages of a PRBS; 7 by default.")] = None
    clock: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Time that a PRBS holds a bit.")
    ] = None
    lead: Annotated[float | None, typer.Option(metavar="SECONDS", help="Rest before pulses.")] = (
        None
    )
    tail: Annotated[float | None, typer.Option(metavar="SECONDS", help="Rest after pulses.")] = None
    periods: Annotated[int | None, typer.Option(help="How often it is repeated.")] = None
    inputs: Annotated[
        list[str] | None,
        typer.Option("--input", metavar="NAME", help="Name of an input; may be repeated."),
    ] = None
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL",
            help="model.json of the plant, or the folder of identify --out: say what precision to "
            "expect.",
        ),
    ] = None
    noise: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STD",
            help="Noise on the outputs: once for all of them, or once for each, by name "
            "(--noise q=0.2) or in their order; that of the estimate by default.",
        ),
    ] = None
    coefficient: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Of interest to the optimal input; may be repeated."),
    ] = None
    binary: Annotated[
        bool | None,
        typer.Option("--binary", help="The optimal input as a signal of two levels."),
    ] = None
