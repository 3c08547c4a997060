"""The optimal spectrum: against closed forms, a general solver, and the signals made of it."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

from tridentify import OutputError, Record, Structure, TransferFunction, identify, simulate
from tridentify.errors import OptionError, ParameterNameError, UndeterminedError
from tridentify.excitation import multisine, optimal_spectrum, precision
from tridentify.excitation.frequency import response_gradient

pytestmark = pytest.mark.unjudged

SECOND = TransferFunction([2.0], [1.0, 1.0, 9.0])
REST = {"offset": False, "initial_state": "rest"}


def per_line(model, structure, omega, theta):
    """(n_omega, p, p) information of lines of power one, in relative coefficients."""
    step = 1e-6
    shape = (model.n_outputs, model.n_inputs)
    slopes = []
    for k in range(theta.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = theta.copy()
            moved[k] *= 1.0 + sign * step
            num, den = structure.split(moved, *shape)
            one = TransferFunction(num, den, delay=model.delay)
            ends.append(one.frequency_response(omega)[:, 0, 0])
        slopes.append((ends[0] - ends[1]) / (2 * step))
    g = np.array(slopes).T
    return np.real(g.conj()[:, :, None] * g[:, None, :])


def test_derivatives_are_those_of_the_frequency_response():
    model = TransferFunction([3.0, 2.0], [1.0, 1.0, 9.0], delay=0.1)
    theta = np.array([1.0, 9.0, 3.0, 2.0, 0.1])
    omega = np.geomspace(0.1, 100.0, 7)
    g = response_gradient(model, Structure(2, 1, delay="free"), omega)[:, 0, 0]
    found = np.real(g.conj()[:, :, None] * g[:, None, :])
    num = Structure(2, 1, delay=0.1)
    expected = per_line(model, num, omega, theta[:4])
    np.testing.assert_allclose(found[:, :4, :4], expected, rtol=1e-6, atol=1e-8)
    late = TransferFunction([3.0, 2.0], [1.0, 1.0, 9.0], delay=0.1 + 1e-7)
    early = TransferFunction([3.0, 2.0], [1.0, 1.0, 9.0], delay=0.1 - 1e-7)
    slope = late.frequency_response(omega) - early.frequency_response(omega)
    np.testing.assert_allclose(g[:, 4], 0.1 * slope[:, 0, 0] / 2e-7, rtol=1e-5)


def test_gain_alone_is_told_best_where_the_response_is_largest():
    structure = Structure(2, 0, fixed={"a1": 1.0, "a0": 9.0})
    best = optimal_spectrum(SECOND, structure)
    (line,) = best.support
    assert line[0] == pytest.approx(np.sqrt(9.0 - 0.5), rel=0.02)
    assert line[2] > 0.97


def test_one_pole_has_the_line_of_the_closed_form():
    # det F at one line: b^2 w^2 / (w^2 + a^2)^4, largest at w = a / sqrt(3)
    best = optimal_spectrum(TransferFunction([5.0], [1.0, 3.0]), criterion="D")
    (line,) = best.support
    assert line[0] == pytest.approx(3.0 / np.sqrt(3.0), rel=0.03)


@pytest.mark.parametrize("criterion", ["A", "D"])
def test_no_general_solver_finds_better_powers(criterion):
    theta = np.array([1.0, 9.0, 2.0])
    omega = np.geomspace(0.5, 12.0, 14)
    best = optimal_spectrum(SECOND, Structure(2, 0), lines=omega, criterion=criterion)
    lines = per_line(SECOND, Structure(2, 0), omega, theta)

    def cost(power):
        cov = np.linalg.inv(np.tensordot(power, lines, 1))
        return np.log(np.trace(cov)) if criterion == "A" else np.linalg.slogdet(cov)[1]

    def softened(z):
        weights = np.exp(z - z.max())
        return cost(weights / weights.sum())

    other = scipy.optimize.minimize(softened, np.zeros(omega.size), method="BFGS")
    assert cost(best.power[:, 0]) <= other.fun + 4e-3
    assert other.fun < cost(np.full(omega.size, 1.0 / omega.size)) - 0.1
    assert best.efficiency >= 0.999


@pytest.mark.parametrize("criterion", ["A", "D"])
def test_the_certificate_is_the_equivalence_theorem(criterion):
    best = optimal_spectrum(SECOND, criterion=criterion)
    assert best.slopes.max() <= 1.0 + 4e-3
    where = best.power[:, 0] > 0.05
    np.testing.assert_allclose(best.slopes[where], 1.0, atol=0.01)
    assert best.power.sum() == pytest.approx(1.0)


def test_the_subset_of_interest_gets_the_power():
    every = optimal_spectrum(SECOND)
    one = optimal_spectrum(SECOND, coefficients=["b0"])
    assert one.coefficients == ("b0",)
    assert one.relative_per_sample[0] < every.relative_per_sample[2]


@pytest.mark.parametrize("rate", [1e-6, 1e6])
@pytest.mark.fast("1e-06")
def test_time_scale_does_not_matter(rate):
    fast = TransferFunction([2.0 * rate**2], [1.0, rate, 9.0 * rate**2])
    best, other = optimal_spectrum(SECOND), optimal_spectrum(fast)
    np.testing.assert_allclose(other.omega, rate * best.omega, rtol=1e-9)
    np.testing.assert_allclose(other.power, best.power, atol=1e-6)


def test_every_input_keeps_to_its_own_limit():
    model = TransferFunction([[[2.0], [1.0, 3.0]]], [1.0, 1.0, 9.0])
    best = optimal_spectrum(model, limit=[1.0, 3.0])
    np.testing.assert_allclose(best.power.sum(axis=0), [1.0, 9.0])
    plan = best.excitation(60.0, 0.05)
    np.testing.assert_allclose(plan.amplitude, [1.0, 3.0])
    gram = plan.u.T @ plan.u
    assert abs(gram[0, 1]) < 1e-9 * gram.max()


def test_a_long_multisine_reaches_what_the_spectrum_promises():
    best = optimal_spectrum(SECOND, Structure(2, 0, **REST), noise_std=0.1)
    plan = best.excitation(400.0, 0.05)
    ahead = precision(SECOND, plan, best.structure, noise_std=0.1)
    promised = best.relative_per_sample / np.sqrt(plan.n_samples) * plan.crest_factor[0]
    np.testing.assert_allclose(ahead.relative, promised, rtol=0.02)


@pytest.mark.slow
def test_no_multisine_of_the_same_power_is_better():
    structure = Structure(2, 0, **REST)
    best = optimal_spectrum(SECOND, structure, noise_std=0.1)
    plan = best.excitation(200.0, 0.05)
    least = np.sum(precision(SECOND, plan, structure, noise_std=0.1).relative ** 2)
    rng = np.random.default_rng(0)
    for _ in range(20):
        lines = np.sort(rng.choice(np.arange(10, 300), 3, replace=False))
        other = multisine(200.0, dt=0.05, harmonics=lines.tolist(), power=rng.uniform(0.1, 1, 3))
        other = other.scaled(plan.rms / other.rms)
        rival = precision(SECOND, other, structure, noise_std=0.1).relative
        assert np.sum(rival**2) > 0.99 * least


@pytest.mark.slow
@pytest.mark.judged
def test_the_binary_signal_has_crest_factor_one_and_is_compared():
    best = optimal_spectrum(SECOND, Structure(2, 0, **REST), noise_std=0.1, limit=0.5)
    plan = best.excitation(60.0, 0.05, shape="binary")
    assert set(np.unique(plan.u)) == {-0.5, 0.5}
    rows = best.compare(60.0, 0.05)
    assert len(rows) == 6
    for other, _ in rows:
        assert other.amplitude[0] == pytest.approx(0.5)
        assert other.n_samples <= 1200
    text = best.summary(60.0, 0.05)
    assert "certified" in text
    assert "PRBS" in text
    assert "3-2-1-1" in text
    assert "<table>" in best._repr_html_()


@pytest.mark.slow
def test_of_an_estimate_the_spectrum_is_for_all_that_the_plant_may_be():
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 5)
    y = simulate(SECOND, Record(u, u, dt=0.1))[:, 0] + 0.2 * rng.standard_normal(200)
    found = identify(Record(u, y, dt=0.1), Structure(2, 0, **REST), OutputError())
    best = optimal_spectrum(found, n_models=8)
    alone = optimal_spectrum(found, n_models=1)
    assert best.n_models > 1
    assert alone.n_models == 1
    assert np.abs(best.power - alone.power).max() > 0.01
    assert best.efficiency >= 0.999


@pytest.mark.slow
def test_an_integrator_that_was_identified_keeps_its_draws():
    rng = np.random.default_rng(3)
    model = TransferFunction([2.0], [1.0, 3.0, 0.0])
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 5)
    y = simulate(model, Record(u, u, dt=0.1))[:, 0] + 0.02 * rng.standard_normal(200)
    structure = Structure(2, 0, fixed={"a0": 0.0}, drift=False, **REST)
    found = identify(Record(u, y, dt=0.1), structure, OutputError())
    best = optimal_spectrum(found, n_models=6)
    assert best.n_models == 6
    assert best.coefficients == ("a1", "b0")
    ahead = precision(found, best.excitation(60.0, 0.1))
    assert len(ahead.draws) > 30
    assert ahead.std[1] == 0.0


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: optimal_spectrum(SECOND, criterion="E"), OptionError, "criterion"),
        (lambda: optimal_spectrum(SECOND, limit=-1.0), OptionError, "limit"),
        (lambda: optimal_spectrum(SECOND, band=(2.0, 1.0)), OptionError, "band"),
        (lambda: optimal_spectrum(SECOND, lines=[1.0, 0.5]), OptionError, "rising"),
        (lambda: optimal_spectrum(SECOND, band=(1, 2), lines=[1.0]), OptionError, "one of the two"),
        (lambda: optimal_spectrum(SECOND, coefficients=["b7"]), ParameterNameError, "b7"),
        (lambda: optimal_spectrum(SECOND, lines=[1.0]), UndeterminedError, "widen"),
        (
            lambda: optimal_spectrum(SECOND, Structure(2, 1), coefficients=["b1"]),
            OptionError,
            "other than zero",
        ),
        (lambda: optimal_spectrum(SECOND).excitation(10.0, 1.5), OptionError, "sample faster"),
        (lambda: optimal_spectrum(SECOND).excitation(shape="square"), OptionError, "shape"),
    ],
)
def test_what_has_no_optimum_is_refused(call, error, words):
    with pytest.raises(error, match=words):
        call()
