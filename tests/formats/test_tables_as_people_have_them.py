"""Title lines, dates, marks of missing samples, workbooks, bytes: tables as people have them."""

from __future__ import annotations

import datetime
import io
import warnings
from pathlib import Path

import numpy as np
import pytest

from tridentify import Record, errors, list_channels, read_record, read_records

pytestmark = pytest.mark.unisolated

ROWS = "t,u,y\n0,1,2\n0.5,4,5\n1,7,8\n"
ASKED = {"inputs": ["u"], "outputs": ["y"]}


def check_good(record: Record) -> None:
    np.testing.assert_array_equal(record.t, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(record.u[:, 0], [1.0, 4.0, 7.0])
    np.testing.assert_array_equal(record.y[:, 0], [2.0, 5.0, 8.0])


# --------------------------------------------------------------------------------------- contents
@pytest.mark.parametrize(
    "wrap",
    [
        bytes,
        bytearray,
        memoryview,
        io.BytesIO,
        lambda content: io.StringIO(content.decode()),
        lambda content: io.BufferedReader(io.BytesIO(content)),
    ],
)
def test_bytes_and_open_files_are_read(wrap) -> None:
    record = read_record(wrap(ROWS.encode()), **ASKED)
    check_good(record)
    assert record.name == ""
    assert [c.name for c in list_channels(wrap(ROWS.encode()))] == ["t", "u", "y"]


@pytest.mark.parametrize("mode", ["r", "rb"])
def test_an_open_file_gives_its_name_and_is_read_from_where_it_stands(tmp_path, mode) -> None:
    path = tmp_path / "flight 12.csv"
    path.write_text("something else entirely\n" + ROWS)
    with path.open(mode) as stream:
        stream.readline()
        record = read_record(stream, **ASKED)
        assert not stream.closed
    check_good(record)
    assert record.name == "flight 12"


def test_a_binary_format_in_memory_is_known_by_its_content() -> None:
    stream = io.BytesIO()
    np.savez(stream, t=[0.0, 0.5, 1.0], u=[1.0, 4.0, 7.0], y=[2.0, 5.0, 8.0])
    check_good(read_record(io.BytesIO(stream.getvalue()), **ASKED))


@pytest.mark.parametrize(
    ("contents", "error", "words"),
    [
        (3, errors.SampleTypeError, r"found builtins\.int; expected a path, bytes or an open file"),
        ([b"t,u,y"], errors.SampleTypeError, "several files to read_records"),
        (b"", errors.EmptyFileError, "found nothing in 'bytes'"),
        (b"\x89PNG\r\n\x1a\n\x00", errors.UnreadableFileError, "UTF-8"),
    ],
)
def test_what_is_no_table_is_refused(contents, error, words) -> None:
    with pytest.raises(error, match=words):
        read_record(contents, **ASKED)


def test_a_closed_file_and_one_open_for_writing_are_refused(tmp_path: Path) -> None:
    closed = io.BytesIO(ROWS.encode())
    closed.close()
    with (tmp_path / "run.csv").open("w") as writing:
        for stream in (closed, writing):
            with pytest.raises(errors.UnreadableFileError, match="file open for reading"):
                read_record(stream, **ASKED)


def test_several_files_are_several_experiments(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    path.write_text(ROWS)
    found = read_records([path, ROWS.encode()], **ASKED, stop=0.5)
    assert [record.n_samples for record in found] == [2, 2]
    assert [record.name for record in found] == ["one", ""]
    for wrong in (str(path), path, []):
        with pytest.raises(errors.OptionError, match="expected a list of files"):
            read_records(wrong, **ASKED)


# ------------------------------------------------------------------------------------ title lines
TITLED = {
    "one line": "Flight 12\n" + ROWS,
    "several, blank ones among them": "Flight 12\nPilot: A. B.\n\nDate: 2026-01-02\n" + ROWS,
    "filled up by a workbook": "Flight 12,,\nPilot,Smith,\nt,u,y\n0,1,2\n0.5,4,5\n1,7,8\n",
    "pairs with numbers": "Rate,50\nPilot,Smith\n" + ROWS,
    "with units below": "Flight 12\nt,u,y\ns,deg,deg/s\n0,1,2\n0.5,4,5\n1,7,8\n",
    "other separators": "Flight 12, run 3\n" + ROWS.replace(",", ";"),
    "an unclosed quote": 'Flight "12\n' + ROWS,
}


@pytest.mark.parametrize("kind", TITLED)
def test_lines_of_title_are_passed_over_and_told(kind: str) -> None:
    with pytest.warns(errors.DataWarning, match="above the header.*Flight|Rate") as caught:
        check_good(read_record(TITLED[kind].encode(), **ASKED))
    assert len(caught) == 1
    assert "\n" not in str(caught[0].message)
    assert caught[0].filename == __file__


LOGGED = {
    "Logger v1.2; serial 123\r\nStart: 2026-01-02 10:00:00\r\n\r\nTime;Temp;Heater\r\n"
    "[s];[degC];[%]\r\n0,0;20,5;0\r\n1,0;20,6;50\r\n2,0;21,0;50\r\n": ("Time", "Temp", "Heater"),
    "LabVIEW Measurement\t\nWriter_Version\t2\nX_Value\tVoltage\tCurrent\n"
    "0.000000\t0.1\t0.2\n0.001\t0.2\t0.2\n": ("X_Value", "Voltage", "Current"),
    '"Model","DSO"\n"Rate","1000"\n"TIME","CH1","CH2"\n0,1,2\n1,2,3\n': ("TIME", "CH1", "CH2"),
}


@pytest.mark.parametrize(("text", "names"), LOGGED.items(), ids=["semicolons", "tabs", "quotes"])
def test_what_loggers_put_above_their_tables(text: str, names) -> None:
    with pytest.warns(errors.DataWarning, match="found 2 lines above the header"):
        found = list_channels(text.encode())
    assert tuple(channel.name for channel in found) == names


UNTITLED = {
    "an index without a name": ",t,u,y\n0,0,1,2\n1,0.5,4,5\n2,1,7,8\n",
    "text elsewhere": "t,mode,u,y\n0,auto,1,2\n0.5,auto,4,5\n1,man,7,8\n",
    "the first sample missing": "t,u,y,z\n0,1,2,\n0.5,4,5,\n1,7,8,3\n",
    "numbers as names": "t,u,y,1\n0,1,2,\n0.5,4,5,\n1,7,8,3\n",
    "a name in two lines": 't,u,y,"z\n[deg]"\n0,1,2,3\n0.5,4,5,3\n1,7,8,3\n',
    "two rows of text": "t,u,y,z\n0,1,2,off\n0.5,4,5,off\n1,7,8,on\n",
}


@pytest.mark.parametrize("kind", UNTITLED)
def test_nothing_is_told_of_a_table_that_begins_at_once(kind: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_good(read_record(UNTITLED[kind].encode(), **ASKED))


def test_a_ragged_table_is_told_as_such_and_no_row_is_taken_for_a_header() -> None:
    with pytest.raises(errors.RaggedRowError, match="2 cells in line 2"):
        read_record(b"t,u,y\n0,1\n0,1,err\n1,2,3\n2,3,4\n3,4,5\n", **ASKED)
    with pytest.raises(errors.RaggedRowError, match="1 cells in line 2"):
        read_record(b"t,u,y\nfault\n0\n", **ASKED)


# ---------------------------------------------------------------------------------- dates, missing
@pytest.mark.parametrize(
    "times",
    [
        ("2026-11-22T10:00:00", "2026-11-22T10:00:00.500", "2026-11-22T10:00:01"),
        ("2026-11-22 23:59:59.5", "2026-11-23 00:00:00", "2026-11-23 00:00:00,5"),
        ("2026-11-22T10:00:00Z", "2026-11-22T11:00:00.5+01:00", "2026-11-22T10:00:01Z"),
        ("10:00:00", "10:00:00.5", "10:00:01.000000"),
    ],
)
@pytest.mark.parametrize("header", ["t", "Time [ms]", "when"])
def test_a_column_of_dates_or_times_counts_from_the_first(times, header) -> None:
    cells = zip(times, (1, 4, 7), (2, 5, 8), strict=True)
    text = f"{header};u;y\n" + "".join(f"{t};{u};{y}\n" for t, u, y in cells)
    named = {"time": header} if header == "when" else {}
    record = read_record(text.encode(), **ASKED, **named)
    np.testing.assert_allclose(record.t, [0.0, 0.5, 1.0], rtol=0, atol=1e-15)
    assert record.dt == 0.5
    assert record.units["t"] == "s"


def test_nanoseconds_of_dates_are_kept() -> None:
    rows = "".join(f"2026-11-22T10:00:00.{200 * k:09d},0,{k}\n" for k in range(20))
    record = read_record(b"t,u,y\n" + rows.encode(), **ASKED)
    np.testing.assert_allclose(record.t, 2e-7 * np.arange(20), rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        ("0.5", "'0.5' in column 't', line 3"),
        ("10:00:01", "'10:00:01'"),
        ("2026-13-01", "'2026-13-01'"),
        ("01/02/2026", "all dates as 2026-11-22T"),
    ],
)
def test_times_of_two_kinds_in_one_column_are_refused(cell: str, words: str) -> None:
    text = f"t,u,y\n2026-11-22,1,2\n{cell},4,5\n"
    with pytest.raises(errors.TextInColumnError, match=words):
        read_record(text.encode(), **ASKED)


def test_a_date_that_is_missing_is_refused_with_its_line() -> None:
    with pytest.raises(errors.NotFiniteError, match="column 't', line 3"):
        read_record(b"t,u,y\n10:00:00,1,2\nNA,4,5\n10:00:01,7,8\n", **ASKED)


@pytest.mark.parametrize("missing", ["", "NA", "N/A", "n/a", "-", "--", "nan", "#N/A", " - "])
def test_marks_of_a_missing_sample(missing: str) -> None:
    record = read_record(ROWS.replace("4,5", f"4,{missing}").encode(), **ASKED)
    assert np.isnan(record.y[:, 0]).tolist() == [False, True, False]


def test_a_dash_is_still_a_unit_below_the_header() -> None:
    record = read_record(b"t,u,y\ns,-,deg\n0,1,2\n1,4,-\n", **ASKED)
    assert (dict(record.units), record.n_samples) == ({"t": "s", "y": "deg"}, 2)


# -------------------------------------------------------------------------------------- workbooks
@pytest.fixture
def book(tmp_path: Path):
    openpyxl = pytest.importorskip("openpyxl", reason="needs openpyxl, of tridentify[excel]")

    def write(*sheets: list) -> Path:
        made = openpyxl.Workbook()
        for number, rows in enumerate(sheets):
            sheet = made.active if number == 0 else made.create_sheet()
            sheet.title = f"Run {number + 1}"
            for row in rows:
                sheet.append(row)
        made.save(tmp_path / "book.xlsx")
        return tmp_path / "book.xlsx"

    return write


TABLE = [["t", "u", "y"], [0, 1, 2], [0.5, 4, 5], [1, 7, 8]]


def test_a_sheet_is_read_with_titles_units_dates_and_errors(book) -> None:
    start = datetime.datetime(2026, 11, 22, 23, 59, 59)
    times = [start + datetime.timedelta(seconds=0.5 * k) for k in range(4)]
    path = book(
        [
            ["Flight 12"],
            ["pilot", "A. B."],
            [],
            ["time", "u; (deg)", "y", "remark"],
            ["", "deg", "deg/s"],
            *zip(
                times, (1, 4, 7, 9), (2, "#DIV/0!", "NA", 8), (None, "gust", None, 3), strict=True
            ),
        ]
    )
    with pytest.warns(errors.DataWarning, match="Flight 12"):
        record = read_record(path, inputs=["u;"], outputs=["y"])
    np.testing.assert_allclose(record.t, [0.0, 0.5, 1.0, 1.5])
    np.testing.assert_array_equal(record.y[:, 0], [2.0, np.nan, np.nan, 8.0])
    assert dict(record.units) == {"t": "s", "u;": "deg", "y": "deg/s"}


def test_text_below_the_rows_of_a_sheet_is_left_out_and_told(book) -> None:
    path = book([*TABLE, [], ["measured by XY"]])
    with pytest.warns(
        errors.DataWarning, match=r"below the last row of 'book\.xlsx'.*XY"
    ) as caught:
        check_good(read_record(path, **ASKED))
    assert (len(caught), caught[0].filename) == (1, __file__)


def test_a_workbook_in_memory(book) -> None:
    check_good(read_record(io.BytesIO(book(TABLE).read_bytes()), **ASKED))


def test_sheets_with_numbers_are_told_apart(book) -> None:
    path = book(
        TABLE, [["only", "text"], ["a", "b"]], [["Time [ms]", "u", "z"], [0, 3, 4], [500, 5, 6]]
    )
    names = ["Run 1.t", "Run 1.u", "Run 1.y", "Run 3.Time [ms]", "Run 3.u", "Run 3.z"]
    assert [channel.header for channel in list_channels(path)] == names
    check_good(read_record(path, inputs=["Run 1.u"], outputs=["y"]))
    last = read_record(path, inputs=["Run 3.u"], outputs=["z"])
    assert (last.dt, last.y.ravel().tolist()) == (0.5, [4.0, 6.0])
    with pytest.raises(errors.DuplicateColumnError, match=r"Run 1\.u or Run 3\.u"):
        read_record(path, **ASKED)


@pytest.mark.parametrize(
    ("rows", "error", "words"),
    [
        ([], errors.EmptyFileError, "found nothing in 'book.xlsx'"),
        ([["t", "u", "y"]], errors.EmptyFileError, "a header and no row"),
        ([["t", "u", "y"], [0, "stuck", 1], [1, 2, 3]], errors.TextInColumnError, "'stuck'"),
        ([[1, 2, 3], [4, 5, 6]], errors.MissingHeaderError, "add a header line"),
    ],
)
@pytest.mark.fast("rows2*")
def test_sheets_that_are_no_table_are_refused(book, rows, error, words) -> None:
    with pytest.raises(error, match=words):
        read_record(book(rows), **ASKED)


@pytest.mark.parametrize("separator", [",", ";"])
def test_percent_signs_behind_all_cells_of_a_column(tmp_path, separator):
    sign = "." if separator == "," else ","
    rows = [[f"{0.1 * k:.1f}", f"{k % 3 + 0.5}%", f"{k} %"] for k in range(9)]
    lines = [separator.join(row).replace(".", sign) for row in rows]
    file = tmp_path / "valve.csv"
    file.write_text("\n".join([separator.join(["time", "valve", "level"]), *lines]))
    record = read_record(file, inputs=["valve"], outputs=["level"])
    assert record.u[:4, 0].tolist() == [0.5, 1.5, 2.5, 0.5]
    assert record.y[:3, 0].tolist() == [0.0, 1.0, 2.0]


def test_a_percent_sign_behind_one_cell_alone_is_refused(tmp_path):
    rows = "\n".join(f"{0.1 * k:.1f},{k % 3}{'%' * (k == 4)},{k}" for k in range(9))
    (tmp_path / "valve.csv").write_text(f"time,valve,level\n{rows}\n")
    with pytest.raises(errors.TextInColumnError, match="'1%' in column 'valve'"):
        read_record(tmp_path / "valve.csv", inputs=["valve"], outputs=["level"])


def test_the_only_column_of_dates_is_time_whatever_it_is_called(tmp_path):
    rows = "\n".join(f"2026-01-01 00:00:{k:02d},{k % 3},{k}" for k in range(9))
    (tmp_path / "log.csv").write_text(f"Datum,valve,level\n{rows}\n")
    assert read_record(tmp_path / "log.csv", inputs=["valve"], outputs=["level"]).dt == 1.0
