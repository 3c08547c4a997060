"""A fleet: one row for every unit, whatever it does to the process that reads and identifies it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

import fleets
from tridentify import Record, Structure, TransferFunction, fleet, identify, simulate
from tridentify.errors import DataError, MissingColumnError, OptionError
from tridentify.fleet.rows import unpacked

pytestmark = pytest.mark.unjudged

MOODS = ("hang", "crash", "grow", "raise")


@pytest.fixture(scope="module")
def moody(tmp_path_factory: pytest.TempPathFactory) -> fleet.Run:
    """Good units, and among them some of every kind that goes wrong."""
    rng = np.random.default_rng(1)
    source: dict[str, object] = dict(fleets.units(6))
    source |= {mood: fleets.unit(rng, name=mood) for mood in MOODS}
    u = np.sign(np.sin(np.arange(100.0) ** 1.5))
    source |= {
        "flat": Record(u, np.zeros(100), dt=0.1),
        "constant input": Record(np.ones(100), u, dt=0.1, intersample="zoh"),
        "no record": 7,
        "two records": [fleets.unit(rng), fleets.unit(rng)],
        "absent file": "no/such/file.csv",
        "last": fleets.unit(rng),
    }
    return fleet.fit(
        source,
        Structure(2, 0, initial_state="free"),
        fleets.Moody(),
        out=tmp_path_factory.mktemp("moody") / "out",
        workers=1,  # each of them starts another process after every unit that ends one
        time_limit=1.5,
        memory_limit=2 << 30,
        progress=False,
        judge=False,
        inputs=["u"],
        outputs=["y"],
    )


def test_every_unit_has_one_row_with_its_reason(moody: fleet.Run) -> None:
    rows = moody.rows()
    status = dict(rows.select("key", "status").iter_rows())
    assert len(status) == rows.height == 16
    assert {key for key, one in status.items() if one == "converged"} == {
        *(f"u{k:04d}" for k in range(6)),
        "two records",
        "last",
    }
    assert {key: status[key] for key in status if status[key] != "converged"} == {
        "hang": "over time",
        "crash": "crashed",
        "grow": "over memory",
        "raise": "fault",
        "flat": "bad input",
        "constant input": "no answer",
        "no record": "bad input",
        "absent file": "bad input",
    }


def test_a_row_says_what_was_found_and_which_exception(moody: fleet.Run) -> None:
    rows = {row["key"]: row for row in moody.rows().to_dicts()}
    assert rows["hang"]["exception"] == "TimeoutError"
    assert "within 1.5 s" in rows["hang"]["message"]
    assert 1.5 <= rows["hang"]["seconds"] < 3.5
    assert rows["raise"]["exception"] == "ZeroDivisionError"
    assert rows["raise"]["message"] == "of the method's own making"
    assert rows["flat"]["exception"] == "ZeroOutputError"
    assert rows["constant input"]["exception"] == "ConstantInputError"
    assert "expected a Record" in rows["no record"]["message"]
    assert all("\n" not in row["message"] for row in rows.values())
    assert not any(row["ok"] for row in rows.values() if row["exception"])


def test_rows_carry_the_fingerprint_of_what_was_read(moody: fleet.Run) -> None:
    rows = {row["key"]: row for row in moody.rows().to_dicts()}
    for key in ("hang", "crash", "grow", "raise", "flat", "last"):
        assert len(rows[key]["fingerprint"]) == 64, key
    assert len({rows[key]["fingerprint"] for key in MOODS}) == 4


def test_numbers_are_those_of_identify(moody: fleet.Run) -> None:
    row = next(row for row in moody.rows().to_dicts() if row["key"] == "u0003")
    record = fleets.units(6)["u0003"]
    alone = identify(record, Structure(2, 0, initial_state="free"), fleets.Moody())
    assert row["coefficients"] == alone.theta.tolist()
    assert row["standard_errors"] == alone.std.tolist()
    np.testing.assert_array_equal(unpacked(row["covariance"]), alone.cov)
    assert row["names"] == ["a1", "a0", "b0"]
    assert row["fingerprint"] == alone.record_fingerprint
    assert row["fit"] == alone.fit.tolist()
    assert row["n_samples"] == 120


def test_the_table_has_a_column_a_coefficient(moody: fleet.Run) -> None:
    table = moody.table().set_index("key")
    assert table.loc["u0000", "a0"] == pytest.approx(3.0, rel=0.2)
    assert table.loc["u0000", "a0_std"] > 0
    assert np.isnan(table.loc["hang", "a0"])
    assert sorted(moody.failed()["key"]) == sorted(
        key for key in table.index if not table.loc[key, "ok"]
    )


def test_an_estimate_is_made_again_on_demand(moody: fleet.Run) -> None:
    row = next(row for row in moody.rows().to_dicts() if row["key"] == "two records")
    estimate = moody.estimate("two records")
    assert estimate.theta.tolist() == row["coefficients"]
    assert len(estimate.nuisance) == 2
    with pytest.raises(DataError, match="found no unit 'u9999'"):
        moody.estimate("u9999")


def test_the_summary_counts_causes_and_shows_the_distribution(moody: fleet.Run) -> None:
    text = moody.summary()
    assert "16 records: 8 with an estimate, 8 without" in text
    assert "bad input 3" in text
    assert "over time 1" in text
    assert "a0" in text
    first = moody.failed().iloc[0]
    assert f"\n  {first['key']}: {first['message']}\n" in text


@pytest.mark.parametrize(
    ("mood", "status", "said"),
    [
        ("raise", "fault", "of the method's own making"),
        pytest.param("hang", "over time", "within 1 s", marks=pytest.mark.slow),
    ],
)
def test_failed_units_are_tried_again_and_the_old_rows_stay(
    tmp_path: Path, mood: str, status: str, said: str
) -> None:
    source = fleets.units(2) | {mood: fleets.unit(np.random.default_rng(5), name=mood)}
    run = fleet.fit(
        source, (2, 0), fleets.Moody(), out=tmp_path, workers=1, time_limit=0.5, progress=False,
        judge=False,
    )  # fmt: skip
    with pytest.raises(OptionError, match="no failed unit that is crashed"):
        run.retry(status="crashed")
    again = run.retry(status=status, time_limit=1.0)
    rows = {row["key"]: row for row in again.rows().to_dicts()}
    assert rows[mood]["attempt"] == 1
    assert said in rows[mood]["message"]
    assert rows["u0000"]["attempt"] == 0
    stored = pl.concat(pl.read_parquet(path) for path in again.store.files())
    assert stored.filter(key=mood)["attempt"].sort().to_list() == [0, 1]


# --------------------------------------------------------------------------------------- sources
@pytest.fixture(scope="module")
def three() -> dict[str, Record]:
    return fleets.units(3, seed=3)


@pytest.fixture(scope="module")
def expected(
    three: dict[str, Record], tmp_path_factory: pytest.TempPathFactory
) -> list[list[float]]:
    return [identify(record, (2, 0)).theta.tolist() for record in three.values()]


def coefficients_of(run: fleet.Run) -> list[list[float]]:
    return run.rows()["coefficients"].to_list()


def test_files_of_any_format_and_the_damaged_among_them(
    three: dict[str, Record], expected: list[list[float]], tmp_path: Path
) -> None:
    folder = tmp_path / "logs" / "day one"
    fleets.write_files(folder, three)
    whole = (folder / "u0000.parquet").read_bytes()
    (folder / "cut.parquet").write_bytes(whole[: len(whole) // 2])
    (folder / "noise.parquet").write_bytes(b"PAR1" + bytes(range(256)) * 20)
    (folder / "words.csv").write_text("to be or not\nto be,,,\n")
    (folder / "empty.csv").write_text("")
    frame = fleets.frame_of({"u0001": three["u0001"]}).drop("unit")
    frame.with_columns(pl.lit(float("nan")).alias("u")).write_csv(folder / "nan.csv")
    frame.write_csv(tmp_path / "logs" / "u0001.csv")
    run = fleet.fit(
        tmp_path / "logs" / "**" / "*.*",
        (2, 0),
        out=tmp_path / "out",
        progress=False,
        judge=False,
        **fleets.READING,
    )
    rows = {row["key"]: row for row in run.rows().to_dicts()}
    assert [rows[f"day one/u000{k}.parquet"]["coefficients"] for k in range(3)] == expected
    np.testing.assert_allclose(rows["u0001.csv"]["coefficients"], expected[1], rtol=1e-9)
    bad = {key for key, row in rows.items() if row["status"] == "bad input"}
    names = ("cut.parquet", "noise.parquet", "words.csv", "empty.csv", "nan.csv")
    assert bad == {f"day one/{name}" for name in names}
    assert all(len(rows[key]["fingerprint"]) == 64 for key in bad)
    assert rows["day one/cut.parquet"]["exception"] == "UnreadableFileError"
    assert rows["day one/nan.csv"]["exception"] == "NotFiniteError"


@pytest.mark.parametrize("kind", ["file", "folder", "pandas", "polars", "pyarrow"])
def test_units_by_a_column(
    kind: str, three: dict[str, Record], expected: list[list[float]], tmp_path: Path
) -> None:
    frame = fleets.frame_of(three)
    source: object = frame
    if kind == "file":
        source = tmp_path / "all.parquet"
        # small row groups, and a unit in two pieces
        frame.write_parquet(source, row_group_size=50)
    elif kind == "folder":
        source = tmp_path / "set"
        (source / "unit=u0002").mkdir(parents=True)
        frame.filter(pl.col("unit") == "u0002").drop("unit").write_parquet(
            source / "unit=u0002" / "0.parquet"
        )
        rest = frame.filter(pl.col("unit") != "u0002")
        rest[:150].write_parquet(source / "a.parquet")
        rest[150:].write_parquet(source / "b.parquet")
        (source / "c.parquet").write_bytes(b"PAR1 cut short")
    elif kind == "pandas":
        source = frame.to_pandas()
    elif kind == "pyarrow":
        source = frame.to_arrow()
    run = fleet.fit(
        source,
        (2, 0),
        key="unit",
        out=tmp_path / "out",
        progress=False,
        judge=False,
        **fleets.READING,
    )
    good = run.rows().filter(pl.col("ok"))
    assert good["key"].to_list() == list(three)
    np.testing.assert_allclose(good["coefficients"].to_list(), expected, rtol=1e-9)
    if kind == "folder":
        (bad,) = run.rows().filter(~pl.col("ok")).to_dicts()
        assert (bad["key"], bad["exception"]) == ("c.parquet", "UnreadableFileError")


def test_a_key_that_comes_twice_is_a_row_of_its_own(
    three: dict[str, Record], expected: list[list[float]], tmp_path: Path
) -> None:
    pairs = [("a", three["u0000"]), ("a", three["u0001"]), ("b", three["u0002"])]
    run = fleet.fit(iter(pairs), (2, 0), out=tmp_path, progress=False, judge=False)
    rows = run.rows()
    assert rows["key"].to_list() == ["a", "a#2", "b"]
    assert rows["status"].to_list() == ["converged", "bad input", "converged"]
    assert rows["coefficients"].to_list() == [expected[0], [], expected[2]]


def test_sources_that_are_none(three: dict[str, Record], tmp_path: Path) -> None:
    fit = {"out": tmp_path / "out", "progress": False}
    with pytest.raises(DataError, match="found no file for"):
        fleet.fit(str(tmp_path / "*.csv"), (2, 0), **fit)
    with pytest.raises(OptionError, match="found one record"):
        fleet.fit(three["u0000"], (2, 0), **fit)
    with pytest.raises(OptionError, match="found key=None for a data frame"):
        fleet.fit(fleets.frame_of(three), (2, 0), **fit)
    fleets.frame_of(three).write_parquet(tmp_path / "all.parquet")
    with pytest.raises(MissingColumnError, match="no column 'tail'"):
        fleet.fit(tmp_path / "all.parquet", (2, 0), key="tail", **fit)
    with pytest.raises(OptionError, match="found time_limit=0"):
        fleet.fit(three, (2, 0), time_limit=0, **fit)
    with pytest.raises(OptionError, match="workers=True"):
        fleet.fit(three, (2, 0), workers=True, **fit)


@pytest.mark.slow
@pytest.mark.judged
@pytest.mark.parametrize("judge", [False, True])
def test_an_output_that_moves_beside_a_constant_input_is_no_answer_from_rest(
    judge: bool, tmp_path: Path
) -> None:
    """A start from rest is an answer only to who answers: the units here move by themselves."""
    still = {}
    for key, record in fleets.units(6, seed=4).items():
        still[key] = Record(np.ones(record.n_samples), record.y, dt=0.1, intersample="zoh")
    u = np.full(200, 2.0)
    y = simulate(TransferFunction([3.0], [1.0, 1.0, 3.0]), Record(u, u, dt=0.1))[:, 0]
    y = y + 0.02 * np.random.default_rng(5).standard_normal(200)
    source = still | {"step": Record(u, y, dt=0.1, intersample="zoh")}
    run = fleet.fit(source, Structure(2, 0), out=tmp_path / "out", judge=judge, progress=False)
    rows = {row["key"]: row for row in run.rows().to_dicts()}
    assert rows["step"]["ok"]
    assert "constant-input" in rows["step"]["cautions"]
    assert {rows[key]["status"] for key in still} == {"no answer"}
    assert "never change" in rows["u0000"]["message"]
