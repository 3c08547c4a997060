"""Validation: what is right passes, what is wrong is named with its lags, channel and remedy."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    Estimate,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
    validate,
)
from tridentify.data import short_period
from tridentify.errors import (
    ChannelCountError,
    DataError,
    OptionError,
    SampleTypeError,
    TooFewSamplesError,
)
from tridentify.judgement.validation.residuals import look, root_of
from tridentify.judgement.validation.statistics import bends

pytestmark = pytest.mark.unjudged

DT, N = 0.05, 600
PLANT = TransferFunction([9.0], [1.0, 1.2, 9.0])
NAMES = {"input_names": ["elevator"], "output_names": ["q"]}
REST = Structure(2, 0, offset=False, initial_state="rest")


def prbs(n=N, seed=0, hold=8):
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], n // hold + 1), hold)[:n]


def noise(n=N, seed=1, std=0.08):
    return std * np.random.default_rng(seed).standard_normal(n)


def response(u, plant=PLANT, dt=DT):
    return simulate(plant, Record(u, np.zeros(len(u)), dt=dt))[:, 0]


def recorded(u, y, dt=DT, **more):
    return Record(u, y, dt=dt, **{**NAMES, **more})


def white(structure=REST):
    return structure, ThreeModel(noise="white")


@pytest.fixture(scope="module")
def record():
    u = prbs()
    return recorded(u, response(u) + noise(), units={"elevator": "rad", "q": "rad/s"})


@pytest.fixture(scope="module")
def estimate(record):
    return identify(record, *white())


@pytest.fixture(scope="module")
def right(estimate, record):
    return validate(estimate, record)


@pytest.fixture(scope="module")
def low(record):
    return validate(identify(record, *white(Structure(1, 0, offset=False))), record)


# ----------------------------------------------------------------------------------- a right model
def test_a_right_model_passes(right, estimate, record):
    assert right.ok
    assert right.model_ok
    assert right.own
    assert not right.findings
    assert right.verdict.startswith("Nothing speaks against the model")
    assert not any(test.rejected for test in right.tests)
    residual = estimate.residual(record)
    assert right.residual[0] == pytest.approx(residual)
    assert right.fit == pytest.approx(estimate.fit, abs=1e-9)
    r2 = 1 - np.var(residual) / np.var(record.y)
    assert right.r2 == pytest.approx([r2], abs=1e-12)
    assert np.std(right.innovations[0]) == pytest.approx(1.0, abs=0.02)


def test_the_derivatives_are_those_of_differences(estimate, record):
    view = look(estimate, [record], None)
    (output,) = view.outputs
    root = root_of(estimate)
    assert root @ root.T == pytest.approx(estimate.cov, rel=1e-9, abs=1e-12)
    for k in range(root.shape[1]):
        ends = []
        for sign in (1.0, -1.0):
            a1, a0, b0 = estimate.theta + sign * 1e-3 * root[:, k]
            ends.append(response(record.u[:, 0], TransferFunction([b0], [1.0, a1, a0])))
        expected = (ends[0] - ends[1]) / 2e-3
        assert output.coefficients[0][:, k] == pytest.approx(expected, abs=1e-5 * np.std(expected))


def test_the_bounds_of_the_cross_correlation_allow_for_input_and_fit(right, estimate, record):
    (picture,) = right.cross_correlation
    d = look(estimate, [record], None).outputs[0].coefficients[0]
    q = np.linalg.qr(d)[0]
    r = estimate.residual(record)[:, 0]
    u = record.u[:, 0] - record.u[:, 0].mean()
    lags = np.round(picture.lags / DT).astype(int)
    shifted = []
    for k in lags:
        z = np.zeros(N)
        z[max(k, 0) : N + min(k, 0)] = u[max(-k, 0) : N - max(k, 0)]
        shifted.append(z)
    size = max(np.linalg.norm(z) for z in shifted)
    left = r - q @ (q.T @ r)
    s = np.sqrt(left @ left / (N - 3))
    for k, z in enumerate(shifted):
        own = z - q @ (q.T @ z)
        bound = 2.5758293 * s * np.linalg.norm(own) / (np.linalg.norm(left) * size)
        assert picture.bound[k] == pytest.approx(bound, rel=1e-6)
        assert picture.correlation[k] == pytest.approx(left @ own / (np.linalg.norm(left) * size))
    # short positive lags are what the fit took
    assert picture.bound[lags == 1] < 0.95 * picture.bound[lags == -10]


def test_an_estimate_that_was_stored_is_judged_alike(estimate, record, right, tmp_path):
    again = validate(Estimate.load(estimate.save(tmp_path / "m.json")), record)
    assert again.own
    # a stored model is fitted anew where the other is where its search ended: to rounding
    values = [t.p_value for t in right.tests]
    assert [t.p_value for t in again.tests] == pytest.approx(values, rel=1e-12)


@pytest.mark.slow
def test_what_is_given_back_can_be_read_and_kept(low):
    document = json.loads(json.dumps(low.to_dict(), allow_nan=False))
    assert document["ok"] is False
    assert document["findings"][0]["outputs"] == ["q"]
    text = low.summary()
    assert max(map(len, text.splitlines())) <= 78
    assert low.findings[0].remedy[:10] in " ".join(text.split())
    named = dataclasses.replace(low, verdict="<b>")
    assert "&lt;b&gt;" in named._repr_html_()
    with pytest.raises(ValueError, match="read-only"):
        low.fit[0] = 0.0


# --------------------------------------------------------------------------------- what is missing
def test_an_order_that_is_too_low_is_named(low):
    finding = low.findings[0]
    assert not low.ok
    assert not low.model_ok
    assert (finding.code, finding.outputs) == ("order-low", ("q",))
    assert "correlated with elevator at lag" in low.verdict
    assert "the order is too low" in low.verdict
    assert "poles=2" in finding.remedy
    assert "the sum of squares of the whitened residual falls by" in finding.effect
    # one cause, one finding
    assert [f.code for f in low.findings if f.matters] == ["order-low"]


@pytest.mark.slow
def test_a_noise_model_does_not_hide_a_missing_pole(record):
    coloured = identify(record, Structure(1, 0, offset=False), ThreeModel(noise="ar"))
    assert coloured.noise_model[0].size
    assert validate(coloured, record).findings[0].code == "order-low"


@pytest.mark.slow
def test_a_missing_delay_is_named(record):
    u = record.u[:, 0]
    late = TransferFunction([9.0], [1.0, 1.2, 9.0], delay=0.3)
    other = recorded(u, response(u, late) + noise())
    finding = validate(identify(other, *white()), other).findings[0]
    assert finding.code == "delay"
    assert "a delay of about 0.3 s of elevator explains it best" in finding.message


@pytest.mark.slow
def test_coloured_noise_leaves_the_model_good(record):
    e, v = noise(seed=5), np.zeros(N)
    for k in range(1, N):
        v[k] = 0.7 * v[k - 1] + e[k]
    other = recorded(record.u, response(record.u[:, 0]) + v)
    found = validate(identify(other, *white()), other)
    assert not found.ok
    assert found.model_ok
    assert [f.code for f in found.findings] == ["noise-model"]
    assert "noise='ar'" in found.findings[0].remedy
    modelled = validate(identify(other, REST, ThreeModel(noise="ar")), other)
    assert modelled.ok


@pytest.mark.slow
def test_a_drift_is_named(record):
    slow = 0.4 * np.linspace(0.0, 1.0, N) ** 2
    other = recorded(record.u, record.y[:, 0] + slow)
    found = validate(identify(other, *white()), other)
    assert found.findings[0].code == "drift"
    assert "moves slowly" in found.verdict


def test_noise_that_grows_is_named(record):
    late = np.where(np.arange(N) < N // 2, 1.0, 3.0)
    other = recorded(record.u, response(record.u[:, 0]) + late * noise())
    found = validate(identify(other, *white()), other)
    assert [f.code for f in found.findings if f.matters] == ["noise-changes"]
    assert found.model_ok
    assert found.stationarity[0].scales[-1] > 2 * found.stationarity[0].scales[0]


def test_outliers_are_named_by_their_times(record):
    y = np.array(record.y[:, 0])
    y[[100, 333]] += [1.0, -1.2]
    other = recorded(record.u, y)
    found = validate(identify(other, *white()), other)
    assert "bad-samples" in [f.code for f in found.findings if f.matters]
    assert found.normality[0].outliers[:, 1] == pytest.approx([100 * DT, 333 * DT])
    assert "at 5, 16.65 s" in next(f.text for f in found.findings if f.code == "bad-samples")
    robust = identify(other, REST, ThreeModel(loss="student"))
    assert validate(robust, other).ok


@pytest.mark.slow
def test_feedback_is_named():
    n, e = 2000, noise(2000, 7)
    reference = prbs(n, 8)
    b, a = _held()
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n):
        for i in (1, 2):
            y[k] += b[i] * u[k - i] - a[i] * y[k - i] if k >= i else 0.0
        u[k] = reference[k] - (y[k - 1] + e[k - 1] if k else 0.0)
    other = recorded(u, y + e)
    found = validate(identify(other, *white()), other)
    (finding,) = (f for f in found.findings if f.code == "feedback")
    # told by errors that come before inputs, or by past outputs that tell the input's moves
    assert "the input reacts to the output (feedback)" in finding.message
    assert finding is found.findings[0]
    assert "the input reacts to the output (feedback)" in found.verdict


@pytest.mark.slow
def test_feedback_within_the_sample_is_not_called_a_missing_delay():
    n, rng = 1500, np.random.default_rng(2)
    b, a = _held()
    v = lfilter([1.0], [1.0, -0.9], 0.25 * rng.standard_normal(n))
    reference = prbs(n, 8)
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n):
        for i in (1, 2):
            y[k] += b[i] * u[k - i] - a[i] * y[k - i] if k >= i else 0.0
        u[k] = reference[k] - 0.6 * (y[k] + v[k])
    other = recorded(u, y + v)
    found = validate(identify(other, Structure(2, 0), throw=False), other)
    # it explains what the response seems to miss, so that is not told beside it
    (first,) = found.findings
    assert first.code == "feedback"
    assert "of the same sample" in first.message
    assert "delay" not in first.text


def _held():
    from scipy.signal import cont2discrete

    b, a, _ = cont2discrete(([9.0], [1.0, 1.2, 9.0]), DT)
    return b.ravel(), a


@pytest.mark.slow
def test_a_response_that_is_not_linear_is_hinted_at():
    u = np.random.default_rng(9).choice([-1.0, 0.3, 1.0], N // 8).repeat(8)
    y = response(u)
    other = recorded(u, y + 0.25 * y**2 + noise())
    found = validate(identify(other, *white(dataclasses.replace(REST, offset=True))), other)
    assert "nonlinear" in [f.code for f in found.findings]


@pytest.mark.judged
@pytest.mark.slow
def test_what_a_residual_is_searched_for_is_computed_once(monkeypatch):
    """A look and all tests after it share their columns."""
    asked, own = [], bends.bends

    def counted(view, output, estimate):
        asked.append((view, output))
        return own(view, output, estimate)

    monkeypatch.setattr(bends, "bends", counted)
    u = np.random.default_rng(77).choice([-1.0, 0.3, 1.0], N // 8).repeat(8)
    y = response(u)
    found = identify(recorded(u, y + 0.4 * y**2 + noise()), Structure(2, 0))
    assert any(one.matters for one in found.findings)
    assert asked
    assert len(asked) == len(set(asked))


@pytest.mark.slow
def test_coefficients_that_change_are_noticed():
    u = prbs(1200, 10)
    a, b = response(u), response(u, TransferFunction([9.0], [1.0, 1.2, 10.5]))
    other = recorded(u, np.where(np.arange(1200) < 600, a, b) + noise(1200))
    found = validate(identify(other, *white()), other)
    assert "varying" in [f.code for f in found.findings]


# --------------------------------------------------------------------------------- another record
def test_another_record_has_a_start_of_its_own(estimate):
    u = prbs(400, 20) + 0.5
    other = recorded(u, response(u) + 3.0 + noise(400, 21))
    found = validate(estimate, other)
    assert found.ok
    assert not found.own
    assert "offset" in found.notes[0]
    assert found.fit == pytest.approx(found.transfer.expected_fit, abs=1.5)


def test_as_good_as_can_be_is_said(estimate):
    u = 0.1 * prbs(400, 22)
    found = validate(estimate, recorded(u, response(u) + noise(400, 23)))
    assert found.ok
    assert found.fit[0] < 60
    assert "was to be expected" in found.verdict


def test_another_plant_is_told_from_another_noise(estimate):
    u = prbs(400, 24)
    noisy = validate(estimate, recorded(u, response(u) + noise(400, 25, 0.3)))
    assert noisy.ok
    assert [f.code for f in noisy.findings] == ["noise-size"]
    assert noisy.transfer.size_ratio == pytest.approx([0.3 / 0.08], rel=0.1)
    changed = TransferFunction([9.0], [1.0, 1.2, 10.0])
    other = validate(estimate, recorded(u, response(u, changed) + noise(400, 25)))
    assert other.findings[0].code == "another-system"
    assert not other.ok


@pytest.mark.slow
def test_a_residual_that_a_wrong_plant_makes_large_is_not_called_noise(estimate):
    u = prbs(400, 24)
    found = validate(estimate, recorded(u, response(u, TransferFunction([3.0], [1.0, 2.0]))))
    (size,) = (f for f in found.findings if f.code == "noise-size")
    assert "noisier" not in size.text
    assert "Mend what is missing" in size.remedy


def test_the_change_test_is_that_of_two_covariances(estimate):
    u = prbs(400, 28)
    other = recorded(u, response(u) + noise(400, 29))
    found = validate(estimate, other)
    moves = look(estimate, [other], None).outputs[0].coefficients[0]
    r = other.y[:, 0] - response(u, estimate.model)
    assert "initial state rest, no offset" in found.notes[0]
    q = np.linalg.qr(moves)[0]
    left = r - q @ (q.T @ r)
    s2 = left @ left / 397
    whole = s2 * np.eye(400) + moves @ moves.T
    inner = q.T @ whole @ q
    statistic = (q.T @ r) @ np.linalg.solve(inner, q.T @ r)
    from scipy.stats import f

    expected = f.sf(statistic / 3, 3, 397)
    assert found.transfer.coefficients_p_value == pytest.approx(expected, rel=1e-3)


# ----------------------------------------------------------------------------- records as they are
def test_missing_samples_and_uneven_time():
    rng = np.random.default_rng(30)
    t = np.cumsum(rng.uniform(0.02, 0.08, N))
    u = prbs()
    y = simulate(PLANT, Record(u, np.zeros(N), t=t))[:, 0] + noise()
    y[50:70] = np.nan
    uneven = Record(u, y, t=t, **NAMES)
    found = validate(identify(uneven, *white()), uneven)
    assert found.ok
    assert any("uneven" in note for note in found.notes)
    assert any("20 missing samples" in note for note in found.notes)
    assert np.isnan(found.residual[0][50:70]).all()
    assert found.uneven


@pytest.mark.slow
def test_several_experiments_and_channels_are_judged_by_name():
    rng = np.random.default_rng(31)
    u = rng.choice([-1.0, 1.0], (100, 2)).repeat(8, axis=0)
    names = {"input_names": ["elevator", "flap"], "output_names": ["q", "alpha"]}
    den = [1.0, 1.2, 9.0]
    plant = TransferFunction([[[9.0], [3.0]], [[1.0, 2.0], [4.0]]], [[den, den], [den, den]])
    y = simulate(plant, Record(u, np.zeros((800, 2)), dt=DT))
    y = y + np.std(y, axis=0) * 0.1 * rng.standard_normal(y.shape)
    pair = [Record(u[a:b], y[a:b], dt=DT, **names) for a, b in ((0, 400), (400, 800))]
    structure = Structure(2, [[0, 0], [1, 0]], offset=False, initial_state="free")
    estimate = identify(pair, *white(structure))
    found = validate(estimate, pair)
    assert found.ok
    assert found.fit == pytest.approx(estimate.fit, abs=1e-6)
    assert [(c.output, c.input) for c in found.cross_correlation] == [
        ("q", "elevator"),
        ("q", "flap"),
        ("alpha", "elevator"),
        ("alpha", "flap"),
    ]
    assert validate(estimate, pair[1], experiment=1).residual[0] == pytest.approx(
        found.residual[1], nan_ok=True
    )


@pytest.mark.slow
def test_the_input_that_is_late_is_named_among_others():
    rng = np.random.default_rng(31)
    u = rng.choice([-1.0, 1.0], (100, 2)).repeat(8, axis=0)
    den = [1.0, 1.2, 9.0]
    rows = [[[9.0], [3.0]], [[1.0, 2.0], [4.0]]]
    plant = TransferFunction(rows, [[den, den], [den, den]], delay=[[0.0, 0.4], [0.0, 0.0]])
    y = simulate(plant, Record(u, np.zeros((800, 2)), dt=DT))
    y = y + np.std(y, axis=0) * 0.1 * rng.standard_normal(y.shape)
    names = {"input_names": ["elevator", "flap"], "output_names": ["q", "alpha"]}
    one = Record(u, y, dt=DT, **names)
    structure = Structure(2, [[0, 0], [1, 0]], offset=False, initial_state="rest")
    first = validate(identify(one, *white(structure)), one).findings[0]
    assert first.outputs == ("q",)
    assert "flap" in first.message


@pytest.mark.slow
def test_an_order_that_is_too_low_is_found_on_uneven_time():
    t = np.cumsum(np.random.default_rng(30).uniform(0.02, 0.08, N))
    u = prbs()
    y = simulate(PLANT, Record(u, np.zeros(N), t=t))[:, 0] + noise()
    uneven = Record(u, y, t=t, **NAMES)
    low = validate(identify(uneven, *white(Structure(1, 0))), uneven)
    assert low.findings[0].code == "order-low"


def test_a_record_without_noise_is_not_tested():
    u = prbs(200)
    clean = recorded(u, response(u))
    found = validate(identify(clean, REST), clean)
    assert found.ok
    assert not found.tests
    assert "rounding" in found.verdict
    assert found.summary()


# --------------------------------------------------------------------------------- what is refused
def test_other_channels_are_refused(estimate, record):
    with pytest.raises(ChannelCountError, match=r"found a record with channels .*'de'"):
        validate(estimate, Record(record.u, record.y, dt=DT, input_names=["de"]))


def test_too_few_samples_are_refused(estimate, record):
    with pytest.raises(TooFewSamplesError, match="found 15 samples of output 'q'"):
        validate(estimate, record.slice(0.0, 14 * DT))


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"level": 1.0}, OptionError, "found level=1.0"),
        ({"level": 99}, OptionError, "found level=99"),
        ({"n_lags": 0}, OptionError, "found n_lags=0"),
        ({"experiment": 1}, DataError, "an experiment from 0 to 0"),
    ],
)
def test_options_out_of_range_are_refused(estimate, record, options, error, says):
    with pytest.raises(error, match=says):
        validate(estimate, record, **options)


def test_what_is_no_estimate_is_refused(estimate, record):
    with pytest.raises(SampleTypeError, match=r"found Record in place of an estimate.*write valid"):
        validate(record, estimate)
    with pytest.raises(SampleTypeError, match="found TransferFunction in place of an estimate"):
        validate(estimate.model, record)


def test_what_is_no_record_is_refused(estimate):
    with pytest.raises(SampleTypeError, match="found str in place of a record"):
        validate(estimate, ["flight.csv"])
    with pytest.raises(SampleTypeError, match="found nothing"):
        validate(estimate, [])


@pytest.mark.slow
def test_another_piece_in_which_nothing_moves_tells_nothing_of_the_coefficients():
    whole = short_period()
    low = identify(whole.slice(0.5, 7.8), (1, 0), throw=False)
    checked = validate(low, whole.slice(8.0, 9.8))
    assert checked.transfer is not None
    assert np.isnan(checked.transfer.coefficients_p_value)
    assert np.all(np.isfinite(checked.fit))


def test_samples_identified_by_their_interval_are_known_again_on_a_clock_from_elsewhere():
    u = prbs()
    record = recorded(u, response(u) + noise())
    late = Record(record.u, record.y, t=37.5 + DT * np.arange(N), **NAMES)
    estimate, other = identify(record, *white()), recorded(u, response(u) + noise(seed=7))
    own = [validate(estimate, one).notes[0].startswith("the record that") for one in (late, other)]
    assert own == [True, False]
