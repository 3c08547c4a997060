"""Small files of every binary format, written by the tests themselves."""

from __future__ import annotations

import gc
import struct
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from scipy import io


def write_ulog(
    path: Path,
    topics: dict[str, dict[str, np.ndarray]],
    types: dict[str, str] | None = None,
) -> Path:
    """A ULog file from the public description of the format (PX4 guide, "ULog File Format").

    Every topic maps fields to samples and holds a ``timestamp`` in microseconds; a name such as
    ``imu#1`` is the second instance of ``imu``. Fields are doubles, unless `types` says otherwise.
    """

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message("B", bytes(40))]
    described: set[str] = set()
    rows: list[tuple[int, bytes]] = []
    subscribed: list[bytes] = []
    for number, (label, fields) in enumerate(topics.items()):
        name, _, instance = label.partition("#")
        others = {f: v for f, v in fields.items() if f != "timestamp"}
        kinds = {f: (types or {}).get(f, "double") for f in others}
        if name not in described:
            text = "".join(f"{kinds[f]} {f};" for f in others)
            parts.append(message("F", f"{name}:uint64_t timestamp;{text}".encode()))
            described.add(name)
        head = struct.pack("<BH", int(instance or 0), number)
        subscribed.append(message("A", head + name.encode()))
        codes = {"double": "d", "float": "f", "int32_t": "i", "bool": "?"}
        layout = "<HQ" + "".join(codes[kinds[f]] for f in others)
        for k, stamp in enumerate(fields["timestamp"]):
            body = struct.pack(layout, number, int(stamp), *(v[k] for v in others.values()))
            rows.append((int(stamp), message("D", body)))
    rows.sort(key=lambda row: row[0])
    path.write_bytes(b"".join(parts + subscribed + [data for _, data in rows]))
    return path


def write_mdf(
    path: Path, groups: list[tuple[np.ndarray, dict[str, tuple[np.ndarray, str]]]]
) -> Path:
    """An MDF4 file with one group for every time axis."""
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        for time, channels in groups:
            file.append(
                [
                    Signal(samples=samples, timestamps=time, name=name, unit=unit)
                    for name, (samples, unit) in channels.items()
                ]
            )
        file.save(path, overwrite=True)
    return path


def write_excel(path: Path, *sheets: list) -> Path:
    """A workbook of one sheet for each list of rows."""
    from openpyxl import Workbook

    book = Workbook()
    for number, rows in enumerate(sheets):
        sheet = book.active if number == 0 else book.create_sheet()
        sheet.title = f"Run{number + 1}"
        for row in rows:
            sheet.append(list(row))
    book.save(path)
    return path


def write_matlab_hdf5(path: Path, variables: dict[str, object]) -> Path:
    """A file as MATLAB writes it with ``save -v7.3``: numbers, texts, structs and cells."""
    import h5py

    def put(group: h5py.Group, name: str, value: object, store: h5py.Group) -> None:
        if isinstance(value, dict):
            inner = group.create_group(name)
            inner.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, item in value.items():
                put(inner, key, item, store)
        elif isinstance(value, str):
            codes = np.array([[ord(letter)] for letter in value], dtype=np.uint16)
            data = group.create_dataset(name, data=codes)
            data.attrs["MATLAB_class"] = np.bytes_("char")
        elif isinstance(value, list):
            references = []
            for item in value:
                key = f"c{len(store)}"
                put(store, key, item, store)
                references.append(store[key].ref)
            cell = np.empty((len(value), 1), dtype=h5py.ref_dtype)
            cell[:, 0] = references
            data = group.create_dataset(name, data=cell, dtype=h5py.ref_dtype)
            data.attrs["MATLAB_class"] = np.bytes_("cell")
        else:
            data = group.create_dataset(name, data=np.atleast_2d(np.asarray(value, float)).T)
            data.attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        store = file.create_group("#refs#")
        for name, value in variables.items():
            put(file, name, value, store)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, written by a test".ljust(124)
    with path.open("r+b") as stream:
        stream.write(head + b"\x00\x02IM")
    return path


