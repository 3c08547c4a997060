"""What a report says first: of what, one sentence of result and trust, the numbers that matter."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.answer.finding import CODES, Finding
from tridentify.estimation.answer.parameter import Parameter
from tridentify.estimation.answer.trust import HEADS, class_of, unusable
from tridentify.judgement.validation.result import ABOUT_NOISE
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.uncertainty import derived
from tridentify.writing.layout import IN_TABLES, format_std, format_value, short

NUMBERS = 4
"""Shown first."""

LONGEST_TITLE = 40
"""Characters of a name in the heading."""

LATE = 0.5
"""Standard error over the value, from which a number is no result."""


class KeyNumber(NamedTuple):
    """One of the numbers shown first."""

    label: str
    value: str
    error: str = ""
    unit: str = ""


def title_of(output_names: Sequence[str], input_names: Sequence[str]) -> str:
    """The channels.

    Examples
    --------
    >>> title_of(["q", "alpha"], ["elevator"])
    'q, alpha from elevator'
    """
    sides = (
        ", ".join(short(name, LONGEST_TITLE) for name in names)
        for names in (output_names, input_names)
    )
    return " from ".join(sides)


def subtitle_of(records: Sequence[Record]) -> str:
    """Names, experiments, samples, sampling, duration of the records, and the day of today.

    Parameters
    ----------
    records : sequence of Record

    Returns
    -------
    str
    """
    today = datetime.now(UTC)
    day = f"{today.day} {today:%B %Y}"
    if not records:
        return day
    names = ", ".join(dict.fromkeys(short(r.name, IN_TABLES) for r in records if r.name))
    several = f"{len(records)} experiments" if len(records) > 1 else ""
    samples = sum(record.n_samples for record in records)
    steps = {record.dt for record in records}
    step = next(iter(steps))
    if len(steps) == 1 and step is not None:
        sampling = f"every {step:.4g} s"
    else:
        gaps = np.concatenate([np.diff(record.t) for record in records])
        sampling = f"{gaps.min():.3g} to {gaps.max():.3g} s apart"
    duration = sum(float(record.t[-1] - record.t[0]) for record in records)
    parts = (names, several, f"{samples:,} samples {sampling}, {duration:.4g} s", day)
    return " \N{MIDDLE DOT} ".join(part for part in parts if part)


def orders_in_words(structure: Structure) -> str:
    """Poles and zeros, as one says them.

    Examples
    --------
    >>> orders_in_words(Structure(2, 1)), orders_in_words(Structure(1, 0))
    ('2 poles and 1 zero', '1 pole and no zero')
    """
    return f"{_count(structure.poles, 'pole')} and {_count(structure.zeros, 'zero')}"


def _count(given: object, what: str) -> str:
    values = np.ravel(np.asarray(given, dtype=int))
    low, high = int(values.min()), int(values.max())
    if low < high:
        return f"{low} to {high} {what}s"
    return f"{low or 'no'} {what}{'s' if low > 1 else ''}"


def fits_in_words(names: Sequence[str], fits: Sequence[float]) -> str:
    """How well each output is followed.

    Examples
    --------
    >>> fits_in_words(["q"], [94.1234]), fits_in_words(["q", "alpha"], [94.1234, 93.0])
    ('94.1 % of q', '94.1 % of q, 93.0 % of alpha')
    """
    pairs = zip(names, fits, strict=True)
    return ", ".join(f"{fit:.1f} % of {short(name, LONGEST_TITLE)}" for name, fit in pairs)


def headline_of(estimate: Estimate, findings: Sequence[Finding]) -> str:
    """What was found, in one sentence."""
    if why := unusable(estimate, findings):
        return why
    fits = fits_in_words(estimate.output_names, estimate.fit.tolist())
    words = orders_in_words(estimate.structure)
    return f"{HEADS[class_of(estimate, findings)]}: a model of {words} fits {fits}."


def trust_of(estimate: Estimate, findings: Sequence[Finding], tested: bool = True) -> str:
    """How far to trust it, in one sentence.

    Parameters
    ----------
    estimate : Estimate
    findings : sequence of Finding
        Ranked.
    tested : bool
        Whether the residual could be tested.
    """
    if not estimate.status.ok:
        return ""
    doubts = [finding for finding in findings if finding.matters]
    said = []
    if headline := unusable(estimate, findings):
        others = [CODES[one.code] for one in doubts if CODES[one.code] not in headline]
        return f"Besides: {'; '.join(list(dict.fromkeys(others))[:2])}." if others else ""
    if estimate.status is not Status.CONVERGED:
        said.append(as_sentence(estimate.status.message))
    if doubts:
        errors = all(finding.code in ABOUT_NOISE for finding in doubts)
        wrong = any(finding.severity == "error" for finding in doubts)
        held = (
            "The numbers may be wrong"
            if wrong and not errors
            else "The coefficients can be used, their standard errors with care"
            if errors
            else "Use the numbers with care"
        )
        reasons = list(dict.fromkeys(CODES[finding.code] for finding in doubts))[:2]
        said.append(f"{held}: {'; '.join(reasons)}.")
    elif estimate.status is Status.CONVERGED:
        said.append(
            "Nothing speaks against it: coefficients and standard errors can be used."
            if tested
            else "The residual could not be tested."
        )
    return " ".join(said)


def as_sentence(text: str) -> str:
    """With a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def key_numbers(estimate: Estimate) -> list[KeyNumber]:
    """The numbers that matter, by one rule for all models.

    The fit; delays that were estimated; natural frequency and damping of the slowest mode or its
    time constant, and the static gain, as far as they are determined; coefficients where room is
    left.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of KeyNumber
        At most `NUMBERS`.
    """
    fits = [f"{fit:.1f}" for fit in estimate.fit]
    label = f"fit of {title_names(estimate.output_names)}"
    found = [KeyNumber(label, " / ".join(fits[:3]) + (" ..." if len(fits) > 3 else ""), "", "%")]
    first, others = in_order(estimate)
    told = [item for item in (*first, *others) if item.std > 0.0 and is_result(item)]
    return [*found, *map(key_number, told[: NUMBERS - 1])]


def in_order(estimate: Estimate) -> tuple[list[Parameter], list[Parameter]]:
    """A delay, the slowest mode and the gain; and the coefficients that follow them."""
    coefficients = list(estimate.parameters.values())
    delays = [item for item in coefficients if item.name.startswith("delay")]
    quantities = [item for item in derived(estimate) if not item.name.startswith("real pole")]
    gains = [item for item in quantities if item.name.startswith("dc gain")]
    modes = [item for item in quantities if item not in gains][:2]
    others = [item for item in coefficients if item not in delays]
    return [*delays[:1], *modes, *gains[:1]], others


def key_number(item: Parameter) -> KeyNumber:
    """A quantity as it is shown first."""
    return KeyNumber(
        short(item.name, IN_TABLES),
        format_value(item.value, item.told_to),
        format_std(item.std),
        "" if item.unit == "-" else item.unit,
    )


def title_names(names: Sequence[str]) -> str:
    """Names in a label: three at most."""
    shown = " / ".join(short(name, LONGEST_TITLE) for name in names[:3])
    return shown + (" ..." if len(names) > 3 else "")


def is_result(item: Parameter) -> bool:
    """Whether a number is known to better than half of its size."""
    return bool(np.isfinite(item.value) and item.std < LATE * abs(item.value))
