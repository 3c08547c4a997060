"""Lines that arrive in pieces: whole ones only, the same numbers however they are cut, no flood."""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
import time
import tracemalloc
from contextlib import closing
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tridentify import errors
from tridentify.record.formats.streams import datagrams
from tridentify.record.formats.streams.datagrams import UdpSource, loopback_address
from tridentify.record.formats.streams.header import Asked, find_columns
from tridentify.record.formats.streams.lines import LONGEST_LINE, LineCutter, WholeLines
from tridentify.record.formats.streams.read_rows import BadLine
from tridentify.record.formats.streams.rows import RowReader
from tridentify.record.formats.streams.sources import FileSource, PipeSource, source_of_file
from tridentify.record.formats.streams.timeline import SET_BACK, Timeline, nominal_step

PLAIN = Asked(("u",), ("y",))
UNIFORM = Asked(("u",), ("y",), uniform=True)


def read(data: bytes, asked: Asked = PLAIN, cuts: tuple[int, ...] = ()):
    """Rows, their lines and the problems of a whole stream that comes in pieces."""
    cutter, reader = LineCutter(), RowReader(asked)
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    found = []
    for begin, end in pairwise(edges):
        found += [reader.read(lines) for lines in cutter.cut(data[begin:end])]
    found += [reader.read(lines) for lines in cutter.rest()]
    width = len(asked.inputs) + len(asked.outputs) + (not asked.uniform)
    values = np.concatenate([np.zeros((0, width)), *(rows.values for rows in found)])
    numbers = [number for rows in found for number in rows.lines.tolist()]
    problems = [problem for rows in found for problem in rows.problems]
    stops = [stop for rows in found for stop in rows.stops.tolist()]
    return values, numbers, problems, stops


# ---------------------------------------------------------------------------------------- lines
@given(st.binary(max_size=300), st.lists(st.integers(0, 300), max_size=8))
@example(b"\n\n", [1])
def test_lines_do_not_depend_on_how_the_bytes_were_cut(data, cuts):
    cutter = LineCutter()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    found = [lines for begin, end in pairwise(edges) for lines in cutter.cut(data[begin:end])]
    whole = data[: data.rfind(b"\n") + 1]
    assert b"".join(lines.text for lines in found) == whole
    assert cutter.held == len(data) - len(whole)
    position = 0
    for lines in found:
        assert (lines.start, lines.stop) == (position, position + len(lines.text))
        position = lines.stop


@pytest.mark.parametrize("size", [7, 1000, 1 << 20])
def test_a_line_that_is_too_long_is_dropped_and_counted(size):
    long = b"9" * (LONGEST_LINE + 1) + b"\n"
    data = b"a\n" + long + b"b\nc\n" + long + long + b"d\n"
    cutter = LineCutter()
    found = [x for k in range(0, len(data), size) for x in cutter.cut(data[k : k + size])]
    assert b"".join(lines.text for lines in found) == b"a\nb\nc\nd\n"
    assert [lines.stop - lines.start for lines in found if lines.too_long] == [len(long)] * 3
    assert found[-1].stop == len(data)


def test_a_line_without_an_end_does_not_fill_the_memory():
    cutter, piece = LineCutter(), b"1" * (1 << 20)
    tracemalloc.start()
    for _ in range(200):
        assert list(cutter.cut(piece)) == []
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 20
    (lost,) = cutter.cut(b"\n")
    assert lost.too_long
    assert lost.stop == 200 * len(piece) + 1


# ----------------------------------------------------------------------------------------- rows
@pytest.mark.parametrize("n", [3, 600])
@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", ","), ("|", ".")]
)
def test_numbers_come_back_as_they_are(n, separator, decimal):
    truth = np.random.default_rng(1).standard_normal((n, 3)) * 10.0 ** np.arange(-8, 1, 4)
    truth[:, 0] = np.arange(n) / 3
    body = "".join(separator.join(map(repr, row)) + "\r\n" for row in truth.tolist())
    header = separator.join(("t", "u", "y")) + "\r\n"
    values, numbers, problems, _ = read(
        (header + body.replace(".", decimal)).encode(), Asked(("u",), ("y",), decimal=decimal)
    )
    np.testing.assert_array_equal(values, truth)
    assert numbers == list(range(2, n + 2))
    assert not problems