def write_matlab_5(path: Path, variables: dict[str, object]) -> Path:
    """The same in version 5, compressed."""

    def plain(value: object) -> object:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list):
            cell = np.empty((len(value), 1), dtype=object)
            for k, item in enumerate(value):
                cell[k, 0] = plain(item)
            return cell
        return value if isinstance(value, str) else np.atleast_2d(np.asarray(value, float))

    io.savemat(path, {name: plain(value) for name, value in variables.items()}, do_compression=True)
    return path


@pytest.fixture(scope="session")
def write() -> SimpleNamespace:
    """The writers by name."""
    return SimpleNamespace(
        ulog=write_ulog, mdf=write_mdf, matlab5=write_matlab_5, matlab73=write_matlab_hdf5
    )


N = 8
T = 0.02 * np.arange(N)
U = np.array([0.0, 1, 1, 0, -1, -1, 0, 0])
Y = np.array([0.0, 0, 0.5, 1, 0.75, 0, -0.5, -0.25])
R = np.array([0.0, 2, 2, 2, 2, 0, 0, 0])


def _parquet(path: Path) -> Path:
    pl.DataFrame({"t": T, "u": U, "y": Y, "r": R}).write_parquet(path)
    return path


def _feather(path: Path) -> Path:
    pl.DataFrame({"t": T, "u": U, "y": Y, "r": R}).write_ipc(path, compression="lz4")
    return path


def _npz(path: Path) -> Path:
    np.savez_compressed(path, t=T, u=U, y=Y, r=R)
    return path


def _csv(path: Path) -> Path:
    rows = np.column_stack([T, U, Y, R]).tolist()
    path.write_text("t,u,y,r\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    return path


def _column(values: np.ndarray) -> np.ndarray:
    return values[:, np.newaxis]


MATLAB = {"z": {"u": _column(U), "y": _column(Y), "Ts": 0.02}}
FLAT = {"time": "t", "inputs": ["u"], "outputs": ["y"]}
SAMPLES: dict[str, tuple[Callable[[Path], Path], dict[str, object], str]] = {
    "run.csv": (_csv, FLAT, ""),
    "run.parquet": (_parquet, FLAT, ""),
    "run.feather": (_feather, FLAT, ""),
    "run.npz": (_npz, FLAT, ""),
    "five.mat": (
        lambda path: write_matlab_5(path, MATLAB),
        {"inputs": ["z.u"], "outputs": ["z.y"]},
        "",
    ),
    "seven.mat": (
        lambda path: write_matlab_hdf5(path, MATLAB),
        {"inputs": ["z.u"], "outputs": ["z.y"]},
        "h5py",
    ),
    "run.ulg": (
        lambda path: write_ulog(path, {"log": {"timestamp": 1e6 * T, "u": U, "y": Y, "r": R}}),
        {"inputs": ["log.u"], "outputs": ["log.y"]},
        "pyulog",
    ),
    "run.xlsx": (
        lambda path: write_excel(
            path, [["t", "u [deg]", "y [deg/s]", "r [deg/s]"], *zip(T, U, Y, R, strict=True)]
        ),
        {"inputs": ["u"], "outputs": ["y"]},
        "openpyxl",
    ),
    "run.mf4": (
        lambda path: write_mdf(
            path, [(T, {"u": (U, "deg"), "y": (Y, "deg/s"), "r": (R, "deg/s")})]
        ),
        {"inputs": ["u"], "outputs": ["y"]},
        "asammdf",
    ),
}


# Feather is Arrow as Parquet is; MDF4 takes seconds to open, and its record is read elsewhere
DEAR = ("run.feather", "run.mf4")
NAMES = [pytest.param(name, marks=pytest.mark.slow) if name in DEAR else name for name in SAMPLES]


@pytest.fixture(scope="session", params=NAMES)
def sample(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory):
    """One small record of 8 samples in every format: its path, and how to ask for it."""
    make, asked, needs = SAMPLES[request.param]
    if needs:
        pytest.importorskip(needs, reason=f"needs {needs}, of the extra tridentify[files]")
    path = make(tmp_path_factory.mktemp("sample") / request.param)
    return SimpleNamespace(path=path, asked=asked, needs=needs, t=T, u=U, y=Y, r=R)


@pytest.fixture(autouse=True)
def _collected(request: pytest.FixtureRequest) -> Iterator[None]:
    """Collect what asammdf leaves open, so that no later test is blamed for it."""
    yield
    if "asammdf" in request.fixturenames:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)
            gc.collect()
