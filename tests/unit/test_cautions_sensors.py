"""Coarse converters, limits, hanging sensors, repeats and outliers: said when true, not otherwise.

The records come from a simulation of their own, pole by pole.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify import errors as err
from tridentify.numerics.converter import quantum, runs

DT = 0.05
DEN, NUM = np.array([1.0, 1.0, 3.0]), np.array([0.2, 0.5])
METHOD = ThreeModel(noise="white", finish="likelihood")
WORDS = (
    "quantised",
    "saturated",
    "hung",
    "repeat the one before",
    "repeats each value",
    "repeats one value exactly",
    "Gaussian noise explains",
)
PLAIN = Structure(2, 1)


def respond(u, dt=DT):
    return by_modes(NUM, DEN, u, dt)


def noisy(seed=0, n_samples=800, level=0.05, u=None):
    """(record, noise standard deviation)."""
    rng = np.random.default_rng(seed)
    if u is None:
        u = np.repeat(rng.choice([-1.0, 1.0], n_samples // 10 + 1), 10)[:n_samples]
    clean = respond(u)
    sigma = level * clean.std()
    return Record(u, clean + sigma * rng.standard_normal(u.size), dt=DT), sigma


def said(record, structure=PLAIN):
    """The words of `WORDS` that the cautions contain, and the cautions."""
    lines = identify(record, structure, METHOD, throw=False).cautions
    return {word for word in WORDS for line in lines if word in line}, lines


# -------------------------------------------------------------------------------------- quantum
@pytest.mark.parametrize("q", [1.0, 0.01, 3.7e-6, 20.0 / 4096])
@pytest.mark.parametrize("about", [0.0, 1000.0])
def test_quantum_is_found_through_rounding(q, about):
    signal = 40 * q * np.sin(0.37 * np.arange(300)) + 11 * q
    values = about * q + q * np.round(signal / q)
    assert quantum(values) == pytest.approx(q, rel=1e-6)
    assert quantum(values * 57.29577951308232) == pytest.approx(q * 57.29577951308232, rel=1e-6)
    printed = np.array([float(f"{v:.9g}") for v in values])
    assert quantum(printed) == pytest.approx(q, rel=1e-4)


def test_quantum_without_two_neighbouring_levels():
    levels = np.array([0.0, 6, 10, 16, 19, 25, 40, 46.0])
    assert quantum(np.tile(levels, 3)) == pytest.approx(1.0)


def test_continuous_values_have_no_quantum():
    for seed in range(300):
        rng = np.random.default_rng(seed)
        values = rng.uniform(-1e3, 1e3) + rng.standard_normal(rng.integers(2, 200))
        assert quantum(values) == 0.0


@pytest.mark.parametrize("values", [[], [1.0], [2.0, 2.0], [np.nan, 1.0, np.nan], [0.0, 1.0]])
def test_too_few_values_have_no_quantum(values):
    assert quantum(np.array(values)) == 0.0


def test_missing_samples_end_a_run():
    found = runs(np.array([1.0, 1.0, np.nan, 1.0, 2.0, 2.0]))
    assert found.first.tolist() == [0, 4]
    assert found.length.tolist() == [2, 2]


# ------------------------------------------------------------------------------- said when true
@pytest.mark.parametrize(("steps", "told"), [(0.2, False), (1.0, False), (3.0, True), (10.0, True)])
@pytest.mark.fast("0.2-False", "1.0-False", "3.0-True")
def test_converter_is_judged_against_the_noise(steps, told):
    record, sigma = noisy()
    q = steps * sigma
    words, lines = said(record.with_outputs(q * np.round(record.y / q)))
    assert words == ({"quantised"} if told else set())
    if told:
        line = next(line for line in lines if "quantised" in line)
        assert f"steps of {q:.4g} " in line


def test_quantised_input_is_nothing_to_mention():
    rng = np.random.default_rng(5)
    u = 0.25 * np.round(4.0 * np.cumsum(rng.standard_normal(600)) / 10)
    record, _ = noisy(u=u)
    assert said(record)[0] == set()


@pytest.mark.parametrize(
    "side", [*(pytest.param(s, marks=pytest.mark.slow) for s in ("top", "bottom")), "both"]
)
@pytest.mark.parametrize("step", [0.0, 0.3])
@pytest.mark.fast("0.3-both")
def test_saturation_is_named_with_its_limit(side, step):
    record, sigma = noisy(1)
    low, high = np.quantile(record.y, [0.06, 0.94])
    low, high = (low if side != "top" else -9.0), (high if side != "bottom" else 9.0)
    y = np.clip(record.y, low, high)
    if step:
        y = step * sigma * np.round(y / (step * sigma))
    words, lines = said(record.with_outputs(y))
    assert words == {"saturated"}
    (line,) = (line for line in lines if "saturated" in line)
    ends = {"largest": y.max(), "smallest": y.min()}
    ends = {w: v for w, v in ends.items() if side == "both" or (w == "largest") == (side == "top")}
    assert " or ".join(f"its {word} value {value:.6g}" for word, value in ends.items()) in line
    assert f"{int(np.isin(y, list(ends.values())).sum())} samples" in line


@pytest.mark.unjudged
@pytest.mark.slow
def test_marking_saturated_samples_as_missing_takes_most_of_the_bias_away():
    """The rest stays: noise decides which samples near the limit are beyond it."""
    truth = np.concatenate([DEN[1:], NUM])
    clipped, marked = [], []
    for seed in range(6):
        record, _ = noisy(seed, level=0.1)
        high = np.quantile(record.y, 0.85)
        full = record.with_outputs(np.minimum(record.y, high))
        structure = Structure(2, 1, offset=False, initial_state="rest")
        clipped.append(identify(full, structure, METHOD).theta)
        marked.append(identify(full.mask(full.y >= high), structure, METHOD).theta)
    before, after = (np.abs(np.mean(x, axis=0) / truth - 1.0) for x in (clipped, marked))
    assert np.max(before) > 0.1
    assert np.max(after) < 0.35 * np.max(before)


@pytest.mark.slow
def test_hanging_sensor_is_named_with_its_place():
    record, _ = noisy(2)
    y = np.array(record.y)
    y[300:340] = y[300]
    words, lines = said(record.with_outputs(y))
    assert words == {"hung"}
    assert any("40 samples" in line and "from sample 300 on" in line for line in lines)


def test_repeated_rows_are_counted():
    record, _ = noisy(3)
    y = np.array(record.y)
    where = np.array([50, 123, 200, 301, 402, 555, 700])
    y[where] = y[where - 1]
    words, lines = said(record.with_outputs(y))
    assert words == {"repeat the one before"}
    assert any(line.startswith("7 samples of y") for line in lines)


def counted_speed(seed, again=0):
    """A motor on a few plateaus, of a counter whose step the file rounds to five digits."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([2.0, 2.5, 4.2, 5.0, 6.3, 7.0, 8.0], size=12), 97)
    y = by_modes(np.array([360.0]), np.array([1.0, 12.0]), u, 0.01)
    y = 0.0503 * np.round((y + rng.uniform(-5.0, 5.0, u.size)) / 0.0503)
    y = np.array([float(f"{value:.5g}") for value in y])
    if again:
        where = 2 * rng.choice(u.size // 2 - 1, again, replace=False) + 1
        y[where] = y[where - 1]
    return Record(u, y, dt=0.01)


@pytest.mark.parametrize("again", [0, 60])
def test_values_of_a_counter_that_meet_by_chance_are_no_repeats(again):
    words, lines = said(counted_speed(1, again), Structure(1, 0))
    assert words == ({"repeat the one before"} if again else set()), lines


@pytest.mark.parametrize(("at", "severity"), [([221, 341], "note"), ([271, 401], "warning")])
def test_far_samples_where_the_input_moves_are_not_called_bad(at, severity):
    rng = np.random.default_rng(4)
    u = np.repeat([0.0, 1.0, 0.0, 1.0, 0.0], 120)[20:]
    y = by_modes(np.array([160.0]), np.array([1.0, 160.0]), u, 1e-3)
    y += 0.004 * rng.standard_normal(u.size)
    assert np.flatnonzero(np.diff(u)).tolist() == [99, 219, 339, 459]
    y[at] += 0.06
    estimate = identify(Record(u, y, dt=1e-3), Structure(1, 0), METHOD)
    (found,) = [one for one in estimate.findings if one.code == "bad-samples"]
    assert found.severity == severity
    assert ("where an input moves" in found.message) == (severity == "note")


@pytest.mark.parametrize(
    "factor",
    [2, *(pytest.param(k, marks=pytest.mark.slow) for k in (3, 5, 8))],
)
@pytest.mark.parametrize("step", [0.0, 0.3])
@pytest.mark.slow
def test_slow_sensor_is_named_with_its_factor_and_a_remedy(factor, step):
    record, sigma = noisy(11, n_samples=960)
    y = np.repeat(record.y[::factor, 0], factor)
    if step:
        y = step * sigma * np.round(y / (step * sigma))
    words, lines = said(record.with_outputs(y))
    assert words == {"repeats each value"}
    (line,) = (line for line in lines if "repeats each value" in line)
    assert f"{factor} times in a row," in line
    assert f"keep every {factor}th sample" in line
    assert "Record.from_rates" in line


@pytest.mark.slow
def test_slow_sensor_without_a_fixed_ratio_is_named_with_the_mean():
    record, _ = noisy(11)
    held = np.floor(np.floor(np.arange(800) * 0.3 + 1e-9) / 0.3).astype(int)
    words, lines = said(record.with_outputs(np.array(record.y[held])))
    assert words == {"repeats each value"}
    assert any("3.3 times in a row on average" in line for line in lines)


@pytest.mark.parametrize("step", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_frozen_logger_is_named(step):
    """Inputs and outputs stand still together, so that the model moves little."""
    u = np.random.default_rng(12).standard_normal(1000)
    record, sigma = noisy(12, u=u)
    u, y = np.array(record.u), np.array(record.y)
    if step:
        y = step * sigma * np.round(y / (step * sigma))
    for k in range(60, 960, 90):
        u[k : k + 10], y[k : k + 10] = u[k], y[k]
    lines = said(Record(u, y, dt=DT))[1]
    word = "stays at exactly one value" if step else "one value exactly in 10 places"
    (line,) = (line for line in lines if word in line)
    assert "from sample 60 on" in line


SLOW_DEN = np.array([1.0, 1.0, 9.0])


@pytest.mark.judged
@pytest.mark.parametrize(
    "share", [0.02, 0.2, *(pytest.param(x, marks=pytest.mark.slow) for x in (0.4, 0.55, 0.7))]
)
@pytest.mark.parametrize("sides", [pytest.param(1, marks=pytest.mark.slow), 2])
@pytest.mark.parametrize(
    ("level", "steps"),
    [(0.05, 0.0), *(pytest.param(*x, marks=pytest.mark.slow) for x in ((0.0, 0.0), (0.05, 0.5)))],
)
@pytest.mark.parametrize("noise", ["white", pytest.param("auto", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_saturation_is_noticed_at_any_share(share, sides, level, steps, noise):
    rng = np.random.default_rng(13)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 25)
    model = TransferFunction([1.0], SLOW_DEN)
    y = simulate(model, Record(u, u, dt=0.02))[:, 0]
    sigma = 0.05 * y.std()
    y = y + level * y.std() * rng.standard_normal(u.size)
    high = np.quantile(np.abs(y) if sides == 2 else y, 1.0 - share)
    y = np.clip(y, -high if sides == 2 else -9.0, high)
    if steps:
        y = steps * sigma * np.round(y / (steps * sigma))
    method = ThreeModel(noise=noise, finish="likelihood")
    lines = identify(Record(u, y, dt=0.02), Structure(2, 0), method, throw=False).cautions
    named = sum(line.count("est value ") for line in lines if "saturated" in line)
    # the few samples of a small share may all be at one side
    assert named == sides if share > 0.02 else named >= (0 if steps else 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "ratio", [0.003, 0.5, *(pytest.param(x, marks=pytest.mark.slow) for x in (0.1, 1.5))]
)
@pytest.mark.parametrize(
    "steps",
    [0.0, pytest.param(0.02, marks=pytest.mark.slow), pytest.param(0.1, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("level", [0.0, pytest.param(0.003, marks=pytest.mark.slow)])
def test_flat_tops_of_a_fast_system_raise_no_alarm(ratio, steps, level):
    """Plateaus at both ends that are entered at a jump, and a model of too low an order."""
    rng = np.random.default_rng(14)
    tau = ratio * DT
    model = TransferFunction([1.0 / tau**2], [1.0, 1.2 / tau, 1.0 / tau**2])
    for u in (
        np.repeat(rng.choice([-1.0, 1.0], 40), 12),
        np.repeat(rng.standard_normal(40), 12),
    ):
        y = simulate(model, Record(u, u, dt=DT))[:, 0]
        y = y + level * y.std() * rng.standard_normal(u.size)
        if steps:
            y = steps * np.round(y / steps)
        words = said(Record(u, y, dt=DT), Structure(1, 0))[0]
        assert not words & {"saturated", "repeats each value", "repeats one value exactly"}


@pytest.mark.judged
@pytest.mark.slow
def test_saturated_measured_input():
    rng = np.random.default_rng(6)
    true = np.repeat(rng.uniform(-1.0, 1.0, 80), 10)
    measured = np.clip(true + 0.05 * rng.standard_normal(true.size), -0.7, 0.7)
    y = respond(true)
    y = y + 0.05 * y.std() * rng.standard_normal(y.size)
    lines = identify(Record(measured, y, dt=DT), PLAIN, METHOD, throw=False).cautions
    assert any("of input u stay at its ends, -0.7 and 0.7" in line for line in lines)


@pytest.mark.judged
@pytest.mark.parametrize("count", [1, 10])
def test_gross_outliers_recommend_a_robust_loss(count):
    record, sigma = noisy(4)
    y = np.array(record.y)
    where = np.random.default_rng(1).choice(800, count, replace=False)
    y[where] += 25 * sigma
    bad = record.with_outputs(y)
    words, lines = said(bad)
    assert words == {"Gaussian noise explains"}
    line = next(line for line in lines if "Gaussian noise explains" in line)
    assert line.startswith(f"{count} samples" if count > 1 else "A sample")
    assert "loss='huber'" in line
    robust = identify(bad, PLAIN, ThreeModel(loss="huber"))
    assert not any("Gaussian noise explains" in line for line in robust.cautions)


# ------------------------------------------------------------------------------ silent otherwise
def inputs():
    rng = np.random.default_rng(7)
    t = np.arange(400)
    return {
        "step": np.ones(400),
        "late step": (t > 80).astype(float),
        "binary": np.repeat(rng.choice([-1.0, 1.0], 25), 16),
        "fast binary": rng.choice([-1.0, 1.0], 400),
        "doublet": np.where(t < 100, 0.0, np.where(t < 150, 1.0, np.where(t < 200, -1.0, 0.0))),
        "levels": np.repeat(rng.integers(-3, 4, 40).astype(float), 10),
        "sine": np.sin(0.05 * t),
        "ramp to a hold": np.clip((t - 50) / 100, 0.0, 1.0),
        "noise": rng.standard_normal(400),
    }


@pytest.mark.parametrize("kind", inputs())
@pytest.mark.parametrize("level", [0.0, 0.01, 0.3])
@pytest.mark.fast("0.01-*")
def test_sound_records_raise_no_alarm(kind, level):
    u = np.repeat(inputs()[kind], 3)
    record, _ = noisy(8, level=level, u=u)
    assert said(record)[0] == set()


@pytest.mark.slow
@pytest.mark.parametrize("n_samples", [15, 30, 60])
@pytest.mark.parametrize("seed", range(6))
def test_short_sound_records_raise_no_alarm(n_samples, seed):
    u = np.where(np.arange(n_samples) < n_samples // 2, 1.0, -1.0)
    record, _ = noisy(seed, level=0.1, u=u)
    assert said(record, Structure(1, 0, offset=False, initial_state="rest"))[0] == set()


def test_counts_with_noise_of_their_own_raise_no_alarm():
    record, sigma = noisy(9, level=0.1)
    assert said(record.with_outputs(np.round(1.5 * record.y / sigma)))[0] == set()


@pytest.mark.judged
@pytest.mark.slow
def test_response_that_the_model_misses_is_not_taken_for_outliers():
    record, _ = noisy(10, level=0.0)
    found = identify(
        record, Structure(1, 0, offset=False, initial_state="rest"), METHOD, throw=False
    ).findings
    assert not any(one.code == "bad-samples" for one in found)


# ------------------------------------------------------------------------------------------ mask
@functools.cache
def two_outputs():
    return Record([0.0, 1.0, 1.0, 1.0], np.arange(8.0).reshape(4, 2), dt=0.1)


def test_mask_marks_one_output_or_all():
    record = two_outputs()
    one = record.mask(record.y >= 7.0)
    assert np.argwhere(np.isnan(one.y)).tolist() == [[3, 1]]
    both = record.mask(record.y[:, 0] >= 6.0)
    assert np.argwhere(np.isnan(both.y)).tolist() == [[3, 0], [3, 1]]
    assert np.isfinite(record.y).all()
    assert both.dt == record.dt


@pytest.mark.parametrize(
    ("where", "error"),
    [
        ([True], err.ShapeError),
        ([[True] * 3] * 4, err.ShapeError),
        ([1, 0, 0, 0], err.SampleTypeError),
        ([3], err.SampleTypeError),
        ([True] * 4, err.EmptyChannelError),
    ],
)
def test_mask_refuses_what_does_not_fit(where, error):
    with pytest.raises(error, match="found"):
        two_outputs().mask(where)


@pytest.mark.parametrize(
    ("y", "error"),
    [
        (np.zeros(4), err.ShapeError),
        (np.zeros((3, 2)), err.ShapeError),
        (np.full((4, 2), np.inf), err.NotFiniteError),
        (np.full((4, 2), np.nan), err.EmptyChannelError),
        ([["a", "b"]] * 4, err.SampleTypeError),
    ],
)
def test_with_outputs_refuses_what_does_not_fit(y, error):
    with pytest.raises(error, match="found"):
        two_outputs().with_outputs(y)


@pytest.mark.slow
def test_a_simulation_that_rests_before_its_manoeuvre_has_no_stuck_sensor():
    """Without noise the output stands still until the input moves, but for its last digit."""
    u = np.repeat([0.0, 1.0, -1.0, 0.0], [200, 100, 100, 600])
    other = TransferFunction([2.0, 3.0, 9.0], [1.0, 3.2, 10.0, 9.4])
    y = 0.04 + 0.01 * simulate(other, Record(u, u, dt=0.005))[:, 0]
    y[20:25] += 2e-10
    record = Record(u, np.round(y, 10), dt=0.005)
    codes = [f.code for f in identify(record, Structure(2, 1)).findings]
    assert "stuck-sensor" not in codes


@pytest.mark.judged
@pytest.mark.parametrize("kept", [2, 5])
def test_an_output_whose_samples_have_no_neighbours_is_judged_like_others(kept):
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 30), 10)
    y = np.full(u.size, np.nan)
    whole = simulate(TransferFunction([3.0], [1.0, 1.0, 3.0]), Record(u, u, dt=0.1))[:, 0]
    y[::kept] = (whole + 0.05 * rng.standard_normal(u.size))[::kept]
    estimate = identify(Record(u, y, dt=0.1), Structure(2, 0))
    assert [one.code for one in estimate.findings] == ["missing-samples"]
