"""Short and noisy records: who comes nearest to the truth? Aim: ThreeModel(), but for chance.

The paper's step record, and pilots' doublets and 3-2-1-1s of 100 and 250 samples, on the paper's
aircraft and on other plants. Every method knows that the record starts at rest and has no offset.

The width of a pulse is the usual one for a plant of corner frequency ``w``: ``2.3 / w`` for the
doublet, ``1.6 / w`` for the 3-2-1-1 (Jategaonkar, Flight Vehicle System Identification, 2006,
ch. 2); the record lasts ``21.65 / w`` (the aircraft: 12.5 s).

Scores are of the relative errors. RMSE: root mean square over coefficients and draws; median: root
mean square over coefficients of the median over draws. A draw without an answer counts as an answer
of zero for every coefficient (relative error one); an answer with a status that is not ok counts as
it stands. An outlier has a coefficient farther from the truth than three times its size.

Verdict: ThreeModel() against the lowest of all others but the one that is started at the truth,
ThreeModel.paper included, on the draws of both: ``equal`` if the scores differ by less than half a
per cent (methods that end on the same minimum differ in the last digits); ``lowest``; ``within`` if
the 95 % interval of the ratio (paired bootstrap over draws) reaches one; else ``above``. As the
lowest of several is picked after the fact, the comparison leans towards the others.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

import numpy as np
from contest import AT_TRUTH, OURS, Outcome, contest, labels
from machine import HERE, keep
from matplotlib.figure import Figure
from numpy.typing import NDArray
from plants import AIRCRAFT, FIRST, LIGHT, OVERDAMPED, THIRD, Cell, Plant, pilot

Array = NDArray[np.float64]
TOLD = (AT_TRUTH,)
"""Not ranked: started at the truth."""
INPUTS = {"doublet": ((1, 1), 2.3), "3-2-1-1": ((3, 2, 1, 1), 1.6)}
LASTS = 12.5 * np.sqrt(3.0)
RESAMPLES = 1000
OUTLIER = 3.0
EQUAL = 0.005
VERDICTS = ("lowest", "equal", "within", "above")


def cells(every: bool = False) -> list[Cell]:
    """The experiments; with ``every`` all noise levels on all plants."""
    step = np.ones(100)
    found = [
        Cell(f"aircraft step 100 ratio {ratio:g}", AIRCRAFT, step, 0.05, ("ratio", ratio))
        for ratio in (0.5, 1.0, 2.0, 3.0)
    ]
    for signal in INPUTS:
        for count in (100, 250):
            found += [pulses(AIRCRAFT, signal, count, snr) for snr in (0, 5, 10)]
    others = (OVERDAMPED, LIGHT, THIRD.faster(1000), FIRST.faster(1000))
    for plant in others:
        found += [pulses(plant, "doublet", 100, snr) for snr in ((0, 5, 10) if every else (0, 10))]
        found += [pulses(plant, "3-2-1-1", 250, snr) for snr in ((0, 5, 10) if every else (5,))]
    return found


def pulses(plant: Plant, signal: str, count: int, snr: float) -> Cell:
    """A pilot's input, its pulses fitted to the plant."""
    shape, width = INPUTS[signal]
    dt = LASTS / plant.corner / count
    u = pilot(shape, width / plant.corner, dt, count)
    return Cell(f"{plant.name} {signal} {count} {snr:g} dB", plant, u, dt, ("snr", snr))


def relative(cell: Cell, theta: Array) -> Array:
    """Errors over the truth; one where there is no answer."""
    return np.nan_to_num(np.abs(theta / cell.plant.theta - 1), nan=1.0, posinf=1e300)


def rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def middle(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.median(errors, axis=-2) ** 2)))


SCORES = {"rms": rms, "median": middle}


