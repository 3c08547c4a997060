"""What `advise` tells of records with one thing wrong in them, and of right ones, by class.

The records are those of `wrong_records`; what needs a model to be seen (cubic stiffness, two
plants, a plant that varies, an order too low) is not for `advise` and left out. A right record is
called wrong where a finding is more than a note.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

from machine import keep
from wrong_records import draw

from tridentify import advise
from tridentify.errors import TridentifyError

RIGHT = ("right", "right, input measured", "right, two experiments")
WRONG = (
    "sensor hangs",
    "single sine, four poles",
    "input measured, stated held",
    "delay",
    "slow disturbance",
    "lost rows",
    "clipped, then noise",
    "feedback",
    "spikes",
)


class Row(NamedTuple):
    """What became of one record."""

    kind: str
    seed: int
    codes: tuple[str, ...]
    notes: tuple[str, ...]
    named: bool
    poles: int
    seconds: float


def judge(task: tuple[str, int]) -> Row:
    """Advise on one record."""
    kind, seed = task
    case = draw(kind, seed)
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = advise(case.records)
        except TridentifyError:
            return Row(kind, seed, ("refused",), (), False, 0, time.process_time() - begun)
    codes = tuple(dict.fromkeys(f.code for f in found.findings if f.matters))
    notes = tuple(dict.fromkeys(f.code for f in found.findings if not f.matters))
    named = any(code in case.codes for code in (*codes, *notes))
    return Row(kind, seed, codes, notes, named, found.poles or 0, time.process_time() - begun)


def table(rows: list[Row]) -> list[str]:
    """A line a class."""
    lines = [f"{'class':30s} {'records':>7s} {'named':>7s} {'s':>6s}  findings beyond notes"]
    for kind in dict.fromkeys(row.kind for row in rows):
        own = [row for row in rows if row.kind == kind]
        counts = Counter(code for row in own for code in row.codes).most_common(4)
        named = "" if kind in RIGHT else f"{100 * sum(r.named for r in own) / len(own):.0f} %"
        seconds = sum(row.seconds for row in own) / len(own)
        told = ", ".join(f"{code} {n}" for code, n in counts) or "none"
        lines.append(f"{kind:30s} {len(own):7d} {named:>7s} {seconds:6.2f}  {told}")
    right = [row for row in rows if row.kind in RIGHT]
    if right:
        wrong = sum(bool(row.codes) for row in right)
        late = sum("delay" in row.notes for row in right)
        many = sum(row.poles > 2 for row in right)
        lines += [
            "",
            f"right records: {wrong} of {len(right)} called wrong ({100 * wrong / len(right):.1f} "
            f"%), {late} with a delay that is not there, {many} with more than their two poles",
        ]
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=40, help="of every class")
    parser.add_argument("--seed", type=int, default=20_000, help="the first one")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    args = parser.parse_args()
    tasks = [(kind, args.seed + k) for kind in (*RIGHT, *WRONG) for k in range(args.records)]
    with ProcessPoolExecutor(args.jobs) as pool:
        rows = list(pool.map(judge, tasks, chunksize=4))
    report = "\n".join(table(rows))
    print(report)
    if args.save:
        keep("advice", report, [row._asdict() for row in rows])


if __name__ == "__main__":
    main()
