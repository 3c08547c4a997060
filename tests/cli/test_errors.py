"""Bad input on the command line: one clear line, its own exception class, nothing left behind."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tridentify import errors
from tridentify.cli import identify_command
from tridentify.errors import TridentifyError

NO_ANSWER, BAD_INPUT = 1, 2
HEADER = "t,elevator,q\n"


def rows(n: int = 200, **replaced: Callable[[int], object]) -> str:
    """A sound file, but for the columns that are replaced."""
    columns: dict[str, Callable[[int], object]] = {
        "t": lambda k: repr(0.02 * k),
        "elevator": lambda k: 0.05 * (-1) ** (k // 23),
        "q": lambda k: repr(float(np.sin(0.1 * k))),
    }
    columns |= replaced
    lines = [",".join(str(column(k)) for column in columns.values()) for k in range(n)]
    return HEADER + "\n".join(lines) + "\n"


def at(row: int, cell: object, otherwise: Callable[[int], object]) -> Callable[[int], object]:
    return lambda k: cell if k == row else otherwise(k)


def constant(value: float) -> Callable[[int], object]:
    return lambda _: value


def jittered(k: int) -> float:
    return 0.02 * k + (0.004 if k % 7 == 3 else 0.0)


def second_order(n: int = 400) -> str:
    """Noise-free response of 1/(s^2 + s + 3) to steps, digits kept."""
    from tridentify import Record, TransferFunction, simulate

    u = np.sign(np.sin(0.05 * np.arange(n) ** 1.1))
    y = simulate(TransferFunction([1.0], [1.0, 1.0, 3.0]), Record(u, u, dt=0.02))[:, 0]
    lines = [f"{0.02 * k!r},{u[k].item()!r},{y[k].item()!r}" for k in range(n)]
    return HEADER + "\n".join(lines)


@dataclass(frozen=True)
class Case:
    """A file, what is asked of it, and how it has to be refused."""

    text: str | bytes | None
    expected: type[TridentifyError]
    says: str
    options: tuple[str, ...] = ()
    code: int = BAD_INPUT


CASES = {
    "text in a column": Case(
        rows(q=at(12, "stall", constant(1.0))),
        errors.TextInColumnError,
        "found 'stall' in column 'q', line 14",
    ),
    "missing input column": Case(
        rows(), errors.MissingColumnError, "no column 'aileron'", ("--input", "aileron")
    ),
    "missing time column": Case(
        rows(), errors.MissingColumnError, "no column 'clock'", ("--time", "clock")
    ),
    "no sampling": Case(
        rows().replace("t,", "k,", 1), errors.SamplingError, "no column called t or time"
    ),
    "two columns of time": Case(
        "t,Time,elevator,q\n0,0,1,0\n1,1,0,1\n", errors.SamplingError, "columns t and Time"
    ),
    "sampling interval below zero": Case(rows(), errors.SamplingError, "dt", ("--dt", "-0.1")),
    "nan in the input": Case(
        rows(elevator=at(5, "nan", constant(0.1))), errors.NotFiniteError, "line 7"
    ),
    "infinite input": Case(
        rows(elevator=at(5, "inf", constant(0.1))), errors.NotFiniteError, "found inf"
    ),
    "infinite output": Case(rows(q=at(5, "-inf", constant(0.1))), errors.NotFiniteError, "-inf"),
    "no sample in the output": Case(rows(q=lambda _: "nan"), errors.EmptyChannelError, "'q'"),
    "unequal lengths": Case(
        rows(9) + "0.18,0.05\n", errors.RaggedRowError, "found 2 cells in line 11"
    ),
    "time runs backwards": Case(
        rows(t=at(9, "0.05", lambda k: repr(0.02 * k))), errors.TimeNotIncreasingError, "time"
    ),
    "time stands still": Case(
        rows(t=at(9, "0.16", lambda k: repr(0.02 * k))), errors.TimeNotIncreasingError, "time"
    ),
    "jittered time given as uniform": Case(
        rows(t=jittered),
        errors.NonUniformTimeError,
        "expected 0.02 s within 5 percent",
        ("--time", "t", "--dt", "0.02"),
    ),
    "jittered time of a band-limited input": Case(
        rows(t=jittered),
        errors.NonUniformTimeError,
        "expected a uniform step",
        ("--intersample", "band-limited"),
    ),
    "jittered time and a method that needs a uniform step": Case(
        rows(t=jittered),
        errors.NonUniformTimeError,
        "SvfLeastSquares expects a uniform step",
        ("--method", "svf-least-squares"),
    ),
    "negative delay": Case(rows(), errors.OptionError, "found delay=-0.1", ("--delay", "-0.1")),
    "delay in words": Case(rows(), errors.OptionError, "--delay 'late'", ("--delay", "late")),
    "delay longer than the record": Case(rows(), errors.DelayError, "delay", ("--delay", "1e6")),
    "delays for other channels": Case(
        rows(), errors.ChannelCountError, "--delay 0.1,0.2", ("--delay", "0.1,0.2")
    ),
    "poles for other channels": Case(
        rows(), errors.ChannelCountError, "--poles 2,1", ("--poles", "2,1")
    ),
    "no number of poles": Case(rows(), errors.OrderError, "--poles 'two'", ("--poles", "two")),
    "no rule of what is missing": Case(
        rows(), errors.OptionError, "--missing 'q is large'", ("--missing", "q is large")
    ),
    "a rule about an input": Case(
        rows(), errors.ChannelNameError, "'elevator'", ("--missing", "elevator>1")
    ),
    "a rule that leaves nothing": Case(
        rows(), errors.EmptyChannelError, "'q'", ("--missing", "q<=10")
    ),
    "no unit": Case(rows(), errors.OptionError, "--unit 'rad'", ("--unit", "rad")),
    "a unit of nothing": Case(rows(), errors.UnitError, "'p'", ("--unit", "p=rad")),
    "a range without samples": Case(
        rows(), errors.EmptyRangeError, "100", ("--from", "100", "--to", "101")
    ),
    "fewer samples than unknowns": Case(rows(4), errors.TooFewSamplesError, "unknowns"),
    "zero input": Case(rows(elevator=constant(0.0)), errors.ZeroInputError, "'elevator'"),
    "zero output": Case(rows(q=constant(0.0)), errors.ZeroOutputError, "'q'"),
    "constant input, free initial state": Case(
        rows(elevator=constant(1.0)),
        errors.ConstantInputError,
        "stays at",
        ("--initial-state", "free"),
        NO_ANSWER,
    ),
    "orders that the data cannot support": Case(
        second_order(),
        errors.UnsupportedOrderError,
        "4 poles",
        ("--poles", "4", "--zeros", "3"),
        NO_ANSWER,
    ),
    "more zeros than poles": Case(
        rows(), errors.OrderError, "3 zeros with 2 poles", ("--zeros", "3")
    ),
    "no number of zeros": Case(rows(), errors.OrderError, "--zeros 'one'", ("--zeros", "one")),
    "zeros for other channels": Case(
        rows(), errors.ChannelCountError, "1 outputs and 1 inputs", ("--zeros", "1,1")
    ),
    "unknown method": Case(
        rows(), errors.OptionError, "expected one of three-model", ("--method", "magic")
    ),
    "no such file": Case(None, errors.UnreadableFileError, "found no such file"),
    "not a text file": Case(b"\x89PNG\xff\xfe\x00", errors.UnreadableFileError, "UTF-8"),
    "empty file": Case("", errors.EmptyFileError, "found nothing"),
    "a header and no row": Case(HEADER, errors.EmptyFileError, "row"),
    "no header": Case("0,1,2\n1,2,3\n", errors.MissingHeaderError, "first line"),
    "a column twice": Case("t,q,q,elevator\n0,1,2,3\n", errors.DuplicateColumnError, "'q'"),
}
# The list that was promised: each of these has an exception class that no other of them has.
PROMISED = (
    "text in a column",
    "missing input column",
    "infinite input",
    "unequal lengths",
    "time runs backwards",
    "jittered time given as uniform",
    "fewer samples than unknowns",
    "zero input",
    "constant input, free initial state",
    "zero output",
    "orders that the data cannot support",
    "no such file",
    "empty file",
)


def arguments(case: Case, folder: Path) -> list[str]:
    file = folder / "record.csv"
    if isinstance(case.text, bytes):
        file.write_bytes(case.text)
    elif case.text is not None:
        file.write_text(case.text, encoding="utf-8")
    question = {"--input": "elevator", "--output": "q", "--poles": "2", "--zeros": "1"}
    question |= dict(zip(case.options[::2], case.options[1::2], strict=True))
    return ["identify", str(file), *(word for pair in question.items() for word in pair)]


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_bad_input_is_one_line_and_leaves_nothing(run, tmp_path, case):
    words = [*arguments(case, tmp_path), "--out", tmp_path / "out"]
    before = sorted(tmp_path.iterdir())

    outcome = run(*words)
    assert outcome.code == case.code
    assert outcome.out == ""
    assert "Traceback" not in outcome.err
    (line,) = outcome.error_lines
    assert line == outcome.err.splitlines()[-1]
    assert line.startswith("tridentify: error: found ")
    assert " expect" in line
    assert line.count(";") >= 2, "what to do is missing"
    assert case.says in line

    traced = run(*words, "--debug")
    assert f"tridentify.errors.{case.expected.__name__}: " in traced.err
    assert sorted(tmp_path.iterdir()) == before


def test_every_promised_refusal_has_a_class_of_its_own():
    classes = [CASES[name].expected for name in PROMISED]
    assert len(set(classes)) == len(PROMISED)


def test_more_poles_than_the_data_support_end_with_code_1_whatever_the_zeros(run, tmp_path):
    text = second_order()
    for zeros in ("2", "3", "4"):
        asked = Case(text, TridentifyError, "", ("--poles", "4", "--zeros", zeros))
        assert run(*arguments(asked, tmp_path)).code == NO_ANSWER


@pytest.mark.skipif(os.name == "nt", reason="file names are Unicode here")
@pytest.mark.parametrize("command", ["identify", "channels", "stream"])
@pytest.mark.fast("stream", "channels")
def test_the_name_of_a_file_does_not_steer_the_terminal(run, tmp_path, command):
    name = os.fsdecode(b"a\xe9\x1b[2J\x07\xe2\x80\xaecsv")
    path = tmp_path / name
    path.write_text(second_order())
    asked = ["--input", "elevator", "--output", "q", "--poles", "2", "--zeros", "1"]
    words = [] if command == "channels" else asked
    if command == "identify":
        words = [*words, "--out", tmp_path / "out"]
    outcome = run(command, path, *words)
    absent = run(command, tmp_path / f"no{name}", *words)
    assert absent.code == 2
    for text in (outcome.out, outcome.err, absent.out, absent.err):
        assert all(line.isprintable() for line in text.split("\n")), text
    assert "\\udce9" in absent.err
    if command != "stream":
        assert outcome.code == 0, outcome.err
        assert "a\\udce9\\x1b[2J\\x07\\u202ecsv" in outcome.err
    if command == "identify":
        page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
        assert "\u202e" not in page
        assert "\x1b" not in page


def test_a_step_from_rest_is_fine(run, tmp_path):
    t = 0.02 * np.arange(300)
    wd = np.sqrt(9 - 1.5**2)
    step = (1 - np.exp(-1.5 * t) * (np.cos(wd * t) + 1.5 / wd * np.sin(wd * t))) / 9
    lines = [f"{a!r},1.0,{b!r}" for a, b in zip(t.tolist(), step.tolist(), strict=True)]
    text = HEADER + "\n".join(lines)
    for state in ("auto", "rest"):
        asked = Case(text, TridentifyError, "", ("--zeros", "0", "--initial-state", state))
        outcome = run(*arguments(asked, tmp_path), "--json")
        assert outcome.code == 0
        found = {item["name"]: item["value"] for item in json.loads(outcome.out)["parameters"]}
        assert found == pytest.approx({"a1": 3.0, "a0": 9.0, "b0": 1.0}, rel=1e-8)


# ------------------------------------------------------------------------------ the output folder
@pytest.mark.parametrize("place", ["file/below", "file"])
def test_an_output_folder_that_cannot_be_made_is_refused_before_the_work(run, tmp_path, place):
    (tmp_path / "file").write_text("not a folder")
    words = arguments(Case(rows(), TridentifyError, ""), tmp_path)
    outcome = run(*words, "--out", tmp_path / place, "--debug")
    assert outcome.code == BAD_INPUT
    assert "tridentify.errors.OutputPathError: " in outcome.err
    (line,) = outcome.error_lines[-1:]
    assert line.startswith("tridentify: error: found no way to write the folder")
    assert "reading" not in outcome.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "record.csv"]
    assert (tmp_path / "file").read_text() == "not a folder"


def write_little(_estimate: object, _record: object, folder: Path, *_: object) -> None:
    for name in ("bode.png", "fit.png", "report.html"):
        (folder / name).write_text("new")


def test_a_folder_in_the_place_of_a_file_undoes_what_was_moved(
    run, noisy, question, tmp_path, monkeypatch
):
    monkeypatch.setattr(identify_command, "write_results", write_little)
    (tmp_path / "out" / "report.html").mkdir(parents=True)
    (tmp_path / "out" / "bode.png").write_text("mine")
    outcome = run("identify", noisy, *question, "--out", tmp_path / "out")
    assert outcome.code == BAD_INPUT
    assert "report.html is a folder" in outcome.error_lines[0]
    left = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert left == ["bode.png", "report.html"]
    assert (tmp_path / "out" / "bode.png").read_text() == "mine"


# ----------------------------------------------------------------------------------------- usage
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["identify"], "FILE"),
        (["validate"], "MODEL"),
        (["compare"], "MODEL"),
        (["identify", "x.csv", "--offset", "perhaps"], "--offset"),
        (["identify", "x.csv", "--colour", "red"], "--colour"),
        (["--colour"], "--colour"),
        (["identify", "x.csv", "--intersample", "hold"], "'--intersample': 'hold' is not one of"),
        (["fly"], "fly"),
        (["study", "aircraft", "--draws", "0"], "--draws"),
    ],
)
def test_wrong_usage_is_one_line_that_points_to_the_help(run, words, says):
    outcome = run(*words)
    assert outcome.code == BAD_INPUT
    assert outcome.out == ""
    (line,) = outcome.err.splitlines()
    assert line.startswith("tridentify: error: ")
    assert says in line
    assert line.endswith("--help")
