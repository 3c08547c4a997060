"""A state is a plain value: saved, restored and resumed bit for bit, whatever happens meanwhile."""

from __future__ import annotations

import base64
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import tridentify
from tridentify import (
    Estimate,
    Record,
    Structure,
    TransferFunction,
    TridentifyError,
    identify,
    online,
    simulate,
)
from tridentify import errors as err
from tridentify.online.kernels import slots
from tridentify.online.saved.state import packed

pytestmark = pytest.mark.unjudged

DT = 0.05
ASKED = Structure(2, 1, offset=True, initial_state="free")
METHODS = {
    "three-model": online.ThreeModel(),
    "three-model, forgetting": online.ThreeModel(forgetting=0.998, forget="directional"),
    "least squares": online.RecursiveLeastSquares(),
    "least squares, resetting": online.RecursiveLeastSquares(forgetting=0.99, forget="resetting"),
    "least squares, filter": online.RecursiveLeastSquares(filter=(1.0, 4.0, 4.0), forgetting=0.999),
    "least squares, start": online.RecursiveLeastSquares(
        start=TransferFunction([0.3, 0.4], [1.0, 1.5, 2.5])
    ),
    "kalman": online.Kalman(drift=0.01),
    "kalman, each its own": online.Kalman(drift={"a1": 0.1, "a0": 0.0, "b1": 0.01, "b0": 1e-3}),
    "gradient": online.Gradient(),
}
every_method = pytest.mark.parametrize("key", list(METHODS), ids=str)


def signals(n_samples, seed=1):
    """A record with gaps in the output and in the input, and one outlier."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(-(-n_samples // 4)), 4)[:n_samples]
    y = simulate(TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0]), Record(u, u, dt=DT))[:, 0] + 2.0
    y = y + 0.05 * np.std(y) * rng.standard_normal(n_samples)
    y[200:230] = np.nan
    y[rng.integers(0, n_samples, n_samples // 50)] = np.nan
    y[n_samples // 2] = 50.0
    u[77::101] = np.nan
    return u.tolist(), y.tolist()


def stepped(method, state, u, y):
    innovations = []
    for now_u, now_y in zip(u, y, strict=True):
        state, innovation = method.step(state, now_u, now_y)
        innovations.append(np.ravel(innovation))
    return state, np.array(innovations)


def content(state, folder):
    path = folder / "content.json"
    state.save(path)
    return path.read_bytes()


@every_method
@pytest.mark.fast("three-model, forgetting", "least squares, filter", "kalman", "gradient")
def test_resumed_from_a_file_bit_for_bit(key, tmp_path):
    """Every state on the way, saved and loaded, gives the same innovations and the same end."""
    method = METHODS[key]
    u, y = signals(620)
    expected = method.init(ASKED, DT, units={"u": "V", "y": "rad"})
    resumed = expected
    path = tmp_path / "state.json"
    for k in range(len(u)):
        if k in (0, 1, 5, 60, 199, 210, 400, 601):
            resumed.save(path)
            resumed = online.State.load(path)
            assert content(resumed, tmp_path) == path.read_bytes()
        expected, one = method.step(expected, u[k], y[k])
        resumed, two = method.step(resumed, u[k], y[k])
        assert np.array_equal(one, two, equal_nan=True)
    assert content(resumed, tmp_path) == content(expected, tmp_path)
    for name in ("n_samples", "time", "flags", "seen", "changes", "structure"):
        assert getattr(resumed, name) == getattr(expected, name), name
    assert type(resumed.method) is type(method)
    one, two = method.estimate(expected), resumed.method.estimate(resumed)
    assert np.array_equal(one.theta, two.theta)
    assert np.array_equal(one.cov, two.cov)
    assert dict(two.units) == {"u": "V", "y": "rad"}


@pytest.mark.slow
def test_jittered_time_is_in_the_state(tmp_path):
    method = online.ThreeModel()
    u, y = signals(800)
    intervals = DT * np.random.default_rng(3).uniform(0.5, 1.5, 800)
    states = [method.init(ASKED, DT)] * 2
    for k in range(800):
        if k % 97 == 5:
            states[1].save(tmp_path / "state.json")
            states[1] = online.State.load(tmp_path / "state.json")
        states = [method.step(s, u[k], y[k], interval=intervals[k])[0] for s in states]
    assert content(states[0], tmp_path) == content(states[1], tmp_path)
    assert states[1].time == pytest.approx(intervals[1:].sum(), rel=1e-9)


@pytest.mark.slow
def test_an_estimate_to_start_from_survives_the_file(tmp_path):
    u, y = (np.array(x) for x in signals(600))
    u, y = u[230:520], y[230:520]
    known = np.isfinite(u)
    u = np.where(known, u, 0.0)
    estimate = identify(Record(u, y, dt=DT), ASKED)
    method = online.ThreeModel(start=estimate)
    state = method.init(ASKED, DT)
    state, _ = stepped(method, state, u[:100].tolist(), y[:100].tolist())
    state.save(tmp_path / "state.json")
    again = online.State.load(tmp_path / "state.json")
    assert again.method == method or again.method.start is not None
    one, _ = stepped(method, state, u[100:].tolist(), y[100:].tolist())
    two, _ = stepped(again.method, again, u[100:].tolist(), y[100:].tolist())
    assert content(one, tmp_path) == content(two, tmp_path)


# ------------------------------------------------------------------------- a process that dies
CHILD = """
import json, sys, time
from tridentify import Structure, online
target, source = sys.argv[1:]
state = online.State.load(target)
u, y = json.load(open(source))
method = state.method
for k in range(state.n_samples, len(u)):
    state, _ = method.step(state, u[k], y[k])
    if state.n_samples % 50 == 0:
        state.save(target)
        print(state.n_samples, flush=True)
        time.sleep(0.01)
