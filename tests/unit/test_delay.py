"""Known delays: exact for any number of seconds, and no sample explained by an unknown past."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, errors, identify, simulate
from tridentify.estimation.likelihood.cost import evaluate_variant
from tridentify.estimation.likelihood.setup.nuisance import build_base, candidates, first_explained
from tridentify.estimation.methods.output_error import OutputError
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.models.regression import Experiment, Layout, response_of
from tridentify.numerics.realization import cascade
from tridentify.numerics.sampled import Sampled, States

pytestmark = pytest.mark.unjudged

DT = 0.1
BANK = cascade(np.array([-0.8, -1 + 2j, -1 - 2j, -0.8, -6.0], dtype=complex))
TRUTH = {
    1: ([1.5], [1.0, 2.0]),
    2: ([0.2, 0.5], [1.0, 1.0, 3.0]),
    3: ([0.3, 1.0, 0.9], [1.0, 3.0, 5.0, 3.0]),
    4: ([1.0, 2.0, 3.0], [1.0, 5.0, 27.0, 32.0, 60.0]),
}
DELAYS = [0.0, 0.3, 1.0, 1.5, 7.77, 158.6, 500.0]


@pytest.mark.parametrize("steps", DELAYS)
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_states_are_those_of_the_past(responses, steps, intersample):
    """x(t_k - delay), from the last knot by one exponential; nothing before the record."""
    t = np.arange(160) * DT
    u = np.random.default_rng(1).standard_normal((160, 2))
    signal = Sampled(u, DT, intersample, delays=(steps * DT, 0.05))
    found = np.full((2 * BANK.order, 160), np.nan)
    states = States(signal, BANK.a, BANK.b, upper=1)
    states.advance(0, 70, found)
    states.advance(70, 160, found[:, 70:])
    for j, delay in enumerate(signal.delays):
        expected, late = responses(BANK.a, BANK.b, t, u[:, j], delay, intersample)
        own = found[j * BANK.order : (j + 1) * BANK.order].T
        assert np.abs(own - expected).max() < 1e-11
        assert np.abs(signal.direct[:, j] - late).max() < 1e-11


def test_one_delay_for_all_runs_them_together():
    u = np.random.default_rng(1).standard_normal((50, 3))
    together = Sampled(u, DT, "foh", delays=(0.13,) * 3)
    apart = Sampled(u, DT, "foh", delays=(0.13, 0.13, 0.14))
    found = [np.empty((3 * BANK.order, 50)) for _ in range(2)]
    for signal, out in zip((together, apart), found, strict=True):
        States(signal, BANK.a, BANK.b, upper=1).advance(0, 50, out)
    same = slice(0, 2 * BANK.order)
    assert len(together.groups) == 1
    assert np.array_equal(found[0][same], found[1][same])


def test_delays_are_plain_data():
    rng = np.random.default_rng(2)
    u, y = rng.standard_normal((40, 1)), rng.standard_normal((40, 1))
    e = Experiment(u, y, DT, "zoh", False, False, False)
    moved = dataclasses.replace(e, delays=np.array([[2 * DT]]))
    rows = np.eye(Layout(BANK.order, 1, False, False, False).n_signals)
    before, after = response_of(e, BANK, rows), response_of(moved, BANK, rows)
    assert np.abs(after[2:] - before[:-2]).max() < 1e-13
    assert not after[:2].any()


@pytest.mark.parametrize("n", TRUTH)
@pytest.mark.parametrize("steps", [0.3, 1.0, 7.77])
@pytest.mark.parametrize("method", [ThreeModel(), OutputError()], ids=["ThreeModel", "OutputError"])
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.fast(
    "zoh-ThreeModel-7.77-*",
    "foh-ThreeModel-0.3-*",
    "zoh-OutputError-0.3-*",
    "foh-OutputError-1.0-*",
)
def test_noise_free_records_give_the_truth(n, steps, method, intersample):
    num, den = TRUTH[n]
    rng = np.random.default_rng(7)
    u = np.repeat(np.sign(rng.standard_normal(100)), 3) + 0.3
    model = TransferFunction(num, den, delay=steps * DT)
    y = simulate(model, Record(u, u, dt=DT, intersample=intersample))
    record = Record(u, y, dt=DT, intersample=intersample)
    estimate = identify(record, Structure(n, len(num) - 1, delay=steps * DT), method)
    assert estimate.theta == pytest.approx([*den[1:], *num], rel=1e-9)
    assert estimate.model.delay[0, 0] == steps * DT


DEN = [1.0, 1.4, 3.0]
NUM = [[[0.2, 0.5], [0.0, 1.0]], [[0.0, 0.4], [0.3, -2.0]]]
LATE = [[0.123, 0.4], [0.0, 1.27]]


def in_flight(jitter=0.0, seed=5):
    """A record cut out of a longer one: the inputs before it are at work and unknown."""
    rng = np.random.default_rng(seed)
    t = np.concatenate([[0.0], np.cumsum(0.1 * (1 + jitter * rng.uniform(-1, 1, 499)))]) + 7.0
    u = 0.2 * np.cumsum(rng.standard_normal((500, 2)), 0) + rng.standard_normal((500, 2))
    u += np.array([1.0, -3.0])
    model = TransferFunction(NUM, [[DEN] * 2] * 2, delay=LATE)
    y = simulate(model, Record(u, u, t=t)) + np.array([2.0, -1.0])
    return Record(u[120:], y[120:], t=t[120:])


@pytest.mark.parametrize("jitter", [0.0, 0.5])
@pytest.mark.parametrize("state", ["free", "auto"])
@pytest.mark.fast("auto-0.5", "free-0.0")
def test_an_unknown_past_does_not_bias(jitter, state):
    records = [in_flight(jitter, seed=k) for k in (5, 6)]
    structure = Structure(2, [[1, 0], [0, 1]], delay=LATE, initial_state=state, offset=True)
    estimate = identify(records, structure)
    assert any("output samples of every experiment" in d for d in estimate.trace.decisions)
    truth = [*DEN[1:], 0.2, 0.5, 1.0, 0.4, 0.3, -2.0]
    assert estimate.theta == pytest.approx(truth, rel=1e-9)
    for k, record in enumerate(records):
        start = int(np.searchsorted(record.t - record.t[0], 1.27 - 1e-9))
        residual = estimate.residual(record, experiment=k)
        assert np.isnan(residual[:start]).all()
        assert np.abs(residual[start:]).max() < 1e-11


def test_choices_are_compared_on_the_same_samples():
    record = in_flight()
    structure = Structure(2, [[1, 0], [0, 1]], delay=LATE, offset=True)
    choices = candidates([record], structure)
    base, variants = build_base([record], structure, choices)
    poles = np.roots(DEN).astype(complex)
    counts = {tuple(evaluate_variant(base, v, poles).counts) for v in variants}
    assert counts == {(380.0 - 13, 380.0 - 13)}
    assert {c.initial_state for c in choices} == {"rest", "equilibrium", "free"}


def test_equilibrium_of_a_delayed_system_is_found():
    """A trim on both sides, held before the record: no free response is needed."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(60), 5)
    u[:5] = 0.0
    model = TransferFunction([0.2, 0.5], DEN, delay=0.37)
    y = simulate(model, Record(u, u, dt=DT))[:, 0]
    record = Record(u + 4.0, y + 2.0 + 0.01 * rng.standard_normal(300), dt=DT)
    white = ThreeModel(noise="white")
    estimate = identify(record, Structure(2, 1, delay=0.37), white)
    assert estimate.nuisance[0].initial_state == "equilibrium"
    stated = identify(record, Structure(2, 1, delay=0.37, initial_state="equilibrium"), white)
    assert stated.degrees_of_freedom == estimate.degrees_of_freedom + 4  # ceil(0.37 / 0.1)
    assert stated.theta == pytest.approx(estimate.theta, rel=0.02)
    assert np.isfinite(stated.predict(record)).all()


