"""Do 95 % intervals hold 95 % of the time? Coverage over noise draws, by three routes.

Every record is simulated from a known truth, identified, and asked for 95 % intervals of its
coefficients, natural frequency, damping, poles, static gain, step and frequency response: by the
delta method, and by sampling from the covariance on the scale of the coefficients ("sampled") and
on one that keeps the draws stable ("stable"); the aircraft's short records by the parametric
bootstrap, too, with the bias of the estimates before and after its correction. The structure
(orders, start at rest, no offset) is known to the estimator. A record that `identify` refuses has
no intervals; it is counted, and the coverage is that of the others.

Every draw has a generator of its own, spawned from the seed by its case and number.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import multiprocessing
import os
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
os.environ.update(dict.fromkeys(THREADS, "1"))

import numpy as np  # noqa: E402 - the libraries read their number of threads when loaded
from machine import HERE, keep  # noqa: E402
from numpy.typing import NDArray  # noqa: E402
from scipy.signal import lfilter  # noqa: E402

from tridentify import Record, Structure, ThreeModel, TridentifyError, identify  # noqa: E402
from tridentify.uncertainty import (  # noqa: E402
    bootstrap,
    derived,
    response_band,
    sample,
    sampled_coefficients,
    sampled_derived,
    sampled_response_band,
    sampled_step_band,
    step_band,
)

Array = NDArray[np.float64]
LEVEL = 0.95
SEED = 20261121
BATCH = 4
ROUTES = ("delta", "sampled", "stable")
KINDS = ("percentile", "bca", "studentized")
HEAD = (
    "coverage of 95 % intervals, in percent, +- 95 % binomial error; low/high: the truth lies",
    "below/above the interval; ?: outside 93 to 97; !: outside beyond the binomial error",
)


def register(stages: int, tap: int, length: int, hold: int) -> Array:
    """Levels +-1 of a shift register with feedback from its last stage and one other."""
    bits, out = [1] * stages, []
    for _ in range(-(-length // hold)):
        out.append(2.0 * bits[-1] - 1.0)
        bits = [bits[-1] ^ bits[tap - 1], *bits[:-1]]
    return np.repeat(out, hold)[:length]


class Case(NamedTuple):
    """A truth, an input, a noise level; where step and frequency response are asked for."""

    den: tuple[float, ...]
    num: tuple[float, ...]
    u: Array
    dt: float
    noise: float
    colour: str
    times: tuple[float, ...]
    omega: tuple[float, ...]
    draws: int
    outer: int


def snr(decibel: float) -> float:
    """Noise over the standard deviation of the output, as a negative number (see `deviation`)."""
    return -(10.0 ** (-decibel / 20.0))


REAL_POLES = ((1.0, 4.0, 3.0), (3.0,), register(7, 6, 1016, 8), 0.05)


def coloured(length: int) -> tuple[tuple[float, ...], tuple[float, ...], Array, float]:
    """The same poles, for a record of so many samples in coloured noise."""
    return (1.0, 4.0, 3.0), (2.0,), register(7, 6, length, 8), 0.05


RAO_GARNIER = (1.0, 5.0, 408.0, 416.0, 1600.0), (-6400.0, 1600.0)
SHORT = ((1.0, 1.0, 3.0), (0.5,), np.ones(100), 0.05)
LONG = ((1.0, 1.0, 3.0), (0.5,), np.ones(1000), 0.05)
MAXIMAL = register(10, 7, 7161, 7)
AT = ((0.3, 1.0, 3.0), (0.3, 1.7, 6.0))
AT_4 = ((0.1, 0.5, 2.0, 10.0), (0.5, 2.0, 8.0, 20.0, 60.0))
AT_D = ((0.5, 1.5, 4.0), (0.5, 1.7, 5.0))
CASES = {
    "3/(s^2+4s+3), N=1016, white, 10 dB": Case(*REAL_POLES, snr(10), "white", *AT, 1000, 0),
    "Rao-Garnier, N=1000, 10 dB": Case(
        *RAO_GARNIER, MAXIMAL[:1000], 0.01, snr(10), "white", *AT_4, 1000, 0
    ),
    "Rao-Garnier, N=1000, 0 dB": Case(
        *RAO_GARNIER, MAXIMAL[:1000], 0.01, snr(0), "white", *AT_4, 1000, 0
    ),
    "Rao-Garnier, N=7161, 10 dB": Case(
        *RAO_GARNIER, MAXIMAL, 0.01, snr(10), "white", *AT_4, 1000, 0
    ),
    "aircraft, M=100, ratio 0.5": Case(*SHORT, 0.5, "white", *AT_D, 1000, 60),
    "aircraft, M=100, ratio 1": Case(*SHORT, 1.0, "white", *AT_D, 1000, 60),
    "aircraft, M=1000, ratio 1": Case(*LONG, 1.0, "white", *AT_D, 1000, 0),
    "2/(s^2+4s+3), N=1016, ARMA, 15 dB": Case(*coloured(1016), snr(15), "arma", *AT, 1000, 0),
    "2/(s^2+4s+3), N=100, ARMA, 15 dB": Case(*coloured(100), snr(15), "arma", *AT, 1000, 0),
    "2/(s^2+4s+3), N=150, ARMA, 15 dB": Case(*coloured(150), snr(15), "arma", *AT, 1000, 0),
}


def modes(case: Case) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Poles and residues."""
    poles = np.roots(case.den)
    return poles, np.polyval(case.num, poles) / np.polyval(np.polyder(case.den), poles)


