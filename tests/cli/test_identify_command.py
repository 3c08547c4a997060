"""`tridentify identify`: what it reads, prints, writes, and how it ends."""

from __future__ import annotations

import html
import io
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

import tridentify
from tridentify import Estimate, Record, TransferFunction, simulate
from tridentify.cli import identify_command, main, terminal
from tridentify.estimation import machine_code

DT = 0.02
DEN = (1.0, 3.0, 9.0)
TRUTH = {"a1": 3.0, "a0": 9.0, "b1": 2.0, "b0": 3.0}
FIGURES = {"fit", "residual-tests", "bode", "step", "pole-zero", "convergence"}


def answers(text: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(text)
    return document


def values(document: dict[str, Any]) -> dict[str, float]:
    return {item["name"]: item["value"] for item in document["parameters"]}


# ------------------------------------------------------------------------------------- the answer
def test_a_record_without_noise_gives_the_coefficients_back(run, manoeuvre, question):
    outcome = run("identify", manoeuvre, "--time", "t", *question, "--json")
    assert outcome.code == 0
    found = values(answers(outcome.out))
    assert found == pytest.approx(TRUTH, rel=1e-8)
    assert list(found) == ["a1", "a0", "b1", "b0"]


def test_the_tables_show_what_json_says(run, noisy, question):
    document = answers(run("identify", noisy, *question, "--json").out)
    outcome = run("identify", noisy, *question)
    rows = {line.split("  ")[0]: line.split() for line in outcome.out.splitlines() if line}
    shown = [*document["parameters"], *document["derived"]]
    assert [item["name"] for item in document["derived"]] == [
        "natural frequency",
        "damping",
        "dc gain",
    ]
    for item in shown:
        words = rows[item["name"]]
        numbers = [float(word) for word in words if re.fullmatch(r"-?[\d.]+(e[-+]\d+)?", word)]
        low, high = item["interval95"]
        expected = [item["value"], item["std"], low, high]
        assert numbers == pytest.approx(expected, abs=0.1 * item["std"])
        assert high - low == pytest.approx(2 * 1.959964 * item["std"], rel=1e-5)
    (fit,) = document["fit"]
    assert float(rows["q"][1]) == pytest.approx(fit["fit"], abs=0.01)
    assert document["status"]["message"] in outcome.out
    in_full = " ".join(run("identify", noisy, *question, "--verbose").out.split())
    for note in document["decisions"]:
        assert note in in_full
    assert "no offset" not in outcome.out  # what was not chosen, and by how much
    assert "-2 log L" not in outcome.out
    assert "lowest AICc" in outcome.out


def test_no_line_of_progress_comes_twice_and_counts_come_every_other_second(
    run, noisy, question, capsys, monkeypatch
):
    lines = run("identify", noisy, *question).err.splitlines()
    assert len(lines) > 3
    assert len(set(lines)) == len(lines)
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    with terminal.Activity() as activity:
        for k in range(1, 31):
            now[0] += 0.3
            activity.stage("the same as before")
            activity.stage(f"candidates: {k} of 30 done")
    assert [line.partition(": ")[2] for line in capsys.readouterr().err.splitlines()] == [
        "the same as before",
        "candidates: 1 of 30 done",
        "candidates: 8 of 30 done (after 2 s)",
        "candidates: 15 of 30 done (after 4 s)",
        "candidates: 22 of 30 done (after 7 s)",
        "candidates: 29 of 30 done (after 9 s)",
        "candidates: 30 of 30 done (after 9 s)",
    ]


def test_a_noisy_record_is_answered_within_its_own_standard_errors(run, noisy, question):
    document = answers(run("identify", noisy, *question, "--json").out)
    for item in document["parameters"]:
        assert abs(item["value"] - TRUTH[item["name"]]) < 4 * item["std"]
    derived = {item["name"]: item["value"] for item in document["derived"]}
    expected = {"natural frequency": 3.0, "damping": 0.5, "dc gain": 1 / 3}
    assert derived == pytest.approx(expected, rel=0.03)
    (fit,) = document["fit"]
    assert fit["noise_std"] == pytest.approx(1e-3, rel=0.1)


def test_units_of_the_header_reach_the_table(run, write_table, clean):
    columns = {"Time [s]": clean["t"], "elevator [rad]": clean["elevator"], "q [rad/s]": clean["q"]}
    path = write_table("units.csv", columns)
    options = ["--input", "elevator", "--output", "q", "--poles", 2, "--zeros", 1, "--json"]
    outcome = run("identify", path, *options)
    units = {item["name"]: item["unit"] for item in answers(outcome.out)["parameters"]}
    assert units == {"a1": "1/s", "a0": "1/s^2", "b1": "1/s^2", "b0": "1/s^3"}
    assert "column 'Time [s]' as time" in outcome.err


# ----------------------------------------------------------------------------------- the sampling
@pytest.mark.parametrize(
    "sampling", [["--time", "t"], ["--dt", "0.02"], ["--time", "t", "--dt", "0.02"], []]
)
def test_the_sampling_may_be_stated_in_every_way(run, manoeuvre, question, sampling):
    outcome = run("identify", manoeuvre, *sampling, *question, "--json")
    assert values(answers(outcome.out)) == pytest.approx(TRUTH, rel=1e-8)
    assert ("taking column 't' as time" in outcome.err) == (not sampling)


def test_dt_scales_time(run, manoeuvre, question):
    outcome = run("identify", manoeuvre, "--dt", 2 * DT, *question, "--json")
    slower = {"a1": 1.5, "a0": 2.25, "b1": 1.0, "b0": 0.75}
    assert values(answers(outcome.out)) == pytest.approx(slower, rel=1e-8)


@pytest.mark.parametrize(
    ("header", "factor", "dt", "says"),
    [
        ("t", 1.0, 0.001, "'t' is not used; its mean step is 0.02 s, not 0.001 s"),
        ("Time [ms]", 1e3, 0.001, "'Time [ms]' is not used; its mean step is 0.02 s, not 0.001 s"),
        ("t", 1.0, 0.0204, ""),
        ("t [ms]", 1e3, 0.02, ""),
        ("t [frames]", 50.0, 0.001, ""),
        ("clock", 1.0, 0.001, ""),
    ],
)
def test_a_column_of_time_that_tells_otherwise_is_pointed_out(
    run, write_table, clean, question, header, factor, dt, says
):
    columns = {header: factor * clean["t"], "elevator": clean["elevator"], "q": clean["q"]}
    outcome = run("identify", write_table("scaled.csv", columns), "--dt", dt, *question, "--json")
    assert outcome.code == 0
    cautions = [line for line in outcome.err.splitlines() if "is not used" in line]
    assert cautions == ([f"tridentify: warning: column {says}"] if says else [])


def test_an_unused_column_of_time_may_hold_anything(run, write_table, clean, question):
    path = write_table("text.csv", clean)
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([*lines[:9], "noon" + lines[9][lines[9].index(",") :], *lines[10:]]))
    outcome = run("identify", path, "--dt", DT, *question)
    assert outcome.code == 0
    assert "caution" not in outcome.err


