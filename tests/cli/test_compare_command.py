"""``tridentify compare``: models and files told apart, fits as text and JSON, the picture."""

from __future__ import annotations

import json
import shutil

import matplotlib.pyplot as plt
import numpy as np
import pytest

from tridentify import Estimate, Structure, compare, identify, read_record
from tridentify.export import write_json

pytestmark = pytest.mark.unjudged


@pytest.fixture(scope="module")
def place(tmp_path_factory, table_at, held):
    """Two flights that start and are trimmed differently, and models of the first of them."""
    folder = tmp_path_factory.mktemp("compare")
    rng = np.random.default_rng(4)
    for name, offset in (("one", 0.0), ("two", 0.4)):
        u = 0.05 * np.repeat(rng.choice([-1.0, 1.0], 40), 15)
        q = held([2.0, 3.0], u) + 1e-3 * rng.standard_normal(u.size)
        columns = {"t": 0.02 * np.arange(u.size), "elevator": u + offset, "q": q + offset}
        table_at(folder / f"{name}.csv", columns)
        turned = {"time": columns["t"], "rate": columns["q"], "de": columns["elevator"]}
        table_at(folder / f"{name}-renamed.csv", turned)
    record = read_record(folder / "one.csv", time="t", inputs=["elevator"], outputs=["q"])
    right = identify(record, Structure(2, 1))
    (folder / "right").mkdir()
    right.save(folder / "right" / "model.json")
    identify(record, Structure(1, 0)).save(folder / "low.json")
    write_json(right.model, folder / "plain.json")
    return folder


@pytest.mark.slow
def test_models_are_simulated_on_files_as_compare_does(run, place):
    outcome = run("compare", place / "right", place / "low.json", place / "one.csv",
                  place / "two.csv", "--json")  # fmt: skip
    assert outcome.code == 0
    document = json.loads(outcome.out)
    assert document["models"] == ["right", "low"]
    assert document["records"] == ["one", "two"]
    records = [
        read_record(place / f"{name}.csv", time="t", inputs=["elevator"], outputs=["q"])
        for name in ("one", "two")
    ]
    models = [Estimate.load(place / "right" / "model.json"), Estimate.load(place / "low.json")]
    assert document["fits"] == pytest.approx(compare(models, records).fits)
    fits = np.array(document["fits"])[:, :, 0]
    assert np.all(fits[0] > 94.0)
    assert np.all(fits[1] < 80.0)


def test_the_text_names_what_was_fitted_and_the_poles(run, place):
    outcome = run(
        "compare", place / "right" / "model.json", place / "plain.json", place / "two.csv"
    )
    assert outcome.code == 0
    assert "Initial state and offset are fitted to each record" in " ".join(outcome.out.split())
    assert "natural frequency" in outcome.out
    assert max(map(len, outcome.out.splitlines())) <= 80


def test_columns_may_be_called_otherwise(run, place):
    plain = run("compare", place / "right", place / "two.csv", "--json")
    renamed = run("compare", place / "right", place / "two-renamed.csv", "--input", "de",
                  "--output", "rate", "--json")  # fmt: skip
    fits = [json.loads(one.out)["fits"] for one in (plain, renamed)]
    assert np.array(fits[0]) == pytest.approx(np.array(fits[1]))


def test_the_folder_gets_picture_and_numbers_and_pyplot_nothing(run, place, tmp_path):
    outcome = run("compare", place / "right", place / "two.csv", "--out", tmp_path / "c", "--json")
    files = sorted(path.name for path in (tmp_path / "c").iterdir())
    assert files == ["comparison.json", "comparison.svg"]
    kept = json.loads((tmp_path / "c" / "comparison.json").read_text())
    shown = json.loads(outcome.out)
    assert kept["fits"] == shown["fits"]
    assert "<path" in (tmp_path / "c" / "comparison.svg").read_text()
    assert plt.get_fignums() == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["right"], "found no record among"),
        (["one.csv"], "found no model among"),
        (["low.json", "none.csv"], "none.csv"),
        (["none.json", "one.csv"], "none.json"),
        (["low.json", "one-renamed.csv"], "elevator"),
        (["low.json", "one.csv", "--output", "q", "--output", "r"], "found 2 --output"),
        (["low.json", "one.csv", "one.csv"], "twice"),
    ],
)
def test_what_cannot_be_compared_is_one_line(run, place, words, says):
    outcome = run("compare", *(place / word if "." in word or word == "right" else word
                               for word in words))  # fmt: skip
    assert outcome.code == 2
    assert outcome.out == ""
    assert len(outcome.error_lines) == 1
    assert says in outcome.error_lines[0]


def test_models_of_one_name_are_numbered(run, place, tmp_path):
    for name in ("a", "b"):
        shutil.copytree(place / "right", tmp_path / name / "right")
    outcome = run("compare", tmp_path / "a" / "right", tmp_path / "b" / "right",
                  place / "two.csv", "--json")  # fmt: skip
    assert json.loads(outcome.out)["models"] == ["right", "right 2"]
