"""The numbers behind the pictures: fit, residual, Bode, step response, poles and zeros."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from tridentify.app.plain import listed, number
from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.advice import FrequencyResponse, frequency_response
from tridentify.judgement.comparison import Comparison, compare
from tridentify.judgement.validation import Validation, validate
from tridentify.judgement.validation.result import Check
from tridentify.numerics.arrays import Array
from tridentify.record.checks.times import typical_step
from tridentify.record.formats.channels import Channel
from tridentify.record.formats.series import Series
from tridentify.record.record import Record
from tridentify.uncertainty import poles, response_band, step_band, zeros
from tridentify.writing.layout import p_in_words

FREQUENCIES, INSTANTS = 200, 240
"""Of a curve that is drawn."""
SETTLED = 6.0
"""Slowest time constants that a step response is shown for."""
LEVEL = 0.95
FARTHEST_ZERO = 20.0
"""Size of a zero over that of the fastest pole, beyond which it is far out of the band: drawn, it
would leave no room for the rest."""
ASKED: Mapping[str, str] = MappingProxyType(
    {
        "white": "its unexplained part is white",
        "past inputs": "not correlated with past inputs",
        "feedback": "not correlated with later inputs",
        "level": "its level does not wander",
        "scale": "its size does not change",
        "coefficients constant": "the coefficients are constant",
        "linear": "no powers of the signals in it",
        "Gaussian": "Gaussian",
        "size of the noise": "as large as the estimate expects",
    }
)
"""What each test of the residual asks, in words."""
LONGEST_TESTED = 20_000
"""Samples that are tested while one waits: a second."""


def _pairs(
    outputs: Sequence[str], inputs: Sequence[str], numbers: Callable[[int, int], dict[str, Any]]
) -> list[dict[str, Any]]:
    """A document for every output and input, with their names."""
    return [
        {"output": output, "input": source, **numbers(i, j)}
        for i, output in enumerate(outputs)
        for j, source in enumerate(inputs)
    ]


def mean_fits(found: Comparison) -> Array:
    """(n_models, n_outputs) fits, over all records."""
    return np.asarray(np.mean(found.fits, axis=1))


def _thin(record: Record, y: Array, pixels: int, t0: float) -> tuple[Array, Array]:
    """Instants and values as they are drawn: least and largest of each column in turn."""
    one = Series(Channel("", ""), record.t, y)
    drawn = one.thinned(float(record.t[0]), float(record.t[-1]), max(pixels // 2, 50))
    if not drawn.thinned:
        return drawn.t - t0, drawn.minimum
    half = 0.25 * float(drawn.t[1] - drawn.t[0]) if drawn.t.size > 1 else 0.0
    t = np.column_stack([drawn.t - half, drawn.t + half]).ravel() - t0
    return t, np.column_stack([drawn.minimum, drawn.maximum]).ravel()


def _drawn(
    records: Sequence[Record], values: Sequence[Array], pixels: int, t0: float
) -> list[list[float | None]]:
    """Times and values of experiments one after the other, with a gap that is not drawn."""
    parts = [_thin(record, y, pixels, t0) for record, y in zip(records, values, strict=True)]
    gap = np.array([np.nan])
    joined = (
        [piece for part in column for piece in (part, gap)][:-1]
        for column in zip(*parts, strict=True)
    )
    return [listed(np.concatenate(pieces)) for pieces in joined]


def fit(estimate: Estimate, records: Sequence[Record], pixels: int, t0: float) -> dict[str, Any]:
    """Measured against model, offset and initial state refitted to the record."""
    found = compare([estimate], list(records))
    outputs = []
    for i, name in enumerate(estimate.output_names):
        own = [np.asarray(response)[:, i] for response in found.responses[0]]
        measured = _drawn(records, [record.y[:, i] for record in records], pixels, t0)
        parts = {"measured": measured[1], "model": _drawn(records, own, pixels, t0)[1]}
        head = {"name": name, "unit": records[0].units.get(name, ""), "time": measured[0]}
        outputs.append({**head, **parts, "low": None, "high": None})
    return {"outputs": outputs}


def residual(
    estimate: Estimate, records: Sequence[Record], pixels: int, t0: float
) -> dict[str, Any]:
    """What the model leaves, and the tests that judge it."""
    all_of_them = sum(record.n_samples for record in records)
    records = _stretches(records)
    judged = sum(record.n_samples for record in records)
    try:
        found = validate(estimate, list(records))
    except TridentifyError as error:
        return {"outputs": [_untested(name, str(error)) for name in estimate.output_names]}
    stretch = "" if judged == all_of_them else f"the first {judged:,} samples"
    outputs = []
    for i, name in enumerate(found.output_names):
        left = [one[:, i] for one in found.residual]
        time, values = _drawn(records, left, pixels, t0)
        outputs.append(
            {
                "name": name,
                "time": time,
                "residual": values,
                **_correlations(found, i),
                "stretch": stretch,
                "tests": [
                    {"name": test.name, "passed": not test.rejected, "text": _told(test)}
                    for test in found.tests
                    if test.output == name
                ],
            }
        )
    return {"outputs": outputs}


def _told(test: Check) -> str:
    """What a test asks, and how likely the record is if that is so."""
    return f"{ASKED.get(test.name, test.name)}: {p_in_words(test.p_value)}"


def _stretches(records: Sequence[Record]) -> list[Record]:
    """The first samples of each record, as many as are tested while one waits."""
    most = max(LONGEST_TESTED // len(records), 100)
    return [
        record if record.n_samples <= most else record.slice(None, record.t[most - 1])
        for record in records
    ]


def _untested(name: str, why: str) -> dict[str, Any]:
    test = {"name": "tests", "passed": False, "text": f"could not be tested: {why}"}
    none: dict[str, Any] = {key: [] for key in ("time", "residual", "lags", "autocorrelation")}
    rest = {"correlation_limit": 0.0, "crosscorrelation": {}, "stretch": "", "tests": [test]}
    return {"name": name, **none, **rest}


def _correlations(found: Validation, i: int) -> dict[str, Any]:
    if not found.whiteness:
        return {
            "lags": [], "autocorrelation": [], "correlation_limit": 0.0, "crosscorrelation": {}
        }  # fmt: skip
    own = found.whiteness[i]
    across = {}
    n = len(found.input_names)
    for j, name in enumerate(found.input_names):
        one = found.cross_correlation[n * i + j]
        at = np.searchsorted(one.lags, own.lags)
        inside = at < one.lags.size
        values = np.full(own.lags.size, np.nan)
        values[inside] = one.correlation[at[inside]]
        across[name] = listed(values)
    return {
        "lags": listed(own.lags),
        "autocorrelation": listed(own.autocorrelation),
        "correlation_limit": number(float(np.median(own.bound))),
        "crosscorrelation": across,
    }


def bode(estimate: Estimate, records: Sequence[Record], pixels: int, t0: float) -> dict[str, Any]:
    """Magnitude and phase with their bands, and what was measured."""
    omega = _frequencies(estimate, records)
    band = response_band(estimate, omega, level=LEVEL)
    try:
        seen: FrequencyResponse | None = frequency_response(_stretches(records))
    except TridentifyError:
        seen = None

    def numbers(i: int, j: int) -> dict[str, Any]:
        phase = band.phase[:, i, j]
        turn = _turn(float(phase[0]))
        return {
            "frequency": listed(omega),
            "magnitude_db": _decibels(band.magnitude[:, i, j]),
            "magnitude_low": _decibels(band.magnitude_low[:, i, j]),
            "magnitude_high": _decibels(band.magnitude_high[:, i, j]),
            "phase_deg": listed(np.degrees(phase + turn)),
            "phase_low": listed(np.degrees(band.phase_low[:, i, j] + turn)),
            "phase_high": listed(np.degrees(band.phase_high[:, i, j] + turn)),
            "measured": None if seen is None else _measured(seen, i, j, phase + turn, omega),
        }

    return {"pairs": _pairs(estimate.output_names, estimate.input_names, numbers)}


def _turn(first: float) -> float:
    """Whole turns that bring the phase at the lowest frequency into -190 to 170 degrees.

    A gain that is negative begins at -180 degrees then, whichever way rounding falls.
    """
    return -2.0 * np.pi * math.floor((first + math.radians(190.0)) / (2.0 * np.pi))


def _decibels(size: Array) -> list[float | None]:
    with np.errstate(divide="ignore", invalid="ignore"):
        return listed(20.0 * np.log10(size))


def _frequencies(estimate: Estimate, records: Sequence[Record]) -> Array:
    """From a decade below the slowest pole to the Nyquist frequency."""
    step = min(typical_step(record.t) for record in records)
    size = np.abs(poles(estimate).roots)
    size = size[size > 0.0]
    longest = max(float(record.t[-1] - record.t[0]) for record in records)
    highest = np.pi / step
    slowest = float(size.min()) if size.size else highest / 100.0
    lowest = min(max(slowest / 10.0, 0.2 / longest), highest / 30.0)
    return np.geomspace(lowest, highest, FREQUENCIES)


def _measured(
    seen: FrequencyResponse, i: int, j: int, phase: Array, omega: Array
) -> dict[str, Any] | None:
    """The measured response on the branch of the model's phase."""
    kept = np.isfinite(seen.response[:, i, j]) & (np.abs(seen.response[:, i, j]) > 0.0)
    if not kept.any():
        return None
    response = seen.response[kept, i, j]
    at = seen.omega[kept]
    near = np.interp(np.log(at), np.log(omega), phase)
    angle = np.angle(response)
    angle = angle + 2.0 * np.pi * np.round((near - angle) / (2.0 * np.pi))
    return {
        "frequency": listed(at),
        "magnitude_db": _decibels(np.abs(response)),
        "phase_deg": listed(np.degrees(angle)),
        "coherence": listed(seen.coherence[kept, i, j]),
    }


