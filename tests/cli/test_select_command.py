"""`tridentify select`: what it reads, prints, writes, and how it ends."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tridentify import Estimate

pytestmark = pytest.mark.unjudged

QUESTION = ["--input", "elevator", "--output", "q"]
FEW = ["--poles", "1:2", "--zeros", "all"]


def test_the_table_names_the_recommended_row_and_why_and_progress_is_elsewhere(run, short):
    answer = run("select", short, *QUESTION, *FEW)
    assert answer.code == 0
    assert "recommended: 2, 1 (poles, zeros)" in answer.out
    marked = [line.split()[:3] for line in answer.out.splitlines() if line.startswith("->")]
    assert marked == [["->", "2,", "1"]]
    assert "2 poles and no zero" in " ".join(answer.out.split())
    assert "AICc" in answer.out
    assert "parallel model, for all candidates" in answer.err
    assert "the whole search for each: 3 of 3 done" in answer.err


@pytest.mark.slow
@pytest.mark.undrawn
def test_json_and_a_folder_hold_the_same(run, short, tmp_path):
    folder = tmp_path / "result"
    outcome = run("select", short, *QUESTION, *FEW, "--json", "--out", folder)
    document = json.loads(outcome.out)
    assert outcome.code == 0
    assert document["rows"][document["recommended"]]["label"] == "2, 1"
    assert {path.name for path in folder.iterdir()} == {
        "selection.json",
        "model.json",
        "selection.svg",
        "hankel.svg",
        "fit.svg",
        "report.html",
    }
    page = (folder / "report.html").read_text("utf-8")
    assert "Recommended: 2 poles and 1 zero" in page
    assert "Hankel singular values" in page
    stored = json.loads((folder / "selection.json").read_text("utf-8"))
    assert stored["reason"] == document["reason"]
    model = Estimate.load(folder / "model.json")
    assert model.parameters["a0"].value == document["rows"][2]["coefficients"]["a0"]["value"]


@pytest.mark.slow
def test_a_validation_file_judges(run, noisy, write_table, clean):
    noise = 1e-3 * np.random.default_rng(9).standard_normal(clean["q"].size)
    other = write_table("other.csv", clean | {"q": clean["q"] + noise})
    outcome = run("select", noisy, *QUESTION, "--poles", "2", "--zeros", "1", "--validation", other)
    assert outcome.code == 0
    assert "validation record" in outcome.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--poles", "a:b"], "found --poles 'a:b'; expected a range such as 1:4 or one number;"),
        (["--zeros", "some"], "found --zeros 'some'"),
        (["--poles", "2", "--zeros", "3:4"], "found no candidates"),
        (["--poles", "1:99"], "candidates for --poles 1:99"),
        (["--method", "guess"], "--method"),
        (["--jobs", "0"], "--jobs"),
    ],
)
def test_bad_usage_is_one_line_and_code_2(run, noisy, arguments, said):
    outcome = run("select", noisy, *QUESTION, *arguments)
    assert outcome.code == 2
    (line,) = outcome.error_lines
    assert said in line


def test_a_record_that_allows_no_answer_ends_with_code_1(run, write_table):
    still = {"t": np.arange(40) * 0.1, "elevator": np.ones(40), "q": np.ones(40)}
    outcome = run("select", write_table("still.csv", still), *QUESTION, "--poles", "1")
    assert outcome.code == 1
    assert "no usable candidate among 1 (1, 0);" in outcome.error_lines[-1]


@pytest.mark.slow
def test_several_processes_print_the_same(run, noisy):
    one = run("select", noisy, *QUESTION, *FEW, "--json")
    two = run("select", noisy, *QUESTION, *FEW, "--json", "--jobs", "2")
    assert json.loads(one.out) == json.loads(two.out)
