"""What can be asked of an estimate, by name."""

import re

import pytest

from tridentify import OutputError, Structure, ThreeModel, from_options, list_options
from tridentify.cli.entry import main
from tridentify.errors import OptionError
from tridentify.structure import AutoStructure

PHYSICAL = {"physical", "known"}


def test_every_choice_can_be_asked_for():
    for option in list_options():
        assert option.help.endswith(".")
        assert option.type == "text" or option.default in option.choices
        for choice in option.choices:
            given = {option.name: choice}
            if option.name == "zeros":
                given["poles"] = "8"
            structure, _ = from_options(given)
            assert isinstance(structure, Structure | AutoStructure)


@pytest.mark.parametrize(("command", "physical"), [("identify", False), ("physical", True)])
def test_every_switch_is_one_of_the_command_line(command, physical, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    main([command, "--help"])
    known = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    own = {one.switch for one in list_options() if (one.name in PHYSICAL) == physical}
    assert own <= known


def test_answers_become_structure_and_method():
    structure, method = from_options(
        {"poles": 3, "zeros": 0, "delay": "free", "bounds": "a1=0:3, b0=0:", "loss": "huber"}
    )
    assert (structure.poles, structure.zeros, structure.delay) == (3, 0, "free")
    assert dict(structure.bounds) == {"a1": (0.0, 3.0), "b0": (0.0, None)}
    assert method == ThreeModel(loss="huber")
    assert from_options({"method": "output-error"})[1] == OutputError()
    assert from_options({"controller": "sampled"})[1].controller == "sampled"


def test_orders_left_open_are_those_of_the_package():
    structure, _ = from_options({"poles": "auto", "offset": "no"})
    assert structure == Structure.auto(offset=False)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"pole": 2}, "expected one of poles"),
        ({"poles": "7"}, "expected one of auto"),
        ({"delay": "soon"}, "expected seconds"),
        ({"known": "mass"}, "such as mass=1.2"),
        ({"physical": "kite"}, "short-period"),
        ({"method": "output-error", "controller": "sampled"}, "no such choice"),
        ({"noise": "ar", "loss": "huber"}, "one of the two"),
    ],
)
def test_answers_that_make_no_sense_are_refused(given, words):
    with pytest.raises(OptionError, match=words):
        from_options(given)
