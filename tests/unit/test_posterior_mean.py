"""The posterior mean against quadrature, and when `ThreeModel` ends on it."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.special import ndtr

from tridentify import (
    Estimate,
    Parameter,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.errors import OptionError
from tridentify.estimation.answer.estimate import Status
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.posterior import maximum_or_mean as weighing
from tridentify.estimation.posterior.many_cascades import coordinates
from tridentify.estimation.posterior.mean import LONGEST, Posterior, posterior, vagueness
from tridentify.estimation.posterior.surface import surface, unit_of
from tridentify.models.regression import Experiment
from tridentify.numerics.realization import denominator, sort_poles

pytestmark = pytest.mark.unjudged

REST = {"offset": False, "initial_state": "rest"}
SECOND = Structure(2, 0, **REST)
AIRCRAFT = TransferFunction([0.5], [1.0, 1.0, 3.0])
TRUTH = np.array([1.0, 3.0, 0.5])
DT = 0.05


def noisy(ratio, seed=0, *, model=AIRCRAFT, n_samples=100, dt=DT, scale=1.0):
    """Step record with noise of ``ratio`` times the root mean square of the output."""
    u = np.ones(n_samples)
    clean = simulate(model, Record(u, u, dt=dt)).ravel()
    std = ratio * np.sqrt(np.mean(clean**2))
    noise = std * np.random.default_rng(seed).standard_normal(n_samples)
    return Record(u, scale * (clean + noise), dt=dt)


def problem_of(record, n, m=0):
    e = Experiment(record.u.copy(), record.y.copy(), record.dt, "zoh", False, False, False)
    return Problem.of([e], n, ((m,),))


def run(record, finish="posterior", structure=SECOND):
    return identify(record, structure, ThreeModel(noise="white", finish=finish), throw=False)


# --------------------------------------------------------------------------------- dense quadrature
class Dense:
    """The same density on a rank-one lattice that fills a box of coordinates, as weights."""

    def __init__(self, problem, low, high, count):
        self.unit, self.n = unit_of(problem), problem.n_poles
        share = (np.arange(count)[:, None] + 0.5) * STRIDES[self.n]
        share = np.modf(share / [count, 1.0][: self.n])[0]
        low, high = np.log(low), np.log(high)
        self.found = surface(problem, low + (high - low) * share)
        self.weights = np.exp(self.found.log_density - self.found.log_density.max())
        self.weights /= self.weights.sum()
        edge = np.any(np.abs(share - 0.5) > 0.49, axis=1)
        assert self.weights[edge].sum() < 1e-3, "the box ends where there still is something"
        assert np.sum(self.weights**2) < 1.0 / 100.0, "the lattice is too coarse"
        self.order = np.arange(1, self.n + 1)
        self.a = self.found.denominators / self.unit**self.order

    def pitman(self):
        """Minimises the expected squared error relative to powers of the mean pole size."""
        size = (self.found.scale / self.unit)[:, None] ** -(2.0 * self.order)
        return (self.weights @ (self.a * size)) / (self.weights @ size)

    def error(self, effective):
        """Standard error of `pitman` from so many draws (delta method)."""
        size = (self.found.scale / self.unit)[:, None] ** -(2.0 * self.order)
        mean = self.weights @ size
        influence = size * (self.a - self.pitman()) / mean
        return np.sqrt(self.weights @ influence**2 / effective)

    def probability(self, values, k):
        """Posterior probability that ``a_{n-1-k}`` lies below each value."""
        order = np.argsort(self.a[:, k])
        below = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
        return np.interp(values, self.a[order, k], below)

    def probability_b(self, values):
        """As `probability` for ``b_0``, Gaussian about least squares at each denominator."""
        mean = self.found.numerators[:, 0] / self.unit**self.n
        std = np.abs(self.found.roots[:, 0, 0]) / self.unit**self.n
        return np.array([self.weights @ ndtr((value - mean) / std) for value in values])


STRIDES = {1: np.array([1.0]), 2: np.array([1.0, 0.5 * (np.sqrt(5.0) - 1.0)])}
LAG = TransferFunction([2.0], [1.0, 1.5])
LEVELS = np.array([0.025, 0.16, 0.5, 0.84, 0.975])
STARTS = {
    "nowhere": [],
    "at the maximum": [(np.array([-1.5 + 0j]), np.array([[0.2]]))],
    "misplaced": [(np.array([-0.4 + 0j]), np.array([[1e-8]]))],
    "without covariance": [(np.array([-3.0 + 0j]), None)],
}


@pytest.fixture(scope="module", params=[0.5, 1.5])
def one_pole(request):
    problem = problem_of(noisy(request.param, model=LAG, n_samples=60), 1)
    return problem, Dense(problem, [1e-5], [300.0], 4000)


@pytest.mark.parametrize("start", STARTS)
def test_one_pole_is_quadrature(one_pole, start):
    problem, dense = one_pole
    found = posterior(problem, STARTS[start])
    assert found.usable
    assert found.effective >= 400.0
    error = abs(-found.poles[0].real - dense.pitman()[0])
    assert error < 4.0 * dense.error(found.effective)[0]
    sampling = 4.0 * np.sqrt(LEVELS * (1.0 - LEVELS) / found.effective)
    a, b = np.quantile(found.draws, LEVELS, axis=0).T
    assert np.all(np.abs(dense.probability(a, 0) - LEVELS) < sampling)
    # b has a scatter of its own about least squares, drawn for each of the draws that are kept
    own = 1.0 + found.effective / len(found.draws)
    assert np.all(np.abs(dense.probability_b(b) - LEVELS) < np.sqrt(own) * sampling)


BOXES = {0.3: ((0.06, 0.12), (0.12, 0.6)), 1.0: ((0.03, 5e-4), (0.8, 4.0))}


@pytest.fixture(scope="module", params=BOXES)
def two_poles(request):
    problem = problem_of(noisy(request.param), 2)
    return problem, Dense(problem, *BOXES[request.param], 12_000)


@pytest.mark.parametrize("near", [[], [(np.roots([1.0, 1.0, 3.0]), np.diag([0.2, 0.4]))]])
def test_two_poles_are_quadrature(two_poles, near):
    problem, dense = two_poles
    found = posterior(problem, near)
    mean = denominator(found.poles)[1:]
    assert np.all(np.abs(mean - dense.pitman()) < 4.0 * dense.error(found.effective))
    sampling = 4.0 * np.sqrt(LEVELS * (1.0 - LEVELS) / found.effective) + 0.01
    quantiles = np.quantile(found.draws, LEVELS, axis=0).T
    for k in range(2):
        assert np.all(np.abs(dense.probability(quantiles[k], k) - LEVELS) < sampling)
    assert np.all(np.abs(dense.probability_b(quantiles[2]) - LEVELS) < sampling)


def test_the_end_of_a_search_leads_to_light_damping():
    """Far below the first box, which begins at 0.02."""
    poles = 5.0 * np.array([-0.003 + 1j, -0.003 - 1j])
    den = np.poly(poles).real
    u = np.zeros(200)
    u[5:15], u[15:25] = 1.0, -1.0
    clean = simulate(TransferFunction([den[-1]], den), Record(u, u, dt=DT)).ravel()
    y = clean + 0.3 * np.std(clean) * np.random.default_rng(0).standard_normal(200)
    problem = problem_of(Record(u, y, dt=DT), 2)
    dense = Dense(problem, (0.248, 1e-5), (0.252, 0.02), 8000)
    found = posterior(problem, [(poles, None)])
    assert found.effective >= 60.0
    sampling = 4.0 * np.sqrt(LEVELS * (1.0 - LEVELS) / found.effective) + 0.01
    quantiles = np.quantile(found.draws, LEVELS, axis=0).T
    for k in range(2):
        assert np.all(np.abs(dense.probability(quantiles[k], k) - LEVELS) < sampling)


def test_draws_are_of_admissible_shape():
    found = posterior(problem_of(noisy(1.0), 3, 1), [])
    assert found.draws.shape == (1000, 5)
    assert np.all(np.isfinite(found.draws))
    assert np.all(found.draws[:, :3] > 0.0)
    assert np.all(found.draws[:, 0] * found.draws[:, 1] > found.draws[:, 2]), "Hurwitz"
    assert np.all(found.poles.real < 0.0)
    assert 1.0 <= found.effective <= found.evaluated


def test_covariance_is_that_of_gaussian_draws():
    rng = np.random.default_rng(0)
    root = np.array([[2.0, 0.0], [-1.0, 0.5]])
    draws = rng.standard_normal((200_000, 2)) @ root.T
    found = Posterior(np.array([-1.0 + 0j]), draws, 1.0, 1).covariance_about(np.zeros(2))
    assert found == pytest.approx(root @ root.T, rel=0.02)


def test_covariance_forgives_a_far_draw():
    draws = np.random.default_rng(0).standard_normal((10_000, 2))
    before = Posterior(np.zeros(1), draws, 1.0, 1).covariance_about(np.zeros(2))
    draws[0] = 1e12
    after = Posterior(np.zeros(1), draws, 1.0, 1).covariance_about(np.zeros(2))
    assert after == pytest.approx(before, abs=0.01)


def test_the_error_of_a_mean_in_the_tail_reaches_the_bulk():
    draws = np.random.default_rng(0).standard_normal((10_000, 1))
    (variance,) = Posterior(np.zeros(1), draws, 1.0, 1).covariance_about(np.array([4.0])).ravel()
    assert 2.0 < np.sqrt(variance) < 4.0


# --------------------------------------------------------------------------------------- vagueness
def test_vagueness_of_a_lag_is_its_relative_standard_error():
    found = vagueness(np.array([-2.0 + 0j]), np.array([[0.09]]), 100.0)
    assert found == pytest.approx(0.3 / 2.0)


def test_a_lag_slower_than_the_record_is_measured_against_its_length():
    found = vagueness(np.array([-1e-3 + 0j]), np.array([[0.09]]), 5.0)
    assert found == pytest.approx(0.3 / (1.0 / 5.0), rel=1e-6)


@pytest.mark.parametrize("c", [0.4, 5.0])
@pytest.mark.parametrize("length", [1000.0, 0.1])
def test_vagueness_of_a_section_is_that_of_its_coefficients(c, length):
    d = 4.0
    cov = np.array([[0.04, 0.03], [0.03, 0.25]])
    size_c = max(c, np.sqrt(d), 1.0 / length)
    size_d = max(d, c / length, 1.0 / length**2)
    expected = max(0.2 / size_c, 0.5 / size_d)
    poles = sort_poles(np.roots([1.0, c, d]).astype(complex))
    assert vagueness(poles, cov, length) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_vagueness_of_the_third_order_takes_the_worst_coefficient(which):
    """``(p^2 + c p + d)(p + s)``; the covariance is made from known ones of c, d and s."""
    c, d, s = 0.6, 4.0, 7.0
    std = np.array([0.01, 0.01, 0.01])
    std[which] = 0.5
    jacobian = np.array([[1.0, 0.0, 1.0], [s, 1.0, c], [0.0, s, d]])
    cov = jacobian @ np.diag(std**2) @ jacobian.T
    poles = sort_poles(np.roots(np.polymul([1.0, c, d], [1.0, s])).astype(complex))
    expected = (std / [np.sqrt(d), d, s])[which]
    assert vagueness(poles, cov, 1e3) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("factor", [1e6, 1e-6])
def test_vagueness_has_no_unit_of_time(factor):
    poles = np.array([-0.3 + 2j, -0.3 - 2j, -1.0, -1.7])
    root = np.random.default_rng(0).normal(size=(4, 4))
    scale = factor ** np.arange(1.0, 5.0)
    before = vagueness(poles, root @ root.T, 30.0)
    after = vagueness(poles * factor, root @ root.T * np.outer(scale, scale), 30.0 / factor)
    assert after == pytest.approx(before, rel=1e-6)


# ------------------------------------------------------------------------------ through `identify`
@pytest.fixture(scope="module")
def short():
    record = noisy(1.0)
    return record, run(record)


def test_the_status_and_the_trace_say_so(short):
    _, estimate = short
    assert estimate.status is Status.POSTERIOR_MEAN
    assert estimate.status.ok
    told = estimate.trace.decisions[-1]
    assert "posterior mean" in told
    assert "as asked for" in told
    assert "denominators weighed" in estimate.trace.stopped
    assert estimate.trace.passes[-1].steps[0].name == "posterior"
    assert estimate.trace.passes[-1].theta == pytest.approx(estimate.theta)


def test_numerators_are_least_squares_at_the_mean(short):
    record, estimate = short
    poles = sort_poles(np.roots([1.0, *estimate.theta[:2]]).astype(complex))
    assert estimate.theta == pytest.approx(coefficients(evaluate(problem_of(record, 2), poles)))


def test_draws_are_there_to_read_only(short):
    _, estimate = short
    assert estimate.draws.shape == (1000, 3)
    assert np.all(np.isfinite(estimate.draws))
    assert not estimate.draws.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        estimate.draws[0, 0] = 1.0


def test_intervals_are_quantiles_of_the_draws(short):
    _, estimate = short
    for k, parameter in enumerate(estimate.parameters.values()):
        share = np.mean(estimate.draws[:, k] < parameter.value)
        assert 0.02 < share < 0.98
        expected = np.quantile(estimate.draws[:, k], [0.1 * share, 0.9 + 0.1 * share])
        assert parameter.interval(0.9) == pytest.approx(tuple(expected))
        ends = [0.3173105 * share, 1.0 - 0.3173105 * (1.0 - share)]
        low, high = np.quantile(estimate.draws[:, k], ends)
        assert parameter.std == pytest.approx((high - low) / 2.0, rel=1e-4)


def test_save_and_load_keep_draws_and_intervals(short, tmp_path):
    _, estimate = short
    loaded = Estimate.load(estimate.save(tmp_path / "estimate.json"))
    assert loaded.status is Status.POSTERIOR_MEAN
    assert np.array_equal(loaded.draws, estimate.draws)
    assert not loaded.draws.flags.writeable
    assert loaded.trace.decisions == estimate.trace.decisions
    for name, parameter in estimate.parameters.items():
        assert loaded.parameters[name].interval() == parameter.interval()


def test_the_same_record_gives_the_same_draws(short):
    record, estimate = short
    again = run(record)
    assert np.array_equal(again.theta, estimate.theta)
    assert np.array_equal(again.draws, estimate.draws)


@pytest.mark.parametrize("factor", [1e6, 1e-6])
@pytest.mark.fast("1e-06")
def test_another_unit_of_time_scales_the_mean(short, factor):
    record, estimate = short
    slow = run(Record(record.u, record.y, dt=DT * factor))
    scale = factor ** np.array([1.0, 2.0, 2.0])
    assert slow.status is Status.POSTERIOR_MEAN
    assert slow.theta * scale == pytest.approx(estimate.theta, rel=1e-6)
    assert slow.std * scale == pytest.approx(estimate.std, rel=1e-6)


@pytest.mark.parametrize("factor", [1e3, 1e-9])
@pytest.mark.fast("1e-09")
def test_another_unit_of_the_output_scales_the_numerator(short, factor):
    record, estimate = short
    other = run(Record(record.u, factor * record.y, dt=DT))
    scale = np.array([1.0, 1.0, factor])
    assert other.status is Status.POSTERIOR_MEAN
    assert other.theta == pytest.approx(estimate.theta * scale, rel=1e-6, abs=0.0)
    assert other.std == pytest.approx(estimate.std * scale, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("factor", [1e4, -1e-4])
@pytest.mark.fast("10000.0")
def test_another_unit_of_the_input_scales_the_numerator_back(short, factor):
    record, estimate = short
    other = run(Record(factor * record.u, record.y, dt=DT))
    expected = estimate.theta / [1.0, 1.0, factor]
    assert other.theta == pytest.approx(expected, rel=1e-6, abs=0.0)


def test_several_channels_and_records():
    """Two outputs, two records, offsets: the draws follow the order of the names."""
    rng = np.random.default_rng(3)
    model = TransferFunction([[[1.0, 2.0]], [[-4.0]]], [[[1.0, 1.2, 4.0]]] * 2)
    records = []
    for n_samples in (60, 80):
        u = np.repeat(rng.standard_normal(-(-n_samples // 10)), 10)[:n_samples]
        y = simulate(model, Record(u, u, dt=0.1))
        records.append(Record(u, y + 1.0 + 0.8 * rng.standard_normal(y.shape), dt=0.1))
    structure = Structure(2, [[1], [0]], offset=True, initial_state="rest")
    estimate = identify(records, structure, ThreeModel(noise="white", finish="posterior"))
    assert estimate.status is Status.POSTERIOR_MEAN
    assert estimate.draws.shape == (1000, len(estimate.names))
    truth = np.array([1.2, 4.0, 1.0, 2.0, -4.0])
    assert np.all(np.abs(estimate.theta - truth) < 4.5 * estimate.std)
    middle = np.median(estimate.draws, axis=0)
    assert np.all(np.abs(estimate.theta - middle) < 1.5 * estimate.std)


def late_motor():
    """Little noise, a delay not stated, needless zeros: the likely models form a curve."""
    rng = np.random.default_rng(0)
    motor = TransferFunction([900.0], [1.0, 27.5, 62.5], delay=0.045)
    u = np.repeat(rng.choice([-6.0, 6.0], 80), rng.integers(5, 60, 80))[:1500]
    clean = simulate(motor, Record(u, u, dt=0.01))[:, 0]
    return Record(u, clean + 0.02 * clean.std() * rng.standard_normal(1500), dt=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("finish", ["auto", "posterior"])
def test_the_mean_of_models_on_a_curve_explains_the_record(finish):
    found = identify(late_motor(), Structure(4, 3), ThreeModel(finish=finish))
    assert found.fit[0] > 97.8
    for parameter in (*found.parameters.values(), *found.derived()):
        low, high = parameter.interval()
        assert low <= parameter.value <= high


@pytest.mark.slow
def test_with_more_draws_it_still_does(monkeypatch):
    monkeypatch.setattr("tridentify.estimation.posterior.mean.ROUND", 6_000)
    method = ThreeModel(finish="posterior")
    assert method.estimate([late_motor()], Structure(4, 3)).fit[0] > 97.8


# ------------------------------------------------------------------------------ the finish option
@pytest.mark.parametrize("ratio", [0.05, 1.0, 3.0])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.fast("0-1.0", "1-0.05")
def test_likelihood_never_gives_it_and_posterior_always(ratio, seed):
    record = noisy(ratio, seed)
    likelihood, mean = run(record, "likelihood"), run(record, "posterior")
    assert likelihood.status is not Status.POSTERIOR_MEAN
    assert likelihood.draws.shape == (0, 3)
    assert mean.status is Status.POSTERIOR_MEAN
    cost = [np.sum(e.residual(record) ** 2) for e in (likelihood, mean)]
    assert cost[0] <= cost[1] * (1.0 + 1e-9)


@pytest.mark.parametrize("finish", ["auto", "likelihood", "posterior"])
@pytest.mark.parametrize("model", [LAG, AIRCRAFT])
def test_noise_free_records_never(finish, model):
    order = len(model.den[0][0]) - 1
    estimate = run(noisy(0.0, model=model), finish, Structure(order, 0, **REST))
    assert estimate.status is Status.CONVERGED
    truth = [*model.den[0][0][1:], *model.num[0][0]]
    assert estimate.theta == pytest.approx(truth, rel=1e-7)


def test_long_records_never():
    record = noisy(0.3, model=LAG, n_samples=LONGEST + 1, dt=1e-3)
    estimate = run(record, "posterior", Structure(1, 0, **REST))
    assert estimate.status is Status.CONVERGED


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.fast("1")
def test_a_well_identified_record_stays_on_the_maximum(seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(np.sign(rng.standard_normal(50)), 8)
    clean = simulate(AIRCRAFT, Record(u, u, dt=DT))
    record = Record(u, clean + 0.3 * np.std(clean) * rng.standard_normal(clean.shape), dt=DT)
    auto, likelihood = run(record, "auto"), run(record, "likelihood")
    assert auto.status is Status.CONVERGED
    assert np.array_equal(auto.theta, likelihood.theta)
    assert auto.draws.shape == (0, 3)
    # Both finishes then agree within a fraction of a standard error.
    mean = run(record, "posterior")
    assert np.all(np.abs(mean.theta - auto.theta) < 0.3 * auto.std)
    assert mean.std == pytest.approx(auto.std, rel=0.2)


@pytest.mark.slow
def test_a_short_noisy_record_leaves_it_and_says_why():
    estimate = run(noisy(3.0, 1), "auto")
    assert estimate.status is Status.POSTERIOR_MEAN
    told = estimate.trace.decisions[-1]
    assert "natural size" in told or "no usable end" in told or "elsewhere" in told


@pytest.fixture(scope="module")
def unseen_pair():
    """A slow pair that 600 quiet samples show well, and a fast one that they hardly show."""
    rng = np.random.default_rng(4)
    fast = [1.0, 40.0, 3000.0]
    model = TransferFunction([-7.0 * 3000.0, -6.5 * 3000.0], np.polymul([1.0, 2.5, 6.35], fast))
    u = np.repeat([0.0, 1.0, -1.0, 1.0, -1.0, 0.0], [30, 75, 50, 25, 25, 395])
    clean = simulate(model, Record(u, u, dt=0.04, intersample="foh"))[:, 0]
    noise = 0.05 * clean.std() * rng.standard_normal(u.size)
    record = Record(u, clean + noise, dt=0.04, intersample="foh")
    return record, run(record, "auto", Structure(4, 3, **REST))


@pytest.mark.slow
def test_every_value_lies_in_its_interval(unseen_pair):
    """The mean of whole denominators moved the slow pair along with the fast one."""
    _, estimate = unseen_pair
    assert estimate.status is Status.POSTERIOR_MEAN
    for quantity in (*estimate.parameters.values(), *estimate.derived()):
        low, high = quantity.interval()
        assert low <= quantity.value <= high, quantity.name
    slow = next(q for q in estimate.derived() if q.name == "natural frequency 1")
    shown = estimate.model.natural_frequency.min()
    assert slow.interval()[0] < shown < slow.interval()[1]


@pytest.mark.slow
def test_it_explains_the_record_nearly_as_well_as_the_maximum(unseen_pair):
    record, estimate = unseen_pair
    best = run(record, "likelihood", Structure(4, 3, **REST))
    assert estimate.fit[0] > best.fit[0] - 0.1


@pytest.mark.slow
def test_a_mean_that_explains_the_record_worse_than_allowed_is_not_given(unseen_pair, monkeypatch):
    monkeypatch.setattr(weighing, "RIVAL", -1.0)
    found = run(unseen_pair[0], "auto", Structure(4, 3, **REST))
    assert found.status in weighing.SOUND
    assert any("does not explain it" in line for line in found.trace.decisions)


def test_the_reason_names_what_the_record_does_not_see(unseen_pair):
    record, estimate = unseen_pair
    told = estimate.trace.decisions[-1]
    assert f"{record.n_samples} samples" in told
    assert "of the poles near" in told
    near = float(told.split("near ")[1].split()[0])
    assert near > 10.0
    assert "short" not in estimate.status.message + told


def test_intervals_are_drawn_out_to_a_mean_in_the_tail():
    draws = np.linspace(2.0, 3.0, 101)
    low, high = Parameter("a0", 1.5, 0.3, "", draws).interval()
    assert high == pytest.approx(2.95)
    assert np.log(1.5 / low) == pytest.approx(0.1 * np.log(high / 1.5))
    assert Parameter("a0", 2.5, 0.3, "", draws).interval() == pytest.approx((2.025, 2.975))
    ends = 2.0 + 0.05 * 20.5 / 101, 2.95 + 0.05 * 20.5 / 101
    assert Parameter("a0", 2.2, 0.3, "", draws).interval() == pytest.approx(ends)


@pytest.mark.parametrize("finish", ["mean", "", "Posterior", None, True, 1])
def test_an_unknown_finish_is_refused(finish):
    with pytest.raises(OptionError, match=r"finish=.*'auto', 'likelihood' or 'posterior'"):
        ThreeModel(finish=finish)


def test_the_default_is_auto():
    assert ThreeModel().finish == "auto"
    assert dataclasses.replace(ThreeModel(), finish="likelihood") == ThreeModel(finish="likelihood")


def test_coordinates_cover_every_pairing_of_the_same_poles():
    """The mean does not depend on how real poles were paired where the search ended."""
    problem = problem_of(noisy(1.0, n_samples=60), 2)
    poles = np.array([-1.0 + 0j, -4.0 + 0j])
    found = [posterior(problem, [(one, None)]) for one in (poles, poles[::-1])]
    assert np.array_equal(coordinates(poles), coordinates(poles[::-1]))
    for one, other in itertools.pairwise(found):
        assert np.array_equal(one.draws, other.draws)
