"""Logs that are not what was recorded: interpolated, on two clocks, filtered forth and back."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, advise, identify, simulate, validate
from tridentify.judgement.causes.sensors.both_ways_filtered import forth_and_back
from tridentify.numerics.joined_by_lines import between_follows, joined_by_lines

PLANT = TransferFunction([2.0, 8.0], [1.0, 1.6, 16.0])
TRUTH = {"a1": 1.6, "a0": 16.0, "b1": 2.0, "b0": 8.0}
ASKED = Structure(2, 1)


def recorded(seed, n, dt, hold, noise=0.04):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]
    y = simulate(PLANT, Record(u, u, dt=dt))[:, 0]
    return u, y + noise * y.std() * rng.standard_normal(n)


def finer(u, y, factor):
    place = np.arange((u.size - 1) * factor + 1) / factor
    return tuple(np.interp(place, np.arange(u.size), one) for one in (u, y))


def off(estimate):
    own = estimate.parameters
    return max(abs(own[name].value - value) / own[name].std for name, value in TRUTH.items())


@pytest.mark.parametrize("factor", [2, 3, 5, 10])
@pytest.mark.parametrize("digits", [15, 4])
def test_lines_between_every_kth_sample_are_seen_also_where_they_are_rounded(factor, digits):
    u, y = recorded(1, 120, 0.1, 3, 0.2)
    v, z = finer(u, y, factor)
    found = joined_by_lines(np.round(z[1:], digits), v[1:, None])
    assert found == (factor, factor - 1)
    assert between_follows(v[1:, None], found)
    assert not between_follows(np.sin(np.arange(z.size - 1.0))[:, None], found)


def test_no_lines_are_seen_in_what_was_recorded():
    rng = np.random.default_rng(3)
    held, n = np.repeat(rng.standard_normal(80), 4), 320
    ramps = np.interp(np.arange(n), np.arange(0, n + 4, 4), rng.standard_normal(n // 4 + 1))
    # the input bends lines that an integrator makes of it, without noise
    pairs = [(np.cumsum(held), held)]
    for u in (held, ramps):
        pairs += [(simulate(PLANT, Record(u, u, dt=0.05, intersample="foh"))[:, 0], u), (u, u)]
    for y, u in pairs:
        noisy = y + 0.02 * rng.standard_normal(n)
        for seen in (y, np.round(y, 1), noisy, np.round(noisy, 2)):
            assert joined_by_lines(seen, u[:, None]) is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_log_that_was_interpolated_is_told_first_and_the_recorded_rows_mend_it(seed):
    u, y = recorded(seed, 300, 0.1, 3)
    record = Record(*finer(u, y, 5), dt=0.02, intersample="auto")
    estimate = identify(record, ASKED)
    first = estimate.findings[0]
    assert (first.code, first.severity) == ("interpolated", "error")
    assert "1196 of 1496 samples" in first.message
    assert "Record(u[::5], y[::5], dt=0.1)" in first.remedy
    assert "With the recorded samples alone" in first.effect
    assert validate(estimate, record).findings[0].code == "interpolated"
    assert [f.code for f in estimate.findings if f.matters and f.code != "interpolated"] == []
    kept = identify(Record(u, y, dt=0.1), ASKED)
    assert off(kept) < 3.5 < off(estimate)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_advice_looks_at_the_recorded_samples_alone(seed):
    u, y = recorded(seed, 300, 0.1, 3)
    codes = [f.code for f in advise(Record(*finer(u, y, 3), dt=0.1 / 3)).findings]
    assert codes[0] == "interpolated"
    assert "bad-samples" not in codes


def on_two_clocks(seed, ppm, n=1200, fine=20):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 6 + 1), 6)[:n]
    often = np.repeat(u, fine)
    y = simulate(PLANT, Record(often, often, dt=0.05 / fine))[:, 0]
    y = np.interp(np.arange(n) * (1.0 + 1e-6 * ppm), np.arange(n * fine) / fine, y)
    return u, y + 0.04 * y.std() * rng.standard_normal(n)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("ppm", [1000, -1000, 300])
def test_clocks_that_run_apart_are_named_and_times_of_their_own_mend_it(ppm, seed):
    u, y = on_two_clocks(seed, ppm)
    first = identify(Record(u, y, dt=0.05), ASKED).findings[0]
    assert (first.code, first.severity) == ("varying", "error")
    assert "the clocks of the channels run apart" in first.message
    said = float(first.message.partition("differ by about ")[2].split(" ppm")[0])
    assert abs(said - abs(ppm)) < 120.0
    step = float(first.remedy.partition("y_dt=")[2].split(")")[0].split(",")[0])
    assert abs(step / 0.05 - 1.0 - 1e-6 * ppm) < 120e-6
    near = [with_times_of_its_own(u, y, 1.0 + (step / 0.05 - 1.0) * by) for by in (0.95, 1.0, 1.1)]
    assert off(max(near, key=lambda one: one.fit[0])) < 3.5


def with_times_of_its_own(u, y, ratio):
    most = min(y.size, int((u.size - 1) / ratio) + 1)
    return identify(Record.from_rates(u, y[:most], u_dt=0.05, y_dt=0.05 * ratio), ASKED)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_an_output_that_was_filtered_forth_and_back_is_no_output_that_comes_early(seed):
    u, y = recorded(seed, 800, 0.05, 6, 0.12)
    smooth = forth_and_back(y[:, None], 2, 0.25)[:, 0]
    found = identify(Record(u, smooth, dt=0.05), ASKED).findings
    first = next(f for f in found if f.matters)
    assert first.code == "filtered"
    assert "an output was filtered forth and back" in first.message
    assert "about a Butterworth filter of" in first.message
    assert not {"delay", "order-low", "intersample"} & {f.code for f in found if f.matters}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_an_input_that_is_filtered_alike_leaves_nothing_of_it(seed):
    u, y = recorded(seed, 800, 0.05, 6, 0.12)
    both = forth_and_back(np.column_stack([u, y]), 2, 0.25)
    codes = {f.code for f in identify(Record(both[:, 0], both[:, 1], dt=0.05), ASKED).findings}
    assert not {"filtered", "delay", "varying"} & codes
