"""Whitened samples that leave a slow response to the noise: the two ends are compared, and told."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.judgement.cautions.residual import response_as_noise

DT, N = 0.05, 600
METHOD = ThreeModel(noise="ar", finish="likelihood")


def fitted(model, structure, noise, seed=0, inputs=None):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 20), 20) if inputs is None else inputs
    clean = simulate(model, Record(u, u, dt=DT))[:, 0]
    v = lfilter([1.0], [1.0, -noise], rng.standard_normal(N + 500))[500:]
    record = Record(u, clean + 0.1 * clean.std() * v / v.std(), dt=DT)
    return record, identify(record, structure, METHOD, throw=False)


def told(estimate):
    return estimate.trace.about(DecisionKind.RESPONSE_AS_NOISE, DecisionKind.SLOW_AS_NOISE)


@pytest.fixture(scope="module")
def missed():
    """A fast lag and a slow one, and a structure for one of them."""
    model = TransferFunction([1.2, 0.5], np.polymul([1.0, 4.0], [1.0, 0.15]))
    return fitted(model, Structure(1, 0), 0.5)


@pytest.mark.slow
def test_it_is_told_where_white_weights_explain_far_more(missed):
    record, estimate = missed
    white = identify(record, Structure(1, 0), ThreeModel(noise="white", finish="likelihood"))
    ratio = ((100.0 - estimate.fit[0]) / (100.0 - white.fit[0])) ** 2
    assert ratio > 1.5
    (line,) = told(estimate)
    assert f"{estimate.fit[0]:.1f} %" in line
    assert f"{white.fit[0]:.1f} %" in line
    (finding,) = response_as_noise(estimate)
    assert finding.severity == ("warning" if ratio > 4.0 else "note")
    assert finding in estimate.findings
    assert finding.message in " ".join(estimate.summary().split())


@pytest.mark.parametrize("seed", [0, 1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.fast("0")
def test_a_right_model_in_coloured_noise_has_no_such_word(seed):
    _, estimate = fitted(TransferFunction([2.0], [1.0, 2.0, 4.0]), Structure(2, 0), 0.9, seed)
    assert not told(estimate)
