"""Pages of physical parameters, selections and validations: what they say first, and the rest."""

from __future__ import annotations

import dataclasses
import html
import re
from functools import cache

import numpy as np
import pytest

from tridentify import (
    Record,
    Structure,
    TransferFunction,
    identify,
    select_structure,
    simulate,
    validate,
)
from tridentify.physical import estimate_physical
from tridentify.physical.mechanical import mass_spring_damper
from tridentify.report import (
    write_physical_report,
    write_selection_report,
    write_validation_report,
)
from tridentify.report.physical_page import contradictions

PLANT = TransferFunction([9.0], [1.0, 1.2, 9.0])


def record_of(plant, seed, n=400, size=0.05, name=""):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10)
    y = simulate(plant, Record(u, u, dt=0.05))[:, 0] + size * rng.standard_normal(n)
    names = {"input_names": ["force"], "output_names": ["position"]}
    units = {"force": "N", "position": "m"}
    return Record(u, y, dt=0.05, name=name, units=units, **names)


def first_of(path):
    text = path.read_text(encoding="utf-8")
    return text, text[: text.index("<nav")]


@pytest.fixture(scope="module")
def found():
    return estimate_physical(mass_spring_damper(), record_of(PLANT, 1))


@pytest.mark.slow
@pytest.mark.undrawn
def test_physical_parameters_stand_first_and_what_speaks_against_the_map_too(found, tmp_path):
    path = write_physical_report(found, record_of(PLANT, 1), tmp_path / "r.html", figures=tmp_path)
    text, first = first_of(path)
    for name, item in found.parameters.items():
        assert f"<dt>{name}</dt>" in first
        assert f"± {item.std:.2g}"[:4] in first
    assert "3 of 3 parameters are determined" in first
    assert "Measured against model" in first
    for heading in ("Physical parameters", "Correlations", "What speaks against the map"):
        assert heading in text
    correlation = found.cov[0, 1] / (found.std[0] * found.std[1])
    assert f">{correlation:.2f}<" in text
    assert (tmp_path / "fit.svg").exists()


def test_a_contradiction_says_how_much_it_matters(found):
    assert contradictions(dataclasses.replace(found, p_value=0.2)) == ()
    slight = dataclasses.replace(found, p_value=1e-9, fit=found.estimate.fit - 0.1, freedom=1)
    (finding,) = contradictions(slight)
    assert finding.severity == "note"
    assert "p < 0.001" in finding.message
    assert "1 degree of freedom" in finding.message
    (finding,) = contradictions(dataclasses.replace(slight, fit=found.estimate.fit - 5.0))
    assert finding.severity == "warning"
    assert finding.effect.endswith("A simulation shows it.")
    before, after = found.estimate.fit[0], found.estimate.fit[0] - 5.0
    assert f"fit of position from {before:.2f} to {after:.2f} %" in finding.effect


@cache
def selected():
    """A record, and what is recommended for it."""
    record = record_of(PLANT, 2)
    return record, select_structure(record, [Structure(1, 0), Structure(2, 0), Structure(3, 0)])


@pytest.mark.slow
@pytest.mark.undrawn
def test_a_selection_shows_the_recommended_model_and_all_candidates(tmp_path):
    record, selection = selected()
    text, first = first_of(
        write_selection_report(selection, record, tmp_path / "r.html", figures=tmp_path)
    )
    assert "<h1>Orders of position from force</h1>" in text
    assert "Recommended: 2 poles and no zero" in first
    assert html.escape(selection.reason) in first
    assert "<dt>natural frequency</dt>" in first
    (marked,) = re.findall(r'<tr class="marked">(.*?)</tr>', text, re.DOTALL)
    assert "2, 0" in marked
    assert all(row.label in text for row in selection.rows)
    assert {path.name for path in tmp_path.glob("*.svg")} == {
        "fit.svg",
        "selection.svg",
        "hankel.svg",
    }


@pytest.mark.undrawn
def test_a_selection_without_a_recommendation_says_why(tmp_path):
    record, selection = selected()
    none = dataclasses.replace(selection, recommended=None, reason="nothing can be estimated")
    _, first = first_of(write_selection_report(none, record, tmp_path / "r.html"))
    assert 'class="verdict bad"' in first
    assert "No structure is recommended." in first
    assert "nothing can be estimated" in first


@pytest.mark.slow
@pytest.mark.undrawn
def test_a_validation_shows_the_fit_with_an_offset_of_the_record_itself(tmp_path):
    estimate = identify(record_of(PLANT, 1), Structure(2, 0))
    moved = record_of(PLANT, 3, name="another day")
    shifted = dataclasses.replace(moved, y=np.asarray(moved.y) + 7.0, t=None)
    checked = validate(estimate, shifted)
    path = write_validation_report(
        estimate, checked, shifted, tmp_path / "r.html", figures=tmp_path
    )
    text, first = first_of(path)
    assert f"fit {checked.fit[0]:.1f} % of position" in first
    assert "The model holds on this record" in first
    assert "as good as can be" in first
    assert "Measured against model" in first
    assert "same coefficients" in text
    assert (tmp_path / "residual-tests.svg").exists()


@pytest.mark.undrawn
@pytest.mark.slow
def test_another_plant_is_told_first(tmp_path):
    estimate = identify(record_of(PLANT, 1), Structure(2, 0))
    other = record_of(TransferFunction([20.0], [1.0, 3.0, 20.0]), 3)
    checked = validate(estimate, other)
    _, first = first_of(write_validation_report(estimate, checked, other, tmp_path / "r.html"))
    assert "Something speaks against the model on this record" in first
    assert html.escape(checked.findings[0].message) in first
