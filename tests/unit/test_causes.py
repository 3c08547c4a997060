"""What identify itself finds wrong with a record: the cause is named, and by what it brings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from tridentify import Record, Structure, TransferFunction, identify, simulate, validate
from tridentify.causes.saturation import levels

DT, N = 0.05, 800
PLANT = TransferFunction([9.0], [1.0, 1.5, 9.0])
ASKED = Structure(2, 0)


def held(seed, n=N):
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], n // 8), 8)


def response(u, plant=PLANT):
    return simulate(plant, Record(u, u, dt=DT))[:, 0]


def noise(seed, n=N, size=0.05):
    return size * np.random.default_rng(100 + seed).standard_normal(n)


def hardening(u):
    """The plant with a spring that hardens, by an integrator of its own, sample by sample."""
    state, found = np.zeros(2), []
    for value in u:
        found.append(state[0])

        def slope(_, x, value=value):
            return [x[1], 9.0 * value - 1.5 * x[1] - 9.0 * x[0] - 6.0 * x[0] ** 3]

        state = solve_ivp(slope, (0.0, DT), state, rtol=1e-8, atol=1e-10).y[:, -1]
    return np.array(found)


def late(seed):
    plant = TransferFunction([9.0], [1.0, 1.5, 9.0], delay=0.25)
    u = held(seed)
    return [Record(u, response(u, plant) + noise(seed), dt=DT)]


def cubic(seed):
    u = held(seed)
    return [Record(u, hardening(u) + noise(seed, size=0.01), dt=DT)]


def levels_at_random(seed, n=N):
    return np.repeat(np.random.default_rng(seed).standard_normal(n // 8), 8)


def clipped(seed):
    """A sensor that goes no further than 0.6 of the largest output, and noise after it."""
    u = levels_at_random(seed)
    y = response(u)
    limit = 0.6 * float(np.max(np.abs(y)))
    return [Record(u, np.clip(y, -limit, limit) + noise(seed), dt=DT)]


def clipped_above(seed):
    """The same on one side, in coloured noise."""
    u = levels_at_random(seed)
    y = response(u)
    limit = 0.5 * float(np.max(y))
    return [Record(u, np.minimum(y, limit) + coloured(seed), dt=DT)]


def coloured(seed, n=N, size=0.05):
    white = np.random.default_rng(200 + seed).standard_normal(n + 100)
    return size * 0.7 * lfilter([1.0], [1.0, -0.7], white)[100:]


def stopped(seed):
    """An actuator that goes no further than 0.8, commanded by more."""
    u = levels_at_random(seed)
    acted = np.clip(u, -0.8, 0.8)
    return [Record(u, response(acted) + noise(seed), dt=DT)]


def changed(seed):
    u = held(seed)
    other = response(u, TransferFunction([9.0], [1.0, 1.5, 12.0]))
    later = np.linspace(0.0, 1.0, N)
    y = (1.0 - later) * response(u) + later * other
    return [Record(u, y + noise(seed), dt=DT)]


def two_plants(seed):
    first, second = held(seed), held(seed + 50)
    other = TransferFunction([9.0], [1.0, 1.5, 12.0])
    return [
        Record(first, response(first) + noise(seed), dt=DT),
        Record(second, response(second, other) + noise(seed + 50), dt=DT),
    ]


def hung(seed):
    u = held(seed)
    y = response(u) + noise(seed)
    y[300:420] = y[299]
    return [Record(u, y, dt=DT)]


def one_pole_missing(seed):
    plant = TransferFunction([27.0], np.polymul([1.0, 1.5, 9.0], [1.0, 3.0]))
    u = held(seed)
    return [Record(u, response(u, plant) + noise(seed), dt=DT)]


CAUSES = {
    "delay": late,
    "nonlinear": cubic,
    "varying": changed,
    "disagreeing-experiments": two_plants,
    "stuck-sensor": hung,
}


@pytest.mark.parametrize("code", CAUSES)
def test_the_cause_is_named_first(code):
    estimate = identify(CAUSES[code](3), ASKED, throw=False)
    first = estimate.findings[0]
    assert first.code == code, [finding.text for finding in estimate.findings]
    assert first.matters
    assert first.remedy
    if code != "stuck-sensor":
        assert "With it: " in first.effect


def test_a_delay_is_told_with_its_size_and_what_it_brings():
    (record,) = late(4)
    first = identify(record, ASKED, throw=False).findings[0]
    assert "a delay of about 0.25 s" in first.message
    better = identify(record, Structure(2, 0, delay=0.25))
    assert abs(better.theta[1] - 9.0) < 5 * better.std[1]
    assert not better.cautions


def test_an_order_that_is_too_low_is_told_where_nothing_earlier_explains_it():
    codes = [f.code for f in identify(one_pole_missing(5), ASKED, throw=False).findings]
    # a fast pole is nearly a delay, which comes first and explains as much
    assert codes
    assert codes[0] in ("order-low", "delay")


LIMITS = {
    clipped: lambda y: 0.6 * np.max(np.abs(y)),
    clipped_above: lambda y: 0.5 * np.max(y),
    stopped: lambda _: 0.8,
}


@pytest.mark.parametrize("made", LIMITS)
@pytest.mark.parametrize("seed", [3, 4])
def test_a_limit_is_told_with_its_level_and_what_it_brings(made, seed):
    (record,) = made(seed)
    first = identify(record, ASKED, throw=False).findings[0]
    assert first.code == "saturation", first.text
    assert "With it: " in first.effect
    told = float(first.message.split(" explains it best")[0].split()[-1])
    limit = LIMITS[made](response(record.u[:, 0]))
    assert abs(told - limit) < 0.15 * limit


def test_a_hardening_spring_is_not_taken_for_coloured_noise():
    for seed in (3, 4, 5):
        (record,) = cubic(seed)
        estimate = identify(record, ASKED, throw=False)
        assert estimate.noise_model[0].size
        for found in (estimate.findings, validate(estimate, record).findings):
            assert next(f.code for f in found if f.matters) == "nonlinear"


def test_a_short_delay_in_much_noise_is_told():
    codes = []
    for seed in range(4):
        u = held(seed)
        plant = TransferFunction([9.0], [1.0, 1.5, 9.0], delay=2 * DT)
        y = response(u, plant) + noise(seed, size=0.3)
        found = identify(Record(u, y, dt=DT), ASKED, throw=False).findings
        codes += [f.code for f in found[:1] if f.matters]
    assert codes.count("delay") >= 3


def test_a_limit_on_one_side_leaves_the_other_open():
    rng = np.random.default_rng(0)
    y = rng.standard_normal(2000)
    low, high = levels(np.maximum(y, -0.7) + 0.05 * rng.standard_normal(2000), y)
    assert np.isinf(high)
    assert abs(low + 0.7) < 0.05
    assert np.isinf(levels(y + 0.3 * rng.standard_normal(2000), y)).all()


def test_right_records_are_left_alone():
    told = []
    for seed in range(12):
        u = held(seed)
        estimate = identify(Record(u, response(u) + noise(seed), dt=DT), ASKED)
        told += estimate.cautions
    assert not told


def test_right_records_with_other_inputs_and_noise_are_left_alone():
    told = []
    for drawn, made in ((held, coloured), (levels_at_random, noise), (levels_at_random, coloured)):
        for seed in range(12):
            u = drawn(seed)
            estimate = identify(Record(u, response(u) + made(seed), dt=DT), ASKED)
            told += estimate.cautions[:1]
    # 3 % of 36 records
    assert len(told) <= 1, told