def response(case: Case) -> Array:
    """Output from rest for the held input, mode by mode."""
    y = np.zeros(case.u.size)
    for p, r in zip(*modes(case), strict=True):
        weights = [0.0, r * np.expm1(p * case.dt) / p], [1.0, -np.exp(p * case.dt)]
        y += lfilter(*weights, case.u.astype(complex)).real
    return y


def deviation(case: Case, clean: Array) -> float:
    """Standard deviation of the noise: a ratio to the rms, or (negative) to the std."""
    return case.noise * np.sqrt(np.mean(clean**2)) if case.noise > 0 else -case.noise * clean.std()


def noise_of(case: Case, clean: Array, rng: np.random.Generator) -> Array:
    """White noise, or ARMA with C = 1 + 0.9 q^-1 and D = 1 - q^-1 + 0.2 q^-2."""
    if case.colour == "white":
        return deviation(case, clean) * rng.standard_normal(clean.size)
    settle = 500
    c, d = [1.0, 0.9], [1.0, -1.0, 0.2]
    impulse = lfilter(c, d, np.eye(1, 2000)[0])
    coloured = lfilter(c, d, rng.standard_normal(clean.size + settle))[settle:]
    return deviation(case, clean) * coloured / np.linalg.norm(impulse)


def truths(case: Case) -> dict[str, float]:
    """Every quantity by the name that the estimates give it."""
    n, m = len(case.den) - 1, len(case.num) - 1
    found = {f"a{n - 1 - k}": v for k, v in enumerate(case.den[1:])}
    found |= {f"b{m - k}": v for k, v in enumerate(case.num)}
    poles, residues = modes(case)
    poles = sorted(poles, key=abs)
    pairs, real = [p for p in poles if p.imag > 0], [p.real for p in poles if p.imag == 0]
    for k, p in enumerate(pairs, 1):
        number = f" {k}" if len(pairs) > 1 else ""
        found |= {f"natural frequency{number}": abs(p), f"damping{number}": -p.real / abs(p)}
    for k, p in enumerate(real, 1):
        number = f" {k}" if len(real) > 1 else ""
        found |= {f"real pole{number}": p, f"time constant{number}": -1.0 / p}
    if n == 2:  # an estimate may have a pair where the truth has real poles
        frequency = np.sqrt(case.den[2])
        found |= {"natural frequency": frequency, "damping": case.den[1] / (2.0 * frequency)}
    found["dc gain"] = case.num[-1] / case.den[-1]
    poles, residues = modes(case)
    for t in case.times:
        found[f"step({t:g} s)"] = float(np.sum(residues * np.expm1(poles * t) / poles).real)
    for w in case.omega:
        ratio = np.polyval(case.num, 1j * w) / np.polyval(case.den, 1j * w)
        found[f"|G|({w:g})"], found[f"arg G({w:g})"] = float(abs(ratio)), float(np.angle(ratio))
    return found


Ends = dict[str, tuple[float, float]]


def asked(case: Case, estimate, route: str, seed: int) -> Ends:
    """95 % intervals of everything by one route."""
    if route == "delta":
        found = {p.name: p.interval(LEVEL) for p in estimate.parameters.values()}
        found |= {q.name: q.interval(LEVEL) for q in derived(estimate)}
        steps = step_band(estimate, case.times, LEVEL)
        bode = response_band(estimate, case.omega, level=LEVEL)
    else:
        scale = "stable" if route == "stable" else "coefficients"
        drawn = sample(estimate, seed=seed, scale=scale)
        rows = sampled_coefficients(drawn, LEVEL) + sampled_derived(drawn, LEVEL)
        found = {q.name: (q.low, q.high) for q in rows}
        steps = sampled_step_band(drawn, case.times, LEVEL)
        bode = sampled_response_band(drawn, case.omega, level=LEVEL)
    for k, t in enumerate(case.times):
        found[f"step({t:g} s)"] = float(steps.low[k, 0, 0]), float(steps.high[k, 0, 0])
    for k, w in enumerate(case.omega):
        found[f"|G|({w:g})"] = (
            float(bode.magnitude_low[k, 0, 0]),
            float(bode.magnitude_high[k, 0, 0]),
        )
        found[f"arg G({w:g})"] = float(bode.phase_low[k, 0, 0]), float(bode.phase_high[k, 0, 0])
    return found