"""


def child(*arguments):
    source = Path(tridentify.__file__).parents[1]
    path = os.pathsep.join([str(source), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-c", CHILD, *map(str, arguments)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "key", ["three-model", "least squares, filter", "kalman", "gradient"], ids=str
)
def test_a_killed_process_is_resumed_as_if_nothing_had_happened(key, tmp_path):
    """SIGKILL after some checkpoint, go on from the file, and die once more."""
    method = METHODS[key]
    u, y = signals(1500)
    begin = method.init(ASKED, DT)
    target, source = tmp_path / "state.json", tmp_path / "signals.json"
    begin.save(target)
    source.write_text(json.dumps([u, y]), encoding="utf-8")
    reached = []
    for stop in (150, 800):
        process = child(target, source)
        for line in process.stdout:
            if int(line) >= stop:
                break
        process.kill()
        process.wait()
        process.stdout.close()
        state = online.State.load(target)
        reached.append(state.n_samples)
        assert stop <= state.n_samples < 1500
    assert not list(tmp_path.glob("state.json?*"))
    assert reached[1] > reached[0]
    rest, late = stepped(method, state, u[state.n_samples :], y[state.n_samples :])
    whole, innovations = stepped(method, begin, u, y)
    assert np.array_equal(late, innovations[state.n_samples :], equal_nan=True)
    assert content(rest, tmp_path) == content(whole, tmp_path)


SAVER = """
import sys
from tridentify import online
state = online.State.load(sys.argv[1])
print("ready", flush=True)
while True:
    state.save(sys.argv[1])
