"""Time of judging, as a multiple of one `identify` in the same process.

Simulated records: clean ones and coloured ones of a right model, and a few of `wrong_records.py`,
where all causes are tried. *Judging* is what `identify` adds to its search; `validate` is of the
identified record, with nothing remembered. `select_structure` gets ten candidates, `bootstrap` 500
draws (``--long``). Processor times, each the least of its repeats; the contenders take turns.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence

import numpy as np
import rival
import wrong_records
from machine import keep

from tridentify import Record, Structure, identify, select_structure, validate
from tridentify.identify import search
from tridentify.judgement.validation.remembered import remembered
from tridentify.uncertainty import bootstrap

REPEATS = 5
WRONG = ("delay", "cubic spring", "spikes", "two plants as one")
SEED = 4100
TEN = tuple(Structure(n, m) for n in (1, 2, 3, 4) for m in range(n))
AIMS = {"validate": 5.0, "select": 15.0, "bootstrap": 100.0}
DRAWS = 500

Case = tuple[list[Record], Structure]


def cases() -> dict[str, Case]:
    """Records and what is asked of them."""
    found: dict[str, Case] = {}
    for n in (250, 1000):
        u, y = rival.held_binary(n, 0, 0.05)
        found[f"clean, {n}"] = [Record(u, y, dt=0.05)], Structure(2, 0)
    rng = np.random.default_rng(SEED)
    u, y = rival.held_binary(1000, 1, 0.05)
    noise = np.convolve(rng.standard_normal(1200), 0.8 ** np.arange(200), "valid")[:1000]
    coloured = y + 0.1 * float(np.std(y)) * noise
    found["coloured, 1000"] = [Record(u, coloured, dt=0.05)], Structure(2, 0)
    for kind in WRONG:
        case = wrong_records.draw(kind, SEED)
        found[kind] = list(case.records), case.structure
    return found


def measured(case: Case, long: bool) -> dict[str, float]:
    """Processor time [s] of each."""
    records, structure = case
    estimate = identify(records, structure, throw=False)

    def forgetful() -> None:
        remembered(estimate, records)
        validate(estimate, records)

    asked: dict[str, Callable[[], object]] = {
        "identify": lambda: identify(records, structure, throw=False),
        "search": lambda: search(records, structure),
        "validate": forgetful,
    }
    spent = {name: _least(run, REPEATS) for name, run in asked.items()}
    # a judgement is remembered: what it takes is what is left without the search
    spent["judging"] = spent["identify"] - spent.pop("search")
    if long:
        spent["select"] = _least(lambda: select_structure(records, TEN), 1)
        spent["bootstrap"] = _least(lambda: bootstrap(estimate, records, n_draws=DRAWS), 1)
    return spent


def _least(run: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        before = time.process_time()
        run()
        times.append(time.process_time() - before)
    return min(times)


def table(rows: dict[str, dict[str, float]], names: Sequence[str]) -> list[str]:
    """Times [ms] and multiples of `identify`."""
    aims = "".join(f"{f'< {AIMS[name]:g}' if name in AIMS else '':>12s}" for name in names)
    lines = [
        f"{'record':22s}{'identify':>12s}{'judging':>12s}"
        + "".join(f"{f'{name} /':>12s}" for name in names),
        f"{'aim, times identify':46s}{aims}",
    ]
    for label, spent in rows.items():
        times = "".join(f"{1e3 * spent[name]:9.1f} ms" for name in ("identify", "judging"))
        ratios = "".join(f"{spent[name] / spent['identify']:12.2f}" for name in names)
        lines.append(f"{label:22s}{times}{ratios}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--long", action="store_true", help="choice of orders and bootstrap too")
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    options = parser.parse_args()
    rows = {label: measured(case, options.long) for label, case in cases().items()}
    names = ["validate", *(("select", "bootstrap") if options.long else ())]
    report = "\n".join(table(rows, names))
    print(report)
    if options.save:
        keep("judging_time", report, rows)


if __name__ == "__main__":
    main()