def side(name: str, ends: tuple[float, float], truth: float) -> int:
    """-1: the truth lies below the interval, 0: inside, 1: above."""
    low, high = ends
    if name.startswith("arg"):  # whole turns do not count
        middle = 0.5 * (low + high)
        truth = middle + float(np.angle(np.exp(1j * (truth - middle))))
    return -1 if truth < low else 1 if truth > high else 0


class Drawn(NamedTuple):
    """One record: where the truth lies for each route and quantity, or why there is no answer."""

    theta: list[float]
    sides: dict[str, dict[str, int]]
    refused: str
    again: dict[str, list[list[float]]]
    copies: tuple[int, int, int]


def method_of(case: Case):
    """``noise="auto"`` for coloured noise, where the method has that option."""
    options = {field.name for field in dataclasses.fields(ThreeModel)}
    if case.colour != "white" and "noise" in options:
        return ThreeModel(noise="auto")
    return ThreeModel()


def one(name: str, draw: int, outer: bool, copies: int) -> Drawn:
    """Identify one record and ask for its intervals."""
    case = CASES[name]
    own = np.random.SeedSequence(SEED, spawn_key=(list(CASES).index(name), draw))
    clean = response(case)
    y = clean + noise_of(case, clean, np.random.default_rng(own))
    record = Record(case.u, y, dt=case.dt)
    n, m = len(case.den) - 1, len(case.num) - 1
    structure = Structure(n, m, offset=False, initial_state="rest")
    method = method_of(case)
    try:
        estimate = identify(record, structure, method)
    except TridentifyError as error:
        return Drawn([], {}, type(error).__name__, {}, (0, 0, 0))
    truth = truths(case)
    sides = {}
    for route in ROUTES:
        ends = asked(case, estimate, route, draw)
        sides[route] = {q: side(q, ends[q], truth[q]) for q in ends if q in truth}
    if not outer:
        return Drawn(estimate.theta.tolist(), sides, "", {}, (0, 0, 0))
    found = bootstrap(estimate, record, method, n_draws=copies, seed=draw)
    again = {kind: found.intervals(LEVEL, kind).tolist() for kind in KINDS}
    again["delta"] = [list(p.interval(LEVEL)) for p in estimate.parameters.values()]
    again["theta"] = [estimate.theta.tolist(), found.bias_corrected.tolist()]
    again["theta"].append((estimate.theta - found.bias).tolist())
    for kind in KINDS[:2]:
        rows = sampled_derived(found.sample, LEVEL, kind=kind)
        sides[kind] = {
            q.name: side(q.name, (q.low, q.high), truth[q.name]) for q in rows if q.name in truth
        }
    counted = (found.n_draws, found.n_failed, found.n_flagged)
    return Drawn(estimate.theta.tolist(), sides, "", again, counted)


def batch(task: tuple[str, int, int, bool, int]) -> list[Drawn]:
    """Draws ``first .. last - 1`` of a case."""
    name, first, last, outer, copies = task
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return [one(name, draw, outer, copies) for draw in range(first, last)]


def share(hits: int, count: int) -> str:
    """A percentage with the half width of its 95 % interval; marked where it misses 93 to 97."""
    if not count:
        return f"{'-':>14s}"
    p = hits / count
    error = 1.96 * np.sqrt(max(p * (1 - p), 0.25 / count) / count)
    mark = "!" if p + error < 0.93 or p - error > 0.97 else "?" if not 0.93 <= p <= 0.97 else " "
    return f"{100 * p:6.1f} +-{100 * error:4.1f}{mark}"


def table(case: Case, drawn: list[Drawn], routes: tuple[str, ...]) -> tuple[list[str], dict]:
    """Coverage of every quantity, with the share of misses below and above."""
    answers = [d for d in drawn if not d.refused]
    head = f"  {'':22s}{'truth':>9s}{'n':>6s}"
    lines = [head + "".join(f"{route:>13s} {'low/high %':>12s}" for route in routes)]
    data = {}
    for name, truth in truths(case).items():
        row, data[name] = "", {}
        count = 0
        for route in routes:
            found = [d.sides[route][name] for d in answers if name in d.sides.get(route, {})]
            count = len(found)
            hits, below, above = (found.count(k) for k in (0, -1, 1))
            misses = f"{100 * below / count:.1f}/{100 * above / count:.1f}" if count else ""
            row += f"{share(hits, count)}{misses:>12s}"
            data[name][route] = {"count": count, "inside": hits, "below": below, "above": above}
        if count:
            lines.append(f"  {name:22s}{truth:9.4g}{count:6d}{row}")
    return lines, data


