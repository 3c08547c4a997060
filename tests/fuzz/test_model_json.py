"""A saved estimate that somebody changed: it is refused in one line, or it can be used."""

from __future__ import annotations

import copy
import json
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.output_error import OutputError
from tridentify.export import read_json, write_c_header, write_json, write_matlab
from tridentify.judgement.cautions import judged

pytestmark = pytest.mark.unjudged

LONGEST = 5.0
"""Processor seconds in which a file of some hundred kilobytes is refused, or read and used."""

VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, -5, 2, 3, 10**9, -(10**9), 2**63, 10**400, 0.5, -0.5, 1e9, -1e9,
    1e-300, 1e150, -1e150, 1e300, 5e-324, "", "inf", "-inf", "nan", "1", "u", "y", "free", "rest",
    "equilibrium", "zoh", "foh", "band-limited", "cubic", "CONVERGED", "POSTERIOR_MEAN", "*/", "\\",
    "a\nb", "\u202etxt", "\x1b[2J", "\ud800", "x" * 300, "x" * 30_000, [], {}, [[]], [1], [0.0],
    [1, 2, 3, 4], [[1e9] * 5], [None], ["inf"], [[1.0, 0.0], [0.0, 1.0]], [[0.0]], [[[0.0]]],
    [-1.0], [[-1.0]], [1.0] * 2000, [[1, [2]]], {"a0": 1}, {"a0": 1.0, "b9": 2.0},
    {"a0": [None, None]}, {"a0": [1.0, 0.1]}, [[{"a0": 1.0}, 0.0]], {"u": "rad"},
    {"u": 1}, {"": ""}, {"num": [[[1.0]]]},
)  # fmt: skip
TEXTS = ("1e999", "NaN", "-Infinity", "9" * 5000, "[" * 200_000, '"\\ud800"', '{"a":1,"a":2}')


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where values stand in a document; of long lists the first and the last."""
    if path:
        yield path
    if isinstance(value, dict):
        for key, item in value.items():
            yield from places(item, (*path, key))
    elif isinstance(value, list):
        for k in {0, len(value) - 1} if value else ():
            yield from places(value[k], (*path, k))


def _holder(document: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        document = document[key]
    return document


def _moved(value: Any, rng: np.random.Generator) -> Any:
    """A value like the one that stands there."""
    if isinstance(value, bool) or value is None:
        return not value
    if isinstance(value, (int, float)):
        factor = float(rng.choice([-1.0, 0.0, 1.0 + 1e-6, 2.0, 1e3, 1e-3, 1e30, 1e-30, 1e150]))
        # a damaged place may hold a scalar of numpy, which warns where a float is infinite
        return float(value) * factor if isinstance(value, float) else value * int(min(factor, 1e9))
    if isinstance(value, str):
        return str(rng.choice([value[:-1], value + "x", value * 2, value + "\u2028", value[::-1]]))
    if isinstance(value, list):
        longer = [value[1:], value + value[:1], value[::-1], value * 2, [value], value[:-1]]
        return longer[int(rng.integers(len(longer)))]
    return {k: v for k, v in value.items() if rng.random() < 0.7}


def _other_coefficients(document: dict[str, Any], rng: np.random.Generator) -> None:
    """Other coefficients and terms, of any size, that belong together."""
    structure = Structure.from_dict(document["structure"])
    outputs, inputs = len(document["output_names"]), len(document["input_names"])
    theta = np.array(document["theta"]) * rng.choice([-1.0, 1.0, 1.0], len(document["theta"]))
    size = 10.0 ** rng.choice([0, 1, 5, 20, 80, 150, 290])
    theta *= size ** rng.uniform(-1.0, 1.0, theta.size) * (rng.random(theta.size) > 0.1)
    if structure.delay == "free":
        theta[-inputs:] = np.abs(theta[-inputs:])
        document["model"]["delay"] = [theta[-inputs:].tolist()] * outputs
    num, den = structure.split(theta, outputs, inputs)
    document["theta"] = theta.tolist()
    document["model"]["num"] = [[one.tolist() for one in row] for row in num]
    document["model"]["den"] = [[one.tolist() for one in row] for row in den]
    spread = min(size, 1e140) ** rng.uniform(-1.0, 1.0, theta.size) * (rng.random(theta.size) > 0.1)
    root = rng.standard_normal((theta.size, theta.size)) * spread[:, None]
    document["cov"] = (root @ root.T).tolist()
    for terms in document["nuisance"]:
        terms["offset"] = [size * rng.standard_normal() for _ in range(outputs)]
        free = np.array(terms["free_response"], dtype=np.float64)
        terms["free_response"] = (size * rng.standard_normal(free.shape)).tolist()


def spoiled(document: dict[str, Any], rng: np.random.Generator) -> str:
    """The text of a document with one to three changes."""
    found = copy.deepcopy(document)
    if "theta" in document and rng.random() < 0.4:
        _other_coefficients(found, rng)
        if rng.random() < 0.7:
            return json.dumps(found)
    for _ in range(int(rng.integers(1, 4))):
        everywhere = list(places(found))
        if not everywhere:
            break
        # the shallow places are few, the deep ones many: each depth gets its share
        depth = int(rng.choice(sorted({len(p) for p in everywhere})))
        here = [p for p in everywhere if len(p) == depth]
        path = here[int(rng.integers(len(here)))]
        holder, key = _holder(found, path), path[-1]
        match int(rng.integers(6)):
            case 0 | 1:
                holder[key] = copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])
            case 2 | 3:
                holder[key] = _moved(holder[key], rng)
            case 4:
                del holder[key]
            case _:
                other = _holder(found, here[int(rng.integers(len(here)))])
                if isinstance(other, dict):
                    other[str(rng.choice(["extra", "theta", "__class__", "delay"]))] = holder[key]
                else:
                    other.append(copy.deepcopy(holder[key]))
    return _damaged(json.dumps(found), rng)


def _damaged(text: str, rng: np.random.Generator) -> str:
    """One time in ten the text itself is changed."""
    if rng.random() > 0.1:
        return text
    at = int(rng.integers(len(text)))
    match int(rng.integers(4)):
        case 0:
            return text[:at]
        case 1:
            return text[:at] + str(rng.choice(list('0"{}[],:\x00\xff'))) + text[at + 1 :]
        case 2:
            return text[:at] + text[at : at + 40] + text[at:]
        case _:
            colon = text.find(": ", at)
            odd = TEXTS[int(rng.integers(len(TEXTS)))]
            return text if colon < 0 else f"{text[: colon + 2]}{odd}{text[text.find(',', colon) :]}"


def _record(seed: int, inputs: int = 1, outputs: int = 1, noise: float = 0.05) -> Record:
    rng = np.random.default_rng(seed)
    u = np.sign(rng.standard_normal((15, inputs))).repeat(10, axis=0)
    num = [[[2.0 + i, 1.0 + j] for j in range(inputs)] for i in range(outputs)]
    den = [[[1.0, 1.5, 4.0]] * inputs] * outputs
    record = Record(u, np.zeros((150, outputs)), dt=0.05)
    y = simulate(TransferFunction(num, den), record) + 0.3
    y += noise * rng.standard_normal(y.shape)
    return Record(u, y, dt=0.05, units={record.output_names[0]: "deg/s", "t": "s"})


def _kinds() -> dict[str, Estimate]:
    """One estimate of each kind that differs in what the file holds."""
    one, quiet = _record(1), OutputError()
    separate = Structure([[2, 1], [1, 2]], [[1, 0], [0, 1]], initial_state="free")
    late = identify(one, Structure(2, 1, delay=0.1, initial_state="free"), quiet)
    return {
        "white": identify(one, Structure(2, 1), quiet),
        "coloured": identify(one, Structure(2, 1), ThreeModel(noise="ar")),
        "delay": identify(one, Structure(2, 1, delay="free"), quiet),
        "known delay": replace(late, findings=judged(late, [one])),
        "two by two": identify(_record(2, 2, 2), Structure(2, 1), quiet),
        "separate": identify(_record(3, 2, 2), separate, quiet),
        "fixed": identify(one, Structure(2, 1, fixed={"a0": 4.0}, bounds={"b1": (0, None)}), quiet),
        "known": identify(
            one,
            Structure(
                2, 1, priors={"a1": (1.5, 0.1)}, equalities=[({"b0": 1.0, "a0": -0.25}, 0.0)]
            ),
            quiet,
        ),
        "posterior mean": identify(_record(4, noise=2.0).slice(0.0, 2.0), Structure(2, 1)),
        "several": identify([one, _record(5)], Structure(2, 1, drift=True), quiet),
        "robust": identify(one, Structure(2, 1), ThreeModel(loss="student")),
        "three models": identify(one, Structure(2, 1), ThreeModel.paper(gamma=3.0)),
    }


@pytest.fixture(scope="module")
def documents(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("estimates")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = _kinds()
    return {
        kind: json.loads(estimate.save(folder / "model.json").read_text("utf-8"))
        for kind, estimate in made.items()
    }


def use(estimate: Estimate, record: Record, folder: Any) -> None:
    """Everything that one does with an estimate that was loaded."""
    assert estimate.summary().isprintable() or "\x1b" not in estimate.summary()
    repr(estimate)
    estimate._repr_html_()
    write_json(estimate, folder / "again.json")
    again = Estimate.load(folder / "again.json")
    np.testing.assert_array_equal(again.theta, estimate.theta)
    for attempt in (
        lambda: estimate.predict(record),
        lambda: write_c_header(estimate, 0.05, folder / "model.h"),
        lambda: write_matlab(estimate, folder / "model.m"),
        lambda: write_matlab(estimate, folder / "model.mat"),
        lambda: estimate.model.to_control(),
    ):
        try:
            attempt()
        except TridentifyError as error:
            one_line(error)


def one_line(error: Exception) -> None:
    text = str(error)
    assert text.isprintable(), repr(text[:300])
    assert len(text) < 2000, text[:300]


def attempt(text: str, folder: Any) -> str:
    """Load a document and use what came of it; says how it ended."""
    path = folder / "model.json"
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    try:
        estimate = Estimate.load(path)
    except TridentifyError as error:
        one_line(error)
        return "refused"
    channels = len(estimate.input_names), len(estimate.output_names)
    use(estimate, _record(9, *channels), folder)
    return "used"


def test_a_document_that_nobody_changed_is_used(documents, tmp_path):
    for kind, document in documents.items():
        assert attempt(json.dumps(document), tmp_path) == "used", kind


def test_a_changed_estimate_is_refused_in_one_line_or_can_be_used(documents, seeds, tmp_path):
    ended = {"refused": 0, "used": 0}
    kinds = sorted(documents)
    for seed, rng in seeds.take(70):
        kind = kinds[int(rng.integers(len(kinds)))]
        text = spoiled(documents[kind], rng)
        begin = time.process_time()
        try:
            ended[attempt(text, tmp_path)] += 1
        except Exception as error:
            raise AssertionError(f"seed {seed}, {kind}: {error!r}") from error
        assert time.process_time() - begin < LONGEST, f"seed {seed}, {kind}"
    assert ended["refused"] > ended["used"] > 0


def test_a_changed_plain_model_is_refused_in_one_line_or_can_be_used(seeds, tmp_path):
    model = TransferFunction(
        [[[2.0, 1.0], [3.0]]], [[[1.0, 2.0, 9.0], [1.0, 3.0]]], delay=[[0.1, 0.0]]
    )
    document = json.loads(write_json(model, tmp_path / "model.json").read_text("utf-8"))
    for seed, rng in seeds.take(80):
        (tmp_path / "model.json").write_text(
            spoiled(document, rng), encoding="utf-8", errors="surrogatepass"
        )
        try:
            found = read_json(tmp_path / "model.json")
            str(found)
            write_c_header(found, 0.1, tmp_path / "model.h")
            write_matlab(found, tmp_path / "model.m")
        except TridentifyError as error:
            one_line(error)
        except Exception as error:
            raise AssertionError(f"seed {seed}: {error!r}") from error