def test_json_gives_what_csv_gives():
    truth = np.random.default_rng(2).standard_normal((50, 3))
    truth[7, 2] = np.nan
    lines = [
        json.dumps({"y": y if y == y else None, "mode": "x", "t": t, "u": u})
        for t, u, y in truth.tolist()
    ]
    values, _, problems, _ = read("\n".join(lines).encode())
    np.testing.assert_array_equal(values, truth)
    assert not problems


BAD = {
    b"1,2": "found 2 cells; expected 3",
    b"1,2,3,4": "found 4 cells; expected 3",
    b"1,x,3": "found 'x' in column 'u'; expected a number",
    b"1,2,1e999": "found inf in column 'y'; expected a finite number",
    b"1,2,-inf": "found -inf in column 'y'",
    b",2,3": "found no time in column 't'",
    b"nan,2,3": "found no time in column 't'",
    b"1,2,1_0": "found '1_0' in column 'y'",
    b"1,2,0x1p3": "found '0x1p3' in column 'y'",
    b"1,2,\xff": "found the byte 0xff, which is no UTF-8",
    b"1,2,\x00": "in column 'y'; expected a number",
    b'1,2,"3': "",
    b"1;2;3": "found 1 cells; expected 3",
    b"1,2,3;5": "found '3;5' in column 'y'",
}
GOOD = {
    b"1,2,": [1, 2, np.nan],
    b"1,,3": [1, np.nan, 3],
    b"1,NULL,n/a": [1, np.nan, np.nan],
    b"1,2,NaN": [1, 2, np.nan],
    b" 1 ,\t2, +3.e0 ": [1, 2, 3],
    b"1,2,3,": [1, 2, 3],
    b"1,2,3\r": [1, 2, 3],
    b'"1","2","3"': [1, 2, 3],
}


@pytest.mark.parametrize("bad", BAD, ids=repr)
@pytest.mark.parametrize("n", [1, 700])
def test_a_malformed_line_is_named_and_the_others_stay(bad, n):
    lines = [b"t,u,y", *(b"%d,2,3" % k for k in range(n)), bad, b"9000,5,6", b""]
    values, numbers, problems, _ = read(b"\n".join(lines))
    assert values[-1].tolist() == [9000, 5, 6]
    if BAD[bad]:
        (problem,) = problems
        assert problem.line == n + 2
        assert BAD[bad] in problem.text
        assert len(values) == n + 1
    assert numbers[-1] == n + 3


@pytest.mark.parametrize("good", GOOD, ids=repr)
@pytest.mark.parametrize("n", [1, 700])
def test_an_unusual_line_is_read(good, n):
    lines = [b"t,u,y", *(b"%d,2,3" % k for k in range(n)), good, b"9000,5,6", b""]
    values, _, problems, _ = read(b"\n".join(lines))
    assert not problems
    np.testing.assert_array_equal(values[-2], GOOD[good])


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b'{"t":1,"u":2', "found broken JSON"),
        (b'{"t":1,"u":2,"y":"3"}', "found '3' in column 'y'; expected a number"),
        (b'{"t":1,"u":2,"y":true}', "found 'True' in column 'y'"),
        (b'{"t":1,"u":2,"y":[3]}', "found '[3]' in column 'y'"),
        (b'{"t":1,"u":2}', "found no 'y' in the object"),
        (b'{"t":null,"u":2,"y":3}', "found no time"),
        (b'{"t":1,"u":2,"y":1' + b"0" * 400 + b"}", "found inf in column 'y'"),
        (b'{"t":1,"u":2,"y":1' + b"0" * 5000 + b"}", "found no usable JSON"),
        (b'{"t":1,"u":2,"y":Infinity}', "found inf in column 'y'"),
        (b"[" * 60000, "JSON"),
        (b"[1,2,3]", "found [1, 2, 3]; expected a JSON object"),
        (b"1,2,3", "broken JSON"),
        (b'{"t":1,"u":2,"y":"\xff"}', "found the byte 0xff"),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_malformed_json_is_named_and_the_others_stay(line, says):
    sound = b'{"t":0,"u":1,"y":2}'
    values, numbers, problems, _ = read(b"\n".join([sound, line, b"", sound]))
    assert numbers == [1, 4]
    assert len(values) == 2
    (problem,) = problems
    assert problem.line == 2
    assert says in problem.text
    assert "\n" not in problem.text


