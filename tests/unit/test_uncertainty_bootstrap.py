"""The parametric bootstrap: its noise, its order, its failures, its correction of bias."""

from __future__ import annotations

import dataclasses
import multiprocessing
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.errors import (
    ConvergenceError,
    DataError,
    OptionError,
    UnsupportedError,
    UnsupportedOrderError,
)
from tridentify.uncertainty import (
    Bootstrap,
    bootstrap,
    sampled_derived,
    sampled_step_band,
)
from tridentify.uncertainty.bias import corrected
from tridentify.uncertainty.noise import NoiseModel
from tridentify.uncertainty.resampling import _clean, _held, _Task, identify_copy

pytestmark = pytest.mark.unjudged

DT = 0.05
PLANT = TransferFunction([0.5], [1.0, 1.0, 3.0])


def noisy(seed=0, noise=0.03, n=160, gap=False, offset=0.0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 8), 8)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0] + offset + noise * rng.standard_normal(n)
    if gap:
        y[40:60] = np.nan
    return Record(u, y, dt=DT)


@pytest.fixture(scope="module")
def case():
    record = noisy()
    estimate = identify(record, Structure(2, 0, offset=False, initial_state="rest"))
    return estimate, record, bootstrap(estimate, record, n_draws=60, seed=3)


@dataclasses.dataclass(frozen=True)
class Awkward:
    """A method that answers with the largest sample, and fails for every record it dislikes."""

    above: float
    name: str = "Awkward"

    def estimate(self, records, structure, progress=None):
        largest = float(np.nanmax(records[0].y))
        if largest > self.above:
            raise UnsupportedOrderError(f"found {largest}; expected less; whistle")
        known = ThreeModel().estimate(records, structure, progress)
        return dataclasses.replace(known, theta=np.full(3, largest))


@pytest.mark.slow
def test_spread_is_the_standard_error(case):
    estimate, _, copies = case
    assert copies.n_draws == 60
    assert copies.n_failed == copies.n_flagged == 0
    # 60 copies know a standard deviation to 9 percent
    assert copies.std == pytest.approx(estimate.std, rel=0.35)
    assert copies.spread == pytest.approx(estimate.std, rel=0.5)
    assert np.all(np.abs(copies.bias) < estimate.std)
    assert np.all(np.abs(copies.median_bias) < estimate.std)
    for kind in ("bca", "percentile", "basic", "studentized"):
        ends = copies.intervals(0.95, kind)
        assert np.all(ends[:, 0] < estimate.theta)
        assert np.all(estimate.theta < ends[:, 1])
        width = ends[:, 1] - ends[:, 0]
        assert width == pytest.approx(3.92 * estimate.std, rel=0.5)


@pytest.mark.slow
def test_other_quantities_come_from_the_copies(case):
    _, _, copies = case
    sample = copies.sample
    assert sample.origin == "bootstrap"
    frequency = sampled_derived(sample, kind="bca")[0]
    assert frequency.name == "natural frequency"
    assert frequency.low < np.sqrt(3.0) < frequency.high
    band = sampled_step_band(sample, [1.0, 2.0], kind="basic")
    assert np.all(band.low < band.high)


@pytest.mark.slow
def test_seed_and_workers(case):
    estimate, record, copies = case
    with ThreadPoolExecutor(1) as pool:
        again = bootstrap(estimate, record, n_draws=60, seed=3, executor=pool)
    assert np.array_equal(again.theta, copies.theta)
    few = bootstrap(estimate, record, n_draws=5, seed=3)
    assert np.array_equal(few.theta, copies.theta[:5])
    other = bootstrap(estimate, record, n_draws=5, seed=4)
    assert not np.array_equal(other.theta, copies.theta[:5])


@pytest.mark.parametrize("colour", [0.0, pytest.param(0.8, marks=pytest.mark.slow)])
def test_a_copy_ends_where_a_search_from_nothing_ends(colour):
    record = noisy(n=320, noise=0.0)
    rng = np.random.default_rng(1)
    added = lfilter([1.0], [1.0, -colour], 0.05 * rng.standard_normal(record.n_samples))
    record = Record(record.u, record.y[:, 0] + added, dt=DT)
    structure = Structure(2, 0, offset=False, initial_state="rest")
    estimate = identify(record, structure, ThreeModel(noise="ar" if colour else "white"))
    copies = bootstrap(estimate, record, n_draws=8, seed=2)
    clean, method = _clean(estimate, record, 0), _held(estimate, ThreeModel())
    noise = NoiseModel.of(estimate)
    for k, seed in enumerate(np.random.SeedSequence(2).spawn(8)):
        task = _Task(k, (clean,), noise, estimate.structure, method, seed)
        apart = np.abs(identify_copy(task).theta - copies.theta[k]) / estimate.std
        # both end where a step promises less than 1e-7 of -2 log L
        assert np.max(apart) < np.sqrt(method.tolerance) + 1e-3