def jittered(clean: dict[str, np.ndarray], size: float) -> dict[str, np.ndarray]:
    wobble = size * DT * np.random.default_rng(5).uniform(-0.5, 0.5, clean["t"].size)
    wobble[[0, -1]] = 0.0
    return clean | {"t": clean["t"] + wobble}


@pytest.mark.parametrize("size", [0.02, 0.5])
def test_uneven_time_is_taken_as_it_is_recorded(run, write_table, clean, question, size):
    uneven = jittered(clean, size)["t"]
    record = Record(clean["elevator"], clean["q"], t=uneven)
    q = simulate(TransferFunction([2.0, 3.0], DEN), record)[:, 0]
    path = write_table("jitter.csv", clean | {"t": uneven, "q": q})
    outcome = run("identify", path, *question, "--json")
    assert outcome.code == 0
    assert values(answers(outcome.out)) == pytest.approx(TRUTH, rel=1e-7)
    assert answers(outcome.out)["record"]["dt"] is None
    assert "time is taken as it is recorded" in outcome.err
    assert "steps 0.0" in run("identify", path, *question).out


@pytest.mark.slow
@pytest.mark.unjudged
def test_the_mean_step_may_still_be_stated_for_inexact_time_stamps(
    run, write_table, clean, question
):
    path = write_table("jitter.csv", jittered(clean, 0.5))
    refused = run("identify", path, *question, "--time", "t", "--dt", DT)
    assert refused.code == 2
    assert "leave --time out if only the time stamps are inexact" in refused.error_lines[0]
    note = run("identify", path, *question).err
    advised = re.search(r"--dt [\d.]+", note)
    assert advised
    document = answers(run("identify", path, *question, *advised[0].split(), "--json").out)
    assert document["record"]["dt"] == DT
    assert values(document) == pytest.approx(TRUTH, rel=1e-7)


