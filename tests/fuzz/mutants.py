"""A process that resumes from damaged files: run by the fuzzers of states and checkpoints.

``mutants.py states|checkpoints FOLDER SEED...`` takes a document of the folder for each seed,
damages it, loads it and feeds samples to what was loaded. It prints a line for each seed. A loop
that writes beyond its arrays or does not end kills the process, and the seed that was named last is
the one.
"""

from __future__ import annotations

import base64
import json
import random
import signal
import sys
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np

from tridentify import Structure, TridentifyError, online
from tridentify.cli.stream_checkpoint import read_checkpoint, undamaged
from tridentify.cli.stream_question import StreamQuestion
from tridentify.cli.stream_session import Session
from tridentify.record.formats.streams.header import Asked
from tridentify.record.formats.streams.lines import LineCutter
from tridentify.record.formats.streams.sources import FileSource

SECONDS = 20.0
"""Of processor time for one seed, before the process is killed."""
SAMPLES = 60
ODD = [
    None, True, "x", "", [], {}, -1, 0, 1, 3, 1.5, 1e300, -1e300, 10**30, 2**31, 2**63, "inf",
    "nan", [[[]]], {"a": 1}, 1e-320, "\ud800", "a\nb", 1000,
]  # fmt: skip
NUMBERS = [
    np.nan, np.inf, -np.inf, 1e300, -1e300, 1e200, 1e100, 1e18, -1e18, 2.0**53, 2.0**63, -1.0, 0.0,
    1.0, 0.5, 1e-300, 5e-324, -1e-5, -51.0, 51.0, 200.0,
]  # fmt: skip
TEXTS = ["1e999", "[", "NaN", "\\", '"', "", "[" * 200_000]
PACKED = ("values", "values", "values", "values", "constants", "bank", "poles")
HEAD = 16
"""Clocks and indices stand in the first places of the vector."""


def places(value: object, here: tuple = ()) -> list[tuple]:
    """Every place in a document, by the keys that lead there."""
    if isinstance(value, dict):
        inner = value.items()
    elif isinstance(value, list):
        inner = enumerate(value)
    else:
        return [here]
    return [here, *(place for key, one in inner for place in places(one, (*here, key)))]


def reached(value: object, where: tuple) -> object:
    for key in where:
        value = value[key]
    return value


def damage(document: dict, state: dict, dice: random.Random) -> None:
    """Change one thing."""
    kind = dice.choice(["odd", "gone", "more", "plan", "number", "number", "number", "cut"])
    if kind in ("odd", "gone"):
        *front, last = dice.choice(places(document)[1:])
        if kind == "odd":
            reached(document, front)[last] = dice.choice(ODD)
        else:
            del reached(document, front)[last]
    elif kind == "more":
        here = reached(document, dice.choice(places(document)))
        if isinstance(here, dict):
            here["more"] = dice.choice(ODD)
        elif isinstance(here, list):
            here.insert(dice.randrange(len(here) + 1), dice.choice(ODD))
    elif kind == "plan":
        k = dice.randrange(len(state["ints"]))
        state["ints"][k] += dice.choice([1, -1, 51, -51, 1000, 2**31, 2**62])
    else:
        damage_numbers(state, kind, dice)


def damage_numbers(state: dict, kind: str, dice: random.Random) -> None:
    key = dice.choice(PACKED)
    numbers = np.frombuffer(base64.b64decode(state[key])).copy()
    if not numbers.size:
        return
    at = dice.randrange(numbers.size)
    if kind == "cut":
        numbers = np.delete(numbers, range(at, min(at + dice.choice([1, 2, 8]), numbers.size)))
    else:
        watch, length = state["ints"][8], max(state["ints"][9], 1)
        first = dice.choice([at, dice.randrange(HEAD), watch + dice.randrange(length)])
        at = first if key == "values" and first < numbers.size else at
        factor = dice.choice([-1.0, 1.001, 2.0, 1e6, 1e30])
        numbers[at] = dice.choice([*NUMBERS, numbers[at] * factor, numbers[at] + 1.0])
    state[key] = base64.b64encode(numbers.tobytes()).decode("ascii")


def damaged(text: str, dice: random.Random) -> str:
    document = json.loads(text)
    for _ in range(dice.choice([1, 1, 1, 2, 3])):
        # what it would change may be gone already
        with suppress(AttributeError, IndexError, KeyError, TypeError, ValueError):
            damage(document, document.get("state", document), dice)
    text = json.dumps(document)
    if dice.random() < 0.05:
        at = dice.randrange(len(text))
        text = text[:at] + dice.choice(TEXTS) + text[at + dice.randrange(4) :]
    return text


def resumed_state(path: Path, seed: int) -> str:
    state = online.State.load(path)
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((SAMPLES, len(state.input_names)))
    y = u[:, :1] + 0.1 * rng.standard_normal((SAMPLES, len(state.output_names)))
    y[SAMPLES // 3], y[SAMPLES // 2] = np.nan, 1e4
    state, _ = state.method.step(state, u[0], y[0])
    state, _, _ = state.method.feed(state, u, y)
    told = f"{state.flags} {state.seen} {state.innovations} {state.noise_std}"
    try:
        state.method.estimate(state)
    except online.NotReadyError:
        return "not ready"
    return "ran on" if told else ""


def resumed_stream(path: Path, seed: int) -> str:
    question, data = question_of(path.parent), path.parent / "data.csv"
    source = FileSource(data, False, lambda _: None)
    session = Session(question, lambda _: None, lambda _: None)
    found = read_checkpoint(path, question.to_dict())
    try:
        source.seek(found.mark)
        position = 0 if found.mark is None else found.mark.position
        with undamaged(path):
            session.go_on_from(found.state, found.reader, found.timeline, found.counts, position)
        for lines in LineCutter(position).cut(data.read_bytes()[position:]):
            session.take(lines)
        session.line(final=True)
    finally:
        source.close()
    return "ran on"


def question_of(folder: Path) -> StreamQuestion:
    """What the stream of the test asks; `test_checkpoints` writes it beside its checkpoints."""
    asked = json.loads((folder / "asked.json").read_text(encoding="utf-8"))
    method = online.RecursiveLeastSquares(filter=(1.0, 4.0, 4.0), forgetting=0.999)
    structure = Structure(2, 1, delay=asked["delay"])
    names = Asked(("u",), ("y",), name="data.csv")
    return StreamQuestion(names, structure, method, None, "zoh", [], asked["every"])


def main(kind: str, folder: Path, seeds: list[int]) -> None:
    warnings.simplefilter("ignore")
    documents = sorted((folder / kind).glob("*.json"))
    resumed = {"states": resumed_state, "checkpoints": resumed_stream}[kind]
    for seed in seeds:
        dice = random.Random(seed)
        print(seed, flush=True, end=" ")
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
        text = damaged(dice.choice(documents).read_text(encoding="utf-8"), dice)
        path = folder / f"{kind}-{seeds[0]}.json"
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        try:
            print(resumed(path, seed), flush=True)
        except TridentifyError as refusal:
            print("refused" if "\n" not in str(refusal) else "in several lines", flush=True)
        except Exception as error:
            print(f"{type(error).__name__}: {str(error)[:200]!r}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), list(map(int, sys.argv[3:])))
