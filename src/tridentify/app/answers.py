"""What is shown of a model in words and numbers, in the order in which it is asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tridentify.app.lines import columns_of, model_in_python, model_in_shell
from tridentify.app.plain import findings, number
from tridentify.app.sources import pieces
from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.parameter import Parameter
from tridentify.judgement.comparison import compare
from tridentify.judgement.validation import validate
from tridentify.options import known_parameters, method_of
from tridentify.physical import MODELS, estimate_physical
from tridentify.physical.result import AS_WELL
from tridentify.record.record import Record
from tridentify.report.first_screen import (
    NUMBERS,
    as_sentence,
    headline_of,
    in_order,
    is_result,
    trust_of,
)
from tridentify.uncertainty import derived

LEVEL = 0.95


def described(
    estimate: Estimate, record: Record | None, card: Mapping[str, Any], chosen: Mapping[str, str]
) -> dict[str, Any]:
    """Sentence, numbers, doubts, coefficients, physical parameters, lines, validation.

    Parameters
    ----------
    estimate : Estimate
    record : Record or None
        None where its file is gone.
    card : mapping
        Of the record.
    chosen : mapping of str to str
        Options.
    """
    physical, told, notes = _physical(record, card, chosen)
    fits, doubts = _validated(estimate, record, card)
    shared = shared_time(card)
    told_shared = f"{shared}: there the model is tested by what it was made from." if shared else ""
    found = [*estimate.findings]
    sentence = " ".join([headline_of(estimate, found), trust_of(estimate, found)]).strip()
    return {
        "sentence": f"{sentence} {told}".strip(),
        "numbers": [_row(one) for one in _key_numbers(estimate)],
        "findings": findings(found),
        "parameters": [_row(one) for one in estimate.parameters.values()],
        "derived": [_row(one) for one in derived(estimate)],
        "physical": physical,
        "physical_notes": notes,
        "python": model_in_python(card, chosen),
        "command_line": model_in_shell(card, chosen),
        "outputs": list(estimate.output_names),
        "validation_fit": fits,
        "validation_findings": doubts,
        "validation_note": told_shared,
    }


def shared_time(card: Mapping[str, Any]) -> str:
    """Where ranges for validation are identified, too; nothing where none is.

    Examples
    --------
    >>> ranges = [(0.0, 6.0, "identify"), (5.0, 9.0, "validate")]
    >>> shared_time({"ranges": [dict(zip(("start", "end", "use"), one)) for one in ranges]})
    'The ranges to identify and for validation share 5 to 6 s'
    """
    made, tested = (
        [(one["start"], one["end"]) for one in card["ranges"] if one["use"] == use]
        for use in ("identify", "validate")
    )
    if tested and not made:
        return "The whole record is identified, the range for validation with it"
    both = sorted((max(a, c), min(b, d)) for a, b in made for c, d in tested)
    told = [f"{start:.5g} to {end:.5g} s" for start, end in both if start < end]
    if not told:
        return ""
    return f"The ranges to identify and for validation share {' and '.join(told)}"


def _row(one: Any) -> dict[str, Any]:
    low, high = one.interval(LEVEL)
    held = one.std == 0 and isinstance(one, Parameter)
    return {
        "name": one.name,
        "value": number(one.value),
        "std": number(one.std),
        "low": number(low),
        "high": number(high),
        "unit": one.unit,
        "status": "fixed" if held else "free",
    }


def _key_numbers(estimate: Estimate) -> list[Any]:
    """Delays, the slowest mode and the gain as far as they are determined, then coefficients."""
    first, others = in_order(estimate)
    told = [one for one in first if is_result(one)]
    return [*told, *sorted(others, key=lambda one: not is_result(one))][:NUMBERS]


def _validated(
    estimate: Estimate, record: Record | None, card: Mapping[str, Any]
) -> tuple[list[float | None] | None, list[dict[str, Any]] | None]:
    """Fit and doubts on the ranges for validation; None where there are none."""
    if record is None:
        return None, None
    others = pieces(record, card, "validate")
    if not others:
        return None, None
    try:
        fits = np.mean(compare([estimate], others).fits[0], axis=0)
        found: Sequence[Finding] = validate(estimate, others).findings
    except TridentifyError as error:
        said = Finding("unmodelled-response", "warning", f"It could not be tested: {error}", "")
        return None, findings([said])
    return [number(float(fit)) for fit in fits], findings(found)


def _physical(
    record: Record | None, card: Mapping[str, Any], chosen: Mapping[str, str]
) -> tuple[list[dict[str, Any]] | None, str, list[str]]:
    """Parameters of the map that is asked for; why, where there are none; and what to know."""
    if chosen["physical"] == "none" or record is None:
        return None, "", []
    model = MODELS[chosen["physical"]]()
    channels = columns_of(model, record.input_names, record.output_names)
    try:
        found = estimate_physical(
            model,
            pieces(record, card, "identify"),
            method_of({**chosen, "loss": "squared"}),
            known=known_parameters(chosen),
            channels=channels,
        )
    except TridentifyError as error:
        return None, f"The map {chosen['physical']} gives nothing: {error}.", []
    spread = np.sqrt(np.diag(found.cov))
    rows = [
        Parameter(name, float(value), float(std), unit)
        for name, value, std, unit in zip(
            found.names, found.values, spread, found.units, strict=True
        )
    ]
    rows += list(found.combinations)
    taken = [f"{ours} is {theirs}" for ours, theirs in channels.items() if ours != theirs]
    said = [f"channels by their names: {', '.join(taken)}"] if taken else []
    notes = [as_sentence(one) for one in [*_few(found.notes), *said]]
    return [_physical_row(one) for one in rows], "", notes


def _few(notes: Sequence[str]) -> list[str]:
    """Notes, of sets of parameters that do as well the first alone, with what to do."""
    others = [one for one in notes if one.startswith(AS_WELL)]
    if not others:
        return list(notes)
    rest = len(others) - 1
    more = f", and {rest} other sets" if rest > 1 else ", and another set" if rest else ""
    told = f"{others[0].rstrip('.')}{more}; state what is known beforehand under Known parameters"
    return [told, *(one for one in notes if one not in others)]


def _physical_row(one: Parameter) -> dict[str, Any]:
    if np.isfinite(one.value):
        return _row(one)
    none = dict.fromkeys(("value", "std", "low", "high"))
    return {"name": one.name, **none, "unit": one.unit, "status": "not determined"}