def describe(cell: Cell, outcome: Outcome) -> dict[str, Any]:
    """All figures of one method in one cell; those of single coefficients in their units."""
    given = outcome.theta[np.all(np.isfinite(outcome.theta), axis=1)]
    errors = (
        np.abs(given - cell.plant.theta) if len(given) else np.full((1, cell.bound.size), np.nan)
    )
    every = relative(cell, outcome.theta)
    count = len(outcome.status)
    return {
        "draws": count,
        "rms": rms(every),
        "median": middle(every),
        "rms_over_bound": rms(every) / rms(cell.bound / cell.plant.theta),
        "largest": float(every.max()),
        "q95": float(np.quantile(every.max(axis=1), 0.95)),
        "q999": float(np.quantile(every.max(axis=1), 0.999)),
        "outliers": int(np.sum(np.any(every > OUTLIER, axis=1))),
        "no_answer": count - len(given),
        "not_ok": sum("not ok" in status for status in outcome.status),
        "status": dict(Counter(outcome.status)),
        "seconds": float(np.median(outcome.seconds)),
        "worst_draws": worst_draws(every, outcome.status),
        "coefficients": {
            name: {
                "rmse": rms(errors[:, k]),
                "rmse_over_bound": rms(errors[:, k]) / cell.bound[k],
                "median": float(np.median(errors[:, k])),
                "median_over_bound": float(np.median(errors[:, k])) / cell.bound[k],
                "q95": float(np.quantile(errors[:, k], 0.95)),
                "q999": float(np.quantile(errors[:, k], 0.999)),
                "largest": float(errors[:, k].max()),
                "outliers": int(np.sum(errors[:, k] > OUTLIER * abs(cell.plant.theta[k]))),
            }
            for k, name in enumerate(cell.plant.names)
        },
    }  # fmt: skip


def worst_draws(errors: Array, status: list[str]) -> list[tuple[int, float, str]]:
    """Number, relative error and status of the three worst: `Cell.record` gives their records."""
    order = np.argsort(errors.max(axis=1))[:-4:-1]
    return [(int(k), float(errors[k].max()), status[k]) for k in order]


def compare(kind: str, ours: Array, other: Array) -> list[float]:
    """Ratio ours / other of a score, with its 95 % interval; errors are (n_draws, n)."""
    picks = np.random.default_rng(len(ours)).integers(len(ours), size=(RESAMPLES, len(ours)))
    if kind == "rms":
        drawn = [np.mean(errors**2, axis=1)[picks].mean(axis=1) for errors in (ours, other)]
    else:
        drawn = [np.mean(np.median(errors[picks], axis=1) ** 2, axis=1) for errors in (ours, other)]
    low, high = np.quantile(np.sqrt(drawn[0] / drawn[1]), [0.025, 0.975]).tolist()
    return [SCORES[kind](ours) / SCORES[kind](other), low, high]


def verdict_of(ratio: list[float]) -> str:
    """In a word: ratio of the scores and its interval."""
    if abs(ratio[0] - 1) < EQUAL:
        return "equal"
    return "lowest" if ratio[0] < 1 else "within" if ratio[1] <= 1 else "above"


def judge(cell: Cell, outcomes: dict[str, Outcome]) -> dict[str, Any]:
    """Scores and verdicts on the common draws, for all coefficients together and for each."""
    count = min(len(outcome.status) for outcome in outcomes.values())
    errors = {label: relative(cell, o.theta[:count]) for label, o in outcomes.items()}
    found: dict[str, Any] = {"draws": count}
    for kind in SCORES:
        found[kind] = decide(kind, errors)
    found["coefficients"] = {
        name: {
            kind: decide(kind, {label: e[:, k : k + 1] for label, e in errors.items()})
            for kind in SCORES
        }
        for k, name in enumerate(cell.plant.names)
    }
    return found


def decide(kind: str, errors: dict[str, Array]) -> dict[str, Any]:
    """Everyone's score, the lowest of those that are ranked, and ours next to the best other."""
    scores = {label: SCORES[kind](own) for label, own in errors.items()}
    order = sorted((label for label in scores if label not in TOLD), key=scores.__getitem__)
    found: dict[str, Any] = {"scores": scores, "lowest": order[0]}
    others = [label for label in order if label != OURS]
    if others and OURS in errors:
        ratio = compare(kind, errors[OURS], errors[others[0]])
        found |= {"rival": others[0], "ratio": ratio, "verdict": verdict_of(ratio)}
    return found


def block(cell: Cell, figures: dict[str, dict[str, Any]], verdict: dict[str, Any]) -> list[str]:
    """Table of one cell."""
    sizes = ", ".join(
        f"{name} {100 * part:.3g} %"
        for name, part in zip(cell.plant.names, abs(cell.bound / cell.plant.theta), strict=True)
    )
    lines = [f"{cell.name}   (bound: {sizes})"]
    for label, found in figures.items():
        lines.append(
            f"  {label:31s}{found['draws']:6d}{found['rms']:10.3g}{found['rms_over_bound']:9.2f}"
            f"{found['median']:9.3g}{found['q95']:9.3g}{found['q999']:9.3g}{found['largest']:9.2g}"
            f"{100 * found['outliers'] / found['draws']:8.1f}{found['no_answer']:6d}"
            f"{found['not_ok']:6d}{1e3 * found['seconds']:8.1f}"
        )
    lines += [f"  {kind}: {said(verdict[kind])}" for kind in SCORES]
    return [*lines, ""]