def measured(seen: FrequencyResponse) -> list[dict[str, Any]]:
    """The measured response of every pair, without a model."""

    def numbers(i: int, j: int) -> dict[str, Any]:
        response = seen.response[:, i, j]
        return {
            "frequency": listed(seen.omega),
            "magnitude_db": _decibels(np.abs(response)),
            "phase_deg": listed(np.degrees(np.unwrap(np.angle(response)))),
            "coherence": listed(seen.coherence[:, i, j]),
        }

    return _pairs(seen.output_names, seen.input_names, numbers)


def step(estimate: Estimate, records: Sequence[Record], pixels: int, t0: float) -> dict[str, Any]:
    """Response to a unit step, with its band."""
    decay = np.abs(poles(estimate).roots.real)
    decay = decay[decay > 0.0]
    longest = max(float(record.t[-1] - record.t[0]) for record in records)
    end = min(SETTLED / float(decay.min()), longest) if decay.size else longest
    t = np.linspace(0.0, end, INSTANTS)
    band = step_band(estimate, t, LEVEL)

    def numbers(i: int, j: int) -> dict[str, Any]:
        parts = {"value": band.response, "low": band.low, "high": band.high}
        return {"time": listed(t), **{key: listed(one[:, i, j]) for key, one in parts.items()}}

    return {"pairs": _pairs(estimate.output_names, estimate.input_names, numbers)}


