"""The models of a picture: each with a name, a colour and a kind of line of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tridentify.errors import OptionError, SampleTypeError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.comparison.entries import Entry, Models, entries_of, same_channels
from tridentify.numerics.arrays import Array
from tridentify.plots.style import CYCLE, DASHES, cycle_colour
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Line:
    """One model of a picture.

    Attributes
    ----------
    entry : Entry
    number : int
        Its place among the models.
    together : int
        How many models there are.
    after : int
        How many stand on the axes already.
    named : bool
        Whether the user gave its name.
    """

    entry: Entry
    number: int
    together: int
    after: int = 0
    named: bool = False

    @property
    def model(self) -> TransferFunction:
        """The transfer function."""
        return self.entry.model

    @property
    def estimate(self) -> Estimate | None:
        """None for a model without standard errors."""
        return self.entry.estimate

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.entry.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.entry.output_names

    @property
    def units(self) -> Mapping[str, str]:
        """Channel to unit."""
        return self.entry.units

    @property
    def dt(self) -> float | None:
        """Sampling interval of the record it was identified from [s]."""
        return None if self.estimate is None else self.estimate.dt

    @property
    def draws(self) -> Array:
        """Draws of a posterior mean, else none."""
        return np.zeros((0, 0)) if self.estimate is None else np.asarray(self.estimate.draws)

    @property
    def label(self) -> str:
        """In the legend."""
        return self.entry.name if self.named or self.together > 1 else "model"

    @property
    def colour(self) -> str:
        """Of the house's palette."""
        return cycle_colour(self.after + self.number)

    @property
    def dash(self) -> str:
        """Kind of line."""
        return DASHES[(self.after + self.number) % len(DASHES)]

    @property
    def opacity(self) -> float:
        """Of its band: many lie over each other."""
        return 0.25 if self.together == 1 else 0.15


def lines_of(
    models: Models,
    names: Sequence[str] | None,
    example: str,
    axes: Sequence[Axes] | Axes | None = None,
) -> tuple[Line, ...]:
    """Every model with its line.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
    names : sequence of str, optional
    example : str
        How one writes the call.
    axes : sequence of matplotlib Axes, or one, optional
        Where they will be drawn: colours that stand there are passed over.

    Raises
    ------
    SampleTypeError, OptionError, ChannelNameError
        As `entries_of` and `same_channels`.
    """
    entries = entries_of(models, names, example=example)
    same_channels(entries)
    first = next(iter(np.ravel(np.asarray(axes, dtype=object))), None)
    taken = {line.get_color() for line in getattr(first, "lines", ())}
    after = max((k + 1 for k, colour in enumerate(CYCLE) if colour in taken), default=0)
    named = names is not None or isinstance(models, Mapping)
    return tuple(Line(entry, k, len(entries), after, named) for k, entry in enumerate(entries))


def band_label(ax: Axes, level: float) -> str | None:
    """In the legend, of the first band; the others look like it."""
    label = f"{100 * level:.3g} % band"
    return None if label in ax.get_legend_handles_labels()[1] else label


def named_first(lines: Sequence[Line]) -> Line:
    """The line whose channels have names and units, as far as one has."""
    return next((line for line in lines if line.units), None) or next(
        (line for line in lines if not line.entry.unnamed), lines[0]
    )


def numbers(what: str, given: object, example: str) -> Array:
    """An axis of numbers, or one line about what was given in its place.

    Raises
    ------
    SampleTypeError
        It is a model or a record: models are given together, before all else.
    OptionError
        It is no row of finite numbers.
    """
    if isinstance(given, Estimate | TransferFunction | Record):
        raise SampleTypeError(
            f"found {shown(type(given).__name__)} in place of {what}; expected numbers there, and "
            f"several models in one list; write {example}"
        )
    try:
        found = np.atleast_1d(np.asarray(given, dtype=np.float64))
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.ndim != 1 or not found.size or not np.all(np.isfinite(found)):
        raise OptionError(f"found {what}={shown(given)}; expected numbers in a row; correct it")
    return found


def frequencies(given: object, example: str) -> Array:
    """An axis of angular frequencies: two at least, as one makes no curve.

    Raises
    ------
    SampleTypeError, OptionError
        As `numbers`, or it is a single one, or one is not positive: the axis is logarithmic.
    """
    found = numbers("omega", given, example)
    if found.min() <= 0.0:
        raise OptionError.found(
            "omega=", float(found.min()), "frequencies above zero [rad/s]", "leave it out"
        )
    if found.size < 2:
        raise OptionError(
            f"found one frequency, omega={found[0]:.6g}; expected several [rad/s] to draw a curve "
            "over; give np.geomspace(low, high, 200), or ask model.frequency_response for one"
        )
    return found
