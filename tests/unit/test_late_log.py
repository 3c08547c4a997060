"""Inputs that are logged at the end of the interval in which they acted: a mean, or held."""

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate, validate
from tridentify.estimation.answer.finding import Finding, joined

PLANT = TransferFunction([2.0, 9.0], [1.0, 2.0, 9.0])
ORDER = Structure(2, 1)
TRUE = np.array([2.0, 9.0, 2.0, 9.0])
STEP, FINE = 0.05, 10


def logged(seed: int, how: str, n: int = 500, size: float = 0.05) -> Record:
    """A sum of sines, or of levels, that acts between the samples too."""
    rng = np.random.default_rng(seed)
    if how == "held":
        u = np.repeat(rng.choice([-1.0, 1.0], n // 6 + 1), 6 * FINE)[: n * FINE]
    else:
        time = np.arange(n * FINE) * STEP / FINE
        rates = rng.uniform(0.5, 12.0, 8)
        u = np.sin(rates * time[:, None] + rng.uniform(0.0, 6.3, 8)).sum(axis=1)
    y = simulate(PLANT, Record(u, u, dt=STEP / FINE))[::FINE, 0]
    y = y + size * np.std(y) * rng.standard_normal(n)
    means = u.reshape(n, FINE).mean(axis=1)
    if how != "the next":
        means = np.concatenate([u[:1], means[:-1]])
    return Record(means, y, dt=STEP)


def first_of(record: Record) -> Finding | None:
    estimate = identify(record, ORDER)
    found = joined(estimate.findings, validate(estimate, record).findings)
    return next((one for one in found if one.matters), None)


def is_named(record: Record) -> bool:
    first = first_of(record)
    return first is not None and first.code == "intersample" and first.kind == "late-log"


@pytest.mark.judged
def test_a_mean_that_is_logged_at_its_end_is_named_and_the_advice_puts_it_right() -> None:
    record = logged(1, "mean", n=300)
    before = identify(record, ORDER, throw=False)
    first = next(one for one in before.findings if one.matters)
    assert (first.code, first.kind, first.severity) == ("intersample", "late-log", "error")
    assert "logged at the end of the interval" in first.message
    assert "Record(u[1:], y[:-1]" in first.remedy
    assert "fit of y from" in first.effect
    after = identify(Record(record.u[1:], record.y[:-1], dt=STEP), ORDER)
    off = np.abs(after.theta - TRUE)
    assert np.all(off < 4.0 * after.std)
    assert np.any(np.abs(before.theta - TRUE) > 4.0 * before.std)


@pytest.mark.slow
@pytest.mark.judged
@pytest.mark.parametrize("how", ["mean", "held"])
@pytest.mark.parametrize("behaviour", ["zoh", "foh", "auto"])
def test_it_is_named_whatever_the_input_is_taken_for(how: str, behaviour: str) -> None:
    records = [logged(seed, how) for seed in range(30, 36)]
    named = [is_named(Record(one.u, one.y, dt=STEP, intersample=behaviour)) for one in records]
    assert sum(named) >= 5


@pytest.mark.slow
@pytest.mark.judged
def test_a_mean_of_the_interval_that_follows_is_held() -> None:
    assert not any(first_of(logged(seed, "the next")) for seed in range(40, 46))
