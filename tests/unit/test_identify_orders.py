"""Orders given in several ways to `identify`, or left to the record."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, select_structure, simulate
from tridentify.errors import IdentifiabilityError, OptionError, OrderError
from tridentify.structure import AutoStructure

PLANT = TransferFunction([2.0, 3.0], [1.0, 2.0, 9.0])


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 6)
    y = simulate(PLANT, Record(u, u, dt=0.05))[:, 0]
    return Record(u, y + 0.05 * np.std(y) * rng.standard_normal(240), dt=0.05)


@pytest.mark.unjudged
def test_numbers_and_a_pair_are_a_structure(record):
    wanted = identify(record, Structure(2, 1)).theta
    assert np.array_equal(identify(record, poles=2, zeros=1).theta, wanted)
    assert np.array_equal(identify(record, (2, 1)).theta, wanted)


def test_the_record_chooses_its_order_and_the_estimate_says_so(record):
    open_ = Structure.auto(max_poles=2, offset=False, initial_state="rest")
    found = identify(record, open_)
    known = Structure(2, 1, offset=False, initial_state="rest")
    alone = identify(record, known)
    assert found.structure == alone.structure
    assert np.array_equal(found.theta, alone.theta)
    assert found.findings == alone.findings
    assert found.trace.decisions[0].startswith("poles, zeros = 2, 1 chosen of 3 candidates: ")


@pytest.mark.unjudged
@pytest.mark.slow
def test_without_a_structure_the_default_candidates_are_tried(monkeypatch, record):
    asked = []

    def selected(records, candidates, **options):
        asked.append(candidates)
        return select_structure(records, [Structure(1, 0)], **options)

    monkeypatch.setattr(sys.modules["tridentify.identify"], "select_structure", selected)
    assert identify(record).structure.poles == 1
    assert asked == [None]
    rows = select_structure(record).rows
    tried = {(one.structure.poles, one.structure.zeros) for one in rows}
    assert tried >= {(n, m) for n in range(1, 5) for m in range(n)}


@pytest.mark.unjudged
def test_a_behaviour_left_open_is_settled_once_for_all_candidates():
    rng = np.random.default_rng(8)
    u = np.cumsum(rng.standard_normal(240)) * 0.3
    y = simulate(PLANT, Record(u, u, dt=0.1, intersample="foh"))[:, 0]
    record = Record(u, y + 0.002 * np.std(y) * rng.standard_normal(240), dt=0.1, intersample="auto")
    found = select_structure(record, [Structure(1, 0), Structure(2, 0), Structure(2, 1)])
    assert {row.estimate.intersample for row in found.rows} == {"foh"}
    assert found.recommended.label == "2, 1"
    assert any("joined by straight lines (foh) for all candidates" in note for note in found.notes)


@pytest.mark.parametrize(
    ("arguments", "options", "error", "said"),
    [
        ((), {"poles": 2}, OrderError, "found poles; expected poles and zeros together"),
        ((), {"zeros": 0}, OrderError, "found zeros; expected"),
        ((Structure(2, 1),), {"poles": 2, "zeros": 1}, OrderError, "beside a structure"),
        (("2, 1",), {}, OptionError, "found structure=str; expected a Structure"),
        (((2, 1, 0),), {}, OptionError, "found structure=tuple"),
        (((1, 2),), {}, OrderError, "found 2 zeros with 1 poles"),
    ],
)
def test_what_is_no_structure_is_one_line(record, arguments, options, error, said):
    with pytest.raises(error, match=said) as caught:
        identify(record, *arguments, **options)
    assert "\n" not in str(caught.value)


def test_no_order_for_a_record_that_says_nothing():
    still = Record(np.ones(50), np.ones(50), dt=0.1)
    with pytest.raises(IdentifiabilityError, match="found no usable candidate among 3 orders"):
        identify(still, Structure.auto(max_poles=2))


@pytest.mark.parametrize("most", [0, 2.5, "4", [[2]]])
def test_most_poles_are_a_whole_number(most):
    with pytest.raises(OrderError, match="max_poles"):
        AutoStructure(most)