def test_json_of_another_kind_at_the_beginning_is_passed_over():
    data = b'{"status":"boot"}\n{"t":0,"u":1,"y":2}\n'
    values, _, problems, _ = read(data)
    assert values.tolist() == [[0, 1, 2]]
    assert problems[0].line == 1


def test_with_a_known_step_a_malformed_line_takes_its_time():
    values, numbers, problems, _ = read(b"u,y\n1,2\nx,2\n# remark\n\n3,4\n", UNIFORM)
    np.testing.assert_array_equal(values, [[1, 2], [np.nan, np.nan], [3, 4]])
    assert numbers == [2, 3, 6]
    assert problems == [BadLine(3, "found 'x' in column 'u'; expected a number")]


CELL = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.integers(-(10**9), 10**9).map(str),
    st.text("0123456789.+-eE_nainf \t", max_size=6),
    st.sampled_from(["", "nan", "NULL", "null", "inf", "1e400", "é", "#", "%", '"', "\0", "1,2"]),
)
LINE = st.one_of(
    st.lists(CELL, min_size=3, max_size=3).map(",".join),
    st.lists(CELL, max_size=5).map(",".join),
    st.sampled_from(["t,u,y", "y,u,t", "# t,u,y", "", "{}"]),
).map(lambda text: text.replace("\n", "").encode())


@given(
    st.lists(LINE | st.binary(max_size=12).map(lambda b: b.replace(b"\n", b"")), max_size=40),
    st.lists(st.integers(0, 2000), max_size=5),
    st.booleans(),
)
def test_the_quick_way_and_the_careful_one_give_the_same(lines, cuts, uniform):
    asked = UNIFORM if uniform else PLAIN
    data = b"t,u,y\n0,1,2\n" + b"".join(line + b"\n" for line in lines)
    values, _, problems, _ = read(data, asked, tuple(cuts))
    reader = RowReader(asked)
    expected, said = [], []
    for line in data.split(b"\n")[:-1]:
        rows = reader.read(WholeLines(line + b"\n", 0, 0))
        expected.append(rows.values)
        said += rows.problems
    np.testing.assert_array_equal(values, np.concatenate(expected))
    assert problems == said
    assert np.isfinite(values[:, 0]).all() or uniform
    assert not np.isinf(values).any()


VALUE = st.one_of(
    st.floats(),
    st.integers(),
    st.none(),
    st.booleans(),
    st.text(max_size=3),
    st.just(10**400),
    st.lists(st.integers(), max_size=2),
)
OBJECT = st.one_of(
    st.fixed_dictionaries({"t": VALUE, "u": VALUE, "y": VALUE}).map(json.dumps),
    st.dictionaries(st.sampled_from("tuyz"), VALUE, max_size=4).map(json.dumps),
    st.sampled_from(['{"t":1,"u":2', '"y":3}', "", " ", '{"t":1,"u":1,"y":1} x', "[]", "1\r"]),
).map(lambda text: text.encode())


@given(st.lists(OBJECT, max_size=40), st.lists(st.integers(0, 2000), max_size=5))
def test_json_is_read_alike_in_blocks_and_line_by_line(lines, cuts):
    data = b"".join(line + b"\n" for line in [b'{"t":0,"u":1,"y":2}', *lines])
    values, _, problems, _ = read(data, PLAIN, tuple(cuts))
    reader = RowReader(PLAIN)
    found = [reader.read(WholeLines(line + b"\n", 0, 0)) for line in data.split(b"\n")[:-1]]
    np.testing.assert_array_equal(values, np.concatenate([rows.values for rows in found]))
    assert problems == [problem for rows in found for problem in rows.problems]
    assert np.isfinite(values[:, 0]).all()