def test_a_folder_in_place_of_a_file_is_named(run, question, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = run("identify", ".", "--dt", DT, *question)
    assert outcome.code == 2
    assert outcome.err.startswith("tridentify: reading .\n")


def test_from_and_to_cut_in_seconds(run, manoeuvre, question):
    cut = ["--from", 2.0, "--to", 8.0, "--json"]
    document = answers(run("identify", manoeuvre, *question, *cut).out)
    assert document["record"]["n_samples"] == 301
    assert (document["record"]["start"], document["record"]["stop"]) == (2.0, 8.0)
    # the cut record does not start at rest
    assert values(document) == pytest.approx(TRUTH, rel=1e-7)
    assert any("initial state free" in note for note in document["decisions"])


@pytest.mark.unjudged
@pytest.mark.slow
def test_intersample_says_what_the_input_does(run, write_table, question):
    t = DT * np.arange(600)
    u = 0.05 * np.sin(1.3 * t**1.2) * (t > 0.5)
    _, q, _ = signal.lsim(([2.0, 3.0], DEN), u, t, interp=True)
    path = write_table("lines.csv", {"t": t, "elevator": u, "q": q})
    joined = values(answers(run("identify", path, *question, "--intersample", "foh", "--json").out))
    stepped = values(
        answers(run("identify", path, *question, "--intersample", "zoh", "--json").out)
    )
    found = values(answers(run("identify", path, *question, "--json").out))
    assert found == pytest.approx(joined, rel=1e-12)
    assert joined == pytest.approx(TRUTH, rel=1e-8)
    assert max(abs(stepped[name] / TRUTH[name] - 1) for name in TRUTH) > 1e-3


# ---------------------------------------------------------------------------------- the structure
def test_several_outputs_may_have_their_own_number_of_zeros(run, write_table, clean, held):
    alpha = held([-4.0], clean["elevator"])
    path = write_table("two.csv", clean | {"alpha": alpha})
    options = ["--input", "elevator", "--output", "q", "--output", "alpha", "--poles", 2]
    document = answers(run("identify", path, *options, "--zeros", 1, "--zeros", 0, "--json").out)
    expected = {
        "a1": 3.0,
        "a0": 9.0,
        "b1[q,elevator]": 2.0,
        "b0[q,elevator]": 3.0,
        "b0[alpha,elevator]": -4.0,
    }
    assert values(document) == pytest.approx(expected, rel=1e-8)
    both = values(answers(run("identify", path, *options, "--zeros", 1, "--json").out))
    assert both == pytest.approx(expected | {"b1[alpha,elevator]": 0.0}, rel=1e-8, abs=1e-8)


@pytest.mark.unjudged
@pytest.mark.parametrize("more", [[], pytest.param(["--poles", "auto"], marks=pytest.mark.slow)])
def test_without_poles_the_orders_are_chosen_and_told(run, clean, write_table, more):
    noise = 1e-3 * np.random.default_rng(3).standard_normal(clean["q"].size)
    columns = clean | {"q": clean["q"] + noise}
    # 48 samples, which are enough for four candidates
    few = write_table("few.csv", {name: column[45:235:4] for name, column in columns.items()})
    options = ["--input", "elevator", "--output", "q", "--offset", "no", "--initial-state", "rest"]
    outcome = run("identify", few, *options, *more)
    assert outcome.code == 0
    assert "poles, zeros = 2, 1 chosen of 4 candidates" in " ".join(outcome.out.split())


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--zeros", "1"], "found --zeros 1 without a number of --poles"),
        (["--poles", "2"], "found --poles 2 without --zeros"),
        (["--fix", "a0=0"], "found knowledge of coefficients without --poles"),
    ],
)
def test_half_an_order_is_one_line_and_code_2(run, noisy, more, said):
    outcome = run("identify", noisy, "--input", "elevator", "--output", "q", *more)
    assert outcome.code == 2
    (line,) = outcome.error_lines
    assert said in line


