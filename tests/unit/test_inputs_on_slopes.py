"""Inputs that rest at most samples and move on slopes: measured, or a ramp that was set."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    Record,
    Structure,
    TransferFunction,
    identify,
    select_structure,
    simulate,
    validate,
)
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.attempts.intersample import behaviours as compared
from tridentify.judgement.causes.attempts.intersample import (
    for_left_open,
    in_doubt,
    seems_held,
)
from tridentify.judgement.cautions import _beside_better
from tridentify.judgement.selection import settle

K, T1, T2, T3 = 0.05, 60.0, 6.0, 12.0
SHIP = TransferFunction([K * T3 / (T1 * T2), K / (T1 * T2)], [1.0, 1 / T1 + 1 / T2, 1 / (T1 * T2)])
TRUTH = np.array([1 / T1 + 1 / T2, 1 / (T1 * T2), K * T3 / (T1 * T2), K / (T1 * T2)])
N, FINE = 900, 10


def followed(command: np.ndarray, most: float) -> np.ndarray:
    """A command as an actuator of limited rate follows it."""
    found, at = np.empty(command.size), 0.0
    for k, wanted in enumerate(command):
        at += float(np.clip(wanted - at, -most, most))
        found[k] = at
    return found


def ship(seed: int, measured: bool, intersample: str = "auto") -> Record:
    """A rudder of 3 degrees a second, measured, or set step by step and held; waves at the yaw."""
    rng = np.random.default_rng(seed)
    command: list[float] = []
    while len(command) < N:
        command += [20.0 * rng.uniform(-1.0, 1.0)] * int(rng.integers(20, 60))
    wanted = np.array(command[:N])
    if measured:
        fine = followed(np.repeat(wanted, FINE), 3.0 / FINE)
    else:
        fine = np.repeat(followed(wanted, 3.0), FINE)
    y = simulate(SHIP, Record(fine, fine, dt=1.0 / FINE))[::FINE, 0]
    pole = 0.96 * np.exp(0.7j)
    waves = lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], rng.standard_normal(2 * N))[N:]
    noise = 0.1 * y.std() * waves / waves.std() + 0.005 * rng.standard_normal(N)
    return Record(fine[::FINE], y + noise, dt=1.0, intersample=intersample)


MORE = [pytest.param(k, marks=pytest.mark.slow) for k in range(11, 17)]


@pytest.mark.parametrize("seed", [10, *MORE])
@pytest.mark.parametrize("measured", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_ramp_is_joined_or_held_as_the_likelihood_with_its_noise_says(seed, measured):
    estimate = identify(ship(seed, measured), Structure(2, 1))
    told = any(one.code == "intersample" and one.matters for one in estimate.findings)
    assert estimate.intersample == ("foh" if measured else "zoh") or told
    assert np.max(np.abs(estimate.theta - TRUTH) / estimate.std) < 5.0 or told


@pytest.mark.slow
def test_searches_are_asked_for_where_the_noise_speaks_for_the_present_behaviour():
    record = ship(10, True, "zoh")
    estimate = identify(record, Structure(2, 1))
    found = compared(estimate, [record])
    assert found is not None
    assert not found.staircase
    assert found.above["foh"] < 0.0
    assert in_doubt(found, estimate) == ["foh"]
    # white noise leaves no doubt that a search could take away: it was fitted to its end
    assert in_doubt(found, estimate.saying(noise_model=(np.zeros(0),))) == []


def test_what_moves_on_slopes_is_not_held_as_a_matter_of_course():
    y = np.zeros(60)
    rest = np.repeat([0.0, 1.0, -1.0, 0.5], 15)
    slopes = followed(rest, 0.4)
    both = np.column_stack([rest, slopes])
    asked = [Record(u, y, dt=1.0) for u in (rest, slopes, both)]
    assert [seems_held([one]) for one in asked] == [True, False, True]
    assert not seems_held([Record(np.sin(np.arange(60.0)), y, dt=1.0)])


def test_another_behaviour_is_a_note_beside_a_cause_that_explains_more():
    lines = Finding("intersample", "warning", "Lines are better.", "State them.", kind="alone")
    open_ = Finding("intersample", "warning", "The record does not tell.")
    low = Finding("order-low", "warning", "More poles.", effect="With it: the fit rises.")
    assert [one.severity for one in _beside_better([lines, open_], [low])] == ["note", "warning"]
    assert _beside_better([lines], [Finding("order-low", "note", "More poles.")]) == [lines]
    assert _beside_better([lines], []) == [lines]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_identify_and_validate_name_one_cause_first(seed):
    """A mode beyond the Nyquist frequency, folded: lines explain a part of it, more poles most."""
    rng = np.random.default_rng(seed)
    n, dt = 6000, 0.005
    u = np.repeat(rng.choice([-1.0, 1.0], n // 60), 60)
    u = u + 0.5 * np.repeat(rng.choice([-1.0, 1.0], n // 150), 150)
    fine = Record(u, u, dt=dt)
    y = simulate(TransferFunction([2.0, 8.0], [1.0, 1.6, 16.0]), fine)
    y = y + 0.15 * simulate(TransferFunction([8100.0], [1.0, 5.4, 8100.0]), fine)
    y = y[:, 0] + 0.02 * rng.standard_normal(n)
    record = Record(u[::10], y[::10], dt=0.05)
    estimate = identify(record, Structure(2, 1))
    both = estimate.findings, validate(estimate, record).findings
    first, again = (next(one.code for one in found if one.matters) for found in both)
    assert first == again
    notes = [one for one in estimate.findings if one.code == "intersample"]
    assert not any(one.matters for one in notes)


def test_nobody_is_told_to_leave_open_what_was_left_open():
    remedy = "State intersample='foh' (--intersample foh), or 'auto'."
    for intersample, wanted in (("auto", False), ("zoh", True)):
        rng = np.random.default_rng(0)
        u = np.repeat(rng.choice([-1.0, 1.0], 20), 6)
        y = simulate(TransferFunction([1.0], [1.0, 1.0]), Record(u, u, dt=0.1))
        record = Record(u, y + 0.05 * rng.standard_normal(y.shape), dt=0.1, intersample=intersample)
        estimate = identify(record, Structure(1, 0))
        assert ("auto" in for_left_open(remedy, estimate)) is wanted


@pytest.mark.slow
def test_a_selection_says_where_identify_takes_another_behaviour(monkeypatch):
    rng = np.random.default_rng(1)
    u = lfilter([1.0], [1.0, -0.9], rng.standard_normal(150))
    lines = np.interp(np.arange(1500) / 10, np.arange(150), u)
    middle = np.append((lines[1:] + lines[:-1]) / 2, lines[-1])
    y = simulate(TransferFunction([2.0], [1.0, 0.8]), Record(middle, middle, dt=0.01))[::10]
    record = Record(u, y + 0.02 * rng.standard_normal(y.shape), dt=0.1, intersample="auto")
    monkeypatch.setattr(settle, "_identified", lambda *_: "band-limited")
    found = select_structure(record, [Structure(1, 0)])
    assert "identify takes the input as band-limited" in found.notes[0]
    monkeypatch.undo()
    again = select_structure(record, [Structure(1, 0)])
    assert not any("identify takes" in note for note in again.notes)
