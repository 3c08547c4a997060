"""Every value that an estimate reports lies within its own interval, whatever record it is of."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    Record,
    Status,
    Structure,
    ThreeModel,
    TransferFunction,
    TridentifyError,
    identify,
    simulate,
)
from tridentify.cli.tables import estimate_document
from tridentify.estimation.answer.estimate import Estimate
from tridentify.uncertainty import sample, sampled_response_band, sampled_step_band

pytestmark = pytest.mark.unjudged

NUMBER = r"[-+]?(?:\d[\d,]*\.?\d*(?:e[-+]?\d+)?|inf)"
ROW = re.compile(
    rf"^(?P<name>\S.*?)\s{{2,}}(?P<value>{NUMBER})\s+{NUMBER}\s+(?P<low>{NUMBER})\s+"
    rf"(?P<high>{NUMBER})(?:\s|$)"
)


def drawn(seed: int) -> tuple[Record, Structure]:
    """A short record of a random system, and orders that suit it or are too many."""
    rng = np.random.default_rng(seed)
    order, n = int(rng.integers(1, 5)), int(10.0 ** rng.uniform(1.7, 3.0))
    poles: list[complex] = []
    while len(poles) < order:
        w = 10.0 ** rng.uniform(-0.3, 1.0)
        if len(poles) + 2 <= order and rng.random() < 0.6:
            z = rng.uniform(0.05, 0.95)
            poles += [w * complex(-z, math.sqrt(1 - z * z)), w * complex(-z, -math.sqrt(1 - z * z))]
        else:
            poles.append(complex(-w))
    den = np.real(np.poly(poles))
    fastest = max(abs(p) for p in poles)
    dt = 2.0 * math.pi / fastest / rng.uniform(8.0, 40.0)
    zeros = int(rng.integers(0, order))
    num = den[-1] * rng.choice([-1.0, 1.0]) * np.append(rng.uniform(0.05, 0.3, zeros), 1.0)
    hold = int(rng.integers(1, max(n // 8, 2)))
    kind = rng.integers(3)
    u = np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]
    if kind == 1:
        u = rng.standard_normal(n)
    elif kind == 2:
        u = np.where((np.arange(n) > n // 6) & (np.arange(n) < n // 2), 1.0, 0.0)
    clean = simulate(TransferFunction(num, den), Record(u, u, dt=dt))[:, 0]
    noise = rng.standard_normal(n)
    if rng.random() < 0.4:
        noise = lfilter([0.7], [1.0, -0.7], noise)
    size = float(np.std(clean)) * 10.0 ** (-rng.uniform(0.0, 40.0) / 20.0)
    record = Record(u, clean + size * noise / np.std(noise), dt=dt)
    more = int(rng.integers(0, 3))
    asked = order + more
    bounds = None
    if rng.random() < 0.3:
        names = [f"a{k}" for k in range(asked)]
        true = dict(zip(names, den[::-1], strict=False))
        chosen = str(rng.choice(names))
        middle = abs(float(true.get(chosen, 1.0))) or 1.0
        bounds = {chosen: tuple(sorted(middle * rng.uniform(0.3, 2.5, 2)))}
    return record, Structure(asked, min(zeros + more, asked - 1), bounds=bounds)


def outside(estimate: Estimate, record: Record) -> list[str]:
    """All that is reported of a quantity and lies outside of what is reported of its interval."""
    found = []
    for one in (*estimate.parameters.values(), *estimate.derived()):
        low, high = one.interval(0.95)
        if np.isfinite([low, high, one.value]).all() and not low <= one.value <= high:
            found.append(f"{one.name}: {one.value} not in {low} .. {high}")
    for line in estimate.summary().splitlines():
        row = ROW.match(line)
        if row:
            value, low, high = (float(row[k].replace(",", "")) for k in ("value", "low", "high"))
            if not low <= value <= high:
                found.append(f"as printed: {line}")
    return found + _outside_of(estimate_document(estimate, [record]), "document")


def _outside_of(document: object, where: str) -> list[str]:
    """The same of every table of a document that has values beside intervals."""
    found: list[str] = []
    if isinstance(document, dict):
        value, pair = document.get("value"), document.get("interval95")
        if isinstance(value, int | float) and isinstance(pair, list | tuple):
            low, high = pair
            if np.isfinite([low, high, value]).all() and not low <= value <= high:
                found.append(f"{where}: {value} not in {low} .. {high}")
        for key, one in document.items():
            found += _outside_of(one, f"{where}.{key}")
    elif isinstance(document, list | tuple):
        for one in document:
            found += _outside_of(one, where)
    return found


def with_room(estimate: Estimate) -> list[str]:
    """Of a posterior mean: what lies near an end of its interval, or is not what the model has."""
    found = []
    for one in (*estimate.parameters.values(), *estimate.derived()):
        low, high = one.interval()
        sides = np.array([one.value - low, high - one.value])
        if one.draws.min() > 0.0 or one.draws.max() < 0.0:
            sides = np.abs(np.log(np.abs([low / one.value, high / one.value])))
        if sides.min() < 0.05 * sides.sum():
            found.append(f"{one.name}: {one.value} near an end of {low} .. {high}")
    rows = estimate.derived_rows()
    found += [
        f"{one.name}: {one.value}, of the model {row[1]}"
        for one, row in zip(estimate.derived(), rows, strict=True)
        if one.value != row[1]
    ]
    return found


def from_printed(estimate: Estimate) -> list[str]:
    """What follows from the printed coefficients and lies outside of its printed interval."""
    matches = [ROW.match(line) for line in estimate.summary().splitlines()]
    rows = {
        row["name"]: tuple(float(row[k].replace(",", "")) for k in ("value", "low", "high"))
        for row in matches
        if row
    }
    a = [rows[f"a{k}"][0] for k in range(estimate.structure.poles) if f"a{k}" in rows]
    wanted = {"dc gain": rows["b0"][0] / a[0]}
    if len(a) == 1:
        wanted |= {"real pole": -a[0], "time constant": 1.0 / a[0]}
    elif len(a) == 2 and a[1] ** 2 < 4.0 * a[0]:
        wanted |= {"natural frequency": a[0] ** 0.5, "damping": a[1] / (2.0 * a[0] ** 0.5)}
    return [
        f"{name}: {value} by the printed coefficients, not in {rows[name]}"
        for name, value in wanted.items()
        if name in rows and not rows[name][1] <= value <= rows[name][2]
    ]


BURIED = {
    1: ([2.0], [1.0, 1.5]),
    2: ([0.5], [1.0, 1.0, 3.0]),
    3: ([3.0, 6.0], [1.0, 2.2, 10.2, 9.0]),
}
"""Poles -> a plant whose record is noise for the most part."""


def buried(poles: int, seed: int) -> Record:
    """A short record with noise of three times the response."""
    rng = np.random.default_rng([seed, poles])
    n, hold = int(rng.choice([50, 100, 200])), int(rng.integers(5, 20))
    dt = float(rng.uniform(0.05, 0.15))
    u = np.ones(n) if seed % 2 else np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]
    clean = simulate(TransferFunction(*BURIED[poles]), Record(u, u, dt=dt))[:, 0]
    return Record(u, clean + 3.0 * np.std(clean) * rng.standard_normal(n), dt=dt)


@pytest.mark.parametrize(
    ("poles", "seed"),
    [
        *((k, 0) for k in BURIED),
        *(pytest.param(k, s, marks=pytest.mark.slow) for k in BURIED for s in range(1, 20)),
    ],
)
def test_values_of_a_posterior_mean_have_room_in_their_intervals(poles: int, seed: int) -> None:
    record = buried(poles, seed)
    rest = {"offset": False, "initial_state": "rest"}
    structure = Structure(poles, int(poles > 2), **rest)  # type: ignore[arg-type]
    method = ThreeModel(noise="white", finish="posterior")
    estimate = identify(record, structure, method, throw=False)
    assert estimate.status is Status.POSTERIOR_MEAN
    assert outside(estimate, record) == []
    assert with_room(estimate) == []
    assert from_printed(estimate) == []
    drawn = sample(estimate, 300)
    response = sampled_response_band(drawn, np.geomspace(0.1, 30.0, 12))
    assert np.all(response.magnitude_low <= response.magnitude)
    assert np.all(response.magnitude <= response.magnitude_high)
    step = sampled_step_band(drawn, np.linspace(0.0, 8.0, 12))
    assert np.all((step.low <= step.response) & (step.response <= step.high))


FEW = (2, 3)


@pytest.mark.parametrize(
    "seed", [*FEW, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 1, *range(4, 64)))]
)
def test_every_value_lies_within_its_own_interval(seed: int) -> None:
    record, structure = drawn(seed)
    try:
        estimate = identify(record, structure, throw=False)
    except TridentifyError:
        return
    assert outside(estimate, record) == []


def test_a_value_outside_is_seen() -> None:
    assert _outside_of({"x": {"value": 3.0, "interval95": [1.0, 2.0]}}, "") != []
    assert ROW.match("a1                  2.037         0.016         2.005         2.068  1/s")
