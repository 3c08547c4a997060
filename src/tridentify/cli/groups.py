"""Groups of options that several commands take, each read in one place into what it stands for.

A command names a group as one parameter, ``reading: Reading``; `with_groups` puts the group's
fields in its place before the command is registered, so that the help shows them one by one.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any, get_type_hints

from tridentify.cli import options
from tridentify.cli.ask import (
    chooses_orders,
    chosen_method,
    nested_delays,
    nested_poles,
    nested_zeros,
)
from tridentify.cli.knowledge import known_from
from tridentify.cli.load import RecordSource, rules_from, units_from
from tridentify.cli.stretches import stretches_from
from tridentify.estimation.methods.base import Method
from tridentify.record.checks.samples import Intersample
from tridentify.record.formats.assemble import Wanted
from tridentify.structure import AutoStructure, Structure


@dataclass(frozen=True)
class ReadingMany:
    """How files are read into records, many of them alike."""

    time: options.Time = None
    dt: options.Step = None
    intersample: options.Intersample = "auto"
    references: options.References = None
    reference_intersample: options.ReferenceIntersample = None
    instants: options.Instants = "auto"
    units: options.Units = None
    start: options.Start = None
    stop: options.Stop = None

    def options(self) -> dict[str, Any]:
        """As `tridentify.read_record` takes them."""
        return {
            "time": self.time,
            "dt": self.dt,
            "intersample": self.intersample,
            "references": tuple(self.references or ()),
            "reference_intersample": self.reference_intersample,
            "instants": self.instants,
            "units": units_from(self.units or ()),
            "start": self.start,
            "stop": self.stop,
        }


@dataclass(frozen=True)
class Reading(ReadingMany):
    """How files are read into records, and what of them does not count."""

    missing: options.Missing = None
    masked: options.Masked = None
    ranges: options.Ranges = None

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
    """What is estimated beside the model."""

    offset: options.Offset = "auto"
    drift: options.Drift = None
    initial_state: options.InitialState = "auto"

    def terms(self) -> dict[str, Any]:
        """As `Structure` takes them."""
        return {
            "offset": options.answered(self.offset),
            "drift": None if self.drift is None else options.answered(self.drift),
            "initial_state": self.initial_state,
        }


@dataclass(frozen=True)
class Late:
    """Dead times."""

    delay: options.Delay = None

    def template(self, along: Along, n_outputs: int, n_inputs: int) -> Structure:
        """A structure of any orders."""
        delay = nested_delays(self.delay or (), n_outputs, n_inputs)
        return Structure(1, 0, delay=delay, **along.terms())


@dataclass(frozen=True)
class Known:
    """What is known of the coefficients."""

    fixed: options.Fixed = None
    bounds: options.Limits = None
    priors: options.Priors = None
    gains: options.Gains = None

    @property
    def something(self) -> bool:
        """Whether anything is."""
        return bool(self.fixed or self.bounds or self.priors or self.gains)

    def read(self) -> dict[str, Any]:
        """As `Structure` takes it."""
        return known_from(self.fixed or (), self.bounds or (), self.priors or (), self.gains or ())


@dataclass(frozen=True)
class Way:
    """How it is estimated."""

    method: options.Method = "three-model"
    noise: options.NoiseModel = "auto"
    route: options.Routes = "auto"
    controller: options.Controllers = "unknown"

    def chosen(self, loss: options.Losses = "squared") -> Method:
        """The method with its options."""
        return chosen_method(
            self.method,
            noise=self.noise,
            loss=loss,
            route=self.route,
            controller=self.controller,
        )


def asked_structure(
    poles: Sequence[str],
    zeros: Sequence[str],
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
    template = late.template(along, n_outputs, n_inputs)
    if chooses_orders(poles, zeros, known.something):
        return AutoStructure(template=template)
    return replace(
        template,
        poles=nested_poles(poles, n_outputs, n_inputs),
        zeros=nested_zeros(zeros, n_outputs, n_inputs),
        **known.read(),
    )


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command with every group of options spread out.

    Parameters
    ----------
    command : callable
        Parameters annotated with a dataclass of options are groups.

    Examples
    --------
    >>> def fit(file: str, way: Way, out: str | None = None) -> None:
    ...     print(way.method, out)
    >>> list(inspect.signature(with_groups(fit)).parameters)
    ['file', 'method', 'noise', 'route', 'controller', 'out']
    >>> with_groups(fit)(file="a.csv", out="b", **vars(Way("output-error")))
    output-error b
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, type[Any]] = {}
    spread: list[inspect.Parameter] = []
    for name, own in inspect.signature(command).parameters.items():
        kind = hints[name]
        if not is_dataclass(kind):
            spread.append(own.replace(annotation=kind, kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        groups[name] = kind  # type: ignore[assignment]
        inner = get_type_hints(kind, include_extras=True)
        spread += [
            inspect.Parameter(
                one.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=one.default,
                annotation=inner[one.name],
            )
            for one in fields(kind)
        ]

    @wraps(command)
    def run(**given: Any) -> None:
        made = {
            name: group(**{one.name: given.pop(one.name) for one in fields(group)})
            for name, group in groups.items()
        }
        command(**given, **made)

    run.__signature__ = inspect.Signature(spread)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in spread}
    del run.__wrapped__
    return run
