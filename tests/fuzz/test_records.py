"""Random records and streams, most of them hopeless: refused in one line, or it holds."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from tridentify import (
    METHODS,
    OutputError,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    advise,
    frequency_response,
    identify,
    online,
    simulate,
    validate,
)

EXPONENTS = (-323, -300, -99, -41, -39, -38, -30, -9, 0, 0, 0, 9, 30, 38, 39, 41, 150, 308)
LENGTHS = (0, 1, 2, 3, 5, 8, 13, 30, 60)
STRUCTURES = (
    Structure(1, 0, offset=False, initial_state="rest"),
    Structure(1, 1, initial_state="equilibrium"),
    Structure(2, 0, offset=True, drift=True, initial_state="free"),
    Structure(1, 0, offset=False, initial_state="rest", delay=0.1),
)
QUICK = {key: METHODS[key] for key in METHODS if key not in ("three-model", "output-error")}
QUICK["paper"] = lambda: ThreeModel.paper(1.7)
THOROUGH = {"output-error": OutputError, "three-model": ThreeModel}


def size(rng: np.random.Generator) -> float:
    return float(10.0 ** rng.choice(EXPONENTS)) * rng.choice([1.0, 1.0, 1.7])


def signal(rng: np.random.Generator, n: int) -> np.ndarray:
    """Noise, levels, a constant, one spike, every magnitude; scaled or shifted out of reason."""
    kind = rng.integers(8)
    if kind == 0:
        x = np.full(n, rng.standard_normal())
    elif kind == 1:
        x = np.eye(max(n, 1))[rng.integers(max(n, 1))][:n]
    elif kind == 2:
        x = 10.0 ** rng.uniform(-320, 300, n)
    elif kind == 3:
        x = np.exp(np.minimum(np.arange(n) * rng.uniform(0.0, 9.0), 600.0))
    elif kind == 4:
        x = np.cumsum(rng.standard_cauchy(n))
    else:
        x = np.repeat(rng.choice([-1.0, 1.0], n // 4 + 1), 4)[:n]
    with np.errstate(over="ignore"):
        if rng.random() < 0.4:
            x = x * size(rng)
        if rng.random() < 0.2:
            x = x + size(rng)
        if n and rng.random() < 0.2:
            x[rng.integers(n)] = rng.choice([size(rng), -size(rng), math.inf, math.nan])
    return x


def response(rng: np.random.Generator, u: np.ndarray) -> np.ndarray:
    """What a lag makes of the input, with noise, in any unit; or anything."""
    if rng.random() < 0.3 or not np.isfinite(u).all() or np.abs(u).max(initial=0.0) > 1e200:
        return signal(rng, len(u))
    y, decay = np.zeros(len(u)), rng.uniform(0.1, 0.99)
    for k in range(len(u) - 1):
        y[k + 1] = decay * y[k] + (1.0 - decay) * u[k]
    y += rng.choice([0.0, 0.05]) * np.abs(y).max(initial=0.0) * rng.standard_normal(len(u))
    with np.errstate(over="ignore", invalid="ignore"):
        y = y * (size(rng) if rng.random() < 0.3 else 1.0)
    return np.where(rng.random(len(u)) < rng.choice([0.0, 0.0, 0.2, 1.0]), np.nan, y)


def instants(rng: np.random.Generator, n: int) -> dict[str, object]:
    kind = rng.integers(6)
    if kind < 3:
        return {"dt": 0.1 if rng.random() < 0.5 else size(rng) * rng.choice([1.0, 1.0, 1.0, -1.0])}
    steps = rng.uniform(0.05, 0.15, n)
    if kind == 3:
        steps = 10.0 ** rng.uniform(-rng.choice([1, 10, 200]), rng.choice([1, 10, 200]), n)
    with np.errstate(over="ignore", invalid="ignore"):
        t = np.cumsum(steps) * (1.0 if rng.random() < 0.5 else size(rng))
        return {"t": t + (size(rng) if rng.random() < 0.3 else 0.0)}


def record(rng: np.random.Generator) -> Record:
    n = int(rng.choice(LENGTHS))
    inputs, outputs = (2 if rng.random() < 0.15 else 1 for _ in range(2))
    u = np.column_stack([signal(rng, n) for _ in range(inputs)])
    y = np.column_stack([response(rng, u[:, 0]) for _ in range(outputs)])
    return Record(u, y, intersample=rng.choice(["zoh", "foh"]), **instants(rng, n))


def use(attempt, what: str, records: list[Record], structure: Structure, method: object) -> bool:
    """Identify, simulate, judge: whether there is an estimate, which then holds."""
    estimate = attempt(what, lambda: identify(records, structure, method, throw=False))
    if estimate is None:
        return False
    assert np.isfinite(estimate.theta).all(), f"{what}: {estimate.theta}"
    response_ = attempt(f"{what}, simulate", lambda: simulate(estimate.model, records[0]))
    assert response_ is None or np.isfinite(response_).all(), what
    attempt(f"{what}, residual", lambda: estimate.residual(records[0]))
    attempt(f"{what}, summary", estimate.summary)
    attempt(f"{what}, validate", lambda: validate(estimate, records))
    again = TransferFunction.from_dict(estimate.model.to_dict())
    for one, other in zip(again.den[0], estimate.model.den[0], strict=True):
        assert np.array_equal(one, other), what
    return True


def explore(
    seeds, attempt, count: int, methods: dict[str, Callable[[], object]]
) -> tuple[int, int]:
    estimates = refusals = 0
    keys = list(methods)
    for seed, rng in seeds.take(count):
        made = attempt(f"seed {seed}, record", lambda rng=rng: record(rng))
        if made is None:
            refusals += 1
            continue
        records = [made, made] if rng.random() < 0.1 else [made]
        structure = STRUCTURES[rng.integers(len(STRUCTURES))]
        key = keys[rng.integers(len(keys))]
        if use(attempt, f"seed {seed}, {key}", records, structure, methods[key]()):
            estimates += 1
        else:
            refusals += 1
    return estimates, refusals


@pytest.mark.slow
def test_any_record_is_identified_or_refused_by_the_quick_methods(seeds, attempt):
    estimates, refusals = explore(seeds, attempt, 80, QUICK)
    assert estimates
    assert refusals


FOUND = (35789150496, 593278933946, 765466188751, 43616708294)
"""Seeds that once failed with the quick methods."""


@pytest.mark.slow
def test_what_once_failed_with_the_quick_methods_is_identified_or_refused(attempt):
    known = SimpleNamespace(take=lambda _: [(k, np.random.default_rng(k)) for k in FOUND])
    assert sum(explore(known, attempt, len(FOUND), QUICK)) == len(FOUND)


def test_any_record_is_identified_or_refused_by_the_thorough_methods(seeds, attempt):
    estimates, refusals = explore(seeds, attempt, 25, THOROUGH)
    assert estimates
    assert refusals


@pytest.mark.slow
def test_any_record_is_surveyed_or_refused(seeds, attempt):
    ended = []
    for seed, rng in seeds.take(300):
        made = attempt(f"seed {seed}, record", lambda rng=rng: record(rng))
        if made is None:
            continue
        for survey in (frequency_response, advise):
            what = f"seed {seed}, {survey.__name__}"
            found = attempt(what, lambda made=made, survey=survey: survey(made))
            ended.append(found is not None)
            attempt(f"{what}, in words", lambda found=found: repr(found) + str(found))
    assert any(ended)
    assert not all(ended)


SCALES = (1e-30, 1e-9, 1e9, 1e30)


@pytest.mark.parametrize("key", ["output-error", "svf-instrumental-variable", "three-model"])
def test_a_record_in_any_unit_gives_the_scaled_answer(seeds, key):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 20), 4)
    plant = TransferFunction([3.0], [1.0, 1.5, 3.0])
    y = simulate(plant, Record(u, u, dt=0.1))[:, 0] + 0.01 * rng.standard_normal(u.size)
    structure = Structure(2, 0, offset=False, initial_state="rest")
    plain = identify(Record(u, y, dt=0.1), structure, METHODS[key](), throw=False)
    for seed, draw in seeds.take(3):
        in_, out, time = draw.choice(SCALES, 3)
        scaled = Record(u * in_, y * out, dt=0.1 * time)
        found = identify(scaled, structure, METHODS[key](), throw=False)
        factor = np.array([1.0 / time, time**-2.0, time**-2.0 * out / in_])
        assert found.theta / factor == pytest.approx(plain.theta, rel=1e-6), f"seed {seed}"
        assert found.std / factor == pytest.approx(plain.std, rel=1e-4), f"seed {seed}"
        assert found.status is plain.status, f"seed {seed}"


# ------------------------------------------------------------------------------------- on-line
STREAMED = (
    Structure(1, 0),
    Structure(1, 0, initial_state="free"),
    Structure(1, 0, delay=0.13),
)


def lag(rate: float) -> TransferFunction:
    return TransferFunction([rate], [1.0, rate])


ESTIMATORS = {
    "least squares": lambda rate: online.RecursiveLeastSquares(filter=(1.0, rate), forgetting=0.99),
    "resetting": lambda rate: online.RecursiveLeastSquares(start=lag(rate), forget="resetting"),
    "kalman": lambda rate: online.Kalman(filter=(1.0, rate)),
    "gradient": lambda rate: online.Gradient(gamma=rate),
    "gradient from a model": lambda rate: online.Gradient(start=lag(rate), rate=0.5),
    "three models": lambda rate: online.ThreeModel(start=lag(rate), forgetting=0.99),
}


def after_each(rng: np.random.Generator, dt: float, n: int) -> np.ndarray | None:
    if rng.random() < 0.6:
        return None
    reach = rng.choice([0.1, 1.0, 200.0])
    with np.errstate(over="ignore", under="ignore"):
        return dt * 10.0 ** rng.uniform(-reach, reach, n)


def follow(seeds, attempt, count: int) -> tuple[int, int]:
    """How many streams ended in a state, and how many in a refusal."""
    followed = refused = 0
    keys = list(ESTIMATORS)
    for seed, rng in seeds.take(count):
        n, key = int(rng.choice([1, 2, 5, 30, 100])), keys[rng.integers(len(keys))]
        u = signal(rng, n)[:, None]
        y = response(rng, u[:, 0])[:, None]
        dt = 0.1 if rng.random() < 0.6 else float(size(rng))
        rate = 2.0 if rng.random() < 0.7 else float(size(rng))
        after, what = after_each(rng, dt, n), f"seed {seed}, {key}"
        structure = STREAMED[rng.integers(len(STREAMED))]

        def fed(key=key, rate=rate, structure=structure, dt=dt, u=u, y=y, after=after):
            method = ESTIMATORS[key](rate)
            return method.feed(method.init(structure, dt), u, y, after)[0]

        state = attempt(what, fed)
        if state is None:
            refused += 1
            continue
        followed += 1
        attempt(f"{what}, words", lambda s=state: f"{s.flags} {s.seen} {s.innovations}")
        estimate = attempt(f"{what}, estimate", lambda s=state: s.method.estimate(s))
        if estimate is not None:
            assert np.isfinite(estimate.theta).all(), what
            attempt(f"{what}, summary", estimate.summary)
        again = attempt(f"{what}, kept", lambda s=state: online.State.from_dict(s.to_dict()))
        assert np.array_equal(again.values, state.values, equal_nan=True), what
    return followed, refused


def test_any_stream_is_followed_or_refused(seeds, attempt):
    followed, refused = follow(seeds, attempt, 60)
    assert followed
    assert refused


FOUND_ON_LINE = (159, 513, 608, 763, 1428, 1798, 2310, 2682, 3035, 24506, 960329611899)
"""Seeds that once failed."""


def test_what_once_failed_on_line_is_followed_or_refused(attempt):
    known = SimpleNamespace(take=lambda _: [(k, np.random.default_rng(k)) for k in FOUND_ON_LINE])
    assert sum(follow(known, attempt, len(FOUND_ON_LINE))) == len(FOUND_ON_LINE)
