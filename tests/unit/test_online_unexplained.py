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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "code"), [(late, "unmodelled-response"), (limited, "nonlinear"), (plant, None)]
)
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12, 14])
def test_coloured_noise_is_usual_when_the_bank_has_moved(seed):
    """What the scores scatter by is known before the bank moves, or by the first false alarm."""
    share = pending(list(passed(plant, seed))[1200:])
    assert share < 0.1


TRUE = np.array([1.6, 9.0, 3.0, 6.0])


def fed(method, u, y, state=None):
    state = method.init(ASKED, dt=DT) if state is None else state
    return method.feed(state, u[:, None].copy(), y[:, None].copy())[0]


@pytest.mark.parametrize("count", [1100, 1500, 1900])
@pytest.mark.slow
def test_a_memory_does_not_lose_it_while_samples_are_kept(count):
    """More samples than are remembered, and fewer than are dropped."""
    state = fed(online.ThreeModel(forgetting=1.0 - 1.0 / 500.0), *recorded(late, 21, count))
    assert "unmodelled-response" in warned(state)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "code"), [(late, "unmodelled-response"), (limited, "nonlinear"), (plant, None)]
)
def test_the_gradient_rule_says_it(kind, code):
    u, y = recorded(kind, 11, 2400)
    method = online.Gradient()
    state = fed(method, u[:1000], y[:1000])
    early = [one for one in warned(state) if one != "varying"]
    state = fed(method, u[1000:], y[1000:], state)
    told = [one for one in warned(state) if one != "varying"]
    assert early == told == ([] if code is None else [code])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(22, 30))
@pytest.mark.parametrize(
    ("kind", "code"), [(late, "unmodelled-response"), (limited, "nonlinear"), (plant, None)]
)
def test_the_gradient_rule_says_it_long_after(kind, code, seed):
    told = [
        w for w in warned(fed(online.Gradient(), *recorded(kind, seed, 6000))) if w != "varying"
    ]
    assert told == ([] if code is None else [code])


@pytest.mark.slow
def test_questions_go_on_from_a_saved_state(tmp_path):
    u, y = recorded(late, 12, 2300)
    method = online.Gradient()
    k = 1900
    state = fed(method, u[:k], y[:k])
    while not (state.values[slots.WORK_DONE] > 3.0 and not state.stage.searching):
        state, k = fed(method, u[k : k + 1], y[k : k + 1], state), k + 1
    again = online.State.load(state.save(tmp_path / "state.json"))
    one, other = (fed(method, u[k:], y[k:], each) for each in (state, again))
    assert one.stage.doubt == other.stage.doubt is not None
    assert np.array_equal(one.values, other.values)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(31, 44))
def test_the_errors_of_the_gradient_rule_contain_what_it_has_still_to_go(seed):
    """Few samples with coloured noise: too few blocks of scores to tell, and no rest yet."""
    found = online.Gradient().estimate(fed(online.Gradient(), *recorded(plant, seed, 900)))
    assert np.max(np.abs(found.theta - TRUE) / found.std) < 5.0


def began_late(seed, n):
    u, y = recorded(plant, seed, n)
    return u, np.where(np.arange(n) < n // 3, y, np.append(np.zeros(4), y[:-4]))


@pytest.mark.slow
def test_a_look_tells_what_began_later():
    """Without an end of the samples that are kept: an actuator that became late."""
    told, right = 0, 0
    for seed in range(50, 53):
        state = fed(online.ThreeModel(), *began_late(seed, 7000))
        told += bool(state.changes) or "unmodelled-response" in warned(state)
        right += warned(fed(online.ThreeModel(), *recorded(plant, seed, 7000))) in ([], ["varying"])
    assert (told, right) == (3, 3)
