"""Models as bytes: the same as the files, and read by those they are for."""

import csv
import json

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.errors import OptionError
from tridentify.export import (
    read_json,
    to_bytes,
    write_c_header,
    write_control_script,
    write_json,
    write_matlab,
    write_table,
)

PLANT = TransferFunction(
    [[[2.0, 1.0], [3.0]]],
    [[[1.0, 0.5, 4.0], [1.0, 2.0]]],
    delay=[[0.0, 0.3]],
    input_names=["elevator", 'thr"ust\u00b0'],
    output_names=["q"],
)


@pytest.fixture(scope="module")
def estimate():
    rng = np.random.default_rng(2)
    u = rng.choice([-1.0, 1.0], (300, 2)).repeat(2, axis=0)
    plant = TransferFunction([[[2.0], [1.0]], [[0.5], [3.0]]], [1.0, 1.2, 4.0])
    record = Record(u, np.zeros((600, 2)), dt=0.05)
    y = simulate(plant, record) + 0.01 * rng.standard_normal((600, 2))
    return identify(Record(u, y, dt=0.05, output_names=["q", "alpha"]), Structure(2, 0))


@pytest.mark.parametrize(
    ("ending", "write"),
    [
        (".json", write_json),
        (".mat", write_matlab),
        (".m", write_matlab),
        (".py", write_control_script),
        (".csv", write_table),
    ],
)
def test_bytes_are_those_of_the_file(estimate, tmp_path, ending, write):
    path = write(estimate, tmp_path / f"model{ending}")
    assert to_bytes(estimate, ending) == path.read_bytes()


def test_a_filter_takes_the_name_that_is_given(estimate, tmp_path):
    path = write_c_header(estimate, 0.01, tmp_path / "short_period.h")
    assert to_bytes(estimate, ".h", dt=0.01, name="short_period") == path.read_bytes()


def test_an_estimate_comes_back_from_its_bytes(estimate, tmp_path):
    path = tmp_path / "again.json"
    path.write_bytes(to_bytes(estimate, ".json"))
    np.testing.assert_array_equal(read_json(path).theta, estimate.theta)


def test_a_table_keeps_names_with_commas(estimate):
    rows = list(csv.reader(to_bytes(estimate, ".csv").decode().splitlines()))
    assert [row[0] for row in rows[1:]] == list(estimate.names)
    assert any("," in row[0] for row in rows[1:])
    values = [[float(cell) for cell in row[1:3]] for row in rows[1:]]
    np.testing.assert_array_equal(values, np.column_stack([estimate.theta, estimate.std]))


def test_the_script_makes_the_model():
    control = pytest.importorskip("control", reason="python-control is not installed")
    made: dict = {}
    exec(to_bytes(PLANT, ".py").decode("ascii"), made)
    model = made["model"]
    assert isinstance(model, control.TransferFunction)
    assert made["delay"] == [[0.0, 0.3]]
    assert model.input_labels == list(PLANT.input_names)
    s = 0.7j
    undelayed = np.array([[(2 * s + 1) / (s * s + 0.5 * s + 4), 3 / (s + 2)]])
    np.testing.assert_allclose(model(s), undelayed, rtol=1e-12)


@pytest.mark.parametrize(
    ("ending", "words"), [(".h", "found no dt"), (".csv", "expected an estimate"), (".xls", ".mat")]
)
def test_what_cannot_be_written_is_refused(ending, words):
    with pytest.raises(OptionError, match=words):
        to_bytes(PLANT, ending)


def test_a_model_without_errors_is_json_too():
    assert json.loads(to_bytes(PLANT, ".json"))["delay"] == [[0.0, 0.3]]
