"""Changes that are told on-line in gusts and on recorded streams, for `online.py`.

*Gusts.* A short period, ``(p^2 + 3 p + 16.4) q = (-8 p - 12) delta``, flown by doublets and
3-2-1-1s with pauses between them, every 0.04 s. Gusts move the plant as a second elevator would;
other disturbances stand on the output. Where the stiffness steps it becomes a third larger.

*Recorded streams.* The public records of `real_records.py`, sample by sample, on the structure that
is physically right. None of the plants is known to change, though none is quite linear.
"""

from __future__ import annotations

import sys
import warnings
import zlib
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import scipy.signal
from changing import scaled, stepped
from numpy.typing import NDArray
from plants import Plant
from real_records import ITEMS, Item, load, shared_data

from tridentify import Record, Structure, TridentifyError, identify, online

Array = NDArray[np.float64]
DT, SAMPLES, CHANGE, DRAWS, WORKERS = 0.04, 6000, 3000, 8, 3
EARLY = 600  # samples: an alarm before the step may be confirmed by the samples after it
PLANT = Plant("short period", (3.0, 16.4), (-8.0, -12.0))


def estimators() -> dict[str, Any]:
    """All four, as they begin anew on a change."""
    return {
        "ThreeModel": online.ThreeModel(),
        "RecursiveLeastSquares": online.RecursiveLeastSquares(on_change="restart"),
        "Kalman": online.Kalman(drift=0.001, on_change="restart"),
        "Gradient": online.Gradient(),
    }


def _flown(rng: np.random.Generator, count: int) -> Array:
    """Doublets and 3-2-1-1s with pauses."""
    u, k = np.zeros(count), 100
    while k < count - 80:
        size = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)
        for j, width in enumerate((30, 20, 10, 10) if rng.random() < 0.3 else (12, 12)):
            u[k : k + width] = size * (-1) ** j
            k += width
        k += int(rng.integers(20, 140))
    return u


def _slow(rng: np.random.Generator, count: int, seconds: float) -> Array:
    """First-order noise of variance one."""
    keep = np.exp(-DT / seconds)
    noise = rng.standard_normal(count)
    return np.asarray(scipy.signal.lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], noise))


def _strength(count: int) -> Array:
    return 0.3 + 2.0 * np.abs(np.sin(2.0 * np.pi * np.arange(count) / 2500.0)) ** 3


AT_INPUT: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "gust": lambda rng, n: 0.25 * _slow(rng, n, 1.5),
    "gust that comes and goes": lambda rng, n: 0.2 * _slow(rng, n, 1.5) * _strength(n),
}
AT_OUTPUT: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "noise that comes and goes": lambda rng, n: 0.3 * _slow(rng, n, 0.3) * _strength(n),
}


def _stream(kind: str, draw: int, after: Plant) -> Record:
    rng = np.random.default_rng([zlib.crc32(kind.encode()), draw])
    u = _flown(rng, SAMPLES)
    size = float(np.std(stepped(PLANT, PLANT, u, DT, SAMPLES)))
    still = np.zeros(SAMPLES)
    gust = AT_INPUT[kind](rng, SAMPLES) if kind in AT_INPUT else still
    beside = AT_OUTPUT[kind](rng, SAMPLES) if kind in AT_OUTPUT else still
    y = stepped(PLANT, after, u + gust, DT, CHANGE)
    noise = beside + 0.03 * rng.standard_normal(SAMPLES)
    return Record(u, y + size * noise, dt=DT)


def gusts(quick: bool) -> dict[str, Any]:
    """False changes and errors of a plant that stays; changes found where it does not."""
    draws = 1 if quick else DRAWS
    kinds = (*AT_INPUT, *AT_OUTPUT)
    with ProcessPoolExecutor(WORKERS) as pool:
        rows = dict(zip(kinds, pool.map(_in, kinds, [draws] * len(kinds)), strict=True))
    return {"rows": rows, "draws": draws, "samples": SAMPLES, "change": CHANGE}


def _in(kind: str, draws: int) -> dict[str, Any]:
    """All estimators in one kind of disturbance."""
    found = {}
    for name, method in estimators().items():
        row: dict[str, Any] = {"false": [], "off": [], "none": 0, "delays": [], "early": 0}
        for draw in range(draws):
            still, end = _ended(method, _stream(kind, draw, PLANT), Structure(2, 1))
            row["false"].append(len(still))
            row["none"] += end is None
            if end is not None:
                off = end.theta / PLANT.theta - 1.0
                row["off"].append([off.tolist(), (end.std / np.abs(PLANT.theta)).tolist()])
            moved = _stream(kind, draw, scaled(PLANT, "a0", 4.0 / 3.0))
            told, end = _ended(method, moved, Structure(2, 1))
            after = [at - CHANGE for at in told if at >= CHANGE - EARLY]
            row["early"] += len(told) - len(after)
            row["none"] += end is None
            row["delays"].append(max(after[0], 0) if after else None)
        found[name] = row
        print(f"gusts: {kind}, {name}", file=sys.stderr, flush=True)
    return found