HEAD = (
    f"  {'method':31s}{'draws':>6s}{'rms':>10s}{'/bound':>9s}{'median':>9s}{'95 %':>9s}"
    f"{'99.9 %':>9s}{'largest':>9s}{'out %':>8s}{'none':>6s}{'bad':>6s}{'ms':>8s}"
)
NOTE = """relative errors; rms and median as in the script's docstring; 95 %, 99.9 %: quantiles, and
largest, of a draw's worst coefficient; /bound: rms over that of the Cramer-Rao bound; out: a
coefficient off by more than 3 times its size; none: no answer; bad: status not ok; ms: CPU time"""


def single(cell: Cell, figures: dict[str, dict[str, Any]], verdict: dict[str, Any]) -> list[str]:
    """Figures of every coefficient, in its own units, over the answers that were given."""
    lines = []
    for k, name in enumerate(cell.plant.names):
        lines.append(f"{cell.name}   {name} = {cell.plant.theta[k]:g}, bound {cell.bound[k]:.3g}")
        for label, found in figures.items():
            one = found["coefficients"][name]
            lines.append(
                f"  {label:31s}{one['rmse']:10.3g}{one['rmse_over_bound']:10.3g}"
                f"{one['median']:10.3g}{one['median_over_bound']:10.3g}{one['q95']:10.3g}"
                f"{one['q999']:10.3g}{one['largest']:10.3g}{one['outliers']:6d}"
            )
        lines += [f"  {kind}: {said(verdict['coefficients'][name][kind])}" for kind in SCORES]
    return [*lines, ""]


def said(one: dict[str, Any]) -> str:
    """A verdict in words."""
    if "ratio" not in one:
        return f"lowest {one['lowest']}"
    ratio, low, high = one["ratio"]
    return (
        f"lowest {one['lowest']}; {OURS} / {one['rival']} = {ratio:.4g} "
        f"({low:.4g} .. {high:.4g}): {one['verdict']}"
    )


SINGLE_HEAD = (
    f"  {'method':31s}{'RMSE':>10s}{'/bound':>10s}{'median':>10s}{'/bound':>10s}{'95 %':>10s}"
    f"{'99.9 %':>10s}{'largest':>10s}{'out':>6s}"
)


def summary(data: dict[str, Any]) -> list[str]:
    """One line a cell, and the count of verdicts."""
    lines = [
        f"{'':42s}{'RMSE/bound':>11s}  {'lowest other by RMSE':32s}{'ours / it (95 %)':27s}"
        f"{'verdict':9s}{'lowest other by median':32s}{'ours / it (95 %)':27s}verdict"
    ]
    counts: dict[str, Counter[str]] = {}
    for kind, title in (("rms", "RMSE"), ("median", "median")):
        verdicts = [cell["verdict"] for cell in data.values()]
        counts[f"{title}, of {len(data)} cells"] = Counter(v[kind]["verdict"] for v in verdicts)
        ones = [one[kind]["verdict"] for v in verdicts for one in v["coefficients"].values()]
        counts[f"{title} of single coefficients, of {len(ones)}"] = Counter(ones)
    for name, cell in data.items():
        line = f"{name:42s}{cell['methods'][OURS]['rms_over_bound']:11.3g}  "
        for kind, width in (("rms", 32), ("median", 32)):
            one = cell["verdict"][kind]
            ratio, low, high = one["ratio"]
            line += f"{one['rival']:{width}s}{f'{ratio:.4g} ({low:.4g} .. {high:.4g})':27s}"
            line += f"{one['verdict']:9s}"
        lines.append(line.rstrip())
    lines.append("")
    for title, count in counts.items():
        told = ", ".join(f"{word} {count[word]}" for word in VERDICTS)
        lines.append(f"{OURS} by {title}: {told}")
    methods = [cell["methods"][OURS] for cell in data.values()]
    totals = {key: sum(m[key] for m in methods) for key in ("draws", "no_answer", "not_ok")}
    lines.append(
        f"{OURS}: {totals['draws']} records, {totals['no_answer']} without an answer, "
        f"{totals['not_ok']} with a status that is not ok"
    )
    return lines


