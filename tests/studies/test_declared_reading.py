"""A file that declares a study: what it may say, and one line on whatever else it says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from declared import STUDY, document
from tridentify.errors import OptionError, UnreadableFileError
from tridentify.studies import SHIPPED, read_study, shipped_study, study_from
from tridentify.studies.declared.nouns import cells, draws_of, meetings


def changed(place: str, value: object) -> dict[str, Any]:
    """The small study with a value at ``a.b.c``; None takes it away."""
    found = document()
    *rooms, last = place.split(".")
    room = found
    for name in rooms:
        room = room.setdefault(name, {})
    room[last] = value
    if value is None:
        del room[last]
    return found


def test_what_a_file_says_is_read(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text(STUDY)
    study = read_study(path)
    assert (study.name, study.draws, study.seed) == ("small", 12, 3)
    assert [one.coefficients for one in study.systems] == [("a0", "b0"), ("a1", "a0", "b0")]
    assert study.systems[1].theta.tolist() == [1.0, 3.0, 0.5]
    assert [one.name for one in study.noises] == ["white ratio 0.05", "white ratio 0.2"]


def test_every_part_meets_every_other_unless_the_file_says_who() -> None:
    study = study_from(document())
    assert len(cells(study)) == 4
    assert len(meetings(study)) == 8
    grids = [
        {"systems": ["first"], "methods": ["ours"]},
        {"systems": ["aircraft"], "noises": ["white"]},
        {"systems": ["aircraft"], "methods": ["ours"]},
    ]
    study = study_from(changed("cells", grids))
    met = [(cell.name, method.name) for cell, method in meetings(study)]
    assert len(met) == len(set(met)) == 6
    assert ("first / pulses / white ratio 0.2", "raw") not in met


def test_a_leading_coefficient_that_is_not_one_is_divided_out() -> None:
    study = study_from(changed("systems.first", {"num": [4.0], "den": [2.0, 8.0]}))
    assert study.systems[0] == study_from(document()).systems[0]


def test_without_noise_one_draw_is_enough() -> None:
    study = study_from(changed("noises.white", {"ratio": [0, 0.1]}))
    assert {cell.noise.name: draws_of(study, cell) for cell in cells(study)} == {
        "white ratio 0": 1,
        "white ratio 0.1": 12,
    }


WRONG = [
    ("drawz", 3, "the study: found the unknown key 'drawz'; expected one of cells, description"),
    ("draws", 0, "the study: found draws = 0; expected a whole number from 1"),
    ("draws", 2.5, "found draws = 2.5; expected a whole number"),
    ("draws", True, "found draws = True; expected a whole number"),
    ("seed", -1, "found seed = -1; expected a whole number from 0"),
    ("name", "two\nlines", "found name = 'two\\nlines'"),
    ("name", "../up", "found name = '../up'"),
    ("systems", None, "found no systems; expected at least one table [systems.NAME]"),
    ("systems", {}, "found systems = {}; expected at least one table"),
    ("systems.x", 3, "[systems]: found 'x' = 3; expected a table; write [systems.x]"),
    ("systems.first.den", None, "[systems.first]: found no den; expected numbers"),
    ("systems.first.den", ["1", 2], "[systems.first]: found den = ['1', 2]; expected numbers"),
    ("systems.first.den", [0, 2], "found den = [0, 2]; expected numbers in descending powers"),
    ("systems.first.den", [2], "found degrees 0 over 0; expected 1 to 20 poles"),
    ("systems.first.num", [1, 2, 3], "found degrees 2 over 1"),
    ("systems.first.num", [10**400], "[systems.first]: found num = [1000"),
    ("seed", 2**70, "the study: found seed = "),
    ("systems.first.num", [float("nan")], "found num = [nan]"),
    ("systems.first.zeros", 1, "[systems.first]: found the unknown key 'zeros'"),
    ("inputs.pulses.kind", "saw", "found kind = 'saw'; expected one of step, prbs, multisine"),
    ("inputs.pulses.dt", 0, "[inputs.pulses]: found dt = 0; expected a number above zero [s]"),
    ("inputs.pulses.order", 3, "[inputs.pulses]: found the unknown key 'order'"),
    ("inputs.pulses.width", "wide", "[inputs.pulses]: "),
    ("inputs.pulses.amplitude", None, "[inputs.pulses]: found no amplitude; expected one"),
    ("inputs.pulses.samples", 1000, "found samples=1000 of a signal of 80; expected at most"),
    ("inputs.s", {"kind": "step", "dt": 1}, "[inputs.s]: found no samples"),
    ("noises.white.std", 1, "[noises.white]: found std and ratio; expected one of std, ratio"),
    ("noises.white.ratio", None, "[noises.white]: found no level"),
    ("noises.white.ratio", -1, "[noises.white]: found ratio = -1; expected a number or a list"),
    ("noises.white.ratio", [], "[noises.white]: found ratio = []"),
    ("noises.white.ratio", [1, 1], "[noises.white]: found ratio = [1, 1]"),
    ("noises.white.kind", "pink", "found kind = 'pink'; expected one of white, student, arma"),
    ("noises.white.kind", "student", "[noises.white]: found no degrees; expected a number above 2"),
    ("noises.v", {"kind": "arma", "std": 1, "ar": [1, -1]}, "[noises.v]: found ar with a root"),
    (
        "methods.ours.kind",
        "best",
        "[methods.ours]: found kind = 'best'; expected one of three-model",
    ),
    ("methods.ours.startz", 2, "[methods.ours]: found the unknown key 'startz'; expected one of"),
    ("methods.ours.starts", "x", "[methods.ours]: "),
    ("methods.ours.loss", "cubic", "[methods.ours]: "),
    ("methods.ours.initial_state", "asleep", "[methods.ours]: "),
    ("methods.raw.filter", [1, 2], "[methods.raw]: found a filter of degree 1 for the 1 poles"),
    ("methods.raw.filter", ["c"], "[methods.raw]: found filter=('c',); expected numbers"),
    ("methods.raw.corner", -1, "[methods.raw]: found corner=-1; expected a frequency above zero"),
    ("inputs.m", {"kind": "multisine", "dt": 1, "period": 9, "harmonics": "x"}, "[inputs.m]: "),
    ("inputs.s", {"kind": "step", "dt": 1, "samples": 9, "amplitude": "x"}, "[inputs.s]: found"),
    ("methods.p", {"kind": "paper"}, "[methods.p]: found no gamma; expected one"),
    ("methods.o", {"kind": "output-error", "start": "lie"}, "found start='lie'; expected 'truth'"),
    ("cells", [], "found cells = []; expected tables [[cells]]"),
    ("cells", [{"systems": ["second"]}], "[[cells]] number 1: found systems = ['second']"),
    ("cells", [{"system": ["first"]}], "[[cells]] number 1: found the unknown key 'system'"),
    ("systems.still", {"num": [1e-320], "den": [1, 1]}, "still"),
]


@pytest.mark.parametrize(("place", "value", "told"), WRONG)
def test_what_is_wrong_is_told_in_one_line(place: str, value: object, told: str) -> None:
    with pytest.raises(OptionError) as error:
        study_from(changed(place, value))
    assert told in str(error.value)
    assert "\n" not in str(error.value)
    assert "; " in str(error.value)


@pytest.mark.parametrize(
    ("write", "told"),
    [
        (lambda path: None, "No such file"),
        (lambda path: path.write_text("a = [1"), "found no study in"),
        (lambda path: path.write_bytes(b"\xff\xfe"), "found no study in"),
        (lambda path: path.mkdir(), "directory"),
        (lambda path: path.write_text("#" * 1_000_001), "more than 1000000 bytes"),
    ],
)
def test_a_file_that_is_none_is_refused(
    tmp_path: Path, write: Callable[[Path], object], told: str
) -> None:
    path = tmp_path / "study.toml"
    write(path)
    with pytest.raises(UnreadableFileError) as error:
        read_study(path)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_files_that_come_with_the_package_are_studies() -> None:
    assert SHIPPED == ("aircraft", "efficiency")
    assert [read_study(shipped_study(name)).name for name in SHIPPED] == list(SHIPPED)
    with pytest.raises(OptionError, match="expected one of: aircraft, efficiency"):
        shipped_study("airship")