@given(st.lists(st.text("0123456789.+-eEnaif ", min_size=1, max_size=7), min_size=1, max_size=6))
def test_polars_reads_no_more_than_python_does(cells):
    cells = [cell for cell in cells if cell.strip()] or ["1"]
    rows = [b"%d,2,3" % k for k in range(600)]
    rows[300:300] = [b"1,2," + cell.encode() for cell in cells]
    values, _, problems, _ = read(b"t,u,y\n" + b"\n".join(rows) + b"\n")
    expected = []
    for cell in cells:
        try:
            number = float("nan" if cell.strip().lower() in ("na", "-nan", "-", "--") else cell)
        except ValueError:
            continue
        if not np.isinf(number):
            expected.append(number)
    np.testing.assert_array_equal(values[300 : 300 + len(expected), 2], expected)
    assert len(values) == 600 + len(expected)
    assert len(problems) == len(cells) - len(expected)


# --------------------------------------------------------------------------------------- header
def test_comments_units_and_a_byte_order_mark_are_understood():
    data = "\ufeff# a logger\nsep=;\nt;u;y\nms;deg;m\n20;1;2\n".encode()
    reader = RowReader(PLAIN)
    rows = reader.read(WholeLines(data, 0, len(data)))
    assert rows.values.tolist() == [[0.02, 1.0, 2.0]]
    assert reader.units == {"u": "deg", "y": "m"}
    assert reader.clock == "t"


def test_a_header_in_a_comment_counts():
    values, numbers, _, _ = read(b"# t,u,y\n1,2,3\n")
    assert values.tolist() == [[1, 2, 3]]
    assert numbers == [2]


def test_columns_may_be_named_with_and_without_a_header():
    asked = Asked(("u",), ("y",), columns=("y", "t", "u"))
    for head in (b"", b"a,b,c\n"):
        values, _, problems, _ = read(head + b"3,1,2\n", asked)
        assert values.tolist() == [[1, 2, 3]]
        assert not problems


def test_a_header_that_comes_again_is_followed():
    data = b"t [ms],u,y\n1000,2,3\nt [ms],u,y\n2000,2,3\ny,extra,u,t [ms]\n3,0,2,3000\n"
    values, numbers, problems, _ = read(data)
    assert values.tolist() == [[1, 2, 3], [2, 2, 3], [3, 2, 3]]
    assert numbers == [2, 4, 6]
    assert not problems


def test_what_the_header_said_is_taken_up_again_at_any_line():
    data = b"t,u,y\n1,2,3\ny,u,t\n3,2,2\n"
    reader = RowReader(PLAIN)
    reader.read(WholeLines(data, 0, len(data)))
    for line, rest in ((2, b"2,8,9\n"), (3, b"9,8,2\n"), (4, b"9,8,2\n")):
        again = RowReader(PLAIN)
        again.go_on_from(json.loads(json.dumps(reader.to_dict(line))))
        rows = again.read(WholeLines(rest, 0, 6))
        assert rows.values.tolist() == [[2, 8, 9]]
        assert rows.lines.tolist() == [line + 1]


@pytest.mark.parametrize(
    ("data", "asked", "error"),
    [
        (b"1,2,3\n4,5,6\n", PLAIN, errors.MissingHeaderError),
        (b"t,u,q\n1,2,3\n", PLAIN, errors.MissingColumnError),
        (b"k,u,y\n1,2,3\n", PLAIN, errors.SamplingError),
        (b"t,time,u,y\n1,2,3,4\n", PLAIN, errors.SamplingError),
        (b"t,u,u\n1,2,3\n", PLAIN, errors.DuplicateColumnError),
        (b"t [frames],u,y\n1,2,3\n", PLAIN, errors.UnitError),
        (b"t,u\n1,2\n", Asked(("u",), ("u",)), errors.ChannelNameError),
        ("t,u,y\n".encode("utf-16"), PLAIN, errors.UnreadableFileError),
        (b"\x89PNG\r\n\x00\x00\n", PLAIN, errors.UnreadableFileError),
    ],
)
def test_a_beginning_that_makes_no_sense_is_refused_in_one_line(data, asked, error):
    with pytest.raises(error) as caught:
        read(data, asked)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("found")
    assert "expected" in message


def test_units_that_are_given_come_first():
    asked = Asked(("u",), ("y",), units=(("y", "rad"), ("t", "ms")))
    found = find_columns(["t [s]", "u [deg]", "y [deg]"], [], asked)
    assert dict(found.units) == {"u": "deg", "y": "rad"}
    assert found.scale == 1e-3


