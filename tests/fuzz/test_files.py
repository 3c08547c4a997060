"""Files of every format, damaged and forged: read, or refused in one line, in bounded time."""

from __future__ import annotations

import io
import time
import warnings
import zipfile
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tridentify import errors, list_channels, read_record

LONGEST = 20.0
"""Processor time of this process for one small file, far above what any takes [s]."""

EXTREMES = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**62,
    2**63,
    2**64 - 1,
)

CELLS = (
    *(
        "",
        " ",
        "nan",
        "-inf",
        "1e999",
        "-1e-999",
        "1_000",
        "0x10",
        "1,5",
        "1.234,5",
        "1,234",
        "1 234",
    ),
    *(
        "\u0661",
        "\u22121",
        "+-1",
        "1e",
        "true",
        '"',
        '""',
        '"1',
        "'1'",
        "=1+1",
        "#",
        "%",
        "\0",
        "\ufeff",
    ),
    *(
        "2024-01-01",
        "2024-02-30T25:61:00Z",
        "0000-00-00",
        "9999-12-31T23:59:59.999999999-23:59",
        "12:30:00",
        "9999:59:59.9",
        "NA",
        "-",
        "#N/A",
        "9" * 400,
        "a" * 3000,
        "\u202e1",
        "\x1b[0m",
        "\ud800",
        "\u2028",
        "\x85",
    ),
)

CLOCKS = ("{:.1f}", "{:.1f}", "2026-11-22T10:00:{:04.1f}", "10:00:{:04.1f}", "2026-11-22")
"""How the cells of time are written."""

TITLES = ("Flight 12", "Flight 12,,", "rate;50", "a\tb", '"', "", "# made up", "t,u", "1", "s,V,-")

ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-32", "latin-1", "cp1252", "utf-7")


