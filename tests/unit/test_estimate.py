"""Estimates: parameters and units, text, files, and the fitted output."""

from __future__ import annotations

import dataclasses
import json
import math
import pickle

import numpy as np
import pytest

from tridentify import identify, simulate
from tridentify.errors import DataError, OptionError, OutputPathError, UnreadableFileError
from tridentify.estimation.answer.estimate import (
    Estimate,
    Parameter,
    Pass,
    Start,
    Status,
    Step,
    Trace,
)
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction


def test_every_status_has_a_message_and_only_convergence_needs_no_remedy():
    assert all(status.message for status in Status)
    assert [status for status in Status if not status.remedy] == [Status.CONVERGED]
    unusable = {Status.MAX_PASSES, Status.STALLED, Status.AT_SAMPLING_LIMIT}
    assert {status for status in Status if not status.ok} == unusable


def test_interval_is_gaussian():
    low, high = Parameter("a0", 3.0, 0.1).interval(0.95)
    assert (low, high) == pytest.approx((3.0 - 0.195996, 3.0 + 0.195996), abs=1e-6)
    assert Parameter("a0", -4.0, 0.1).relative_std == pytest.approx(0.025)
    assert Parameter("a0", 0.0, 0.1).relative_std == math.inf
    with pytest.raises(OptionError, match="level=95; expected a probability between 0 and 1"):
        Parameter("a0", 3.0, 0.1).interval(95)


def test_parameters_carry_value_error_and_unit(double):
    estimate = double.estimate
    table = estimate.parameters
    assert list(table) == list(estimate.names)
    assert [p.value for p in table.values()] == estimate.theta.tolist()
    assert [p.std for p in table.values()] == pytest.approx(np.sqrt(np.diag(estimate.cov)))
    units = [p.unit for p in table.values()]
    assert units == ["1/s", "1/s^2", "1/s^2", "1/s^3", "1/s", "1/s^2"]
    with pytest.raises(TypeError):
        table["a0"] = Parameter("a0", 1.0, 1.0)


def test_unknown_channel_units_leave_numerators_without_unit(single):
    estimate = dataclasses.replace(single.estimate, units={})
    assert [p.unit for p in estimate.parameters.values()] == ["1/s", "1/s^2", ""]


