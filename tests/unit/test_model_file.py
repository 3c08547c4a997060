"""A saved estimate that was changed by hand: refused in one line that says which field."""

from __future__ import annotations

import dataclasses
import json
import math
import time

import numpy as np
import pytest

from tridentify import Estimate, Record, TransferFunction
from tridentify.errors import (
    ChannelNameError,
    CoefficientError,
    DataError,
    OrderError,
    ParameterNameError,
    ScaleError,
    TridentifyError,
    UnitError,
    UnreadableFileError,
)
from tridentify.estimation.answer.encoding import check_covariance, decode, read_json
from tridentify.estimation.answer.encoding.document import DEEPEST, MOST_BYTES, MOST_VALUES
from tridentify.estimation.answer.encoding.values import _DECODERS
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.trace import Trace
from tridentify.export import read_json as read_model
from tridentify.export import write_c_header, write_json
from tridentify.physical.result import PhysicalEstimate
from tridentify.structure import Structure

CHANGES = {
    "a billion poles": (("structure", "poles"), 10**9, "poles"),
    "unstable noise": (("noise_model",), [[1e9] * 5], "noise model"),
    "no experiment": (("nuisance",), [], "nuisance"),
    "a long denominator": (("model", "den"), [[[1.0] * 2000]], "2000"),
    "numbers as names": (("names",), [1, 2, 3, 4], "names"),
    "other names": (("names",), ["a1", "a0", "b1"], "3 coefficients"),
    "names of code": (("names",), ["a1", "a0", "system('ls')"], "3 coefficients"),
    "theta as text": (("theta",), "inf", "theta"),
    "theta infinite": (("theta", 0), "inf", "theta"),
    "theta too large": (("theta", 0), 1e200, "sizes"),
    "theta of another model": (("theta", 0), 7.0, "model"),
    "samples below zero": (("n_samples",), -5, "-5 samples"),
    "a fraction of a sample": (("n_samples",), 5.5, "n_samples"),
    "a truth as a number": (("n_samples",), True, "n_samples"),
    "an unknown course": (("intersample",), "cubic", "intersample"),
    "an unknown status": (("status",), "FINE", "status"),
    "an unknown loss": (("loss",), "absolute", "loss"),
    "asymmetric covariance": (("cov", 0, 1), 0.1, "symmetric"),
    "negative variance": (("cov", 0, 0), -1.0, "below zero"),
    "a hole in the covariance": (("cov", 0, 1), None, "not finite"),
    "a code as a unit": (("units", "elevator"), "[*\\\n/ static void evil(void){} /", "units"),
    "a unit of nothing": (("units", "nobody"), "V", "nobody"),
    "a mark in a name": (("input_names", 0), "ele\u202evator", "input_names"),
    "an endless name": (("input_names", 0), "e" * 1000, "200 characters"),
    "a shape of free response": (("nuisance", 0, "free_response"), [[1.0]], "free response"),
    "an unknown initial state": (("nuisance", 0, "initial_state"), "odd", "initial_state"),
    "a huge whole number": (("n_samples",), 10**400, "whole number"),
    "a negative step": (("dt",), -0.1, "dt"),
    "a negative variance of noise": (("noise_variance", 0), -1.0, "noise_variance"),
    "outliers of another shape": (("outliers",), [[1.0, 2.0]], "outliers"),
    "escape codes": (("method",), "\x1b[2J", "method"),
    "an endless text": (("method",), "x" * 30_000, "method"),
    "a field too many": (("surprise",), 1, "surprise"),
    "another kind of trace": (("trace",), [1], "trace"),
}  # fmt: skip


@pytest.fixture
def document(single, tmp_path):
    return json.loads(single.estimate.save(tmp_path / "made.json").read_text("utf-8"))


def refused(text, path):
    path.write_text(text, encoding="utf-8")
    begin = time.process_time()
    with pytest.raises(TridentifyError) as caught:
        Estimate.load(path)
    assert time.process_time() - begin < 5.0
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000
    return caught.value


@pytest.mark.parametrize("what", CHANGES)
def test_a_changed_field_is_refused_by_its_name(document, what, tmp_path):
    (*path, last), value, words = CHANGES[what]
    holder = document
    for key in path:
        holder = holder[key]
    holder[last] = value
    error = refused(json.dumps(document), tmp_path / "model.json")
    assert isinstance(error, DataError)
    assert words in str(error)


@pytest.mark.parametrize("field", ["theta", "cov", "structure", "nuisance", "status", "names"])
def test_a_missing_field_is_named(document, field, tmp_path):
    del document[field]
    assert f"'{field}'" in str(refused(json.dumps(document), tmp_path / "model.json"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"cost": ', '"cost": 1e999, "x": ', "range of a float"),
        ('"cost": ', '"cost": NaN, "x": ', "NaN"),
        ('"cost": ', '"cost": ' + "[" * 200_000 + ', "x": ', "deep"),
        ('"cost": ', '"cost": 1, "cost": ', "twice"),
        ('"cost": ', '"cost": ' + "9" * 5000 + ', "x": ', "digits"),
    ],
)
def test_what_no_estimate_writes_is_no_readable_file(document, old, new, words, tmp_path):
    text = json.dumps(document)
    assert old in text
    error = refused(text.replace(old, new, 1), tmp_path / "model.json")
    assert isinstance(error, UnreadableFileError)
    assert words in str(error)