def samples() -> dict[str, tuple[Callable[[Path], Path], dict[str, object], str]]:
    """The small files that the tests of formats write."""
    spec = spec_from_file_location("samples", Path(__file__).parents[1] / "formats" / "conftest.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    found: dict[str, tuple[Callable[[Path], Path], dict[str, object], str]] = module.SAMPLES
    return found


SAMPLES = samples()


# --------------------------------------------------------------------------------------- mutations
def flipped(data: bytearray, rng: np.random.Generator) -> None:
    """Other bytes, mostly in the first and last of them, where the formats keep what matters."""
    for _ in range(int(rng.choice([1, 1, 2, 8, 32]))):
        span = int(rng.choice([64, 512, len(data)]))
        at = int(rng.integers(min(span, len(data))))
        data[at if rng.random() < 0.7 else len(data) - 1 - at] = int(rng.integers(256))


def cut(data: bytearray, rng: np.random.Generator) -> None:
    """Without a piece: the end, or something before it."""
    begin = int(rng.integers(len(data)))
    del data[begin : len(data) if rng.random() < 0.5 else begin + int(rng.integers(1, 200))]


def repeated(data: bytearray, rng: np.random.Generator) -> None:
    """A piece twice or many times, where it stood or elsewhere."""
    begin, length = int(rng.integers(len(data))), int(rng.integers(1, 400))
    piece = bytes(data[begin : begin + length]) * int(rng.choice([1, 1, 3, 50]))
    at = int(rng.integers(len(data)))
    data[at:at] = piece


def overstated(data: bytearray, rng: np.random.Generator) -> None:
    """A whole number of the file's own is as large or small as it can be."""
    size = int(rng.choice([1, 2, 4, 8]))
    value = EXTREMES[int(rng.integers(len(EXTREMES)))] % (1 << 8 * size)
    at = int(rng.integers(max(len(data) - size, 1)))
    data[at : at + size] = value.to_bytes(size, "little" if rng.random() < 0.7 else "big")


MUTATIONS = (flipped, flipped, cut, repeated, overstated, overstated)


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """A file after one to three accidents."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 4))):
        if data:
            MUTATIONS[int(rng.integers(len(MUTATIONS)))](data, rng)
    return bytes(data)


def forged_text(rng: np.random.Generator) -> bytes:
    """A table that looks like one, with cells, ends of lines and encodings of all kinds."""
    pick = rng.integers
    separator, end = ",;\t|"[int(pick(4))], ("\n", "\r\n", "\r", "\n\n")[int(pick(4))]
    header = ["t", "u [V]", "y"] + ([CELLS[int(pick(len(CELLS)))]] if rng.random() < 0.3 else [])
    rows = [header]
    if rng.random() < 0.2:
        rows.append(["s", "V", "-", "m"][: len(header)])
    clock = CLOCKS[int(pick(len(CLOCKS)))]
    for k in range(int(pick(2, 30))):
        rows.append([clock.format(0.1 * k), str(k % 2), f"{rng.random():.3f}", "0"][: len(header)])
    for _ in range(int(pick(0, 4))):
        row = rows[int(pick(len(rows)))]
        row[int(pick(len(row)))] = CELLS[int(pick(len(CELLS)))]
    if rng.random() < 0.2:
        del rows[int(pick(len(rows)))][int(pick(len(header))) :]
    lines = [separator.join(row) for row in rows]
    if rng.random() < 0.2:
        lines[:0] = [TITLES[k] for k in pick(len(TITLES), size=int(pick(1, 5)))]
    if rng.random() < 0.2:
        lines.insert(int(pick(len(lines))), "# made up, t,u,y")
    encoding = ENCODINGS[int(pick(len(ENCODINGS)))] if rng.random() < 0.3 else "utf-8"
    return end.join(lines).encode(encoding, "replace")


# ------------------------------------------------------------------------------------- what holds
def check(path: Path, asked: dict[str, Any], rng: np.random.Generator, what: str) -> None:
    """Ask a file; nothing but the package's own errors, in one line, comes of it."""
    begun, said = time.process_time(), ""
    source = path if rng.random() < 0.7 else io.BytesIO(path.read_bytes())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", errors.DataWarning)
            if rng.random() < 0.8:
                read_record(source, **asked)
            else:
                list_channels(source)
    except errors.TridentifyError as error:
        said = str(error)
    except Exception as error:
        raise AssertionError(f"{what}: {error!r}") from error
    assert said.isprintable(), (what, said)
    assert len(said) < 1000, (what, said)
    assert time.process_time() - begun < LONGEST, what


def test_forged_text_is_read_or_refused(seeds, tmp_path: Path) -> None:
    path = tmp_path / "forged.csv"
    for seed, rng in seeds.take(150):
        content = forged_text(rng)
        path.write_bytes(mutated(content, rng) if rng.random() < 0.3 else content)
        asked = {"inputs": ["u"], "outputs": ["y"], "time": "t"}
        if rng.random() < 0.3:
            del asked["time"]
        check(path, asked, rng, f"seed {seed}")


@pytest.mark.timeout(900)
@pytest.mark.slow
def test_a_workbook_with_damaged_parts_is_read_or_refused(seeds, tmp_path: Path) -> None:
    pytest.importorskip("openpyxl", reason="needs openpyxl, of the extra tridentify[excel]")
    make, asked, _ = SAMPLES["run.xlsx"]
    with zipfile.ZipFile(make(tmp_path / "sound.xlsx")) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    path = tmp_path / "run.xlsx"
    for seed, rng in seeds.take(4):
        spoiled = sorted(parts)[int(rng.integers(len(parts)))]
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in parts.items():
                archive.writestr(name, mutated(content, rng) if name == spoiled else content)
        check(path, asked, rng, f"seed {seed}, {spoiled}")


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.fast("run.csv", "run.ulg", "run.npz", "seven.mat", "run.feather")
def test_a_damaged_file_is_read_or_refused(name: str, seeds, tmp_path: Path) -> None:
    make, asked, needs = SAMPLES[name]
    if needs == "asammdf" and not seeds.seconds:
        pytest.skip("asammdf takes seconds to start; make fuzz damages MDF4 files")
    if needs:
        pytest.importorskip(needs, reason=f"needs {needs}, of the extra tridentify[files]")
    path = tmp_path / name
    content = make(path).read_bytes()
    for seed, rng in seeds.take(100 if name.endswith(".csv") else 1):
        path.write_bytes(mutated(content, rng))
        check(path, asked, rng, f"{name}, seed {seed}")