def poles_and_zeros(
    estimate: Estimate, records: Sequence[Record], pixels: int, t0: float
) -> dict[str, Any]:
    """Places in the complex plane."""

    def numbers(i: int, j: int) -> dict[str, Any]:
        return {"zeros": _zeros(estimate, i, j)}

    pairs = _pairs(estimate.output_names, estimate.input_names, numbers)
    return {"poles": _roots(poles(estimate).roots), "zeros": pairs[0]["zeros"], "pairs": pairs}


def _zeros(estimate: Estimate, i: int, j: int) -> list[dict[str, Any]]:
    try:
        found = zeros(estimate, i, j).roots
        nearby = FARTHEST_ZERO * float(np.max(np.abs(poles(estimate, i, j).roots), initial=0.0))
        return _roots(found[np.abs(found) <= nearby])
    except TridentifyError:
        return []


def _roots(found: Any) -> list[dict[str, Any]]:
    return [
        {
            "re": number(root.real),
            "im": number(root.imag),
            "frequency": number(abs(root)),
            "damping": number(-root.real / abs(root)) if root else None,
        }
        for root in np.asarray(found, dtype=complex).tolist()
    ]


Picture = Callable[[Estimate, Sequence[Record], int, float], dict[str, Any]]

PANELS: Mapping[str, Picture] = MappingProxyType(
    {"fit": fit, "residual": residual, "bode": bode, "step": step, "poles": poles_and_zeros}
)
"""The pictures of a model, by name."""
