"""One quick look at a residual serves both who asks for feedback and who asks for tests."""

from __future__ import annotations

import numpy as np

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.validation import assess


def test_an_identification_takes_one_look_and_another_record_gets_its_own(monkeypatch):
    rng = np.random.default_rng(1)
    # what moves a little at every sample may react: the first question is then asked
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 6) + 0.02 * rng.standard_normal(240)
    y = simulate(TransferFunction([3.0], [1.0, 2.0, 9.0]), Record(u, u, dt=0.05))[:, 0]
    records = [
        Record(u, y + 0.05 * np.std(y) * rng.standard_normal(u.size), dt=0.05) for _ in range(2)
    ]
    taken = []
    look = assess.look
    monkeypatch.setattr(assess, "look", lambda *a, **k: taken.append(1) or look(*a, **k))
    estimate = identify(records[0], Structure(2, 0))
    assert len(taken) == 1
    again = assess.own_look(estimate, records[1:])
    assert len(taken) == 2
    assert again is assess.own_look(estimate, records[1:])
    assert again is not assess.own_look(estimate, records[:1])
