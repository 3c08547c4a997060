"""A stored model is named by its file or its folder, and what is swapped is told in one line."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from tridentify import Structure, identify, read_record

pytestmark = pytest.mark.unjudged


@pytest.fixture(scope="module")
def place(tmp_path_factory, table_at, held):
    """A flight, its model in a folder, and a folder without one."""
    folder = tmp_path_factory.mktemp("stored")
    rng = np.random.default_rng(8)
    u = 0.05 * np.repeat(rng.choice([-1.0, 1.0], 20), 15)
    q = held([2.0, 3.0], u) + 1e-3 * rng.standard_normal(u.size)
    columns = {"t": 0.02 * np.arange(u.size), "elevator": u, "q": q}
    table_at(folder / "flight.csv", columns)
    record = read_record(folder / "flight.csv", inputs=["elevator"], outputs=["q"])
    (folder / "result").mkdir()
    identify(record, Structure(2, 1)).save(folder / "result" / "model.json")
    (folder / "empty").mkdir()
    return folder


EXCITE = ("excite", "3-2-1-1", "--dt", 0.02, "--for-frequency", 3, "--noise", 0.01, "--json")


@pytest.mark.slow
@pytest.mark.parametrize("model", ["result", "result/model.json"])
def test_the_folder_stands_for_the_model_in_it(run, place, tmp_path, model):
    validated = run("validate", place / model, place / "flight.csv", "--json")
    assert validated.code == 0
    assert json.loads(validated.out)["fit"][0] > 90.0
    exported = run("export", place / model, tmp_path / "plant.h", "--dt", 0.02)
    assert exported.code == 0
    assert (tmp_path / "plant.h").read_text().count("double") > 0
    assert run(*EXCITE, "--model", place / model, "--out", tmp_path / "plan.csv").code == 0


@pytest.mark.parametrize("model", ["result", "result/model.json"])
def test_swapped_arguments_are_told_in_one_line(run, place, model):
    for command in (
        ("validate", place / "flight.csv", place / model),
        ("export", place / "plant.h", place / model, "--dt", 0.02),
    ):
        outcome = run(*command)
        assert outcome.code == 2
        assert len(outcome.error_lines) == 1
        assert "FILE and MODEL are swapped" in outcome.error_lines[0]
        assert f"tridentify {command[0]} result/model.json" in outcome.error_lines[0]


def test_a_record_or_an_empty_folder_is_no_model(run, place, tmp_path):
    for wrong, words in (
        ("flight.csv", "where the model belongs"),
        ("empty", "found no model.json in the folder"),
    ):
        for command in (
            ("validate", place / wrong, place / "flight.csv"),
            ("export", place / wrong, tmp_path / "plant.h", "--dt", 0.02),
            (*EXCITE, "--model", place / wrong),
        ):
            outcome = run(*command)
            assert outcome.code == 2
            assert len(outcome.error_lines) == 1
            assert words in outcome.error_lines[0]


def test_a_model_may_have_any_name(run, place, tmp_path):
    shutil.copy(place / "result" / "model.json", tmp_path / "saved.txt")
    assert run("export", tmp_path / "saved.txt", tmp_path / "plain.json").code == 0
    assert (tmp_path / "plain.json").is_file()