# ----------------------------------------------------------------------------------------- time
def test_rounded_stamps_are_on_the_raster():
    stamps = np.round(1.7e9 + 0.001 * np.arange(5000), 6)
    line = Timeline(nominal_step(stamps[:32]))
    interval, elapsed, remarks = line.intervals(stamps)
    assert set(interval.tolist()) == {line.dt}
    assert interval.sum() == pytest.approx(5.0, rel=1e-5)
    assert elapsed[-1] == pytest.approx(4.999, abs=1e-5)
    assert not remarks


@given(
    st.lists(st.sampled_from([0.1, 0.1, 0.1, 0.1000001, 0.13, 0.3, 0.0, -0.1, -3.0]), max_size=60),
    st.lists(st.integers(0, 60), max_size=4),
)
def test_intervals_do_not_depend_on_how_the_stamps_came(steps, cuts):
    stamps = 5.0 + np.cumsum([0.0, *steps])
    whole, pieces = Timeline(0.1), Timeline(0.1)
    expected = whole.intervals(stamps)
    edges = [0, *sorted(min(cut, len(stamps)) for cut in cuts), len(stamps)]
    found = []
    for begin, end in pairwise(edges):
        found.append(pieces.intervals(stamps[begin:end]))
        # through a checkpoint
        pieces = Timeline.from_dict(json.loads(json.dumps(pieces.to_dict())))
    for k in (0, 1):
        np.testing.assert_array_equal(np.concatenate([part[k] for part in found]), expected[k])
    taken = np.isfinite(expected[0])
    assert (expected[0][taken] > 0).all()
    # no time is lost: the intervals add up to what the clock says
    assert np.nansum(expected[0][1:]) == pytest.approx(expected[1][-1], abs=2e-4 + 1e-9)


def test_a_nominal_step_that_is_wrong_does_not_win_over_the_stamps():
    line = Timeline(0.1)
    interval, _, _ = line.intervals(0.10005 * np.arange(1000))
    assert interval[1:].sum() == pytest.approx(0.10005 * 999, rel=1e-5)


def test_a_gap_is_taken_as_it_is_and_the_raster_goes_on():
    line = Timeline(0.1)
    interval, elapsed, _ = line.intervals(np.array([0.0, 0.1, 0.2, 0.75, 0.85, 0.95]))
    assert interval == pytest.approx([0.1, 0.1, 0.1, 0.55, 0.1, 0.1])
    assert interval[[1, 2, 4, 5]].tolist() == [0.1] * 4
    assert elapsed == pytest.approx([0.0, 0.1, 0.2, 0.75, 0.85, 0.95])


def test_where_only_whole_steps_will_do_others_are_refused_for_a_while():
    line = Timeline(0.1, whole=True)
    shifted = 1.05 + 0.1 * np.arange(30)
    interval, _, remarks = line.intervals(
        np.concatenate([[0.0, 0.1, 0.2, 0.404, 0.5, 0.55, 0.6], shifted])
    )
    steps = [1, 1, 1, 2, 1, np.nan, 1, *[np.nan] * SET_BACK]
    assert interval[: 7 + SET_BACK] / 0.1 == pytest.approx(steps, nan_ok=True)
    assert len(remarks) == SET_BACK + 1
    assert (interval[8 + SET_BACK :] == 0.1).all()


def test_time_that_stands_still_or_goes_back_is_refused():
    line = Timeline(0.1)
    interval, _, remarks = line.intervals(np.array([0.0, 0.1, 0.1, 0.05, 0.2, 1e308, -1e308]))
    assert np.isnan(interval).tolist() == [False, False, True, True, False, False, True]
    assert "found time 0.05 after 0.1; expected a later one" in remarks[3]


def test_a_clock_that_was_set_back_is_believed_after_a_while():
    stamps = np.concatenate([100 + 0.1 * np.arange(50), 0.1 * np.arange(50)])
    line = Timeline(0.1)
    interval, elapsed, remarks = line.intervals(stamps)
    assert np.isnan(interval).sum() == SET_BACK - 1
    back = 50 + SET_BACK - 1
    assert interval[back] == pytest.approx(SET_BACK * 0.1)
    assert "clock set back from" in remarks[back]
    assert elapsed[-1] == pytest.approx(0.1 * 99)
    assert (np.diff(elapsed[np.isfinite(interval)]) > 0).all()