def test_arrays_are_copied_and_read_only(single):
    theta = np.array(single.estimate.theta)
    estimate = dataclasses.replace(single.estimate, theta=theta)
    theta[0] = 99.0
    assert estimate.theta[0] != 99.0
    with pytest.raises(ValueError, match="read-only"):
        estimate.theta[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        estimate.nuisance[0].offset[0] = 1.0


@pytest.mark.parametrize("field", ["theta", "cov", "fit", "noise_variance"])
def test_arrays_of_another_shape_are_refused(single, field):
    with pytest.raises(ValueError, match=f"found {field} of shape"):
        dataclasses.replace(single.estimate, **{field: np.zeros((5, 5))})


def test_channel_covariance_follows_the_names(double):
    num, den, cov = double.estimate.channel(1, 0)
    theta = double.estimate.theta
    assert num == pytest.approx(theta[4:6])
    assert den == pytest.approx([1.0, *theta[:2]])
    picked = [0, 1, 4, 5]
    assert cov[:4, :4] == pytest.approx(double.estimate.cov[np.ix_(picked, picked)])
    assert not cov[4].any()  # no free delay


def test_free_delay_enters_the_channel_covariance(single):
    cov = np.diag([1.0, 2.0, 3.0, 4.0])
    estimate = dataclasses.replace(
        single.estimate,
        structure=dataclasses.replace(single.estimate.structure, delay="free"),
        names=("a1", "a0", "b0", "delay"),
        theta=np.array([1.0, 3.0, 0.5, 0.1]),
        cov=cov,
    )
    assert estimate.channel(0, 0)[2] == pytest.approx(cov)
    assert estimate.parameters["delay"].unit == "s"


def test_separate_denominators_have_their_own_poles_and_names(single):
    names = ("a0[q,e]", "b0[q,e]", "a1[q,r]", "a0[q,r]", "b0[q,r]")
    estimate = dataclasses.replace(
        single.estimate,
        model=TransferFunction([[[2.0], [3.0]]], [[[1.0, 4.0], [1.0, 1.0, 9.0]]]),
        structure=Structure([[1, 2]], 0),
        names=names,
        theta=np.array([4.0, 2.0, 1.0, 9.0, 3.0]),
        cov=np.diag([0.1, 0.2, 0.3, 0.4, 0.5]),
        input_names=("e", "r"),
    )
    rows = {row[0]: row[1:3] for row in estimate.derived_rows()}
    assert rows["real pole[q,e]"] == pytest.approx((-4.0, math.sqrt(0.1)))
    assert rows["natural frequency[q,r]"][0] == pytest.approx(3.0)
    assert rows["dc gain[q,r]"][0] == pytest.approx(1 / 3)
    assert "a1[q,r]" in estimate.summary()


def test_summary_states_all_that_matters(double):
    text = double.estimate.summary()
    assert max(map(len, text.splitlines())) <= 78
    for part in ("b0[alpha,elevator]", "natural frequency", "damping", "dc gain[q,elevator]"):
        assert part in text
    for part in ("converged to a stationary point", "rad/s", "fit [%]", "93.21", "samples 600"):
        assert part in text
    assert "initial state: at rest (AICc +3.1)" in text
    assert "offset[alpha]" in text
    assert "what to do" not in text


def test_summary_gives_the_remedy_when_there_is_one(single):
    stalled = dataclasses.replace(single.estimate, status=Status.STALLED)
    unwrapped = " ".join(stalled.summary().split())
    assert f"what to do: {Status.STALLED.remedy}" in unwrapped
    assert max(map(len, stalled.summary().splitlines())) <= 78


def test_summary_survives_an_unusable_covariance(single):
    broken = dataclasses.replace(
        single.estimate, cov=np.full((3, 3), np.nan), gradient=math.nan, condition=math.inf
    )
    assert "nan" not in broken.summary()  # what is not known is left blank
    assert "a0" in broken.summary()
    assert "condition inf" in broken.summary()


def test_repr_is_one_short_line(single):
    assert (
        repr(single.estimate) == "Estimate(ThreeModel: converged; a1=1.0024, a0=3.0066, b0=0.5018)"
    )


def test_html_is_escaped(single):
    channels = {"output_names": ("<q>",), "method": "a<b"}
    html = dataclasses.replace(single.estimate, **channels)._repr_html_()
    assert "<q>" not in html
    assert "a&lt;b" in html
    assert "<td>a1</td>" in html


def _same(one, other):
    if dataclasses.is_dataclass(one) and not isinstance(one, (Structure, TransferFunction)):
        fields = [field.name for field in dataclasses.fields(one)]
        return all(_same(getattr(one, name), getattr(other, name)) for name in fields)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, (Structure, TransferFunction)):
        return one.to_dict() == other.to_dict()
    if isinstance(one, (float, np.ndarray)):
        same_shape = np.shape(one) == np.shape(other)
        return same_shape and np.array_equal(one, other, equal_nan=True)
    return one == other


@pytest.mark.parametrize("case", ["single", "double"])
def test_saved_estimate_comes_back_exactly(case, request, tmp_path):
    estimate = request.getfixturevalue(case).estimate
    path = estimate.save(tmp_path / "new folder" / "model.json")
    assert _same(estimate, Estimate.load(path))
    assert [file.name for file in path.parent.iterdir()] == ["model.json"]


