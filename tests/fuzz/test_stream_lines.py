"""Lines of a stream, damaged and forged: read, skipped or refused, alike in any pieces."""

from __future__ import annotations

import json
import time
import warnings
from typing import Any

import numpy as np
import pytest

from tridentify import Structure, errors, online
from tridentify.cli.stream_question import StreamQuestion
from tridentify.cli.stream_session import Session
from tridentify.record.formats.streams.header import Asked
from tridentify.record.formats.streams.lines import LineCutter

LONGEST = 20.0
"""Processor time of some hundred lines, far above what any take [s]."""

CELLS = (
    *("", " ", "nan", "NaN", "null", "-inf", "1e999", "-0.0", "1_0", "0x1", "1,5", "1.2.3", "--1"),
    *('"', '""', '"1', "#", "%", "\0", "\ufeff", "\u0661", "\u202e", "\u2028", "\x85", "\x1b[2J"),
    *("9" * 400, "x" * 70_000, "1e308", "-1e308", "t", "u", "y", "true", "[1]", "{}", "1e-320"),
)

JSON_LINES = (
    *("{", "{}", "[]", "null", "1", '"t"', "{'t': 1}", '{"t": 1, "t": 2, "u": 0, "y": 0}'),
    *('{"t": 1e999, "u": 0, "y": 0}', '{"t": NaN, "u": 0, "y": 0}', '{"t": "1", "u": 0, "y": 0}'),
    *('{"t": 1, "u": [0], "y": {}}', '{"t": true, "u": 0, "y": 0}', '{"t": 1, "u": 0}', "[" * 9000),
    *(
        '{"t": ' + "9" * 5000 + ', "u": 0, "y": 0}',
        '{"t": 1, "u": 0, "y": "\\ud800"}',
        '{"a":' * 900,
    ),
)


def forged(rng: np.random.Generator, form: str) -> bytes:
    """A header, samples, and among them lines that are none."""
    header = "t,u,y" if form == "csv" else ""
    lines = [header, "s,V,-"] if header and rng.random() < 0.2 else [header] if header else []
    step = float(rng.choice([0.1, 0.1, 1e-3]))
    for k in range(int(rng.integers(2, 120))):
        stamp = step * (k + (rng.random() < 0.02) * rng.integers(-9, 1000))
        u, y = k // 7 % 2, rng.standard_normal() * float(rng.choice([1, 1, 1, 1e5]))
        if form == "csv":
            lines.append(f"{stamp!r},{u},{y!r}".replace("np.float64(", "").replace(")", ""))
        else:
            lines.append(json.dumps({"t": float(stamp), "u": u, "y": float(y)}))
    for _ in range(int(rng.integers(0, 12))):
        at = int(rng.integers(len(lines)))
        cells = lines[at].split(",")
        cells[int(rng.integers(len(cells)))] = CELLS[int(rng.integers(len(CELLS)))]
        choices = (",".join(cells), lines[at][: int(rng.integers(len(lines[at]) + 1))], header, "")
        more = JSON_LINES if form == "json" else ("# y,u,t", "y,t,u", "t,u,y,z", ",,", ",,,")
        pool = (*choices, more[int(rng.integers(len(more)))])
        where = at if rng.random() < 0.7 else min(at, 2)
        lines[where] = pool[int(rng.integers(len(pool)))]
    end = "\r\n" if rng.random() < 0.2 else "\n"
    data = bytearray((end.join(lines) + end).encode("utf-8", "replace"))
    for _ in range(int(rng.choice([0, 0, 1, 5]))):
        data[int(rng.integers(len(data)))] = int(rng.integers(256))
    return bytes(data)


def followed(data: bytes, asked: Asked, cuts: list[int]) -> tuple[list[dict[str, Any]], str]:
    """Lines of output of a stream that comes in these pieces, and why it ended early."""
    emitted: list[dict[str, Any]] = []
    said: list[str] = []
    dt = 0.1 if asked.uniform else None
    method = online.RecursiveLeastSquares(filter=(1.0, 2.0))  # nothing to be searched
    question = StreamQuestion(asked, Structure(1, 0), method, dt, "zoh", (), 4.0)
    session, cutter = Session(question, emitted.append, said.append), LineCutter()
    refused = ""
    warnings.simplefilter("ignore", RuntimeWarning)  # as the command line does
    try:
        for begin, end in zip([0, *cuts], [*cuts, len(data)], strict=True):
            for lines in cutter.cut(data[begin:end]):
                session.take(lines)
        for lines in cutter.rest():
            session.take(lines)
        session.end_waiting()
        emitted.append(session.line(final=True))
    except errors.TridentifyError as error:
        refused = str(error)
    assert len(refused) < 1000
    assert all(len(text) < 1000 for text in said)
    return emitted, refused


def check(data: bytes, asked: Asked, rng: np.random.Generator, what: str) -> None:
    """However the bytes come, the same lines come out, in bounded time."""
    begun = time.process_time()
    cuts = sorted(rng.integers(len(data) + 1, size=int(rng.integers(0, 9))).tolist())
    try:
        whole, pieces = followed(data, asked, []), followed(data, asked, cuts)
    except Exception as error:
        raise AssertionError(f"{what}: {error!r}") from error
    assert repr(pieces) == repr(whole), what
    assert time.process_time() - begun < LONGEST, what
    numbers = [line["number"] for line in whole[0]]
    assert numbers == list(range(1, len(numbers) + 1)), what
    for line in whole[0]:
        assert line["malformed"] <= line["lines"], what


@pytest.mark.slow
def test_forged_lines_of_csv_are_followed_or_refused(seeds) -> None:
    for seed, rng in seeds.take(25):
        uniform = bool(rng.random() < 0.2)
        check(forged(rng, "csv"), Asked(("u",), ("y",), uniform=uniform), rng, f"seed {seed}")


@pytest.mark.slow
def test_forged_lines_of_json_are_followed_or_refused(seeds) -> None:
    for seed, rng in seeds.take(25):
        check(forged(rng, "json"), Asked(("u",), ("y",)), rng, f"seed {seed}")


@pytest.mark.parametrize(
    ("data", "refusal"),
    [
        (b't,u,y\n"a\rb,V,"\n0.1,0,1\n0.2,0,2\n', ""),
        (b't,u\rx,"y"\n0.1,0,1\n', "found damaged quotes"),
        (b'"t",u,"y\r"\r\n0.1,0,1\r\n', "found "),
        (b'name\r\n{"t": 0.1, "u": 0, "y": 70\r85.9}\r\n{"t": 0.2, "u": 0, "y": 1}\r\n', "found "),
    ],
)
def test_damaged_quotes_before_the_first_row(data: bytes, refusal: str) -> None:
    """Seen: the error of a bad line left the reader where there was no row yet to be bad."""
    check(data, Asked(("u",), ("y",)), np.random.default_rng(0), repr(data))
    said = followed(data, Asked(("u",), ("y",)), [])[1]
    assert said.startswith(refusal)
    assert bool(said) == bool(refusal)
