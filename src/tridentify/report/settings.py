"""What a report says about data and options, and the lines that lead to the estimate again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.identify import METHODS
from tridentify.record.record import Record
from tridentify.report.tables import measured
from tridentify.writing.layout import as_call, format_std, format_sum, format_value

_ESTIMATED = {True: "estimated", False: "none", "auto": "chosen by AICc"}
_BETWEEN = {
    "zoh": "held between samples (zoh)",
    "foh": "linear between samples (foh)",
    "band-limited": "band-limited",
}


def settings_table(estimate: Estimate, records: Sequence[Record]) -> list[tuple[str, str]]:
    """Everything needed to tell which data and which options led here."""
    from tridentify import __version__

    structure = estimate.structure
    priors = structure.priors or {}
    states = [terms.initial_state for terms in estimate.nuisance]
    channels = (*estimate.output_names, *estimate.input_names)
    units = [f"{name} [{estimate.units[name]}]" for name in channels if name in estimate.units]
    rows = [
        ("method", estimate.call or estimate.method),
        ("poles", _per_channel(estimate, structure.poles)),
        ("zeros", _per_channel(estimate, structure.zeros)),
        ("delay", _delay_text(estimate)),
        ("offset", _ESTIMATED.get(structure.offset, "")),
        ("drift", _ESTIMATED.get(structure.drift, f"of degree {structure.drift}")),
        ("initial state", ", ".join(states) or f"{structure.initial_state}"),
        ("fixed", ", ".join(f"{k} = {v:g}" for k, v in (structure.fixed or {}).items())),
        ("bounds", ", ".join(_bound_text(k, *v) for k, v in (structure.bounds or {}).items())),
        ("equalities", "; ".join(_equality_text(*item) for item in structure.equalities or ())),
        ("priors", ", ".join(f"{k} = {m:g} +/- {s:g}" for k, (m, s) in priors.items())),
        ("static gain", _per_channel(estimate, structure.static_gain)),
        ("loss", _loss_text(estimate)),
        ("noise", _noise_text(estimate)),
        ("input between samples", _BETWEEN[estimate.intersample]),
        *record_rows(records),
        ("units", ", ".join(units)),
        ("degrees of freedom", f"{estimate.degrees_of_freedom}"),
        ("cost", measured(estimate.cost, 6)),
        ("AICc", measured(estimate.aicc, 6)),
        ("condition", measured(estimate.condition, 3)),
        ("relative gradient", measured(estimate.gradient)),
        ("data fingerprint (SHA-256)", estimate.record_fingerprint),
        ("written", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC by tridentify {__version__}"),
    ]
    return [(label, value) for label, value in rows if value]


def _per_channel(estimate: Estimate, given: object) -> str:
    """Orders, delays or gains: one for all channels, or each with the name of its channel."""
    if given is None:
        return ""
    if not isinstance(given, tuple):
        return f"{given}"
    parts = []
    for output, row in zip(estimate.output_names, given, strict=True):
        for source, item in zip(estimate.input_names, row, strict=True):
            parts.append(f"{output} / {source}: {'unknown' if item is None else item}")
    return ", ".join(parts)


def _delay_text(estimate: Estimate) -> str:
    given = estimate.structure.delay
    if given != "free":
        text = _per_channel(estimate, given)
        return f"{text} s" if not isinstance(given, tuple) else f"{text} [s]"
    found = [p for name, p in estimate.parameters.items() if name.startswith("delay")]
    each = [f"{p.name} = {format_value(p.value, p.std)} +/- {format_std(p.std)} s" for p in found]
    return f"estimated: {', '.join(each)}"


def _bound_text(name: str, low: float | None, high: float | None) -> str:
    left = "" if low is None else f"{low:g} <= "
    return f"{left}{name}{'' if high is None else f' <= {high:g}'}"


def _equality_text(weights: Mapping[str, float], value: float) -> str:
    return f"{format_sum(weights)} = {value:g}"


def _loss_text(estimate: Estimate) -> str:
    if estimate.loss == "squared":
        return "squared"
    columns = estimate.outliers[:, 1]
    counts = [f"{n}: {int(np.sum(columns == i))}" for i, n in enumerate(estimate.output_names)]
    return f"{estimate.loss}; outliers beyond four standard deviations: {', '.join(counts)}"


def _noise_text(estimate: Estimate) -> str:
    models = zip(estimate.output_names, estimate.noise_model, strict=True)
    return ", ".join(f"{n}: {f'AR({a.size})' if a.size else 'white'}" for n, a in models)


def record_rows(records: Sequence[Record]) -> list[tuple[str, str]]:
    """What every experiment is: name, stretch of time, samples, steps, gaps."""
    rows = []
    for number, record in enumerate(records, 1):
        steps = np.diff(record.t)
        step = (
            f"step {record.dt:.6g} s"
            if record.dt is not None
            else f"steps {steps.min():.4g} to {steps.max():.4g} s, not uniform"
        )
        missing = int(np.isnan(record.y).sum())
        lost = f", {missing:,} output samples missing" if missing else ""
        name = f"{record.name}: " if record.name else ""
        stretch = f"{record.t[0]:.6g} s to {record.t[-1]:.6g} s"
        label = "record" if len(records) == 1 else f"experiment {number}"
        text = f"{name}{stretch} ({record.n_samples:,} samples), {step}{lost}"
        rows.append((label, text))
        if record.reference is not None:
            which = "" if len(records) == 1 else f" of {label}"
            held = _BETWEEN[str(record.reference_behaviour)]
            driven = record._labelled(record.reference_names)
            rows.append((f"reference{which}", f"{driven}; {held}"))
    return rows


def code_again(estimate: Estimate, records: Sequence[Record]) -> str:
    """Lines of Python that estimate the same from the same samples.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record

    Returns
    -------
    str
    """
    import tridentify

    method = estimate.call.partition("(")[0]
    known = [method] if method in tridentify.__all__ else []
    names = ", ".join(sorted(["Structure", "identify", "read_record", *known]))
    lines = [f"from tridentify import {names}"]
    if method and not known:
        module = next(
            (m.__module__ for m in METHODS.values() if getattr(m, "__name__", "") == method),
            "tridentify.estimation.methods.paper",
        )
        lines.append(f"from {module} import {method}")
    channels = f"inputs={list(estimate.input_names)}, outputs={list(estimate.output_names)}"
    lines += ["", "records = ["]
    for number, record in enumerate(records, 1):
        file = file_of(record, number)
        beyond = record.t[-1] + (record.t[-1] - record.t[-2]) / 2
        cut = f".slice({record.t[0]:.9g}, {beyond:.9g})"
        driven = ""
        if record.reference is not None:
            driven = f", references={list(record.reference_names)}"
            driven += f", reference_intersample={record.reference_behaviour!r}"
        lines.append(f"    read_record({file!r}, {channels}{driven}){cut},")
    options = f", {estimate.call}" if estimate.call else ""
    lines += [
        "]",
        f"estimate = identify(records, {as_call(estimate.structure)}{options})",
    ]
    if estimate.record_fingerprint:
        lines.append(f"assert estimate.record_fingerprint == {estimate.record_fingerprint!r}")
    return "\n".join(lines)


def workbench_again(records: Sequence[Record]) -> str:
    """What opens the records in the workbench: a command line, and a line of Python.

    Parameters
    ----------
    records : sequence of Record

    Returns
    -------
    str
    """
    files = [file_of(record, number) for number, record in enumerate(records, 1)]
    command = shlex.join(["tridentify", "app", *dict.fromkeys(files)])
    return f"{command}\n\n# from Python, after the lines above:\n#   records[0].explore()"


def file_of(record: Record, number: int) -> str:
    """The file that a record was read from, as far as its name tells."""
    return f"{record.name or f'experiment-{number}'}.csv"
