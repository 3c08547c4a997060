"""Instants that are not uniform: states and simulation against one exponential an interval."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.integrate
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from tridentify import Record, Structure, TransferFunction, errors, identify, simulate
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.methods.output_error import OutputError
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.estimation.search.stand_ins import averaged, window
from tridentify.models.regression import Experiment, Layout, response_of
from tridentify.numerics.intervals import Crossing, plan, steps
from tridentify.numerics.realization import cascade

pytestmark = pytest.mark.unjudged

POLES = np.array([-1 + 3j, -1 - 3j, -20.0, -0.1], dtype=complex)
BANK = cascade(np.tile(POLES, 2))
DAY = 86400.0


def instants(kind, n=160, dt=0.1, seed=1):
    """Sampling instants from zero, of several kinds."""
    h = np.full(n - 1, dt)
    if "jitter" in kind:
        h *= np.random.default_rng(seed).uniform(0.2, 1.8, n - 1)
    if "gap" in kind:
        h[n // 2] = DAY
    if kind == "two rates":
        h[n // 3 :] = 0.03
    t = np.concatenate([[0.0], np.cumsum(h)])
    return np.delete(t, [10, 11, 50, 90]) if kind == "missing rows" else t


KINDS = ["jitter", "gap", "jitter and gap", "two rates", "missing rows"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_states_are_those_of_one_exponential_an_interval(responses, kind, intersample):
    t = instants(kind)
    u = np.random.default_rng(2).standard_normal((t.size, 1))
    crossing = Crossing(plan(t, u, 0.0, intersample), BANK.a, BANK.b, upper=1)
    found = np.empty((BANK.order, t.size))
    crossing.advance(0, 70, found)
    crossing.advance(70, t.size, found[:, 70:])
    expected = responses(BANK.a, BANK.b, t, u[:, 0], 0.0, intersample)[0]
    assert np.abs(found.T - expected).max() < 3e-13 * np.abs(expected).max()


def test_many_lengths_take_digits_and_few_take_one_table():
    few = plan(instants("two rates"), np.ones((160, 1)), 0.0, "zoh")
    many = plan(instants("jitter and gap"), np.ones((160, 1)), 0.0, "zoh")
    assert steps(BANK.a, BANK.b, few.lengths, few.distinct).terms == 0
    assert few.distinct.size < 20
    assert steps(BANK.a, BANK.b, many.lengths, many.distinct).terms > 0
    assert many.distinct.size == 0


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    rate=st.floats(-6.0, 6.0),
    spread=st.floats(0.0, 5.0),
    intersample=st.sampled_from(["zoh", "foh"]),
)
def test_any_lengths_at_any_rate(responses, seed, rate, spread, intersample):
    """Lengths over decades, systems fast or slow."""
    rng = np.random.default_rng(seed)
    unit = 10.0**-rate
    t = unit * np.cumsum(10.0 ** rng.uniform(-spread, 0.0, 200))
    t = t - t[0]
    u = rng.standard_normal((t.size, 1))
    bank = cascade(np.array([-0.5 + 2j, -0.5 - 2j, -0.5 + 2j, -0.5 - 2j, -7.0]) / unit)
    found = np.empty((5, t.size))
    Crossing(plan(t, u, 0.0, intersample), bank.a, bank.b, upper=1).advance(0, t.size, found)
    expected = responses(bank.a, bank.b, t, u[:, 0], 0.0, intersample)[0]
    assert np.abs(found.T - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.fast("jitter")
def test_columns_of_a_regression(responses, kind):
    """States, direct terms, impulse, constant and ramp, each with its own delays."""
    t = instants(kind)
    rng = np.random.default_rng(3)
    u, y = rng.standard_normal((t.size, 2)), rng.standard_normal((t.size, 2))
    delays = np.array([[0.03, 0.777], [0.0, 0.1]])
    start = int(np.searchsorted(t, 0.777))
    e = Experiment(u, y, 0.1, "foh", True, True, True, t=t, delays=delays, start=start)
    layout = Layout(BANK.order, 2, True, True, True)
    for i in range(2):
        unit = np.eye(layout.n_signals)
        found = response_of(e, BANK, unit, outputs=[i] * layout.n_signals)
        for j in range(2):
            states, late = responses(BANK.a, BANK.b, t, u[:, j], delays[i, j], "foh")
            assert np.abs(found[:, layout.input_states(j)] - states).max() < 1e-9
            assert np.abs(found[:, layout.direct(j)] - late).max() < 1e-9
        free = np.array([expm(BANK.a * s) @ BANK.b for s in t[start:] - t[start]])
        assert np.abs(found[start:, : BANK.order] - free).max() < 1e-12
        assert not found[:start, : BANK.order].any()
        assert np.array_equal(found[:, layout.nuisance], np.stack([t**0, t / t[-1]], 1))


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_simulation_is_what_an_ode_solver_gives(intersample):
    rng = np.random.default_rng(6)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.4, 12))])
    u = rng.standard_normal(t.size)
    model = TransferFunction([0.4, 2.0, 1.0], [1.0, 0.8, 4.0], delay=0.23)
    found = simulate(model, Record(u, u, t=t + 5.0, intersample=intersample))[:, 0]

    def late(now):
        before = now - 0.23
        if before < 0.0:
            return 0.0
        if intersample == "foh":
            return np.interp(before, t, u)
        return u[np.searchsorted(t, before, side="right") - 1]

    # y = 0.4 u + (1.68 p - 0.6) / a u, observer form
    def slope(now, x):
        v = late(now)
        return [-0.8 * x[0] + x[1] + 1.68 * v, -4.0 * x[0] - 0.6 * v]

    breaks = np.unique(np.concatenate([t, t + 0.23]))
    breaks = breaks[breaks <= t[-1]]
    x, expected = np.zeros(2), {0.0: 0.0}
    for begin, end in itertools.pairwise(breaks):
        inside = end - 1e-12
        x = scipy.integrate.solve_ivp(slope, (begin, inside), x, rtol=1e-11, atol=1e-12).y[:, -1]
        expected[end] = x[0]
    wanted = np.array([expected[now] for now in t]) + 0.4 * np.array([late(now) for now in t])
    assert np.abs(found - wanted).max() < 1e-8


TRUTH = {
    1: ([1.5], [1.0, 2.0]),
    2: ([0.2, 0.5], [1.0, 1.0, 3.0]),
    3: ([0.3, 1.0, 0.9], [1.0, 3.0, 5.0, 3.0]),
    4: ([1.0, 2.0, 3.0], [1.0, 5.0, 27.0, 32.0, 60.0]),
}


@pytest.mark.parametrize("n", TRUTH)
@pytest.mark.parametrize("kind", ["jitter", "jitter and gap", "missing rows"])
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.fast(
    "foh-jitter and gap-1",
    "zoh-jitter and gap-4",
    "zoh-jitter and gap-2",
    "foh-jitter and gap-3",
)
def test_noise_free_records_give_the_truth(n, kind, intersample):
    num, den = TRUTH[n]
    t = instants(kind, n=300)
    rng = np.random.default_rng(7)
    u = np.repeat(np.sign(rng.standard_normal(t.size)), 3)[: t.size] + 0.3
    record = Record(u, u, t=t + 100.0, intersample=intersample)
    y = simulate(TransferFunction(num, den), record)
    record = Record(u, y, t=t + 100.0, intersample=intersample)
    estimate = identify(record, Structure(n, len(num) - 1))
    assert estimate.theta == pytest.approx([*den[1:], *num], rel=1e-9)
    assert estimate.dt is None
    assert np.abs(estimate.residual(record)).max() < 1e-11


def noisy(kind="jitter", n=300, seed=0, noise=0.05):
    t = instants(kind, n=n, seed=seed + 1)
    rng = np.random.default_rng(seed)
    u = np.repeat(np.sign(rng.standard_normal(n)), 4)[: t.size]
    y = simulate(TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0]), Record(u, u, t=t))[:, 0]
    return Record(u, y + noise * rng.standard_normal(t.size), t=t)


def test_a_colour_of_the_noise_is_not_sought_and_says_so():
    estimate = identify(noisy(), Structure(2, 1))
    assert any("not uniform" in line for line in estimate.trace.decisions)
    with pytest.raises(errors.UnsupportedError, match="evenly spaced"):
        identify(noisy(), Structure(2, 1), ThreeModel(noise="ar"))


@pytest.mark.judged
def test_estimate_survives_a_record_without_a_step(tmp_path):
    """Text, bands, files, predictions: nothing needs a step."""
    from tridentify import Estimate, uncertainty

    record = noisy()
    estimate = identify(record, Structure(2, 1))
    assert "ThreeModel" in estimate.summary()
    back = Estimate.load(estimate.save(tmp_path / "estimate.json"))
    assert back.dt is None
    assert np.array_equal(back.predict(record), estimate.predict(record))
    band = uncertainty.step_band(estimate, np.linspace(0.1, 5, 9))
    assert np.isfinite(band.low).all()


def test_fingerprint_sees_the_instants():
    one = noisy()
    moved = np.array(one.t)
    moved[5] += 1e-3
    other = Record(one.u, one.y, t=moved)
    found = [identify(r, Structure(2, 1), OutputError()).record_fingerprint for r in (one, other)]
    assert found[0] != found[1]


def test_stand_ins_keep_time():
    """Averages are weighted by time: the exact response to the averaged input is near."""
    t = instants("jitter", n=6000, dt=0.01)
    u = np.sin(0.2 * t)[:, None] + 1.0
    y = simulate(TransferFunction([1.0], [1.0, 1.0]), Record(u, u, t=t))
    e = Experiment(u, y, 0.01, "zoh", False, False, False, t=t)
    problem = Problem.of([e], 1, ((0,),))
    thin = averaged(problem).experiments[0]
    assert thin.n_samples == 2000
    assert np.array_equal(thin.t, t[::3])
    found = simulate(TransferFunction([1.0], [1.0, 1.0]), Record(thin.u, thin.u, t=thin.t))
    assert np.abs(found - thin.y).max() < 1e-3
    piece = window(problem).experiments[0]
    assert piece.t[0] == 0.0
    assert piece.n_samples == 2000


@pytest.mark.slow
def test_cost_is_linear_in_the_record():
    import time

    from tridentify.models.regression import regress

    seconds = []
    for n in (20_000, 80_000):
        t = instants("jitter", n=n)
        u = np.random.default_rng(1).standard_normal((n, 1))
        e = Experiment(u, u, 0.1, "zoh", True, True, False, t=t)
        regress(e, BANK)
        best = []
        for _ in range(3):
            begin = time.perf_counter()
            regress(e, BANK)
            best.append(time.perf_counter() - begin)
        seconds.append(min(best))
    assert seconds[1] < 8.0 * seconds[0]