@pytest.mark.slow
def test_processes_give_the_same(case):
    estimate, record, copies = case
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        again = bootstrap(estimate, record, n_draws=10, seed=3, executor=pool)
    assert np.array_equal(again.theta, copies.theta[:10])


def test_progress_is_told(case):
    estimate, record, _ = case
    told = []
    bootstrap(estimate, record, n_draws=3, progress=told.append)
    assert told == ["bootstrap: 1 of 3", "bootstrap: 2 of 3", "bootstrap: 3 of 3"]


@pytest.mark.slow
@pytest.mark.judged
def test_failures_are_counted_and_named(case):
    estimate, record, _ = case
    largest = [bootstrap(estimate, record, Awkward(np.inf), n_draws=30, seed=1).theta[:, 0]][0]
    limit = float(np.sort(largest)[19])
    copies = bootstrap(estimate, record, Awkward(limit), n_draws=30, seed=1)
    assert copies.n_failed == 10
    assert [f.draw for f in copies.failures] == np.flatnonzero(largest > limit).tolist()
    assert "UnsupportedOrderError" in copies.failures[0].reason
    failed = np.isnan(copies.theta).all(axis=1)
    assert np.array_equal(failed, largest > limit)
    assert len(copies.sample.theta) == 20
    text = copies.summary()
    assert "30 copies, 10 failed" in text
    assert "more copies failed than a tail" in text
    with pytest.raises(ConvergenceError, match="30 of 30"):
        bootstrap(estimate, record, Awkward(-np.inf), n_draws=30)


def test_a_mistake_in_a_method_is_not_a_failure(case):
    @dataclasses.dataclass(frozen=True)
    class Broken:
        name: str = "Broken"

        def estimate(self, records, structure, progress=None):
            raise KeyError("a mistake")

    with pytest.raises(KeyError):
        bootstrap(case[0], case[1], Broken(), n_draws=2)


def test_missing_samples_and_nuisance_terms_stay(case):
    records = [noisy(1, gap=True, offset=2.0), noisy(2, n=120, offset=-1.0)]
    estimate = identify(records, Structure(2, 0, offset=True, initial_state="rest"))
    copies = bootstrap(estimate, records, n_draws=12)
    assert copies.n_failed == 0
    clean = [_clean(estimate, record, e) for e, record in enumerate(records)]
    assert np.array_equal(np.isnan(clean[0].y), np.isnan(records[0].y))
    assert np.nanmean(clean[0].y) == pytest.approx(2.0, abs=0.1)
    assert np.nanmean(clean[1].y) == pytest.approx(-1.0, abs=0.1)


def test_what_was_decided_is_held():
    record = noisy(5, n=400)
    estimate = identify(record, Structure(2, 0))
    assert estimate.structure.initial_state != "auto"
    seen = []

    @dataclasses.dataclass(frozen=True)
    class Spy:
        name: str = "Spy"

        def estimate(self, records, structure, progress=None):
            seen.append(structure)
            return estimate

    bootstrap(estimate, record, Spy(), n_draws=2)
    assert seen[0] == estimate.structure
    assert _held(estimate, ThreeModel(noise="auto")).noise == "white"
    coloured = dataclasses.replace(estimate, noise_model=(np.array([-0.5]),))
    assert _held(coloured, ThreeModel(noise="auto")).noise == "ar"
    assert _held(coloured, ThreeModel(noise="white")).noise == "white"


@pytest.mark.slow
def test_copies_have_the_noise_of_each_experiment():
    model = TransferFunction([2.0], [1.0, 4.0])
    rng, records = np.random.default_rng(21), []
    for noise in (0.02, 0.4):
        u = np.repeat(rng.choice([-1.0, 1.0], 30), 5)
        y = simulate(model, Record(u, u, dt=DT))[:, 0]
        records.append(Record(u, y + noise * rng.standard_normal(u.size), dt=DT))
    estimate = identify(records, Structure(1, 0, offset=False, initial_state="rest"))
    assert len(estimate.noise_levels) == 2
    drawn = NoiseModel.of(estimate)
    spread = [float(drawn.draw(rng, 5000, e).std()) for e in (0, 1)]
    assert spread == pytest.approx([0.02, 0.4], rel=0.2)
    copies = bootstrap(estimate, records, n_draws=16, seed=3)
    # a standard deviation of 16 draws is known to 18 %
    assert copies.theta.std(axis=0) == pytest.approx(estimate.std, rel=0.6)


