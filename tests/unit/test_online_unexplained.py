"""On-line a late input and one that is not carried out are told, coloured noise is not."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from tridentify import Record, Structure, ThreeModel, online
from tridentify.online.search import record_of
from tridentify.online.unexplained import response_finding

DT, N = 0.02, 1500
ASKED = Structure(2, 1)
SETTING = online.ThreeModel().init(ASKED, DT).stage.setting


def plant(u):
    num, den, _ = cont2discrete(([3.0, 6.0], [1.0, 1.6, 9.0]), DT, "zoh")
    return lfilter(num.ravel(), den, u)


def late(u):
    return np.append(np.zeros(3), plant(u)[:-3])


def limited(u):
    return plant(np.clip(u, -0.8, 0.8))


def recorded(kind, seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(N // 20), 20)
    y, noise = kind(u), rng.standard_normal(N)
    if kind is plant:
        noise = lfilter([1.0], [1.0, -0.95], noise)
    return u, y + 0.05 * y.std() * noise / noise.std()


@pytest.mark.parametrize(
    ("kind", "code"), [(late, "unmodelled-response"), (limited, "nonlinear"), (plant, None)]
)
def test_what_the_input_leaves_is_told(kind, code):
    kept = np.column_stack([np.full(N, DT), *recorded(kind, 11)])
    found = ThreeModel(noise="white").estimate([record_of(SETTING, kept)], ASKED)
    told = response_finding(SETTING, kept, found.theta, found.std)
    assert [one.code for one in told] == ([] if code is None else [code])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12, 20))
@pytest.mark.parametrize(
    ("kind", "code"), [(late, "unmodelled-response"), (limited, "nonlinear"), (plant, None)]
)
def test_an_estimate_on_line_says_it(kind, code, seed):
    u, y = recorded(kind, seed)
    found = online.run(online.ThreeModel(), Record(u, y, dt=DT), ASKED).estimate.findings
    told = [one.code for one in found if one.severity == "warning" and one.code != "varying"]
    assert told == ([] if code is None else [code])