def test_nan_infinity_and_absent_dt_survive_the_file(single, tmp_path):
    trace = Trace(
        (Pass(1, (Step("series", [math.inf, math.nan], 1.0, math.inf),), [1, 2, 3], 1.0),),
        (Start("bad", [math.nan, 1.0, 2.0], -math.inf),),
    )
    odd = dataclasses.replace(
        single.estimate,
        cov=np.full((3, 3), np.inf),
        gradient=math.nan,
        aicc=-math.inf,
        dt=None,
        trace=trace,
    )
    path = odd.save(tmp_path / "odd.json")
    json.loads(path.read_text(), parse_constant=pytest.fail)  # strict JSON: no bare NaN
    assert _same(odd, Estimate.load(path))


def test_estimates_can_be_pickled(double):
    assert _same(double.estimate, pickle.loads(pickle.dumps(double.estimate)))


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [
        ("", UnreadableFileError, "no readable estimate"),
        ("[1, 2]", DataError, "found schema None"),
        ('{"schema": 99}', DataError, "found schema 99"),
        ('{"schema": 2, "theta": [1]}', DataError, "damaged"),
        ('{"schema": 2, "surprise": 1}', DataError, "damaged"),
    ],
)
def test_other_files_are_refused(tmp_path, content, error, words):
    path = tmp_path / "model.json"
    path.write_text(content)
    with pytest.raises(error, match=words):
        Estimate.load(path)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(UnreadableFileError, match=r"none\.json"):
        Estimate.load(tmp_path / "none.json")


def test_unwritable_place_leaves_nothing_behind(single, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputPathError, match="choose another output path"):
        single.estimate.save(tmp_path / "file" / "model.json")
    (tmp_path / "model.json").mkdir()
    (tmp_path / "model.json" / "kept").write_text("")
    with pytest.raises(OutputPathError):
        single.estimate.save(tmp_path / "model.json")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["file", "model.json"]


def _at_truth(case):
    estimate, theta = case.estimate, case.truth
    num, den = estimate.structure.split(theta, len(estimate.output_names), 1)
    model = TransferFunction(
        num, den, input_names=estimate.input_names, output_names=estimate.output_names
    )
    return dataclasses.replace(estimate, theta=theta, model=model)


@pytest.mark.parametrize("case", ["single", "double"])
def test_prediction_adds_trim_offset_drift_and_free_response(case, request):
    known = request.getfixturevalue(case)
    predicted = _at_truth(known).predict(known.record)
    assert predicted == pytest.approx(known.clean, abs=1e-12)


def test_residual_is_nan_where_nothing_was_recorded(single):
    y = np.array(single.record.y)
    y[7] = np.nan
    gap = Record(single.record.u, y, dt=0.02)
    residual = single.estimate.residual(gap)
    assert np.flatnonzero(np.isnan(residual[:, 0])).tolist() == [7]
    expected = y - single.estimate.predict(single.record)
    assert residual == pytest.approx(expected, abs=1e-15, nan_ok=True)


def test_prediction_takes_the_terms_of_the_asked_experiment(single):
    first = single.estimate.nuisance[0]
    second = dataclasses.replace(first, offset=np.array([5.0]))
    estimate = dataclasses.replace(single.estimate, nuisance=(first, second))
    rise = estimate.predict(single.record, experiment=1) - estimate.predict(single.record)
    assert rise == pytest.approx(5.0)


def test_record_with_other_channels_is_refused(single, double):
    with pytest.raises(DataError, match="found a record with 1 inputs and 2 outputs"):
        single.estimate.predict(double.record)


@pytest.mark.unjudged
def test_a_natural_frequency_that_is_held_has_no_standard_error():
    u = np.sign(np.sin(np.arange(400) ** 1.5))
    y = simulate(TransferFunction([1.0], [1.0, 1.0, 3.0]), Record(u, u, dt=0.05))
    y = y + 0.01 * np.random.default_rng(0).standard_normal(y.shape)
    estimate = identify(Record(u, y, dt=0.05), Structure(2, 0, fixed={"a0": 3.0}))
    found = {row[0]: row for row in estimate.derived_rows()}
    assert found["natural frequency"][1:3] == (pytest.approx(3.0**0.5), 0.0)
    assert found["damping"][2] > 0.0
