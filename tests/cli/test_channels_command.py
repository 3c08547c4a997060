"""``tridentify channels``, and ``tridentify identify`` on other files than text."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tridentify.record.formats import summary

pytestmark = pytest.mark.unisolated

N = 200


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    """A held square wave, and the exact response of 2/(s + 1) to it."""
    u = np.where(np.arange(N) // 25 % 2, -1.0, 1.0)
    y, state, decay = np.empty(N), 0.0, np.exp(-0.05)
    for k in range(N):
        y[k] = state
        state = decay * state + 2.0 * (1.0 - decay) * u[k]
    return {"time [ms]": 50.0 * np.arange(N), "u [deg]": u, "y [deg/s]": y}


@pytest.fixture(scope="module", params=["csv", "parquet", "npz"])
def file(request: pytest.FixtureRequest, columns, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("channels") / f"run.{request.param}"
    if request.param == "csv":
        pl.DataFrame(columns).write_csv(path)
    elif request.param == "parquet":
        pl.DataFrame(columns).write_parquet(path)
    else:
        np.savez(path, **columns)
    return path


def test_channels_are_listed(run, file: Path) -> None:
    outcome = run("channels", file)
    assert outcome.code == 0
    rows = [line.split() for line in outcome.out.splitlines()]
    assert ["u", "[deg]", "deg", "-1", "1", "0", "0", "input"] in rows
    assert outcome.out.startswith(f"{file.name}: 200 samples, 0 to 9.95 s, every 0.05 s")


def test_what_is_missing_uneven_or_no_number_is_told(run, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,mode,u,y [deg]\n0,auto,1,2\n1,man,NA,-3\n2,man,-,-\n4,off,2,7\n")
    outcome = run("channels", path)
    assert "unevenly: steps of 1 to 2 s" in " ".join(outcome.out.split())
    rows = {line.split()[0]: line.split()[1:] for line in outcome.out.splitlines() if line.strip()}
    assert rows["mode"] == ["no", "numbers"]
    assert rows["u"] == ["1", "2", "1.5", "2", "input"]
    assert rows["y"] == ["[deg]", "deg", "-3", "7", "2", "1", "output"]
    document = json.loads(run("channels", path, "--json").out)
    assert document["clocks"][0] == {
        "clock": "", "samples": 4, "start": 0.0, "stop": 4.0, "shortest": 1.0, "longest": 2.0,
        "step": None,
    }  # fmt: skip
    assert document["channels"][1]["mean"] is None


def test_what_there_was_no_time_for_is_told(run, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,mode,u\n0,auto,1\n1,man,2\n")
    monkeypatch.setattr(summary, "PATIENCE", -1.0)
    rows = [line.split() for line in run("channels", path).out.splitlines()]
    assert ["u", "not", "read"] in rows
    assert "2 samples, 0 to 1 s" in run("channels", path).out


def test_channels_of_several_clocks_are_told_apart(run, tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="needs openpyxl, of tridentify[excel]")
    book = openpyxl.Workbook()
    for sheet, step in ((book.active, 0.5), (book.create_sheet("slow"), 2.0)):
        sheet.append(["t", "u"])
        for k in range(5):
            sheet.append([step * k, k])
    book.save(tmp_path / "two.xlsx")
    said = " ".join(run("channels", tmp_path / "two.xlsx").out.split())
    assert "two.xlsx, Sheet: 5 samples, 0 to 2 s, every 0.5 s" in said
    assert "two.xlsx, slow: 5 samples, 0 to 8 s, every 2 s" in said


def test_no_time_is_told(run, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("u,y\n0,1\n1,2\n")
    assert "2 samples; time unknown" in run("channels", tmp_path / "run.csv").out


@pytest.mark.parametrize("columns", [1, 2500])
@pytest.mark.fast("1")
def test_names_of_any_length_are_cut_in_the_table(run, tmp_path: Path, columns: int) -> None:
    """One long name would make every row as wide as itself."""
    named = ["t", "u" * 20_000, *(f"c{k}" for k in range(columns))]
    (tmp_path / "long.csv").write_text(f"{','.join(named)}\n{','.join('1' for _ in named)}\n")
    outcome = run("channels", tmp_path / "long.csv")
    assert outcome.code == 0
    assert max(map(len, outcome.out.splitlines())) < 300
    assert "u...u" in outcome.out
    listed = json.loads(run("channels", tmp_path / "long.csv", "--json").out)["channels"]
    assert [entry["name"] for entry in listed] == named


@pytest.mark.fast("csv", "npz")
def test_channels_as_json(run, file: Path, columns) -> None:
    listed = json.loads(run("channels", file, "--json").out)["channels"]
    assert [entry["name"] for entry in listed] == ["time [ms]", "u [deg]", "y [deg/s]"]
    assert listed[2] == {
        "name": "y [deg/s]",
        "unit": "deg/s",
        "clock": "",
        "samples": N,
        "missing": 0,
        "minimum": pytest.approx(float(columns["y [deg/s]"].min()), abs=1e-9),
        "maximum": pytest.approx(float(columns["y [deg/s]"].max()), abs=1e-9),
        "mean": pytest.approx(float(columns["y [deg/s]"].mean()), abs=1e-9),
        "std": pytest.approx(float(columns["y [deg/s]"].std()), abs=1e-9),
        "role": "output",
        "rate": pytest.approx(20.0),
    }


@pytest.mark.fast("csv", "npz")
def test_identify_takes_the_file_and_its_units(run, file: Path) -> None:
    outcome = run(
        *("identify", file, "--input", "u", "--output", "y", "--poles", "1", "--zeros", "0"),
        "--json",
    )
    assert outcome.code == 0
    assert "taking column 'time [ms]' as time" in outcome.err
    found = {item["name"]: item for item in json.loads(outcome.out)["parameters"]}
    assert found["a0"]["value"] == pytest.approx(1.0, rel=1e-4)
    assert (found["a0"]["unit"], found["b0"]["unit"]) == ("1/s", "1/s^2")


def test_identify_takes_a_workbook_and_tells_its_title(run, columns, tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="needs openpyxl, of tridentify[excel]")
    book = openpyxl.Workbook()
    for row in (
        ["Bench 3"],
        list(columns),
        *zip(*(v.tolist() for v in columns.values()), strict=True),
    ):
        book.active.append(list(row))
    book.save(tmp_path / "run.xlsx")
    asked = ["--input", "u", "--output", "y", "--poles", "1", "--zeros", "0", "--json"]
    outcome = run("identify", tmp_path / "run.xlsx", *asked)
    assert outcome.code == 0, outcome.err
    assert "warning: found a line above the header of 'run.xlsx' ('Bench 3')" in outcome.err
    found = {item["name"]: item for item in json.loads(outcome.out)["parameters"]}
    assert found["a0"]["value"] == pytest.approx(1.0, rel=1e-4)


def test_a_format_with_a_time_of_its_own_needs_no_time(run, columns, tmp_path: Path) -> None:
    from scipy import io

    u, y = columns["u [deg]"], columns["y [deg/s]"]
    io.savemat(tmp_path / "run.mat", {"z": {"u": u[:, None], "y": y[:, None], "Ts": 0.05}})
    outcome = run(
        *("identify", tmp_path / "run.mat", "--input", "z.u", "--output", "z.y"),
        *("--poles", "1", "--zeros", "0", "--json"),
    )
    assert outcome.code == 0
    assert json.loads(outcome.out)["record"]["dt"] == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("absent.parquet", None, "no such file"),
        ("run.parquet", b"", "found nothing"),
        ("run.parquet", b"PAR1" + bytes(200), "expected a sound Parquet file"),
        ("run.mf4", b"t,u\n0,1\n", "no mark of MDF4"),
    ],
)
def test_a_bad_file_is_one_line(run, tmp_path: Path, name: str, content, words: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    outcome = run("channels", tmp_path / name)
    assert (outcome.code, outcome.out) == (2, "")
    assert len(outcome.error_lines) == 1
    assert words in " ".join(outcome.err.split())


def test_a_name_cannot_steer_the_terminal(run, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("t,\x1b[31mred\n0,1\n1,2\n")
    outcome = run("channels", tmp_path / "run.csv")
    assert outcome.code == 0
    assert "\x1b[31m" not in outcome.out
    assert "x1b[31mred" in outcome.out


@pytest.mark.fast("npz", "csv")
def test_without_channels_the_likely_ones_are_named(run, file: Path) -> None:
    for command in ("identify", "select", "advise"):
        outcome = run(command, file)
        assert outcome.code == 2
        assert "found no --input and no --output" in outcome.err
        assert "perhaps --input u --output y;" in " ".join(outcome.err.split())
    outcome = run("identify", file, "--input", "u", "--poles", 1)
    assert "found no --output; expected" in outcome.err
