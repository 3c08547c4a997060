"""Copies that end where their poles are known for certain are those of the whole search."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.methods.around_maximum import maximum, turns
from tridentify.estimation.search import following, search
from tridentify.numerics.realization import cascade, roots_of, row_of
from tridentify.uncertainty import bootstrap


@pytest.mark.unjudged
def test_a_copy_that_ends_at_once_ends_where_the_search_would(monkeypatch):
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 6)
    y = simulate(TransferFunction([3.0], [1.0, 2.0, 9.0]), Record(u, u, dt=0.05))[:, 0]
    record = Record(u, y + 0.05 * np.std(y) * rng.standard_normal(u.size), dt=0.05)
    estimate = identify(record, Structure(2, 0))
    asked = []
    whole = following.enriched_starts
    monkeypatch.setattr(
        following, "enriched_starts", lambda *given: asked.append(1) or whole(*given)
    )
    at_once = bootstrap(estimate, record, n_draws=6)
    assert not asked
    for room in (following, maximum, search, turns):
        monkeypatch.setattr(room, "CERTAIN", -1.0)
    searched = bootstrap(estimate, record, n_draws=6)
    assert asked
    apart = np.abs(at_once.theta - searched.theta) / estimate.std
    assert apart.max() < 1e-6
    assert np.allclose(at_once.std_draws, searched.std_draws, rtol=1e-6)


@pytest.mark.parametrize("poles", [(-1.0, -3.0), (-0.5 + 2.0j, -0.5 - 2.0j)])
@pytest.mark.parametrize("roots", [(-1.2, -2.0), (-1.0 + 3.0j, -1.0 - 3.0j), (-0.1, -40.0)])
def test_the_row_of_two_roots_gives_them_back(poles, roots):
    bank = cascade(np.array(poles, dtype=np.complex128))
    row = row_of(bank, np.array(roots, dtype=np.complex128))
    found = np.sort_complex(roots_of(bank, row))
    assert np.allclose(found, np.sort_complex(np.array(roots)), rtol=1e-10)


def test_two_equal_poles_have_no_row():
    bank = cascade(np.array([-1.0, -1.0], dtype=np.complex128))
    assert row_of(bank, np.array([-2.0, -3.0], dtype=np.complex128)) is None
