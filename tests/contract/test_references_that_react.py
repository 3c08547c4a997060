"""What is given as a reference and is none: it carries the noise of the output."""

from dataclasses import replace

import numpy as np
import pytest

from oracles import sampled_loop
from tridentify import Record, Structure, ThreeModel, identify
from tridentify.judgement.validation.residuals import look
from tridentify.judgement.validation.tried import may_react, try_causes

STEP = 0.05
GIVEN = {
    "control error": lambda u, y, r: r - y,
    "a tenth of the output": lambda u, y, r: r - 0.1 * y,
    "output": lambda u, y, r: y,
    "input": lambda u, y, r: u,
}
RIGHT = {
    "levels": lambda rng, n: np.repeat(rng.choice([-1.0, 1.0], n // 25), 25),
    "random walk": lambda rng, n: 0.1 * np.cumsum(rng.standard_normal(n)),
    "tones": lambda rng, n: sum(
        np.sin(w * STEP * np.arange(n) + rng.uniform(0, 6)) for w in (0.3, 0.8, 1.7, 3.1)
    ),
}


def loop(seed, kind="levels", n=600):
    """A second-order plant under a PI controller, in white noise."""
    rng, total = np.random.default_rng(seed), [0.0]
    r = RIGHT[kind](rng, n)

    def control(k, y):
        total[0] += 0.8 * STEP * (r[k] - y[0])
        return 0.6 * (r[k] - y[0]) + total[0]

    noise = 0.1 * rng.standard_normal((n, 1))
    u, y = sampled_loop([[([4.0], [1.0, 1.2, 4.0])]], control, noise, STEP)
    return u[:, 0], y[:, 0], r


def codes(u, y, r):
    record = Record(u, y, dt=STEP, reference=r)
    found = identify(record, Structure(2, 0), ThreeModel(controller="sampled"))
    assert found.route == "reference"
    return {one.code: one for one in found.findings}


@pytest.mark.slow
@pytest.mark.parametrize("given", list(GIVEN))
@pytest.mark.parametrize("seed", [0, 1])
def test_a_reference_that_carries_the_output_is_told(given, seed):
    u, y, r = loop(seed)
    finding = codes(u, y, GIVEN[given](u, y, r))["reference-reacts"]
    assert finding.severity == "warning"
    assert "reacts to the noise of y" in finding.message


@pytest.mark.parametrize("kind", list(RIGHT))
@pytest.mark.parametrize("sensor", [0.0, 0.05])
@pytest.mark.slow
def test_a_reference_that_was_measured_is_none_of_these(kind, sensor):
    u, y, r = loop(2, kind)
    noise = sensor * np.random.default_rng(9).standard_normal(r.size)
    assert "reference-reacts" not in codes(u, y, r + noise)


@pytest.mark.slow
def test_that_the_recorded_input_reacts_is_no_objection_to_what_a_reference_drives():
    u, y, _ = loop(0)
    record = Record(u, y, dt=STEP)
    found = identify(record, Structure(2, 0), ThreeModel(route="open-loop", noise="white"))
    view = look(found, [record], None, own=True)
    driven = replace(view, driven=True)
    assert may_react(view)
    assert not may_react(driven)
    assert try_causes(view, found, 20, 1e-3).cause == "feedback"
    assert try_causes(driven, found, 20, 1e-3).cause != "feedback"