def picture(data: dict[str, Any], names: list[str]) -> Figure:
    """Every score over the lowest of its cell, by RMSE and by median."""
    rows = list(data)
    figure = Figure(figsize=(2.6 + 1.5 * len(names), 1.6 + 0.27 * len(rows)), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for ax, kind, title in zip(panels, SCORES, ("RMSE", "Median"), strict=True):
        scores = np.array(
            [[data[row]["verdict"][kind]["scores"][name] for name in names] for row in rows]
        )  # fmt: skip
        ranked = [k for k, name in enumerate(names) if name not in TOLD]
        ratio = scores / scores[:, ranked].min(axis=1, keepdims=True)
        shown = np.log10(np.clip(ratio, 1.0, 3.0))
        ax.imshow(shown, cmap="Blues", vmin=0, vmax=np.log10(5.0), aspect="auto")
        for i, k in np.ndindex(ratio.shape):
            lowest = k in ranked and ratio[i, k] < 1 + EQUAL
            text = f"{ratio[i, k]:.2f}" if ratio[i, k] < 9.995 else f"{ratio[i, k]:.0e}"
            weight = "bold" if lowest else "normal"
            ax.text(k, i, text, ha="center", va="center", fontsize=7, fontweight=weight)
        ax.set_xticks(range(len(names)), names, rotation=35, ha="right", fontsize=8)
        ax.set_yticks(range(len(rows)), rows, fontsize=8)
        ax.tick_params(length=0)
        ax.set_title(f"{title} of the relative errors, over the lowest of its row", fontsize=10)
        for k in range(len(names)):
            if names[k] in TOLD:
                ax.axvline(k - 0.5, color="black", linewidth=1)
    figure.suptitle(
        "Short and noisy records (bold: lowest, or within half a per cent of it; right of the "
        "line: started at the truth, not ranked)",
        fontsize=11,
    )
    return figure


def store(data: dict[str, Any], texts: dict[str, str], names: list[str]) -> None:
    """Tables, figure, JSON; the summary also in the write-up."""
    folder = HERE / "results"
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        (folder / f"short_records_{name}.txt").write_text(text + "\n")
    picture(data["cells"], names).savefig(folder / "short_records.png", dpi=110)
    keep("short_records", "\n".join(summary(data["cells"])), data)


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    parser.add_argument("--cells", default="", help="parts of names of cells, a,b; default all")
    parser.add_argument("--all", action="store_true", help="all noise levels on all plants")
    parser.add_argument("--methods", default="", help="parts of names of methods, a,b; default all")
    parser.add_argument("--draws", type=int, default=1000, help="of ThreeModel()")
    parser.add_argument("--rival-draws", type=int, default=250, help="of every other method")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    return parser.parse_args()


def main() -> None:
    given = options()
    chosen = [
        cell for cell in cells(given.all) if any(w in cell.name for w in given.cells.split(","))
    ]
    names = [n for n in labels() if any(w in n for w in given.methods.split(","))]
    outcomes = contest(
        chosen,
        lambda _, label: given.draws if label == OURS else min(given.draws, given.rival_draws),
        names=names,
        seed=given.seed,
        workers=given.workers,
    )
    data: dict[str, Any] = {"seed": given.seed, "cells": {}}
    tables, coefficients = [NOTE, "", HEAD, ""], [SINGLE_HEAD, ""]
    for cell in chosen:
        own = {label: outcomes[cell.name, label] for label in names}
        figures = {label: describe(cell, outcome) for label, outcome in own.items()}
        verdict = judge(cell, own)
        data["cells"][cell.name] = {
            "truth": cell.plant.theta.tolist(),
            "bound": cell.bound.tolist(),
            "methods": figures,
            "verdict": verdict,
        }
        tables += block(cell, figures, verdict)
        coefficients += single(cell, figures, verdict)
    print("\n" + "\n".join(tables))
    if OURS in names and len(names) > 1:
        print("\n".join(summary(data["cells"])))
    if given.save:
        texts = {"methods": "\n".join(tables), "coefficients": "\n".join(coefficients)}
        store(data, texts, names)


if __name__ == "__main__":
    main()