"""


@pytest.mark.slow
def test_a_save_that_is_cut_short_leaves_the_old_file(tmp_path):
    """Killed in the middle of writing, again and again: the file is always whole."""
    method = METHODS["three-model"]
    u, y = signals(400)
    state, _ = stepped(method, method.init(ASKED, DT), u, y)
    target = tmp_path / "state.json"
    state.save(target)
    expected = target.read_bytes()
    source = Path(tridentify.__file__).parents[1]
    for k in range(5):
        process = subprocess.Popen(
            [sys.executable, "-c", SAVER, str(target)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(source)},
        )
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.02 + 0.013 * k)
        process.kill()
        process.wait()
        process.stdout.close()
        assert target.read_bytes() == expected


# ------------------------------------------------------------------------------ damaged files
@pytest.fixture(
    scope="module", params=[("least squares, filter", 400), ("three-model", 300)], ids=str
)
def document(request, tmp_path_factory):
    key, n_samples = request.param
    method = METHODS[key]
    u, y = signals(n_samples)
    state, _ = stepped(method, method.init(ASKED, DT), u, y)
    path = tmp_path_factory.mktemp("state") / "state.json"
    state.save(path)
    return path.read_text(encoding="utf-8")


def refused(kinds, path):
    with pytest.raises(kinds) as caught:
        online.State.load(path)
    text = str(caught.value)
    assert "\n" not in text
    assert "found" in text
    return text


def test_no_such_file(tmp_path):
    refused(err.UnreadableFileError, tmp_path / "nothing.json")
    refused(err.UnreadableFileError, tmp_path)


def test_a_file_that_is_cut_or_is_something_else(document, tmp_path):
    path = tmp_path / "state.json"
    for part in (0, 1, 10, len(document) // 3, len(document) // 2, len(document) - 10):
        path.write_text(document[:part], encoding="utf-8")
        refused(err.DataError, path)
    for text in ("[]", "3", "null", "{}", '{"schema": 1}', "time,u,y\n0,1,2\n"):
        path.write_text(text, encoding="utf-8")
        refused(err.DataError, path)
    path.write_bytes(b"\x80\x04\x95\x00\xff\xfe")
    refused(err.DataError, path)


def test_an_estimate_is_no_state_and_a_state_no_estimate(document, tmp_path):
    u = np.repeat(np.random.default_rng(1).standard_normal(60), 5)
    y = simulate(TransferFunction([0.5], [1.0, 2.0]), Record(u, u, dt=DT))
    identify(Record(u, y, dt=DT), Structure(1, 0)).save(tmp_path / "model.json")
    refused(err.DataError, tmp_path / "model.json")
    (tmp_path / "state.json").write_text(document, encoding="utf-8")
    with pytest.raises(err.DataError):
        Estimate.load(tmp_path / "state.json")


def test_a_file_of_another_version_is_refused(document, tmp_path):
    found = json.loads(document)
    keys = [k for k, v in found.items() if isinstance(v, int) and not isinstance(v, bool)]
    keys = [k for k in keys if any(word in k for word in ("schema", "version", "state"))]
    assert len(keys) == 1, "the file does not say of which version it is"
    path = tmp_path / "state.json"
    for version in (0, 999, -1, "1", None, 1.5):
        path.write_text(json.dumps({**found, keys[0]: version}), encoding="utf-8")
        refused(err.DataError, path)


def places(value, prefix=()):
    """Every place in a document, by the keys that lead there; the first entries of long lists."""
    yield prefix
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from places(inner, (*prefix, key))
    elif isinstance(value, list):
        for key, inner in enumerate(value[:2]):
            yield from places(inner, (*prefix, key))


def altered(value, where, change):
    if not where:
        return change(value)
    copy = value.copy()
    copy[where[0]] = altered(value[where[0]], where[1:], change)
    return copy


def without(value, where):
    if len(where) == 1:
        copy = value.copy()
        del copy[where[0]]
        return copy
    copy = value.copy()
    copy[where[0]] = without(value[where[0]], where[1:])
    return copy


def test_a_file_with_a_part_missing_is_refused(document, tmp_path):
    found = json.loads(document)
    path = tmp_path / "state.json"
    for key in found:
        path.write_text(json.dumps(without(found, (key,))), encoding="utf-8")
        refused(err.DataError, path)


@pytest.mark.slow
def test_a_file_that_was_altered_never_ends_in_a_foreign_error(document, tmp_path):
    """Refused in one line, or loaded and stepped: no KeyError, no crash of a compiled loop."""
    found = json.loads(document)
    path = tmp_path / "state.json"
    changes = (lambda _: None, lambda _: "x", lambda _: [], lambda _: {}, lambda _: -7)
    told = []
    for where in list(places(found))[1:]:
        for change in changes:
            path.write_text(json.dumps(altered(found, where, change)), encoding="utf-8")
            try:
                state = online.State.load(path)
                state, _ = state.method.step(state, 1.0, 0.0)
                state.method.estimate(state)
            except TridentifyError as refusal:
                told.append(str(refusal))
    assert told
    assert not [text for text in told if "\n" in text]


def test_lists_of_the_wrong_length_are_refused(document, tmp_path):
    """A state whose arrays do not fit each other would make a compiled loop read past the end."""
    found = json.loads(document)
    path = tmp_path / "state.json"

    def inside(where):
        value = found
        for key in where:
            value = value[key]
        return value

    told = []
    lists = [w for w in places(found) if isinstance(inside(w), list) and inside(w)]
    for where in lists:
        shorter = altered(found, where, lambda values: values[:-1])
        path.write_text(json.dumps(shorter), encoding="utf-8")
        try:
            state = online.State.load(path)
            for k in range(20):
                state, _ = state.method.step(state, math.sin(k), math.cos(k))
            state.method.estimate(state)
        except TridentifyError as refusal:
            told.append(str(refusal))
    assert told
    assert not [text for text in told if "\n" in text]


def numbers(text):
    return np.frombuffer(base64.b64decode(text)).copy()


def with_number(found, key, at, value):
    changed = numbers(found[key])
    changed[at] = value
    return {**found, key: base64.b64encode(changed.tobytes()).decode("ascii")}


def watched(found, slot):
    return found["ints"][slots.AT_WATCH] + slot


def in_constants(found, place):
    return found["ints"][place]


HUGE = 1e18
FATAL = {
    "another plan": lambda d: {**d, "ints": [x + 51 * (k == 1) for k, x in enumerate(d["ints"])]},
    "a plan of floats": lambda d: {**d, "ints": [float(x) for x in d["ints"]]},
    "a column far before": lambda d: with_number(d, "values", slots.FIRST, -HUGE),
    "a column far behind": lambda d: with_number(d, "values", slots.FIRST, HUGE),
    "half a column": lambda d: with_number(d, "values", slots.FIRST, 0.5),
    "a full chunk": lambda d: with_number(d, "values", slots.FILLED, 1e6),
    "a chunk below nothing": lambda d: with_number(d, "values", slots.FILLED, -1e6),
    "a block beyond its end": lambda d: with_number(d, "values", watched(d, slots.INSIDE), HUGE),
    "an alarm for ever": lambda d: with_number(d, "values", slots.ALARM, 1e300),
    "a count below zero": lambda d: with_number(d, "values", slots.COUNT, -1.0),
    "no count": lambda d: with_number(d, "values", slots.COUNT, np.nan),
    "another time": lambda d: with_number(d, "values", slots.TIME, 1e6),
    "flags that are none": lambda d: with_number(d, "values", slots.SEEN, 2.0**62),
    "a scale below zero": lambda d: with_number(d, "values", watched(d, slots.WEIGHT), -1.0),
    "minus one sample": lambda d: with_number(d, "values", watched(d, slots.SCALED), -1.0),
    "no scale": lambda d: with_number(d, "values", watched(d, slots.SCALE), np.inf),
    "a negative triangle": lambda d: with_number(d, "values", d["ints"][slots.AT_FACTOR], -1.0),
    "a delay": lambda d: with_number(d, "constants", in_constants(d, slots.C_EXTRA), 1e9),
    "another transition": lambda d: with_number(d, "constants", in_constants(d, slots.C_STEP), 9.0),
    "a pole to the right": lambda d: with_number(d, "bank", 0, 1.0),
    "one number more": lambda d: {**d, "values": packed(np.append(numbers(d["values"]), 0.0))},
    "a bank for the memory": lambda d: {**d, "bank": packed(-np.ones(40_000))},
    "poles for the memory": lambda d: {**d, "structure": {**d["structure"], "poles": 10**9}},
    "zeros for the memory": lambda d: {**d, "structure": {**d["structure"], "zeros": 10**9}},
    "a part more": lambda d: {**d, "more": 1},
    "an option more": lambda d: {**d, "method": {**d["method"], "more": 1}},
    "a number for a truth": lambda d: {**d, "searching": 0},
    "changes to come": lambda d: {**d, "changes": [10**6]},
    "a huge change": lambda d: {**d, "changes": [10**30]},
    "samples of nobody": lambda d: {**d, "past": [packed(np.ones(3 * 10**4))]},
}


@pytest.mark.parametrize("change", FATAL.values(), ids=FATAL)
def test_what_no_estimator_can_have_come_to_is_refused(document, change, tmp_path):
    """Each of these made a compiled loop write beyond its arrays, not end, or fill the memory."""
    path = tmp_path / "state.json"
    path.write_text(json.dumps(change(json.loads(document))), encoding="utf-8")
    assert len(refused(err.DataError, path)) < 500 + len(str(path))


@pytest.mark.parametrize("part", ["[" * 200_000, '{"a":' * 200_000, "1e999", "-Infinity", "NaN"])
def test_values_that_have_no_end_are_refused(document, part, tmp_path):
    path = tmp_path / "state.json"
    path.write_text(document.replace('"ints": [', f'"ints": [{part}', 1), encoding="utf-8")
    refused(err.UnreadableFileError, path)


def test_a_long_file_is_not_taken_into_the_memory(tmp_path):
    path = tmp_path / "state.json"
    with path.open("wb") as stream:
        stream.truncate(1 << 40)
    refused(err.UnreadableFileError, path)
    path.write_bytes(b"[" + b"1," * 5_000_000 + b"1]")
    refused(err.UnreadableFileError, path)


def test_numbers_that_overflow_later_end_in_an_error_of_ours(tmp_path):
    """Every number is finite, but their products are not."""
    method = METHODS["least squares, filter"]
    u, y = signals(400)
    state, _ = stepped(method, method.init(ASKED, DT), u, y)
    x, ints = state.values.copy(), state.stage.blueprint.ints
    n, at = state.stage.blueprint.n_columns, int(ints[slots.AT_FACTOR])
    x[at + n : at + 2 * n] = 1e240
    x[at + 4 * n : at + int(ints[slots.FACTOR])] = 1e240
    state._replace(values=x).save(tmp_path / "state.json")
    again = online.State.load(tmp_path / "state.json")
    with pytest.raises(online.NotReadyError):
        method.estimate(again)


def test_arithmetic_that_fails_on_the_slow_clock_is_told_in_one_line(monkeypatch):
    method = METHODS["three-model"]

    def fails(*_):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(online.ThreeModel, "tick", fails)
    u, y = signals(100)
    with pytest.raises(err.ScaleError) as caught:
        stepped(method, method.init(ASKED, DT), u, y)
    assert "\n" not in str(caught.value)


def test_a_place_that_cannot_be_written(document, tmp_path):
    (tmp_path / "state.json").write_text(document, encoding="utf-8")
    state = online.State.load(tmp_path / "state.json")
    for bad in (tmp_path, tmp_path / "state.json" / "state.json"):
        with pytest.raises(err.OutputPathError) as caught:
            state.save(bad)
        assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["state.json"]
