"""What the thresholds of the estimation do: each halved and doubled, on small records of all kinds.

Every numeric constant of ``tridentify.estimation`` (but for its ``answer``, which only writes, and
for guards of rounding below 1e-20) is halved and doubled wherever it is read, and the records that
reach a function that reads it are estimated again. Integers are rounded and stay at least 1; of a
share between a half and one the distance to one is changed. Told are, for each change, how many
estimates

- changed at all (one bit of a coefficient or a standard error, how it ended, what was found),
- moved: a coefficient by more than a tenth of its standard error, or a standard error by a tenth,
- are worse: AICc higher by more than 0.5, an exception, or a status that is no longer ok,

and the processor time over that of the same records with the threshold as it is. Two runs with
nothing changed differ by what the last line says.

The records: short ones (``--records``) of order 1 to 4, 0 to 40 dB, some told that they start at
rest; three long ones; coloured noise; outliers; missing samples and uneven time; two outputs;
unknown delays; knowledge of coefficients, true and wrong; every other method of the package. A
threshold that most short and long records reach is tried on these and on the quickest record of
each other kind (two of it for those in the table of `likelihood.thresholds`), others on all that
reach it. What is an option of the methods (the tolerance) is left to whoever sets it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import argparse
import ast
import importlib
import inspect
import json
import pkgutil
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any

import numpy as np
from machine import HERE, keep
from numpy.typing import NDArray
from random_systems import _input, _poles_and_step, _zeros
from scipy.signal import lfilter

import tridentify
from tridentify import METHODS, Record, Structure, ThreeModel, TransferFunction, simulate
from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import Method

Array = NDArray[np.float64]
Number = int | float | tuple[float, ...]
Held = tuple[FunctionType, dict[str, str]]
Rows = dict[str, Any]

SEED = 20261122
RECORDS = 12
MANY = 8
GUARDS = 1e-20
ROOM = "tridentify.estimation"
ONLY_WRITES = ROOM + ".answer"
TABLE = ROOM + ".likelihood.thresholds"
MOVED = 0.1
WORSE = 0.5
SNRS = (0, 10, 20, 40)
SHORT, LONG = (60, 120, 250), (6_000, 9_000, 15_000)
INPUTS = ("prbs", "noise", "step", "doublet", "3-2-1-1")
WAYS = {"halved": 0.5, "doubled": 2.0}
MAXIMUM = ThreeModel(finish="likelihood")


@dataclass(frozen=True)
class Task:
    """One estimation."""

    name: str
    record: Record
    structure: Structure
    method: Method

    @property
    def kind(self) -> str:
        """What the name begins with."""
        return self.name.rpartition(" ")[0]


@dataclass(frozen=True)
class Outcome:
    """What came of it; nothing but a word where that was an exception."""

    theta: Array
    std: Array
    criterion: float
    ok: bool
    ended: str
    seconds: float


@dataclass(frozen=True)
class Threshold:
    """A constant: where it stands, and its value."""

    module: str
    name: str
    value: Number

    @property
    def label(self) -> str:
        """Short."""
        return f"{self.module.removeprefix(ROOM + '.')}.{self.name}"

    def changed(self, factor: float) -> Number:
        """Its value halved or doubled."""
        if isinstance(self.value, tuple):
            return tuple(scaled(one, factor) for one in self.value)
        return scaled(self.value, factor)


def scaled(value: float, factor: float) -> float:
    """A number times a factor; integers stay whole, and shares above a half below one."""
    if isinstance(value, int):
        return max(1, round(value * factor)) if value else 0
    if 0.5 < value < 1.0:
        return 1.0 - (1.0 - value) / factor
    return value * factor


# ----------------------------------------------------------------------------------- the records
def made(
    rng: np.random.Generator, order: int, kind: str, snr: float, count: int, pole: float = 0.0
) -> tuple[Record, TransferFunction]:
    """A record of a random system from rest, and the system; noise coloured by a pole."""
    poles, dt = _poles_and_step(rng, order, count)
    zeros = _zeros(rng, poles)
    den, num = np.poly(poles).real, np.atleast_1d(np.poly(zeros).real)
    model = TransferFunction(num * den[-1] / np.abs(num[-1]), den)
    u = _input(rng, kind, poles, dt, count)
    clean = simulate(model, Record(u, u, dt=dt))[:, 0]
    noise = lfilter([1.0], [1.0, -pole], rng.standard_normal(count + 200))[200:]
    y = clean + np.std(clean) * 10.0 ** (-snr / 20) * noise / np.std(noise)
    return Record(u, y, dt=dt), model


def asked(model: TransferFunction, **more: Any) -> Structure:
    """The right orders."""
    return Structure(model.den[0][0].size - 1, model.num[0][0].size - 1, **more)


def tasks(records: int, seed: int) -> Iterator[Task]:
    """Every estimation, reproducible from the seed."""
    for k in range(records):
        rng = np.random.default_rng([seed, 0, k])
        snr, count = SNRS[(k // 4) % 4], SHORT[k % 3]
        record, model = made(rng, 1 + k % 4, INPUTS[k % 5], snr, count)
        rest = {"initial_state": "rest", "offset": False} if k % 3 == 0 else {}
        yield Task(f"short {k}", record, asked(model, **rest), MAXIMUM)
    for k in range(3):
        rng = np.random.default_rng([seed, 1, k])
        record, model = made(rng, 1 + k % 4, INPUTS[k % 2], SNRS[1 + k % 3], LONG[k % 3])
        yield Task(f"long {k}", record, asked(model), MAXIMUM)
    for k in range(3):
        rng = np.random.default_rng([seed, 9, k])
        record, model = made(rng, 1 + k, INPUTS[k], (0, 5)[k % 2], 80)
        yield Task(f"posterior {k}", record, asked(model), ThreeModel())
    yield from coloured(seed)
    yield from damaged(seed)
    yield from delayed(seed)
    yield from known(seed)
    yield from others(seed)


def coloured(seed: int) -> Iterator[Task]:
    """Coloured noise."""
    for k in range(3):
        rng = np.random.default_rng([seed, 2, k])
        record, model = made(rng, 1 + k % 3, INPUTS[k % 2], 10, 300 + 100 * k, (0.6, 0.9)[k % 2])
        yield Task(f"coloured {k}", record, asked(model), MAXIMUM)


def damaged(seed: int) -> Iterator[Task]:
    """Outliers, missing samples, uneven time, two outputs."""
    for k in range(2):
        rng = np.random.default_rng([seed, 3, k])
        record, model = made(rng, 1 + k % 2, "prbs", 20, 250)
        y = record.y.copy()
        at = rng.choice(250, 10, replace=False)
        y[at] += 5.0 * np.std(y) * rng.choice([-1.0, 1.0], (10, 1))
        loss = ("huber", "student")[k % 2]
        yield Task(f"outliers {k}", record.with_outputs(y), asked(model), ThreeModel(loss=loss))
    for k in range(2):
        rng = np.random.default_rng([seed, 4, k])
        record, model = made(rng, 2, "prbs", 20, 250)
        y = record.y.copy()
        y[rng.choice(250, 40, replace=False)] = np.nan
        yield Task(f"missing {k}", record.with_outputs(y), asked(model), MAXIMUM)
        t = record.t[np.sort(rng.choice(250, 200, replace=False))]
        u = record.u[np.searchsorted(record.t, t - 1e-9)]
        held = Record(u, np.zeros(t.size), t=t)
        y = simulate(model, held)
        y = y + 0.1 * np.std(y) * rng.standard_normal(y.shape)
        yield Task(f"uneven {k}", Record(u, y, t=t), asked(model), MAXIMUM)
    for k in range(2):
        rng = np.random.default_rng([seed, 5, k])
        record, model = made(rng, 2, "prbs", 20, 250)
        second = simulate(TransferFunction([1.0], [1.0, 3.0 * abs(model.poles).max()]), record)
        second = second + 0.05 * np.std(second) * rng.standard_normal(second.shape)
        both = Record(record.u, np.hstack([record.y, second]), dt=record.dt)
        poles = [[2], [1]] if k else 3
        zeros = [[1], [0]] if k else 2
        yield Task(f"outputs {k}", both, Structure(poles, zeros), MAXIMUM)


def delayed(seed: int) -> Iterator[Task]:
    """Unknown delays."""
    for k in range(3):
        rng = np.random.default_rng([seed, 6, k])
        record, model = made(rng, 1 + k % 2, ("prbs", "step", "3-2-1-1")[k], 20, 100)
        late = (4.0, 2.5, 7.3)[k] * float(record.dt or 1.0)
        model = TransferFunction(model.num[0][0], model.den[0][0], delay=late)
        quiet = Record(record.u, record.u, dt=record.dt)
        y = simulate(model, quiet)
        y = y + 0.1 * np.std(y) * rng.standard_normal(y.shape)
        start = {"initial_state": "rest"} if k % 2 else {}
        wanted = asked(model, delay="free", **start)
        yield Task(f"delay {k}", Record(record.u, y, dt=record.dt), wanted, MAXIMUM)


def known(seed: int) -> Iterator[Task]:
    """Knowledge of coefficients, the last two times wrong."""
    for k in range(6):
        rng = np.random.default_rng([seed, 7, k])
        record, model = made(rng, 2, "prbs", 20, 250, (0.0, 0.7)[k == 1])
        gain = float(model.num[0][0][-1] / model.den[0][0][-1])
        a0, a1 = float(model.den[0][0][2]), float(model.den[0][0][1])
        more: list[dict[str, Any]] = [
            {"fixed": {"a0": a0}},
            {"priors": {"a1": (a1, 0.05 * a1)}},
            {"bounds": {"a1": (0.5 * a1, 0.9 * a1)}},
            {"static_gain": gain},
            {"static_gain": 1.5 * gain},
            {"fixed": {"a0": 2.0 * a0}},
        ]
        yield Task(f"known {k}", record, asked(model, **more[k]), MAXIMUM)


def others(seed: int) -> Iterator[Task]:
    """Every other method, and the paper's."""
    for k, (name, method) in enumerate(sorted(METHODS.items())):
        rng = np.random.default_rng([seed, 8, k])
        for order in (2, 3):
            record, model = made(rng, order, "prbs", 20, 250)
            if name != "three-model":
                yield Task(f"{name} {order}", record, asked(model), method())
            else:
                rate = float(np.abs(model.poles).max())
                quiet = asked(model, initial_state="rest", offset=False)
                c = tuple(np.poly(np.full(order + 1, -rate)).tolist())
                paper = ThreeModel.paper(gamma=rate, n_operators=4, filter=c)
                yield Task(f"paper {order}", record, quiet, paper)