# -------------------------------------------------------------------------------------- sources
def gather(source, until: bytes, seconds: float = 10.0) -> list[object]:
    """Pieces until these bytes came."""
    found, end = [], time.monotonic() + seconds
    for piece in source.pieces():
        assert time.monotonic() < end, "nothing came"
        if piece is not None:
            found.append(piece)
            if until in piece.data:
                break
    source.close()
    return found


def test_a_file_ends_at_its_end(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"one\ntwo")
    source = FileSource(path)
    pieces = list(source.pieces())
    assert b"".join(piece.data for piece in pieces) == b"one\ntwo"
    source.close()


def test_a_growing_file_is_followed_through_truncation_and_rotation(tmp_path):
    path, told = tmp_path / "log.csv", []
    path.write_bytes(b"one\ntw")

    def write() -> None:
        time.sleep(0.3)
        with path.open("ab") as stream:
            stream.write(b"o\n")
        time.sleep(0.4)
        path.write_bytes(b"3\n")
        time.sleep(0.4)
        path.rename(tmp_path / "log.1")
        with (tmp_path / "log.1").open("ab") as stream:
            stream.write(b"late\n")
        time.sleep(0.3)
        path.write_bytes(b"fresh\n")

    writer = threading.Thread(target=write)
    source = FileSource(path, follow=True, tell=told.append)
    writer.start()
    pieces = gather(source, b"fresh")
    writer.join()
    assert b"".join(piece.data for piece in pieces) == b"one\ntwo\n3\nlate\nfresh\n"
    fresh = [k for k, piece in enumerate(pieces) if piece.fresh]
    assert [pieces[k + 1].data for k in fresh] == [b"3\n", b"fresh\n"]
    assert [pieces[k + 1].position for k in fresh] == [0, 0]
    assert "cut to a shorter length" in told[0]
    assert "another file" in told[1]


@pytest.mark.parametrize("refill", [b"3\n" * 9, b"one\nt33\n"])
def test_a_file_that_is_cut_and_filled_again_between_two_looks_is_noticed(tmp_path, refill):
    path, told = tmp_path / "log.csv", []
    path.write_bytes(b"one\ntwo\n")
    source = FileSource(path, follow=True, tell=told.append)
    pieces = source.pieces()
    assert next(pieces).data == b"one\ntwo\n"
    # longer than it was, or as long
    path.write_bytes(refill)
    fresh, piece = next(pieces), next(pieces)
    assert (fresh.fresh, piece.data, piece.position) == (True, refill, 0)
    assert told == ["log.csv was cut and filled again; reading it from its beginning"]
    with path.open("ab") as stream:
        stream.write(b"4\n")
    assert next(pieces).data == b"4\n"
    source.close()


def test_a_file_that_was_cut_and_filled_again_meanwhile_is_resumed_from_its_beginning(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"a" * 9_000)
    with closing(FileSource(path, follow=True)) as first:
        assert next(first.pieces()).data == b"a" * 9_000
        path.write_bytes(b"b" * 9_500)
        mark = first.mark(9_000)
    with closing(FileSource(path, follow=True)) as again:
        again.seek(mark)
        assert next(again.pieces()).data == b"b" * 9_500


def test_a_file_that_is_cut_and_filled_again_is_noticed_after_going_on(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"a" * 9_000)
    with closing(FileSource(path, follow=True)) as first:
        next(first.pieces())
        mark = first.mark(9_000)
    with closing(FileSource(path, follow=True)) as again:
        again.seek(mark)
        path.write_bytes(b"b" * 9_500)
        pieces = again.pieces()
        assert next(pieces).fresh
        assert next(pieces).data == b"b" * 9_500


def test_a_file_that_is_not_there_yet_is_waited_for(tmp_path):
    path, told = tmp_path / "later.csv", []
    source = source_of_file(path, True, told.append)
    threading.Timer(0.3, path.write_bytes, [b"here\n"]).start()
    assert gather(source, b"here")[0].data == b"here\n"
    assert "waiting for" in told[0]
    with pytest.raises(errors.UnreadableFileError):
        source_of_file(tmp_path / "never.csv", False, told.append)