@pytest.mark.slow
def test_coloured_noise_is_stationary_from_the_first_sample():
    row = np.array([-1.2, 0.5])
    noise = NoiseModel(np.array([2.0, 3.0]), (row, np.empty(0)))
    rng = np.random.default_rng(0)
    drawn = np.array([noise.draw(rng, 40) for _ in range(4000)])
    assert drawn.std(axis=0)[:, 0] == pytest.approx(2.0, rel=0.05)
    assert drawn.std(axis=0)[:, 1] == pytest.approx(3.0, rel=0.05)
    white = drawn[:, 2:, 0] + row[0] * drawn[:, 1:-1, 0] + row[1] * drawn[:, :-2, 0]
    correlation = np.mean(white[:, 0] * white[:, 1]) / np.mean(white**2)
    assert abs(correlation) < 0.05
    first = np.mean(drawn[:, 0, 0] * drawn[:, 1, 0]) / 4.0
    assert first == pytest.approx(1.2 / 1.5, abs=0.05)  # Yule-Walker


def test_noise_that_is_not_stationary_is_refused(case):
    estimate, record, _ = case
    wandering = dataclasses.replace(estimate, noise_model=(np.array([-1.0]),))
    with pytest.raises(UnsupportedError, match="not stationary"):
        bootstrap(wandering, record, n_draws=2)


def test_other_records_and_methods_are_refused(case):
    estimate, record, _ = case
    with pytest.raises(DataError, match="other samples"):
        bootstrap(estimate, noisy(9))
    with pytest.raises(DataError, match="found 2 records"):
        bootstrap(estimate, [record, record])
    with pytest.raises(OptionError, match="pass the method"):
        bootstrap(dataclasses.replace(estimate, method="homemade"), record)
    for wrong in ({"n_draws": 1}, {"n_draws": 2.0}, {"seed": -1}):
        with pytest.raises(OptionError, match="whole number"):
            bootstrap(estimate, record, **wrong)
    with pytest.raises(OptionError, match="percentile"):
        case[2].intervals(0.95, "exact")


# ------------------------------------------------------------------------ the correction of bias
def test_correction_moves_against_the_bias_and_keeps_the_model_stable(case):
    estimate = case[0]
    theta = np.asarray(estimate.theta)
    spread = np.random.default_rng(0).standard_normal((301, 3)) * 0.01
    factor = np.array([1.6, 1.1, 1.1])  # of the middle of the copies
    found = corrected(estimate, theta * factor * np.exp(spread))
    assert found == pytest.approx(theta / factor, rel=0.02)
    low = corrected(estimate, theta * [0.4, 0.9, 0.9] * np.exp(spread))
    assert low == pytest.approx(theta * [1.6, 1.1, 1.1], rel=0.02)


def test_heavy_tails_do_not_move_the_correction(case):
    estimate = case[0]
    theta = np.asarray(estimate.theta) * np.exp(
        0.05 * np.random.default_rng(1).standard_normal((400, 3))
    )
    calm = corrected(estimate, theta)
    theta[:20] = [1e6, 1e9, 1e8]
    wild = Bootstrap(estimate, theta, theta, (), 0, 0)
    assert np.all(np.abs(wild.bias) > 1e4)
    assert wild.bias_corrected == pytest.approx(calm, rel=0.03)
    # a correction on a linear scale would have crossed zero, the copies' mean far beyond it
    runaway = corrected(
        estimate, np.asarray(estimate.theta) * [30.0, 900.0, 900.0] * np.ones((9, 3))
    )
    assert np.all(runaway > 0)


def test_correction_knows_channels_and_higher_orders(double):
    estimate = double.estimate
    rng = np.random.default_rng(2)
    theta = np.asarray(estimate.theta) + estimate.std * 1e-3 * rng.standard_normal((200, 6))
    assert corrected(estimate, theta) == pytest.approx(estimate.theta, rel=1e-3)


@pytest.mark.judged
def test_summary_is_a_table(case):
    text = case[2].summary()
    assert all(len(line) <= 100 for line in text.splitlines())
    assert "60 copies, 0 failed, 0 flagged" in text
    assert [line.split()[0] for line in text.splitlines()[4:]] == ["a1", "a0", "b0"]
