"""`delay="free"` on random systems: how often a known delay would have explained the record better.

Orders 1 to 4, delays of 0 to 20 samples (none, whole steps and anything between), gains of both
signs, inputs with few edges and with many, noise that is white or (a third) first-order
autoregressive, starts that are free, at rest, and left to the method. Kind of input, order and
start go round in turn; all else comes from ``SeedSequence(seed, spawn_key=(number,))``.

The judge is a dense grid of known delays, a step apart, up to three steps beyond the true one and
the one that was found. It is walked forward from the true poles and back from those that were
found, refined at every place from the neighbour's; the lowest three are refined once more with the
delay free, and so is the truth. The noise is known to the judge, and all of it is on the samples
that the longest delay of the grid allows, so that the likelihoods can be compared. An answer is
wrong where its delay, with the best poles from those found and from the truth, is more than 2 above
the lowest in ``-2 log L``; a wrong sign is told by itself, and so is a tenth of the samples or more
left out beyond what the true delay takes.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from machine import keep
from numpy.typing import NDArray
from scipy.signal import lfilter, max_len_seq

from tridentify import (
    Estimate,
    Record,
    Structure,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.errors import TridentifyError
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import finish
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.estimation.likelihood.setup.problem import Problem

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SEED = 20261122
INPUTS = ("step", "doublet", "two-level", "pulses", "prbs", "multisine")
ORDERS = (1, 2, 3, 4)
STARTS = ("free", "auto", "rest")
SNRS = (30.0, 15.0, 5.0)
COLOUR, COLOURED = 0.8, 1.0 / 3.0
LATEST = 20.0
BEYOND = 3.0
GRID = 1.0
WORSE = 2.0
LOST = 0.1
MOST_PLACES = 60


class Drawn(NamedTuple):
    """One record with its truth; times in steps of 1 s."""

    number: int
    input: str
    snr: float
    coloured: bool
    start: str
    model: TransferFunction
    record: Record
    structure: Structure

    @property
    def delay(self) -> float:
        """In steps."""
        return float(self.model.delay[0, 0])


def draw(number: int, seed: int = SEED) -> Drawn:
    """Record ``number``."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    kind, order = INPUTS[number % 6], ORDERS[(number // 6) % 4]
    start, coloured = STARTS[(number + number // 6) % 3], bool(rng.uniform() < COLOURED)
    n_samples, snr = int(rng.choice([250, 600])), float(rng.choice(SNRS))
    poles = _poles(rng, order, n_samples)
    zeros = -np.exp(rng.uniform(np.log(0.05), 0.0, int(rng.integers(0, order))))
    zeros = zeros * rng.choice([-1.0, 1.0], zeros.size)
    den, num = np.poly(poles).real, np.atleast_1d(np.poly(zeros))
    num = num * rng.choice([-1.0, 1.0]) * den[-1] / np.abs(num[-1])
    delay = float(rng.choice([0.0, rng.integers(1, LATEST + 1), rng.uniform(0.0, LATEST)]))
    model = TransferFunction(num, den, delay=delay)
    u = _input(rng, kind, n_samples)
    y = simulate(model, Record(u, u, dt=1.0))[:, 0]
    noise = rng.standard_normal(n_samples + 200)
    if coloured:
        noise = lfilter([1.0], [1.0, -COLOUR], noise)
    y = y + 10.0 ** (-snr / 20) * np.std(y) * noise[200:] / np.std(noise)
    offset = start != "rest"
    y = y + offset * rng.normal()
    structure = Structure(order, num.size - 1, delay="free", offset=offset, initial_state=start)
    return Drawn(number, kind, snr, coloured, start, model, Record(u, y, dt=1.0), structure)


def _poles(rng: np.random.Generator, order: int, n_samples: int) -> Complex:
    """Rates log-uniform over 1.3 decades, real ones and pairs of damping 0.1 to 0.9 [1/step]."""
    slowest, fastest = 15.0 / n_samples, 0.5
    pairs = int(rng.integers(0, order // 2 + 1))
    found: list[complex] = []
    for _ in range(pairs):
        damping = rng.uniform(0.1, 0.9)
        low = slowest / damping
        size = float(np.exp(rng.uniform(np.log(min(low, 0.4)), np.log(fastest))))
        turn = complex(-damping, np.sqrt(1.0 - damping**2))
        found += [size * turn, size * turn.conjugate()]
    while len(found) < order:
        found.append(-complex(np.exp(rng.uniform(np.log(slowest), np.log(fastest)))))
    return np.array(found)


def _input(rng: np.random.Generator, kind: str, n: int) -> Array:
    """Held over whole steps; the ones with few edges between two levels or three."""
    u = np.zeros(n)
    if kind == "step":
        u[int(rng.integers(5, n // 3)) :] = 1.0
    elif kind == "doublet":
        first, width = int(rng.integers(5, n // 4)), int(rng.integers(8, n // 6))
        u[first : first + width], u[first + width : first + 2 * width] = 1.0, -1.0
    elif kind == "two-level":
        for k in rng.choice(np.arange(5, n - n // 6), int(rng.integers(3, 9)), replace=False):
            u[k:] = 1.0 - u[k:]
    elif kind == "pulses":
        # the edges lie all in one part of the record
        first, width = int(rng.integers(5, n // 2)), n // 6
        for k in rng.choice(np.arange(first, first + width), 4, replace=False):
            u[k:] = 1.0 - u[k:]
    elif kind == "prbs":
        hold = int(rng.integers(2, 12))
        bits = int(np.ceil(np.log2(n / hold + 2)))
        sequence = 2.0 * max_len_seq(bits, state=rng.integers(0, 2, bits) | 1)[0] - 1.0
        u = np.resize(np.repeat(sequence, hold), n)
    else:
        period = n // int(rng.integers(1, 4))
        t = np.arange(n)
        lines = np.arange(1, max(period // 10, 4))
        for line in lines:
            u += np.cos(2.0 * np.pi * line * t / period + rng.uniform(0.0, 2.0 * np.pi))
        u /= np.std(u)
    return u


class Verdict(NamedTuple):
    """What became of one record."""

    drawn: Drawn
    refused: str
    above: float
    sign: bool
    lost: float
    seconds: float
    known_seconds: float
    found: float

    @property
    def wrong(self) -> bool:
        """Whether a known delay explains the record clearly better."""
        return not self.refused and self.above > WORSE


def judge(number: int, seed: int = SEED) -> Verdict:
    """Identify one record and look for better delays."""
    drawn = draw(number, seed)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        known, known_seconds = _timed(drawn, drawn.delay)
        found, seconds = _timed(drawn, "free")
        if not isinstance(found, Estimate):
            refused = found if isinstance(known, Estimate) else "both"
            return Verdict(drawn, refused, 0.0, False, 0.0, seconds, known_seconds, np.nan)
        above = _above(drawn, found)
    sign = bool(np.sign(found.model.dc_gain[0, 0]) == np.sign(drawn.model.dc_gain[0, 0]))
    unexplained = float(np.isnan(found.predict(drawn.record)).mean())
    allowed = drawn.delay / drawn.record.n_samples if drawn.start != "rest" else 0.0
    return Verdict(
        drawn,
        "",
        above,
        sign,
        max(unexplained - allowed, 0.0),
        seconds,
        known_seconds,
        float(found.model.delay[0, 0]),
    )


def _timed(drawn: Drawn, delay: float | str) -> tuple[Estimate | str, float]:
    structure = Structure(
        drawn.structure.poles,
        drawn.structure.zeros,
        delay=delay,
        offset=drawn.structure.offset,
        initial_state=drawn.structure.initial_state,
    )
    begun = time.process_time()
    found: Estimate | str
    try:
        found = identify(drawn.record, structure, throw=False)
    except (TridentifyError, ValueError) as refusal:
        found = type(refusal).__name__
    return found, time.process_time() - begun


def _above(drawn: Drawn, found: Estimate) -> float:
    """How far the delay found is above the best that is known, in ``-2 log L``."""
    delay = float(found.model.delay[0, 0])
    end = min(max(drawn.delay, delay) + BEYOND, 0.6 * drawn.record.n_samples)
    end = max(end, delay)
    state = found.structure.initial_state
    problem = _problem(drawn, Nuisances(str(state), bool(found.structure.offset), False), end)
    truth = np.roots(drawn.model.den[0][0]).astype(np.complex128)
    own = np.roots(found.model.den[0][0]).astype(np.complex128)
    here = min((_at(problem, delay, poles, 15) for poles in (own, truth)), key=_cost)
    ends = [here]
    grid = np.arange(0.0, end + 1e-9, max(GRID, end / MOST_PLACES))
    for way, start in ((grid, truth), (grid[::-1], own)):
        near = start
        for place in way:
            ends.append(_at(problem, place, near))
            near = ends[-1].poles
    ends.append(_at(problem, drawn.delay, truth, 15))
    for point in sorted(ends, key=_cost)[:3]:
        late = point.problem.freed(np.full(1, end))
        ends.append(finish(partial(evaluate, late), evaluate(late, point.poles), None, 15)[0])
    return _cost(here) - min(map(_cost, ends))


def _problem(drawn: Drawn, nuisances: Nuisances, end: float) -> Problem:
    """On the samples that every delay allows, with the colour that the noise has."""
    stated = drawn.start == "rest"
    y = np.array(drawn.record.y)
    if not stated:
        y[: int(np.ceil(end))] = np.nan
    record = Record(drawn.record.u, y, dt=1.0)
    structure = Structure(
        drawn.structure.poles,
        drawn.structure.zeros,
        delay=0.0 if stated else end,
        offset=nuisances.offset,
        initial_state=nuisances.initial_state,
    )
    noise = (np.array([-COLOUR]),) if drawn.coloured else ()
    return build([record], structure, nuisances).whitened(noise)


def _at(problem: Problem, delay: float, poles: Complex, most: int = 4) -> Point:
    late = problem.delayed(np.full(1, delay))
    return finish(partial(evaluate, late), evaluate(late, late.admissible(poles)[0]), None, most)[0]


def _cost(point: Point) -> float:
    return point.objective


def report(found: Sequence[Verdict]) -> str:
    """Counts by kind of input, order, noise and start."""
    lines = [f"{len(found)} random records (seed {SEED})", ""]
    lines.append("                records  wrong   sign  left out  refused")
    by: dict[str, Callable[[Verdict], object]] = {
        "all": lambda one: "",
        "input": lambda one: one.drawn.input,
        "order": lambda one: one.drawn.structure.poles,
        "start": lambda one: one.drawn.start,
        "noise": lambda one: "coloured" if one.drawn.coloured else "white",
        "SNR": lambda one: f"{one.drawn.snr:g} dB",
    }
    for title, key in by.items():
        groups = dict.fromkeys(sorted({key(one) for one in found}, key=str))
        for group in groups:
            own = [one for one in found if key(one) == group]
            counts = [
                len(own),
                sum(one.wrong for one in own),
                sum(not (one.sign or one.refused) for one in own),
                sum(one.lost > LOST for one in own),
                sum(one.refused not in ("", "both") for one in own),
            ]
            name = f"{title} {group}".strip()
            lines.append(
                f"{name:16s}"
                + "".join(f"{n:7d}" for n in counts[:3])
                + f"{counts[3]:10d}{counts[4]:9d}"
            )
    ratios = [one.seconds / max(one.known_seconds, 1e-3) for one in found]
    total = sum(one.seconds for one in found) / max(sum(one.known_seconds for one in found), 1e-3)
    told = ", ".join(f"{q:.1f}" for q in np.percentile(ratios, [50, 90]))
    lines += ["", f"time of a known delay: {total:.1f} times in all; median, 90 %: {told}"]
    return "\n".join(lines)


def line(one: Verdict) -> str:
    """One record in words."""
    d = one.drawn
    what = one.refused or ("WRONG" if one.wrong else "left out" if one.lost > LOST else "")
    return (
        f"{d.number:4d} {d.input:9s} {d.structure.poles},{d.structure.zeros} {d.start:4s} "
        f"{'coloured' if d.coloured else 'white':8s} {d.snr:2g} dB {d.record.n_samples} samples, "
        f"delay {d.delay:5.2f} found {one.found:6.2f} above {one.above:6.1f} "
        f"{one.seconds:5.2f} s, known {one.known_seconds:5.2f} s {what}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=288)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--verbose", action="store_true", help="every record")
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    options = parser.parse_args()
    found = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for one in pool.map(partial(judge, seed=options.seed), range(options.records)):
            found.append(one)
            if options.verbose:
                print(line(one), flush=True)
    told = report(found)
    print(told)
    if options.save:
        kept = [[one.drawn.number, one.above, one.found, one.seconds] for one in found]
        keep("delays", told, kept)


if __name__ == "__main__":
    main()
