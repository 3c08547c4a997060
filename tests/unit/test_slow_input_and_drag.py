"""Inputs recorded slower than the outputs, and damping by the square of the speed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter

from oracles import by_modes
from tridentify import Record, Structure, identify
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.trace import Trace
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.estimation.posterior.maximum_or_mean import ELSEWHERE, left_behind
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.signals.coarse_input import converter_steps
from tridentify.judgement.causes.timing.moves import repeats
from tridentify.judgement.causes.timing.slow_input import slow_input_rivals

NUM, DEN, DT, FINE = np.array([2.0, 8.0]), np.array([1.0, 1.6, 16.0]), 0.05, 10
pytestmark = pytest.mark.judged
SEEDS = [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 5))]


def noisy(rng, y):
    return y + 0.02 * y.std() * rng.standard_normal(y.size)


def first_of(record, structure):
    return identify(record, structure, throw=False).findings[0]


def repeated(seed):
    """What acted, and a record of every fourth sample of it."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 70), 7)[3:483]
    y = noisy(rng, by_modes(NUM, DEN, u, DT))
    return u, Record(np.repeat(u[::4], 4), y, dt=DT)


def test_when_each_move_acted_is_read_off_the_output():
    u, record = repeated(1)
    rest, poles = Nuisances("free", offset=False, drift=False), np.roots(DEN)
    present = Present.of([record], Structure(2, 1), np.zeros((1, 1)), rest, (np.zeros(0),), poles)
    (rival,) = slow_input_rivals(present)
    left = rival.parts[0].records[0].u[:, 0] - u
    assert np.mean(left**2) < 0.1 * np.mean((record.u[:, 0] - u) ** 2)


def thrown(seed, apart, n=600):
    """A switch thrown at any time, or (``apart`` whole samples) with the recorder."""
    rng = np.random.default_rng(seed)
    moves = np.cumsum(rng.integers(12 * FINE // apart, 50 * FINE // apart, n)) * apart
    level = np.searchsorted(moves[moves < n * FINE], np.arange(n * FINE), side="right")
    u = rng.choice([-1.0, 1.0], n)[level]
    y = by_modes(NUM, DEN, u, DT / FINE)[::FINE]
    rng = np.random.default_rng(seed + 100)
    return Record(u[::FINE], noisy(rng, y), dt=DT, intersample="auto"), u, moves


@pytest.mark.parametrize(("apart", "named"), [(1, 1), (FINE, 0)])
def test_when_a_switch_was_thrown_between_the_samples_is_read_off_the_output(apart, named):
    record, u, _ = thrown(3, apart)
    record = record.between("foh")
    rest, poles = Nuisances("free", offset=False, drift=False), np.roots(DEN)
    present = Present.of([record], Structure(2, 1), np.zeros((1, 1)), rest, (np.zeros(0),), poles)
    found = list(slow_input_rivals(present))
    assert len(found) == named
    for rival in found:
        acted = u.reshape(-1, FINE).mean(axis=1)
        left = rival.parts[0].records[0].u[:, 0] - acted
        assert np.mean(left**2) < 0.2 * np.mean((record.u[:, 0] - acted) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 7))
def test_a_switch_that_is_thrown_between_the_samples_is_named_and_no_lost_rows(seed):
    found = [one for one in identify(thrown(seed, 1)[0], Structure(2, 1)).findings]
    assert not any(one.severity == "error" for one in found)
    between = [one for one in found if one.kind == "between"]
    assert [one for one in found if one.matters] == [one for one in between if one.matters]
    aligned = identify(thrown(seed, FINE)[0], Structure(2, 1)).findings
    assert not any(one.matters or one.kind == "between" for one in aligned)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 5))
def test_a_held_input_that_was_recorded_every_fourth_sample_is_named(seed):
    found = first_of(repeated(seed)[1], Structure(2, 1))
    assert found.code == "intersample"
    assert "u recorded at every 4th sample" in found.message
    assert "known to 0.2 s only" in found.message


def smooth(rng, n):
    u = lfilter(*butter(3, 0.8 * 2 * DT / FINE), rng.standard_normal(n * FINE))
    middle = np.append(0.5 * (u[1:] + u[:-1]), u[-1])
    return u[::FINE] / u.std(), by_modes(NUM, DEN, middle, DT / FINE)[::FINE]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 4))