def test_several_inputs_may_have_their_own_number_of_zeros(run, write_table, clean, held):
    rudder = np.roll(clean["elevator"], 270)
    q = clean["q"] + held([5.0], rudder)
    path = write_table("two.csv", clean | {"rudder": rudder, "q": q})
    options = ["--input", "elevator", "--input", "rudder", "--output", "q", "--poles", 2]
    document = answers(run("identify", path, *options, "--zeros", "1,0", "--json").out)
    expected = {
        "a1": 3.0,
        "a0": 9.0,
        "b1[q,elevator]": 2.0,
        "b0[q,elevator]": 3.0,
        "b0[q,rudder]": 5.0,
    }
    assert values(document) == pytest.approx(expected, rel=1e-8)


@pytest.mark.unjudged
@pytest.mark.slow
def test_nuisance_terms_are_estimated_when_asked_for(run, write_table, clean, question):
    q = clean["q"] + 0.7 - 0.02 * clean["t"]
    path = write_table("drifting.csv", clean | {"q": q})
    document = answers(run("identify", path, *question, "--drift", "yes", "--json").out)
    assert values(document) == pytest.approx(TRUTH, rel=1e-7)
    along = {item["name"]: item["value"] for item in document["estimated_along"]}
    assert along == pytest.approx({"offset[q]": 0.7, "drift[q]": -0.02}, rel=1e-7)
    rest = ["--initial-state", "rest", "--offset", "no", "--json"]
    biased = answers(run("identify", path, *question, *rest).out)
    assert biased["estimated_along"] == []
    assert abs(values(biased)["a0"] - 9.0) > 0.1


@pytest.mark.slow
def test_noise_may_be_taken_for_white_or_modelled(run, write_table, clean, question):
    e = np.random.default_rng(5).standard_normal(clean["q"].size)
    coloured = signal.lfilter([1e-3], [1.0, -0.9], e)
    path = write_table("coloured.csv", clean | {"q": clean["q"] + coloured})
    documents = {}
    for noise in ("auto", "ar", "white"):
        outcome = run("identify", path, *question, "--noise", noise, "--json")
        assert outcome.code == 0, outcome.err
        documents[noise] = json.loads(outcome.out)
    assert documents["auto"]["parameters"] == documents["ar"]["parameters"]
    errors = {key: [p["std"] for p in d["parameters"]] for key, d in documents.items()}
    # taken as white, the scatter of the scores makes up for the colour
    assert any("scatter of the scores" in note for note in documents["white"]["decisions"])
    assert np.all(np.array(errors["auto"]) > 0.7 * np.array(errors["white"]))
    assert any("whitened" in note for note in documents["auto"]["decisions"])
    assert any("not white" in text for text in documents["white"]["warnings"])


