"""From answers to errors over the Cramer-Rao bound, and from those to text."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from cases import Case
from peer import Batch

NORMAL = 0.67449  # median of the modulus of a standard normal variable


def finite(value: float) -> float | None:
    """Itself, or None where JSON could not hold it."""
    return float(value) if np.isfinite(value) else None


def summarise(case: Case, batch: Batch) -> dict[str, Any]:
    """Figures of one row.

    ``rms`` and ``bias`` are over the records that gave a model; ``median`` counts the others as
    infinitely wrong and is divided by 0.6745, so that all three are one (bias: zero) for an
    unbiased, normal, efficient estimator.
    """
    bound = case.bound()
    good = [answer["theta"] for answer in batch.answers if "theta" in answer]
    bad = Counter(
        f"{answer['error']}: {answer['message']}" for answer in batch.answers if "error" in answer
    )
    errors = (np.array(good).reshape(-1, bound.size) - case.truth) / bound
    size = np.vstack([np.abs(errors), np.full((bad.total(), bound.size), np.inf)])
    with np.errstate(all="ignore"):
        median = np.median(size, axis=0) / NORMAL if size.size else np.full(bound.size, np.inf)
        rms = np.sqrt(np.mean(errors**2, axis=0)) if good else np.full(bound.size, np.inf)
        bias = np.mean(errors, axis=0) if good else np.full(bound.size, np.inf)
    timed = [answer for answer in batch.answers if "seconds" in answer]
    seconds = [answer["seconds"] for answer in timed]
    return {
        "records": len(batch.answers),
        "failures": bad.total(),
        "reasons": dict(bad.most_common(3)),
        "stopped": batch.stopped,
        "rms": [finite(value) for value in rms],
        "median": [finite(value) for value in median],
        "bias": [finite(value) for value in bias],
        "seconds": float(np.mean(seconds[1:] or seconds)) if seconds else None,
        "first": timed[0]["at"] if timed else None,
        "peak": max((answer["peak"] for answer in timed), default=None),
        "versions": batch.versions,
    }


def describe(case: Case) -> dict[str, Any]:
    """What the table says of a case."""
    bound = case.bound()
    return {
        "title": case.title,
        "names": case.names,
        "truth": case.truth.tolist(),
        "bound": bound.tolist(),
        "free": (case.bound(free_numerator=True) / bound).tolist(),
    }


def text(data: dict[str, Any]) -> str:
    """The whole report.

    Parameters
    ----------
    data : dict
        ``cases``: name -> `describe`; ``rows``: case -> peer -> way -> `summarise`, or
        ``{"missing": reason}`` in the place of the latter.
    """
    lines = []
    for name, case in data["cases"].items():
        rows = data["rows"].get(name, {})
        if rows:
            lines += [*_block(name, case, rows), ""]
    lines += ["versions", *_versions(data["rows"])]
    return "\n".join(lines)


def _block(name: str, case: dict[str, Any], rows: dict[str, Any]) -> list[str]:
    relative = np.abs(np.array(case["bound"]) / np.array(case["truth"]))
    pairs = zip(case["names"], relative, case["free"], strict=True)
    bounds = ", ".join(f"{who} {100 * part:.2g} % ({more:.2f})" for who, part, more in pairs)
    lines = [
        f"{name}: {case['title']}",
        f"bound by value (factor if the numerator is free): {bounds}",
        f"{'':29s}{'worst rms':>14s}{'worst median':>15s}{'no model':>10s}{'s/record':>10s}"
        f"{'first s':>9s}{'MB':>6s}   rms / bound by coefficient: {' '.join(case['names'])}",
    ]
    remarks = []
    for peer, ways in rows.items():
        for way, row in ways.items():
            lines.append(_row(f"{peer}: {way}", case["names"], row))
            remarks.append(f"  {peer}: {way}: {shows(case['names'], row)}.")
    return [*lines, *remarks]


def _worst(names: list[str], values: list[float | None]) -> tuple[float, str]:
    filled = [np.inf if value is None else value for value in values]
    at = int(np.argmax(filled))
    return filled[at], names[at]


def _figure(value: float | None) -> str:
    if value is None or not np.isfinite(value):
        return "-"
    return f"{value:.2f}" if value < 10 else f"{value:.3g}"


def _row(who: str, names: list[str], row: dict[str, Any]) -> str:
    if "missing" in row:
        return f"{who:29s} not installed: {row['missing']}"
    worst = []
    for key in ("rms", "median"):
        value, name = _worst(names, row[key])
        worst.append(f"{_figure(value)} {name if np.isfinite(value) else '  '}")
    seconds = "-" if row["seconds"] is None else f"{row['seconds']:.3g}"
    first = "-" if row["first"] is None else f"{row['first']:.1f}"
    peak = "-" if row["peak"] is None else f"{row['peak']:.0f}"
    ended = "*" if row["stopped"] else " "
    lost = f"{row['failures']}/{row['records']}{ended}"
    each = " ".join(_figure(value) for value in row["rms"])
    return (
        f"{who:29s}{worst[0]:>14s}{worst[1]:>15s}{lost:>10s}{seconds:>10s}{first:>9s}{peak:>6s}"
        f"   {each}"
    )


def shows(names: list[str], row: dict[str, Any]) -> str:
    """What a row shows, in a sentence made of its figures."""
    if "missing" in row:
        return f"not installed: {row['missing']}"
    total, lost = row["records"], row["failures"]
    reason = next(iter(row["reasons"]), "").partition(": ")[2].rstrip(".")
    reason = reason if len(reason) <= 70 else reason[:67] + "..."
    ended = f"; the time limit ended it after {total - lost} answers" if row["stopped"] else ""
    if lost == total:
        return f"no model from any of {total} records ({reason})"
    accuracy = _accuracy(names, row)
    few = "; so few records say little" if total - lost < 10 else ""
    failed = f"; no model from {lost} of {total} records ({reason})" if lost else ""
    return f"{accuracy}{failed}{ended}{few}"


def _accuracy(names: list[str], row: dict[str, Any]) -> str:
    rms, who = _worst(names, row["rms"])
    median, typical = _worst(names, row["median"])
    if rms <= 1.3:
        words = "errors at the bound"
    elif rms <= 2.0:
        words = f"errors within twice the bound (rms {_figure(rms)} in {who})"
    elif rms <= 5.0:
        words = f"rms error {_figure(rms)} times the bound in {who}"
    elif median <= 2.0:
        words = f"mostly within twice the bound, but outliers (rms {_figure(rms)} in {who})"
    elif np.isfinite(median):
        words = f"typical error {_figure(median)} times the bound in {typical}, rms {_figure(rms)}"
    else:
        words = f"rms error {_figure(rms)} times the bound in {who}"
    at = names.index(who)
    if rms > 1.3 and abs(row["bias"][at]) > 0.8 * rms:
        words += f", mostly bias ({row['bias'][at]:+.2g})"
    return words


def _versions(rows: dict[str, Any]) -> list[str]:
    found: dict[str, dict[str, str]] = {}
    for peers in rows.values():
        for peer, ways in peers.items():
            for row in ways.values():
                if row.get("versions"):
                    found[peer] = row["versions"]
    return [
        f"  {peer}: " + ", ".join(f"{name} {value}" for name, value in versions.items())
        for peer, versions in found.items()
    ]
