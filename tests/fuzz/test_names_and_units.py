"""Names and units of any text: refused in one line, or never code in what is exported."""

from __future__ import annotations

import dataclasses
import html
import re
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, read_record, simulate
from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.output_error import OutputError
from tridentify.export import write_c_header, write_matlab
from tridentify.writing.layout import short

IN_SUMMARY = 26
"""Characters of a name in the heading of a summary."""
COMPILER = shutil.which("gcc") or shutil.which("cc")
PIECES = (
    "u", "rad/s", "°", "µ", "é", "\\", "\n", "\r", "\r\n", "\u2028", "\u2029", "\x0b", "\x0c",
    "\x85", "*/", "/*", "//", "??/", "???/", "??'", "%{", "%}", "%", "...", "'", '"', "''", ";",
    "|", "`", "$", "{", "}", "[", "]", "(", ")", "<", ">", "&", "<script>alert(1)</script>",
    "\x1b[2J", "\x00", "\x07", "\u202e", "\u2066", "\u200f", "\u00ad", "\u200b", "\ufeff",
    "\ud800", "\U000e0041", "=", ",", " ", "static void evil(void){}", "system('ls')",
    "#error no", "\\u000a", "&#10;", "%d%n", "$\\frac{1$", "-- -->", "]]>", "={{7*7}}", "x" * 90,
)  # fmt: skip


def text(rng: np.random.Generator) -> str:
    """A handful of pieces that mean something to some language."""
    count = int(rng.integers(1, 6))
    return "".join(PIECES[int(k)] for k in rng.integers(len(PIECES), size=count))


def soft(rng: np.random.Generator) -> str:
    """Of printable pieces alone, which a name may have."""
    return "".join(c for c in text(rng) if c.isprintable()).strip()[:100] or "u"


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    u = np.sign(np.random.default_rng(1).standard_normal(12)).repeat(5)
    record = Record(u, u, dt=0.1)
    y = simulate(TransferFunction([2.0], [1.0, 4.0]), record)
    return identify(Record(u, y, dt=0.1), Structure(1, 0, initial_state="rest"), OutputError())


def forced(estimate: Estimate, name: str, unit: str) -> Estimate:
    """An estimate whose name and unit nobody has checked."""
    found = dataclasses.replace(estimate)
    model = dataclasses.replace
    del model
    plant = TransferFunction.from_dict(estimate.model.to_dict())
    object.__setattr__(plant, "input_names", (name,))
    for key, value in {
        "model": plant,
        "input_names": (name,),
        "units": {name: unit, "y": unit},
    }.items():
        object.__setattr__(found, key, value)
    return found


def one_line(error: Exception) -> None:
    assert str(error).isprintable(), repr(str(error))
    assert len(str(error)) < 2000


def test_text_of_any_kind_is_a_name_or_is_refused_in_one_line(seeds):
    taken = refused = 0
    for seed, rng in seeds.take(600):
        name, unit = text(rng), text(rng)
        try:
            record = Record([0.0, 1.0], [0.0, 1.0], dt=1.0, input_names=[name], units={name: unit})
        except TridentifyError as error:
            refused += 1
            one_line(error)
            continue
        taken += 1
        shown = repr(record) + record._repr_html_()
        assert all(c.isprintable() or c == "\n" for c in shown), seed
        assert "<script" not in record._repr_html_(), seed
    assert taken > 20
    assert refused > 200


def test_a_header_of_any_text_is_read_or_refused_in_one_line(seeds, tmp_path):
    path = tmp_path / "record.csv"
    for seed, rng in seeds.take(150):
        unit = text(rng).replace('"', '""')
        content = f't [s],"u [{unit}]",y\n0,1,2\n1,2,3\n2,1,4\n'
        path.write_text(content, encoding="utf-8", errors="surrogatepass", newline="")
        try:
            record = read_record(path, time="t", inputs=["u"], outputs=["y"])
        except TridentifyError as error:
            one_line(error)
            continue
        except Exception as error:
            raise AssertionError(f"seed {seed}: {error!r}") from error
        assert all(u.isprintable() for u in record.units.values()), seed


