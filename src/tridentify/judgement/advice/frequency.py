"""Measured frequency response and coherence of records, without a model.

The lines of the spectra around a frequency are explained by a response and by what leaks in from
the ends of each stretch, both smooth in frequency or with a pole nearby (`advice.local`). A window
in time, as in Welch's method, would smear a short manoeuvre's response over the lines; here the
ends are unknowns, so that one short record has no leakage, several share the response, and the
lines left over beyond the unknowns give the variance of the noise. Several inputs are fitted
together, so each has its own response although the inputs are alike.

*Coherence* is partial: of the variance at the output that the other inputs, the ends and the drift
do not explain, the share that this input explains, both counted per degree of freedom, so that
noise alone gives zero on average.

*What it cannot do.* Two resonances inside of one window are flattened, and what they leave over
widens the standard error. Noise on the input biases the response towards zero. Under feedback
the response leans to minus the inverse of the controller.

Reference: R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd ed.,
Wiley (2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import DataError, TooFewSamplesError
from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.estimation.methods.base import check_signals, check_times
from tridentify.judgement.advice.local import DEGREE, Window, local_responses
from tridentify.judgement.advice.spectra import Stretch, Told, stretches
from tridentify.numerics.arrays import Array, Complex, Flags
from tridentify.record.listed import listed
from tridentify.record.record import Record

SPARE = 8
"""Lines beyond the unknowns, at least: the variance of the noise is known to 35 %."""

REACH = 0.07
"""Half width of a window in its frequency, where that holds more lines than are needed."""

MOST = 300
"""Lines of a window, at most, where the input has power on all: more would cost time and hide
resonances."""

GROWN = 6.0
"""Widening of a window, at most, until the input has enough lines in it (few tones, periods)."""

APART = 0.04
"""Distance of neighbouring frequencies in the result, in their frequency; a line at least."""

EXCITED = 1e-3
"""Power of an input near a frequency, in its largest, from which the frequency is excited: -30 dB
is what a doublet still has a decade above its peak."""

GOOD = 0.6
"""Coherence from which a measured point is shown in full."""


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Frequency response, its standard error and coherence, as measured.

    Attributes
    ----------
    omega : (n_omega,) array
        Angular frequencies [rad/s].
    response : (n_omega, n_outputs, n_inputs) complex array
        ``nan`` where the record does not tell it.
    std : (n_omega, n_outputs, n_inputs) array
        Root mean square of the error's size, for real and imaginary part together.
    coherence : (n_omega, n_outputs, n_inputs) array
        Partial coherence, 0 to 1.
    power : (n_omega, n_inputs) array
        Of the inputs near each frequency, in its largest.
    input_names, output_names : tuple of str
    notes : tuple of str
        What was done to the samples.

    Examples
    --------
    >>> from tridentify import Record, TransferFunction, simulate
    >>> u = np.random.default_rng(0).standard_normal(1000)
    >>> y = simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=0.05))
    >>> measured = frequency_response(Record(u, y, dt=0.05))
    >>> k = np.argmin(abs(measured.omega - 2.0))
    >>> round(float(abs(measured.response[k, 0, 0])), 2)
    0.71
    """

    omega: Array
    response: Complex
    std: Array
    coherence: Array
    power: Array
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @cached_property
    def excited(self) -> Flags:
        """(n_omega, n_inputs), where an input has power."""
        return np.asarray(self.power > EXCITED)

    @cached_property
    def good(self) -> Flags:
        """(n_omega, n_outputs, n_inputs), where a point is worth believing."""
        return np.asarray(self.excited[:, None, :] & (self.coherence >= GOOD))

    def band(self, input_: int = 0) -> tuple[float, float] | None:
        """Lowest and highest excited frequency of an input [rad/s]; None where there is none.

        Parameters
        ----------
        input_ : int
            Position of the input.
        """
        return _ends(self.omega, self.excited[:, input_])

    def seen(self, output: int = 0, input_: int = 0) -> tuple[float, float] | None:
        """Lowest and highest frequency with a good point [rad/s]; None where there is none.

        Parameters
        ----------
        output, input_ : int
            Positions of the channel.
        """
        return _ends(self.omega, self.good[:, output, input_])

    def to_dict(self) -> dict[str, object]:
        """Plain numbers and text, as for JSON; None for what is not known."""

        def plain(values: Array) -> object:
            boxed = values.astype(object)
            boxed[~np.isfinite(values)] = None
            return boxed.tolist()

        return {
            "omega": self.omega.tolist(),
            "magnitude": plain(np.abs(self.response)),
            "phase_deg": plain(np.degrees(np.angle(self.response))),
            "std": plain(self.std),
            "coherence": plain(self.coherence),
            "excited": self.excited.tolist(),
            "inputs": list(self.input_names),
            "outputs": list(self.output_names),
            "notes": list(self.notes),
        }


def _ends(omega: Array, flags: Flags) -> tuple[float, float] | None:
    at = np.flatnonzero(flags)
    return (float(omega[at[0]]), float(omega[at[-1]])) if at.size else None


