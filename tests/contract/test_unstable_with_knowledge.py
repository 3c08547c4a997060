"""Plants that are not stable, in a loop with a reference, asked together with something else.

Known coefficients, bounds, known delays and a drift are honoured; what the predictor cannot be told
is refused in one line of a class of its own. The loops come from `oracles`.
"""

from __future__ import annotations

import numpy as np
import pytest

import tridentify as tri
from oracles import sampled_loop
from tridentify.errors import UnstablePlantError

PENDULUM = ([1.5], [1.0, 0.6, -2.0])
TRUTH = {"a1": 0.6, "a0": -2.0, "b0": 1.5}
DT = 0.08
SAMPLED = tri.ThreeModel(controller="sampled")
CLOSE = 4.0


def record_of(seed, *, n=500, late=0, slope=0.0, channel=PENDULUM):
    """A sampled lead controller around a pendulum; its input acts some samples late."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], n // 15 + 1), 15)[:n]
    drift = slope * DT * np.arange(n)
    e = 0.05 * rng.standard_normal(n) + drift
    gain, pole, before, state = 6.0, 0.3, 0.0, 0.0
    asked = []

    def control(k, y):
        nonlocal before, state
        error = r[k] - y[0]
        state = pole * state + (1.0 - pole) * (error - before) / DT
        before = error
        asked.append(gain * error + 1.8 * state)
        return asked[k - late] if k >= late else 0.0

    _, y = sampled_loop([[channel]], control, e[:, None], DT)
    return tri.Record(np.array(asked), y, dt=DT, reference=r)


def close(estimate, truth=TRUTH):
    assert estimate.status.ok
    assert estimate.loop.mirrored
    for name, value in truth.items():
        found = estimate.parameters[name]
        assert abs(found.value - value) <= CLOSE * found.std + 1e-9 * abs(value)


@pytest.mark.slow
@pytest.mark.unjudged
def test_a_known_gain_a_known_delay_and_a_drift_together():
    record = record_of(31, n=300, late=2, slope=0.05)
    structure = tri.Structure(2, 0, delay=2 * DT, drift=True, fixed={"b0": 1.5})
    estimate = tri.identify(record, structure, SAMPLED)
    close(estimate)
    assert estimate.parameters["b0"].value == 1.5
    assert estimate.parameters["b0"].std == 0.0
    assert float(estimate.model.delay[0, 0]) == 2 * DT


@pytest.mark.unjudged
@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "of"),
    [
        ({"fixed": {"a0": -2.0}}, {}),
        ({"bounds": {"b0": (0.0, None)}}, {}),
        ({"static_gain": -0.75}, {}),
        ({"equalities": [({"a1": 1.0, "b0": 2.0}, 3.6)]}, {}),
        ({"delay": 2 * DT}, {"late": 2}),
        ({"drift": True}, {"slope": 0.2}),
    ],
    ids=["fixed", "bounds", "static gain", "equality", "delay", "drift"],
)
@pytest.mark.parametrize("seed", [41, 42, 43])
def test_what_is_known(options, of, seed):
    close(tri.identify(record_of(seed, **of), tri.Structure(2, 0, **options), SAMPLED))


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_slope_is_found():
    estimate = tri.identify(record_of(44, slope=0.2), tri.Structure(2, 0, drift=True), SAMPLED)
    assert estimate.nuisance[0].drift[0] == pytest.approx(0.2, abs=0.02)


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_bound_that_is_reached_holds():
    estimate = tri.identify(record_of(45), tri.Structure(2, 0, bounds={"b0": (1.7, None)}), SAMPLED)
    assert estimate.parameters["b0"].value == 1.7
    assert estimate.parameters["b0"].std == 0.0


@pytest.mark.unjudged
@pytest.mark.slow
def test_what_is_known_makes_surer():
    record = record_of(46)
    free = tri.identify(record, tri.Structure(2, 0), SAMPLED)
    known = tri.identify(record, tri.Structure(2, 0, fixed={"b0": 1.5}), SAMPLED)
    assert known.parameters["a0"].std < free.parameters["a0"].std


@pytest.mark.unjudged
@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "method", "word"),
    [
        (tri.Structure(2, 0, priors={"b0": (1.5, 0.1)}), SAMPLED, "priors"),
        (tri.Structure(2, 0, delay="free"), SAMPLED, "delay"),
        (tri.Structure(2, 0), tri.ThreeModel(controller="sampled", loss="huber"), "loss"),
    ],
    ids=["priors", "free delay", "loss"],
)
def test_what_the_predictor_cannot_be_told_is_refused_in_one_line(structure, method, word):
    with pytest.raises(UnstablePlantError, match=word) as refused:
        tri.identify(record_of(47), structure, method)
    assert "\n" not in str(refused.value)


@pytest.mark.unjudged
def test_a_refusal_that_is_clear_waits_for_no_stable_answer(monkeypatch):
    """What past inputs leave is more than the noise, whichever stable model is sought."""

    def sought(*_, **__):
        raise AssertionError("a stable answer was sought")

    monkeypatch.setattr("tridentify.estimation.methods.by_reference.reference.white_root", sought)
    with pytest.raises(UnstablePlantError, match="a delay that is to be estimated"):
        tri.identify(record_of(51), tri.Structure(2, 0, delay="free"), SAMPLED)


@pytest.mark.unjudged
@pytest.mark.slow
def test_two_outputs_are_refused_and_each_is_found_alone():
    one = record_of(48)
    noise = 0.05 * np.random.default_rng(50).standard_normal(one.n_samples)
    y = np.column_stack([one.y[:, 0], 2.0 * one.y[:, 0] + noise])
    both = tri.Record(one.u, y, dt=DT, reference=one.reference)
    with pytest.raises(UnstablePlantError, match="one output at a time"):
        tri.identify(both, tri.Structure(2, 0), SAMPLED)
    close(tri.identify(both.select(outputs=["y1"]), tri.Structure(2, 0), SAMPLED))


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_stable_plant_with_priors_is_not_refused():
    record = record_of(49, channel=([1.5], [1.0, 0.6, 2.0]))
    known = tri.Structure(2, 0, priors={"b0": (1.5, 0.1)})
    assert tri.identify(record, known, SAMPLED).status.ok
