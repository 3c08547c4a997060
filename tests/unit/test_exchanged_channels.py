"""A record whose output is the command, and whose input answers it; and what is said once only."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from tridentify import Record, advise, identify

STEP, FINE = 0.08, 20
"""[s], and steps of the simulation in one of them."""


def moved_by_levels(seed: int, den: list[float], n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """A held input at levels and what it makes of an output, simulated apart from the package."""
    rng = np.random.default_rng([6113, seed])
    u = np.repeat(rng.uniform(-1.0, 1.0, n), 8)[:n]
    t = np.arange(n * FINE) * STEP / FINE
    y = signal.lsim(([den[-1] or 1.0], den), np.repeat(u, FINE), t, interp=False)[1][::FINE]
    return u, y + 0.02 * y.std() * rng.standard_normal(n)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_input_and_output_are_told_to_be_exchanged(seed: int) -> None:
    """And no controller is modelled first, which takes ten times as long and tells nothing."""
    u, y = moved_by_levels(seed, [1.0, 2.2, 9.0])
    record = Record(y, u, dt=STEP, intersample="auto")
    found = identify(record, (2, 1), throw=False)
    assert found.route == "open-loop"
    first = found.findings[0]
    assert (first.code, first.severity) == ("no-response", "error")
    assert "look exchanged" in first.message
    assert "look exchanged" in advise(record).findings[0].message
    assert not any("exchanged" in one.message for one in advise(Record(u, y, dt=STEP)).findings)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_an_integrator_whose_last_coefficient_was_left_free_is_told_once(seed: int) -> None:
    """Exciting it more, as for others that are not determined, would tell it no better."""
    u, y = moved_by_levels(seed, [1.0, 1.0, 0.0])
    found = identify(Record(u, y, dt=STEP), (2, 0)).findings
    assert [one.code for one in found] == ["outside-the-record"]
    assert "Fix the pole at zero" in found[0].remedy


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_rows_that_are_stored_twice_are_told_once(seed: int) -> None:
    u, y = moved_by_levels(seed, [1.0, 2.2, 9.0])
    rows = np.sort(np.append(np.arange(u.size), np.repeat([60, 170, 290], [3, 2, 4])))
    found = identify(Record(u[rows], y[rows], dt=STEP), (2, 0)).findings
    sets_in = any("in at once" in one.message for one in found)
    assert any(one.code == "stuck-sensor" for one in found) != sets_in
