"""Parquet, Feather, NPZ and data frames: good ones read exactly, bad ones refused in one line."""

from __future__ import annotations

import datetime
import io
import os
import pickle
import sys
import zipfile
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tridentify import errors, frame_from_record, list_channels, read_record, record_from_frame
from tridentify.record.formats.apart import isolation
from tridentify.record.record import Record

pytestmark = pytest.mark.unisolated

COLUMNS = {"t": [0.0, 0.5, 1.0], "u": [1.0, 4.0, 7.0], "y [deg]": [2.0, None, 8.0]}


def write_parquet(path: Path, frame: pl.DataFrame) -> Path:
    frame.write_parquet(path)
    return path


def write_feather(path: Path, frame: pl.DataFrame) -> Path:
    frame.write_ipc(path, compression="lz4")
    return path


def write_npz(path: Path, frame: pl.DataFrame) -> Path:
    columns = {name: frame[name].fill_null(float("nan")).to_numpy() for name in frame.columns}
    np.savez_compressed(path, **columns)
    return path


WRITERS = {"run.parquet": write_parquet, "run.feather": write_feather, "run.npz": write_npz}
# Parquet and Feather are read by one library in a process of its own, which takes a while.
NAMES = ["run.parquet", pytest.param("run.feather", marks=pytest.mark.slow), "run.npz"]


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.fast("run.parquet", "run.npz")
def test_a_table_comes_back(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path / name, pl.DataFrame(COLUMNS))
    record = read_record(path, time="t", inputs=["u"], outputs=["y"], intersample="foh")
    np.testing.assert_array_equal(record.t, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(record.u[:, 0], [1.0, 4.0, 7.0])
    np.testing.assert_array_equal(record.y[:, 0], [2.0, np.nan, 8.0])
    assert (record.dt, record.name, record.intersample) == (0.5, "run", "foh")
    assert dict(record.units) == {"y": "deg"}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.fast("run.npz")
def test_the_content_decides_and_not_the_suffix(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path / name, pl.DataFrame(COLUMNS))
    renamed = path.rename(path.with_suffix(".csv"))
    record = read_record(renamed, dt=0.5, inputs=["u"], outputs=["y"])
    assert record.n_samples == 3


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.fast("run.npz")
def test_channels_are_listed_with_units_and_samples(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path / name, pl.DataFrame(COLUMNS))
    listed = [(c.name, c.unit, c.samples) for c in list_channels(path)]
    assert listed == [("t", "", 3), ("u", "", 3), ("y", "deg", 3)]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("error", "options", "words"),
    [
        (errors.MissingColumnError, {"inputs": ["v"]}, "expected one of t, u, y "),
        (errors.NotFiniteError, {"inputs": ["y"], "outputs": ["u"]}, "2 of|row 2|sample 2"),
        (
            errors.SamplingError,
            {"time": None, "inputs": ["t"]},
            "name the column of time or give dt",
        ),
    ],
)
@pytest.mark.fast("*-run.npz", "MissingColumnError-*-run.parquet")
def test_refusals(tmp_path: Path, name: str, error: type[Exception], options, words: str) -> None:
    path = WRITERS[name](tmp_path / name, pl.DataFrame(COLUMNS))
    asked = {"time": "t", "inputs": ["u"], "outputs": ["y"], **options}
    with pytest.raises(error, match=words) as caught:
        read_record(path, **asked)
    assert type(caught.value) is error
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.fast("run.npz")
def test_no_row_is_refused(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path / name, pl.DataFrame(COLUMNS).clear())
    with pytest.raises((errors.EmptyFileError, errors.TooFewSamplesError), match="expected"):
        read_record(path, time="t", inputs=["u"], outputs=["y"])


@pytest.mark.parametrize("name", ["run.parquet", "run.feather"])
@pytest.mark.fast("run.feather")
def test_text_in_a_column_that_is_needed_is_refused(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path / name, pl.DataFrame({"u": ["a", "b"], "y": [1, 2]}))
    with pytest.raises(errors.TextInColumnError, match="String in column 'u'"):
        read_record(path, dt=1.0, inputs=["u"], outputs=["y"])


def test_dates_count_from_the_first_and_lose_no_digit(tmp_path: Path) -> None:
    start = datetime.datetime(2031, 5, 1, 12, 0, 0, 1)
    times = pl.Series([start + datetime.timedelta(microseconds=200 * k) for k in range(50)])
    path = write_parquet(
        tmp_path / "dated.parquet", pl.DataFrame({"t": times, "u": range(50), "y": range(50)})
    )
    record = read_record(path, time="t", inputs=["u"], outputs=["y"])
    np.testing.assert_allclose(record.t, 2e-4 * np.arange(50), rtol=0, atol=1e-15)
    assert record.dt == pytest.approx(2e-4, rel=1e-12)


