"""``--fix``, ``--bound``, ``--prior`` and ``--gain``: read, used and refused."""

from __future__ import annotations

import json

import pytest

from tridentify import errors
from tridentify.cli.ask import known_from


def read(option, *texts):
    options = {"fixed": (), "bounds": (), "priors": (), "gains": ()} | {option: texts}
    return known_from(**options)


@pytest.mark.parametrize(
    ("option", "text", "key", "expected"),
    [
        ("fixed", "a0=3", "fixed", {"a0": 3.0}),
        ("fixed", " b0[q,e] = -1.5e-3 ", "fixed", {"b0[q,e]": -1.5e-3}),
        ("bounds", "b0=0:", "bounds", {"b0": (0.0, None)}),
        ("bounds", "b0=:5.", "bounds", {"b0": (None, 5.0)}),
        ("bounds", "b0=-1e3:-.5", "bounds", {"b0": (-1e3, -0.5)}),
        ("priors", "a0=3+-0.1", "priors", {"a0": (3.0, 0.1)}),
        ("priors", "a0=-3 +- 1e-2", "priors", {"a0": (-3.0, 0.01)}),
        ("gains", "2", "static_gain", 2.0),
        ("gains", "2,?", "static_gain", [[2.0, None]]),
    ],
)
def test_what_is_written_is_read(option, text, key, expected):
    assert read(option, text)[key] == expected


def test_nothing_written_says_nothing():
    assert known_from((), (), (), ()) == {
        "fixed": {},
        "bounds": {},
        "priors": {},
        "static_gain": None,
    }


@pytest.mark.parametrize(
    ("option", "texts", "error"),
    [
        ("fixed", ("a0",), errors.OptionError),
        ("fixed", ("a0=x",), errors.OptionError),
        ("fixed", ("a0=1", "a0=2"), errors.OptionError),
        ("bounds", ("b0=3",), errors.OptionError),
        ("priors", ("a0=3",), errors.OptionError),
        ("priors", ("a0=3+-",), errors.OptionError),
        ("gains", ("one",), errors.OptionError),
        ("gains", ("1,2", "3"), errors.ChannelCountError),
    ],
)
def test_what_cannot_be_read_is_refused(option, texts, error):
    with pytest.raises(error, match="found --") as caught:
        read(option, *texts)
    assert "expected" in str(caught.value)


def test_the_command_keeps_what_is_known(run, noisy, question):
    known = ["--fix", "a0=9.1", "--gain", 0.3, "--bound", "b1=0:", "--prior", "a1=3+-0.1"]
    outcome = run("identify", noisy, *question, *known, "--json")
    assert outcome.code == 0
    rows = json.loads(outcome.out)["parameters"]
    values = {row["name"]: (row["value"], row["std"]) for row in rows}
    assert values["a0"] == (9.1, 0.0)
    assert values["b0"] == (pytest.approx(2.73, rel=1e-12), 0.0)
    assert values["a1"][1] > 0.0


def test_the_tables_show_it(run, noisy, question):
    outcome = run("identify", noisy, *question, "--fix", "a0=9.1", "--bound", "b1=2.5:")
    assert outcome.code == 0
    assert "9.1" in outcome.out
    assert "Held by a bound: b1 = 2.5" in " ".join(outcome.out.split())


@pytest.mark.parametrize(
    ("option", "text"),
    [("--fix", "a7=1"), ("--fix", "a0=-1"), ("--bound", "a0=5:1"), ("--prior", "a0=1+-0")],
)
def test_nonsense_is_one_line_of_error(run, noisy, question, option, text):
    outcome = run("identify", noisy, *question, option, text)
    assert outcome.code != 0
    assert len(outcome.error_lines) == 1