def test_variants_are_the_problems_themselves():
    """Constants put back on delayed inputs, from the impulse that began later."""
    from tridentify.estimation.likelihood.cost import evaluate
    from tridentify.estimation.likelihood.setup.nuisance import build

    record = in_flight(0.3)
    structure = Structure(2, [[1, 0], [0, 1]], delay=LATE, offset=True)
    choices = candidates([record], structure)
    base, variants = build_base([record], structure, choices)
    poles = np.array([-0.5 + 1j, -0.5 - 1j])
    for choice, variant in zip(choices, variants, strict=True):
        own = evaluate(build([record], structure, choice), poles)
        assert evaluate_variant(base, variant, poles).rss == pytest.approx(own.rss, rel=1e-9)


def test_first_explained_sample():
    record = Record(np.arange(5.0), np.arange(5.0), dt=0.1)
    assert first_explained(record, Structure(1, 0, delay=0.3)) == 3
    assert first_explained(record, Structure(1, 0, delay=0.31)) == 4
    assert first_explained(record, Structure(1, 0, delay=0.3, initial_state="rest")) == 0


@pytest.mark.parametrize("delay", [29.9, 30.0, 1e9])
def test_a_delay_as_long_as_the_record_is_refused(delay):
    u = np.random.default_rng(1).standard_normal(300)
    with pytest.raises(errors.DelayError, match="shorter than the record"):
        identify(Record(u, u, dt=DT), Structure(1, 0, delay=delay))


def test_outputs_that_end_before_the_input_arrives_are_refused():
    u = np.random.default_rng(1).standard_normal(300)
    y = u.copy()
    y[40:] = np.nan
    with pytest.raises(errors.DelayError, match="after the delay"):
        identify(Record(u, y, dt=DT), Structure(1, 0, delay=4.0))


@pytest.mark.parametrize("delay", [-0.1, np.nan, np.inf])
def test_no_sensible_delay_is_refused(delay):
    with pytest.raises(errors.OptionError):
        Structure(1, 0, delay=delay)


@pytest.mark.parametrize(
    ("late", "words"),
    [(1, "the first output sample is not used"), (4, "the first 4 output samples are not used")],
)
def test_samples_before_a_delayed_input_are_counted_in_words(late, words):
    u = np.sign(np.sin(np.arange(300) ** 1.5))
    y = simulate(TransferFunction([2.0], [1.0, 4.0], delay=0.05 * late), Record(u, u, dt=0.05))
    y = y + 0.01 * np.random.default_rng(0).standard_normal(y.shape)
    structure = Structure(1, 0, delay=0.05 * late, initial_state="free")
    estimate = identify(Record(u, y, dt=0.05), structure, OutputError())
    assert any(words in line for line in estimate.trace.decisions)
