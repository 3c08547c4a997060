"""The options of ``tridentify excite``: what they are called, and what they say in the help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

Signal = Literal["prbs", "multisine", "3-2-1-1", "doublet", "chirp", "optimal"]


@dataclass(frozen=True)
class Wish:
    """What is asked of a signal; None where nothing is said.

    Attributes
    ----------
    amplitude
        Largest magnitude about the trim, in the unit of the input or with one of its own, such as
        1.5deg.
    duration
        Of a chirp, or of a multisine's period.
    band
        Of a chirp or multisine, in rad/s.
    width
        Of a doublet's or 3-2-1-1's unit.
    for_frequency
        In place of --width: the mode to be excited.
    order
        Stages of a PRBS; 7 by default.
    clock
        Time that a PRBS holds a bit.
    lead
        Rest before pulses.
    tail
        Rest after pulses.
    periods
        How often it is repeated.
    inputs
        Name of an input; may be repeated.
    model
        model.json of the plant, or the folder of identify --out: say what precision to expect.
    noise
        Noise on the outputs: once for all of them, or once for each, by name (--noise q=0.2) or in
        their order; that of the estimate by default.
    coefficient
        Of interest to the optimal input; may be repeated.
    binary
        The optimal input as a signal of two levels.
    """

    amplitude: Annotated[str | None, typer.Option(metavar="A")] = None
    duration: Annotated[float | None, typer.Option(metavar="SECONDS")] = None
    band: Annotated[str | None, typer.Option(metavar="LOW,HIGH")] = None
    width: Annotated[float | None, typer.Option(metavar="SECONDS")] = None
    for_frequency: Annotated[float | None, typer.Option(metavar="RAD/S")] = None
    order: Annotated[int | None, typer.Option()] = None
    clock: Annotated[float | None, typer.Option(metavar="SECONDS")] = None
    lead: Annotated[float | None, typer.Option(metavar="SECONDS")] = None
    tail: Annotated[float | None, typer.Option(metavar="SECONDS")] = None
    periods: Annotated[int | None, typer.Option()] = None
    inputs: Annotated[list[str] | None, typer.Option("--input", metavar="NAME")] = None
    model: Annotated[Path | None, typer.Option(metavar="MODEL")] = None
    noise: Annotated[list[str] | None, typer.Option(metavar="STD")] = None
    coefficient: Annotated[list[str] | None, typer.Option(metavar="NAME")] = None
    binary: Annotated[bool | None, typer.Option("--binary")] = None
