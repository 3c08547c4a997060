"""Error over the Cramer-Rao bound. Aim: within 5 % wherever output error from the truth is.

The systems of the field (Rao and Garnier; a second-order plant under a PRBS, with white and with
ARMA noise) and the paper's aircraft. All methods know that the record starts at rest and has no
offset, but for the row ``ThreeModel() auto``, which has to find that out. The bound is that for a
known start (and, with coloured noise, for a known noise model), computed without the package.

RMSE and bias are over the draws with an answer, with and without outliers: those with a coefficient
farther than 10 bounds from the truth. "paired" is ThreeModel() over output error started at the
truth on the same draws: the worst ratio of the RMSE of one coefficient, with its 95 % interval
(bootstrap over draws). "none": an exception, or an answer that is not finite.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

import numpy as np
from contest import AT_TRUTH, OURS, OURS_AUTO, Outcome, contest, labels, paper_options
from machine import HERE, keep
from matplotlib.figure import Figure
from numpy.typing import NDArray
from plants import AIRCRAFT, ARMA, RAO_GARNIER, SECOND, SECOND_ARMA, Cell, prbs

from tridentify.plots.style import BLACK, CYCLE, dress

Array = NDArray[np.float64]
AIM = 1.05
OUTLIER = 10.0
RESAMPLES = 2000
LIMIT = 100.0
FAILURES = (
    ("no_answer", "without an answer"),
    ("not_ok", "with a status that is not ok"),
    ("outliers", "outliers"),
)
MARKS = (("outliers", "out"), ("no_answer", "none"), ("not_ok", "bad"))
PRINTED = {
    10: (0.0604, 1.062, 3.546, 7.735, 40.40, 71.62),
    0: (0.191, 3.358, 11.21, 24.46, 127.8, 226.5),
}
"""Cramer-Rao standard deviations of Rao-Garnier at N = 7161 as printed in the project's notes."""


def cells() -> list[Cell]:
    """Every experiment."""
    long, short = prbs(10, (10, 7), 7), prbs(7, (7, 6), 8)
    found = [
        Cell(f"Rao-Garnier N={count} {snr} dB", RAO_GARNIER, long[:count], 0.01, ("snr", snr))
        for count in (7161, 1000)
        for snr in (10, 0)
    ]
    found.append(Cell("3/(s^2+4s+3) white 10 dB", SECOND, short, 0.05, ("snr", 10)))
    found.append(Cell("2/(s^2+4s+3) ARMA 15 dB", SECOND_ARMA, short, 0.05, ("snr", 15), ARMA))
    for count, ratio in ((100, 0.5), (1000, 0.5), (1000, 1.0)):
        title = f"aircraft step M={count} ratio {ratio:g}"
        found.append(Cell(title, AIRCRAFT, np.ones(count), 0.05, ("ratio", ratio)))
    return found


def check_bound(cell: Cell) -> str:
    """Largest relative difference to the printed figures, which have three or four digits."""
    printed = np.array(PRINTED[int(cell.level[1])])
    worst = float(np.max(np.abs(cell.bound / printed - 1)))
    return f"bound of {cell.name}: within {100 * worst:.2f} % of the printed figures"


def describe(cell: Cell, outcome: Outcome) -> dict[str, Any]:
    """All figures of one method in one cell, in units of the bound."""
    scaled = (outcome.theta - cell.plant.theta) / cell.bound
    given = scaled[np.all(np.isfinite(scaled), axis=1)]
    outlier = np.any(np.abs(given) > OUTLIER, axis=1)
    inside = given[~outlier]
    rmse, clean = root(given), root(inside)
    worst = int(np.argmax(rmse)) if len(given) else 0
    return {
        "draws": len(scaled),
        "rmse": rmse.tolist(),
        "rmse_without_outliers": clean.tolist(),
        "worst": float(rmse[worst]),
        "worst_without_outliers": float(clean.max()),
        "worst_coefficient": cell.plant.names[worst],
        "sampling_std": sampling(given[:, worst]) if len(given) else float("nan"),
        "bias": given.mean(axis=0).tolist() if len(given) else None,
        "outliers": int(outlier.sum()),
        "no_answer": len(scaled) - len(given),
        "not_ok": sum("not ok" in status for status in outcome.status),
        "status": dict(Counter(outcome.status)),
        "seconds": float(np.median(outcome.seconds)),
    }


def root(scaled: Array) -> Array:
    """Root mean square over the draws; nan if there are none."""
    if not len(scaled):
        return np.full(scaled.shape[1], np.nan)
    return np.asarray(np.sqrt(np.mean(scaled**2, axis=0)))


def sampling(errors: Array) -> float:
    """Standard deviation of the root mean square, by resampling the draws."""
    picks = np.random.default_rng(0).integers(errors.size, size=(RESAMPLES, errors.size))
    return float(np.std(np.sqrt(np.mean(errors[picks] ** 2, axis=1))))


