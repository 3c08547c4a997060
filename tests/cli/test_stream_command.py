"""`tridentify stream`: what it takes in, what it answers, and how it stops and goes on."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tridentify
from tridentify import Record, Structure, TransferFunction, errors, online
from tridentify.cli import stream_command, stream_session, stream_show
from tridentify.cli.stream_question import StreamQuestion
from tridentify.cli.stream_session import Session
from tridentify.record.formats.streams import datagrams, sources
from tridentify.record.formats.streams.header import Asked
from tridentify.record.formats.streams.lines import LineCutter

DT = 0.02
TRUTH = {"a1": 3.0, "a0": 9.0, "b1": 2.0, "b0": 3.0}
QUESTION = ["--input", "elevator", "--output", "q", "--poles", "2", "--zeros", "1"]
QUICKLY = ["--method", "kalman"]
"""An estimator that costs little, where a test looks at other things than its estimates."""
SOURCES = Path(tridentify.__file__).parents[1]


def objects(text: str) -> list[dict[str, Any]]:
    """Every line of the output; a number that JSON does not know is no JSON."""

    def refuse(name: str) -> None:
        raise ValueError(name)

    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def values(document: dict[str, Any]) -> dict[str, float]:
    return {name: item["value"] for name, item in document["coefficients"].items()}


@pytest.fixture
def columns(held) -> dict[str, np.ndarray]:
    """A long, busy record with a little noise."""
    rng = np.random.default_rng(7)
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 15)
    y = held([2.0, 3.0], u) + 0.02 * rng.standard_normal(u.size)
    return {"t": DT * np.arange(u.size), "elevator": u, "q": y}


@pytest.fixture
def file(write_table, columns) -> Path:
    """The same as a file."""
    return write_table("flight.csv", columns)


def lines_of(file: Path) -> list[str]:
    return file.read_text(encoding="utf-8").splitlines()


def start(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    """The command line in another process."""
    words = [sys.executable, "-m", "tridentify", *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(SOURCES), "PYTHONUNBUFFERED": "1"}
    streams = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen(words, text=True, env=environment, **(streams | options))


def until(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)


# ------------------------------------------------------------------------------------- the answer
@pytest.mark.slow
def test_the_last_line_is_what_the_record_gives_at_once(run, file, columns):
    outcome = run("stream", file, *QUESTION, "--every", 5)
    assert outcome.code == 0
    *_, last = objects(outcome.out)
    record = Record(
        columns["elevator"], columns["q"], dt=DT, input_names=["elevator"], output_names=["q"]
    )
    whole = online.run(online.ThreeModel(), record, Structure(2, 1), every=1e9).estimate
    assert values(last) == {
        name: stream_show.rounded(item.value, item.std) for name, item in whole.parameters.items()
    }
    assert {n: c["std"] for n, c in last["coefficients"].items()} == {
        name: stream_show.rounded(item.std) for name, item in whole.parameters.items()
    }
    for name, item in last["coefficients"].items():
        assert abs(item["value"] - TRUTH[name]) < 4 * item["std"]
    assert last["noise_std"]["q"] == pytest.approx(0.02, rel=0.1)
    assert last["innovation_std"]["q"] == pytest.approx(0.02, rel=0.3)
    assert last["fit"]["q"] == float(f"{whole.fit[0]:.6g}")
    assert all(len(repr(item["std"])) < 14 for item in last["coefficients"].values())
    assert (last["n_samples"], last["lines"], last["malformed"]) == (1500, 1501, 0)


def test_lines_come_at_every_tick_of_data_time_and_at_the_end(run, file):
    found = objects(run("stream", file, *QUESTION, *QUICKLY, "--every", 5).out)
    assert [line["time"] for line in found] == pytest.approx([5, 10, 15, 20, 25, 29.98])
    assert [line["n_samples"] for line in found] == [251, 501, 751, 1001, 1251, 1500]
    assert [line["final"] for line in found] == [False] * 5 + [True]
    assert len(objects(run("stream", file, *QUESTION, *QUICKLY, "--every", "inf").out)) == 1


def test_a_line_at_the_very_end_comes_once(run, file):
    file.write_text("\n".join(lines_of(file)[:502]) + "\n")
    found = objects(run("stream", file, *QUESTION, *QUICKLY, "--every", 5).out)
    assert [line["time"] for line in found] == pytest.approx([5, 10])
    assert [line["number"] for line in found] == [1, 2]


def test_before_it_is_ready_a_line_says_so(run, file):
    file.write_text("\n".join(lines_of(file)[:20]))
    first, *_ = objects(run("stream", file, *QUESTION, "--every", 0.02).out)
    assert not first["ready"]
    assert first["reason"].startswith("found")
    assert "not-ready" in first["flags"]
    assert "coefficients" not in first
    assert first["time"] == pytest.approx(0.02)


def test_too_little_is_answered_with_exit_code_one(run, tmp_path, file):
    path = tmp_path / "short.csv"
    path.write_text("\n".join(lines_of(file)[:6]) + "\n")
    outcome = run("stream", path, *QUESTION)
    (last,) = objects(outcome.out)
    assert (last["ready"], last["final"]) == (False, True)
    assert outcome.code == 1
    assert len(outcome.error_lines) == 1


@pytest.mark.slow
def test_results_do_not_depend_on_how_the_bytes_come(run, file, monkeypatch):
    lines = lines_of(file)
    lines[700:700] = ["stall", "1,2", '9.9,"1"', lines[0]]
    file.write_text("\n".join(lines))
    whole = run("stream", file, *QUESTION).out
    for size, block in ((997, 8192), (1 << 20, 13), (64, 5)):
        monkeypatch.setattr(sources, "PIECE", size)
        monkeypatch.setattr(stream_session, "BLOCK", block)
        assert run("stream", file, *QUESTION).out == whole


@pytest.mark.slow
def test_malformed_lines_before_the_step_is_known_count_where_they_stand(run, file, monkeypatch):
    header, *rows = lines_of(file)[:200]
    spoiled = ["x", *rows[:3], *["stall"] * 20, *rows[3:30], *["1,2"] * 7, *rows[30:]]
    file.write_text("\n".join([header, *spoiled]))
    whole = run("stream", file, *QUESTION, "--every", 0.2).out
    assert [line["malformed"] for line in objects(whole)][:3] == [21, 21, 28]
    for size in (1, 97):
        monkeypatch.setattr(sources, "PIECE", size)
        assert run("stream", file, *QUESTION, "--every", 0.2).out == whole
        monkeypatch.setattr(stream_session, "MOST_HELD", 5)
        assert objects(run("stream", file, *QUESTION).out)[-1]["malformed"] == 28
        monkeypatch.undo()


@pytest.mark.slow
def test_json_gives_what_csv_gives(run, file, tmp_path):
    path = tmp_path / "flight.jsonl"
    header, *rows = lines_of(file)
    names = header.split(",")
    path.write_text(
        "".join(
            json.dumps(dict(zip(names, map(float, row.split(",")), strict=True))) + "\n"
            for row in rows
        )
    )
    expected, found = (objects(run("stream", p, *QUESTION).out)[-1] for p in (file, path))
    assert found.pop("lines") == expected.pop("lines") - 1
    assert found == expected
    assert run("stream", path, *QUESTION, "--format", "csv").code == 2


@pytest.mark.slow
def test_a_known_step_takes_the_place_of_time(run, write_table, columns):
    del columns["t"]
    path = write_table("plain.csv", columns)
    _, *rows = lines_of(path)
    last = objects(run("stream", path, *QUESTION, "--dt", DT).out)[-1]
    for name, item in last["coefficients"].items():
        assert abs(item["value"] - TRUTH[name]) < 4 * item["std"]
    path.write_text("\n".join(rows))
    again = run("stream", path, *QUESTION, "--dt", DT, "--columns", "elevator,q")
    assert values(objects(again.out)[-1]) == values(last)


@pytest.mark.slow
def test_missing_samples_jitter_and_bad_lines_are_flagged(run, file):
    lines = lines_of(file)
    lines[300] = lines[300].rpartition(",")[0] + ","
    time_, *rest = lines[600].split(",")
    lines[600] = ",".join([repr(float(time_) + 0.003), *rest])
    lines[900] = "noise on the line"
    file.write_text("\n".join(lines) + "\n")
    outcome = run("stream", file, *QUESTION, "--every", 5)
    found = objects(outcome.out)
    said = [{"missing-output", "jitter"} & set(line["flags"]) for line in found]
    assert said == [set(), {"missing-output"}, {"jitter"}, {"jitter"}, set(), set()]
    assert {"missing-output", "jitter"} <= set(found[-1]["seen"])
    assert [line["malformed"] for line in found] == [0, 0, 0, 1, 1, 1]
    assert "line 901: found 1 cells; expected 3; skipped" in outcome.err
    for name, item in found[-1]["coefficients"].items():
        assert abs(item["value"] - TRUTH[name]) < 5 * item["std"]


@pytest.mark.slow
def test_several_channels_have_their_own_coefficients(run, held, write_table):
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([-1.0, 1.0], (2, 120)), 10, axis=1)
    y = [held(b, u[0]) + held([c, 1.0], u[1]) for b, c in (([2.0, 3.0], 4.0), ([1.0, 5.0], 6.0))]
    y = [one + 0.01 * rng.standard_normal(one.size) for one in y]
    columns = {"t": DT * np.arange(u.shape[1]), "e": u[0], "r": u[1], "q": y[0], "p": y[1]}
    words = ["--input", "e", "--input", "r", "--output", "q", "--output", "p"]
    path = write_table("two.csv", columns)
    last = objects(run("stream", path, *words, "--poles", 2, "--zeros", 1, "--every", 20).out)[-1]
    truth = {"a1": 3.0, "a0": 9.0, "b1[q,e]": 2.0, "b1[p,r]": 6.0, "b0[p,e]": 5.0, "b0[q,r]": 1.0}
    for name, value in truth.items():
        item = last["coefficients"][name]
        assert abs(item["value"] - value) < 5 * item["std"]
    assert set(last["noise_std"]) == set(last["fit"]) == set(last["innovation_std"]) == {"q", "p"}


def test_samples_that_do_not_count_are_missing(run, file):
    outcome = run("stream", file, *QUESTION, *QUICKLY, "--missing", "q>=0.3", "--every", "inf")
    (last,) = objects(outcome.out)
    assert "missing-output" in last["flags"]


@pytest.mark.slow
def test_with_a_delay_gaps_are_missing_samples(run, file, tmp_path):
    header, *rows = lines_of(file)
    moved = [row.split(",") for row in rows]
    late = np.concatenate([np.zeros(7), [float(q) for _, _, q in moved]])
    rows = [f"{t},{u},{q!r}" for (t, u, _), q in zip(moved, late.tolist(), strict=False)]
    rows[300] = "bad"
    del rows[700:705]
    rows[1100:1100] = [f"{1104 * DT + 0.007!r},1,1"]
    file.write_text("\n".join([header, *rows]))
    words = ["stream", file, *QUESTION, "--delay", 7 * DT]
    outcome = run(*words)
    last = objects(outcome.out)[-1]
    assert (last["n_samples"], last["malformed"]) == (1500, 2)
    assert "whole steps, as there is a delay" in outcome.err
    assert {"missing-output", "missing-input"} <= set(last["seen"])
    assert "jitter" not in last["seen"]
    for name, item in last["coefficients"].items():
        assert abs(item["value"] - TRUTH[name]) < 5 * item["std"]
    # resumed right before, within and behind the gaps
    for kept_rows in (302, 303, 700, 702):
        kept, part = tmp_path / f"{kept_rows}.json", tmp_path / "part.csv"
        part.write_text("\n".join([header, *rows[:kept_rows]]))
        run("stream", part, *words[2:], "--checkpoint", kept)
        part.write_text("\n".join([header, *rows]))
        again = run("stream", part, *words[2:], "--checkpoint", kept, "--resume")
        assert objects(again.out)[-1] == last


@pytest.mark.slow
def test_a_clock_that_is_set_back_is_followed(run, file):
    header, *rows = lines_of(file)
    again = [row.split(",", 1) for row in rows[1000:]]
    rows[1000:] = [f"{float(t) - 20.0!r},{rest}" for t, rest in again]
    file.write_text("\n".join([header, *rows]))
    outcome = run("stream", file, *QUESTION, "--every", "inf")
    (last,) = objects(outcome.out)
    assert (last["n_samples"], last["malformed"]) == (1491, 9)
    (line,) = [text for text in outcome.err.splitlines() if "set back" in text]
    assert line.endswith("going on from there")
    for name, item in last["coefficients"].items():
        assert abs(item["value"] - TRUTH[name]) < 5 * item["std"]


@pytest.mark.slow
def test_a_change_of_the_plant_is_told(run, held, write_table):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 300), 10)
    y = held([2.0, 3.0], u)
    y[1500:] *= 3.0
    y += 0.02 * rng.standard_normal(u.size)
    path = write_table("broken.csv", {"t": DT * np.arange(u.size), "elevator": u, "q": y})
    last = objects(run("stream", path, *QUESTION).out)[-1]
    assert last["n_changes"] == len(last["changes"]) >= 1
    assert 1500 <= last["changes"][0] < 1700
    assert last["change_times"] == pytest.approx([DT * k for k in last["changes"]], rel=1e-5)
    assert f"changed at {last['change_times'][-1]:.6g} s" in stream_show.plain_line(last, 1.0)
    assert last["coefficients"]["b1"]["value"] == pytest.approx(6.0, rel=0.1)


# ------------------------------------------------------------------------------- malformed lines
def test_a_flood_of_bad_lines_does_not_flood_the_terminal(run, file):
    header, *rows = lines_of(file)
    mixed = [header, *(text for row in rows for text in (row, "x" * 500, "{", "1,2,3,4,5"))]
    file.write_text("\n".join(mixed) + "\n")
    outcome = run("stream", file, *QUESTION, *QUICKLY, "--every", "inf")
    assert outcome.code == 0
    assert len(outcome.err.splitlines()) < 30
    assert max(map(len, outcome.err.splitlines())) < 300
    assert "4,500 of 6,001 lines were malformed" in outcome.err
    assert "more remarks were not shown" in outcome.err
    assert objects(outcome.out)[-1]["malformed"] == 4500


def garbage() -> st.SearchStrategy[bytes]:
    """Lines that are no sample: wrong numbers of cells, text, bytes, half of what is sound."""
    return st.one_of(
        st.binary(max_size=40),
        st.text(max_size=30).map(lambda text: text.encode()),
        st.sampled_from([b'{"t":1', b"1,2", b"1,2,3,4", b"9" * 70_000, b"\xff\xfe", b"a,b,c"]),
    ).map(lambda line: b"?," + line.replace(b"\n", b"").replace(b"\r", b""))


def fed(data: bytes, size: int) -> tuple[dict[str, Any], list[str]]:
    """The last line of a stream that comes in pieces of a size."""
    asked = Asked(("u",), ("y",))
    method = online.ThreeModel(start=TransferFunction([1.0], [1.0, 1.2]))
    question = StreamQuestion(asked, Structure(1, 0), method, None, "zoh", (), float("inf"))
    told: list[str] = []
    session, cutter = Session(question, lambda _: None, told.append), LineCutter()
    for begin in range(0, len(data), size):
        for lines in cutter.cut(data[begin : begin + size]):
            session.take(lines)
    return session.line(final=True), told


@pytest.mark.slow
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.data_too_large])
@given(
    st.lists(st.tuples(st.integers(1, 120), garbage()), max_size=25),
    st.integers(1, 5000),
)
def test_whatever_stands_between_the_samples_they_are_found(bad, size):
    u = np.sign(np.sin(0.3 * np.arange(120) ** 1.3))
    y = np.zeros(120)
    for k in range(119):
        y[k + 1] = 0.9 * y[k] + 0.1 * u[k]
    rows = [b"t,u,y", *(b"%.17g,%g,%.17g" % (0.1 * k, u[k], y[k]) for k in range(120))]
    clean, _ = fed(b"\n".join(rows) + b"\n", 4096)
    for place, line in sorted(bad, key=lambda item: -item[0]):
        rows.insert(place, line)
    found, told = fed(b"\n".join(rows) + b"\n", size)
    assert found["coefficients"] == clean["coefficients"]
    assert found["n_samples"] == 120
    assert found["malformed"] == len(bad)
    assert found["lines"] == 121 + len(bad)
    assert all("\n" not in text for text in told)


def test_remarks_come_back_after_a_pause():
    now, said = [0.0], []
    remarks = stream_show.Remarks(said.append, clock=lambda: now[0])
    for _ in range(20):
        remarks.remark("bad")
    assert said == ["bad"] * stream_show.AT_ONCE
    now[0] += 2.0
    remarks.remark("again")
    assert said[-2:] == ["15 more remarks were not shown", "again"]


# ------------------------------------------------------------------------- stopping and going on
def checkpointed(file: Path, kept: Path, *more: object) -> list[object]:
    return ["stream", file, *QUESTION, "--every", 1, "--checkpoint", kept, *more]


@pytest.mark.parametrize(
    "cut",
    [31_003, *(pytest.param(n, marks=pytest.mark.slow) for n in (100, 4_000, 45_678, 60_001))],
)
@pytest.mark.slow
def test_a_file_that_grew_is_taken_up_where_it_ended(run, file, tmp_path, cut):
    content = file.read_bytes()
    lines = content.split(b"\n")
    # what is bad, jittered or comes again lies on both sides of the cut
    for k in range(9, 1400, 97):
        lines[k : k + 1] = [lines[k], b"bad", lines[0]]
    content = b"\n".join(lines)
    file.write_bytes(content)
    whole = objects(run("stream", file, *QUESTION).out)
    part, kept = tmp_path / "part.csv", tmp_path / "kept.json"
    part.write_bytes(content[:cut])
    first = run(*checkpointed(part, kept, "--resume"))
    assert "beginning anew" in first.err
    part.write_bytes(content)
    second = run(*checkpointed(part, kept, "--resume"))
    assert second.code == 0
    assert "going on from" in second.err
    assert objects(second.out)[-1] == whole[-1]
    periodic = [line for line in objects(first.out) + objects(second.out) if not line["final"]]
    unique = {line["time"]: line for line in periodic}
    assert list(unique.values()) == whole[:-1]


@pytest.mark.slow
@pytest.mark.parametrize("moment", [3, 11, 22])
def test_a_run_that_was_killed_ends_as_one_that_was_not(run, file, tmp_path, moment):
    whole = objects(run("stream", file, *QUESTION).out)
    kept = tmp_path / "kept.json"
    growing = tmp_path / "growing.csv"
    lines = file.read_bytes().splitlines(keepends=True)
    growing.write_bytes(b"".join(lines[: 55 * moment]))
    process = start(*checkpointed(growing, kept, "--follow"))
    # it is not told what is coming, and dies in the middle of it
    until(lambda: kept.exists() and len(kept.read_bytes()) > 0)
    with growing.open("ab") as stream:
        for k in range(55 * moment, len(lines)):
            stream.write(lines[k])
            stream.flush()
            if k == 55 * moment + 200:
                process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert [path.name for path in tmp_path.iterdir() if "kept" in path.name] == [kept.name]
    outcome = run(*checkpointed(growing, kept, "--resume"))
    assert outcome.code == 0
    assert objects(outcome.out)[-1] == whole[-1]


@pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM]
)
def test_a_signal_ends_it_with_the_last_line_and_the_checkpoint(run, file, tmp_path, number):
    kept = tmp_path / "kept.json"
    with file.open("ab") as stream:
        stream.write(b"30.0,1.0")  # half a line
    process = start(*checkpointed(file, kept, *QUICKLY, "--follow"))
    assert process.stdout is not None
    shown = [process.stdout.readline() for _ in range(29)]
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    found = objects("".join(shown) + out)
    assert found[-1]["final"]
    assert found[-1]["malformed"] == 0
    assert 29.0 <= found[-1]["time"] <= 29.98
    with file.open("ab") as stream:
        stream.write(b",0.5\n")
    whole, again = (run(*words) for words in (
        ["stream", file, *QUESTION, *QUICKLY], checkpointed(file, kept, *QUICKLY, "--resume")
    ))  # fmt: skip
    assert objects(again.out)[-1] == objects(whole.out)[-1]


@pytest.mark.slow
def test_what_comes_after_a_pipe_is_gone_on_with(run, file, tmp_path, monkeypatch):
    header, *rows = lines_of(file)
    kept = tmp_path / "kept.json"
    whole = objects(run("stream", file, *QUESTION).out)[-1]
    for part in ([header, *rows[:611]], [header, *rows[611:1200]], rows[1200:]):
        pipe = io.TextIOWrapper(io.BytesIO("\n".join(part).encode()))
        monkeypatch.setattr(sys, "stdin", pipe)
        outcome = run(*checkpointed(Path("-"), kept, "--resume"))
        assert outcome.code == 0
    last = objects(outcome.out)[-1]
    assert last.pop("lines") == whole.pop("lines") + 1
    assert last == whole


def test_a_checkpoint_is_neither_overwritten_nor_taken_for_another(run, file, tmp_path):
    kept = tmp_path / "kept.json"
    assert run(*checkpointed(file, kept, *QUICKLY)).code == 0
    before = kept.read_bytes()
    cases = {
        "expected --resume to go on": checkpointed(file, kept, *QUICKLY),
        "found structure": [*checkpointed(file, kept, *QUICKLY, "--resume"), "--delay", "0.1"],
        "found method": checkpointed(file, kept, "--resume"),
        "without --checkpoint": ["stream", file, *QUESTION, "--resume"],
    }
    for says, words in cases.items():
        outcome = run(*words)
        assert outcome.code == 2
        (line,) = outcome.error_lines
        assert says in line
    text = file.read_text()
    for content, says in (
        (text.replace("0.02,", "0.03,", 1), "found other content"),
        (text[: len(text) // 2], "bytes in"),
    ):
        file.write_text(content)
        outcome = run(*checkpointed(file, kept, *QUICKLY, "--resume"))
        assert (outcome.code, outcome.out) == (2, "")
        (line,) = outcome.error_lines
        assert says in line
    assert kept.read_bytes() == before


@pytest.mark.parametrize(
    "content", ["", "{}", "[1]", '{"stream_checkpoint": 1}', '{"stream_checkpoint": 9}', "half {"]
)
def test_a_damaged_checkpoint_is_refused_in_one_line(run, file, tmp_path, content):
    kept = tmp_path / "kept.json"
    kept.write_text(content)
    outcome = run(*checkpointed(file, kept, "--resume"))
    assert outcome.code == 2
    assert len(outcome.error_lines) == 1
    assert "found" in outcome.error_lines[0]


@pytest.mark.parametrize(
    "key",
    [
        "state",
        *(
            pytest.param(k, marks=pytest.mark.slow)
            for k in ("reader", "timeline", "counts", "mark", "question")
        ),
    ],
)
def test_a_checkpoint_with_a_part_missing_is_refused_in_one_line(run, file, tmp_path, key):
    kept = tmp_path / "kept.json"
    run(*checkpointed(file, kept, *QUICKLY))
    document = json.loads(kept.read_text())
    for damaged in (
        {name: value for name, value in document.items() if name != key},
        document | {key: "nonsense"},
        document | {key: {}},
    ):
        kept.write_text(json.dumps(damaged))
        outcome = run(*checkpointed(file, kept, *QUICKLY, "--resume"))
        assert outcome.code == 2, outcome.err
        assert len(outcome.error_lines) == 1


@pytest.mark.slow
def test_a_checkpoint_of_numbers_that_do_not_fit_is_refused_in_one_line(run, file, tmp_path):
    """Columns that are not there, clocks that run away, a state of something else."""
    kept = tmp_path / "kept.json"
    run(*checkpointed(file, kept))
    document = json.loads(kept.read_text())
    columns = document["reader"]["columns"]
    other = {**document["state"], "input_names": ["another"]}
    for part, changes in (
        ("reader", {"columns": {**columns, "places": [0, 1, 9]}}),
        ("reader", {"columns": {**columns, "width": 10**30}}),
        ("reader", {"columns": None}),
        ("reader", {"separator": ""}),
        ("reader", {"names": [1, 2, 3]}),
        ("reader", {"more": 1}),
        ("timeline", {"dt": 1e-3}),
        ("timeline", {"count": 10**30}),
        ("timeline", {"anchor": -1e300}),
        ("timeline", {"behind": 10**9}),
        ("timeline", {"whole": True}),
        ("counts", {"flags": 1 << 40}),
        ("counts", {"line": -1}),
        ("counts", {"line": 10**30}),
        ("counts", {"elapsed": "3"}),
        ("state", other),
        ("state", {"ints": [10**30] * 72}),
    ):
        damaged = {**document, part: {**document[part], **changes}}
        kept.write_text(json.dumps(damaged))
        outcome = run(*checkpointed(file, kept, "--resume"))
        assert (outcome.code, len(outcome.error_lines)) == (2, 1), (part, changes, outcome.err)
        assert "checkpoint" in outcome.error_lines[0]
    for mark in ([1.5, 0, 0], [10**30, 0, 0], [-1, 0, 0], [0, 0], "mark"):
        kept.write_text(json.dumps({**document, "mark": mark}))
        assert run(*checkpointed(file, kept, "--resume")).code == 2
    for text in ("[" * 200_000, json.dumps({**document, "mark": "x"}).replace('"x"', "1e999")):
        kept.write_text(text)
        outcome = run(*checkpointed(file, kept, "--resume"))
        assert (outcome.code, len(outcome.error_lines)) == (2, 1)


def test_a_folder_that_cannot_be_written_is_refused_at_once(run, file, tmp_path):
    (tmp_path / "file").write_text("")
    outcome = run(*checkpointed(file, tmp_path / "file" / "kept.json"))
    assert (outcome.code, outcome.out) == (2, "")
    assert "--checkpoint" in outcome.error_lines[0]


@pytest.mark.slow
def test_a_reader_that_goes_ends_it_quietly(file):
    process = start("stream", file, *QUESTION, "--every", 0.1, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    json.loads(process.stdout.readline())
    process.stdout.close()
    said = process.stderr.read()
    assert process.wait(timeout=60) == 0
    assert "error" not in said
    assert "Traceback" not in said
    process.stderr.close()
    assert process.stdin is not None
    process.stdin.close()


# ------------------------------------------------------------------------------------ the sources
@pytest.mark.slow
def test_a_file_that_grows_in_halves_of_lines_is_read_in_whole_ones(run, file, tmp_path):
    content = file.read_bytes()
    expected = objects(run("stream", file, *QUESTION, "--every", 10).out)
    growing = tmp_path / "growing.csv"
    growing.write_bytes(b"")

    def write() -> None:
        with growing.open("ab", buffering=0) as stream:
            for begin in range(0, len(content), 7001):
                stream.write(content[begin : begin + 7001])
                time.sleep(0.02)

    writer = threading.Thread(target=write)
    writer.start()
    words = ["stream", growing, *QUESTION, "--every", 10, "--follow", "--idle", 1.5]
    found = objects(run(*words).out)
    writer.join()
    assert found == expected


@pytest.mark.slow
def test_every_line_has_its_number_and_a_repeated_one_keeps_it(run, file, tmp_path, monkeypatch):
    whole = objects(run("stream", file, *QUESTION, "--every", 1).out)
    assert [line["number"] for line in whole] == list(range(1, len(whole) + 1))
    assert next(iter(whole[0])) == "number"
    assert "dropped" not in whole[0]
    kept = tmp_path / "kept.json"
    written, least = stream_command.write_checkpoint, 7

    def killed(path, snapshot):
        if snapshot.counts["emitted"] > least:
            raise KeyboardInterrupt  # behind the line, before its checkpoint
        written(path, snapshot)

    monkeypatch.setattr(stream_command, "write_checkpoint", killed)
    first = objects(run(*checkpointed(file, kept)).out)
    monkeypatch.undo()
    second = objects(run(*checkpointed(file, kept, "--resume")).out)
    numbers = [line["number"] for line in first + second]
    assert numbers == [*range(1, least + 2), *range(least + 1, len(whole) + 1)]
    assert first[-1] == second[0]
    assert list({line["number"]: line for line in first + second}.values()) == whole


@pytest.mark.slow
def test_the_last_line_of_a_run_gives_its_number_to_what_follows(run, file, tmp_path):
    whole = objects(run("stream", file, *QUESTION, "--every", 1).out)
    content, kept = file.read_bytes(), tmp_path / "kept.json"
    file.write_bytes(content[:31_003])
    found = objects(run(*checkpointed(file, kept)).out)
    file.write_bytes(content)
    found += objects(run(*checkpointed(file, kept, "--resume")).out)
    assert list({line["number"]: line for line in found}.values()) == whole


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells how many were dropped")
def test_dropped_datagrams_are_told_in_every_line_and_kept(run, file, tmp_path, monkeypatch):
    header, *rows = lines_of(file)
    kept, told = tmp_path / "kept.json", [3, 5]
    monkeypatch.setattr(datagrams.UdpSource, "dropped", property(lambda _: told[0]))
    monkeypatch.setattr(
        datagrams.UdpSource,
        "pieces",
        lambda _: iter([sources.Chunk("\n".join([header, *rows, ""]).encode(), 0)]),
    )
    words = checkpointed(Path("udp:"), kept, *QUICKLY)
    words[1] = "udp://127.0.0.1:0"
    first = run(*words)
    assert [line["dropped"] for line in objects(first.out)] == [3] * 30
    assert "3 datagrams were dropped" in first.err
    told[0] = 5
    monkeypatch.setattr(
        datagrams.UdpSource,
        "pieces",
        lambda _: iter([sources.Chunk(b"30.0,1,0.5\n31.0,1,0.5\n", 0)]),
    )
    second = run(*words, "--resume")
    assert objects(second.out)[-1]["dropped"] == 8
    assert "8 datagrams were dropped" in second.err


@pytest.mark.slow
def test_datagrams_are_heard_on_the_loopback_address(file):
    header, *rows = lines_of(file)
    process = start(
        "stream", "udp://127.0.0.1:0", *QUESTION, "--every", 5, "--idle", 3, "--columns", header
    )
    assert process.stderr is not None
    port = int(re.search(r"listening at udp://127.0.0.1:(\d+)", process.stderr.readline())[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for k in range(0, len(rows), 3):
            sender.sendto("\n".join(rows[k : k + 3]).encode(), ("127.0.0.1", port))
            time.sleep(0.001)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    found = objects(out)
    assert found[-1]["n_samples"] == 1500
    assert len(found) == 6
    for name, item in found[-1]["coefficients"].items():
        assert abs(item["value"] - TRUTH[name]) < 4 * item["std"]


REFUSED: dict[str, tuple[list[object], type[Exception], str]] = {
    "address": (["udp://10.0.0.1:9"], errors.OptionError, "no address of this machine alone"),
    "port": (["udp://127.0.0.1"], errors.OptionError, "udp://127.0.0.1:PORT"),
    "protocol": (["tcp://127.0.0.1:9"], errors.OptionError, "expected -, a file, or udp://"),
    "file": (["nowhere.csv"], errors.UnreadableFileError, "nowhere.csv"),
    "folder": (["."], errors.UnreadableFileError, "directory"),
    "follow": (["-", "--follow"], errors.OptionError, "found --follow with '-'"),
    "every": (["FILE", "--every", "0"], errors.OptionError, "found --every 0"),
    "method": (["FILE", "--method", "magic"], errors.OptionError, "three-model"),
    "option": (["FILE", "--rate", "1"], errors.OptionError, "found --rate with --method"),
    "filter": (["FILE", "--filter", "a"], errors.OptionError, "found --filter 'a'"),
    "walk": (["FILE", "--walk", "a1=x"], errors.OptionError, "found --walk 'a1=x'"),
    "forgetting": (["FILE", "--forgetting", "2"], errors.OptionError, "forgetting=2"),
    "start": (["FILE", "--start", "no.json"], errors.UnreadableFileError, "no.json"),
    "rule": (["FILE", "--missing", "elevator>1"], errors.ChannelNameError, "'elevator'"),
    "time": (["FILE", "--time", "clock"], errors.MissingColumnError, "'clock'"),
    "poles": (["FILE", "--poles", "2,1"], errors.ChannelCountError, "--poles 2,1"),
    "zeros": (["FILE", "--zeros", "3"], errors.OrderError, "zeros"),
    "dt": (["FILE", "--dt", "-1"], errors.SamplingError, "dt"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_usage_is_one_line(run, file, tmp_path, monkeypatch, case):
    words, error, says = REFUSED[case]
    monkeypatch.chdir(tmp_path)
    given = [str(file) if word == "FILE" else word for word in words]
    named = dict(zip(QUESTION[::2], QUESTION[1::2], strict=True))
    named |= {k: v for k, v in zip(given[1::2], given[2::2], strict=False) if k in named}
    more = [w for k, w in enumerate(given[1:]) if given[1 + k - k % 2] not in named]
    arguments = ["stream", given[0], *(word for pair in named.items() for word in pair), *more]
    outcome = run(*arguments)
    assert (outcome.code, outcome.out) == (2, "")
    (line,) = outcome.error_lines
    assert says in line
    debug = run(*arguments, "--debug")
    assert error.__name__ in debug.err


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "found no sample in 0 lines"),
        ("t,elevator,q\n", "found no sample"),
        ("t,elevator,q\nx,y,z\n", "(1 malformed)"),
        ("t,elevator,q\n1,2,3\n", "expected at least 2 to know the step"),
        ("t,elevator,q\n" + "1,2,3\n" * 80, "and no step between times"),
        ("1,2,3\n", "--columns"),
        ("t,elevator\n1,2\n", "no column 'q'"),
    ],
)
def test_a_stream_without_samples_is_one_line(run, tmp_path, content, says):
    path = tmp_path / "empty.csv"
    path.write_text(content)
    outcome = run("stream", path, *QUESTION)
    assert (outcome.code, outcome.out) == (2, "")
    (line,) = outcome.error_lines
    assert says in line


def test_a_standard_input_that_is_closed_is_one_line(run, monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    outcome = run("stream", *QUESTION)
    assert (outcome.code, outcome.out) == (2, "")
    assert "standard input closed" in outcome.error_lines[0]


# --------------------------------------------------------------------------------------- the view
def test_without_a_terminal_the_live_view_is_a_plain_line(run, file):
    outcome = run("stream", file, *QUESTION, *QUICKLY, "--live", "--every", 5)
    assert outcome.code == 0
    assert len(objects(outcome.out)) == 6
    (line,) = [text for text in outcome.err.splitlines() if "samples/s" in text]
    assert re.search(r"1,500 samples, 29\.98 s, [\d,]+ samples/s; a1 = [\d.]+ \+- [\d.]+;", line)
    assert "\x1b" not in outcome.err


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals here")
def test_in_a_terminal_the_table_moves_and_the_lines_stay_whole(run, file, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    main, side = os.openpty()
    shown = bytearray()

    def watch() -> None:
        while True:
            try:
                data = os.read(main, 4096)
            except OSError:
                return
            if not data:
                return
            shown.extend(data)

    watcher = threading.Thread(target=watch)
    watcher.start()
    with open(side, "w", encoding="utf-8") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        outcome = run("stream", file, *QUESTION, *QUICKLY, "--live")
        monkeypatch.undo()
    watcher.join()
    os.close(main)
    assert outcome.code == 0
    assert len(objects(outcome.out)) == 30
    text = shown.decode()
    assert "samples/s" in text
    assert "std error" in text
    assert "\x1b[" in text


@pytest.mark.slow
def test_the_table_shows_what_the_line_says(run, file):
    from rich.console import Console

    last = objects(run("stream", file, *QUESTION, "--every", "inf").out)[-1]
    last |= {"flags": ["stuck"], "change_times": [0.14], "malformed": 3}
    console = Console(width=100)
    with console.capture() as capture:
        console.print(stream_show.live_table("flight.csv", last, 1234.5))
    text = " ".join(capture.get().split())
    for said in ("flight.csv: 1,500 samples, 29.98 s, 1,234 samples/s", "stuck", "a1 3.0", "b0 3.0",
                 "changed at 0.14 s", "3 malformed lines"):  # fmt: skip
        assert said in text


@pytest.mark.parametrize("how", ["zoh", "foh"])
@pytest.mark.fast("foh")
def test_a_line_does_not_contradict_itself(run, file, how):
    file.write_text("\n".join(lines_of(file)[:202]) + "\n")
    found = objects(run("stream", file, *QUESTION, "--every", 0.5, "--intersample", how).out)
    assert {line["ready"] for line in found} == {False, True}
    for line in found:
        assert line["ready"] is ("not-ready" not in line["flags"])
        assert line["intersample"] == how
        assert line["innovation_std"]["q"] != 0.0
    assert found[0]["innovation_std"]["q"] is None
