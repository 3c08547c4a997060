"""At a limit the passes with a noise model end once: there is no root to come to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oracles import continuous_loop
from tridentify import Record, Structure, ThreeModel
from tridentify.estimation.answer.trace import Status
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.methods.by_reference import roots
from tridentify.estimation.methods.by_reference.passes import MOST_PASSES, PATIENCE, Rooted, root

pytestmark = pytest.mark.unjudged

CHANNEL = ([1.0, 2.0], [1.0, 1.2, 4.0])
STATES = (np.zeros((1, 1)), np.ones(1), np.array([1.0]), 2.0)
ORDERS = Structure(2, 1)


def loop_and_estimate():
    rng = np.random.default_rng(0)
    r = np.repeat(rng.choice([-1.0, 1.0], 20), 15)
    u, y = continuous_loop(CHANNEL, STATES, r, 0.1 * rng.standard_normal(300), 0.1)
    record = Record(u, y, dt=0.1, reference=r)
    loop = Loop(driven(record, between=True), "continuous")
    return loop, ThreeModel(noise="white", route="open-loop").estimate([loop.instrument], ORDERS)


@pytest.mark.parametrize(
    ("status", "kind", "again"),
    [
        (Status.CONVERGED, "continuous", True),
        (Status.AT_STABILITY_LIMIT, "continuous", False),
        (Status.AT_SAMPLING_LIMIT, "continuous", False),
        (Status.CONVERGED, "sampled", False),
    ],
)
@pytest.mark.fast("Status.AT_SAMPLING_LIMIT-continuous-False")
def test_driven_inputs_are_found_anew_where_there_is_a_root(monkeypatch, status, kind, again):
    loop, estimate = loop_and_estimate()
    loop = replace(loop, sampling=kind)
    coloured = replace(estimate, noise_model=(np.array([-0.5]),), status=status)
    passes, renewed = [], []

    class Method:
        def estimate(self, records, structure, progress=None):
            return coloured

    def root(loops, structure, first, near, say, **_):
        passes.append(first)
        return Rooted(loops, coloured, 3, 0.0)

    def anew(best, structure, near, say, **_):
        renewed.append(best)
        return replace(best, passes=best.passes + 5)

    monkeypatch.setattr(roots, "root", root)
    monkeypatch.setattr(roots, "_renewed", anew)
    white = Rooted([loop], estimate, 2, 0.0)
    found = roots.with_noise_model(white, ORDERS, Method(), lambda _: None)
    assert len(passes) == 1
    assert bool(renewed) is again
    assert found.passes == (10 if again else 5)
    assert found.estimate.status is status


def test_passes_that_go_to_and_fro_end_when_they_get_no_nearer():
    loop, estimate = loop_and_estimate()
    count = 0

    class Method:
        def estimate(self, records, structure, progress=None):
            nonlocal count
            count += 1
            rng = np.random.default_rng(count)
            return replace(estimate, theta=estimate.theta + rng.uniform(0.5, 1.0, 4) * estimate.std)

    def ended(**options):
        nonlocal count
        count = 0
        return root([loop], ORDERS, estimate, lambda _: Method(), lambda _: None, **options)

    found = ended(patience=PATIENCE)
    assert PATIENCE < found.passes <= 2 * PATIENCE
    assert not found.still
    assert ended().passes == MOST_PASSES
