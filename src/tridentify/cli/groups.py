"""Groups of options that several commands take, each read in one place into what it stands for.

A command names a group as one parameter, ``reading: Reading``; `with_groups` puts the group's
fields in its place before the command is registered, so that the help shows them one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from tridentify.cli import ask, options
from tridentify.cli.ask import known_from
from tridentify.cli.load import RecordSource, asked_channels, rules_from, stretches_from, units_from
from tridentify.estimation.methods.base import Method
from tridentify.record.checks.samples import Intersample
from tridentify.record.formats.assemble import Instants, Wanted
from tridentify.structure import AutoStructure, Structure


@dataclass(frozen=True)
class Measured:
    """What was recorded.

    Attributes
    ----------
    files
        CSV, Excel, Parquet, Feather, NPZ, MATLAB, ULog or MDF4; several are several experiments of
        one model.
    inputs
        Column of an input; may be repeated.
    outputs
        Column of an output; may be repeated.
    """

    files: Annotated[list[Path], typer.Argument(metavar="FILE")]
    inputs: Annotated[list[str] | None, options.record_option("--input", metavar="NAME")] = None
    outputs: Annotated[list[str] | None, options.record_option("--output", metavar="NAME")] = None

    def columns(self) -> tuple[list[str], list[str]]:
        """Those of the inputs and of the outputs; refused with a guess where they are left out."""
        return asked_channels(self.files, self.inputs, self.outputs)


@dataclass(frozen=True)
class ReadingMany:
    """How files are read into records, many of them alike.

    Attributes
    ----------
    time
        Column of time; by default the one called t or time.
    dt
        Uniform sampling interval; with --time, which must agree to 5 percent, or alone. Without it
        time is taken as it is recorded, uneven steps too.
    intersample
        What the input does between samples: zoh (held), foh (joined by lines) or band-limited
        (nothing above half the sampling rate; uniform time).
    references
        Column of what drove the loop from outside, where a controller set the input: a set point,
        or what was added to the controller's output; may be repeated.
    reference_intersample
        What the references do between samples: zoh, foh, band-limited or auto; by default as
        --intersample (switched ones are held), with auto by their samples.
    instants
        Where channels of several clocks meet: at the instants of the outputs, at all instants, or
        auto (all if they lie on one raster).
    start
        Leave out what is before.
    stop
        Leave out what is after.
    """

    time: Annotated[str | None, options.record_option(metavar="NAME")] = None
    dt: Annotated[float | None, options.record_option(metavar="SECONDS")] = None
    intersample: Annotated[Intersample, options.record_option(metavar="HOW")] = "auto"
    references: Annotated[
        list[str] | None, options.record_option("--reference", metavar="NAME")
    ] = None
    reference_intersample: Annotated[Intersample | None, options.record_option(metavar="HOW")] = (
        None
    )
    instants: Annotated[Instants, options.record_option(metavar="HOW")] = "auto"
    units: options.Units = None
    start: Annotated[float | None, options.record_option("--from", metavar="SECONDS")] = None
    stop: Annotated[float | None, options.record_option("--to", metavar="SECONDS")] = None

    def options(self) -> dict[str, Any]:
        """As `tridentify.read_record` takes them."""
        stated = {one.name: getattr(self, one.name) for one in fields(ReadingMany)}
        references = tuple(self.references or ())
        return stated | {"references": references, "units": units_from(self.units or ())}


@dataclass(frozen=True)
class Reading(ReadingMany):
    """How files are read into records, and what of them does not count.

    Attributes
    ----------
    masked
        A stretch, in seconds, whose output samples do not count; may be repeated.
    ranges
        A stretch of every file, in seconds, as an experiment of its own; may be repeated.
    """

    missing: options.Missing = None
    masked: Annotated[list[str] | None, options.record_option("--mask", metavar="FROM:TO")] = None
    ranges: Annotated[list[str] | None, options.record_option("--range", metavar="FROM:TO")] = None

    def source(
        self,
        files: Sequence[Path],
        inputs: Sequence[str],
        outputs: Sequence[str],
        between: Intersample | None = None,
    ) -> RecordSource:
        """Which part of which files are the records.

        Parameters
        ----------
        files : sequence of Path
        inputs, outputs : sequence of str
            Columns.
        between : str, optional
            What the input does between samples, where the option does not say it.
        """
        asked = self.options()
        wanted = Wanted(
            inputs, outputs, **(asked if between is None else asked | {"intersample": between})
        )
        return RecordSource(
            files,
            wanted,
            rules_from(self.missing or ()),
            stretches_from("--mask", self.masked or ()),
            stretches_from("--range", self.ranges or ()),
        )


@dataclass(frozen=True)
class Along:
    """What is estimated beside the model.

    Attributes
    ----------
    offset
        A constant on every output: yes, no, or auto (by AICc).
    drift
        A slope in time on every output: yes, no, or auto (by AICc); a number for a polynomial of
        that degree.
    initial_state
        State at the first sample: rest (all zero), equilibrium (steady under the first input value,
        as in trim), free (any), or auto (by AICc).
    """

    offset: Annotated[options.Choice, options.model_option(metavar="HOW")] = "auto"
    drift: Annotated[str | None, options.model_option(metavar="HOW")] = None
    initial_state: Annotated[
        Literal["auto", "rest", "equilibrium", "free"], options.model_option(metavar="HOW")
    ] = "auto"

    def terms(self) -> dict[str, Any]:
        """As `Structure` takes them."""
        return {
            "offset": options.answered(self.offset),
            "drift": options.drift_of(self.drift),
            "initial_state": self.initial_state,
        }


@dataclass(frozen=True)
class Late:
    """Dead times.

    Attributes
    ----------
    delay
        Known dead time: once, or a number for each input (--delay 0.1,0), or once for each output;
        free to estimate one for each input.
    """

    delay: Annotated[list[str] | None, options.model_option(metavar="SECONDS")] = None

    def template(self, along: Along, n_outputs: int, n_inputs: int) -> Structure:
        """A structure of any orders."""
        delay = ask.nested_delays(self.delay or (), n_outputs, n_inputs)
        return Structure(1, 0, delay=delay, **along.terms())


@dataclass(frozen=True)
class Known:
    """What is known of the coefficients.

    Attributes
    ----------
    fixed
        A coefficient that is known, such as a0=3.
    bounds
        Limits of a coefficient: b0=0:5, b0=0: or b0=:5.
    priors
        What is known before: mean and standard deviation, such as a0=3+-0.1.
    gains
        Known static gain b0 / a0: once for all channels, or once for each output with a number for
        each input (--gain 1.5,?), ? where it is unknown.
    """

    fixed: Annotated[list[str] | None, options.known_option("--fix", metavar="A=X")] = None
    bounds: Annotated[list[str] | None, options.known_option("--bound", metavar="A=LO:HI")] = None
    priors: Annotated[list[str] | None, options.known_option("--prior", metavar="A=X+-S")] = None
    gains: Annotated[list[str] | None, options.known_option("--gain", metavar="G")] = None

    @property
    def something(self) -> bool:
        """Whether anything is."""
        return bool(self.fixed or self.bounds or self.priors or self.gains)

    def read(self) -> dict[str, Any]:
        """As `Structure` takes it."""
        return known_from(self.fixed or (), self.bounds or (), self.priors or (), self.gains or ())


@dataclass(frozen=True)
class Way:
    """How it is estimated.

    Attributes
    ----------
    method
        Estimation method; a wrong name lists them.
    noise
        Measurement noise: white, ar (autoregressive; the samples are whitened), or auto (ar where
        the residual is not white).
    route
        What to make of a controller that set the input: reference (both signals fitted by what
        drove the loop; needs --reference), direct (a noise model), open-loop (none was running), or
        auto (reference where there is one).
    controller
        How that controller worked, for the reference route: sampled (the input is held),
        continuous, or unknown.
    """

    method: Annotated[str, options.model_option(metavar="NAME")] = "three-model"
    noise: Annotated[Literal["auto", "white", "ar"], options.model_option(metavar="HOW")] = "auto"
    route: Annotated[
        Literal["auto", "open-loop", "reference", "direct"],
        options.model_option("--route", metavar="WAY"),
    ] = "auto"
    controller: Annotated[
        Literal["unknown", "sampled", "continuous"],
        options.model_option("--controller", metavar="HOW"),
    ] = "unknown"

    def chosen(self, loss: str = "squared") -> Method:
        """The method with its options."""
        stated = {one.name: getattr(self, one.name) for one in fields(self)}
        return ask.chosen_method(stated.pop("method"), **stated, loss=loss)


@dataclass(frozen=True)
class Orders:
    """How many coefficients there are.

    Attributes
    ----------
    poles
        Degree of the denominator that all channels share; or denominators of their own: once for
        each output with a number for each input (--poles 2,1). Left out, or auto: orders are
        chosen as tridentify select does.
    zeros
        Degree of the numerators: once for all channels, or once for each output in their order
        (--zeros 1 --zeros 0); with several inputs also a number for each of them (--zeros 1,0).
        Left out with --poles.
    """

    poles: Annotated[list[str] | None, options.model_option(metavar="N")] = None
    zeros: Annotated[list[str] | None, options.model_option(metavar="M")] = None


def asked_structure(
    orders: Orders,
    late: Late,
    along: Along,
    known: Known,
    n_outputs: int,
    n_inputs: int,
) -> Structure | AutoStructure:
    """The structure that options ask for; without poles one whose orders a record chooses.

    Raises
    ------
    StructureError, OptionError
        The options make none.
    """
    poles, zeros = orders.poles or (), orders.zeros or ()
    template = late.template(along, n_outputs, n_inputs)
    if ask.chooses_orders(poles, zeros, known.something):
        return AutoStructure(template=template)
    return replace(
        template,
        poles=ask.nested_poles(poles, n_outputs, n_inputs),
        zeros=ask.nested_zeros(zeros, n_outputs, n_inputs),
        **known.read(),
    )
