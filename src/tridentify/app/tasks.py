"""What a worker is asked: plain documents in, plain documents out.

Every function here runs in a process of its own, so that the server answers at once whatever a
file or an estimate costs, and a crash or an endless loop ends a worker and not the session.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tridentify.app import panels, sources
from tridentify.app.answers import described
from tridentify.app.exports import exported
from tridentify.app.lines import between
from tridentify.app.plain import findings, listed, number
from tridentify.errors import ConstantInputError, DataError, EmptyRangeError, UnreadableFileError
from tridentify.estimation.answer.encoding.values import encode
from tridentify.estimation.answer.estimate import Estimate
from tridentify.identify import identify
from tridentify.judgement.advice import advise, find_manoeuvres, frequency_response
from tridentify.judgement.comparison import compare
from tridentify.options import checked, method_of, structure_of, words_of
from tridentify.record.formats.read import list_channels
from tridentify.record.formats.roles import guess_roles
from tridentify.record.formats.series import Series

BESIDE = 0.25
"""Of a sampling interval, by which a stretch of samples is longer than they are."""

MOST_CHANNELS = 5_000
"""Of a record: a flight log has some thousand."""

Say = Callable[[float, str], None]
Source = Mapping[str, Any]
Card = Mapping[str, Any]


def prepare(say: Say) -> None:
    """Load what the first estimate needs: compiled loops and libraries."""
    from tridentify.data import short_period

    identify(short_period(), (2, 1), throw=False)


def opened(say: Say, source: Source) -> dict[str, Any]:
    """What a record's card says of the file itself."""
    found = sources.series(source)
    if not found:
        list_channels(sources.content(source))
        raise UnreadableFileError(
            "found no channel of numbers; expected at least two; choose another file"
        )
    if len(found) > MOST_CHANNELS:
        raise UnreadableFileError(
            f"found {len(found):,} channels; expected at most {MOST_CHANNELS:,}, which a page can "
            "list; write those that are needed into a file of their own"
        )
    longest = max(found, key=lambda one: one.t.size)
    roles = guess_roles([one.channel.name for one in found], [one.values for one in found])
    names = _told_apart(found)
    return {
        "digest": sources.digest(source),
        "n_samples": int(longest.t.size),
        "t0": min(float(one.t[0]) for one in found),
        "duration": max(float(one.t[-1]) for one in found) - min(float(one.t[0]) for one in found),
        "dt": number(longest.dt or float(np.median(np.diff(longest.t)))),
        "uniform": longest.dt is not None,
        "channels": [
            _channel(name, one, role) for name, one, role in zip(names, found, roles, strict=True)
        ],
        **{
            f"{role}s": [name for name, own in zip(names, roles, strict=True) if own == role]
            for role in ("input", "output", "reference")
        },
    }


def _told_apart(found: Sequence[Series]) -> list[str]:
    """Names, or full headers where two channels share a name."""
    times = Counter(one.channel.name for one in found)
    return [
        one.channel.header if times[one.channel.name] > 1 else one.channel.name for one in found
    ]


def _channel(name: str, one: Series, role: str) -> dict[str, Any]:
    found = one.summary()
    return {
        "name": name,
        "unit": one.channel.unit,
        **{key: number(getattr(found, key)) for key in ("minimum", "maximum", "mean", "std")},
        "missing": found.missing,
        "guess": role,
    }


def series(
    say: Say, source: Source, channels: Sequence[str], start: float, end: float, pixels: int,
    t0: float,
) -> dict[str, Any]:  # fmt: skip
    """Channels over a stretch of time, thinned to the columns of a picture."""
    found = sources.series(source)
    known = dict(zip(_told_apart(found), found, strict=True))
    unknown = [name for name in channels if name not in known]
    if unknown:
        raise DataError(
            f"found no channel {unknown[0]!r}; expected one of {', '.join(known)}; choose another"
        )
    drawn = [known[name].thinned(t0 + start, t0 + end, pixels) for name in channels]
    if not drawn:
        return {"time": [], "channels": {}, "thinned": False}
    first = drawn[0]
    alike = all(one.t.shape == first.t.shape and np.allclose(one.t, first.t) for one in drawn)
    if not alike:
        columns = min(pixels, max(one.t.size for one in drawn)) or 1
        drawn = [_in_columns(known[name], t0 + start, t0 + end, columns) for name in channels]
        first = drawn[0]
    return {
        "time": listed(first.t - t0),
        "channels": {
            name: {"minimum": listed(one.minimum), "maximum": listed(one.maximum)}
            for name, one in zip(channels, drawn, strict=True)
        },
        "thinned": bool(any(one.thinned for one in drawn)),
    }


def _in_columns(one: Series, start: float, stop: float, columns: int) -> Any:
    """A series of another clock on the columns of the picture: what it holds where none falls."""
    edges = np.linspace(start, stop, columns + 1)
    thin = one.thinned(start, stop, columns)
    if thin.thinned:
        return thin
    centre = 0.5 * (edges[1:] + edges[:-1])
    values = np.interp(centre, one.t, one.values, left=np.nan, right=np.nan)
    return thin._replace(t=centre, minimum=values, maximum=values)


def stretches(
    say: Say, source: Source, channel: str, low: float | None, high: float | None, t0: float
) -> list[dict[str, float]]:
    """Where a channel is at or beyond limits, each stretch a little longer than its samples."""
    found = sources.series(source)
    one = dict(zip(_told_apart(found), found, strict=True))[channel]
    limits = (-np.inf if low is None else low, np.inf if high is None else high)
    slack = BESIDE * float(np.median(np.diff(one.t)))
    return [
        {"start": max(first - t0 - slack, 0.0), "end": last - t0 + slack}
        for first, last in one.beyond(*limits)
    ]


