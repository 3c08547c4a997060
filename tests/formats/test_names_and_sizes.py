"""Names of files that no terminal should obey, and files that would fill the memory."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy import io

from tridentify import errors, list_channels, read_record
from tridentify.record.formats.apart import isolation
from tridentify.record.formats.matlab import matlab
from tridentify.record.formats.text import text_opening, text_rows

pytestmark = pytest.mark.unisolated

ODD_NAME = b"caf\xe9" + "\u202egnp".encode() + b"\x1b[31m\x07{c}*?"
ASKED = {"time": "t", "inputs": ["u"], "outputs": ["y"]}


def columns_read(path: Path, asked: dict[str, object] = ASKED) -> np.ndarray:
    record = read_record(path, **asked)
    return np.column_stack([record.u, record.y])


# ------------------------------------------------------------------------------------------ names
@pytest.mark.skipif(os.name == "nt", reason="file names are Unicode here")
@pytest.mark.fast("run.csv", "run.npz", "seven.mat")
def test_a_file_is_read_whatever_its_name(sample, tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/" + ODD_NAME + b".bin"))
    shutil.copy(sample.path, path)
    record = read_record(path, **sample.asked)
    np.testing.assert_array_equal(record.y[:, 0], sample.y)
    assert record.name.isprintable()
    with pytest.raises(errors.MissingColumnError) as caught:
        read_record(path, **{**sample.asked, "outputs": ["none"]})
    assert str(caught.value).isprintable()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the locale decides on names on Linux")
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_name_beyond_ascii_is_read_where_the_locale_knows_no_more(
    tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"température\u200f.{suffix}"
    frame = pl.DataFrame({"t": [0.0, 1, 2], "u": [0.0, 1, 1], "y": [0.0, 0, 1]})
    (frame.write_csv if suffix == "csv" else frame.write_parquet)(path)
    done = subprocess.run(
        [sys.executable, "-m", "tridentify", "channels", path],
        env=os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()[-3:]] == [b"t", b"u", b"y"]
    assert done.stdout.isascii()
    assert done.stderr.isascii()
    assert "\\udc" in done.stdout.decode() + done.stderr.decode()


# ---------------------------------------------------------------------------------------- headers
def write_wide(path: Path, names: list[str], rows: int = 3) -> Path:
    numbers = "\n".join(",".join(str(k + j % 7) for j in range(len(names))) for k in range(rows))
    path.write_text(",".join(names) + "\n" + numbers + "\n")
    return path


@pytest.mark.slow
def test_many_columns_take_time_in_proportion(tmp_path: Path) -> None:
    names = ["t", "u", "y", *(f"channel number {k} of the rig" for k in range(79_997))]
    path = write_wide(tmp_path / "wide.csv", names)
    assert path.stat().st_size > 2 << 20
    begun = time.process_time()
    assert [channel.name for channel in list_channels(path)] == names
    np.testing.assert_array_equal(columns_read(path), [[1, 2], [2, 3], [3, 4]])
    assert time.process_time() - begun < 20.0  # 66 s when the names were compared in pairs


@pytest.mark.slow
def test_a_name_that_comes_again_beyond_the_first_mib_is_found(tmp_path: Path) -> None:
    names = ["t", "u", "y", *(f"channel number {k} of the rig" for k in range(60_000)), "u", "u"]
    path = write_wide(tmp_path / "wide.csv", names, 1)
    with pytest.raises(errors.DuplicateColumnError, match="found the column 'u' 3 times"):
        list_channels(path)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("t,u,y" + " " * 2000 + "\n0,1,2\n", "more than 1,000 characters at line 1"),
        ("#" + " " * 2000 + "\nt,u,y\n0,1,2\n", "more than 1,000 characters at line 1"),
        ("t,u,y\n0,1,2\n1,2," + " " * 2000, "more than 1,000 characters at line 3"),
        ("t,u,y\n0,1,2\n" + '1,2,"3\n",' * 500, "more than 1,000 characters at line 1"),
        ("t,u,y," + ",".join(f"c{k}" for k in range(60)) + "\n", "more than 40 columns"),
    ],
)
def test_a_row_without_an_end_is_refused_before_it_is_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str, says: str
) -> None:
    monkeypatch.setattr(text_opening, "LONGEST_ROW", 1000)
    monkeypatch.setattr(text_rows, "MOST_TEXT_COLUMNS", 40)
    path = tmp_path / "endless.csv"
    path.write_text(content)
    with pytest.raises(errors.UnreadableFileError, match=says) as caught:
        read_record(path, **ASKED)
    assert "\n" not in str(caught.value)


# ------------------------------------------------------------------------------------------ sizes
@pytest.mark.skipif(os.name == "nt", reason="files are not sparse by themselves here")
@pytest.mark.parametrize("head", [b"", b"t,u,y\n0,1,2\n", b"t,u,y\n" + b"0,1,2\n" * 400_000])
@pytest.mark.fast("", "t,u,y*")
def test_a_huge_sparse_file_is_refused_by_its_beginning(tmp_path: Path, head: bytes) -> None:
    path = tmp_path / "sparse.csv"
    path.write_bytes(head)
    os.truncate(path, 40 << 30)
    begun = time.process_time()
    with pytest.raises(errors.UnreadableFileError):
        read_record(path, **ASKED)
    assert time.process_time() - begun < 15.0


@pytest.mark.slow
def test_a_byte_far_down_that_is_no_utf_8_is_latin_1(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    rows = b"".join(b"%d,%d,%d,note\n" % (k, k % 2, k % 3) for k in range(90_000))
    path.write_bytes("t,u,y [°],n\n".encode() + rows + b"90000,1,2,\xb0 caf\xe9\n")
    assert path.stat().st_size > 1 << 20
    record = read_record(path, **ASKED)
    assert (record.n_samples, record.units["y"]) == (90_001, "°")
    assert record.y[-1, 0] == 2.0


def test_text_that_would_fill_the_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(isolation, "memory_limit", lambda: 200_000)
    monkeypatch.setattr(text_rows, "_LOOK", 100)
    path = tmp_path / "long.csv"
    for blank in ("", " "):
        path.write_text("t,u,y\n" + "".join(f"{k},1,2{blank}\n" for k in range(10_000)))
        with pytest.raises(errors.FileTooLargeError, match="an eighth of this machine's memory"):
            read_record(path, **ASKED)


@pytest.mark.slow
def test_an_array_is_measured_as_a_whole_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, t=np.arange(1000.0), y=np.zeros((1000, 900)), big=np.zeros(10**7))
    from tridentify.record.formats.npz import NpzFile

    monkeypatch.setattr(isolation, "memory_limit", lambda: 1_000_000)
    archive = NpzFile(path)
    names = [channel.name for channel in archive.channels]
    assert len(archive.read([names.index("t")])[0]) == 1000
    for name in ("y[3]", "big"):
        with pytest.raises(errors.FileTooLargeError):
            archive.read([names.index(name)])


@pytest.mark.parametrize("shape", [(10**400,), (-3,), (10**30, 2)])
def test_a_shape_that_no_array_has_is_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    stream = BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    path = tmp_path / "liar.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("u", "y"):
            archive.writestr(f"{name}.npy", stream.getvalue() + bytes(64))
    with pytest.raises(errors.DataError) as caught:
        read_record(path, dt=1.0, inputs=["u[0]" if len(shape) == 2 else "u"], outputs=["y"])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("packed", [False, True])
def test_variables_of_matlab_are_measured_before_they_are_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, packed: bool
) -> None:
    path = tmp_path / "bomb.mat"
    io.savemat(path, {"u": np.zeros(50_000), "s": {"y": np.zeros(50_000)}}, do_compression=packed)
    assert 800_000 < matlab.declared_size(path) < 802_000
    monkeypatch.setattr(isolation, "memory_limit", lambda: 700_000)
    with pytest.raises(errors.FileTooLargeError, match=r"found 0\.00074\d GiB"):
        matlab.open_file(path)


def test_a_matrix_of_hdf5_is_measured_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py", reason="needs h5py, of the extra tridentify[files]")
    from tridentify.record.formats.matlab import matlab_hdf5

    path = tmp_path / "bomb.h5"
    with h5py.File(path, "w") as file:
        # nothing of it is in the file
        file.create_dataset("y", shape=(1 << 20, 900), chunks=(1 << 16, 900), dtype="f8")
    assert path.stat().st_size < 10_000
    monkeypatch.setattr(isolation, "memory_limit", lambda: 1 << 28)
    opened = matlab_hdf5.open_file(path)
    with pytest.raises(errors.FileTooLargeError, match=r"found 7\.03 GiB"):
        opened.read([0])


def test_a_column_without_numbers_is_refused_by_its_type(tmp_path: Path) -> None:
    path = tmp_path / "lists.parquet"
    frame = pl.DataFrame({"t": [0.0, 1.0], "u": [0.0, 1.0], "y": [[1.0] * 9, [2.0]]})
    frame.write_parquet(path)
    with pytest.raises(errors.TextInColumnError, match=r"found List\(Float64\) in column 'y'"):
        read_record(path, **ASKED)


def test_the_limit_is_a_part_of_what_the_machine_or_its_container_has(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert isolation.memory_limit() <= max(isolation.machine_memory() / 8, 2**28)
    monkeypatch.setattr(isolation, "_installed", lambda: 64 << 30)
    monkeypatch.setattr(isolation, "_allowed", lambda: iter([-1, 8 << 30]))
    assert (isolation.machine_memory(), isolation.memory_limit()) == (8 << 30, 1 << 30)