def _ended(method: Any, record: Record, structure: Structure) -> tuple[tuple[int, ...], Any]:
    run = online.run(method, record, structure, every=1e9)
    return run.state.changes, run.estimate


def gusts_table(data: dict[str, Any]) -> list[str]:
    """Counts, errors and delays."""
    lines = [
        f"gusts: a short period for {data['samples']} samples, {data['draws']} draws; "
        "false changes "
        "in all; error of a0 at the end",
        "[%, root mean square] and its stated standard error; then a0 a third larger from sample "
        f"{data['change']} on: found, samples from the step",
        "to the alarm (least, median, most); changes told before the step; records that end "
        "without an estimate",
        f"{'':49s}{'false':>6s}{'a0 off':>8s}{'stated':>8s}{'found':>7s}{'delays':>20s}"
        f"{'early':>7s}{'none':>6s}",
    ]
    for kind, row in data["rows"].items():
        for name, one in row.items():
            off = np.array(one["off"], dtype=np.float64).reshape(-1, 2, PLANT.theta.size)
            error, std = 100.0 * np.sqrt(np.mean(off[:, :, 1] ** 2, axis=0))
            delays = [d for d in one["delays"] if d is not None]
            lines.append(
                f"{kind:26s}{name:23s}{sum(one['false']):6d}{error:8.1f}{std:8.1f}"
                f"{len(delays):4d}/{len(one['delays']):<2d}{_spread(delays):>20s}"
                f"{one['early']:7d}{one['none']:6d}"
            )
    return lines


def _spread(delays: list[int]) -> str:
    if not delays:
        return "-"
    return f"{min(delays)}, {np.median(delays):.0f}, {max(delays)}"


# --------------------------------------------------------------------------------- real streams
def recorded(quick: bool) -> dict[str, Any]:
    """Changes told on real records, and how far the end is from the off-line estimate."""
    items = ITEMS[:3] if quick else ITEMS
    there = [one for one in items if (shared_data() / one.folder / one.file).is_file()]
    with ProcessPoolExecutor(WORKERS) as pool:
        rows = dict(pool.map(_streamed, range(len(ITEMS)), [one in there for one in ITEMS]))
    absent = [one.name for one in items if one not in there]
    return {"rows": {k: v for k, v in rows.items() if v}, "absent": absent}


def _streamed(place: int, there: bool) -> tuple[str, dict[str, Any]]:
    """Name of a record, and what all estimators tell of it; nothing where it is not at hand."""
    item = ITEMS[place]
    if not there:
        return item.name, {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = _ends(item)
    print(f"recorded: {item.name}", file=sys.stderr, flush=True)
    return item.name, found


def _ends(item: Item) -> dict[str, Any]:
    record = load(item, item.file)
    structure = Structure(
        item.structure.poles, item.structure.zeros, delay=item.structure.delay
    )  # no coefficient can be fixed on-line
    stored = identify(record, structure, throw=False)
    found: dict[str, Any] = {"samples": record.n_samples, "methods": {}}
    for name, method in estimators().items():
        try:
            run = online.run(method, record, structure, every=1e9)
        except TridentifyError as error:
            found["methods"][name] = {"refused": type(error).__name__}
            continue
        off = None
        if run.estimate is not None:
            joint = np.sqrt(run.estimate.std**2 + stored.std**2)
            off = float(np.max(np.abs(run.estimate.theta - stored.theta) / joint))
        told = [one.code for one in run.estimate.findings if one.matters] if run.estimate else []
        found["methods"][name] = {
            "changes": [float(t) for t in run.changes], "off": off, "told": told,
        }  # fmt: skip
    return found


def recorded_table(data: dict[str, Any]) -> list[str]:
    """Changes and distances."""
    lines = [
        "recorded streams: changes told; largest distance of a coefficient at the end from the "
        "off-line estimate [joint standard errors]; cautions",
    ]
    for name, row in data["rows"].items():
        for method, one in row["methods"].items():
            head = f"{name:20s}{row['samples']:7d}  {method:23s}"
            if "refused" in one:
                lines.append(head + one["refused"])
                continue
            off = "none" if one["off"] is None else f"{one['off']:.1f}"
            told = ", ".join(sorted(set(one["told"])))
            lines.append(f"{head}{len(one['changes']):3d}{off:>9s}  {told}".rstrip())
    lines += [f"not at hand: {name}" for name in data["absent"]]
    return lines
