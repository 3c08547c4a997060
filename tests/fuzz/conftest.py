"""How much the fuzzers try: fixed seeds with `make test`, new ones with `make fuzz`."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest


@dataclass(frozen=True, eq=False)
class Seeds:
    """Random generators for one test, each named by its seed.

    Attributes
    ----------
    seconds
        Zero: the seeds 0, 1, 2, ... as many as the test asks for. Otherwise new seeds until so many
        seconds are over.
    """

    seconds: float

    def take(self, count: int) -> Iterator[tuple[int, np.random.Generator]]:
        """Give (seed, generator) `count` times, or until the time is over."""
        if not self.seconds:
            for seed in range(count):
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
    return Seeds(float(os.environ.get("TRIDENTIFY_FUZZ_SECONDS", "0")))
