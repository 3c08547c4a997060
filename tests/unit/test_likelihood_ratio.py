"""Columns tested beside noise whose model was fitted to the same samples: the level holds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify.judgement.causes.system.slow import slow_waves
from tridentify.judgement.validation.residuals import Output
from tridentify.judgement.validation.statistics import likelihood_ratio
from tridentify.judgement.validation.statistics.likelihood_ratio import Known, checked

N = 200


def output(seed, added=0.0):
    """Noise with a memory of ten samples, and perhaps a slow wave."""
    rng = np.random.default_rng(seed)
    v = lfilter([1.0], [1.0, -0.9], rng.standard_normal(N + 300))[300:]
    v = v + added * slow_waves(np.linspace(0.0, 1.0, N))[:, 3]
    nothing = np.zeros((N, 0))
    return Output("y", (v,), (0.0 * v,), (v,), (nothing,), (nothing,), np.array([-0.9]))


def p_value(one, monkeypatch, *, drawn=True):
    step = np.column_stack([np.ones(N), np.arange(N) > N // 3]).astype(float)
    monkeypatch.setattr(likelihood_ratio, "WORTH_DRAWING", 2.0 if drawn else -1.0)
    monkeypatch.setattr(likelihood_ratio, "CALLED", -1.0)
    waves = slow_waves(np.linspace(0.0, 1.0, N))
    return checked(Known(one, (step,), one.noise), (waves,), 0.0)


def test_what_noise_alone_makes_of_the_ratio_is_taken_off_it(monkeypatch):
    one = output(3)
    plain, drawn = (p_value(one, monkeypatch, drawn=d) for d in (False, True))
    assert drawn > plain


def test_a_wave_that_is_there_is_still_found(monkeypatch):
    assert p_value(output(3, added=24.0), monkeypatch) < 1e-3


@pytest.mark.slow
def test_columns_that_are_not_there_are_called_as_often_as_stated(monkeypatch):
    draws, rate = 150, 0.05
    plain, drawn = (
        sum(p_value(output(k), monkeypatch, drawn=d) < rate for k in range(draws))
        for d in (False, True)
    )
    chance = 3.0 * np.sqrt(draws * rate)
    assert drawn < draws * rate + chance
    assert plain > drawn + chance / 2.0