def paired(cell: Cell, ours: Outcome, other: Outcome) -> dict[str, Any]:
    """RMSE of ours over the other's on the draws that both answered, for each coefficient."""
    count = min(len(ours.status), len(other.status))
    pair = [((o.theta[:count] - cell.plant.theta) / cell.bound) ** 2 for o in (ours, other)]
    both = np.all(np.isfinite(pair[0]) & np.isfinite(pair[1]), axis=1)
    a, b = pair[0][both], pair[1][both]
    picks = np.random.default_rng(0).integers(len(a), size=(RESAMPLES, len(a)))
    ratios = np.sqrt(a[picks].mean(axis=1) / b[picks].mean(axis=1))
    found = np.sqrt(a.mean(axis=0) / b.mean(axis=0))
    worst = int(np.argmax(found))
    return {
        "ratio": found.tolist(),
        "interval": np.quantile(ratios, [0.025, 0.975], axis=0).T.tolist(),
        "worst": float(found[worst]),
        "worst_interval": np.quantile(ratios[:, worst], [0.025, 0.975]).tolist(),
    }


def met(found: dict[str, Any]) -> bool:
    """Whether every coefficient is within the aim, but for twice the nominal sampling error."""
    return bool(found["worst"] * (1 - 2 / np.sqrt(2 * found["draws"])) <= AIM)


HEAD = (
    f"  {'method':31s}{'draws':>6s}{'RMSE/bound, worst':>20s}{'without outliers':>18s}"
    f"{'bias, worst':>13s}{'outliers':>10s}{'none':>6s}{'not ok':>8s}{'ms':>8s}"
)


def row(label: str, found: dict[str, Any]) -> str:
    bias = max(found["bias"], key=abs) if found["bias"] else float("nan")
    rmse = f"{found['worst']:.4g} +- {found['sampling_std']:.2g}"
    return (
        f"  {label:31s}{found['draws']:6d}{rmse:>20s}{found['worst_without_outliers']:18.3f}"
        f"{bias:13.3f}{found['outliers']:10d}{found['no_answer']:6d}{found['not_ok']:8d}"
        f"{1e3 * found['seconds']:8.1f}"
    )


def block(
    cell: Cell, figures: dict[str, dict[str, Any]], outcomes: dict[str, Outcome]
) -> list[str]:
    """Table of one cell, with the verdict."""
    paper = paper_options(cell)
    filter_ = " ".join(f"{value:.4g}" for value in paper["filter"])
    lines = [
        f"{cell.name}   (paper: gamma {paper['gamma']:.3g} rad/s, {paper['n_operators']} "
        f"operators, filter {filter_})"
    ]
    lines += [row(label, found) for label, found in figures.items()]
    if AT_TRUTH in figures and OURS in figures:
        for label in (OURS, OURS_AUTO):
            if label in figures:
                pair = paired(cell, outcomes[label], outcomes[AT_TRUTH])
                low, high = pair["worst_interval"]
                figures[label]["paired"] = pair
                lines.append(
                    f"  paired: {label} / {AT_TRUTH} {pair['worst']:.4f} ({low:.4f} .. {high:.4f})"
                )
        own = "within" if met(figures[OURS]) else "above"
        reference = "within" if met(figures[AT_TRUTH]) else "above"
        lines.append(f"  bound + 5 %: {OURS} {own}, {AT_TRUTH} {reference}")
    return [*lines, ""]


def coefficients(cell: Cell, figures: dict[str, dict[str, Any]]) -> list[str]:
    """RMSE and bias of every coefficient."""
    lines = [f"{cell.name:33s}" + "".join(f"{name:>16s}" for name in cell.plant.names)]
    for label, found in figures.items():
        bias = found["bias"] or [float("nan")] * len(found["rmse"])
        pairs = zip(found["rmse"], bias, strict=True)
        lines.append(f"  {label:31s}" + "".join(f"{r:8.3g} {b:+7.2g}" for r, b in pairs))
    return [*lines, ""]


def summary(data: dict[str, Any]) -> list[str]:
    """Whether the aim is met, and where not."""
    cells = data["cells"]
    rows = {name: cell["methods"] for name, cell in cells.items()}
    lines = []
    for label in (OURS, OURS_AUTO):
        wanted = [
            name for name, m in rows.items() if label in m and AT_TRUTH in m and met(m[AT_TRUTH])
        ]
        missed = [name for name in wanted if not met(rows[name][label])]
        lines.append(
            f"{label}: bound + 5 % met in {len(wanted) - len(missed)} of the {len(wanted)} cells "
            f"where {AT_TRUTH} meets it" + (f"; missed in {', '.join(missed)}" if missed else "")
        )
        own = [m[label] for m in rows.values() if label in m]
        total = sum(found["draws"] for found in own)
        told = (f"{sum(f[key] for f in own)} {what}" for key, what in FAILURES)
        lines.append(f"{label}: {total} records, {', '.join(told)}")
    return lines


