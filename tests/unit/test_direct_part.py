"""A direct part: a battery under pulses, measured, and what is said of its record."""

import numpy as np
import pytest

from tridentify import (
    Record,
    Structure,
    TransferFunction,
    advise,
    identify,
    select_structure,
    simulate,
    validate,
)
from tridentify.judgement.causes.attempts.direct_part import follows_at_once, has_direct_part
from tridentify.judgement.selection.orders import default_candidates

RESISTANCE, CELL, TAU = 0.022, 0.015, 12.0


def pulses(rng: np.random.Generator, n: int = 300) -> np.ndarray:
    return np.repeat(rng.choice([-2.0, 0.0, 1.0, 3.0], n // 15), 15)


def battery(seed: int, *, resistance: float = RESISTANCE) -> Record:
    """Voltage under current pulses; the current is held and measured with noise."""
    rng = np.random.default_rng(seed)
    current = pulses(rng)
    model = TransferFunction([-resistance, -(resistance + CELL) / TAU], [1.0, 1.0 / TAU])
    voltage = simulate(model, Record(current, current, dt=1.0, intersample="zoh"))[:, 0]
    y = 3.7 + voltage + 0.0008 * rng.standard_normal(current.size)
    measured = current + 0.003 * rng.standard_normal(current.size)
    return Record(measured, y, dt=1.0, intersample="auto")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_jumps_of_input_and_output_together_are_no_lost_rows(seed: int) -> None:
    record = battery(seed)
    assert record.behaviour == "zoh"
    told = {finding.code for finding in advise(record).findings}
    assert not told & {"lost-rows", "bad-samples", "feedback"}


@pytest.mark.slow
@pytest.mark.unjudged
def test_as_many_zeros_as_poles_are_tried_unasked() -> None:
    record = battery(1)
    assert has_direct_part([record])
    asked = {(one.poles, one.zeros) for one in default_candidates([record])}
    assert (1, 1) in asked
    found = select_structure(record, default_candidates([record], max_poles=1)).recommended
    assert found is not None
    assert found.label == "1, 1"
    assert found.estimate is not None
    value = found.estimate.parameters["b1"]
    assert abs(value.value + RESISTANCE) < 4.0 * value.std


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.fast("1")
def test_a_slope_after_a_jump_is_no_direct_part(seed: int) -> None:
    without = battery(seed, resistance=0.0)
    assert not has_direct_part([without])
    asked = {(one.poles, one.zeros) for one in default_candidates([without])}
    assert (1, 1) not in asked


def test_jumps_that_do_not_agree_are_no_direct_part() -> None:
    rng = np.random.default_rng(0)
    u, y = pulses(rng), pulses(rng)
    assert not follows_at_once(u, y)
    assert not follows_at_once(u[:5], u[:5])
    assert follows_at_once(u, -0.3 * u + 0.001 * rng.standard_normal(u.size))


@pytest.mark.slow
def test_an_output_that_follows_at_once_is_not_called_feedback() -> None:
    rng = np.random.default_rng(4)
    force = rng.standard_normal(800)
    shaker = TransferFunction([1.0, 0.0, 0.0], [1.0, 1.2, 400.0])
    y = simulate(shaker, Record(force, force, dt=0.02))[:, 0] + 0.05 * rng.standard_normal(800)
    record = Record(force, y, dt=0.02)
    found = validate(identify(record, Structure(2, 0), throw=False), record).findings
    assert "feedback" not in [one.code for one in found]
    (told,) = [one for one in found if one.code == "order-low"]
    assert "2 poles and 2 zeros" in told.message
    right = validate(identify(record, Structure(2, 2)), record).findings
    assert "feedback" not in [one.code for one in right]


SPRING = [1.0, 0.4, 9.0]


def shaken(
    seed: int, den: list[float], num: list[float], *, intersample: str = "zoh", n: int = 400
) -> Record:
    """What moves at every sample: held, or a smooth force that is joined by lines."""
    rng = np.random.default_rng([707, seed])
    u = rng.standard_normal(n)
    if intersample == "foh":
        u = np.convolve(u, np.hanning(9), mode="same")
    force = Record(u, u, dt=0.05, intersample=intersample)
    y = simulate(TransferFunction(num, den), force)[:, 0]
    noise = 0.1 * np.std(y) * rng.standard_normal(n)
    return Record(u, y + noise + 0.3, dt=0.05, intersample="auto")


def in_loop(seed: int, n: int = 400) -> Record:
    """A sampled controller moves the input at once by what the noise at the sensor is worth."""
    rng = np.random.default_rng([708, seed])
    goal = np.repeat(rng.uniform(-1.0, 1.0, n // 20), 20)
    noise = 0.02 * rng.standard_normal(n)
    level, u, y = 0.0, np.zeros(n), np.zeros(n)
    for k in range(n):
        y[k] = level + noise[k]
        u[k] = 2.0 * (goal[k] - y[k])
        level += 0.05 * (2.0 * u[k] - level)
    return Record(u, y, dt=0.05, intersample="auto")


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.fast("0", "1")
def test_an_accelerometer_has_a_direct_part(seed: int) -> None:
    assert has_direct_part([shaken(seed, SPRING, [1.0, 0.0, 0.0])])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.fast("zoh-0", "foh-0")
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_its_displacement_has_none(seed: int, intersample: str) -> None:
    """Joined by lines a force is answered at once as well, by half of what comes next."""
    assert not has_direct_part([shaken(seed, SPRING, [1.0], intersample=intersample)])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.fast("0", "1")
def test_a_controller_makes_none(seed: int) -> None:
    assert not has_direct_part([in_loop(seed)])


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.slow
def test_the_order_of_an_accelerometer_is_found(seed: int) -> None:
    found = select_structure(shaken(seed, SPRING, [1.0, 0.0, 0.0])).recommended
    assert found is not None
    assert found.label == "2, 2"


def two_modes(seed: int) -> Record:
    """An accelerometer on two modes."""
    den = np.polymul(SPRING, [1.0, 0.5, 50.0])
    num = np.polymul([1.0, 0.0, 0.0], np.polyadd([0.5, 0.2, 4.5], [1.0, 0.5, 50.0]))
    return shaken(seed, list(den), list(num))


@pytest.mark.slow
def test_too_few_poles_and_no_direct_part_are_no_feedback() -> None:
    record = two_modes(0)
    estimate = identify(record, Structure(2, 0), throw=False)
    findings = validate(estimate, record).findings
    assert "feedback" not in {finding.code for finding in findings}
    low = next(finding for finding in findings if finding.code == "order-low")
    assert "2 poles and 2 zeros" in low.message or "4 poles and 4 zeros" in low.message


def smooth(seed: int, numerator: list[float], n: int = 400) -> Record:
    """A smooth multisine on a spring of some stiffness, 10 dB above the noise."""
    rng = np.random.default_rng([709, seed])
    stiff = rng.uniform(9.0, 30.0)
    t, tones = 0.05 * np.arange(n), 0.15 * np.arange(1, 25)
    phases = 2 * np.pi * rng.random(tones.size)
    u = np.cos(2 * np.pi * np.outer(t, tones) + phases).sum(axis=1)
    force = Record(u, u, dt=0.05, intersample="foh")
    y = simulate(TransferFunction(numerator, [1.0, 1.0, stiff]), force)[:, 0]
    noise = 10 ** (-10.0 / 20.0) * np.std(y) * rng.standard_normal(n)
    return Record(u, y + noise, dt=0.05, intersample="auto")


@pytest.mark.slow
def test_a_smooth_input_tells_a_direct_part_as_a_whole() -> None:
    assert has_direct_part([smooth(0, [1.0, 0.0, 0.0])])
    assert not has_direct_part([smooth(0, [9.0])])
    assert not has_direct_part([smooth(0, [3.0, 0.0])])


@pytest.mark.slow
def test_a_smooth_input_nearly_always_tells_a_direct_part() -> None:
    seeds = range(10)
    assert sum(has_direct_part([smooth(seed, [1.0, 0.0, 0.0])]) for seed in seeds) >= 8
    proper = [[9.0], [3.0, 0.0]]
    assert not any(has_direct_part([smooth(seed, num)]) for seed in seeds for num in proper)


def swept(seed: int, numerator: list[float] | None = None, n: int = 1000) -> Record:
    """An accelerometer on two close modes under a sweep whose force is measured."""
    rng = np.random.default_rng([710, seed])
    t = np.arange(n) / 512
    u = np.sin(2 * np.pi * (5 * t + 85 * t * t / (2 * t[-1])))
    force = Record(u, u, dt=1 / 512, intersample="foh")
    y = np.zeros(n)
    for hertz in rng.uniform(25.0, 60.0) * np.array([1.0, 1.1]):
        w = 2 * np.pi * hertz
        mode = TransferFunction(numerator or [1.0, 0.0, 0.0], [1.0, 0.03 * w, w * w])
        y += simulate(mode, force)[:, 0]
    y += 0.02 * np.std(y) * rng.standard_normal(n)
    return Record(u + 0.002 * rng.standard_normal(n), y, dt=1 / 512, intersample="auto")


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.slow
def test_a_force_that_is_measured_under_a_sweep_tells_a_direct_part(count: int) -> None:
    """Where operators miss too much of two resonances, only the candidates themselves tell."""
    assert sum(has_direct_part([swept(seed)]) for seed in range(count)) >= 0.75 * count
    assert not any(has_direct_part([swept(seed, [4e4])]) for seed in range(count))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4, 7))
def test_two_close_modes_of_an_accelerometer_under_a_sweep_are_found(seed: int) -> None:
    found = select_structure(swept(seed, n=500)).recommended
    assert found is not None
    assert (found.structure.poles, found.structure.zeros) == (4, 4)
    assert found.estimate is not None
    assert found.estimate.fit[0] > 95.0


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.fast("0")
def test_steps_with_slopes_as_an_actuator_makes_them_are_no_direct_part(seed: int) -> None:
    rng = np.random.default_rng([77, seed])
    steps = np.repeat(rng.choice([-1.0, 0.0, 1.0], 20), 20)
    u = np.convolve(steps, np.ones(4) / 4.0, mode="same")
    flown = Record(u, u, dt=0.05, intersample="foh")
    y = simulate(TransferFunction([4.0, 4.0], [1.0, 1.5, 4.0]), flown)[:, 0]
    y = y + 0.005 * np.std(y) * rng.standard_normal(u.size)
    assert not has_direct_part([Record(u, y, dt=0.05, intersample="auto")])
