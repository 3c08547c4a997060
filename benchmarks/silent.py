"""Wrong answers without a word: records with something wrong in them, and what is said of them.

`wrong_records` draws the records, fresh seeds of every kind and right ones beside them. An answer
is *bad* when a coefficient with a stated error below 20 % is more than 5 stated errors and 20 % off
the truth; it is *silent* when nothing that matters is found. The columns `identify` and `validate`
count the records with a finding that matters, *named* those whose first finding names the cause.
Right records with a finding are false alarms.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import argparse
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from machine import keep
from wrong_records import KINDS, Case, draw

from tridentify import Estimate, TridentifyError, identify, validate

OFF, ERRORS, SURE = 0.2, 5.0, 0.2
Row = dict[str, Any]


def is_bad(case: Case, estimate: Estimate) -> bool:
    """Whether a confident coefficient is far from the truth."""
    if case.theta is None or len(case.theta) != len(estimate.theta):
        return False
    off = np.abs(estimate.theta - case.theta)
    size = np.abs(case.theta)
    sure = estimate.std < SURE * np.abs(estimate.theta)
    return bool(np.any(sure & (off > ERRORS * estimate.std) & (off > OFF * size)))


def judge(task: tuple[str, int, bool]) -> Row:
    """One record."""
    kind, seed, checked = task
    case = draw(kind, seed)
    warnings.simplefilter("ignore")
    try:
        estimate = identify(list(case.records), case.structure, throw=False)
    except TridentifyError as error:
        return {"kind": kind, "seed": seed, "refused": type(error).__name__}
    said = [f.code for f in estimate.findings if f.matters]
    row: Row = {
        "kind": kind, "seed": seed, "bad": is_bad(case, estimate), "said": said,
        "status": estimate.status.name, "wanted": list(case.codes),
    }  # fmt: skip
    if checked:
        try:
            found = validate(estimate, list(case.records))
            row["checked"] = [f.code for f in found.findings if f.matters]
        except TridentifyError as error:
            row["checked"] = [type(error).__name__]
    return row


def told(rows: list[Row], key: str) -> str:
    """How many rows have a finding."""
    return f"{sum(bool(row[key]) for row in rows):4d}"


def table(rows: list[Row], checked: bool) -> list[str]:
    """One line a kind."""
    keys = ("said", "checked") if checked else ("said",)
    heads = "".join(f"{w:>10s}{'named':>9s}" for w in ("identify", "validate")[: len(keys)])
    silent = "silent"
    lines = [f"{'kind':28s}{'records':>8s}{'bad':>6s}{silent:>8s}{heads}   first findings"]
    for kind in KINDS:
        own = [row for row in rows if row["kind"] == kind and "refused" not in row]
        if not own:
            continue
        bad = [row for row in own if row["bad"]]
        cells = ""
        for key in keys:
            found = [row for row in own if row[key]]
            named = sum(row[key][0] in row["wanted"] for row in found)
            cells += f"{len(found):10d}{named:9d}"
        quiet = sum(not row["said"] for row in bad)
        first = Counter(row[keys[-1]][0] for row in own if row[keys[-1]])
        said = ", ".join(f"{code} {count}" for code, count in first.most_common(4))
        lines.append(f"{kind:28s}{len(own):8d}{len(bad):6d}{quiet:8d}{cells}   {said}")
    refused = sum("refused" in row for row in rows)
    return [*lines, f"refused: {refused} of {len(rows)}"]


def main() -> None:
    """Draw, judge, and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--records", type=int, default=40, help="of each kind")
    parser.add_argument("--seed", type=int, default=1000, help="the first")
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), help="which kinds")
    parser.add_argument("--no-validate", action="store_true", help="identify alone")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--save", action="store_true", help="store the table under results/")
    asked = parser.parse_args()
    checked = not asked.no_validate
    tasks = [(kind, asked.seed + k, checked) for kind in asked.kinds for k in range(asked.records)]
    with ProcessPoolExecutor(asked.workers) as pool:
        rows = list(pool.map(judge, tasks, chunksize=4))
    lines = table(rows, checked)
    print("\n".join(lines))
    if asked.save:
        keep("silent", "\n".join(lines), rows)


if __name__ == "__main__":
    main()
