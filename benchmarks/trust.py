"""Can validation and order selection be trusted? Random systems, right models and wrong ones.

Random records (`random_systems`: orders 2 to 4, five inputs, 20 and 5 dB, 300 and 1500 samples)
whose coefficients are identifiable. Half of them get autoregressive noise (``0.7``) of the same
size. None of them was used to develop the rules.

Validation. A right model is called wrong when ``validate(...).ok`` is false; claimed is 1 %. It is
judged on its own record, and on another one of the same system with other noise. Wrong models:
one pole too few (`order`); a dead time of a tenth of the slowest time constant but at least three
samples that the structure does not know (`delay`); autoregressive noise taken for white
(`coloured`); a slow drift of half the size of the output (`drift`). *Found*: something serious is
said. *Named*: it is the first thing said. Not every wrong model can be found: one pole too few may
leave nothing that stands out of the noise.

Causes. Records of every kind of `wrong_records` with one thing wrong in them, and right ones beside
them, identified and validated. *Told*: something serious is said, by the estimate or by its
validation. *Named*: the first thing said is the cause. Aims: the first cause right in 85 % of what
is told, false alarms in 2 % of the right ones.

Feedback. Random control loops (`loops`) without their reference, of three lengths and three noise
levels, and open-loop records of stable plants of the same lengths and noise beside them. *Found*:
the finding ``feedback`` is there. *Confident and wrong*: a coefficient off by more than five
standard errors and 20 %, and nothing serious said. Loops whose set point is constant: what is said
of whether the record can tell the plant at all.

Selection. All orders up to five with all numbers of zeros; the recommended one beside those of
lowest AICc, BIC and YIC in the same table.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import argparse
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import loops
import numpy as np
import wrong_records
from machine import keep
from numpy.typing import NDArray
from random_systems import Drawn, draw
from scipy.signal import lfilter

from tridentify import (
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    TridentifyError,
    identify,
    select_structure,
    simulate,
    validate,
)
from tridentify.estimation.answer.finding import joined

Array = NDArray[np.float64]
SEED = 4
FIRST = 20_000
"""Seed of the first record of every kind of `wrong_records`."""
COLOUR = 0.7
MOST_POLES = 5
WRONG = {"order": "order-low", "delay": "delay", "coloured": "noise-model", "drift": "drift"}
Row = dict[str, Any]


def noise(rng: np.random.Generator, count: int, coloured: bool) -> Array:
    """White or autoregressive noise of variance one."""
    white = rng.standard_normal(count + 200)
    if not coloured:
        return white[200:]
    return np.asarray(np.sqrt(1 - COLOUR**2) * lfilter([1.0], [1.0, -COLOUR], white)[200:])


def model_of(drawn: Drawn, delay: float = 0.0) -> TransferFunction:
    n = drawn.order
    return TransferFunction(drawn.theta[n:], np.append(1.0, drawn.theta[:n]), delay=delay)


def noisy(drawn: Drawn, clean: Array, v: Array) -> Record:
    one = drawn.record
    return Record(one.u, clean + drawn.noise_std * v, dt=one.dt, intersample=one.intersample)


def said(record: Record, structure: Structure, method: ThreeModel, other: Record | None) -> Row:
    """What validation says of a model of one record on the same or another one."""
    try:
        estimate = identify(record, structure, method, throw=False)
        if not estimate.status.ok:
            return {"refused": estimate.status.name}
        checked = validate(estimate, record if other is None else other)
    except TridentifyError as error:
        return {"refused": type(error).__name__}
    serious = [finding.code for finding in checked.findings if finding.matters]
    return {"serious": serious, "first": serious[0] if serious else ""}


def judge(number: int, seed: int, parts: Sequence[str]) -> Row | None:
    """Everything about one record; None where its coefficients are not identifiable."""
    drawn = draw(number, seed)
    if not drawn.identifiable:
        return None
    rng = np.random.default_rng([seed, number, 1])
    coloured, count = bool(rng.random() < 0.5), drawn.record.n_samples
    clean = simulate(model_of(drawn), drawn.record)[:, 0]
    record = noisy(drawn, clean, noise(rng, count, coloured))
    row: Row = {
        "number": number, "order": drawn.order, "input": drawn.input, "snr": drawn.snr,
        "samples": count, "coloured": coloured,
    }  # fmt: skip
    if "validation" in parts:
        row |= validated(drawn, record, clean, coloured, rng)
    if "selection" in parts:
        row["selection"] = selected(drawn, record)
    return row


def validated(
    drawn: Drawn, record: Record, clean: Array, coloured: bool, rng: np.random.Generator
) -> Row:
    """Right model on its own record and another one; one kind of wrong model."""
    count = record.n_samples
    right = ThreeModel(noise="ar" if coloured else "white")
    other = noisy(drawn, clean, noise(rng, count, coloured))
    found = {
        "own": said(record, drawn.structure, right, None),
        "other": said(record, drawn.structure, right, other),
    }
    kind = list(WRONG)[int(rng.integers(len(WRONG)))]
    structure, method, spoiled = drawn.structure, right, record
    if kind == "order":
        structure = Structure(
            drawn.order - 1, min(drawn.zeros, drawn.order - 2), offset=False, initial_state="rest"
        )
    elif kind == "delay":
        late = max(0.1 / float(np.min(np.abs(drawn.poles))), 3.0 * float(record.dt or 0.0))
        moved = simulate(model_of(drawn, late), drawn.record)[:, 0]
        spoiled = noisy(drawn, moved, noise(rng, count, coloured))
    elif kind == "coloured":
        method = ThreeModel(noise="white")
        spoiled = noisy(drawn, clean, noise(rng, count, True))
    else:
        x = np.linspace(0.0, 1.0, count)
        slow = (x**2 + 0.5 * np.sin(4 * x)) * 0.5 * np.std(clean) / drawn.noise_std
        spoiled = noisy(drawn, clean, noise(rng, count, coloured) + slow)
    return found | {"wrong": kind, "said": said(spoiled, structure, method, None)}


def selected(drawn: Drawn, record: Record) -> Row:
    """Orders that the rule and the criteria choose."""
    candidates = [
        Structure(n, m, offset=False, initial_state="rest")
        for n in range(1, MOST_POLES + 1)
        for m in range(n)
    ]
    before = time.process_time()
    try:
        found = select_structure(record, candidates)
    except TridentifyError as error:
        return {"refused": type(error).__name__}
    seconds = time.process_time() - before
    usable = [row for row in found.rows if row.ok]
    true = next(
        row
        for row, one in zip(found.rows, candidates, strict=True)
        if (one.poles, one.zeros) == (drawn.order, drawn.zeros)
    )
    chosen = {"rule": 0 if found.recommended is None else found.recommended.structure.poles}
    for name in ("aicc", "bic", "yic"):
        rows = [row for row in usable if np.isfinite(getattr(row, name))]
        best = min(rows, key=lambda row: float(getattr(row, name)), default=None)
        chosen[name] = 0 if best is None else best.structure.poles
    known = bool(true.ok and true.relative_std < 0.5)
    hankel = None if found.hankel is None else found.hankel.order
    return {"chosen": chosen, "known": known, "hankel": hankel, "seconds": seconds}


def cause(task: tuple[str, int]) -> Row:
    """What is said of one record of a kind of `wrong_records`."""
    kind, seed = task
    case, row = wrong_records.draw(kind, seed), {"kind": kind, "seed": seed}
    records = list(case.records)
    try:
        estimate = identify(records, case.structure, throw=False)
        checked = validate(estimate, records).findings if estimate.status.ok else ()
    except TridentifyError as error:
        return row | {"refused": type(error).__name__}
    serious = [finding.code for finding in joined(estimate.findings, checked) if finding.matters]
    first = serious[0] if serious else ""
    return row | {"serious": serious, "first": first, "wanted": list(case.codes)}


def causes_report(rows: Sequence[Row]) -> list[str]:
    """First-named causes of every kind, and false alarms."""
    lines = [f"{'kind':28s}{'records':>8s}{'told':>6s}{'named':>7s}   first said"]
    right, wrong = [], []
    for kind in wrong_records.KINDS:
        own = [row for row in rows if row["kind"] == kind and "refused" not in row]
        if not own:
            continue
        told = [row for row in own if row["first"]]
        named = [row for row in told if row["first"] in row["wanted"]]
        (wrong if own[0]["wanted"] else right).append((len(own), len(told), len(named)))
        firsts = Counter(row["first"] for row in told)
        text = ", ".join(f"{name} {n}" for name, n in firsts.most_common(5))
        lines.append(f"{kind:28s}{len(own):8d}{len(told):6d}{len(named):7d}   {text}".rstrip())
    drawn, told_all, named_all = (sum(one[k] for one in wrong) for k in range(3))
    fine, alarms = (sum(one[k] for one in right) for k in range(2))
    refused = sum("refused" in row for row in rows)
    return [
        *lines,
        f"something said of {told_all} of {drawn} ({share(told_all, drawn).strip()} %), the cause "
        f"first in {named_all} of these ({share(named_all, told_all).strip()} %)",
        f"false alarms: {alarms} of {fine} ({share(alarms, fine).strip()} %); refused: {refused}",
    ]


LENGTHS, LEVELS = (200, 500, 1500), (10.0, 20.0, 30.0)
"""Samples and signal-to-noise ratios [dB] of the loops."""


def looped(task: tuple[str, int, int, float]) -> Row:
    """What is said of a random loop, or of an open-loop record beside it."""
    kind, seed, n, snr = task
    if kind == "open":
        stable = loops.draw(
            seed, n=n, snr=snr, keep=lambda one: bool(one.poles.real.max() < loops.STABLE)
        )
        drawn = loops.opened(stable, seed)
    else:
        drawn = loops.draw(seed, n=n, snr=snr, excitation="none" if kind == "silent" else None)
    row: Row = {"kind": kind, "seed": seed, "samples": n, "snr": snr, "order": drawn.poles.size,
                "stable": bool(drawn.poles.real.max() < loops.STABLE),
                "controller": drawn.controller, "excitation": drawn.excitation}  # fmt: skip
    try:
        estimate = identify(drawn.record, drawn.structure, throw=False)
    except TridentifyError as error:
        return row | {"refused": type(error).__name__}
    if not estimate.status.ok:
        return row | {"refused": estimate.status.name}
    off = np.abs(estimate.theta - drawn.theta)
    size = np.maximum(np.abs(drawn.theta), loops.NOTHING)
    z = (estimate.theta - drawn.theta) / np.where(estimate.std > 0, estimate.std, np.inf)
    said_ = {finding.code: finding.severity for finding in reversed(estimate.findings)}
    return row | {
        "said": said_,
        "route": estimate.route,
        "z": z.tolist(),
        "wrong": bool(np.any((np.abs(z) > 5.0) & (off > 0.2 * size))),
        "serious": any(finding.matters for finding in estimate.findings),
    }


def feedback_report(rows: Sequence[Row]) -> list[str]:
    """Detection by length and noise, false alarms, what is confident and wrong."""
    told = [row for row in rows if "refused" not in row]
    lines = [f"{'feedback found [%]':24s}" + "".join(f"{n:>8d} samples" for n in LENGTHS)]
    for kind, words in (("loop", "loops"), ("open", "open loop (alarms)")):
        for snr in (*LEVELS, None):
            cells = []
            for n in LENGTHS:
                own = [r for r in told if r["kind"] == kind and r["samples"] == n]
                own = [r for r in own if snr in (r["snr"], None)]
                cells.append(share(sum("feedback" in r["said"] for r in own), len(own)))
            level = "all" if snr is None else f"{snr:g} dB"
            lines.append(f"{words + ', ' + level:24s}" + "".join(f"{c:>16s}" for c in cells))
    own = [row for row in told if row["kind"] == "loop"]
    missed = [row for row in own if "feedback" not in row["said"]]
    lines += [
        "",
        f"loops where it is found: {len(own) - len(missed)} of {len(own)}; largest error of a "
        f"coefficient where it is not, median over these: {_median_of(missed)} standard errors",
        _alarms([row for row in told if row["kind"] == "open"]),
        f"confident and wrong: {sum(r['wrong'] and not r['serious'] for r in own)} of {len(own)} "
        f"loops; wrong in all: {sum(r['wrong'] for r in own)}, of these called an error: "
        f"{sum(r['wrong'] and 'error' in r['said'].values() for r in own)}",
        *_direct([row for row in own if row["route"] == "direct"]),
        "",
        *_silent([row for row in told if row["kind"] == "silent"]),
        f"refused: {len(rows) - len(told)} of {len(rows)}",
    ]
    return lines


def _median_of(rows: Sequence[Row]) -> str:
    return f"{np.median([np.max(np.abs(r['z'])) for r in rows]):.1f}" if rows else "-"


def _alarms(rows: Sequence[Row]) -> str:
    feedback = sum("feedback" in row["said"] for row in rows)
    silent = sum("loop-not-excited" in row["said"] for row in rows)
    return (
        f"false alarms in {len(rows)} open-loop records: feedback {feedback}, no excitation "
        f"{silent}"
    )


def _direct(rows: Sequence[Row]) -> list[str]:
    """Errors of the direct route where nothing says that it failed."""
    lines = []
    for name, stable in (("stable", True), ("integrating or unstable", False)):
        own = [row for row in rows if row["stable"] == stable]
        fine = [row for row in own if "error" not in row["said"].values()]
        if not fine:
            continue
        z = np.concatenate([row["z"] for row in fine])
        lines.append(
            f"direct route, {name} plants: {len(own)} records, an error is said of "
            f"{len(own) - len(fine)}; in the others {z.size} coefficients, 95 % intervals cover "
            f"{100 * np.mean(np.abs(z) < 1.96):.1f} %, mean error {np.mean(np.clip(z, -5, 5)):.2f} "
            f"standard errors (cut at 5)"
        )
    return lines


def _silent(rows: Sequence[Row]) -> list[str]:
    """Loops that nothing moves from outside."""
    found = Counter(row["said"].get("loop-not-excited", "nothing") for row in rows)
    text = ", ".join(f"{name} {n}" for name, n in sorted(found.items()))
    wrong = sum(row["wrong"] and not row["serious"] for row in rows)
    return [
        f"constant set point and nothing else, {len(rows)} loops; said of the excitation: {text}; "
        f"confident and wrong {wrong}"
    ]


def by_feedback(options: argparse.Namespace) -> None:
    """Draw, judge and print loops and what stands beside them."""
    grid = [(n, snr) for n in LENGTHS for snr in LEVELS]
    tasks = [
        (kind, options.first + len(grid) * k + i, n, snr)
        for kind in ("loop", "open", "silent")
        for i, (n, snr) in enumerate(grid)
        for k in range(options.each if kind != "silent" else max(options.each // 4, 1))
    ]
    with ProcessPoolExecutor(max_workers=options.workers) as pool:
        rows = list(pool.map(looped, tasks, chunksize=2))
    head = f"{options.each} loops of each length and noise level (seeds from {options.first})"
    text = "\n".join([head, "", *feedback_report(rows)])
    print("\n" + text)
    if options.save:
        keep("feedback", text, {"first": options.first, "each": options.each, "rows": rows})


def share(part: int, whole: int) -> str:
    return f"{100 * part / whole:5.1f}" if whole else "    -"


def rates(rows: Sequence[Row], key: str) -> list[str]:
    """False alarms of right models, by noise and length."""
    lines = []
    groups: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if "refused" in row[key]:
            continue
        tone = "AR" if row["coloured"] else "white"
        for name in ("all", tone, f"{row['samples']} samples", f"{tone} {row['samples']}",
                     row["input"], f"{row['snr']} dB"):  # fmt: skip
            groups[name].append(row)
    for name in sorted(groups, key=lambda name: (name != "all", name)):
        own = groups[name]
        wrong = [row for row in own if row[key]["serious"]]
        kinds = Counter(row[key]["first"] for row in wrong)
        told = ", ".join(f"{kind} {n}" for kind, n in kinds.most_common())
        counts = f"{len(wrong):4d} of {len(own):4d} {share(len(wrong), len(own))} %"
        lines.append(f"  {name:14s} {counts}   {told}".rstrip())
    return lines


def validation_report(rows: Sequence[Row]) -> list[str]:
    lines = ["right models called wrong (claimed: 1 %), on their own record"]
    lines += rates(rows, "own")
    lines += ["", "on another record of the same system and input"]
    lines += rates(rows, "other")
    lines += ["", f"{'wrong models':14s} {'found':>12s} {'named':>7s}   first said"]
    for kind in WRONG:
        own = [row["said"] for row in rows if row["wrong"] == kind]
        told = [one for one in own if "refused" not in one]
        found = [one for one in told if one["serious"]]
        named = sum(one["first"] == WRONG[kind] for one in found)
        firsts = Counter(one["first"] for one in found)
        text = ", ".join(f"{name} {n}" for name, n in firsts.most_common())
        refused = f"; not usable anyway {len(own) - len(told)}" if len(own) > len(told) else ""
        lines.append(
            f"  {kind:12s} {len(found):4d} of {len(told):4d} {share(named, len(told))} %   "
            f"{text}{refused}"
        )
    return lines


def confusion(rows: Sequence[Row]) -> list[str]:
    """How often which order is recommended, for every true order."""
    pairs = Counter((row["order"], row["selection"]["chosen"]["rule"]) for row in rows)
    lines = []
    for order in sorted({true for true, _ in pairs}):
        own = {chosen: n for (true, chosen), n in sorted(pairs.items()) if true == order}
        text = ", ".join(f"{chosen} in {n}" for chosen, n in own.items())
        lines.append(f"  true order {order}: recommended {text}")
    return lines


def selection_report(rows: Sequence[Row]) -> list[str]:
    told = [row for row in rows if "refused" not in row["selection"]]
    lines = [
        f"{'order chosen [%]':18s} {'right':>7s} {'too high':>9s}   "
        "the same where the coefficients of the true orders are known to 50 %",
    ]
    known = [row for row in told if row["selection"]["known"]]
    for name in ("rule", "bic", "aicc", "yic"):
        cells = []
        for group in (told, known):
            chosen = [(row["selection"]["chosen"][name], row["order"]) for row in group]
            cells.append(share(sum(a == b for a, b in chosen), len(chosen)))
            cells.append(share(sum(a > b for a, b in chosen), len(chosen)))
        lines.append(f"  {name:16s} {cells[0]:>7s} {cells[1]:>9s}   {cells[2]:>7s} {cells[3]:>9s}")
    hankel = [
        (row["selection"]["hankel"], row["order"])
        for row in told
        if row["selection"]["hankel"] is not None
    ]
    seconds = np.array([row["selection"]["seconds"] for row in told])
    lines += confusion(told)
    lines += [
        f"{len(told)} records, {len(known)} of them known; {len(rows) - len(told)} refused",
        f"Hankel singular values above the noise: as many as poles "
        f"{share(sum(a == b for a, b in hankel), len(hankel)).strip()} %, more "
        f"{share(sum(a > b for a, b in hankel), len(hankel)).strip()} %",
        f"{MOST_POLES * (MOST_POLES + 1) // 2} candidates: median {np.median(seconds):.1f} s, "
        f"90 % within {np.quantile(seconds, 0.9):.1f} s of processor time",
    ]
    return lines


def run(count: int, seed: int, parts: Sequence[str], workers: int) -> Iterator[Row]:
    """The identifiable ones of so many records."""
    with ProcessPoolExecutor(max_workers=workers) as pool:
        work = partial(judge, seed=seed, parts=parts)
        yield from filter(None, pool.map(work, range(count), chunksize=4))


def by_cause(options: argparse.Namespace) -> None:
    """Draw, judge and print the records of every kind."""
    seeds = range(options.first, options.first + options.each)
    tasks = [(kind, seed) for kind in wrong_records.KINDS for seed in seeds]
    with ProcessPoolExecutor(max_workers=options.workers) as pool:
        rows = list(pool.map(cause, tasks, chunksize=4))
    head = f"{options.each} records of each kind (seeds from {options.first})"
    text = "\n".join([head, "", *causes_report(rows)])
    print("\n" + text)
    if options.save:
        keep("causes", text, {"first": options.first, "each": options.each, "rows": rows})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=600)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--parts", default="validation,selection,causes")
    parser.add_argument("--each", type=int, default=40, help="records of each kind: causes, loops")
    parser.add_argument("--first", type=int, default=FIRST, help="seed of the first of them")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    options = parser.parse_args()
    parts = options.parts.split(",")
    before = time.perf_counter()
    if "causes" in parts:
        by_cause(options)
    if "feedback" in parts:
        by_feedback(options)
    if not {"validation", "selection"} & set(parts):
        return
    rows: list[Row] = []
    for row in run(options.records, options.seed, parts, options.workers):
        rows.append(row)
        if len(rows) % 50 == 0:
            print(f"{len(rows)} records, {time.perf_counter() - before:.0f} s", file=sys.stderr)
    head = (
        f"{options.records} random records (seed {options.seed}), {len(rows)} of them identifiable"
    )
    for part, report in (("validation", validation_report), ("selection", selection_report)):
        if part not in parts:
            continue
        text = "\n".join([head, "", *report(rows)])
        print("\n" + text)
        if options.save:
            keep(part, text, {"seed": options.seed, "records": options.records, "rows": rows})


if __name__ == "__main__":
    main()
