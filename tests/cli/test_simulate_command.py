"""``tridentify simulate``: the outputs of a stored model for the inputs of a file."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.export import write_json

pytestmark = pytest.mark.unjudged


@pytest.fixture(scope="module")
def place(tmp_path_factory, table_at, held):
    """A model of a flight, and the inputs of that flight alone."""
    folder = tmp_path_factory.mktemp("simulate")
    rng = np.random.default_rng(4)
    u = 0.05 * np.repeat(rng.choice([-1.0, 1.0], 20), 15)
    q = held([2.0, 3.0], u) + 1e-3 * rng.standard_normal(u.size)
    record = Record(u, q, dt=0.02, input_names=["elevator"], output_names=["q"])
    identify(record, Structure(2, 1)).save(folder / "model.json")
    table_at(folder / "inputs.csv", {"t": record.t, "elevator": u})
    return folder, record


def rows(text: str) -> tuple[list[str], np.ndarray]:
    head, *table = csv.reader(text.splitlines())
    return head, np.array(table, dtype=float)


def test_outputs_are_those_of_the_model_for_inputs_alone(run, place):
    from tridentify import Estimate

    folder, record = place
    expected = simulate(Estimate.load(folder / "model.json").model, record)
    outcome = run("simulate", folder / "model.json", folder / "inputs.csv")
    assert outcome.code == 0, outcome.err
    head, table = rows(outcome.out)
    assert head == ["t [s]", "q"]
    assert np.allclose(table, np.column_stack([record.t, expected]), rtol=1e-9, atol=1e-12)
    written = run("simulate", folder / "model.json", folder / "inputs.csv",
                  "--out", folder / "predicted.csv")  # fmt: skip
    assert written.code == 0
    assert rows((folder / "predicted.csv").read_text(encoding="utf-8"))[1].shape == table.shape
    document = run("simulate", folder / "model.json", folder / "inputs.csv", "--json")
    assert np.allclose(json.loads(document.out)["outputs"]["q"], table[:, 1])


def test_a_model_that_was_not_identified_is_simulated_too(run, place):
    folder, record = place
    model = TransferFunction([2.0], [1.0, 3.0], delay=0.04)
    write_json(model, folder / "plain.json")
    outcome = run("simulate", folder / "plain.json", folder / "inputs.csv", "--input", "elevator")
    assert outcome.code == 0, outcome.err
    assert np.allclose(rows(outcome.out)[1][:, 1:], simulate(model, record), rtol=1e-9, atol=1e-12)


def test_what_cannot_be_simulated_is_told_in_one_line(run, place, table_at):
    folder, record = place
    table_at(folder / "other.csv", {"t": record.t, "rudder": record.u[:, 0]})
    outcome = run("simulate", folder / "model.json", folder / "other.csv")
    assert outcome.code == 2
    assert "found no column 'elevator'" in outcome.error_lines[-1]
    missing = run("simulate", folder / "none.json", folder / "inputs.csv")
    assert missing.code == 2