def test_columns_of_an_array_are_numbered(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    np.savez(path, t=np.arange(4), u=np.arange(4.0), y=np.arange(8.0).reshape(4, 2), g=9.81)
    assert [c.name for c in list_channels(path)] == ["t", "u", "y[0]", "y[1]"]
    record = read_record(path, time="t", inputs=["u"], outputs=["y[1]"])
    np.testing.assert_array_equal(record.y[:, 0], [1, 3, 5, 7])


@pytest.mark.parametrize(
    ("member", "words"),
    [("notes/log.txt", "ZIP archive without arrays"), ("xl/workbook.xml", "a sound Excel file")],
)
def test_another_zip_archive_is_refused(tmp_path: Path, member: str, words: str) -> None:
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive:
        archive.writestr(member, "<workbook/>")
    with pytest.raises(errors.UnreadableFileError, match=words):
        read_record(tmp_path / "run.npz", dt=1.0, inputs=["u"], outputs=["y"])


def test_arrays_of_different_length_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    np.savez(path, u=np.arange(4.0), y=np.arange(5.0))
    with pytest.raises(errors.LengthMismatchError, match="found 5 samples of 'y' and 4"):
        read_record(path, dt=1.0, inputs=["u"], outputs=["y"])


# ---------------------------------------------------------------------------------------- hostile
class Payload:
    """What creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (os.mkdir, (str(self.path),))


@pytest.mark.slow
@pytest.mark.isolated
def test_a_pickle_in_an_archive_is_never_executed(tmp_path: Path) -> None:
    mark = tmp_path / "executed"
    path = tmp_path / "run.npz"
    hostile = np.array([Payload(mark), Payload(mark)], dtype=object)
    np.savez(path, t=np.arange(2.0), u=hostile, y=np.arange(2.0))
    with pytest.raises(errors.ForeignObjectError, match="Python objects in array 'u'"):
        read_record(path, time="t", inputs=["u"], outputs=["y"])
    assert not mark.exists()
    assert [c.name for c in list_channels(path)] == ["t", "u", "y"]
    assert not mark.exists()
    # the same payload does its deed where a reader lets it
    pickle.loads(pickle.dumps(hostile[0]))
    assert mark.exists()


def test_a_pickle_under_the_name_of_an_archive_is_refused(tmp_path: Path) -> None:
    mark = tmp_path / "executed"
    for name in ("run.npz", "run.mat", "run.csv"):
        (tmp_path / name).write_bytes(pickle.dumps(Payload(mark)))
        with pytest.raises(errors.DataError):
            read_record(tmp_path / name, dt=1.0, inputs=["u"], outputs=["y"])
    assert not mark.exists()


@pytest.mark.isolated
def test_an_archive_that_unpacks_to_more_than_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bomb.npz"
    zeros = np.zeros(1_000_000)
    np.savez_compressed(path, u=zeros, y=zeros)
    assert path.stat().st_size < 30_000
    monkeypatch.setattr(isolation, "memory_limit", lambda: 10_000_000)
    with pytest.raises(errors.FileTooLargeError, match=r"at most 0\.00931 GiB"):
        read_record(path, dt=1.0, inputs=["u"], outputs=["y"])


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["parquet", "feather"])
@pytest.mark.isolated
def test_columns_that_unpack_to_more_than_memory_are_refused(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"bomb.{suffix}"
    repeated = pl.DataFrame({"u": np.zeros(1000)}).lazy()
    frame = repeated.select(pl.col("u").repeat_by(20_000).explode()).collect()
    frame = frame.with_columns(y=pl.col("u"))
    write = frame.write_parquet if suffix == "parquet" else frame.write_ipc
    write(path, compression="zstd")
    assert path.stat().st_size < 1_000_000
    with isolation.IsolatedFile(path, "tridentify.record.formats.arrow", suffix) as source:
        monkeypatch.setattr(isolation, "memory_limit", lambda: 10_000_000)
        with pytest.raises(errors.FileTooLargeError, match=r"0\.298 GiB of samples"):
            source.read([0, 1])


def test_a_header_that_lies_about_its_size_is_refused(tmp_path: Path) -> None:
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (2**50,)}
    np.lib.format.write_array_header_1_0(stream, header)
    path = tmp_path / "liar.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("u", "y"):
            archive.writestr(f"{name}.npy", stream.getvalue() + bytes(64))
    with pytest.raises(errors.FileTooLargeError):
        read_record(path, dt=1.0, inputs=["u"], outputs=["y"])


# ----------------------------------------------------------------------------------------- frames
def make_frame(backend: str, columns: dict[str, list]):
    if backend == "polars":
        return pl.DataFrame(columns)
    module = pytest.importorskip(backend, reason=f"needs {backend}: pip install {backend}")
    if backend == "pandas":
        frame = module.DataFrame(columns)
        return frame.astype({"u": "Int64"}) if "u" in columns else frame
    return module.table(columns)


BACKENDS = ("polars", "pandas", "pyarrow")


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_frame_becomes_a_record(backend: str) -> None:
    frame = make_frame(backend, {"t [ms]": [0, 20, 40], "u": [0, 1, 1], "q [deg/s]": [0, None, 2]})
    record = record_from_frame(frame, time="t", inputs=["u"], outputs=["q"], name="frame")
    np.testing.assert_array_equal(record.y[:, 0], [0.0, np.nan, 2.0])
    assert record.dt == pytest.approx(0.02)
    assert dict(record.units) == {"t": "s", "q": "deg/s"}
    assert record.name == "frame"


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_missing_input_is_refused(backend: str) -> None:
    frame = make_frame(backend, {"u": [0, None, 1], "y": [0, 1, 2]})
    with pytest.raises(errors.NotFiniteError, match="column 'u', row 1"):
        record_from_frame(frame, dt=0.1, inputs=["u"], outputs=["y"])


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("kind", ["duration", "date"])
def test_times_of_a_frame_become_seconds(backend: str, kind: str) -> None:
    steps = [datetime.timedelta(milliseconds=20 * k) for k in range(3)]
    start = datetime.datetime(2030, 1, 1, tzinfo=datetime.UTC)
    times = steps if kind == "duration" else [start + step for step in steps]
    frame = make_frame(backend, {"when": times, "u": [0, 1, 1], "y": [0, 1, 2]})
    record = record_from_frame(frame, time="when", inputs=["u"], outputs=["y"])
    np.testing.assert_allclose(record.t, [0, 0.02, 0.04], atol=1e-12)


def test_the_index_of_a_pandas_frame_is_its_time() -> None:
    pd = pytest.importorskip("pandas", reason="needs pandas: pip install pandas")
    index = pd.date_range("2030-01-01", periods=3, freq="20ms")
    frame = pd.DataFrame({"u": [0, 1, 1], "y": [0.0, 1.0, 2.0]}, index=index)
    assert record_from_frame(frame, inputs=["u"], outputs=["y"]).dt == pytest.approx(0.02)
    named = pd.DataFrame({"u": [0, 1, 1], "y": [0, 1, 2]}, index=pd.Index([0, 1, 2], name="t"))
    assert record_from_frame(named, time="t", inputs=["u"], outputs=["y"]).dt == 1.0
    with pytest.raises(errors.SamplingError, match="neither a time column"):
        record_from_frame(frame.reset_index(drop=True), inputs=["u"], outputs=["y"])


def test_repeated_columns_of_a_pandas_frame_are_refused() -> None:
    pd = pytest.importorskip("pandas", reason="needs pandas: pip install pandas")
    frame = pd.DataFrame([[0, 1, 2], [1, 1, 2]], columns=["u", "y", "y"])
    with pytest.raises(errors.DuplicateColumnError, match="expected every name once"):
        record_from_frame(frame, dt=1.0, inputs=["u"], outputs=["y"])


@pytest.mark.parametrize("thing", [{"u": [1]}, np.zeros((3, 2)), pl.LazyFrame({"u": [1]}), None])
def test_what_is_no_eager_frame_is_refused(thing: object) -> None:
    with pytest.raises(errors.SampleTypeError, match="expected an eager data frame"):
        record_from_frame(thing, dt=1.0, inputs=["u"], outputs=["y"])


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_record_goes_through_a_frame_and_back(backend: str) -> None:
    if backend != "polars":
        pytest.importorskip(backend, reason=f"needs {backend}: pip install {backend}")
    record = Record(
        [[0, 5], [1, 6], [2, 7]],
        [0.0, np.nan, 2.0],
        t=[0.0, 0.1, 0.3],
        input_names=["a", "b"],
        units={"a": "deg", "y": "m/s^2", "t": "s"},
    )
    frame = frame_from_record(record, backend)
    again = record_from_frame(frame, time="t", inputs=["a", "b"], outputs=["y"])
    for name in ("u", "y", "t"):
        np.testing.assert_array_equal(getattr(again, name), getattr(record, name))
    assert dict(again.units) == dict(record.units)


def test_an_unknown_backend_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    record = Record([0, 1], [0, 1], dt=1.0)
    with pytest.raises(errors.OptionError, match="'polars', 'pandas' or 'pyarrow'"):
        frame_from_record(record, "excel")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(errors.MissingDependencyError, match="pip install 'pyarrow'"):
        frame_from_record(record, "pyarrow")
