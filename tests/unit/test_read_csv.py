"""CSV files: good ones read exactly, bad ones refused with one clear line."""

from __future__ import annotations

import os
import string
import tempfile
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tridentify import errors
from tridentify.record.formats.read import read_record, read_records
from tridentify.record.formats.text import text_table
from tridentify.record.record import Record

GOOD = "t,u,y,z\n0,1,2,3\n0.5,4,5,6\n1,7,8,9\n"


@pytest.fixture
def write(tmp_path: Path):
    def writer(content: str | bytes, name: str = "flight.csv") -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return writer


def read(path: Path, **options: object):
    return read_record(path, **{"time": "t", "inputs": ["u"], "outputs": ["y"], **options})


def check_good(record) -> None:
    np.testing.assert_array_equal(record.t, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(record.u[:, 0], [1.0, 4.0, 7.0])
    np.testing.assert_array_equal(record.y[:, 0], [2.0, 5.0, 8.0])
    assert record.dt == 0.5


def test_a_plain_file(write) -> None:
    record = read(write(GOOD), intersample="foh")
    check_good(record)
    assert (record.name, record.intersample) == ("flight", "foh")
    assert (record.input_names, record.output_names) == (("u",), ("y",))


def dated(content: str, day: str) -> str:
    head, *rows = content.splitlines()
    return "\n".join([head, *(f"{day} 10:00:0{row}" for row in rows)])


VARIANTS = {
    "semicolons": GOOD.replace(",", ";"),
    "tabs": GOOD.replace(",", "\t"),
    "byte-order mark": b"\xef\xbb\xbf" + GOOD.encode(),
    "dos": GOOD.replace("\n", "\r\n"),
    "old mac": GOOD.replace("\n", "\r"),
    "no last newline": GOOD.rstrip(),
    "blanks around": GOOD.replace(",", " , "),
    "blank lines": "\n\n" + GOOD.replace("1,7", "\n \n1,7") + "\n\n",
    "quotes": "\n".join(
        ",".join(f'"{cell}"' for cell in line.split(",")) for line in GOOD.splitlines()
    ),
    "text elsewhere": GOOD.replace(",6", ",sensor off"),
    "quoted separator elsewhere": GOOD.replace(",6", ',"a,b\nc"'),
    "blank cells at the end": GOOD.replace("6\n", "6,,\n"),
    "unnamed columns": "t,u,y,,\n0,1,2,,\n0.5,4,5,,\n1,7,8,,\n",
    "exponents": GOOD.replace("0.5,4", "5.0e-1,+4.E0"),
    "glob characters": GOOD,
    "bars": GOOD.replace(",", "|"),
    "utf-16": GOOD.encode("utf-16"),
    "utf-16 big-endian": b"\xfe\xff" + GOOD.encode("utf-16-be"),
    "latin-1": GOOD.replace("z", "température").encode("latin-1"),
    "decimal commas": GOOD.replace(",", ";").replace("0.5", "0,5"),
    "decimal commas in quotes": GOOD.replace("0.5", '"0,5"').replace("4,", '"4,000E0",'),
    "comments above": "# made by hand\n% 3,4\n\n" + GOOD,
    "a quote in a comment": "# don't \"\n" + GOOD,
    "comments between": GOOD.replace("1,7", "# 9,9,9,9\n1,7"),
    "header in a comment": "# logger\n# " + GOOD,
    "separator line": "sep=;\n" + GOOD.replace(",", ";"),
    "aligned by blanks": "  t     u y z \n\n0.0     1 2 3\n0.5    4  5 6  \n  1     7 8 9\n",
    "blanks, units and a decimal comma": "t u y z\ns V m m\n0 1 2 3\n0,5  4 5 6\n1 7 8 9\n",
    "dates by slashes": dated(GOOD, "2026/01/31"),
    "dates by points": dated(GOOD, "31.01.2026"),
    "units below": GOOD.replace("0,1", "s,deg,[rad/s],m/s^2\n0,1", 1),
}


@pytest.mark.parametrize("kind", VARIANTS)
def test_ways_to_write_the_same_file(write, kind: str) -> None:
    name = "run[1]*.csv" if kind == "glob characters" else "run.csv"
    check_good(read(write(VARIANTS[kind], name)))


@pytest.mark.parametrize("missing", ["", "nan", "NaN", "NA", "n/a", "null", '""'])
def test_a_blank_output_is_a_missing_sample(write, missing: str) -> None:
    record = read(write(GOOD.replace("4,5,", f"4,{missing},")))
    assert np.isnan(record.y[:, 0]).tolist() == [False, True, False]


def test_several_channels_in_the_order_asked_for(write) -> None:
    record = read(write(GOOD), inputs=["z", "u"], outputs=["y"])
    np.testing.assert_array_equal(record.u[0], [3.0, 1.0])
    assert record.input_names == ("z", "u")


def test_a_single_string_is_one_column(write) -> None:
    check_good(read(write(GOOD), inputs="u", outputs="y"))


# ---------------------------------------------------------------------------------- names, units
HEADED = "t [s],elevator [rad],alpha (rad),q[rad/s]\n0,1,2,3\n0.5,4,5,6\n"


@pytest.mark.parametrize("name", ["alpha", "alpha (rad)", " alpha "])
def test_a_unit_in_the_header_may_be_named_or_not(write, name: str) -> None:
    record = read(write(HEADED), time="t [s]", inputs=["elevator"], outputs=[name, "q"])
    assert record.output_names == ("alpha", "q")
    units = {"t": "s", "elevator": "rad", "alpha": "rad", "q": "rad/s"}
    assert dict(record.units) == units


def test_a_line_of_units_is_kept_and_gives_time_its_scale(write) -> None:
    record = read(write("t;u;y;z\nms;deg;[m/s²];-\n0;1;2;3\n500;4;5;6\n"), outputs=["y", "z"])
    assert record.dt == 0.5
    assert dict(record.units) == {"t": "s", "u": "deg", "y": "m/s²"}
    headed = read(write("t [ms],u [deg],y\ns,rad,V\n0,1,2\n500,4,5\n"))
    assert (headed.dt, headed.units["u"], headed.units["y"]) == (0.5, "deg", "V")


def test_a_row_of_missing_samples_is_no_line_of_units(write) -> None:
    record = read(write("u,y,z\n1,nan,nan\n2,3,4\n"), time=None, dt=1.0)
    assert record.n_samples == 2


def test_units_given_come_before_those_of_the_header(write) -> None:
    record = read(write(HEADED), inputs=["elevator"], outputs=["q"], units={"q": "deg/s"})
    assert record.units["q"] == "deg/s"
    with pytest.raises(errors.UnitError, match="unit for 'beta'"):
        read(write(HEADED), inputs=["elevator"], outputs=["q"], units={"beta": "rad"})


def test_one_name_with_two_units_must_be_told_apart(write) -> None:
    path = write("t,u,y [rad],y [deg]\n0,1,2,3\n1,1,2,3\n")
    with pytest.raises(errors.DuplicateColumnError, match=r"y \[rad\] or y \[deg\]"):
        read(path)
    both = read(path, outputs=["y [rad]", "y [deg]"])
    assert both.output_names == ("y [rad]", "y [deg]")
    assert dict(both.units) == {"y [rad]": "rad", "y [deg]": "deg"}


def test_an_index_in_brackets_is_no_unit(write) -> None:
    record = read(write("t,u[0],u[1],y\n0,1,2,3\n1,1,2,3\n"), inputs=["u[1]"])
    assert record.input_names == ("u[1]",)
    assert not record.units


@pytest.mark.parametrize(("unit", "step"), [("ms", 1e-3), ("s", 1.0), ("min", 60.0)])
def test_time_in_other_units_becomes_seconds(write, unit: str, step: float) -> None:
    record = read(write(f"t [{unit}],u,y\n0,1,2\n1,1,2\n2,0,1\n"))
    assert record.dt == pytest.approx(step)
    assert record.units["t"] == "s"
    assert read(write("t,u,y\n0,1,2\n1,1,2\n"), units={"t": unit}).dt == pytest.approx(step)


def test_an_unknown_unit_of_time_is_refused(write) -> None:
    with pytest.raises(errors.UnitError, match="found the unit 'fortnights'"):
        read(write("t [fortnights],u,y\n0,1,2\n1,1,2\n"))


# ------------------------------------------------------------------------------------------ time
def test_without_time_column_time_begins_at_zero(write) -> None:
    with pytest.warns(errors.DataWarning, match="'t' is not used"):
        record = read(write(GOOD), time=None, dt=0.1)
    np.testing.assert_allclose(record.t, [0.0, 0.1, 0.2])


def test_a_stated_step_replaces_recorded_time_that_agrees(write) -> None:
    record = read(write("t,u,y\n10,0,1\n10.104,1,2\n10.2,1,3\n"), dt=0.1)
    assert record.dt == 0.1
    np.testing.assert_allclose(record.t, [10.0, 10.1, 10.2])


def test_jittered_time_given_as_uniform_is_refused(write) -> None:
    path = write("t,u,y\n0,0,1\n0.1,1,2\n0.21,1,3\n0.3,1,3\n")
    with pytest.raises(errors.NonUniformTimeError, match=r"step of 0\.11 s after 0\.1 s") as caught:
        read(path, dt=0.1)
    assert "5 percent" in str(caught.value)
    assert read(path).dt is None


@pytest.mark.parametrize("name", ["t", "T", "Time", "time [ms]"])
def test_a_column_called_time_is_taken_by_its_name(write, name: str) -> None:
    path = write(GOOD.replace("t,", f"{name},", 1))
    stated, found = read(path, time=name), read(path, time=None)
    np.testing.assert_array_equal(found.t, stated.t)
    assert found.duration == (1e-3 if "ms" in name else 1.0)


def test_a_stated_step_leaves_a_column_called_time_alone_and_says_so(write) -> None:
    with pytest.warns(errors.DataWarning, match=r"mean step is 0\.5 s, not 7 s"):
        assert read(write(GOOD), time=None, dt=7.0).dt == 7.0


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("clock,u,y,z", r"neither a time column \(t or time\) nor dt"),
        ("t,u,y,time", "the columns 't' and 'time'"),
    ],
)
def test_no_time_or_two_are_refused(write, header: str, words: str) -> None:
    with pytest.raises(errors.SamplingError, match=words):
        read(write(GOOD.replace("t,u,y,z", header, 1)), time=None)


