"""Bit for bit the same? Hashes of estimates, on-line states, files and plans, to compare with.

A move of code from one file to another must not change one digit. `make bits` works all of this
out: every method, structure, sampling, noise model, loss and kind of knowledge, short records and
long ones, on-line states after plain and damaged streams, model files, exported filters, planned
inputs. ``--save`` stores the hashes under ``results/``; without it they are compared with those,
and the names of what differs are printed, with the largest relative difference of a coefficient.

The last bits depend on the processor and on the linear algebra library, so hashes are compared
only with those of the same machine and library versions; on another one, store first.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import argparse
import hashlib
import json
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from loops import Controller, System, run, tustin
from machine import HERE, describe
from numpy.typing import NDArray
from scipy.signal import lfilter

from tridentify import (
    METHODS,
    Estimate,
    OutputError,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    TridentifyError,
    identify,
    online,
    select_structure,
    simulate,
    validate,
)
from tridentify.excitation import multisine, optimal_spectrum, prbs, precision
from tridentify.export import write_c_header, write_matlab
from tridentify.physical import estimate_physical, rcrc_circuit
from tridentify.uncertainty import bootstrap, sample

Array = NDArray[np.float64]
Made = dict[str, Any]
Noise = Literal["white", "ar", "auto"]
STORED = HERE / "results" / "bits.json"
DT = 0.05

PLANTS = {
    "first": (TransferFunction([2.0], [1.0, 0.8]), 0),
    "second": (TransferFunction([0.2, 3.0], [1.0, 1.2, 6.0]), 1),
    "third": (TransferFunction([1.0, 4.0], [1.0, 3.0, 9.0, 8.0]), 1),
    "fourth": (TransferFunction([1.0, 0.5, 20.0], [1.0, 2.0, 30.0, 20.0, 100.0]), 2),
}


def levels(n: int, hold: int, seed: int) -> Array:
    """Held levels."""
    values = np.random.default_rng(seed).standard_normal(-(-n // hold))
    return np.repeat(values, hold)[:n]


def noisy(clean: Array, seed: int, share: float = 0.05, pole: float = 0.0) -> Array:
    """With noise that is a share of the output, autoregressive where a pole is given."""
    white = np.random.default_rng(seed).standard_normal(clean.shape)
    coloured = np.sqrt(1.0 - pole**2) * lfilter([1.0], [1.0, -pole], white, axis=0)
    return np.asarray(clean + share * np.std(clean, axis=0) * coloured)


def record_of(
    plant: str,
    *,
    n: int = 400,
    intersample: str = "zoh",
    share: float = 0.05,
    pole: float = 0.0,
    seed: int = 1,
) -> Record:
    """A record of a plant of the table."""
    model, _ = PLANTS[plant]
    u = levels(n, 7, seed)
    if intersample != "zoh":
        u = lfilter([0.2], [1.0, -0.8], u)
    blank = Record(u, np.zeros(n), dt=DT, intersample=intersample)  # type: ignore[arg-type]
    y = noisy(simulate(model, blank), seed, share, pole)
    return Record(u, y, dt=DT, intersample=intersample)  # type: ignore[arg-type]


def structure_of(plant: str, **options: Any) -> Structure:
    """Its orders."""
    model, zeros = PLANTS[plant]
    return Structure(len(model.den[0][0]) - 1, zeros, **options)


def wide(n: int = 500) -> tuple[Record, Structure]:
    """Two inputs and two outputs, one denominator."""
    den = [1.0, 2.4, 6.3]
    model = TransferFunction(
        [[[-7.0, -6.5], [1.0, 2.0]], [[-0.1, -5.0], [0.5, 1.0]]], [[den, den], [den, den]]
    )
    u = np.stack([levels(n, 7, 3), levels(n, 11, 4)], axis=1)
    y = noisy(simulate(model, Record(u, np.zeros((n, 2)), dt=DT)), 5)
    return Record(u, y, dt=DT), Structure(2, 1)


def separate(n: int = 500) -> tuple[Record, Structure]:
    """Two inputs, a denominator each, one delayed."""
    delay = [[0.0, 0.137]]
    model = TransferFunction([[[2.0], [3.0]]], [[[1.0, 1.5], [1.0, 1.2, 9.0]]], delay=delay)
    u = np.stack([levels(n, 7, 3), levels(n, 11, 4)], axis=1)
    y = noisy(simulate(model, Record(u, np.zeros(n), dt=DT)), 6)
    return Record(u, y, dt=DT), Structure([[1, 2]], [[0, 0]], delay=delay)


def uneven(n: int = 400) -> Record:
    """No two steps alike."""
    t = np.cumsum(np.random.default_rng(2).uniform(0.5 * DT, 1.5 * DT, n))
    u = levels(n, 7, 1)
    return Record(u, noisy(simulate(PLANTS["second"][0], Record(u, np.zeros(n), t=t)), 7), t=t)


def spoiled(record: Record, seed: int = 9) -> Record:
    """Missing samples and some far off."""
    rng = np.random.default_rng(seed)
    y = np.array(record.y)
    y[rng.choice(len(y), len(y) // 20, replace=False)] = np.nan
    far = rng.choice(len(y), len(y) // 50, replace=False)
    y[far] += 10.0 * np.nanstd(y)
    return Record(record.u, y, dt=record.dt, intersample=record.intersample)


# -------------------------------------------------------------------------------------- digests
def digest(*values: Any) -> str:
    """Of arrays by their bytes, of all else by its representation."""
    found = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray | np.generic | float):
            array = np.ascontiguousarray(value)
            found.update(str((array.shape, array.dtype.str)).encode() + array.tobytes())
        elif isinstance(value, bytes):
            found.update(value)
        elif isinstance(value, tuple | list):
            found.update(digest(*value).encode())
        else:
            found.update(repr(value).encode())
    return found.hexdigest()[:20]


def of_estimate(e: Estimate) -> Made:
    """Coefficients and all that hangs on them."""
    costs = [p.cost for p in e.trace.passes]
    numbers = (e.theta, e.cov, e.aicc, np.asarray(e.fit), list(e.noise_model), costs)
    terms = [(n.offset, n.drift, n.initial_state) for n in e.nuisance]
    told = (e.status.name, e.errors, sorted(f.code for f in e.findings))
    return {"hash": digest(numbers, terms, told), "theta": e.theta.tolist()}


def estimated(
    records: Record | list[Record], structure: Structure, method: Any = None
) -> Callable[[], Made]:
    """`identify` on some records."""
    return lambda: of_estimate(identify(records, structure, method or ThreeModel(), throw=False))


# ---------------------------------------------------------------------------------------- cases
def by_method() -> Iterator[tuple[str, Callable[[], Made]]]:
    """Every method on every plant, with nuisance terms and without."""
    for (key, method), plant in product(METHODS.items(), PLANTS):
        for name, terms in (
            ("open", {}),
            ("rest", {"offset": False, "initial_state": "rest"}),
            ("free", {"offset": True, "initial_state": "free"}),
        ):
            structure = structure_of(plant, **terms)
            yield f"{key}, {plant}, {name}", estimated(record_of(plant), structure, method())
        yield (
            f"{key}, {plant}, foh",
            estimated(record_of(plant, intersample="foh"), structure_of(plant), method()),
        )
    for key, method in METHODS.items():
        yield f"{key}, two by two", estimated(*wide(), method())
        yield (
            f"{key}, missing",
            estimated(spoiled(record_of("second")), structure_of("second"), method()),
        )


def by_record() -> Iterator[tuple[str, Callable[[], Made]]]:
    """Samplings, noise models, losses, lengths, experiments."""
    second = structure_of("second")
    for method in (ThreeModel, OutputError):
        name = method().name
        for loss in ("huber", "student"):
            record = spoiled(record_of("second"))
            yield f"{name}, {loss}", estimated(record, second, method(loss=loss))
        for behaviour in ("foh", "band-limited", "auto"):
            record = record_of("fourth", intersample="foh")
            record = Record(record.u, record.y, dt=DT, intersample=behaviour)
            yield (
                f"{name}, taken as {behaviour}",
                estimated(record, structure_of("fourth"), method()),
            )
        yield f"{name}, uneven", estimated(uneven(), second, method())
        yield f"{name}, separate", estimated(*separate(), method())
        pair = [record_of("second", seed=k, n=200 + 50 * k) for k in (1, 2)]
        yield f"{name}, two experiments", estimated(pair, second, method())
        free = replace(second, delay="free")
        late = record_of("second")
        u = np.concatenate([np.zeros((3, 1)), late.u])[: late.n_samples]
        yield (
            f"{name}, free delay",
            estimated(Record(late.u, _lagged(late, u), dt=DT), free, method()),
        )
        for n in (6_000, 30_000):
            yield (
                f"{name}, {n} samples",
                estimated(record_of("third", n=n), structure_of("third"), method()),
            )
    noises: tuple[Noise, ...] = ("white", "ar", "auto")
    for noise, pole in product(noises, (0.0, 0.8)):
        record = record_of("second", pole=pole)
        yield f"noise {noise}, pole {pole}", estimated(record, second, ThreeModel(noise=noise))
    for seed in range(4):
        short = record_of("second", n=40, share=0.4, seed=seed)
        yield f"posterior mean {seed}", estimated(short, second)
    for gamma in (1.0, 3.0):
        yield (
            f"paper, gamma {gamma}",
            estimated(record_of("second"), second, ThreeModel.paper(gamma)),
        )


def _lagged(record: Record, u: Array) -> Array:
    """The output of an input that comes later."""
    moved = Record(u, record.y, dt=DT)
    return noisy(simulate(PLANTS["second"][0], moved), 3)


def by_knowledge() -> Iterator[tuple[str, Callable[[], Made]]]:
    """What is known of coefficients."""
    known: dict[str, dict[str, Any]] = {
        "fixed": {"fixed": {"a1": 1.2}},
        "two fixed": {"fixed": {"a1": 1.2, "b1": 0.2}},
        "bounds": {"bounds": {"b1": (0.25, None), "a0": (0.0, 10.0)}},
        "equality": {"equalities": [({"b0": 2.0, "a0": -1.0}, 0.0)]},
        "prior": {"priors": {"a0": (6.5, 0.2)}},
        "gain": {"static_gain": 0.5},
        "integrator": {"fixed": {"a0": 0.0}, "initial_state": "free"},
    }
    for (name, asked), method in product(known.items(), (ThreeModel, OutputError)):
        structure = structure_of("second", **asked)
        record = record_of("second")
        if name == "integrator":
            plant = TransferFunction([3.0], [1.0, 1.2, 0.0])
            record = Record(record.u, noisy(simulate(plant, record), 2), dt=DT)
            structure = Structure(2, 0, **asked)
        yield f"{method().name}, known: {name}", estimated(record, structure, method())


def in_loop(sampled: bool, pole: float, unstable: bool = False, n: int = 400) -> Record:
    """A PI controller around a plant, or a lead around an unstable one; steps at its input."""
    law = System.of([3.0, 2.0], [1.0, 0.0])
    plant = System.of([1.0, 1.0], [1.0, 0.5, 1.0])
    if unstable:
        law, plant = System.of([24.0, 24.0], [1.0, 8.0]), System.of([2.0], [1.0, 2.0, -3.0])
    dt = 0.05
    controller = Controller(tustin(law, dt) if sampled else law, sampled)
    r, nothing = levels(n, 20, 5)[:, None], np.zeros((n, 1))
    white = np.random.default_rng(11).standard_normal(n)
    v = 0.02 * lfilter([1.0], [1.0, -pole], white)
    u, y = run(plant, controller, nothing, v[:, None], r, dt, fine=1)
    return Record(u, y, dt=dt, reference=r)


def by_loop() -> Iterator[tuple[str, Callable[[], Made]]]:
    """The reference route: kinds of controller, colours, a controller that is given."""
    second = Structure(2, 1)
    kinds: tuple[Literal["sampled", "continuous"], ...] = ("sampled", "continuous")
    for kind, pole in product(kinds, (0.0, 0.7)):
        record, name = in_loop(kind == "sampled", pole), f"loop, {kind}, pole {pole}"
        yield name, estimated(record, second, ThreeModel(controller=kind))
        yield f"{name}, open loop", estimated(record, second, ThreeModel(route="open-loop"))
        yield f"{name}, direct", estimated(record, second, ThreeModel(route="direct"))
    record = in_loop(True, 0.0)
    yield "loop, unknown", estimated(record, second)
    known = ThreeModel(controller=TransferFunction([3.0, 2.0], [1.0, 0.0]))
    yield "loop, given", estimated(in_loop(False, 0.0), second, known)
    for kind in kinds:
        grows = in_loop(kind == "sampled", 0.0, unstable=True)
        yield (
            f"loop, unstable, {kind}",
            estimated(grows, Structure(2, 0), ThreeModel(controller=kind)),
        )


def by_sample() -> Iterator[tuple[str, Callable[[], Made]]]:
    """States of the on-line estimators."""
    estimators: dict[str, Callable[[], Any]] = {
        "three-model": online.ThreeModel,
        "forgetting": lambda: online.ThreeModel(forgetting=0.999),
        "least squares": online.RecursiveLeastSquares,
        "kalman": lambda: online.Kalman(drift=1e-5),
        "gradient": online.Gradient,
    }
    streams = {
        "plain": record_of("second", n=1500),
        "damaged": spoiled(record_of("second", n=1500)),
        "coloured": record_of("second", n=1500, pole=0.9, share=0.2),
        "two by two": wide(1500)[0],
    }
    for (name, make), (what, record) in product(estimators.items(), streams.items()):
        yield f"online {name}, {what}", partial(of_state, make(), record)


def of_state(method: Any, record: Record) -> Made:
    """The saved state at the end, and the estimate there."""
    state = method.init(
        Structure(2, 1), dt=DT, input_names=record.input_names, output_names=record.output_names
    )
    u, y = record.u.tolist(), record.y.tolist()
    for u_k, y_k in zip(u, y, strict=True):
        state, _ = method.step(state, u_k, y_k)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "state.json"
        state.save(file)
        kept = file.read_bytes()
    try:
        theta = method.estimate(state).theta
    except TridentifyError as error:
        return {"hash": digest(kept, type(error).__name__)}
    return {"hash": digest(kept, theta), "theta": theta.tolist()}


def by_file() -> Iterator[tuple[str, Callable[[], Made]]]:
    """Files, orders, verdicts, plans, intervals."""
    second = structure_of("second")

    def files() -> Made:
        estimate = identify(record_of("second"), second)
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder)
            estimate.save(root / "model.json")
            write_c_header(estimate.model, 0.01, root / "model.h")
            write_matlab(estimate, root / "model.m")
            names = ("model.json", "model.h", "model.m")
            return {name: digest((root / name).read_bytes()) for name in names} | {
                "hash": digest(*((root / name).read_bytes() for name in names))
            }

    def orders() -> Made:
        table = select_structure(
            record_of("second"), [Structure(n, m) for n, m in ((1, 0), (2, 1), (3, 1))]
        )
        rows = [(row.aicc, np.asarray(row.fit), np.asarray(row.cross_fit)) for row in table.rows]
        return {"hash": digest(rows, table.recommended.label if table.recommended else "")}

    def verdict() -> Made:
        record = record_of("third")
        found = validate(identify(record, Structure(1, 0)), record)
        return {"hash": digest([t.p_value for t in found.tests], [f.code for f in found.findings])}

    def plan() -> Made:
        model, structure = PLANTS["second"][0], structure_of("second")
        signals = [prbs(6, dt=DT, clock=0.2), multisine(20.0, dt=DT, band=(0.5, 10.0))]
        told = precision(model, signals[0], structure, noise_std=0.01)
        best = optimal_spectrum(model, structure)
        return {"hash": digest([s.u for s in signals], told.std, best.power)}

    def intervals() -> Made:
        record = record_of("second")
        estimate = identify(record, second)
        drawn = sample(estimate, 50, seed=1)
        again = bootstrap(estimate, record, n_draws=5, seed=1)
        return {"hash": digest(np.asarray(drawn.theta), np.asarray(again.sample.theta))}

    def physical() -> Made:
        u = levels(500, 10, 1)
        y = simulate(TransferFunction([5e5], [1.0, 2500.0, 5e5]), Record(u, u, dt=1e-4))
        record = Record(u, noisy(y, 3), dt=1e-4)
        found = estimate_physical(rcrc_circuit(), record, known={"R1": 1e4, "R2": 1e4})
        values = [(p.value, p.std) for p in found.parameters.values()]
        return {"hash": digest(values)}

    yield "files", files
    yield "orders", orders
    yield "verdict", verdict
    yield "plan", plan
    yield "intervals", intervals
    yield "physical", physical


def cases() -> dict[str, Callable[[], Made]]:
    """All, by name."""
    parts = (by_method(), by_record(), by_knowledge(), by_loop(), by_sample(), by_file())
    return {name: run for part in parts for name, run in part}


def worked_out(name: str) -> tuple[str, Made]:
    """One case; what is refused is a result too."""
    warnings.simplefilter("ignore")
    try:
        return name, cases()[name]()
    except TridentifyError as error:
        return name, {"hash": digest(type(error).__name__, str(error)), "refused": True}


def differences(now: dict[str, Made], before: dict[str, Made]) -> list[str]:
    """A line for each case that is not the same."""
    lines = [f"{name}: only {'now' if name in now else 'before'}" for name in now.keys() ^ before]
    for name in sorted(now.keys() & before):
        a, b = now[name], before[name]
        if a["hash"] == b["hash"]:
            continue
        x, y = np.array(a.get("theta", [])), np.array(b.get("theta", []))
        same = x.shape == y.shape and x.size
        size = float(np.max(np.abs(x - y) / np.maximum(np.abs(y), 1e-300))) if same else np.nan
        lines.append(f"{name}: coefficients differ by {size:.1e}")
    return lines


def main() -> int:
    """Work out, then store or compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--save", action="store_true", help="store under results/; with --only beside the others"
    )
    parser.add_argument("--only", default="", help="cases with this in their names")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    names = [name for name in cases() if asked.only in name]
    with ProcessPoolExecutor(asked.workers) as pool:
        now = dict(pool.map(worked_out, names, chunksize=8))
    refused = sum("refused" in made for made in now.values())
    print(f"{len(now)} cases, {refused} of them refused")
    facts = {k: v for k, v in describe().items() if k not in ("memory", "tridentify")}
    stored = json.loads(STORED.read_text())
    if asked.save:
        if asked.only and stored["machine"] == facts:
            now = stored["cases"] | now
        STORED.write_text(json.dumps({"machine": facts, "cases": now}, indent=1) + "\n")
        print(f"stored under results/{STORED.name}")
        return 0
    if stored["machine"] != facts:
        print("the stored hashes are of another machine or other libraries; store your own first")
        return 2
    before = {name: made for name, made in stored["cases"].items() if asked.only in name}
    lines = differences(now, before)
    print("\n".join(lines) if lines else "every bit is the same")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