def picture(data: dict[str, Any], names: list[str]) -> Figure:
    """Worst RMSE over the bound of every method in every cell."""
    cells = data["cells"]
    figure = Figure(figsize=(9.6, 1.6 + 1.2 * len(cells)), layout="constrained")
    ax = figure.subplots()
    ax.axvspan(1.0, AIM, color="#cfe8dc", zorder=0)
    ax.axvline(1.0, color=BLACK, linewidth=0.8, zorder=1)
    markers = "osD^v<>Pp*Xh"
    for k, name in enumerate(names):
        height = 0.34 - 0.68 * k / max(len(names) - 1, 1)
        found = [cell["methods"][name] for cell in cells.values()]
        x = np.array([max(min(m["worst"], LIMIT), 0.9) for m in found])
        error = np.array([2 * m["sampling_std"] if m["worst"] < LIMIT else 0.0 for m in found])
        error = np.array([np.minimum(error, x - 0.86), np.minimum(error, LIMIT - x)])
        y = -np.arange(len(cells)) + height
        colour = CYCLE[k % len(CYCLE)]
        shown = {"fmt": markers[k % len(markers)], "color": colour, "markersize": 5}
        filled = {} if k < len(CYCLE) else {"markerfacecolor": "none"}
        ax.errorbar(x, y, xerr=error, linewidth=1, label=name, clip_on=False, **shown, **filled)
        for one, where in zip(found, y, strict=True):
            told = [f"{one[key]} {what}" for key, what in MARKS if one[key]]
            if one["worst"] > LIMIT:
                told.insert(0, f"{one['worst']:.2g} times;")
            ax.text(1.15 * LIMIT, where, " ".join(told), fontsize=5.5, va="center", color=colour)
    for k in range(len(cells) - 1):
        ax.axhline(-k - 0.5, color="#dddddd", linewidth=0.6)
    ax.set_xscale("log")
    ax.set_xlim(0.85, LIMIT)
    ax.set_xticks([1, 2, 5, 10, 20, 50, 100], ["1", "2", "5", "10", "20", "50", "100"])
    ax.set_yticks(-np.arange(len(cells)), list(cells), fontsize=8)
    ax.set_ylim(-len(cells) + 0.5, 0.5)
    dress(ax, xlabel="RMSE over the Cramer-Rao bound, worst coefficient (bars: 2 sampling errors)")
    ax.grid(False, axis="y")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=8)
    figure.supxlabel(
        "green: within 5 % of the bound; right: outliers (out), without an answer (none), status "
        "not ok (bad); on the right edge: RMSE more than 100 times the bound",
        fontsize=7,
    )
    return figure


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    parser.add_argument("--cells", default="", help="parts of names of cells, a,b; default all")
    parser.add_argument("--methods", default="", help="parts of names of methods, a,b; default all")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    return parser.parse_args()


def main() -> None:
    given = options()
    chosen = [cell for cell in cells() if any(w in cell.name for w in given.cells.split(","))]
    names = [n for n in labels(True) if any(w in n for w in given.methods.split(","))]
    outcomes = contest(
        chosen, lambda *_: given.draws, names=names, seed=given.seed, workers=given.workers
    )
    lines = [check_bound(cell) for cell in cells() if "N=7161" in cell.name]
    lines.append(
        f"sampling error of an RMSE on the bound, {given.draws} draws: "
        f"{1 / np.sqrt(2 * given.draws):.3f}"
    )
    lines += ["", HEAD, ""]
    data: dict[str, Any] = {"seed": given.seed, "draws": given.draws, "cells": {}}
    single = [f"{'RMSE over the bound, bias in bounds':33s}", ""]
    for cell in chosen:
        own = {label: outcomes[cell.name, label] for label in names}
        figures = {label: describe(cell, outcome) for label, outcome in own.items()}
        lines += block(cell, figures, own)
        single += coefficients(cell, figures)
        data["cells"][cell.name] = {
            "truth": cell.plant.theta.tolist(),
            "coefficients": cell.plant.names,
            "bound": cell.bound.tolist(),
            "methods": figures,
        }
    lines += summary(data)
    report = "\n".join(lines)
    print("\n" + report)
    if given.save:
        folder = HERE / "results"
        folder.mkdir(exist_ok=True)
        (folder / "efficiency_coefficients.txt").write_text("\n".join(single) + "\n")
        picture(data, names).savefig(folder / "efficiency.png", dpi=130)
        keep("efficiency", report, data)


if __name__ == "__main__":
    main()