def test_an_input_called_t_is_not_time_as_well(write) -> None:
    with pytest.raises(errors.SamplingError, match="neither"):
        read(write(GOOD), time=None, inputs=["t"])


def test_a_stretch_of_time(write) -> None:
    rows = "".join(f"{k / 10},{k},{k}\n" for k in range(11))
    record = read(write("t,u,y\n" + rows), start=0.3, stop=0.6)
    np.testing.assert_array_equal(record.y[:, 0], [3, 4, 5, 6])
    assert record.t[0] == pytest.approx(0.3)
    record = read(write("t,u,y\n" + rows), start=0.3, stop=0.6, dt=0.1)
    np.testing.assert_array_equal(record.y[:, 0], [3, 4, 5, 6])
    with pytest.raises(errors.EmptyRangeError, match="between 0 s and 1 s"):
        read(write("t,u,y\n" + rows), start=2.0)


def test_what_lies_outside_the_stretch_need_not_be_sound(write) -> None:
    text = "t,u,y\n0,nan,1\n1,0,1\n2,1,1\n3,,\n"
    np.testing.assert_array_equal(read(write(text), start=1, stop=2).u[:, 0], [0, 1])


# -------------------------------------------------------------------------------------- refusals
BAD = [
    (errors.EmptyFileError, "", "found nothing"),
    (errors.EmptyFileError, "\n \n\n", "found nothing"),
    (errors.EmptyFileError, b"\xef\xbb\xbf", "found nothing"),
    (errors.EmptyFileError, "t,u,y\n", "a header and no row"),
    (errors.EmptyFileError, "t,u,y\n\n\n", "a header and no row"),
    (errors.TooFewSamplesError, "t,u,y\n0,1,2\n", "found 1 row"),
    (errors.MissingHeaderError, "0,1,2\n1,1,2\n", "add a header line"),
    (errors.MissingHeaderError, "0;-1.5e3;nan\n1;1;2\n", "names of the columns"),
    (errors.DuplicateColumnError, "t,u,y,y\n0,1,2,3\n1,1,2,3\n", "column 'y' 2 times"),
    (errors.DuplicateColumnError, "t,u, y,y \n0,1,2,3\n1,1,2,3\n", "rename one"),
    (errors.MissingColumnError, "t,v,y\n0,1,2\n1,1,2\n", "no column 'u'.*expected one of t, v, y"),
    (errors.MissingColumnError, "time;u;y\n0;1;2\n1;1;2\n", "no column 't'"),
    (errors.MissingColumnError, "{}", "no column"),
    (errors.TextInColumnError, "t,u,y\n0,1,2\n1,fault,2\n", "'fault' in column 'u', line 3"),
    (errors.TextInColumnError, "t,u,y\n\n0,1,2\n\n1,2,err\n", "'err' in column 'y', line 5"),
    (errors.ThousandsSeparatorError, "t;u;y\n0;1,500;2\n1;800;3\n", "'1,500' .*groups of thou"),
    (errors.ThousandsSeparatorError, "t;u;y\n0;1.234,5;2\n1;2,5;3\n", "one decimal sign"),
    (errors.ThousandsSeparatorError, 't,u,y\n0,"1,234.5",2\n1,3,3\n', "'1,234.5' in column 'u'"),
    (errors.ThousandsSeparatorError, "t;u;y\n0;1 234;2\n1;2;3\n", "write the file without"),
    (errors.ThousandsSeparatorError, "t;u;y\n0;1,5;2\n1;2.5;3\n", "'2.5' in column 'u', line 3"),
    (errors.TextInColumnError, "t,u,y\n1/2/2026,1,2\n2/2/2026,2,3\n", "time in seconds"),
    (errors.TextInColumnError, "t,u,y\n0,1_000,2\n1,2,3\n", "'1_000'"),
    (errors.TextInColumnError, "t,u,y\n0,0x10,2\n1,2,3\n", "'0x10'"),
    (errors.RaggedRowError, "t,u,y,z\n0,1,2,3\n1,1,2\n", "3 cells in line 3.*expected 4"),
    (errors.RaggedRowError, "t,u,y\n0,1,2\n1,1", "2 cells in line 3"),
    (errors.RaggedRowError, "t,u,y\n0,1,2,3\n1,1,2,3\n", "4 cells in line 2.*expected 3"),
    (errors.RaggedRowError, "t,u,y\n0,00,1,5,2\n1,00,2,5,3\n", "cells in line 2"),
    (errors.NotFiniteError, "t,u,y\n0,1,2\n1,,2\n", "column 'u', line 3"),
    (errors.NotFiniteError, "t,u,y\n0,1,2\n1,nan,2\n", "nan .* column 'u', line 3"),
    (errors.NotFiniteError, "t,u,y\n0,1e999,2\n1,1,2\n", "inf .* column 'u', line 2"),
    (errors.NotFiniteError, "t,u,y\n0,1,2\n,1,2\n2,1,2\n", "column 't', line 3"),
    (errors.NotFiniteError, "t,u,y\n0,1,2\n1,1,inf\n", "output 'y' = inf"),
    (errors.EmptyChannelError, "t,u,y\n0,1,\n1,1,\n", "nothing but nan in output 'y'"),
    (errors.TimeNotIncreasingError, "t,u,y\n0,1,2\n0,1,2\n", "strictly increasing"),
    (errors.UnreadableFileError, b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "UTF-8"),
    (errors.UnreadableFileError, b"\x1f\x8b\x08\x00abc", "UTF-8"),
    (errors.UnreadableFileError, b"t,u,y\n0,1,2\n\x00\x00\x00\x00\n", "binary"),
    (errors.UnreadableFileError, GOOD.encode("utf-16")[:-1], "encoding"),
    (errors.TextInColumnError, b"t,u,y\n0,1,2\n1,1,\xff\n", "'ÿ' in column 'y'"),
    (errors.UnreadableFileError, b"t,u,y\n0,1,2\n1,1,\xff\x01\n", "encoding"),
    (errors.UnreadableFileError, b"t,u" + b"\xfe" * 9 + b"\x7f,y\n0,1,2\n1,1,1\n", "encoding"),
    (errors.UnreadableFileError, b'"t,u,y\n' + b"0,1,2\n" * 40_000, "damaged"),
]