def estimated(task: Task) -> Outcome:
    """One estimation, without the judgement that follows it."""
    before = time.process_time()
    nothing = np.zeros(0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found: Estimate = task.method.estimate([task.record], task.structure)
    except Exception as error:
        known_kind = isinstance(error, (TridentifyError, np.linalg.LinAlgError))
        word = type(error).__name__ if known_kind else f"{type(error).__name__}: {error}"
        return Outcome(nothing, nothing, np.inf, False, word, time.process_time() - before)
    seconds = time.process_time() - before
    codes = ", ".join(one.code for one in found.findings)
    word = f"{found.status.name} {found.aicc!r} {codes}"
    return Outcome(found.theta, found.std, found.aicc, found.status.ok, word, seconds)


# -------------------------------------------------------------------------------- the thresholds
def modules() -> list[ModuleType]:
    """Every module of the package that an estimation may reach."""
    found = [
        importlib.import_module(one.name)
        for one in pkgutil.walk_packages(tridentify.__path__, "tridentify.")
        if one.name.startswith((ROOM, "tridentify.models", "tridentify.numerics"))
    ]
    return found


def thresholds() -> list[Threshold]:
    """Every numeric constant, where it is defined."""
    found = []
    for module in modules():
        name = module.__name__
        if not name.startswith(ROOM) or name.startswith(ONLY_WRITES):
            continue
        for node in ast.parse(inspect.getsource(module)).body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            for one in targets:
                own = one.elts if isinstance(one, ast.Tuple) else [one]
                for target in own:
                    if isinstance(target, ast.Name) and target.id.isupper():
                        value = getattr(module, target.id)
                        if is_number(value):
                            found.append(Threshold(name, target.id, value))
    return found


def is_number(value: object) -> bool:
    """Whether it is a number, or a tuple of numbers, and no guard of rounding."""
    if isinstance(value, tuple):
        return bool(value) and all(is_number(one) and not isinstance(one, tuple) for one in value)
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    return known and not 0 < abs(value) < GUARDS


def functions(module: ModuleType) -> Iterator[Held]:
    """Functions of a module, with the constants that are defaults of their parameters."""

    def inside(
        body: Sequence[ast.stmt], owner: Any
    ) -> Iterator[tuple[FunctionType, dict[str, str]]]:
        for node in body:
            if isinstance(node, ast.ClassDef):
                yield from inside(node.body, getattr(owner, node.name))
            elif isinstance(node, ast.FunctionDef):
                found = inspect.unwrap(inspect.getattr_static(owner, node.name))
                found = getattr(found, "__func__", found)
                names = [one.arg for one in (*node.args.posonlyargs, *node.args.args)]
                late = names[len(names) - len(node.args.defaults) :]
                pairs = [*zip(late, node.args.defaults, strict=True)]
                pairs += [
                    (one.arg, value)
                    for one, value in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
                    if value is not None
                ]
                held = {arg: one.id for arg, one in pairs if isinstance(one, ast.Name)}
                if isinstance(found, FunctionType):
                    yield found, held

    yield from inside(ast.parse(inspect.getsource(module)).body, module)


class Bound:
    """Where each threshold is read: names in modules, and defaults of functions."""

    def __init__(self, found: Sequence[Threshold]) -> None:
        self.names: dict[Threshold, list[ModuleType]] = {one: [] for one in found}
        self.defaults: dict[Threshold, list[tuple[FunctionType, str]]] = {one: [] for one in found}
        by_place = {(one.module, one.name): one for one in found}
        for module in modules():
            here: dict[str, Threshold] = {}
            for node in ast.walk(ast.parse(inspect.getsource(module))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    for one in node.names:
                        if (node.module, one.name) in by_place:
                            here[one.asname or one.name] = by_place[node.module, one.name]
            here |= {one.name: one for one in found if one.module == module.__name__}
            for name, threshold in here.items():
                assert name == threshold.name, "a threshold is imported under another name"
                self.names[threshold].append(module)
            for function, held in functions(module):
                for arg, name in held.items():
                    if name in here:
                        self.defaults[here[name]].append((function, arg))

    @contextmanager
    def changed(self, threshold: Threshold, value: Number) -> Iterator[None]:
        """A threshold with another value, wherever it is read."""
        self._set(threshold, value)
        try:
            yield
        finally:
            self._set(threshold, threshold.value)

    def _set(self, threshold: Threshold, value: Number) -> None:
        for module in self.names[threshold]:
            setattr(module, threshold.name, value)
        for function, arg in self.defaults[threshold]:
            parameters = inspect.signature(function).parameters
            if arg in (function.__kwdefaults__ or {}):
                function.__kwdefaults__[arg] = value
                continue
            late = [n for n, p in parameters.items() if p.default is not p.empty and n not in
                    (function.__kwdefaults__ or {})]  # fmt: skip
            whole = list(function.__defaults__ or ())
            whole[late.index(arg)] = value
            function.__defaults__ = tuple(whole)

    def read_by(self, threshold: Threshold, codes: set[CodeType]) -> bool:
        """Whether one of the functions that ran reads the threshold."""
        files = {module.__file__ for module in self.names[threshold]}
        if any(function.__code__ in codes for function, _ in self.defaults[threshold]):
            return True
        return any(code.co_filename in files and threshold.name in code.co_names for code in codes)


def ran(task: Task) -> set[CodeType]:
    """The functions of the package that one estimation runs."""
    seen: set[CodeType] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            seen.add(frame.f_code)

    sys.setprofile(note)
    try:
        estimated(task)
    finally:
        sys.setprofile(None)
    return {code for code in seen if "tridentify" in code.co_filename}


# ------------------------------------------------------------------------------------ the results
def compared(before: Outcome, after: Outcome) -> tuple[bool, bool, bool]:
    """Whether an estimate changed at all, moved, and is worse."""
    pairs = ((before.theta, after.theta), (before.std, after.std))
    same = all(np.array_equal(one, other, equal_nan=True) for one, other in pairs)
    if same and before.ended == after.ended:
        return False, False, False
    if before.theta.size != after.theta.size:
        worse = before.ok and not after.ok
        return True, True, worse
    with np.errstate(all="ignore"):
        step = np.abs(after.theta - before.theta) / before.std
        wider = np.abs(after.std / before.std - 1.0)
    sizes = np.where(np.isfinite(step), step, 0.0) + np.where(np.isfinite(wider), wider, 0.0)
    moved = bool(np.any(sizes > MOVED))
    worse = after.criterion > before.criterion + WORSE or (before.ok and not after.ok)
    return True, moved, bool(worse)


def fewer(own: Sequence[Task], plain: dict[str, Outcome], each: int) -> list[Task]:
    """Where many short and long records tell, only the quickest of every other kind."""
    kept = [task for task in own if task.kind in ("short", "long")]
    if len(kept) < MANY:
        return [*own]
    quick = sorted(own, key=lambda task: plain[task.name].seconds)
    for kind in dict.fromkeys(task.kind for task in own):
        if kind not in ("short", "long"):
            kept += [task for task in quick if task.kind == kind][:each]
    return kept


def measured(
    bound: Bound, threshold: Threshold, own: Sequence[Task], plain: dict[str, Outcome]
) -> dict[str, Any]:
    """Both changes of one threshold."""
    row: dict[str, Any] = {"value": threshold.value, "records": len(own)}
    for way, factor in WAYS.items():
        value = threshold.changed(factor)
        if not own or value == threshold.value:
            continue
        with bound.changed(threshold, value):
            found = {task.name: estimated(task) for task in own}
        marks = {name: compared(plain[name], one) for name, one in found.items()}
        spent = sum(one.seconds for one in found.values())
        before = sum(plain[task.name].seconds for task in own)
        row[way] = {
            "value": value,
            "changed": sum(one[0] for one in marks.values()),
            "moved": sum(one[1] for one in marks.values()),
            "worse": sum(one[2] for one in marks.values()),
            "processor time": round(spent / before, 3),
            "which": {name: found[name].ended for name, one in marks.items() if one[1] or one[2]},
        }
    return row


def report(rows: Rows, seconds: float, noise: float) -> str:
    """What moved or got worse, what only changed, and what changed nothing."""
    width = max(len(name) for name in rows)
    lines = [f"{'':{width}s}  {'value':>10s}  records" + "".join(
        f"  | {way}: changed moved worse  time" for way in WAYS)]  # fmt: skip
    slight, silent, unread = [], [], []
    for name, row in rows.items():
        ways = [row[way] for way in WAYS if way in row]
        if not row["records"]:
            unread.append(name)
        elif not any(one["changed"] for one in ways):
            silent.append(name)
        elif not any(one["moved"] or one["worse"] for one in ways):
            slight.append(name)
        else:
            cells = ""
            for way in WAYS:
                one = row.get(way)
                pad = len(way) - 5
                cells += "  | " + (
                    f"{one['changed']:{pad + 13}d} {one['moved']:5d} {one['worse']:5d}"
                    f" {one['processor time']:5.2f}"
                    if one
                    else " " * (pad + 31)
                )
            value = row["value"]
            shown = f"{value:.4g}" if not isinstance(value, (tuple, list)) else "several"
            lines.append(f"{name:{width}s}  {shown:>10s}  {row['records']:7d}{cells}")
    lines += ["", f"moved no estimate by {MOVED:g} standard errors, made none worse:"]
    lines += wrapped(slight)
    lines += ["", "changed not a bit of any estimate:", *wrapped(silent)]
    lines += ["", "read on none of these records:", *wrapped(unread)]
    told = f"{len(rows)} thresholds, {seconds:.0f} s of processor time"
    lines += ["", f"{told}; two runs with nothing changed: time {noise:.2f}"]
    return "\n".join(lines)


def wrapped(names: Sequence[str]) -> list[str]:
    """Several names a line."""
    lines, line = [], ""
    for name in names or ["none"]:
        if line and len(line) + len(name) + 2 > 110:
            lines.append("  " + line)
            line = ""
        line = f"{line}, {name}" if line else name
    return [*lines, "  " + line]


def run(
    records: int, seed: int, wanted: Callable[[Threshold], bool]
) -> tuple[dict[str, Any], float]:
    """All thresholds that are wanted; and how much two equal runs differ in time."""
    every = [*tasks(records, seed)]
    for task in every:
        estimated(task)  # compile and load
    plain = {task.name: estimated(task) for task in every}
    again = {task.name: estimated(task) for task in every}
    for name, one in plain.items():
        if any(compared(one, again[name])):
            raise SystemExit(f"found two different results of {name}; expected equal ones")
    codes = {task.name: ran(task) for task in every}
    bound = Bound(thresholds())
    rows: Rows = {}
    for threshold in bound.names:
        if not wanted(threshold):
            continue
        own = [task for task in every if bound.read_by(threshold, codes[task.name])]
        own = fewer(own, plain, 2 if threshold.module == TABLE else 1)
        rows[threshold.label] = measured(bound, threshold, own, plain)
        told = {way: row for way, row in rows[threshold.label].items() if way in WAYS}
        print(f"{threshold.label}: {len(own)} records, {told}", file=sys.stderr, flush=True)
    total = [sum(one.seconds for one in group.values()) for group in (plain, again)]
    return rows, total[1] / total[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=RECORDS, help="short ones")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", default="", metavar="PATTERN", help="of names of thresholds")
    parser.add_argument(
        "--save", action="store_true",
        help="store the result and fill README.md; with --only beside what is stored",
    )  # fmt: skip
    options = parser.parse_args()
    before = time.process_time()
    rows, noise = run(
        options.records, options.seed, lambda one: re.search(options.only, one.label) is not None
    )
    seconds = time.process_time() - before
    stored = HERE / "results" / "sensitivity.json"
    if options.save and options.only and stored.exists():
        kept = json.loads(stored.read_text())["data"]
        seconds, noise = seconds + kept["seconds"], kept["noise"]
        rows = {name: rows.get(name, row) for name, row in (kept["rows"] | rows).items()}
    text = report(rows, seconds, noise)
    print("\n" + text)
    if options.save:
        facts = {"records": options.records, "seed": options.seed}
        keep("sensitivity", text, {**facts, "seconds": seconds, "noise": noise, "rows": rows})


if __name__ == "__main__":
    main()