def test_noise_is_refused_with_a_method_that_has_no_choice_of_it(run, noisy, question):
    options = ["--method", "svf-least-squares", "--noise", "ar"]
    outcome = run("identify", noisy, *question, *options)
    assert outcome.code == 2
    assert "found --noise ar with --method svf-least-squares" in outcome.err
    assert "three-model" in outcome.err


# ------------------------------------------------------------------------------------- the files
@pytest.mark.undrawn
@pytest.mark.unjudged
def test_out_writes_everything_and_keeps_what_is_there(run, tmp_path, noisy, question):
    folder = tmp_path / "deep" / "result"
    folder.mkdir(parents=True)
    (folder / "notes.txt").write_text("mine")
    (folder / "model.json").write_text("old")
    outcome = run(
        "identify", noisy, *question, "--out", folder, "--title", "Pitch <rate>", "--json"
    )
    assert outcome.code == 0
    written = {f"{name}.svg" for name in FIGURES} | {"model.json", "report.html"}
    assert {path.name for path in folder.iterdir()} == written | {"notes.txt"}
    assert (folder / "notes.txt").read_text() == "mine"
    assert {Path(name).name for name in answers(outcome.out)["files"]} == written

    estimate = Estimate.load(folder / "model.json")
    named = dict(zip(estimate.names, estimate.theta.tolist(), strict=True))
    assert named == values(answers(outcome.out))
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Pitch &lt;rate&gt;" in page
    assert sorted(path.name for path in tmp_path.iterdir()) == ["deep", "noisy.csv"]


@pytest.mark.slow
@pytest.mark.undrawn
def test_the_terminal_says_what_the_report_says(run, tmp_path):
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 6)
    system = TransferFunction([2.0], DEN)
    y = simulate(system, Record(u, u, dt=0.1))[:, 0] + 0.01 * rng.standard_normal(600)
    # far samples alone call for no test of the residual; a report makes them all
    y[[100, 250, 251]] += [0.5, -0.4, 0.6]
    path = tmp_path / "far.csv"
    lines = [f"{0.1 * k:.1f},{a:g},{b:.6f}" for k, (a, b) in enumerate(zip(u, y, strict=True))]
    path.write_text("t,u,y\n" + "\n".join(lines) + "\n")
    asked = ("--time", "t", "--input", "u", "--output", "y", "--poles", "2", "--zeros", "0")
    shown = run("identify", path, *asked, "--out", tmp_path / "out")
    told = " ".join(shown.out.split())
    page = " ".join(html.unescape((tmp_path / "out" / "report.html").read_text()).split())
    document = answers(run("identify", path, *asked, "--out", tmp_path / "out", "--json").out)
    assert document["findings"]
    for finding in document["findings"]:
        assert finding["message"] in page
        assert finding["message"] in told
    counted = told.count("caution: ") + told.count("note: ")
    listed = sum(page.count(f'<li class="{one}">') for one in ("error", "warning", "note"))
    assert counted == listed == len(document["findings"])


@pytest.mark.slow
def test_a_model_of_too_low_an_order_is_not_usable(run, tmp_path):
    data = Path(tridentify.__file__).parent / "data" / "short_period.csv"
    asked = ("--time", "t", "--input", "delta_e", "--output", "q", "--poles", "1", "--zeros", "0")
    told = " ".join(run("identify", data, *asked).out.split())
    assert "Not usable: a constant follows q more closely" in told
    assert "the order is too low" in told
    assert "use fewer poles" not in told