@pytest.mark.parametrize(("error", "content", "words"), BAD)
def test_bad_files_are_refused(write, error: type[Exception], content, words: str) -> None:
    with pytest.raises(error, match=words) as caught:
        read(write(content))
    assert type(caught.value) is error
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


def test_a_path_that_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(errors.UnreadableFileError, match="found a directory"):
        read(tmp_path)
    with pytest.raises(errors.UnreadableFileError, match="no such file") as caught:
        read(tmp_path / "absent.csv")
    assert isinstance(caught.value, OSError)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.csv")
        with pytest.raises(errors.UnreadableFileError, match="no regular file"):
            read(tmp_path / "pipe.csv")


def test_a_file_without_permission_is_refused(write, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = write(GOOD)
    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(errors.UnreadableFileError, match="Permission denied"):
        read(path)


@pytest.mark.parametrize(
    ("error", "options", "words"),
    [
        (errors.SamplingError, {"dt": -1.0}, "positive number of seconds"),
        (errors.ChannelNameError, {"inputs": []}, "no input asked for"),
        (errors.ChannelNameError, {"outputs": []}, "no output asked for"),
        (errors.ChannelNameError, {"outputs": ["u"]}, "column 'u' asked for more than once"),
        (errors.MissingColumnError, {"outputs": [""]}, "no column ''"),
        (errors.OptionError, {"intersample": "cubic"}, "'cubic'"),
    ],
)
def test_bad_requests_are_refused(write, error: type[Exception], options, words: str) -> None:
    with pytest.raises(error, match=words) as caught:
        read(write(GOOD), **options)
    assert type(caught.value) is error


# ------------------------------------------------------------------------------------ properties
def same(content: bytes, **options: object):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "case.csv")
        path.write_bytes(content)
        return read(path, **options)