def bootstrapped(case: Case, drawn: list[Drawn]) -> tuple[list[str], dict]:
    """Coverage by the bootstrap, and bias and error before and after the correction."""
    answers = [d for d in drawn if d.again]
    truth = np.array([*case.den[1:], *case.num])
    n = len(answers)
    names = list(truths(case))[: truth.size]
    counts = np.array([d.copies for d in answers]).sum(axis=0)
    lines = [
        f"  bootstrap: {n} records, {counts[0]} copies, {counts[1]} failed, {counts[2]} flagged",
        f"  {'':22s}" + "".join(f"{kind:>13s} " for kind in ("delta", *KINDS)),
    ]
    data: dict[str, object] = {"records": n, "copies": counts.tolist()}
    for k, name in enumerate(names):
        row = f"  {name:22s}"
        for kind in ("delta", *KINDS):
            ends = np.array([d.again[kind][k] for d in answers])
            inside = int(np.sum((ends[:, 0] <= truth[k]) & (truth[k] <= ends[:, 1])))
            row += share(inside, n)
            data[f"{name} {kind}"] = inside
        lines.append(row)
    for name in list(truths(case))[truth.size :]:
        row, asked_any = f"  {name:22s}", False
        for kind in ("delta", *KINDS):
            found = [d.sides[kind][name] for d in answers if name in d.sides.get(kind, {})]
            row += share(found.count(0), len(found))
            asked_any |= kind in KINDS and bool(found)
        if asked_any:
            lines.append(row)
    titles = ("mean err", "median err", "rmse", "median |err|")
    lines.append(f"  {'error, % of the truth':34s}" + "".join(f"{t:>14s}" for t in titles))
    for j, label in enumerate(("estimate", "median-corrected", "mean-corrected")):
        values = np.array([d.again["theta"][j] for d in answers]) / truth - 1.0
        for k, name in enumerate(names):
            e = 100 * values[:, k]
            figures = e.mean(), np.median(e), np.sqrt(np.mean(e**2)), np.median(np.abs(e))
            lines.append(f"  {name:4s}{label:30s}" + "".join(f"{v:14.4g}" for v in figures))
            data[f"{name} {label}"] = dict(zip(titles, map(float, figures), strict=True))
    return lines, data


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    parser.add_argument("--draws", type=int, help="records for each case (default 1000)")
    parser.add_argument("--outer", type=int, help="records that are bootstrapped (default 60)")
    parser.add_argument("--copies", type=int, default=200, help="copies of each of these records")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    options = parser.parse_args()
    chosen = {name: case for name, case in CASES.items() if options.only in name}
    results = measured(chosen, options)
    if options.save:
        if options.only:  # the other cases stay as they were measured
            results = earlier() | results
        ordered = {name: results[name] for name in CASES if name in results}
        keep("coverage", "\n".join([*HEAD, *(one["text"] for one in ordered.values())]), ordered)


def measured(chosen: dict[str, Case], options: argparse.Namespace) -> dict[str, dict]:
    """Text and figures of every case."""
    results: dict[str, dict] = {}
    began = time.perf_counter()
    print("\n".join(HEAD))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.workers, mp_context=context) as pool:
        waiting = {}
        for name, case in chosen.items():
            draws = options.draws or case.draws
            outer = min(case.outer and (options.outer or case.outer), draws)
            cuts = sorted({*range(0, outer, 2), *range(outer, draws, BATCH), outer, draws})
            waiting[name] = [
                pool.submit(batch, (name, a, b, a < outer, options.copies))
                for a, b in itertools.pairwise(cuts)
            ]
        for name, futures in waiting.items():
            drawn = [d for future in futures for d in future.result()]
            results[name] = reported(name, chosen[name], drawn)
            print(results[name]["text"], flush=True)
            print(f"[{time.perf_counter() - began:.0f} s]", flush=True)
    return results


def reported(name: str, case: Case, drawn: list[Drawn]) -> dict:
    """One case as text and as figures."""
    refused = [d.refused for d in drawn if d.refused]
    why = ", ".join(f"{refused.count(r)} {r}" for r in sorted(set(refused)))
    lines = ["", f"{name}: {len(drawn)} records, {len(refused)} refused ({why or 'none'})"]
    rows, data = table(case, drawn, ROUTES)
    found = {"records": len(drawn), "refused": refused, "coverage": data}
    if any(d.again for d in drawn):
        more, found["bootstrap"] = bootstrapped(case, drawn)
        rows += more
    return {"text": "\n".join(lines + rows), **found}


def earlier() -> dict[str, dict]:
    """What is stored of an earlier run."""
    path = HERE / "results" / "coverage.json"
    return json.loads(path.read_text())["data"] if path.exists() else {}


if __name__ == "__main__":
    main()
