"""On-line a late input and one that is not carried out are told, coloured noise is not."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from tridentify import Record, Structure, ThreeModel, online
from tridentify.numerics.slices import drain
from tridentify.online.kernels import slots
from tridentify.online.search import record_of
from tridentify.online.unexplained import doubting

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


def recorded(kind, seed, n=N):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(n // 20), 20)
    y, noise = kind(u), rng.standard_normal(n)
    if kind is plant:
        noise = lfilter([1.0], [1.0, -0.95], noise)
    return u, y + 0.05 * y.std() * noise / noise.std()


@pytest.mark.parametrize(
    ("kind", "code"), [(late, "unmodelled-response"), (limited, "nonlinear"), (plant, None)]
)
def test_what_the_input_leaves_is_told(kind, code):
    kept = np.column_stack([np.full(N, DT), *recorded(kind, 11)])
    found = ThreeModel(noise="white").estimate([record_of(SETTING, kept)], ASKED)
    doubt = drain(doubting(SETTING, kept, found.theta, found.std))
    assert (doubt and doubt.code) == code


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


LONG = 4000


def passed(kind, seed, n=LONG, method=None):
    """The states after each sample of a stream."""
    method = method or online.ThreeModel(samples=600)
    state = method.init(ASKED, dt=DT)
    for u, y in zip(*(one.tolist() for one in recorded(kind, seed, n)), strict=True):
        state, _ = method.step(state, u, y)
        yield state


def warned(state):
    return [one.code for one in state.method.estimate(state).findings if one.severity == "warning"]


@pytest.mark.parametrize(
    ("kind", "code"), [(late, "unmodelled-response"), (limited, "nonlinear"), (plant, None)]
)
@pytest.mark.fast("late-unmodelled-response", "plant-None")
def test_it_is_said_when_the_samples_are_gone(kind, code, tmp_path):
    *_, state = passed(kind, 11, 1500)
    assert (state.stage.doubt and state.stage.doubt.code) == code
    assert sum(map(len, state.stage.past)) < 600
    told = [one for one in warned(state) if one != "varying"]
    assert told == ([] if code is None else [code])
    again = online.State.load(state.save(tmp_path / "state.json"))
    assert again.stage.doubt == state.stage.doubt


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12, 20))
@pytest.mark.parametrize(
    ("kind", "code"), [(late, "unmodelled-response"), (limited, "nonlinear"), (plant, None)]
)
def test_it_is_said_long_after(kind, code, seed):
    *_, state = passed(kind, seed, 6000, online.ThreeModel())
    told = [one for one in warned(state) if one != "varying"]
    assert told == ([] if code is None else [code])


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "code"), [(late, "unmodelled-response"), (limited, "nonlinear")])
def test_it_is_said_long_after_with_a_memory(kind, code):
    """All but one: a model that is wrong may be taken for a plant that changes."""
    method, told = online.ThreeModel(forgetting=0.999), 0
    for seed in range(12, 20):
        *_, state = passed(kind, seed, 6000, method)
        told += code in warned(state)
    assert told >= 7


@pytest.mark.parametrize(
    "document", [["order-low", "0x1p-3"], ["nonlinear", "0x1p+3"], ["nonlinear"]]
)
def test_a_doubt_that_nobody_can_have_is_refused(document):
    *_, state = passed(plant, 11, 200)
    with pytest.raises(ValueError, match=r"doubt|unpack"):
        online.State.from_dict(state.to_dict() | {"doubt": document})


def pending(states):
    """Share of the samples at which an alarm was looked into."""
    x = [one.values for one in states]
    return np.mean([v[slots.SUSPECT] > 0.0 and v[slots.SUSPECT] != v[slots.LOOK] for v in x])


def test_coloured_noise_is_usual_when_the_bank_has_moved():
    """What the scores scatter by is known before the bank moves, and no alarm after it."""
    share = pending(list(passed(plant, 11))[1200:])
    assert share < 0.1