def test_unchecked_text_stays_in_the_comments_of_c(seeds, estimate, tmp_path):
    plain = _tokens(write_c_header(forced(estimate, "u", "V"), 0.1, tmp_path / "model.h"))
    for seed, rng in seeds.take(15):
        many = [forced(estimate, text(rng), text(rng)) for _ in range(10)]
        for one in many:
            header = write_c_header(one, 0.1, tmp_path / "model.h")
            found = header.read_bytes()
            assert found.isascii(), seed
            assert b"\\" not in found, seed
        if COMPILER is not None:
            assert _tokens(header) == plain, seed


def _tokens(header: Any) -> str:
    """What the preprocessor leaves, with every warning an error."""
    if COMPILER is None:
        return ""
    strict = ("-std=c99", "-trigraphs", "-Wall", "-Wextra", "-Werror", "-pedantic")
    done = subprocess.run(
        [COMPILER, *strict, "-E", "-P", str(header)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    built = [COMPILER, *strict, "-Wno-unused-function", "-fsyntax-only", "-x", "c", str(header)]
    done = subprocess.run(built, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return re.sub(r"\s+", " ", subprocess.run(
        [COMPILER, *strict, "-E", "-P", str(header)], capture_output=True, text=True, check=True
    ).stdout)  # fmt: skip


def test_unchecked_text_stays_in_the_strings_and_comments_of_matlab(seeds, estimate, tmp_path):
    plain = _code(write_matlab(forced(estimate, "u", "V"), tmp_path / "model.m").read_text("utf-8"))
    for seed, rng in seeds.take(200):
        name, unit = text(rng), text(rng)
        script = write_matlab(forced(estimate, name, unit), tmp_path / "model.m").read_text("utf-8")
        assert all(c.isprintable() or c == "\n" for c in script), seed
        assert _code(script) == plain, (seed, name, unit)
        write_matlab(forced(estimate, name, unit), tmp_path / "model.mat")


def _code(script: str) -> list[str]:
    """The script line by line, as MATLAB reads it: strings emptied, comments gone."""
    lines = []
    for line in script.split("\n"):
        # a quote after a name or a bracket is a transposition; the scripts have none
        bare = re.sub(r"'(?:[^']|'')*'", "''", line.split("; % ")[0] if "; % " in line else line)
        assert bare.count("'") % 2 == 0, line
        lines.append("" if bare.startswith("%") else bare)
    return lines


def test_printable_names_go_through_every_export(seeds, tmp_path):
    for seed, rng in seeds.take(25):
        name, unit = soft(rng), soft(rng)
        if name == "y":
            continue
        u = np.sign(rng.standard_normal(12)).repeat(5)
        y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.1))
        record = Record(u, y, dt=0.1, input_names=[name], units={name: unit})
        found = identify(record, Structure(1, 0, initial_state="rest"), OutputError())
        try:
            # lines are broken where they are full, and a third of one is left for a name
            said = "".join(found.summary().split())
            assert "".join(short(name, IN_SUMMARY).split()) in said, seed
            again = Estimate.load(found.save(tmp_path / "model.json"))
            assert (again.input_names, dict(again.units)) == ((name,), {name: unit}), seed
            assert html.escape("<script>") not in found._repr_html_() or "<script>" in name + unit
            assert "<script" not in found._repr_html_(), seed
            write_c_header(found, 0.1, tmp_path / "model.h")
            write_matlab(found, tmp_path / "model.m")
            write_matlab(found, tmp_path / "model.mat")
            found.model.to_control()
        except TridentifyError as error:
            one_line(error)
        except Exception as error:
            raise AssertionError(f"seed {seed}, {name!r} [{unit!r}]: {error!r}") from error