def test_a_smooth_input_that_was_repeated_is_mended_as_is_advised(seed):
    rng = np.random.default_rng(seed)
    u, y = smooth(rng, 800)
    y = noisy(rng, y)
    found = first_of(Record(np.repeat(u[::5], 5), y, dt=DT, intersample="auto"), Structure(2, 1))
    assert found.code == "intersample"
    assert "u recorded at every 5th sample" in found.message
    t = DT * np.arange(800)
    joined = CubicSpline(t[::5], u[::5])(t)[:796]
    mended = identify(Record(joined, y[:796], dt=DT, intersample="foh"), Structure(2, 1))
    assert mended.fit[0] > 95.0
    assert not any(one.severity == "error" for one in mended.findings)


@pytest.mark.slow
@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize("seed", range(1, 4))
def test_a_command_that_was_set_every_fourth_sample_is_none(seed, late):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 120), 4)
    y = noisy(rng, by_modes(NUM, DEN, np.append(np.zeros(late), u)[: u.size], DT))
    found = identify(Record(u, y, dt=DT), Structure(2, 1), throw=False).findings
    assert [one.code for one in found if one.matters] == ["delay"] * late


def test_moves_at_whole_multiples_are_seen_and_steps_of_a_converter():
    assert repeats(3 + 6 * np.array([0, 1, 3, 4, *range(6, 20)])) == 6
    assert repeats(np.cumsum([4, 6, 4, 4, 5] * 4)) == 1
    u = np.round(3.0 * np.sin(0.05 * np.arange(300))) / 3.0
    levels = np.random.default_rng(0).choice([-1.0, 0.0, 1.0, 2.0], 60)
    records = [Record(np.column_stack([u, np.repeat(levels, 5)]), u, dt=1.0)]
    assert converter_steps(records) == pytest.approx([1.0 / 3.0, 0.0])


def moving(seed, against, stiffness=9.0, drive=8.0, n=300, fine=8):
    """A mass on a spring that a force moves, its position in noise."""
    rng = np.random.default_rng(seed)
    u = drive * np.repeat(rng.uniform(-1.0, 1.0, n // 20), 20)
    y, place, speed, h = np.zeros(n), 0.0, 0.0, DT / fine
    for k in range(n):
        y[k] = place
        for _ in range(fine):
            speed += h * (u[k] - stiffness * place - against(place, speed))
            place += h * speed
    return Record(u, noisy(rng, y), dt=DT)


def by_its_square(place, speed):
    return 0.4 * speed + abs(speed) * speed


def dry(place, speed):
    return speed + 1.5 * np.tanh(speed / 0.02)


def stiffening(place, speed):
    return 0.6 * speed + 3.0 * place**3


@pytest.mark.parametrize(
    ("against", "said", "kind", "remedy"),
    [
        (by_its_square, "damping that grows", "", "smaller"),
        (dry, "friction", "friction", "larger"),
        (stiffening, "a stiffness", "", "smaller"),
    ],
)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.slow
def test_damping_by_the_square_of_the_speed_is_told_from_friction(
    seed, against, said, kind, remedy
):
    found = first_of(moving(seed, against), Structure(2, 0))
    assert found.code == "nonlinear"
    assert (said in found.message, found.kind) == (True, kind)
    assert f"Use {remedy} amplitudes" in found.remedy


def driven(seed, n=400, fine=20):
    """A drive whose speed turns between the samples, its friction 20 to 30 % of what drives it."""
    rng = np.random.default_rng([6, seed])
    half, share = int(rng.integers(15, 40)), rng.uniform(0.2, 0.3)
    u = np.where(np.arange(n) // half % 2 == 0, 1.0, -1.0)
    y, speed, h = np.zeros(n), 0.0, 0.02 / fine / rng.uniform(0.2, 0.5)
    for k in range(n):
        y[k] = speed
        for _ in range(fine):
            pushed = speed + h * (u[k] - speed)
            speed = np.sign(pushed) * max(abs(pushed) - h * share, 0.0)
    return Record(u, noisy(rng, y), dt=0.02)


@pytest.mark.parametrize("seed", range(1, 9))
@pytest.mark.slow
def test_friction_of_a_drive_between_two_levels_is_no_further_pole(seed):
    found = first_of(driven(seed), Structure(1, 0))
    assert (found.code, found.kind) == ("nonlinear", "friction")


def test_what_was_told_of_an_end_goes_with_it():
    kept = "noise coloured"
    gone = (DecisionKind.SLOW_AS_NOISE.told(": fit 77 %"), DecisionKind.FAR_LIKELIER.told(" by 27"))
    told = Trace((), decisions=(kept, *gone))
    assert left_behind(told, 351.2).decisions == (kept, f"{ELSEWHERE} (-2 log L lower by 351)")
