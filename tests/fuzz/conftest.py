"""How much the fuzzers try: fixed seeds with `make test`, new ones with `make fuzz`."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

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