def warm(say: Say, source: Source, card: Card) -> None:
    """Read the record before the first estimate asks for it."""
    sources.whole(source, card)


def manoeuvres(say: Say, source: Source, card: Card) -> list[dict[str, Any]]:
    """Pieces worth identifying."""
    record = sources.whole(source, card)
    return [
        {
            "start": number(one.start - card["t0"]),
            "end": number(one.stop - card["t0"]),
            "score": number(one.score),
            "why": one.why,
        }
        for one in find_manoeuvres(record)
    ]


def advice(say: Say, source: Source, card: Card) -> dict[str, Any]:
    """What the record can tell before anything is fitted."""
    records = sources.pieces(sources.whole(source, card), card, "identify")
    found = advise(records)
    return {
        "summary": found.summary(),
        "facts": [list(pair) for pair in found.facts()],
        "notes": list(found.notes),
        "findings": findings(found.findings),
        "response": panels.measured(frequency_response(records)),
    }


def estimated(say: Say, source: Source, card: Card, options: Mapping[str, Any]) -> dict[str, Any]:
    """An estimate of the ranges of a record that are identified."""
    chosen = checked(options)
    structure, method = structure_of(chosen), method_of(chosen)
    record = sources.whole(source, between(card, chosen))
    records = sources.pieces(record, card, "identify")
    for one in records:
        _check_moved(one)
    steps = _Steps(say)
    found = identify(records, structure, method, throw=False, progress=steps)
    return {
        "described": described(found, record, card, chosen),
        "document": encode(found),
        "structure": words_of(found.structure),
        "fit": [number(fit) for fit in found.fit.tolist()],
    }


def _check_moved(record: Any) -> None:
    """Refuse a piece in which nothing drives the plant, in words of the page."""
    if record.n_samples < 2:
        raise EmptyRangeError(
            "found fewer than 2 samples in a range; expected more; drag over a longer one"
        )
    still = [name for name, u in zip(record.input_names, record.u.T, strict=True) if np.ptp(u) == 0]
    if len(still) == record.n_inputs:
        raise ConstantInputError(
            f"found that {', '.join(still)} does not move in this range; expected an input that "
            "excites the plant; drag over a stretch in which it moves, or take "
            "another channel for the input"
        )


class _Steps:
    """Words of what is going on, with a fraction that grows towards one."""

    def __init__(self, say: Say) -> None:
        self.say = say
        self.left = 1.0

    def __call__(self, words: str) -> None:
        self.left *= 0.8
        self.say(1.0 - self.left, words)


def model(
    say: Say, source: Source, card: Card, options: Mapping[str, Any], document: Mapping[str, Any]
) -> dict[str, Any]:
    """All that is shown of a model but its pictures."""
    chosen = checked(options)
    estimate = Estimate.from_document(document)
    try:
        record = sources.whole(source, between(card, chosen))
    except DataError:
        record = None
    return described(estimate, record, card, chosen)


def _for(estimate: Estimate, card: Card) -> Card:
    """A record with the channels of a model."""
    roles = {"inputs": list(estimate.input_names), "outputs": list(estimate.output_names)}
    return {**card, **roles}


def panel(
    say: Say, source: Source, card: Card, kind: str, document: Mapping[str, Any], pixels: int
) -> dict[str, Any]:
    """One picture of a model on a record."""
    estimate = Estimate.from_document(document)
    record = sources.whole(source, _for(estimate, card))
    records = sources.pieces(record, card, "identify")
    return panels.PANELS[kind](estimate, records, pixels, card["t0"])


def compared(
    say: Say, source: Source, card: Card, documents: Sequence[Mapping[str, Any]],
    names: Sequence[str],
) -> dict[str, Any]:  # fmt: skip
    """Models on one record, offset, drift and state refitted."""
    estimates = [Estimate.from_document(document) for document in documents]
    record = sources.whole(source, _for(estimates[0], card))
    part = sources.pieces(record, card, "validate") or sources.pieces(record, card, "identify")
    found = compare(estimates, part, names=list(names))
    return {
        "inputs": list(estimates[0].input_names),
        "outputs": list(found.output_names),
        "fits": [[number(fit) for fit in row] for row in panels.mean_fits(found)],
        "summary": _summary(found, names, _stretches(card)),
    }


def _stretches(card: Card) -> str:
    """What of a record is compared, in words."""
    for use, said in (("validate", "for validation"), ("identify", "to identify")):
        chosen = [one for one in card["ranges"] if one["use"] == use]
        if chosen:
            pieces = " and ".join(f"{one['start']:.5g} to {one['end']:.5g} s" for one in chosen)
            return f"On its {'range' if len(chosen) == 1 else 'ranges'} {said}, {pieces}: "
    return ""


def _summary(found: Any, names: Sequence[str], where: str) -> str:
    rows = [float(np.mean(row)) for row in panels.mean_fits(found)]
    best = int(np.argmax(rows))
    if len(rows) == 1:
        return f"{where}{names[0]} follows this record to {rows[0]:.1f} %."
    others = ", ".join(f"{names[k]} {fit:.1f} %" for k, fit in enumerate(rows) if k != best)
    return f"{where}{names[best]} follows this record best, to {rows[best]:.1f} %; {others}."


def export(
    say: Say, source: Source, card: Card, options: Mapping[str, Any], document: Mapping[str, Any],
    kind: str, name: str,
) -> tuple[str, str, bytes]:  # fmt: skip
    """A file of a model: its name, its media type, its bytes."""
    estimate = Estimate.from_document(document)
    records = None
    if kind in ("report", "figure"):
        record = sources.whole(source, between(card, checked(options)))
        records = sources.pieces(record, card, "identify")
    return exported(estimate, records, kind, name)
