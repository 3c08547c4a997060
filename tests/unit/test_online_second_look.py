"""What kept samples, asked once more with a model of the noise, do to errors and dates."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, online, simulate
from tridentify.numerics.slices import drain
from tridentify.online.residual import refined
from tridentify.online.search import record_of
from tridentify.online.second_look import doubted
from tridentify.online.suspicion import Old, still_old

DT = 0.02
TRUTH, OTHER = np.array([3.0, 9.0, 2.0, 3.0]), np.array([3.0, 6.0, 2.0, 3.0])
ASKED = Structure(2, 1)
SETTING = online.ThreeModel().init(ASKED, DT).stage.setting


def plant(theta):
    return TransferFunction(theta[2:].tolist(), [1.0, *theta[:2].tolist()])


def samples(seed, count, when, slow, noise=0.05):
    """A plant whose stiffness falls by a third, and a disturbance that goes on for 15 s."""
    rng = np.random.default_rng([seed, 31])
    u = rng.choice([-1.0, 1.0], count // 20 + 1).repeat(20)[:count]
    before, after = (simulate(plant(one), Record(u, u, dt=DT))[:, 0] for one in (TRUTH, OTHER))
    y, keep = np.where(np.arange(count) < when, before, after), np.exp(-DT / 15.0)
    drive = rng.standard_normal(count + 8000)
    wander = scipy.signal.lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], drive)[8000:]
    y = y + before.std() * (slow * wander + noise * rng.standard_normal(count))
    return np.column_stack([np.full(count, DT), u, y])


def white_answer(kept):
    found = identify(record_of(SETTING, kept), ASKED, method=ThreeModel(noise="white"))
    return found.theta, found.cov


def test_white_noise_keeps_its_errors():
    kept = samples(1, 700, 0, 0.0)
    theta, cov = white_answer(kept)
    found = doubted(SETTING, kept, theta, cov)
    assert np.all(np.sqrt(np.diagonal(found) / np.diagonal(cov)) < 1.1)


def test_an_answer_that_a_slow_disturbance_has_bent_is_not_called_sure():
    kept = samples(2, 700, 0, 0.4)
    theta, cov = white_answer(kept)
    found = doubted(SETTING, kept, theta, cov)
    with_model = drain(refined(SETTING, record_of(SETTING, kept), theta, np.sqrt(np.diagonal(cov))))
    least = np.maximum(np.abs(with_model.theta - theta), np.sqrt(np.diagonal(with_model.cov)))
    assert np.allclose(np.sqrt(np.diagonal(found)), np.maximum(np.sqrt(np.diagonal(cov)), least))
    assert np.all(np.abs(theta - OTHER) < 3.0 * np.sqrt(np.diagonal(found)))


def test_samples_that_do_not_tell_leave_it_as_it_is():
    kept = samples(3, 700, 0, 0.4)
    kept[:, 2] = np.nan
    kept[:3, 2] = 1.0
    assert np.array_equal(doubted(SETTING, kept, TRUTH, np.eye(4)), np.eye(4))


@pytest.mark.parametrize("slow", [0.0, 0.4])
def test_a_change_is_dated_when_it_was(slow):
    """The look began before it: what stood before the change was counted for the new plant."""
    for seed in (4, 5):
        kept = samples(seed, 600, 150, slow)
        record = record_of(SETTING, kept)
        new = drain(refined(SETTING, record, OTHER, 0.05 * OTHER))
        old = Old(TRUTH, np.diag((0.02 * TRUTH) ** 2))
        assert 110 <= drain(still_old(SETTING, record, old, new)) <= 230


def test_no_sample_is_cut_off_where_all_are_of_the_new_plant():
    record = record_of(SETTING, samples(6, 600, 0, 0.4))
    new = drain(refined(SETTING, record, OTHER, 0.05 * OTHER))
    assert drain(still_old(SETTING, record, Old(TRUTH, np.eye(4)), new)) == 0