def attempt(content: bytes) -> Record | str:
    """The record, or the message of the refusal."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", errors.DataWarning)  # what may be a title is told
            return same(content)
    except errors.DataError as error:
        return str(error)


@given(st.binary(max_size=200))
def test_any_bytes_are_refused_or_read(content: bytes) -> None:
    outcome = attempt(content)
    assert outcome.n_samples >= 2 if isinstance(outcome, Record) else "\n" not in outcome


@given(
    st.text(alphabet=string.digits + '.,;\t-+eE"\r\n na\0_\ufeffé', max_size=80),
    st.sampled_from(["t,u,y\n", "t;u;y\r\n", '"t",u,y\n0,1,2\n', "t\tu\ty\n0\t1\t2\n"]),
)
def test_any_rows_below_a_header_are_refused_or_read(rows: str, header: str) -> None:
    outcome = attempt((header + rows).encode())
    assert outcome.n_samples >= 2 if isinstance(outcome, Record) else "\n" not in outcome


@given(st.integers(0, len(GOOD)), st.integers(1, 20))
def test_a_file_with_a_piece_lost_never_shifts_columns(start: int, length: int) -> None:
    content = GOOD[:start] + GOOD[start + length :]
    record = attempt(content.encode())
    if isinstance(record, str):
        return
    header = content.splitlines()[0].split(",")
    rows = [line.split(",") for line in content.splitlines()[1:] if line]
    assert all(len(row) == len(header) for row in rows)
    expected = [float(row[header.index("y")] or "nan") for row in rows]
    np.testing.assert_array_equal(record.y[:, 0], expected)


number = st.floats(-1e300, 1e300)


@given(
    st.lists(st.tuples(number, number), min_size=2, max_size=30),
    st.sampled_from([",", ";", "\t"]),
    st.booleans(),
)
def test_numbers_come_back_to_the_last_digit(rows: list, separator: str, quoted: bool) -> None:
    mark = '"' if quoted else ""
    lines = [separator.join(("t", "u", "y"))]
    lines += [
        separator.join(f"{mark}{value!r}{mark}" for value in (float(k), *row))
        for k, row in enumerate(rows)
    ]
    record = same("\n".join(lines).encode())
    np.testing.assert_array_equal(np.hstack([record.u, record.y]), rows)


# -------------------------------------------------------------------------------------- the large
def test_a_large_clean_file_is_not_read_cell_by_cell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    n = 100_000
    path = tmp_path / "large.csv"
    row = "0.12345,-1.5,2.25,text\n"
    path.write_text("u,y,z,note\n" + row * n)

    def refuse(*_: object) -> None:
        raise AssertionError("read cell by cell")

    monkeypatch.setattr(text_table, "read_exactly", refuse)
    read(path, time=None, dt=0.01)
    tracemalloc.start()
    record = read(path, time=None, dt=0.01)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert record.n_samples == n
    # u, y, t and the check of the time axis; the text of the file is not kept
    assert peak < 8 * n * 8


def test_the_public_flight_records_are_read(shared_data: Path) -> None:
    record = read_record(
        shared_data / "attas-short-period" / "data.csv",
        time="t",
        inputs=["u_elevator"],
        outputs=["y_q", "y_alpha"],
    )
    assert (record.n_samples, record.n_outputs) == (626, 2)
    assert record.dt == pytest.approx(0.04)


def test_references_have_units_and_are_refused_where_blank(tmp_path: Path) -> None:
    path = tmp_path / "loop.csv"
    path.write_text("t,u,q [deg/s],q_cmd [deg/s]\n0,0,0,0\n1,1,,2\n2,1,3,2\n")
    record = read_record(path, inputs=["u"], outputs=["q"], references=["q_cmd"])
    assert repr(record).endswith("references: q_cmd [deg/s])")
    assert record.units == {"q": "deg/s", "q_cmd": "deg/s"}
    (again,) = read_records([path], inputs=["u"], outputs=["q"], references="q_cmd")
    np.testing.assert_array_equal(again.reference, record.reference)
    with pytest.raises(errors.NotFiniteError, match=r"column 'q \[deg/s\]', line 3"):
        read_record(path, inputs=["u"], outputs=["q_cmd"], references=["q"])
