"""Real records: order recommended, coefficients against published ones, findings, halves, time.

The records are public but not part of this repository: they are looked for in ``../shared/data``
beside it, or where TRIDENTIFY_SHARED_DATA says; a line tells which are not there. What they are,
who published them and under which licence stands in the README of each of their folders.

*Halves* are identified by themselves with the same structure, where the input moves in both; the
largest difference of a coefficient is told in joint standard errors. *Another record* is one of the
same system: the fit there is with the coefficients held, its start and offset its own, and *again*
compares the coefficients that it has by itself, whatever else was different. Published
values that have no stated error count as exact. The simulated flights (JSBSim) get the noise of a
typical flight test.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from machine import keep

from tridentify import (
    Estimate,
    Record,
    Structure,
    TridentifyError,
    identify,
    read_record,
    select_structure,
    validate,
)

REPOSITORY = Path(__file__).resolve().parents[1]
SEED = 20261122
ACTIVE = 0.2
"""Movement of the input in one half, in that of the other, from which the halves are compared."""

CHANGED = ("varying", "disagreeing-experiments")
"""Findings that say that one set of coefficients does not hold for the whole record."""


@dataclass(frozen=True)
class Item:
    """One system and its records.

    Attributes
    ----------
    name, folder, file : str
    inputs, outputs : tuple of str
    structure : Structure
        The physically right one, as far as it is known.
    order : tuple of str
        Poles and zeros that count as right; empty where none is known.
    published : mapping of str to float
        Coefficients.
    source : str
        Of these.
    other : str
        Another record of the system.
    time : str or None
        Column of the time; None where there is none (a step of 1).
    factor : int
        Every so many samples are kept, after a filter.
    candidates : sequence of Structure
        What the order is chosen from; by default one to four poles.
    noise : float
        Standard deviation added to the outputs.
    cut : tuple of (start, stop), optional
        Stretch that is used [s].
    """

    name: str
    folder: str
    file: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    structure: Structure
    order: tuple[str, ...] = ()
    published: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    other: str = ""
    time: str | None = "t"
    factor: int = 1
    candidates: tuple[Structure, ...] = ()
    noise: float = 0.0
    cut: tuple[float, float] | None = None


SOURCE_ATTAS = "README of the set: output error, rough (the book's final values are not at hand)"
SOURCE_JSBSIM = "central differences of JSBSim's own accelerations at trim"
FLIGHT = ("2, 1",)
INTEGRATOR = {"a0": 0.0}

ITEMS = (
    Item("ATTAS 1", "attas-short-period", "data.csv", ("u_elevator",), ("y_q",), Structure(2, 1),
         FLIGHT, {"a1": 2.455, "a0": 6.355, "b1": -7.08, "b0": -6.58}, SOURCE_ATTAS, "data_2.csv"),
    Item("ATTAS 2", "attas-short-period", "data_2.csv", ("u_elevator",), ("y_q",), Structure(2, 1),
         FLIGHT, {"a1": 2.560, "a0": 6.405, "b1": -7.41, "b0": -6.90}, SOURCE_ATTAS, "data.csv"),
    Item("A-4 (JSBSim)", "jsbsim-a4-doublet", "data.csv", ("delta_e_rad",), ("q_rad_s",),
         Structure(2, 1), FLIGHT,
         {"a1": 1.89228, "a0": 8.89849, "b1": -8.82517, "b0": -8.18977}, SOURCE_JSBSIM,
         factor=4, noise=np.radians(0.2)),
    Item("C-172 (JSBSim)", "jsbsim-c172p-doublet", "data.csv", ("delta_e_rad",), ("q_rad_s",),
         Structure(2, 1), FLIGHT,
         {"a1": 7.6175, "a0": 40.241, "b1": -23.0123, "b0": -55.2369}, SOURCE_JSBSIM,
         factor=4, noise=np.radians(0.2)),
    Item("T-37 (JSBSim)", "jsbsim-t37-3211", "data.csv", ("delta_e_rad",), ("q_rad_s",),
         Structure(2, 1), FLIGHT,
         {"a1": 11.0317, "a0": 31.395, "b1": -21.1698, "b0": -41.1144}, SOURCE_JSBSIM,
         factor=4, noise=np.radians(0.2)),
    Item("RCRC circuit", "rcrc-circuit", "data.csv", ("u",), ("y",), Structure(2, 0, delay=0.001),
         ("2, 0",), {"a1": 2500.0, "a0": 5e5, "b0": 5e5},
         "nominal values of the parts (5 %); one sample of delay", "data_val.csv"),
    Item("EMPS drive", "emps", "data.csv", ("u_volt",), ("y_pos",),
         Structure(2, 0, fixed=INTEGRATOR), ("2, 0",),
         {"a1": 203.50 / 95.1089, "b0": 35.1506519 / 95.1089},
         "Janot, Gautier, Brunot 2019: M = 95.11 kg, Fv = 203.5 N s/m; Coulomb friction besides",
         "data_pulses.csv", factor=10,
         candidates=tuple(Structure(n, m, fixed=INTEGRATOR) for n in (1, 2, 3) for m in range(n))),
    Item("Cascaded tanks", "cascaded-tanks", "data.csv", ("u",), ("y",), Structure(2, 0),
         ("1, 0", "2, 0", "2, 1"), {"a1": 0.02623, "a0": 1.1945e-4, "b0": 5.506e-4},
         "README of the set: output error, rough", "data_val.csv"),
    Item("Heating system", "heating-system", "data.csv", ("u",), ("y",), Structure(2, 1),
         ("1, 0", "2, 0", "2, 1"),
         {"a1": 0.0181 + 0.00037, "a0": 0.0181 * 0.00037},
         "README of the set: output error, rough; its slow pole is poorly determined"),
    Item("TCLab, one heater", "tclab", "data_step.csv", ("u",), ("y",), Structure(2, 0),
         ("1, 0", "2, 0", "2, 1"), {"a1": 0.0102 + 0.046, "a0": 0.0102 * 0.046},
         "README of the set: output error on the first half, rough"),
    Item("TCLab, two heaters", "tclab-closed-loop", "open_loop.csv", ("u1", "u2"), ("y1",),
         Structure(2, 0), (), {}, "none; the record in closed loop has another operating point",
         "closed_loop_1.csv", factor=4,
         candidates=tuple(Structure(n, m) for n in (1, 2, 3) for m in range(n))),
    Item("Coupled drives", "coupled-drives", "data_prbs1.csv", ("u",), ("y",), Structure(3, 0),
         (), {"a2": 19.93, "a1": 509.8, "a0": 2835.0, "b0": 5163.0},
         "Wigren, Schoukens 2017, of an Euler model of |y|: not the linear coefficients",
         "data_prbs2.csv"),
    Item("Robot arm", "robot-arm", "data.csv", ("u",), ("y",), Structure(4, 4), (),
         {"a3": 0.0112, "a2": 0.767626, "a1": 0.0033990, "a0": 0.084881},
         "README of the set: output error, rough (poles at 0.366 and 0.796)", time=None,
         candidates=(Structure(2, 2), Structure(4, 3), Structure(4, 4), Structure(6, 6))),
    Item("Motor bench", "motor-bench-multisine", "data.parquet", ("iq",), ("theta_m",),
         Structure(4, 2), (), {}, "none", factor=2, cut=(1.0, 4.0),
         candidates=(Structure(2, 0), Structure(3, 1), Structure(4, 2))),
)  # fmt: skip


def shared_data() -> Path:
    """The folder with the public records, as for the tests."""
    named = os.environ.get("TRIDENTIFY_SHARED_DATA")
    return Path(named) if named else REPOSITORY.parent / "shared" / "data"


def load(item: Item, file: str) -> Record:
    """Read one of its records."""
    sampling: dict[str, Any] = {"dt": 1.0} if item.time is None else {"time": item.time}
    path = shared_data() / item.folder / file
    record = read_record(
        path, inputs=list(item.inputs), outputs=list(item.outputs), intersample="auto", **sampling
    )
    if item.cut is not None:
        record = record.slice(*item.cut)
    if item.noise:
        rng = np.random.default_rng(SEED)
        record = _thinned(record, item.factor)
        noise = item.noise * rng.standard_normal(record.y.shape)
        return record.with_outputs(record.y + noise)
    return record if item.factor == 1 else _thinned(record, item.factor)


def _thinned(record: Record, factor: int) -> Record:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if record.behaviour == "zoh":
            return record.resample(factor * record.dt) if record.dt else record
        return record.decimate(factor)


def halves(item: Item, record: Record) -> tuple[float, int, int]:
    """Largest difference of a coefficient [joint errors], how many are within 3, of how many."""
    middle = float(record.t[record.n_samples // 2])
    moved = [float(np.std(part.u)) for part in record.split(middle)]
    if min(moved) < ACTIVE * max(moved):
        return float("nan"), 0, 0
    return agreement(*(_identified(item, part) for part in record.split(middle)))


def again(item: Item, estimate: Estimate) -> tuple[float, int, int]:
    """As `halves`, of this record and another one; two that name each other count once."""
    path = shared_data() / item.folder / item.other
    named = [(one.folder, one.other) for one in ITEMS[: ITEMS.index(item)]]
    if not item.other or not path.is_file() or (item.folder, item.file) in named:
        return float("nan"), 0, 0
    return agreement(estimate, _identified(item, load(item, item.other)))


def agreement(first: Estimate | None, second: Estimate | None) -> tuple[float, int, int]:
    """Largest difference of a coefficient [joint errors], how many are within 3, of how many."""
    if first is None or second is None:
        return float("nan"), 0, 0
    joint = np.sqrt(first.std**2 + second.std**2)
    known = (joint > 0) & np.isfinite(joint)
    if not known.any():
        return float("nan"), 0, 0
    off = np.abs(first.theta - second.theta)[known] / joint[known]
    return float(off.max()), int((off <= 3.0).sum()), int(off.size)


def _identified(item: Item, record: Record) -> Estimate | None:
    try:
        return identify(record, item.structure, throw=False)
    except TridentifyError:
        return None


def chosen(item: Item, record: Record) -> str:
    """Poles and zeros that are recommended."""
    delay = item.structure.delay
    plain = [Structure(n, m, delay=delay) for n in (1, 2, 3, 4) for m in range(n)]
    try:
        found = select_structure(record, list(item.candidates or plain))
    except TridentifyError as error:
        return type(error).__name__
    best = found.recommended
    return "none" if best is None else ", ".join(best.label.split(", ")[:2])


def judge(name: str) -> dict[str, Any]:
    """All about one item."""
    item = next(one for one in ITEMS if one.name == name)
    if not (shared_data() / item.folder / item.file).is_file():
        return {"name": name, "absent": True}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _judged(item)


def _judged(item: Item) -> dict[str, Any]:
    record = load(item, item.file)
    begun = time.process_time()
    try:
        estimate = identify(record, item.structure, throw=False)
    except TridentifyError as error:
        return {"name": item.name, "refused": str(error)}
    spent = time.process_time() - begun
    found: dict[str, Any] = {
        "name": item.name,
        "samples": record.n_samples,
        "structure": f"{item.structure.poles}, {item.structure.zeros}",
        "seconds": spent,
        "fit": [float(f) for f in estimate.fit],
        "status": estimate.status.name,
        "coefficients": _coefficients(item, estimate),
        "source": item.source,
        "identify": _first(estimate.findings),
        "changed": any(f.code in CHANGED for f in estimate.findings),
        "halves": halves(item, record),
        "again": again(item, estimate),
    }
    begun = time.process_time()
    try:
        found["validate"] = _first(validate(estimate, record).findings)
    except TridentifyError as error:
        found["validate"] = type(error).__name__
    found["seconds_validate"] = time.process_time() - begun
    found["elsewhere"] = _elsewhere(item, estimate)
    begun = time.process_time()
    found["order"] = chosen(item, record)
    found["right"] = (found["order"] in item.order) if item.order else None
    found["seconds_select"] = time.process_time() - begun
    return found


def _first(findings: Sequence[Any]) -> str:
    told = [finding.code for finding in findings if finding.matters]
    return told[0] if told else "none"


def _coefficients(item: Item, estimate: Estimate) -> list[dict[str, float | str | None]]:
    rows: list[dict[str, float | str | None]] = []
    for name, one in estimate.parameters.items():
        known = item.published.get(name)
        rows.append({"name": name, "value": one.value, "std": one.std, "published": known})
    return rows


def _elsewhere(item: Item, estimate: Estimate) -> float | None:
    """Fit on another record [%]."""
    if not item.other or not (shared_data() / item.folder / item.other).is_file():
        return None
    try:
        return float(validate(estimate, load(item, item.other)).fit[0])
    except TridentifyError:
        return None


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Two tables: what is said of each record, and the coefficients."""
    lines = [
        f"{'record':20s}{'samples':>8s}{'asked':>7s}{'chosen':>8s}{'right':>7s}{'fit %':>7s}"
        f"{'other %':>8s}{'halves':>12s}{'again':>12s}"
        f"{'identify s':>11s}{'validate s':>11s}{'select s':>9s}"
    ]
    known = [row for row in rows if "fit" in row]
    for row in known:
        halves, twice = _agreed(row["halves"]), _agreed(row["again"])
        other = "-" if row["elsewhere"] is None else f"{row['elsewhere']:.1f}"
        right = {True: "yes", False: "no", None: "-"}[row["right"]]
        lines.append(
            f"{row['name']:20s}{row['samples']:8d}{row['structure']:>7s}{row['order']:>8s}"
            f"{right:>7s}{row['fit'][0]:7.1f}{other:>8s}{halves:>12s}{twice:>12s}"
            f"{row['seconds']:11.1f}{row['seconds_validate']:11.1f}{row['seconds_select']:9.1f}"
        )
    for row in rows:
        if "absent" in row:
            lines.append(f"{row['name']:20s} not among the shared records: left out")
        elif "refused" in row:
            lines.append(f"{row['name']:20s} refused: {row['refused']}")
    told = sum(row["halves"][2 if row["changed"] else 1] for row in known)
    of = sum(row["halves"][2] for row in known)
    judged = [row["right"] for row in known if row["right"] is not None]
    lines += [
        "",
        f"right order: {sum(judged)} of {len(judged)} where one is known",
        f"coefficients of two halves within 3 joint standard errors: {_counted(known, 'halves')}",
        f"coefficients of two records within 3 joint standard errors: {_counted(known, 'again')}",
        f"agree or told (the estimate of the whole says that they differ): {told} of {of}",
        "",
        f"{'record':20s}{'identify, first finding':>26s}{'validate, first finding':>26s}",
    ]
    lines += [f"{r['name']:20s}{r['identify']:>26s}{r['validate']:>26s}" for r in known]
    heads = ("estimate", "std", "published", "off [std]", "off [%]")
    lines += ["", f"{'record':20s}{'':>10s}" + "".join(f"{head:>12s}" for head in heads)]
    for row in known:
        for one in row["coefficients"]:
            lines.append(f"{row['name']:20s}{one['name']:>10s}{_against(one)}")
        if any(one["published"] is not None for one in row["coefficients"]):
            lines.append(f"{'':20s}  published: {row['source']}")
    return lines


def _agreed(found: tuple[float, int, int]) -> str:
    worst, within, of = found
    return f"{worst:.1f} ({within}/{of})" if of else "-"


def _counted(rows: Sequence[dict[str, Any]], key: str) -> str:
    found = [row[key] for row in rows]
    return f"{sum(one[1] for one in found)} of {sum(one[2] for one in found)}"


def _against(one: dict[str, Any]) -> str:
    value, std, known = one["value"], one["std"], one["published"]
    text = f"{value:12.5g}{std:12.2g}"
    if known is None:
        return text
    off = value - known
    errors = f"{off / std:12.1f}" if std > 0 else f"{'-':>12s}"
    return f"{text}{known:12.5g}{errors}{100 * off / abs(known) if known else np.nan:12.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="which records (a part of the name); all if none")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    args = parser.parse_args()
    names = [
        item.name
        for item in ITEMS
        if not args.names or any(part.lower() in item.name.lower() for part in args.names)
    ]
    with ProcessPoolExecutor(args.jobs) as pool:
        rows = list(pool.map(judge, names))
    report = "\n".join(table(rows))
    print(report)
    if args.save:
        keep("real_records", report, rows)


if __name__ == "__main__":
    main()
