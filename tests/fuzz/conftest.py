"""How much the fuzzers try: half of the fixed seeds with `make test`, new ones with `make fuzz`."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tridentify import TridentifyError
from tridentify.errors import DataWarning


@dataclass(frozen=True, eq=False)
class Seeds:
    """Random generators for one test, each named by its seed.

    Attributes
    ----------
    seconds
        Zero: the seeds 0, 1, 2, ... as many as the test asks for. Otherwise new seeds until so many
        seconds are over.
    share
        Of those that the test asks for.
    """

    seconds: float
    share: float = 1.0

    def take(self, count: int) -> Iterator[tuple[int, np.random.Generator]]:
        """Give (seed, generator) `count` times, or until the time is over."""
        if not self.seconds:
            for seed in range(round(self.share * count)):
                yield seed, np.random.default_rng(seed)
            return
        end = time.monotonic() + self.seconds
        fresh = np.random.default_rng()
        while time.monotonic() < end:
            seed = int(fresh.integers(1 << 40))
            yield seed, np.random.default_rng(seed)


@pytest.fixture
def seeds() -> Seeds:
    """Seeds to try: a test names the seed in the message of every assertion."""
    quick = os.environ.get("HYPOTHESIS_PROFILE") == "quick"
    return Seeds(float(os.environ.get("TRIDENTIFY_FUZZ_SECONDS", "0")), 0.5 if quick else 1.0)


BATCH = 250
"""Seeds for one process."""
SECONDS = 250.0
"""For one process."""


@pytest.fixture
def mutants() -> Callable[[str, Path, Seeds, int], Counter[str]]:
    """Damage files, resume from them in processes of their own, and count how that ended.

    Whatever is no refusal of the package's own, in one line, is told with its seed.
    """

    def outcomes(kind: str, folder: Path, seeds: Seeds, count: int) -> Counter[str]:
        found: Counter[str] = Counter()
        taken = seeds.take(count)
        while batch := [str(seed) for seed, _ in islice(taken, BATCH)]:
            script = Path(__file__).with_name("mutants.py")
            done = subprocess.run(
                [sys.executable, script, kind, folder, *batch], capture_output=True, text=True,
                timeout=SECONDS, check=False,
            )  # fmt: skip
            lines = done.stdout.splitlines()
            last = lines[-1] if lines else ""
            assert done.returncode == 0, f"seed {last}: {done.returncode} {done.stderr[-2000:]}"
            told = [line.partition(" ") for line in lines]
            wrong = [line for line in told if line[2] not in EXPECTED]
            assert not wrong, f"seeds and errors: {wrong}"
            found.update(line[2] for line in told)
        return found

    return outcomes


EXPECTED = ("refused", "not ready", "ran on")
LONGEST_LINE = 1000
"""What a message may take up, in characters."""


def attempted(what: str, call: Callable[[], object]) -> object | None:
    """The result; None for a refusal in one line; anything else fails and says what was tried."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", DataWarning)
            return call()
    except TridentifyError as error:
        text = str(error)
        assert "\n" not in text, f"{what}: {text}"
        assert 20 < len(text) < LONGEST_LINE, f"{what}: {text}"
        return None
    except Exception as error:
        raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error


@pytest.fixture
def attempt() -> Callable[[str, Callable[[], object]], object | None]:
    """Try a call in which every warning but the package's own is an error."""
    return attempted