def test_a_place_in_a_file_is_known_again(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"a" * 10_000 + b"rest")
    with closing(FileSource(path)) as first:
        next(iter(first.pieces()))
        mark = first.mark(10_000)
    with closing(FileSource(path)) as again:
        again.seek(mark)
        assert b"".join(piece.data for piece in again.pieces()) == b"rest"
    for content, says in (
        (b"b" + b"a" * 9_999 + b"rest", "found other content"),
        (b"a" * 9_999 + b"b" + b"rest", "found other content"),
        (b"a" * 9_999, "found 9999 bytes"),
    ):
        path.write_bytes(content)
        with (
            closing(FileSource(path)) as other,
            pytest.raises(errors.UnreadableFileError, match=says),
        ):
            other.seek(mark)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_named_pipe_is_read_once(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    source = source_of_file(path, False, lambda _: None)
    assert isinstance(source, PipeSource)
    threading.Thread(target=lambda: path.write_bytes(b"through\n")).start()
    assert b"".join(piece.data for piece in source.pieces() if piece) == b"through\n"


def test_datagrams_hold_one_line_or_several():
    source = UdpSource(*loopback_address("udp://127.0.0.1:0"))
    port = int(source.name.rpartition(":")[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in (b"one", b"two\nthree\n", b"", b"last\n"):
            sender.sendto(data, ("127.0.0.1", port))
    pieces = gather(source, b"last")
    assert b"".join(piece.data for piece in pieces) == b"one\ntwo\nthree\n\nlast\n"


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells how many were dropped")
def test_datagrams_that_nobody_read_in_time_are_counted():
    source = UdpSource("127.0.0.1", 0)
    assert source.dropped == 0
    source._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 12)
    port = int(source.name.rpartition(":")[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for k in range(500):
            sender.sendto(b"%d\n" % k, ("127.0.0.1", port))
        # behind the last one that is read, so that no datagram tells it
        behind = source.dropped
        first = next(source.pieces()).data.split()
        sender.sendto(b"last\n", ("127.0.0.1", port))
        sender.sendto(b"last\n", ("127.0.0.1", port))
        pieces = gather(source, b"last")
    assert b"last" in pieces[-1].data
    assert 0 < len(first) < 500
    assert behind == 500 - len(first)
    assert source._told == behind  # told with the datagrams as well


def test_a_counter_of_dropped_datagrams_may_begin_anew(monkeypatch):
    source = UdpSource("127.0.0.1", 0)
    source._told = 0
    counted = []
    for now in (3, 3, (1 << 32) - 1, 2):
        source._count(now.to_bytes(4, sys.byteorder))
        counted.append(source._told)
    source.close()
    assert counted == [3, 3, (1 << 32) - 1, (1 << 32) + 2]
    monkeypatch.setattr(datagrams, "_RXQ_OVFL", None)
    silent = UdpSource("127.0.0.1", 0)
    assert silent.dropped is None
    port = int(silent.name.rpartition(":")[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"heard\n", ("127.0.0.1", port))
    assert gather(silent, b"heard")[-1].data == b"heard\n"


@pytest.mark.parametrize(
    "text",
    [
        "udp://0.0.0.0:9",
        "udp://192.168.1.4:9",
        "udp://example.org:9",
        "udp://127.0.0.1",
        "udp://127.0.0.1:x",
        "udp://127.0.0.1:70000",
        "udp://127.0.0.1:9/path",
        "udp://[::]:9",
        "udp:9",
        "udp://[:9",
    ],
)
def test_other_addresses_are_refused_in_one_line(text):
    with pytest.raises(errors.OptionError, match="expected udp://127") as caught:
        loopback_address(text)
    assert "\n" not in str(caught.value)


def test_a_port_that_is_taken_is_said():
    first = UdpSource("127.0.0.1", 0)
    port = int(first.name.rpartition(":")[2])
    with pytest.raises(errors.UnreadableFileError, match=f"port {port}"):
        UdpSource("127.0.0.1", port)
    first.close()