def test_without_out_nothing_is_written(run, tmp_path, noisy, question, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert run("identify", noisy, *question).code == 0
    assert list(Path().iterdir()) == []


# ----------------------------------------------------------------------------------- the streams
@pytest.mark.parametrize(("patience", "named"), [(0.0, True), (60.0, False)])
def test_progress_goes_to_stderr_and_names_a_long_compilation(
    run, noisy, question, monkeypatch, patience, named
):
    monkeypatch.setattr(terminal, "SILENCE", patience)
    monkeypatch.setattr(machine_code, "load_first", lambda: time.sleep(0.2))
    outcome = run("identify", noisy, *question)
    assert "reading noisy.csv" in outcome.err
    assert ("compiled once per machine" in outcome.err) == named
    assert all(line.startswith("tridentify: ") for line in outcome.err.splitlines())
    assert "reading" not in outcome.out
    assert "\x1b" not in outcome.out + outcome.err


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def test_progress_vanishes_from_a_terminal(noisy, question, monkeypatch, capsys):
    screen = Terminal()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", screen)
    assert main(["identify", str(noisy), *question]) == 0
    # hidden cursor, shown again, and the line of the progress erased
    assert screen.getvalue().count("\x1b[?25l") == screen.getvalue().count("\x1b[?25h") == 1
    assert "\x1b[2K" in screen.getvalue()
    assert "taking column 't' as time" in screen.getvalue()
    assert "a1" in capsys.readouterr().out


@pytest.mark.parametrize("width", ["20", "80", "200"])
@pytest.mark.fast("20")
def test_no_number_is_cut_on_a_narrow_terminal(run, noisy, question, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", "100")
    wide = run("identify", noisy, *question).out
    monkeypatch.setenv("COLUMNS", width)
    assert run("identify", noisy, *question).out == wide
    assert "…" not in wide


def test_names_with_brackets_are_no_markup(run, write_table, clean, question):
    path = write_table("x.csv", clean | {"[red]alpha": clean["q"]})
    options = ["--input", "elevator", "--output", "[red]alpha", "--output", "q", "--poles", 2]
    outcome = run("identify", path, *options, "--zeros", 1)
    assert "b1[[red]alpha,elevator]" in outcome.out


def python(*arguments: object, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "tridentify", *map(str, arguments)],
        env=os.environ | environment,
        capture_output=True,
        timeout=120,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("channels", []),
        ("identify", ["--input", "elevator", "--output", "α", "--poles", 2, "--zeros", 1]),
    ],
    ids=["channels", "identify"],
)
def test_the_module_runs_in_its_own_process_without_utf8(write_table, clean, command, options):
    path = write_table("greek.csv", clean | {"α": clean["q"]})
    plain = {"PYTHONIOENCODING": "ascii", "NO_COLOR": "1"}
    done = python(command, path, *options, **plain)
    assert done.returncode == 0, done.stderr
    assert b"\\u03b1" in done.stdout
    assert done.stdout.isascii()
    assert done.stderr.isascii()


@pytest.mark.slow
def test_a_reader_that_has_seen_enough_is_no_error(noisy, question):
    command = [sys.executable, "-m", "tridentify", "identify", str(noisy), *question]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        complaints = process.stderr.read().decode()
    assert process.returncode == 0
    assert "error:" not in complaints
    assert "Error" not in complaints
    assert "Traceback" not in complaints


# ------------------------------------------------------------------------------- usage and the end
def test_version_and_help(run):
    assert run("--version").out == f"tridentify {tridentify.__version__}\n"
    assert run("--help").code == 0
    top = run("--help").out
    assert all(command in top for command in ("identify", "demo", "study", "Exit codes"))
    text = run("identify", "--help").out
    options = "time dt input output poles zeros intersample from to offset drift initial-state"
    for option in [*options.split(), "method", "out", "json", "title"]:
        assert f"--{option}" in text
    assert run("-h").out == top


def test_without_a_command_there_is_help(run):
    outcome = run()
    assert outcome.code == 2
    assert "identify" in outcome.out


def interrupted(*_arguments: object, **_options: object) -> None:
    raise KeyboardInterrupt


