"""A small study as a file declares it, for the tests of what is made of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

STUDY = """
description = "two plants under steps"
draws = 12
seed = 3

[systems.first]
num = [2.0]
den = [1.0, 4.0]

[systems.aircraft]
num = [0.5]
den = [1.0, 1.0, 3.0]

[inputs.pulses]
kind = "doublet"
amplitude = 1.0
width = 2.0
tail = 4.0
dt = 0.1

[noises.white]
ratio = [0.05, 0.2]

[methods.ours]
kind = "three-model"

[methods.raw]
kind = "step-2-alone"
filter = [1.0, 6.0, 12.0, 8.0]
"""


def document() -> dict[str, Any]:
    """The same as `tomllib` gives it, to change something in it."""
    import tomllib

    return tomllib.loads(STUDY)


def numbers(rows: Sequence[Any]) -> list[dict[str, Any]]:
    """Rows in order, without the times, which no two runs share."""
    kept = [{key: value for key, value in row.items() if key != "seconds"} for row in rows]
    return sorted(kept, key=lambda row: (row["cell"], row["method"], row["draw"]))