def test_depth_and_size_of_a_document_have_an_end(tmp_path):
    path = tmp_path / "model.json"
    path.write_text("[" * DEEPEST + "]" * DEEPEST)
    assert read_json(path)
    path.write_text("[" * (DEEPEST + 1) + "]" * (DEEPEST + 1))
    with pytest.raises(ValueError, match="deep"):
        read_json(path)
    path.write_text("[" + "0," * (MOST_VALUES + 1) + "0]")
    with pytest.raises(ValueError, match="values"):
        read_json(path)
    with path.open("wb") as stream:
        stream.truncate(40 * MOST_BYTES)  # a sparse file: nothing of it is stored
    with pytest.raises(UnreadableFileError, match="128 MiB"):
        Estimate.load(path)


def test_every_field_of_what_is_saved_has_a_decoder():
    kinds = {"Estimate"}
    for cls in (Estimate, PhysicalEstimate, Trace, Finding):
        for field in dataclasses.fields(cls):
            assert str(field.type) in _DECODERS.keys() | kinds, field.name


def test_decoding_does_not_take_one_type_for_another():
    for wrong in ("1.0", True, [1.0], {}):
        with pytest.raises(ValueError, match="cost"):
            decode(Trace, {"passes": [], "starts": [{"name": "a", "theta": [], "cost": wrong}]})
    for wrong in (1.0, None, ["1"], [[1.0], 2.0], [[1.0], [1.0, 2.0]], [[[[1.0]]]], [True]):
        with pytest.raises(ValueError, match="theta"):
            decode(Trace, {"passes": [], "starts": [{"name": "a", "theta": wrong, "cost": 1.0}]})


@pytest.mark.parametrize(
    "cov",
    [
        [[1.0, 2.0], [2.0, 1.0]],
        [[0.0, 1.0], [1.0, 1.0]],
        [[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]],
        [[1.0, math.inf], [math.inf, 1.0]],
        [[1e300, 1e299], [1e290, 1e300]],
    ],
)
def test_what_is_no_covariance_is_refused(cov):
    with pytest.raises(CoefficientError, match="covariance"):
        check_covariance(np.array(cov))


def test_a_covariance_without_what_is_not_known_is_taken():
    unknown = math.nan
    check_covariance(np.full((3, 3), unknown))
    check_covariance(np.array([[1.0, unknown], [unknown, unknown]]))
    check_covariance(np.array([[1.0, 1.0 + 1e-9], [1.0, 1.0]]))
    check_covariance(np.zeros((2, 2)))


def test_an_estimate_has_the_names_that_its_structure_gives(single):
    with pytest.raises(ParameterNameError, match="names"):
        dataclasses.replace(single.estimate, names=("a1", "a0", "b7"))
    with pytest.raises(ParameterNameError, match="names"):
        dataclasses.replace(single.estimate, structure=Structure(1, 1))
    with pytest.raises(UnitError, match="printable"):
        dataclasses.replace(single.estimate, units={"q": "rad\n/s"})
    with pytest.raises(ChannelNameError, match="printable"):
        dataclasses.replace(single.estimate, input_names=("ele\u2066vator",))


def test_orders_have_a_limit():
    assert Structure(200, 200).n_parameters() == 401
    for poles in (201, 10**9, 10**400):
        with pytest.raises(OrderError, match="at most 200"):
            Structure(poles, 0)


def test_a_changed_plain_model_is_refused(tmp_path):
    path = write_json(TransferFunction([2.0], [1.0, 2.0]), tmp_path / "model.json")
    document = json.loads(path.read_text("utf-8"))
    for key, value in (
        ("den", [[[1.0] * 2000]]),
        ("num", "1"),
        ("den", [[[1.0, "2"]]]),
        ("delay", [[-1.0]]),
        ("output_names", ["a", "b"]),
        ("input_names", ["u\n"]),
        ("extra", 1),
        ("model_schema", True),
    ):
        path.write_text(json.dumps({**document, key: value}), encoding="utf-8")
        with pytest.raises(DataError) as caught:
            read_model(path)
        assert str(caught.value).isprintable(), key


def test_a_response_without_room_is_one_error(single, tmp_path):
    model = TransferFunction([1.0], [1.0, -1e6])
    with pytest.raises(ScaleError, match="range of numbers"):
        write_c_header(model, 1.0, tmp_path / "model.h")
    assert not (tmp_path / "model.h").exists()


def test_an_extreme_model_that_is_loaded_can_be_printed(document, tmp_path):
    theta = [1e120, 1e-140, 1e140]
    document["theta"], document["cov"] = theta, np.zeros((3, 3)).tolist()
    document["model"]["den"], document["model"]["num"] = [[[1.0, *theta[:2]]]], [[theta[2:]]]
    path = tmp_path / "model.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    found = Estimate.load(path)
    assert "dc gain" in found.summary()
    assert found.parameters["a1"].value == 1e120


def test_channels_of_several_estimates_have_their_own_covariance(double):
    cov = double.estimate.channel(1, 0)[2]
    positions = [double.estimate.names.index(name) for name in ("a1", "a0")]
    np.testing.assert_array_equal(cov[:2, :2], double.estimate.cov[np.ix_(positions, positions)])
    assert not cov[-1].any()


def test_a_record_takes_no_unit_or_name_that_is_not_printable():
    u = [0.0, 1.0]
    for odd in ("a\nb", "a\u202eb", "a\x1b[2J", "a\u2028b", "\ud800", "x" * 201):
        with pytest.raises(ChannelNameError, match="printable") as caught:
            Record(u, u, dt=1.0, input_names=[odd])
        assert str(caught.value).isprintable()
        with pytest.raises(UnitError, match="printable") as caught:
            Record(u, u, dt=1.0, units={"u": odd})
        assert str(caught.value).isprintable()
    assert Record(u, u, dt=1.0, units={"u": "°/s²"}).units["u"] == "°/s²"