def test_an_interrupt_leaves_nothing_behind(run, tmp_path, noisy, question, monkeypatch):
    monkeypatch.setattr(identify_command, "estimate_model", interrupted)
    outcome = run("identify", noisy, *question, "--out", tmp_path / "out")
    assert outcome.code == 130
    assert outcome.err.splitlines()[-1] == "tridentify: interrupted"
    assert [path.name for path in tmp_path.iterdir()] == ["noisy.csv"]


@pytest.mark.slow
@pytest.mark.undrawn
@pytest.mark.unjudged
def test_a_failure_while_writing_leaves_nothing_behind(run, tmp_path, noisy, question, monkeypatch):
    import tridentify.report.html as report

    def full(_page: object, path: Path, _figures: Path) -> None:
        assert (path.parent / "model.json").exists()
        raise OSError(28, "No space left on device", str(path.parent / "fit.svg"))

    monkeypatch.setattr(report, "write_page", full)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "model.json").write_text("old")
    outcome = run("identify", noisy, *question, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert "No space left on device" in outcome.error_lines[0]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["model.json"]
    assert (tmp_path / "out" / "model.json").read_text() == "old"


def unforeseen(*_arguments: object, **_options: object) -> None:
    raise ZeroDivisionError("two\nlines")


def test_a_fault_is_one_line_and_debug_shows_where(run, noisy, question, monkeypatch):
    monkeypatch.setattr(identify_command, "estimate_model", unforeseen)
    outcome = run("identify", noisy, *question)
    assert outcome.code == 70
    assert outcome.err.splitlines()[-1].startswith("tridentify: error: ")
    assert "ZeroDivisionError: two lines" in outcome.err
    assert "Traceback" not in outcome.err
    for arguments in (
        ["--debug", "identify", noisy, *question],
        ["identify", noisy, *question, "--debug"],
    ):
        assert "Traceback" in run(*arguments).err


def test_warnings_of_libraries_do_not_reach_the_user(run, noisy, question, monkeypatch):
    import warnings

    kept = identify_command.estimate_model

    def noisy_library(*arguments: Any, **options: Any) -> Estimate:
        warnings.warn("overflow encountered", RuntimeWarning, stacklevel=1)
        warnings.warn("the input moves", tridentify.errors.DataWarning, stacklevel=1)
        return kept(*arguments, **options)

    monkeypatch.setattr(identify_command, "estimate_model", noisy_library)
    outcome = run("identify", noisy, *question)
    assert "overflow" not in outcome.err
    assert "tridentify: warning: the input moves" in outcome.err


def test_counting_reports_every_tenth_in_plain_text(capsys):
    with terminal.Activity() as activity:
        for done in range(1, 101):
            activity.count(done, 100)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[1] for line in lines] == [str(k) for k in range(10, 101, 10)]


# ------------------------------------------------------------------------------- robust losses
@pytest.mark.slow
def test_outliers_may_be_met_with_a_robust_loss(run, write_table, clean, question):
    rng = np.random.default_rng(2)
    noise = 1e-3 * rng.standard_normal(clean["q"].size)
    where = rng.choice(noise.size, 30, replace=False)
    noise[where] += 0.1
    path = write_table("spikes.csv", clean | {"q": clean["q"] + noise})
    plain = json.loads(run("identify", path, *question, "--json").out)
    assert any("--loss huber" in text for text in plain["warnings"])
    for loss in ("huber", "student"):
        outcome = run("identify", path, *question, "--loss", loss, "--json")
        assert outcome.code == 0
        document = json.loads(outcome.out)
        assert values(document) == pytest.approx(TRUTH, rel=0.05)
        assert any("30 of 600 samples lie beyond" in text for text in document["decisions"])
        assert document["fit"][0]["noise_std"] == pytest.approx(1e-3, rel=0.2)


def test_loss_is_refused_with_a_method_that_has_no_choice_of_it(run, noisy, question):
    options = ["--method", "svf-least-squares", "--loss", "huber"]
    outcome = run("identify", noisy, *question, *options)
    assert outcome.code == 2
    assert "found --loss huber with --method svf-least-squares" in outcome.err
