"""The output-error method by hand: one start, an honest end, the bound where the start is good."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import cramer_rao, register
from tridentify import (
    OutputError,
    Record,
    Status,
    Structure,
    ThreeModel,
    TransferFunction,
    TridentifyError,
    identify,
    simulate,
)
from tridentify import errors as err
from tridentify.studies.cramer_rao import output_sensitivities

pytestmark = pytest.mark.unjudged

PLANT = TransferFunction([3.0], [1.0, 4.0, 3.0])
AT_REST = Structure(2, 0, offset=False, initial_state="rest")
DT = 0.05


PRBS = register(7, (7, 6), 1016, 8)


def noisy(model, u, snr, seed, dt=DT):
    clean = simulate(model, Record(u, u, dt=dt))
    sigma = np.std(clean, axis=0) * 10 ** (-snr / 20)
    noise = np.random.default_rng(seed).standard_normal(clean.shape)
    return Record(u, clean + sigma * noise, dt=dt)


@pytest.mark.parametrize("den", [[1.0, 1.0, 1.0], [1.0, 20.0, 80.0], [1.0, 0.5, 6.0]])
def test_decent_starts_end_on_the_same_stationary_point(den):
    record = noisy(PLANT, PRBS, 10, 0)
    found = identify(record, AT_REST, OutputError(TransferFunction([7.0], den)))
    reference = identify(record, AT_REST, ThreeModel())
    assert found.status is Status.CONVERGED
    assert found.gradient < 1e-4
    assert np.allclose(found.theta, reference.theta, rtol=1e-5)
    assert np.allclose(found.cov, reference.cov, rtol=1e-3)


def test_numerator_of_the_start_does_not_matter():
    record = noisy(PLANT, PRBS, 10, 0)
    first, second = (
        identify(record, AT_REST, OutputError(TransferFunction(num, [1.0, 2.0, 2.0])))
        for num in ([1.0], [-40.0, 2.0])
    )
    assert np.array_equal(first.theta, second.theta)


def test_trace_begins_at_the_start_given():
    record = noisy(PLANT, PRBS, 10, 0)
    start = TransferFunction([1.0], [1.0, 2.0, 5.0])
    estimate = identify(record, AT_REST, OutputError(start))
    first = estimate.trace.passes[0]
    assert np.allclose(first.theta[:2], [2.0, 5.0])
    assert estimate.trace.starts[0].name == "the start given"
    assert estimate.trace.starts[0].cost == first.cost
    assert first.cost > 1.1 * estimate.cost
    costs = [p.cost for p in estimate.trace.passes]
    assert costs == sorted(costs, reverse=True)


def test_own_start_is_the_series_parallel_model_of_the_raw_record():
    estimate = identify(noisy(PLANT, PRBS, 10, 0), AT_REST, OutputError())
    (start,) = estimate.trace.starts
    assert "state-variable" in start.name
    # biased, as its equations have the square of the noise in them
    assert 2.5 < start.theta[0] < 3.9


def test_start_on_the_end_stays_there():
    record = noisy(PLANT, PRBS, 10, 0)
    first = identify(record, AT_REST, OutputError())
    again = identify(record, AT_REST, OutputError(first.model))
    assert np.allclose(again.theta, first.theta, rtol=1e-6)
    assert again.status is Status.CONVERGED
    assert len(again.trace.passes) <= 2


def test_unstable_start_is_reflected_and_said():
    record = noisy(PLANT, PRBS, 10, 0)
    mirrored = OutputError(TransferFunction([1.0], [1.0, -2.0, 2.0]))
    upright = OutputError(TransferFunction([1.0], [1.0, 2.0, 2.0]))
    found = identify(record, AT_REST, mirrored)
    assert "reflected" in found.trace.starts[0].name
    assert np.allclose(found.theta, identify(record, AT_REST, upright).theta, rtol=1e-9)


def test_a_bad_start_is_not_rescued():
    """Two resonances and a start of four real poles: no search hides where that ends."""
    plant = TransferFunction([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0])
    record = noisy(plant, register(10, (10, 7), 3000, 7), 10, 1, dt=0.01)
    structure = Structure(4, 1, offset=False, initial_state="rest")
    bad = OutputError(TransferFunction([1.0], np.poly([-1.0, -2.0, -3.0, -4.0])))
    found = identify(record, structure, bad, throw=False)
    assert not found.status.ok
    assert found.cost > 2.0 * identify(record, structure, ThreeModel()).cost
    with pytest.raises(TridentifyError):
        identify(record, structure, bad)


def test_few_passes_are_not_called_converged():
    start = OutputError(TransferFunction([1.0], [1.0, 40.0, 900.0]), max_passes=1)
    record = noisy(PLANT, PRBS, 10, 0)
    estimate = identify(record, AT_REST, start, throw=False)
    assert estimate.status is Status.MAX_PASSES
    with pytest.raises(err.ConvergenceError):
        identify(record, AT_REST, start)


def test_shared_denominator_of_several_outputs_with_missing_samples():
    plant = TransferFunction([[[-7.0, -6.5]], [[-0.1, -5.0]]], [1.0, 2.4, 6.3])
    whole = noisy(plant, PRBS, 20, 2)
    y = whole.y.copy()
    y[200:260, 0] = np.nan
    y[500:505, 1] = np.nan
    record = Record(whole.u, y, dt=DT)
    structure = Structure(2, 1, offset=False, initial_state="rest")
    truth = np.array([2.4, 6.3, -7.0, -6.5, -0.1, -5.0])
    given = OutputError(TransferFunction([[[1.0]], [[1.0]]], [1.0, 1.0, 2.0]))
    for method in (OutputError(), given):
        estimate = identify(record, structure, method)
        assert np.all(np.abs(estimate.theta - truth) < 4 * estimate.std)


@pytest.mark.parametrize("rate", [1e-6, 1e6])
def test_fast_and_slow_systems_are_alike(rate):
    record = noisy(PLANT, PRBS, 10, 0)
    other = Record(record.u, record.y, dt=DT / rate)
    scale = np.array([rate, rate**2, rate**2])
    first = identify(record, AT_REST, OutputError())
    second = identify(other, AT_REST, OutputError())
    assert np.allclose(second.theta / scale, first.theta, rtol=1e-6)


MIMO = TransferFunction([[[1.0]], [[1.0]]], [1.0, 1.0, 2.0])
REFUSED = {
    "too low an order": lambda: OutputError(TransferFunction([1.0], [1.0, 2.0])),
    "too high an order": lambda: OutputError(TransferFunction([1.0], [1.0, 2.0, 3.0, 4.0])),
    "other channels": lambda: OutputError(MIMO),
    "no passes": lambda: OutputError(max_passes=0),
    "no tolerance": lambda: OutputError(tolerance=0.0),
    "no number for a tolerance": lambda: ThreeModel(tolerance="fine"),
    "not a number for a tolerance": lambda: ThreeModel(tolerance=float("nan")),
    "not a model": lambda: OutputError(start=[1.0, 2.0]),
    "two denominators": lambda: OutputError(
        TransferFunction([[[1.0], [1.0]]], [[[1.0, 2.0], [1.0, 3.0]]])
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_options_that_make_no_sense_are_refused_in_one_line(case):
    with pytest.raises(err.OptionError) as caught:
        identify(noisy(PLANT, PRBS[:100], 10, 0), AT_REST, REFUSED[case]())
    assert "\n" not in str(caught.value)
    assert "found" in str(caught.value)
    assert "expected" in str(caught.value)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_spread_reaches_the_bound():
    """Every draw counts, also one that would have ended elsewhere."""
    draws = 400
    clean = simulate(PLANT, Record(PRBS, PRBS, dt=DT))[:, 0]
    sigma = np.std(clean) * 10 ** (-10 / 20)
    truth = np.array([4.0, 3.0, 3.0])
    columns = output_sensitivities(PLANT, PRBS, DT)
    bound = np.sqrt(np.diag(cramer_rao(columns, sigma**2)))
    values, errors = np.empty((2, draws, 3))
    for k in range(draws):
        estimate = identify(noisy(PLANT, PRBS, 10, 1000 + k), AT_REST, OutputError())
        values[k], errors[k] = estimate.theta, estimate.std
    rmse = np.sqrt(np.mean((values - truth) ** 2, axis=0))
    assert np.all(np.abs(rmse / bound - 1.0) < 0.08), rmse / bound
    assert np.allclose(np.median(errors, axis=0), bound, rtol=0.05)


@pytest.mark.parametrize("known", [{}, {"bounds": {"a1": (0.0, 3.9)}}], ids=["free", "bounded"])
def test_a_looser_tolerance_stops_earlier_and_not_far_from_the_end(known):
    record = noisy(PLANT, PRBS, 10, 3)
    start = TransferFunction([1.0], [1.0, 12.0, 30.0])
    asked = Structure(2, 0, offset=False, initial_state="rest", **known)
    ends = [
        identify(record, asked, OutputError(start, tolerance=tolerance))
        for tolerance in (1e-7, 0.1)
    ]
    steps = [len(one.trace.passes) for one in ends]
    assert steps[1] < steps[0]
    off = np.abs(ends[1].theta - ends[0].theta)[ends[0].std > 0] / ends[0].std[ends[0].std > 0]
    assert 1e-9 < off.max() < np.sqrt(0.1)
    assert "less than 1e-01" in ends[1].trace.stopped


def test_three_models_stop_at_their_tolerance():
    record = noisy(PLANT, PRBS, 10, 3)
    for tolerance in (1e-9, 1e-3):
        found = identify(record, AT_REST, ThreeModel(tolerance=tolerance))
        assert f"less than {tolerance:.0e}" in found.trace.stopped
