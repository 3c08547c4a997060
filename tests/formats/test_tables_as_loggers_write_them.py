"""Preambles of columns, text below and among the rows, words of errors, days, midnight, dates."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
from scipy import io

from tridentify import Record, errors, read_record
from tridentify.cli import main
from tridentify.record.formats.assemble import Wanted, record_from
from tridentify.record.formats.matlab.matlab import open_file

pytestmark = pytest.mark.unisolated

N = 12
DT = 0.05
U = np.sign(np.sin(1.1 * np.arange(N) + 0.3))
Y = np.round(np.cumsum(U) * 0.1, 3)
ASKED = {"inputs": ["u"], "outputs": ["y"]}


def rows(stamps, separator=",", decimal=".", head="", tail="", y=Y) -> str:
    lines = zip(stamps, U, y, strict=True)
    texts = (separator.join((f"{t}", f"{u:.3f}", f"{v}")) for t, u, v in lines)
    return "".join(f"{head}{text}{tail}\n" for text in texts).replace(".", decimal)


SECONDS = [f"{k * DT:.3f}" for k in range(N)]
PLAIN = "t,u,y\n" + rows(SECONDS)


def check_good(record: Record, dt: float = DT) -> None:
    assert record.dt == pytest.approx(dt, rel=1e-5)
    np.testing.assert_array_equal(record.u[:, 0], U)
    np.testing.assert_array_equal(record.y[:, 0], Y)


@pytest.fixture
def listed(capsys: pytest.CaptureFixture[str]):
    """What ``tridentify channels`` says of a file."""

    def call(path) -> dict:
        capsys.readouterr()
        assert main(["channels", str(path), "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return call


# -------------------------------------------------------------------------------------- preambles
def labview(decimal: str, tail: str) -> str:
    return (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        f"Decimal_Separator\t{decimal}\nMulti_Headings\tNo\nX_Columns\tOne\n"
        "Time_Pref\tRelative\nOperator\tlab\nDate\t2026/11/20\nTime\t10:11:12.123456\n"
        "***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t12\t12\t\n"
        "Date\t2026/11/20\t2026/11/20\t\nTime\t10:11:12.1\t10:11:12.1\t\n"
        "Y_Unit_Label\tV\tmm\t\nX_Dimension\tTime\tTime\t\nX0\t0\t0\t\n"
        "Delta_X\t0.05\t0.05\t\n***End_of_Header***\t\t\t\nX_Value\tu\ty\tComment\n"
    ) + rows(SECONDS, "\t", decimal, tail=tail)


LOGGED = {
    "LabVIEW": (labview(".", "\t"), {}, {"u": "V", "y": "mm"}),
    "LabVIEW, decimal comma, no comments": (labview(",", ""), {}, {"u": "V", "y": "mm"}),
    "LabVIEW waveform": (
        "waveform\t[0]\t[1]\nt0\t20.11.2026 10:11:12,123\t20.11.2026 10:11:12,123\n"
        "delta t\t0,05\t0,05\n\ntime\tu\ty\n"
        + rows([f"20-11-2026 10:11:{12 + k * DT:06.3f}" for k in range(N)], "\t", ",").replace(
            "20-11-2026", "20.11.2026"
        ),
        {},
        {},
    ),
    "ControlDesk": (
        '"format_version","2.0"\n"descriptions"\n"path","Model Root/u","Model Root/y"\n'
        '"unit","V","mm"\n"Time Axis Type: float"\n"trace","xAxis","u","y"\n"trace_values"\n'
        + rows(SECONDS, head=","),
        {"time": "xAxis"},
        {},
    ),
    "keys with numbers, names, units": (
        "Name,Value\nRate,50\nGain,2\nOffset,0\nt,u,y\ns,V,mm\n" + rows(SECONDS),
        {},
        {"u": "V", "y": "mm"},
    ),
}


@pytest.mark.parametrize("kind", LOGGED)
def test_a_table_is_found_where_its_numbers_begin(kind: str) -> None:
    text, named, units = LOGGED[kind]
    with pytest.warns(errors.DataWarning, match="above the header") as caught:
        record = read_record(text.encode(), **ASKED, **named)
    assert len(caught) == 1
    check_good(record)
    assert {name: unit for name, unit in record.units.items() if name != "t"} == units


def test_channels_and_records_agree_on_a_log(tmp_path, listed) -> None:
    path = tmp_path / "log.lvm"
    path.write_text(labview(".", "\t"))
    found = listed(path)
    roles = {one["name"]: one["role"] for one in found["channels"]}
    assert roles == {"X_Value": "time", "u": "input", "y": "output", "Comment": "unused"}
    assert found["clocks"][0]["step"] == pytest.approx(DT)


def test_two_tables_below_each_other_are_not_cut_to_the_second() -> None:
    text = PLAIN + "\nt,u,y\n" + rows(SECONDS) * 3
    with pytest.raises(errors.TextInColumnError, match="'t' in column 't', line 15"):
        read_record(text.encode(), **ASKED)


# ------------------------------------------------------------------- text below and among the rows
BELOW = {
    "END": "line 14 .'END'.",
    "END,,": "line 14 .'END,,'.",
    "\nmeasured by XY, hall 3\nEND": "lines 15 to 16",
    "Samples: 600": "line 14",
}


@pytest.mark.parametrize("below", BELOW)
def test_text_below_the_last_row_is_left_out_and_told(below: str) -> None:
    with pytest.warns(errors.DataWarning, match=f"below the last row.*{BELOW[below]}") as caught:
        check_good(read_record((PLAIN + below + "\n").encode(), **ASKED))
    assert len(caught) == 1
    assert caught[0].filename == __file__


@pytest.mark.parametrize(
    ("among", "error"),
    [("t,u,y", errors.TextInColumnError), ("pause", errors.RaggedRowError)],
)
def test_text_among_the_rows_is_refused_and_channels_reads_on(
    tmp_path, listed, among, error
) -> None:
    lines = PLAIN.splitlines()
    path = tmp_path / "run.csv"
    path.write_text("\n".join([*lines[:6], among, *lines[6:]]))
    with pytest.raises(error, match=r"line 7 of 'run\.csv'"):
        read_record(path, **ASKED)
    found = listed(path)
    assert [one["samples"] for one in found["channels"]] == [N, N, N]
    assert found["clocks"][0]["step"] == pytest.approx(DT)
    assert len(found["problems"]) == 1
    assert "line 7 of 'run.csv'" in found["problems"][0]


def test_a_last_row_that_is_cut_off_is_no_text(tmp_path, listed) -> None:
    path = tmp_path / "run.csv"
    path.write_text(PLAIN + "0.6,1.0")
    with pytest.raises(errors.RaggedRowError, match="line 14"):
        read_record(path, **ASKED)
    assert "line 14" in listed(path)["problems"][0]


def test_many_lines_of_text_below_the_rows_are_refused() -> None:
    with pytest.raises(errors.TextInColumnError, match="line 14"):
        read_record((PLAIN + "a,b,c\n" * 100).encode(), **ASKED)


# ---------------------------------------------------------------------------------- words of errors
@pytest.mark.parametrize("word", ["#DIV/0!", "#N/A", "NaN", "Bad", "---", "1.#QNAN", "I/O Timeout"])
def test_the_word_of_an_error_is_a_missing_sample(word: str) -> None:
    y = [*Y[:3], word, *Y[4:]]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        record = read_record(("t,u,y\n" + rows(SECONDS, y=y)).encode(), **ASKED)
    assert np.flatnonzero(np.isnan(record.y[:, 0])).tolist() == [3]
    told = [str(one.message) for one in caught]
    assert told == ([] if word in ("#N/A", "NaN") else [told[0]])
    assert all(word in text and "missing samples" in text for text in told)


def test_the_word_of_an_error_in_the_first_column_is_no_comment() -> None:
    with pytest.warns(errors.DataWarning, match="a cell"):
        record = read_record(b"y,u\n1,2\n#DIV/0!,3\n5,4\n", **ASKED, dt=1.0)
    np.testing.assert_array_equal(record.y[:, 0], [1.0, np.nan, 5.0])


def test_another_word_is_refused_with_its_line_by_channels_too(tmp_path, listed) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,state,u,y\n0,on,1,2\n1,on,1,3\n2,off,1,stuck\n")
    with pytest.raises(errors.TextInColumnError, match="'stuck' in column 'y', line 4"):
        read_record(path, **ASKED)
    found = listed(path)
    assert len(found["problems"]) == 1
    assert "'stuck' in column 'y', line 4" in found["problems"][0]


# ------------------------------------------------------------------------------------------- time
def test_a_temperature_is_no_time() -> None:
    stamps = [f"{k * DT / 60:.8f}" for k in range(N)]
    text = "Elapsed (min),u (%),T (°C)\n" + rows(stamps)
    check_good(read_record(text.encode(), inputs=["u"], outputs=["T"]))
    with pytest.raises(errors.SamplingError, match="neither a time column"):
        read_record("T (°C),u\n20,0\n21,1\n".encode(), inputs=["u"], outputs=["T"])


@pytest.mark.parametrize("first", [46000.4, 739000.4])
@pytest.mark.parametrize("dt", [0.05, 1.0, 60.0])
def test_days_of_workbooks_are_known_by_their_step(first: float, dt: float) -> None:
    stamps = [f"{first + k * dt / 86400:.12f}" for k in range(N)]
    text = "Time,u,y\n" + rows(stamps)
    with pytest.warns(errors.DataWarning, match="taken for days as workbooks count them"):
        record = read_record(text.encode(), **ASKED)
    assert record.dt == pytest.approx(dt, rel=1e-4)
    assert record.t[0] == 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stated = read_record(text.encode(), **ASKED, units={"Time": "s"})
    assert stated.dt == pytest.approx(dt / 86400, rel=1e-4)


@pytest.mark.parametrize("rate", [25, 60, 100, 128, 1000, 10_000])
def test_seconds_of_the_day_are_no_days(rate: int) -> None:
    stamps = [f"{46000.4 + k / rate:.9f}" for k in range(N)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = read_record(("Time,u,y\n" + rows(stamps)).encode(), **ASKED)
    assert record.dt == pytest.approx(1.0 / rate, rel=1e-4)


def test_what_may_be_days_is_told_with_the_remedy() -> None:
    stamps = [f"{46000.4 + (k + 0.1 * np.sin(k)) / 86400:.5f}" for k in range(N)]
    text = ("Time,u,y\n" + rows(stamps)).encode()
    with pytest.warns(errors.DataWarning, match="state the unit d of 'Time'"):
        read_record(text, **ASKED)
    record = read_record(text, **ASKED, units={"Time": "d"})
    assert record.duration == pytest.approx(N - 1, rel=0.1)


def test_a_column_of_days_without_a_row_is_refused_as_any_other() -> None:
    for units in (None, {"Time": "d"}):
        with pytest.raises(errors.EmptyFileError):
            read_record(b"Time,u,y\n", **ASKED, units=units)
    one = "Time,u,y\n46000.1,1,2\n"
    with pytest.raises(errors.TooFewSamplesError):
        read_record(one.encode(), **ASKED, units={"Time": "d"})


def clock(seconds: float) -> str:
    return f"{int(seconds // 3600) % 24:02}:{int(seconds // 60) % 60:02}:{seconds % 60:06.3f}"


def test_times_of_day_go_on_over_midnight() -> None:
    stamps = [clock(86399.8 + k * DT) for k in range(N)]
    check_good(read_record(("Time,u,y\n" + rows(stamps)).encode(), **ASKED))


def test_a_gap_over_midnight_is_none_that_a_time_of_day_tells() -> None:
    stamps = [clock((86000.0 if k < 6 else 7200.0) + k * DT) for k in range(N)]
    with pytest.raises(errors.TimeNotIncreasingError):
        read_record(("Time,u,y\n" + rows(stamps)).encode(), **ASKED)


DATES = {
    "month first": [f"11/20/2026 11:59:{59 + k * DT:06.3f} AM" for k in range(N)],
    "day first": [f"20/11/2026 11:59:{40 + k * DT:06.3f}" for k in range(N)],
    "over noon": [
        f"11/20/2026 {'11:59' if k < 6 else '12:00'}:{(59.7 + k * DT) % 60:06.3f} "
        f"{'AM' if k < 6 else 'PM'}"
        for k in range(N)
    ],
    "either, on one day": [f"1/2/2026 0:00:{k * DT:06.3f}" for k in range(N)],
}


@pytest.mark.parametrize("kind", DATES)
def test_dates_with_the_day_in_the_middle(kind: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_good(read_record(("Time,u,y\n" + rows(DATES[kind])).encode(), **ASKED))


@pytest.mark.parametrize(("dates", "first"), [(("1/2", "1/3"), "month"), (("2/1", "3/1"), "day")])
def test_which_order_was_taken_is_told_where_both_are_possible(dates, first: str) -> None:
    stamps = [f"{dates[k > 5]}/2026 {clock(86399.7 + k * DT)}" for k in range(N)]
    with pytest.warns(errors.DataWarning, match=f"read with the {first} first") as caught:
        check_good(read_record(("Time,u,y\n" + rows(stamps)).encode(), **ASKED))
    assert len(caught) == 1


def test_orders_that_contradict_each_other_are_refused() -> None:
    stamps = [f"{'13/1' if k < 6 else '1/13'}/2026 10:00:{k * DT:06.3f}" for k in range(N)]
    with pytest.raises(errors.TextInColumnError, match="line 8"):
        read_record(("Time,u,y\n" + rows(stamps)).encode(), **ASKED)


@pytest.mark.parametrize("other", ["22.11.2026 10:00:{}", "2026/11/22 10:00:{}"])
def test_two_ways_to_write_dates_in_one_column_are_refused(tmp_path, listed, other: str) -> None:
    ways = ["2026-11-22T10:00:{}"] * 6 + [other] * 6
    stamps = [way.format(f"{k * DT:06.3f}") for k, way in enumerate(ways)]
    path = tmp_path / "run.csv"
    path.write_text("Time,u,y\n" + rows(stamps))
    with pytest.raises(errors.TextInColumnError, match=r"line 8.*written like those above"):
        read_record(path, **ASKED)
    assert "line 8" in listed(path)["problems"][0]


@pytest.mark.parametrize("time", ["t", "Time", "t_ms"])
def test_a_struct_of_matlab_has_its_time_in_a_field(tmp_path, time: str) -> None:
    stamps = DT * np.arange(N) * (1e3 if time == "t_ms" else 1.0)
    path = tmp_path / "run.mat"
    io.savemat(path, {"data": {time: stamps, "u": U, "y": Y, "T": Y, "info": "text", "gain": 2.0}})
    source = open_file(path)
    clocks = {one.header: one.clock for one in source.channels}
    assert clocks == dict.fromkeys((f"data.{name}" for name in (time, "u", "y", "T")), "data")
    np.testing.assert_allclose(source.instants("data"), DT * np.arange(N))
    check_good(record_from(source, Wanted(["data.u"], ["data.y"]), "run"))


def test_fields_of_another_length_have_not_the_time_beside_them(tmp_path) -> None:
    path = tmp_path / "run.mat"
    io.savemat(path, {"data": {"t": DT * np.arange(N), "u": U, "gains": [1.0, 2.0]}})
    clocks = {one.header: one.clock for one in open_file(path).channels}
    assert clocks == {"data.t": "data", "data.u": "data", "data.gains": ""}
