"""Whether a record from inside a loop tells the plant: exact laws of the controller, with lags."""

from __future__ import annotations

from functools import cache

import loops
import numpy as np
import pytest

from tridentify import Record, TransferFunction, identify, simulate
from tridentify.estimation.answer.trust import unusable
from tridentify.judgement.causes.attempts.told_apart import laws, told_apart
from tridentify.report.first_screen import headline_of, trust_of


@cache
def silent(controller: str, delay: int, seed: int = 0, order: int = 2, **options: int):
    """A loop whose set point is constant, sampled with the record."""
    return loops.draw(
        seed,
        excitation="none",
        n=400,
        of=lambda law, kind: (kind, law.delay, law.sampled) == (controller, delay, True),
        keep=lambda d: d.poles.size == order,
        **options,
    )


@pytest.mark.parametrize(
    ("controller", "delay", "lags"), [("P", 0, 0), ("P", 1, 1), ("lead", 0, 1), ("lead", 1, 2)]
)
@pytest.mark.fast("P-1-1", "lead-1-2")
def test_the_memory_of_a_controller_is_counted(controller, delay, lags):
    (law,) = laws([silent(controller, delay).record])
    assert law.lags == lags
    assert law.share < 1e-9


def test_one_triangle_of_long_records_gives_what_dense_regressions_give():
    rng = np.random.default_rng(3)
    y = rng.standard_normal(9000)
    u = 2.0 - 0.7 * y + 0.4 * np.r_[0.0, y[:-1]] + 0.01 * rng.standard_normal(9000)
    (law,) = laws([Record(u, y, dt=0.1)], most=2)
    now, own = u[2:], [np.ones(8998)] + [u[2 - k : 9000 - k] for k in (1, 2)]
    beside = [np.ones(8998), *(y[2 - k : 9000 - k] for k in (0, 1)), u[1:-1]]
    alone, left = (
        float(np.linalg.lstsq(np.column_stack(known), now, rcond=None)[1][0])
        for known in (own, beside)
    )
    freedom = 8998 - 4
    assert law.lags == 1
    assert law.share == pytest.approx(left / alone, rel=1e-9)
    assert law.outside == pytest.approx(left / (alone - left) * freedom, rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.fast("0")
def test_the_inverse_of_what_answers_at_once_is_no_law_of_a_controller(seed):
    rng = np.random.default_rng(seed)
    force = rng.standard_normal(800)
    shaker = TransferFunction([1.0, 0.0, 0.0], [1.0, 1.2, 400.0])
    quiet = simulate(shaker, Record(force, force, dt=0.02))[:, 0]
    noisy = quiet + 0.05 * rng.standard_normal(800)
    assert laws([Record(force, noisy, dt=0.02)])[0].lags is None


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.fast("0")
def test_a_rounded_controller_without_memory_has_its_law(seed):
    y = np.random.default_rng(seed).standard_normal(800)
    step = 8.0 / 256.0
    assert laws([Record(step * np.round(-2.0 * y / step), y, dt=0.1)])[0].lags == 0


def test_a_gap_longer_than_a_block_is_passed_over():
    rng = np.random.default_rng(3)
    y = rng.standard_normal(12000)
    u = 1.0 - 0.7 * y
    y[1000:10000] = np.nan
    (law,) = laws([Record(u, y, dt=0.1)])
    assert law.lags == 0


def test_no_two_samples_in_a_row_tell_no_law_with_memory():
    record = silent("P", 1).record
    y = np.array(record.y)
    y[::2] = np.nan
    (law,) = laws([Record(record.u, y, dt=record.dt)])
    assert law.lags is None


@pytest.mark.slow
def test_a_plant_of_more_poles_than_the_controller_remembers_is_not_told():
    drawn = silent("P", 0)
    estimate = identify(drawn.record, drawn.structure, throw=False)
    (finding,) = [f for f in estimate.findings if f.code == "loop-not-excited"]
    assert finding.severity == "error"
    assert "cannot tell a plant of 2 poles" in finding.message
    assert unusable(estimate, estimate.findings).startswith("Not usable")
    headline, trust = (one(estimate, estimate.findings) for one in (headline_of, trust_of))
    said = headline.removeprefix("Not usable: ").rstrip(".")
    assert said not in trust


@pytest.mark.slow
def test_a_controller_with_memory_enough_is_a_warning():
    drawn = silent("lead", 1)
    estimate = identify(drawn.record, drawn.structure, throw=False)
    (finding,) = [f for f in estimate.findings if f.code == "loop-not-excited"]
    assert finding.severity == "warning"
    assert told_apart(laws([drawn.record])[0], 2)


@pytest.mark.parametrize("excitation", ["steps", "prbs", "dither"])
@pytest.mark.parametrize("seed", range(4))
def test_what_is_moved_from_outside_is_no_such_record(excitation, seed):
    drawn = loops.draw(seed, excitation=excitation, n=300)
    assert laws([drawn.record])[0].lags is None


def test_commanded_inputs_have_no_law():
    rng = np.random.default_rng(1)
    t = np.arange(300) * 0.1
    for u in (np.sin(t), np.repeat(rng.standard_normal(30), 10), rng.standard_normal(300)):
        y = np.convolve(u, np.exp(-t))[:300] * 0.1
        # an output without noise, whose past tells nothing of the input
        assert laws([Record(u, np.append(0.0, y[:-1]), dt=0.1)])[0].lags is None


def test_a_resistance_shows_its_current_and_is_no_controller():
    """As many zeros as poles: the output follows the input at once, and tells it nearly whole."""
    rng = np.random.default_rng(0)
    current = np.repeat(rng.choice([-2.0, 0.0, 2.0, 4.0], 20), 20)
    cell = TransferFunction([0.05, 0.004], [1.0, 0.04])
    volts = simulate(cell, Record(current, current, dt=2.0))[:, 0]
    volts = volts + 0.0005 * rng.standard_normal(current.size)
    record = Record(current, volts, dt=2.0, intersample="zoh")
    assert laws([record])[0].lags is not None
    assert "loop-not-excited" not in [one.code for one in identify(record, (1, 1)).findings]


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_where_nothing_tells_the_plant_no_other_cause_has_a_remedy(seed):
    record = silent("P", 0, seed).record
    told = [one.code for one in identify(record, (2, 0), throw=False).findings]
    assert "loop-not-excited" in told
    assert not {"order-low", "order-high", "intersample", "delay", "drift"} & set(told)


def test_laws_that_are_kept_are_those_of_the_same_records_and_lags():
    rng = np.random.default_rng(5)
    y = rng.standard_normal(200)
    held, free = Record(1.0 - 2.0 * y, y, dt=0.1), Record(rng.standard_normal(200), y, dt=0.1)
    first = laws([held])
    assert laws([held]) is first
    assert first[0].lags == 0
    # a record made of it, and others beside it, have laws of their own
    assert laws([held.mask(np.arange(200) < 50)])[0].lags == 0
    assert laws([held, free])[0].lags is None
    assert laws([held, held])[0].lags == 0
    assert laws([held], 2) is not first
    assert laws([held]) == first
