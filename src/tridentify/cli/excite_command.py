"""``tridentify excite``: an input to fly, as a file, and the precision that it will give."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from tridentify.cli.stored_models import model_file
from tridentify.cli.terminal import say, show, show_json
from tridentify.errors import OptionError, shown
from tridentify.options import NUMBER

if TYPE_CHECKING:
    from tridentify.estimation.answer.estimate import Estimate
    from tridentify.excitation import Excitation
    from tridentify.transfer_function import TransferFunction


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


REST = (1, 7)
"""Rest before and after pulses, in their units: enough to see the trim, and about two periods of
the mode that they are made for."""

UNITS_OF = {"3-2-1-1": 7, "doublet": 2}
"""Length of pulses, in their units."""

SAID_AMPLITUDE = 1.0
"""Where --amplitude is not stated: one unit of the input, but one degree where that is a radian."""

USED = {
    "prbs": {"order", "clock", "periods"},
    "multisine": {"duration", "band", "periods"},
    "3-2-1-1": {"width", "for_frequency"},
    "doublet": {"width", "for_frequency"},
    "chirp": {"duration", "band"},
    "optimal": {"duration", "band", "periods", "coefficient", "binary"},
}
SEVERAL = ("prbs", "multisine", "optimal")
"""Signals of which there may be one for each of several inputs."""


def excite(
    signal: Annotated[Signal, typer.Argument()],
    dt: Annotated[float, typer.Option(metavar="SECONDS")],
    out: Annotated[Path | None, typer.Option(metavar="FILE")] = None,
    *,
    wish: Wish,
    as_json: Annotated[bool, typer.Option("--json")] = False,
) -> None:
    """Make an input for an experiment, and say what precision it will give.

    Example: tridentify excite 3-2-1-1 --dt 0.02 --for-frequency 3 --amplitude 1deg --out plan.csv

    Parameters
    ----------
    signal
        What to make.
    dt
        Sampling interval.
    out
        Write time and inputs there, as CSV.
    as_json
        Print one JSON object instead of text.
    """
    from tridentify.excitation import precision
    from tridentify.export import read_json

    how = "tridentify excite SIGNAL --model result/model.json"
    plant = None if wish.model is None else read_json(model_file(wish.model, how))
    unit = _unit_of_input(plant)
    size, stated = _amplitude(wish.amplitude, unit, free=plant is None)
    if wish.noise and plant is None:
        raise OptionError("found --noise without --model; expected both, or none; add --model")
    if wish.amplitude is None:
        say(f"--amplitude is not stated: {size:.4g} {stated}".rstrip() + " is taken")
    plan = _rested(_made(signal, wish, dt, size, plant), signal, wish)
    plan = _named(plan, wish.inputs or (), plant, stated)
    ahead = None
    if plant is not None:
        ahead = precision(plant, plan, noise_std=_noise(wish.noise or (), plant))
    written = [] if out is None else [str(plan.save(out))]
    if as_json:
        document: dict[str, Any] = {
            "what": plan.what,
            "n_samples": plan.n_samples,
            "dt": plan.dt,
            "amplitude": plan.amplitude.tolist(),
            "rms": plan.rms.tolist(),
            "precision": None if ahead is None else ahead.to_dict(),
            "files": written,
        }
        show_json(document)
        return
    blocks = [plan.summary(), *([] if ahead is None else [ahead.summary()])]
    show(*blocks, *(f"wrote {path}" for path in written))


def _unit_of_input(plant: Estimate | TransferFunction | None) -> str:
    """The unit that all inputs of a plant have; empty where it is not known, or not one."""
    known = getattr(plant, "units", None) or {}
    units = {known.get(name, "") for name in getattr(plant, "input_names", None) or ()}
    return units.pop() if len(units) == 1 else ""


def _amplitude(text: str | None, unit: str, *, free: bool) -> tuple[float, str]:
    """Read the amplitude in the unit of the input; without a plant any unit of its own holds."""
    if text is None:
        return (math.radians(SAID_AMPLITUDE) if unit == "rad" else SAID_AMPLITUDE), unit
    match = re.fullmatch(rf"\s*({NUMBER})\s*(.*?)\s*", text)
    value, own = (math.nan, "") if match is None else (float(match[1]), match[2])
    turned = {("deg", "rad"): math.radians(1.0), ("rad", "deg"): math.degrees(1.0)}
    same = not own or own == unit or free
    factor = 1.0 if same else turned.get((own, unit), math.nan)
    if not math.isfinite(value * factor):
        raise OptionError(
            f"found --amplitude {shown(text)}; expected a number"
            f"{f' in {unit}, the unit of the input' if unit else ''}, such as "
            f"--amplitude 0.02{unit}{'' if unit or free else ', since the model states no unit'}; "
            "correct it"
        )
    return value * factor, unit or own


def _noise(given: Sequence[str], plant: Estimate | TransferFunction) -> list[float] | None:
    """The noise of every output, from numbers in order or by name."""
    names = tuple(getattr(plant, "output_names", None) or ()) or ("y",)
    own = getattr(plant, "noise_variance", None)
    found: dict[str, float] = {}
    for place, text in enumerate(given):
        name, sign, number = text.rpartition("=")
        label = name.strip() if sign else names[place] if place < len(names) else ""
        if not re.fullmatch(NUMBER, number.strip()) or label not in names or label in found:
            raise OptionError.found(
                "--noise ", text, f"a number, or NAME=NUMBER for each of {', '.join(names)}"
            )
        found[label] = float(number)
    if not given:
        return None
    if len(given) == 1 and "=" not in given[0]:
        return [float(given[0])] * len(names)
    if len(found) < len(names) and own is None:
        lost = ", ".join(name for name in names if name not in found)
        raise OptionError(f"found no --noise for {lost}; expected one for each output; add it")
    return [
        found.get(name, 0.0 if own is None else math.sqrt(own[k])) for k, name in enumerate(names)
    ]


def _rested(plan: Excitation, signal: Signal, wish: Wish) -> Excitation:
    """With rest before and after: as stated, or as pulses want it."""
    before, after = REST if signal in UNITS_OF else (0, 0)
    unit = plan.duration / UNITS_OF.get(signal, 1)
    lead = before * unit if wish.lead is None else wish.lead
    return plan.with_rest(lead, after * unit if wish.tail is None else wish.tail)


def _named(
    plan: Excitation,
    names: Sequence[str],
    plant: Estimate | TransferFunction | None,
    stated: str,
) -> Excitation:
    """The plan under the names that were given, else those of the plant, with its units."""
    own = () if plant is None else plant.input_names
    if len(own) != plan.n_inputs:
        own = tuple(names or plan.input_names)
        return plan.named(own, dict.fromkeys(own, stated) if stated else None)
    known = getattr(plant, "units", None) or {}
    called = tuple(names) or own
    units = {
        new: known.get(old, stated)
        for new, old in zip(called, own, strict=False)
        if known.get(old, stated)
    }
    return plan.named(called, units)


def _band(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError as error:
        raise OptionError.found(
            "--band ", text, "two frequencies in rad/s", "write for example --band 0.5,20"
        ) from error
    return low, high


def _refuse_idle(signal: Signal, wish: Wish) -> None:
    """Refuse options that the signal does not have."""
    every = set().union(*USED.values())
    idle = sorted(key for key in every - USED[signal] if getattr(wish, key) is not None)
    if idle:
        options = ", ".join("--" + key.replace("_", "-") for key in idle)
        known = ", ".join("--" + key.replace("_", "-") for key in sorted(USED[signal]))
        raise OptionError(
            f"found {options} with {signal}; expected only {known} besides the common ones; "
            "leave it out"
        )
    if len(wish.inputs or ()) > 1 and signal not in SEVERAL:
        raise OptionError(
            f"found {len(wish.inputs or ())} inputs with {signal}; expected one, or a prbs or "
            "multisine; make one file for each"
        )


def _needed(option: str, value: Any) -> Any:
    if value is None:
        raise OptionError(
            f"found no --{option}; expected it for this signal; see tridentify excite --help"
        )
    return value


def _made(
    signal: Signal, wish: Wish, dt: float, size: float, plant: Estimate | TransferFunction | None
) -> Excitation:
    """The signal as its own options ask for it."""
    from tridentify import excitation

    band, n_inputs = _band(wish.band), max(len(wish.inputs or ()), 1)
    periods = 1 if wish.periods is None else wish.periods
    _refuse_idle(signal, wish)
    if signal == "prbs":
        order = 7 if wish.order is None else wish.order
        return excitation.prbs(
            order,
            dt=dt,
            clock=wish.clock,
            levels=(-size, size),
            periods=periods,
            n_inputs=n_inputs,
        )
    if signal == "multisine":
        duration, within = _needed("duration", wish.duration), _needed("band", band)
        return excitation.multisine(
            duration, dt=dt, band=within, n_inputs=n_inputs, amplitude=size, periods=periods
        )
    if signal == "chirp":
        within, duration = _needed("band", band), _needed("duration", wish.duration)
        return excitation.chirp(within, duration, dt=dt, amplitude=size)
    if signal == "optimal":
        best = excitation.optimal_spectrum(
            _needed("model", plant), coefficients=wish.coefficient, band=band, limit=size
        )
        return best.excitation(
            wish.duration, dt, shape="binary" if wish.binary else "multisine", periods=periods
        )
    if wish.width is None and wish.for_frequency is None:
        raise OptionError(
            "found no --width and no --for-frequency; expected one of the two; give the width of "
            "a pulse in s, or the natural frequency of the mode to be excited in rad/s"
        )
    make = excitation.doublet if signal == "doublet" else excitation.three_two_one_one
    return make(size, wish.width, dt=dt, for_frequency=wish.for_frequency)
