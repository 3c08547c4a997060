"""Convergence without luck: how often each method ends at the lowest cost that is known.

Random records (`random_systems`); every method of ``METHODS`` gets the right orders and is told
that the record starts at rest without offset. The cost is the output error of its model, simulated
here. The lowest cost known is that of all methods and of output error started at the truth.
A method reaches it when ``N log(cost / lowest)``, the difference in -2 log L, is below 0.01:
coefficients then differ by less than a tenth of a standard error. Methods that do not minimise
this cost mostly do not reach it by themselves; ``+ output error`` is output error started at
their model.

A record is identifiable when the Cramer-Rao bound at the truth is below half of every coefficient
(`random_systems.Drawn.weakest`).
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
from machine import HERE, keep
from random_systems import INPUTS, LENGTHS, SEED, Drawn, draw

from tridentify import Estimate, Record, TransferFunction, identify, simulate
from tridentify.estimation.methods.base import Method
from tridentify.estimation.methods.output_error import OutputError
from tridentify.identify import METHODS

REACHED = 0.01
STRICT = 1e-6
RECORDS = 5000
RIVALS = 1000
OURS = "three-model"
TRUTH = "output error from the truth"
THEN = " + output error"
MINIMISERS = (OURS, "output-error")
AIM = 0.999
GROUPS = ("order", "input", "snr", "samples")

Row = dict[str, Any]


def contestants(with_rivals: bool) -> dict[str, Method]:
    """Every method of the table with its default options, on the likelihood of white noise."""
    names = METHODS if with_rivals else (OURS,)
    return {name: white(METHODS[name]()) for name in names}


def white(method: Method) -> Method:
    """The method on the likelihood of white noise, so that all costs are the same."""
    wanted = {"noise": "white", "finish": "likelihood"}
    known = {field.name for field in fields(method)}  # type: ignore[arg-type]
    chosen = {name: value for name, value in wanted.items() if name in known}
    if chosen:
        return replace(method, **chosen)  # type: ignore[type-var, arg-type]
    return method


def started_at(model: TransferFunction) -> Method:
    """Output error from a given model."""
    return white(OutputError(start=model))


def truth_of(drawn: Drawn) -> TransferFunction:
    """The model that made the record."""
    n = drawn.order
    return TransferFunction(drawn.theta[n:], np.append(1.0, drawn.theta[:n]))


def cost(model: TransferFunction, record: Record) -> float:
    """Sum of squared output errors; infinite for a model whose output overflows."""
    with np.errstate(all="ignore"):
        error = record.y - simulate(model, record)
        total = float(np.einsum("ij,ij->", error, error))
    return total if np.isfinite(total) else float("inf")


def attempt(drawn: Drawn, method: Method) -> tuple[Row, Estimate | None]:
    """One estimation: its cost and status, or the exception; and the processor time."""
    before = time.process_time()
    told, estimate = "", None
    try:
        estimate = identify(drawn.record, drawn.structure, method, throw=False)
    except Exception as error:
        told = f"{type(error).__name__}: {error}"
    seconds = time.process_time() - before
    found = float("inf") if estimate is None else cost(estimate.model, drawn.record)
    return {
        "cost": found,
        "status": "-" if estimate is None else estimate.status.name,
        "ok": estimate is not None and estimate.status.ok,
        "error": told,
        "seconds": seconds,
    }, estimate


def judge(number: int, seed: int, rivals: int, lengths: tuple[int, int] = LENGTHS) -> Row:
    """All methods on one record."""
    drawn = draw(number, seed, lengths)
    tried: dict[str, Row] = {}
    for name, method in contestants(number < rivals).items():
        tried[name], estimate = attempt(drawn, method)
        if name not in MINIMISERS:
            then = dict(tried[name])
            if estimate is not None:
                then = attempt(drawn, started_at(estimate.model))[0]
                then["seconds"] += tried[name]["seconds"]
            tried[name + THEN] = then
    tried[TRUTH] = attempt(drawn, started_at(truth_of(drawn)))[0]
    lowest = min(one["cost"] for one in tried.values())
    for one in tried.values():
        ratio = one.pop("cost") / lowest
        one["relative"] = ratio - 1.0
        one["excess"] = drawn.record.n_samples * float(np.log(ratio))
    return {
        "number": number,
        "order": drawn.order,
        "zeros": drawn.zeros,
        "input": drawn.input,
        "snr": drawn.snr,
        "samples": drawn.record.n_samples,
        "weakest": drawn.weakest,
        "identifiable": drawn.identifiable,
        "methods": tried,
    }


def run(numbers: Sequence[int], seed: int, rivals: int, lengths: tuple[int, int]) -> Iterator[Row]:
    """All records, two at a time."""
    with ProcessPoolExecutor(max_workers=2) as pool:
        yield from pool.map(
            partial(judge, seed=seed, rivals=rivals, lengths=lengths), numbers, chunksize=10
        )


def reached(row: Row, method: str) -> bool:
    """Whether a method ended at the lowest cost known."""
    return bool(row["methods"][method]["excess"] < REACHED)


def summary(rows: Sequence[Row], method: str) -> Row:
    """Counts of one method over the records that it was given."""
    own = [row for row in rows if method in row["methods"]]
    good = [row for row in own if row["identifiable"]]
    found = [row["methods"][method] for row in own]
    errors = Counter(one["error"].partition(":")[0] for one in found if one["error"])
    return {
        "records": len(own),
        "reached": sum(reached(row, method) for row in own),
        "identifiable": len(good),
        "identifiable reached": sum(reached(row, method) for row in good),
        "identifiable within 1e-6": sum(
            row["methods"][method]["relative"] < STRICT for row in good
        ),
        "identifiable not ok": sum(not row["methods"][method]["ok"] for row in good),
        "exceptions": dict(errors),
        "median seconds": float(np.median([one["seconds"] for one in found])),
        "groups": {
            name: {
                str(value): [
                    sum(reached(row, method) for row in good if row[name] == value),
                    sum(row[name] == value for row in good),
                ]
                for value in dict.fromkeys(row[name] for row in rows)
            }
            for name in GROUPS
        },
    }


def share(part: int, whole: int) -> str:
    """Per cent, two digits after the point only near the ends."""
    percent = 100.0 * part / whole if whole else float("nan")
    return f"{percent:.2f}" if percent > 99.0 else f"{percent:.1f}"


def report(rows: Sequence[Row], seed: int, seconds: float) -> tuple[str, dict[str, Row]]:
    """The text and the counts behind it."""
    names = [*dict.fromkeys(name for row in rows for name in row["methods"])]
    names.sort(key=lambda name: (name == TRUTH, name != OURS))
    found = {name: summary(rows, name) for name in names}
    width = max(map(len, names))
    good = sum(row["identifiable"] for row in rows)
    lines = [
        f"{len(rows)} records (seed {seed}), {good} of them identifiable; {seconds:.0f} s",
        "",
        f"{'':{width}s}  identifiable records           all records           exceptions   median",
        f"{'reached the lowest cost known':{width}s}     reached of       %      reached of       %"
        "   (all)     [ms]",
    ]
    for name, one in found.items():
        counted = one["identifiable reached"], one["identifiable"]
        whole = one["reached"], one["records"]
        lines.append(
            f"{name:{width}s}  {counted[0]:10d} {counted[1]:5d} {share(*counted):>6s}"
            f"  {whole[0]:10d} {whole[1]:5d} {share(*whole):>6s}"
            f"  {sum(one['exceptions'].values()):8d} {1e3 * one['median seconds']:8.1f}"
        )
    lines += ["", "per cent of the identifiable records, by"]
    head = f"{'':{width}s} "
    for group, values in found[OURS]["groups"].items():
        head += " |" + "".join(f"{group + ' ' if i == 0 else ''}{value}".rjust(9 if i else 12)
                               for i, value in enumerate(values))  # fmt: skip
    lines.append(head)
    for name, one in found.items():
        row = f"{name:{width}s} "
        for values in one["groups"].values():
            cells = (share(*pair) for pair in values.values())
            row += " |" + "".join(cell.rjust(9 if i else 12) for i, cell in enumerate(cells))
        lines.append(row)
    ours = found[OURS]
    met = ours["identifiable reached"] >= AIM * ours["identifiable"] and not ours["exceptions"]
    strict = ours["identifiable within 1e-6"]
    lines += [
        "",
        f"{OURS}: {ours['identifiable reached']} of {ours['identifiable']} "
        f"({strict} within {STRICT:.0e} of the cost), exceptions {ours['exceptions'] or 'none'}, "
        f"status not ok in {ours['identifiable not ok']}; "
        f"aim {AIM:.1%} without an exception: {'met' if met else 'missed'}",
        *missed(rows),
    ]
    return "\n".join(lines), found


def missed(rows: Sequence[Row]) -> list[str]:
    """Every identifiable record where ours did not reach the lowest cost known."""
    lines = []
    for row in rows:
        if not row["identifiable"] or reached(row, OURS):
            continue
        ours = row["methods"][OURS]
        better = [name for name in row["methods"] if reached(row, name)]
        lines.append(
            f"  {row['number']}: {row['order']} poles, {row['zeros']} zeros, {row['input']}, "
            f"{row['snr']} dB, {row['samples']} samples; -2 log L {ours['excess']:+.3g} "
            f"({ours['error'] or ours['status']}); reached by {', '.join(better)}"
        )
    return ["missed:", *lines] if lines else []


def picture(found: dict[str, Row], path: str) -> None:
    """Share reached per method and input."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = [name for name in found if name != TRUTH]
    names.sort(key=lambda name: (name != OURS, name in METHODS, name))
    colours = ("#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00")
    figure, axes = pyplot.subplots(figsize=(8.0, 0.72 * len(names) + 1.4), layout="constrained")
    height = 0.8 / len(INPUTS)
    for k, kind in enumerate(INPUTS):
        pairs = [found[name]["groups"]["input"][kind] for name in names]
        shares = [100.0 * part / whole if whole else 0.0 for part, whole in pairs]
        at = np.arange(len(names)) - 0.4 + (k + 0.5) * height
        axes.barh(at, shares, 0.9 * height, color=colours[k], label=kind)
        for y, value in zip(at, shares, strict=True):
            axes.text(value + 0.6, y, f"{value:.3g}", va="center", fontsize=6.5)
    axes.set_yticks(np.arange(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 107.0)
    axes.set_xticks(range(0, 101, 20))
    axes.set_xlabel("identifiable records where the lowest cost known is reached [%]")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper right", ncols=len(INPUTS), frameon=False)
    figure.savefig(path, dpi=130)


def study(number: int, seed: int, lengths: tuple[int, int]) -> None:
    """One record in detail."""
    drawn = draw(number, seed, lengths)
    print(
        f"record {number} (seed {seed}): {drawn.structure.poles} poles, {drawn.zeros} zeros, "
        f"{drawn.input}, {drawn.snr} dB, {drawn.record.n_samples} samples every "
        f"{drawn.record.dt:.4g} s; largest relative bound {drawn.weakest:.3g}"
    )
    print("poles", np.array2string(drawn.poles, precision=4))
    print("zeros", np.array2string(drawn.zero_values, precision=4))
    row = judge(number, seed, number + 1, lengths)
    width = max(map(len, row["methods"]))
    for name, one in row["methods"].items():
        told = one["error"] or one["status"]
        print(f"  {name:{width}s} -2 log L {one['excess']:+12.5g}  {told}")
    samples, estimate = drawn.record.n_samples, attempt(drawn, contestants(False)[OURS])[1]
    for start in estimate.trace.starts if estimate is not None else ():
        excess = samples * np.log(start.cost / estimate.cost)
        print(f"  start: {start.name}: -2 log L {excess:+.4g} to the end")


def check_bound(numbers: Sequence[int] = (0, 7, 22, 41)) -> float:
    """Largest relative difference of our bound to the package's standard errors.

    The noise is made a millionth, so that the estimate is as good as the truth.
    """
    worst, small = 0.0, 1e-6
    for number in numbers:
        drawn = draw(number)
        truth = simulate(truth_of(drawn), drawn.record)
        record = Record(
            drawn.record.u,
            truth + small * (drawn.record.y - truth),
            dt=drawn.record.dt,
            intersample=drawn.record.intersample,
        )
        estimate = identify(record, drawn.structure, started_at(truth_of(drawn)), throw=False)
        level = np.sqrt(estimate.noise_variance[0]) / drawn.noise_std
        bound = level * np.sqrt(np.diag(drawn.bound))
        worst = max(worst, float(np.max(np.abs(estimate.std / bound - 1.0))))
    return worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=RECORDS)
    parser.add_argument("--rivals", type=int, default=RIVALS, help="records all methods get")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument(
        "--lengths", type=int, nargs=2, default=LENGTHS, metavar="SAMPLES",
        help="of the records, in turn (default %(default)s)",
    )  # fmt: skip
    parser.add_argument("--only", type=int, metavar="NUMBER", help="one record, in detail")
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    options = parser.parse_args()
    lengths = options.lengths[0], options.lengths[1]
    if options.only is not None:
        study(options.only, options.seed, lengths)
        return
    print(f"bound against the package's standard errors: within {check_bound():.1e}", flush=True)
    before = time.perf_counter()
    rows: list[Row] = []
    for row in run(range(options.records), options.seed, options.rivals, lengths):
        rows.append(row)
        if len(rows) % 250 == 0:
            print(f"{len(rows)} records, {time.perf_counter() - before:.0f} s", file=sys.stderr)
    text, found = report(rows, options.seed, time.perf_counter() - before)
    print("\n" + text)
    if options.save:
        (HERE / "results").mkdir(exist_ok=True)
        picture(found, str(HERE / "results" / "convergence.png"))
        misses = [row for row in rows if not reached(row, OURS)]
        for row in misses:
            for one in row["methods"].values():
                one.update({k: None for k in ("relative", "excess") if not np.isfinite(one[k])})
        keep("convergence", text, {"seed": options.seed, "methods": found, "misses": misses})


if __name__ == "__main__":
    main()
