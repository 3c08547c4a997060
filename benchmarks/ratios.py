"""What one call takes beside another: processor time, both in one process and in turn.

The plain call is ``identify`` of 1,000 samples of ``0.5 / (s^2 + s + 3)`` with white noise of 20
dB; every other row changes one thing of it. Medians over several records, the least of the repeats
each.

- coloured noise: an autoregression with its pole at 0.9, of the same power;
- two needless poles: ``Structure(4, 2)`` of the coloured record;
- delay estimated: ``delay="free"`` beside the delay stated, 0.12 s;
- uneven time: intervals of 0.6 to 1.4 of the mean.

What judging, choice of orders and bootstrap take is in `judging_time.py`.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from machine import keep
from scipy.signal import lfilter

from tridentify import (
    Record,
    Structure,
    TransferFunction,
    identify,
    simulate,
)

MODEL = TransferFunction([0.5], [1.0, 1.0, 3.0])
LATE = TransferFunction([0.5], [1.0, 1.0, 3.0], delay=0.12)
DT, SAMPLES, NOISE = 0.05, 1000, 0.1
RIGHT, MORE = Structure(2, 0), Structure(4, 2)


class Row(NamedTuple):
    """Two calls on the same record, and how many times the second the first may take."""

    name: str
    call: Callable[[], object]
    beside: Callable[[], object]
    aim: float


def drawn(seed: int, *, coloured: bool = False, uneven: bool = False, late: bool = False) -> Record:
    """One record; everything but its seed is in the words of this file's docstring."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 7 + 1), 7)[:SAMPLES]
    steps = DT * (rng.uniform(0.6, 1.4, SAMPLES) if uneven else np.ones(SAMPLES))
    t = np.cumsum(steps) - steps[0]
    clock = {"t": t} if uneven else {"dt": DT}
    y = simulate(LATE if late else MODEL, Record(u, u, **clock))[:, 0]
    noise = rng.standard_normal(SAMPLES + 200)
    noise = lfilter([1.0], [1.0, -0.9], noise) if coloured else noise
    noise = noise[200:] / noise[200:].std()
    return Record(u, y + NOISE * y.std() * noise, **clock)


def rows(seed: int) -> list[Row]:
    """All comparisons on the records of one seed."""
    white, coloured = drawn(seed), drawn(seed, coloured=True)
    uneven, late = drawn(seed, uneven=True), drawn(seed, late=True)
    known = Structure(2, 0, delay=0.12)
    return [
        Row("coloured noise", lambda: identify(coloured, RIGHT),
            lambda: identify(white, RIGHT), 10),
        Row("two needless poles", lambda: identify(coloured, MORE),
            lambda: identify(coloured, RIGHT), 10),
        Row("delay estimated", lambda: identify(late, Structure(2, 0, delay="free")),
            lambda: identify(late, known), 10),
        Row("uneven time", lambda: identify(uneven, RIGHT), lambda: identify(white, RIGHT), 4),
    ]  # fmt: skip


def seconds(call: Callable[[], object], repeats: int) -> float:
    """The least processor time of some calls."""
    found = []
    for _ in range(repeats):
        before = time.process_time()
        call()
        found.append(time.process_time() - before)
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    options = parser.parse_args()
    measured: dict[str, list[tuple[float, float]]] = {}
    aims: dict[str, float] = {}
    for seed in range(options.records):
        for row in rows(seed):
            own = seconds(row.call, options.repeats)
            beside = seconds(row.beside, options.repeats)
            measured.setdefault(row.name, []).append((own, beside))
            aims[row.name] = row.aim
    lines = [f"{'':26s}{'takes':>12s}{'beside':>12s}{'times':>8s}{'aim under':>11s}"]
    data: dict[str, object] = {}
    for name, pairs in measured.items():
        times = statistics.median(own / beside for own, beside in pairs)
        own, beside = (statistics.median(column) for column in zip(*pairs, strict=True))
        verdict = "met" if times < aims[name] else "missed"
        lines.append(
            f"{name:26s}{1e3 * own:9.1f} ms{1e3 * beside:9.1f} ms{times:8.1f}{aims[name]:7.0f} "
            f"{verdict}"
        )
        data[name] = {"pairs": pairs, "aim": aims[name]}
    lines.append(f"processor time; medians over {options.records} records")
    report = "\n".join(lines)
    print(report)
    if options.save:
        keep("ratios", report, data)


if __name__ == "__main__":
    main()