def frequency_response(records: Record | Sequence[Record]) -> FrequencyResponse:
    """Measure frequency response and coherence of every channel.

    Parameters
    ----------
    records : Record or sequence of Record
        Experiments on one system.

    Returns
    -------
    FrequencyResponse
        Up to half the Nyquist frequency: above, what folds back is not small.

    Raises
    ------
    SampleTypeError
        Something else in place of a record.
    DataError
        No record, or records of different channels.
    ScaleError
        Signals or times whose squares have no room in a float.
    TooFewSamplesError
        No uninterrupted stretch is long enough.

    Examples
    --------
    >>> u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 100), 4)
    >>> y = np.roll(u, 2)
    >>> measured = frequency_response(Record(u, y, dt=0.1))
    >>> round(float(np.median(measured.coherence)), 1)
    1.0
    """
    given = listed(records)
    check_surveyed(given)
    first = given[0]
    cut = [stretches(given, i) for i in range(first.n_outputs)]
    for (parts, _), name in zip(cut, first.output_names, strict=True):
        lines = sum(part.omega.size for part in parts)
        needed = (DEGREE + 1) * (first.n_inputs + len(parts)) + 1 + SPARE
        if lines < needed:
            do = "record longer, or leave inputs out"
            if any(record.dt is None for record in given):
                do = "resample to even time before (record.resample)"
            raise TooFewSamplesError(
                f"found {lines} lines in the spectrum of output {name} (stretches of at least 32 "
                f"samples without a gap); expected {needed} for {first.n_inputs} inputs; {do}"
            )
    omega = _frequencies([part for parts, _ in cut for part in parts])
    size = (omega.size, first.n_outputs, first.n_inputs)
    response, std = np.full(size, np.nan, dtype=complex), np.full(size, np.inf)
    coherence, power = np.zeros(size), np.zeros((omega.size, first.n_inputs))
    for i, (parts, _) in enumerate(cut):
        joined = _Lines.of(parts)
        windows = [joined.near(float(one)) for one in omega]
        found = local_responses(windows)
        response[:, i], std[:, i] = found.response, found.std
        coherence[:, i] = found.coherence
        own = [np.mean(np.abs(window.inputs) ** 2, axis=0) for window in windows]
        power = np.maximum(power, own)
    largest = power.max(axis=0)
    power = power / np.where(largest > 0, largest, 1.0)
    notes = tuple(dict.fromkeys(note for _, told in cut for note in _in_words(told)))
    return FrequencyResponse(
        omega, response, std, coherence, power, first.input_names, first.output_names, notes
    )


def check_surveyed(records: Sequence[Record]) -> None:
    """Refuse no records, records of different channels, and numbers without room.

    Raises
    ------
    DataError, ScaleError
    """
    if not records:
        raise DataError("found no record; expected at least one; pass a record or several")
    names = {(r.input_names, r.output_names) for r in records}
    if len(names) > 1:
        raise DataError(
            f"found records of {len(names)} different sets of channels; expected the same inputs "
            "and outputs in all; use record.select"
        )
    check_signals(records)
    check_times(records)


def _frequencies(parts: Sequence[Stretch]) -> Array:
    """From the first line on, a line or 4 % apart."""
    apart = min(float(part.omega[0]) for part in parts)
    highest = max(float(part.omega[-1]) for part in parts)
    found = [apart]
    while (step := max(apart, APART * found[-1])) + found[-1] <= highest:
        found.append(found[-1] + step)
    return np.array(found)


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines of all stretches, sorted by frequency."""

    omega: Array
    inputs: Complex
    output: Complex
    ramp: Complex
    owner: NDArray[np.intp]

    @classmethod
    def of(cls, parts: Sequence[Stretch]) -> _Lines:
        omega = np.concatenate([part.omega for part in parts])
        order = np.argsort(omega, kind="stable")
        owner = np.concatenate([np.full(part.omega.size, e) for e, part in enumerate(parts)])
        return cls(
            omega[order],
            np.vstack([part.inputs for part in parts])[order],
            np.concatenate([part.output for part in parts])[order],
            np.concatenate([part.ramp for part in parts])[order],
            owner[order],
        )

    def near(self, centre: float) -> Window:
        """The lines of a window: enough for the unknowns, and enough where the input is."""
        away = np.abs(self.omega - centre)
        n_inputs, n_parts = self.inputs.shape[1], int(self.owner.max()) + 1
        needed = (DEGREE + 1) * (n_inputs + n_parts) + n_parts + SPARE
        ordered = np.sort(away)
        closest, farthest = (ordered[min(most, away.size) - 1] for most in (needed, MOST))
        least = max(float(closest), min(REACH * centre, float(farthest)))
        half = least
        while half < GROWN * least:
            if self._carried(away <= half) >= (DEGREE + 1) * n_inputs + 1:
                break
            half *= 1.25
        at = away <= half * (1.0 + 1e-9)
        x = (self.omega[at] - centre) / half
        near_zero = bool(self.omega[at][0] <= 2.0 * needed * self.omega[0])
        return Window(x, self.inputs[at], self.output[at], self._ends(at, x, near_zero))

    def _ends(self, at: Flags, x: Array, near_zero: bool) -> Complex:
        """What leaks in from the ends of every stretch; near zero a drift is not smooth."""
        owner = self.owner[at]
        own = (owner[:, None] == np.unique(owner)).astype(float)
        powers = x[:, None] ** np.arange(DEGREE + 1)
        smooth = (own[:, :, None] * powers[:, None, :]).reshape(x.size, -1).astype(complex)
        return np.hstack([smooth, own * self.ramp[at][:, None]]) if near_zero else smooth

    def _carried(self, at: Flags) -> float:
        """How many lines the power of the inputs is spread over, of the input with fewest."""
        power = np.abs(self.inputs[at]) ** 2
        total = power.sum(axis=0)
        spread = total**2 / np.maximum((power**2).sum(axis=0), 1e-300)
        return float(np.min(np.where(total > 0, spread, np.inf)))


def _in_words(told: Told) -> list[str]:
    """What was done to the samples."""
    words = []
    if told.bridged:
        words.append(f"{told.bridged} missing samples bridged by straight lines")
    if told.dropped:
        words.append(
            f"{told.dropped} samples left out, in gaps or in stretches of fewer than 32 samples"
        )
    return words
