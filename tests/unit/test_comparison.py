"""`compare`: fits against a dense refit whatever the model and the record, names, refusals."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.linalg import companion, expm

from tridentify import (
    Record,
    Structure,
    TransferFunction,
    compare,
    identify,
    plots,
    simulate,
    validate,
)
from tridentify.errors import ChannelNameError, OptionError, SampleTypeError
from tridentify.judgement.comparison import refit
from tridentify.judgement.comparison.both_ways import grows
from tridentify.judgement.comparison.refit import refitted

N, DT = 240, 0.05
EVEN = DT * np.arange(N)
UNEVEN = np.cumsum(np.random.default_rng(3).uniform(0.02, 0.08, N))


def steps(seed=0):
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], N // 12), 12) + 0.7


def dense_fit(model, record, responses, drift):
    """NRMSE of a model by states from matrix exponentials, start and offset by least squares."""
    found, t = [], record.t - record.t[0]
    late = float(model.delay.max())
    begin = int(np.flatnonzero(t > late - 1e-9)[0])
    for i in range(model.n_outputs):
        driven, columns = np.zeros(t.size), [np.ones(t.size)]
        columns += [t] if drift else []
        for j in range(model.n_inputs):
            num, den = model.num[i][j], model.den[i][j]
            n = den.size - 1
            a, b = companion(den), np.eye(n)[0]
            padded = np.pad(num, (n + 1 - num.size, 0))
            c, d = padded[1:] - padded[0] * den[1:], padded[0]
            states, direct = responses(
                a, b, t, record.u[:, j], float(model.delay[i, j]), record.intersample
            )
            driven += states @ c + d * direct
            free = np.array([np.asarray(expm(a * (s - t[begin]))) for s in t])
            columns += list((c @ free).T) if n == 1 else list(free.reshape(t.size, -1).T)
        y = record.y[:, i]
        seen = np.isfinite(y) & (np.arange(t.size) >= begin)
        table = np.array(columns).T[seen]
        table = table / np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        left = (y - driven)[seen]
        left = left - table @ np.linalg.lstsq(table, left, rcond=1e-13)[0]
        about = y[seen] - y[seen].mean()
        found.append(100.0 * (1.0 - np.linalg.norm(left) / np.linalg.norm(about)))
    return np.array(found)


PAIR = [[[2.0, 3.0]], [[5.0]]]
CASES = {
    # model, instants, intersample, drift
    "second order": (TransferFunction([2.0, 3.0], [1.0, 1.5, 9.0]), EVEN, "zoh", False),
    "joined by lines": (TransferFunction([2.0, 3.0], [1.0, 1.5, 9.0]), EVEN, "foh", False),
    "biproper": (TransferFunction([0.5, 2.0, 3.0], [1.0, 1.5, 9.0]), EVEN, "zoh", False),
    "late by part of a step": (
        TransferFunction([4.0], [1.0, 1.5, 9.0], delay=0.18), EVEN, "zoh", False,
    ),
    "uneven time": (TransferFunction([2.0, 3.0], [1.0, 1.5, 9.0]), UNEVEN, "zoh", False),
    "uneven and late": (
        TransferFunction([4.0], [1.0, 1.5, 9.0], delay=0.21), UNEVEN, "foh", False,
    ),
    "integrating": (TransferFunction([1.0], [1.0, 2.0, 0.0]), EVEN, "zoh", True),
    "unstable": (TransferFunction([1.0], [1.0, 0.5, -0.6]), EVEN, "zoh", False),
    "repeated poles": (TransferFunction([8.0], [1.0, 6.0, 12.0, 8.0]), EVEN, "zoh", False),
    "two outputs": (TransferFunction(PAIR, [1.0, 1.5, 9.0]), EVEN, "zoh", False),
    "separate denominators": (
        TransferFunction(PAIR, [[[1.0, 1.5, 9.0]], [[1.0, 4.0]]]), EVEN, "zoh", False,
    ),
    "two inputs": (
        TransferFunction([[[2.0, 3.0], [1.0]]], [[[1.0, 1.5, 9.0], [1.0, 0.8]]]),
        EVEN, "zoh", False,
    ),
}  # fmt: skip


def noisy(model, t, intersample, seed=0):
    """A record with noise, samples that are missing, an offset, and a start of its own."""
    rng = np.random.default_rng(seed)
    u = np.column_stack([steps(seed + j) for j in range(model.n_inputs)])
    nothing = np.zeros((N, model.n_outputs))
    plain = TransferFunction([list(row) for row in model.num], [list(row) for row in model.den],
                             delay=model.delay.tolist())  # fmt: skip
    y = simulate(plain, Record(u, nothing, t=t, intersample=intersample))
    y = y + 4.0
    y = y + 0.05 * np.std(y, axis=0) * rng.standard_normal(y.shape)
    y[rng.random(y.shape) < 0.05] = np.nan
    return Record(u, y, t=t, intersample=intersample)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.fast(
    "uneven and late",
    "integrating",
    "two outputs",
    "two inputs",
    "separate denominators",
    "repeated poles",
)
def test_fits_are_those_of_a_dense_refit(name, responses):
    model, t, intersample, drift = CASES[name]
    record = noisy(model, t, intersample)
    other = TransferFunction(
        [[1.5 * num for num in row] for row in model.num], [list(row) for row in model.den],
        delay=model.delay.tolist(),
    )  # fmt: skip
    found = compare([model, other], record).fits[:, 0]
    for k, one in enumerate((model, other)):
        assert found[k] == pytest.approx(dense_fit(one, record, responses, drift), abs=1e-5)
    # the start of an unstable mode explains its record all but alone
    assert np.all(found[0] > found[1]) or name == "unstable"


@pytest.mark.parametrize("name", ["second order", "integrating", "two outputs"])
def test_a_shifted_trim_leaves_the_fit(name):
    model, t, intersample, _ = CASES[name]
    record = noisy(model, t, intersample)
    moved = Record(record.u + 3.0, record.y - 7.0, t=t, intersample=intersample)
    assert compare(model, moved).fits == pytest.approx(compare(model, record).fits, abs=1e-6)


@pytest.mark.unjudged
def test_an_offset_is_fitted_where_prediction_holds_it():
    model = CASES["second order"][0]
    first = noisy(model, EVEN, "zoh", 1)
    estimate = identify(first, Structure(2, 1))
    other = noisy(model, EVEN, "zoh", 2)
    moved = Record(other.u + 1.0, other.y + 2.0, dt=DT)
    fit = compare(estimate, moved).fits[0, 0, 0]
    left = moved.y - estimate.predict(moved)
    held = 100.0 * (
        1.0 - np.sqrt(np.nansum(left**2) / np.nansum((moved.y - np.nanmean(moved.y)) ** 2))
    )
    assert fit > 85.0 > 50.0 > held
    # the judgement of a fit whose start it chooses by AICc is near
    assert validate(estimate, moved).fit[0] == pytest.approx(fit, abs=0.5)


@pytest.mark.unjudged
@pytest.mark.slow
def test_the_drift_of_an_estimate_is_fitted_along():
    model = CASES["second order"][0]
    record = noisy(model, EVEN, "zoh")
    sloping = Record(record.u, record.y + 0.3 * EVEN[:, None], dt=DT)
    with_drift, without = (
        identify(sloping, Structure(2, 1, drift=drift)) for drift in (True, False)
    )
    fits = compare({"drift": with_drift, "none": without}, sloping).fits[:, 0, 0]
    assert fits[0] > fits[1] + 3.0


def test_each_record_keeps_what_its_input_does_between_samples():
    model = CASES["second order"][0]
    u = np.cumsum(np.random.default_rng(2).standard_normal(60))
    records = [Record(u, np.zeros(60), dt=0.2, intersample=kind) for kind in ("zoh", "foh")]
    held, joined = (
        Record(u, simulate(model, one), dt=0.2, intersample=one.intersample) for one in records
    )
    wrong = Record(u, joined.y, dt=0.2)
    fits = compare(model, [held, joined, wrong]).fits[0, :, 0]
    assert fits[:2] == pytest.approx([100.0, 100.0], abs=1e-6)
    assert fits[2] < 90.0


def test_an_unstable_model_over_a_long_record_is_told_and_not_guessed():
    t = 0.5 * np.arange(N)
    model = TransferFunction([1.0], [1.0, -2.0], delay=0.3)
    record = Record(steps(), np.sin(t), t=t)
    found = compare([model, TransferFunction([1.0], [1.0, 2.0])], record)
    assert np.isnan(found.fits[0, 0, 0])
    assert np.isfinite(found.fits[1, 0, 0])
    assert "unstable" in found.notes[0]
    assert "unstable" in found.summary()
    found.plot()


GROWING = {
    "zoh": (EVEN * 10.0, "zoh"),
    "foh": (EVEN * 10.0, "foh"),
    "uneven": (10.0 * (UNEVEN - UNEVEN[0]), "zoh"),
}


@pytest.mark.parametrize("name", GROWING)
def test_growing_modes_are_no_matter_of_rounding(name, responses):
    """Over 120 s exp(2 t) grows by a hundred decades; the response that stays bounded is found."""
    t, intersample = GROWING[name]
    u = steps()
    # backward from the end, where it is as it would stay: x' = 2 x + u
    states, _ = responses(np.array([[-2.0]]), np.ones(1), t[-1] - t[::-1], turned(u, intersample),
                          0.0, intersample)  # fmt: skip
    slow = simulate(
        TransferFunction([3.0], [1.0, 0.5]), Record(u, np.zeros(N), t=t, intersample=intersample)
    )[:, 0]
    y = slow - states[::-1, 0] + 4.0 + 0.2 * np.exp(2.0 * (t - t[-1]))
    model = TransferFunction(
        np.polyadd(3.0 * np.array([1.0, -2.0]), np.array([1.0, 0.5])),
        np.polymul([1.0, 0.5], [1.0, -2.0]),
    )
    record = Record(u, y, t=t, intersample=intersample)
    assert compare(model, record).fits[0, 0, 0] == pytest.approx(100.0, abs=1e-6)
    noisy_one = Record(u, y + 0.1 * np.random.default_rng(0).standard_normal(N), t=t,
                       intersample=intersample)  # fmt: skip
    assert 80.0 < compare(model, noisy_one).fits[0, 0, 0] < 99.0


def turned(u, intersample):
    """An input in reversed time: what was held until a sample is held from it on."""
    return np.append(u[-2::-1], u[0]) if intersample == "zoh" else u[::-1]


def test_both_directions_agree_where_either_is_good():
    model = TransferFunction(
        [[[1.0, 2.0, 3.0]], [[1.0]]], np.poly([-1.0 + 2j, -1.0 - 2j, 1.2]).real
    )
    t = np.arange(N) * 0.05
    record = Record(steps(), np.random.default_rng(0).standard_normal((N, 2)), t=t)
    assert not grows(model, 9.0)
    assert grows(model, record.duration)
    backward = refitted(model, record, drift=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refit, "grows", lambda *_: False)
        forward = refitted(model, record, drift=False)
    assert backward == pytest.approx(forward, abs=1e-7)


def test_a_fit_of_an_output_at_rest_is_none():
    found = compare(CASES["second order"][0], Record(steps(), np.ones(N), dt=DT))
    assert np.isnan(found.fits).all()
    assert "does not move" in found.notes[0]


def named(model, record, inputs, outputs):
    names = {"input_names": inputs, "output_names": outputs}
    num, den = ([list(row) for row in side] for side in (model.num, model.den))
    return TransferFunction(num, den, **names), Record(record.u, record.y, dt=DT, **names)


def test_channels_are_matched_by_name_in_any_order():
    model = CASES["two outputs"][0]
    model, record = named(model, noisy(model, EVEN, "zoh"), ["de"], ["q", "alpha"])
    turned = Record(
        np.column_stack([np.ones(N), record.u[:, 0]]), record.y[:, ::-1], dt=DT,
        input_names=["thrust", "de"], output_names=["alpha", "q"],
    )  # fmt: skip
    straight = compare(model, record)
    assert straight.output_names == ("q", "alpha")
    assert compare(model, turned).fits == pytest.approx(straight.fits, abs=1e-9)
    only_q = TransferFunction(
        model.num[0][0], model.den[0][0], input_names=["de"], output_names=["q"]
    )
    both = compare([model, only_q], record)
    assert both.fits[1, 0, 0] == pytest.approx(straight.fits[0, 0, 0], abs=1e-9)
    assert np.isnan(both.fits[1, 0, 1])
    assert both.notes == ()


def test_channels_without_names_are_matched_by_position():
    model = CASES["two outputs"][0]
    record = noisy(model, EVEN, "zoh")
    with_names, there = named(model, record, ["de"], ["q", "alpha"])
    expected = compare(model, record).fits
    assert compare(model, there).fits == pytest.approx(expected)
    found = compare(with_names, record)
    assert found.fits == pytest.approx(expected)
    assert found.output_names == ("q", "alpha")


def test_channels_that_are_not_there_are_refused_in_one_line():
    model = CASES["second order"][0]
    model, record = named(model, noisy(model, EVEN, "zoh"), ["de"], ["q"])
    other = Record(record.u, record.y, dt=DT, input_names=["da"], output_names=["q"])
    with pytest.raises(ChannelNameError, match="found no input 'de' of 'model' in 'record'"):
        compare(model, other)
    with pytest.raises(ChannelNameError, match="found no output"):
        compare(model, Record(record.u, record.y, dt=DT, input_names=["de"], output_names=["p"]))


def test_either_order_and_several_models_as_in_matlab():
    model = CASES["second order"][0]
    record = noisy(model, EVEN, "zoh")
    slow = TransferFunction([1.0], [1.0, 1.0])
    expected = compare([model, slow], record).fits
    for found in (compare(record, model, slow), compare([record], [model, slow]),
                  compare(model, slow, record)):  # fmt: skip
        assert found.fits == pytest.approx(expected)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (lambda m, r: (m, m), SampleTypeError, "expected models .* and a Record"),
        (lambda m, r: (r, r), SampleTypeError, "expected models .* and a Record"),
        (lambda m, r: ("a.json", r), SampleTypeError, "found 'str' in place of a model"),
        (lambda m, r: ([], r), OptionError, "found no model"),
        (lambda m, r: ([m, 3], r), SampleTypeError, "found 'int' in place of a model"),
        (lambda m, r: (m, []), SampleTypeError, "expected models .* and a Record"),
    ],
)
def test_anything_else_is_refused_in_one_line(arguments, error, message):
    model = CASES["second order"][0]
    record = noisy(model, EVEN, "zoh")
    with pytest.raises(error, match=message) as caught:
        compare(*arguments(model, record))
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.unjudged
def test_names_tell_the_models_apart():
    model = CASES["second order"][0]
    record = noisy(model, EVEN, "zoh")
    two, one = (identify(record, Structure(*orders)) for orders in ((2, 1), (1, 0)))
    assert compare([two, one], record).names == ("2 poles, 1 zero", "1 pole, 0 zeros")
    assert compare([two, two], record).names == ("ThreeModel 1", "ThreeModel 2")
    assert compare([two, two.model], record).names == ("ThreeModel", "model")
    assert compare({"a": two, "b": one}, record).names == ("a", "b")
    assert compare([two, one], record, names=["x", "y"]).names == ("x", "y")
    with pytest.raises(OptionError, match="found 1 names for 2 models"):
        compare([two, one], record, names=["x"])


def test_tables_and_pictures_hold_the_numbers():
    model = CASES["two outputs"][0]
    record = noisy(model, EVEN, "zoh")
    estimate = identify(record, Structure(2, [[1], [0]]))
    found = compare({"estimate": estimate, "truth": model}, [record, noisy(model, EVEN, "zoh", 5)])
    assert found.fits.shape == (2, 2, 2)
    frame = found.to_frame()
    assert frame.pivot_table(index="model", columns=["record", "output"], values="fit").shape == (
        2,
        4,
    )
    row = frame[(frame.model == "truth") & (frame.record == "record 2") & (frame.output == "y2")]
    assert row.fit.item() == found.fits[1, 1, 1]
    assert found.to_dict()["fits"][1][1][1] == found.fits[1, 1, 1]
    text = found.summary()
    assert f"{found.fits[0, 1, 0]:.2f}" in text
    assert max(map(len, text.splitlines())) <= 78
    assert "natural frequency" in found._repr_html_()
    frequency = found.quantities[0]
    assert frequency.name == "natural frequency"
    assert frequency.values[1].value == pytest.approx(3.0)
    assert frequency.values[0].value == pytest.approx(3.0, rel=0.02)
    axes = found.plot()
    assert len(axes) == 4
    labels = [line.get_label() for line in axes[3].get_lines()]
    assert labels == [
        "recorded",
        *(f"{n}: {found.fits[k, 1, 1]:.1f} %" for k, n in enumerate(found.names)),
    ]
    drawn = axes[3].get_lines()[2].get_ydata()
    assert drawn == pytest.approx(found.responses[1][1][:, 1])
    assert not found.fits.flags.writeable


def test_modes_are_paired_by_where_they_are():
    slow, fast = np.array([1.0, 0.4, 4.0]), np.array([1.0, 6.0, 900.0])
    rows = compare(
        {"slow": TransferFunction([4.0], slow), "fast": TransferFunction([900.0], fast),
         "both": TransferFunction([3600.0], np.polymul(slow, fast))},
        Record(steps(), np.sin(EVEN), dt=DT),
    ).quantities  # fmt: skip
    table = {row.name: [v and round(v.value, 3) for v in row.values] for row in rows}
    assert table == {
        "natural frequency 1": [2.0, None, 2.0],
        "damping 1": [0.1, None, 0.1],
        "natural frequency 2": [None, 30.0, 30.0],
        "damping 2": [None, 0.1, 0.1],
        "dc gain": [1.0, 1.0, 1.0],
    }


@pytest.mark.slow
def test_the_time_grows_with_the_samples():
    """Four times as long takes four times as long, with room for the rest."""
    model = CASES["second order"][0]

    def spent(n):
        u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], n // 10), 10)
        record = Record(u, np.random.default_rng(1).standard_normal(n), dt=DT)
        best = np.inf
        for _ in range(3):
            start = time.process_time()
            compare(model, record)
            best = min(best, time.process_time() - start)
        return best

    assert spent(400_000) < 8.0 * spent(100_000)


def test_one_picture_draws_what_it_is_given():
    with pytest.raises(SampleTypeError, match="in place of a Comparison"):
        plots.plot_compared(CASES["second order"][0])
