"""What is said of a file that was changed on disk under its record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Card = Mapping[str, Any]

ROLES = ("inputs", "outputs", "references")
FACTS = ("n_samples", "t0", "duration", "dt", "uniform", "channels", "digest")
"""Of a card, what is read from the file."""
MOST_NAMED = 6
"""Columns that a sentence names."""


def read_anew(before: Card, now: Card) -> dict[str, Any]:
    """The parts of a card that the new content of its file makes different.

    Parameters
    ----------
    before : mapping
        The card.
    now : mapping
        What is read from the file.

    Returns
    -------
    dict
        Facts, roles without columns that are gone, and under ``changed_file`` what is said of it,
        which is left out where the content is the same.
    """
    names = [one["name"] for one in now["channels"]]
    roles = {role: [name for name in before[role] if name in names] for role in ROLES}
    news = {name: now[name] for name in FACTS} | roles | {"unreadable": False}
    if not _same(before, now):
        return news | {"changed_file": told(before, now)}
    return news | {"changed_file": ""} if before.get("unreadable") else news


def _same(before: Card, now: Card) -> bool:
    if before.get("digest"):
        return bool(before["digest"] == now["digest"])
    return all(before[name] == now[name] for name in FACTS if name != "digest")


def told(before: Card, now: Card) -> str:
    """What changed of a file, in sentences.

    Examples
    --------
    >>> roles = {"inputs": ["u"], "outputs": ["y"], "references": [], "ranges": [], "bad": []}
    >>> before = {"n_samples": 1500, "duration": 30.0, "channels": [{"name": "u"}, {"name": "y"}]}
    >>> now = {"n_samples": 1200, "duration": 24.0, "channels": [{"name": "u"}]}
    >>> told(before | roles, now)
    'Its file was changed on disk: 1,500 samples became 1,200, 30 s became 24 s, gone: y (in use).'
    """
    parts = [*_length(before, now), *_columns(before, now)]
    seen = ", ".join(parts) or "other values in the same samples and columns"
    return f"Its file was changed on disk: {seen}. {_beyond(before, now)}".strip()


def unreadable(why: str) -> str:
    """That a changed file is no record any more, and why.

    Examples
    --------
    >>> unreadable("found no channel of numbers; expected at least two; choose another file")[:52]
    'Its file was changed on disk and is no record any mo'
    """
    found = why.partition(";")[0]
    return (
        f"Its file was changed on disk and is no record any more: {found}. Its models are kept; "
        "put the file right, and it is read again."
    )


def _length(before: Card, now: Card) -> list[str]:
    samples, seconds = (
        [form.format(card[name]) for card in (before, now)]
        for form, name in (("{:,}", "n_samples"), ("{:.6g}", "duration"))
    )
    said = []
    if samples[0] != samples[1]:
        said.append(f"{samples[0]} samples became {samples[1]}")
    if seconds[0] != seconds[1]:
        said.append(f"{seconds[0]} s became {seconds[1]} s")
    return said


def _columns(before: Card, now: Card) -> list[str]:
    old, new = ([one["name"] for one in card["channels"]] for card in (before, now))
    used = {name for role in ROLES for name in before[role]}
    gone = [f"{name} (in use)" if name in used else name for name in old if name not in new]
    came = [name for name in new if name not in old]
    return [f"{what}: {_few(names)}" for what, names in (("gone", gone), ("new", came)) if names]


def _few(names: Sequence[str]) -> str:
    rest = len(names) - MOST_NAMED
    return ", ".join([*names[:MOST_NAMED], *([f"{rest} more"] if rest > 0 else [])])


def _beyond(before: Card, now: Card) -> str:
    """Ranges that the new content does not reach."""
    end = now["duration"]
    late = [one for one in (*before["ranges"], *before["bad"]) if one["start"] >= end]
    if not late:
        return ""
    named = _few([f"{one['start']:.5g} to {one['end']:.5g} s" for one in late])
    return f"Beyond its end {'lies' if len(late) == 1 else 'lie'} {named}: move or remove it."
