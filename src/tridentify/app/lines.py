"""Every action as lines of Python and of the command line, to be copied."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from tridentify.app.plain import saved_as
from tridentify.options import (
    DEFAULTS,
    GIVEN_TO_METHOD,
    checked,
    known_parameters,
    list_options,
    method_of,
    structure_of,
)
from tridentify.physical import MODELS, PhysicalModel
from tridentify.physical.channels import match_channels
from tridentify.structure import AutoStructure, Structure

SWITCHES = {one.name: one.switch for one in list_options()}
PLAIN_TERMS = ("delay", "offset", "drift", "initial_state")
KNOWLEDGE = ("fixed", "bounds", "priors")
IN_STRUCTURE = (*PLAIN_TERMS, *KNOWLEDGE)
RESULT = "result"
"""The folder that `tridentify identify` writes where something is to be done with the model."""


def _arguments(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={value!r}" for name, value in values.items())


def _path(card: Mapping[str, Any]) -> str:
    return str(card["path"] or card["file"])


def record_in_python(card: Mapping[str, Any]) -> str:
    """Lines that make the records which a card describes."""
    behaviour = {} if card["intersample"] == "auto" else {"intersample": card["intersample"]}
    references = {"references": card["references"]} if card["references"] else {}
    step = {"dt": card["given_dt"]} if card.get("given_dt") else {}
    roles = {"inputs": card["inputs"], "outputs": card["outputs"], **references}
    lines = [
        "from tridentify import read_record",
        "",
        f"record = read_record({_path(card)!r}, {_arguments({**roles, **behaviour, **step})})",
    ]
    for start, end in _left_out(card):
        lines.append(f"record = record.mask((record.t >= {start!r}) & (record.t <= {end!r}))")
    for use, name in (("identify", "pieces"), ("validate", "other")):
        chosen = [one for one in card["ranges"] if one["use"] == use]
        if chosen:
            cuts = ", ".join(
                f"record.slice({card['t0'] + one['start']!r}, {card['t0'] + one['end']!r})"
                for one in chosen
            )
            lines.append(f"{name} = [{cuts}]")
    return "\n".join(lines)


def look_in_python(card: Mapping[str, Any]) -> str:
    """Lines that read the record, check it, and look for its manoeuvres."""
    of = "pieces" if _identified(card) else "record"
    return "\n".join(
        [
            record_in_python(card),
            "",
            "from tridentify import advise, find_manoeuvres",
            "",
            f"print(advise({of}).summary())",
            "for one in find_manoeuvres(record):",
            "    print(one.start, one.stop, one.why)",
        ]
    )


def record_in_shell(card: Mapping[str, Any]) -> str:
    """Command lines that check the record, and look for its manoeuvres."""
    whole = {**card, "ranges": []}
    return "\n".join(
        [
            shlex.join(["tridentify", "advise", *_source(card)]),
            shlex.join(["tridentify", "manoeuvres", *_source(whole)]),
        ]
    )


def _source(card: Mapping[str, Any]) -> list[str]:
    """Files, channels, bad samples and ranges of a command."""
    words = [_path(card)]
    for option, role in (
        ("--input", "inputs"),
        ("--output", "outputs"),
        ("--reference", "references"),
    ):
        for name in card[role]:
            words += [option, name]
    return words + _sampling(card)


def _sampling(card: Mapping[str, Any]) -> list[str]:
    words: list[str] = []
    if card["intersample"] != "auto":
        words += ["--intersample", card["intersample"]]
    if card.get("given_dt"):
        words += ["--dt", repr(card["given_dt"])]
    t0 = card["t0"]
    for start, end in _left_out(card):
        words += ["--mask", f"{start!r}:{end!r}"]
    ranges = [(t0 + one["start"], t0 + one["end"]) for one in _identified(card)]
    if len(ranges) == 1:
        return [*words, "--from", repr(ranges[0][0]), "--to", repr(ranges[0][1])]
    for start, end in ranges:
        words += ["--range", f"{start!r}:{end!r}"]
    return words


def _left_out(card: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Stretches of bad samples, each once [s, on the clock of the file]."""
    stretches = dict.fromkeys((one["start"], one["end"]) for one in card["bad"])
    return [(card["t0"] + start, card["t0"] + end) for start, end in stretches]


def _of_use(card: Mapping[str, Any], use: str) -> list[Any]:
    return [one for one in card["ranges"] if one["use"] == use]


def _identified(card: Mapping[str, Any]) -> list[Any]:
    return _of_use(card, "identify")


def between(card: Mapping[str, Any], chosen: Mapping[str, str]) -> Mapping[str, Any]:
    """The card with what an estimate takes the input for between its samples."""
    if chosen["intersample"] == "as the record":
        return card
    return {**card, "intersample": chosen["intersample"]}


def model_in_python(card: Mapping[str, Any], options: Mapping[str, Any]) -> str:
    """Lines that read the record and estimate the model again, with its physical map."""
    chosen = checked(options)
    structure, method = structure_of(chosen), method_of(chosen)
    if isinstance(structure, AutoStructure):
        asked = f"Structure.auto({_arguments(_terms(structure.template, chosen))})"
    else:
        orders = {"poles": structure.poles, "zeros": structure.zeros}
        asked = f"Structure({_arguments({**orders, **_terms(structure, chosen)})})"
    of = "pieces" if _identified(card) else "record"
    name = type(method).__name__
    given = {key: chosen[key] for key in GIVEN_TO_METHOD if chosen[key] != DEFAULTS[key]}
    lines = [
        record_in_python(between(card, chosen)),
        "",
        f"from tridentify import Structure, {name}, identify",
        "",
        f"estimate = identify({of}, {asked}, {name}({_arguments(given)}))",
        "print(estimate.summary())",
    ]
    if _of_use(card, "validate"):
        lines += ["", "from tridentify import validate", ""]
        lines += ["print(validate(estimate, other).summary())"]
    if chosen["physical"] != "none":
        lines += [
            "",
            "from tridentify.physical import MODELS, estimate_physical",
            "",
            f"model = MODELS[{chosen['physical']!r}]()",
            f"known = {known_parameters(chosen)!r}",
            f"channels = {_columns(chosen['physical'], card)!r}",
            f"print(estimate_physical(model, {of}, known=known, channels=channels).summary())",
        ]
    return "\n".join(lines)


def _terms(structure: Structure, chosen: Mapping[str, str]) -> dict[str, Any]:
    terms = {name: getattr(structure, name) for name in IN_STRUCTURE if _differs(chosen, name)}
    return {name: dict(one) if isinstance(one, Mapping) else one for name, one in terms.items()}


def _differs(chosen: Mapping[str, str], name: str) -> bool:
    return chosen[name] != DEFAULTS[name]


def model_in_shell(card: Mapping[str, Any], options: Mapping[str, Any]) -> str:
    """A command line that estimates the model again, and one for its physical map."""
    chosen = checked(options)
    own = between(card, chosen)
    words = ["tridentify", "identify", *_source(own)]
    if chosen["poles"] != "auto":
        zeros = int(chosen["poles"]) - 1 if chosen["zeros"] == "auto" else int(chosen["zeros"])
        words += ["--poles", chosen["poles"], "--zeros", str(zeros)]
    for name in (*PLAIN_TERMS, *GIVEN_TO_METHOD, "method"):
        if _differs(chosen, name):
            words += [SWITCHES[name], chosen[name]]
    for name in KNOWLEDGE:
        words += _each(name, chosen)
    tested = _validated_in_shell(own)
    if tested:
        words += ["--out", RESULT]
    lines = [shlex.join(words), *tested]
    if chosen["physical"] != "none":
        lines.append(_physical_in_shell(own, chosen))
    return "\n".join(lines)


def _validated_in_shell(card: Mapping[str, Any]) -> list[str]:
    """A command for the ranges that validate."""
    chosen = [{**one, "use": "identify"} for one in _of_use(card, "validate")]
    if not chosen:
        return []
    words = ["tridentify", "validate", f"{RESULT}/model.json"]
    return [shlex.join([*words, *_source({**card, "ranges": chosen})])]


def _each(name: str, chosen: Mapping[str, str]) -> list[str]:
    """A switch before every part of a text that names several."""
    parts = filter(None, (one.strip() for one in re.split(r"[,;]", chosen[name])))
    return [word for part in parts for word in (SWITCHES[name], part.replace(" ", ""))]


def _physical_in_shell(card: Mapping[str, Any], chosen: Mapping[str, str]) -> str:
    model = MODELS[chosen["physical"]]()
    columns = _columns(chosen["physical"], card)
    words = ["tridentify", "physical", _path(card), "--model", chosen["physical"]]
    for option, names in (("--input", model.input_names), ("--output", model.output_names)):
        for name in names:
            words += [option, f"{name}={columns[name]}"]
    return shlex.join([*words, *_sampling(card), *_each("known", chosen)])


def _columns(name: str, card: Mapping[str, Any]) -> dict[str, str]:
    """Columns of the channels of a map; see `columns_of`."""
    return columns_of(MODELS[name](), card["inputs"], card["outputs"])


def columns_of(
    model: PhysicalModel, inputs: Sequence[str], outputs: Sequence[str]
) -> dict[str, str]:
    """Channels of a map by their names (`match_channels`); one that has no column keeps its own."""
    own = {name: name for name in (*model.input_names, *model.output_names)}
    return (
        own
        | match_channels(model.input_names, inputs)
        | match_channels(model.output_names, outputs)
    )


def export_in_python(name: str, card: Mapping[str, Any], dt: float) -> str:
    """Lines that write the files of a saved model; ``dt`` [s] of the filter in C."""
    stem = saved_as(name, "")
    of = "pieces" if _identified(card) else "record"
    return "\n".join(
        [
            "from pathlib import Path",
            "",
            "from tridentify import Estimate",
            "from tridentify.export import to_bytes",
            record_in_python(card),
            "# the model as Export wrote it: Model (JSON)",
            f"estimate = Estimate.load({stem + '.json'!r})",
            "for ending in ('.m', '.h', '.py', '.csv'):",
            f"    content = to_bytes(estimate, ending, dt={dt!r}, name={stem!r})",
            f"    Path({stem!r} + ending).write_bytes(content)",
            f"estimate.report({stem + '.html'!r}, {of})",
            f"estimate.plot({'pieces[0]' if of == 'pieces' else of}).savefig({stem + '.svg'!r})",
        ]
    )


def export_in_shell(name: str, dt: float) -> str:
    """Command lines that write the files of a saved model."""
    stem = saved_as(name, "")
    filters = {".h": ["--dt", repr(dt), "--name", stem]}
    return "\n".join(
        shlex.join(
            ["tridentify", "export", f"{stem}.json", f"{stem}{ending}", *filters.get(ending, [])]
        )
        for ending in (".m", ".h", ".py", ".csv")
    )


def compared_card(
    record: Mapping[str, Any], inputs: Sequence[str], outputs: Sequence[str]
) -> dict[str, Any]:
    """The record as it is compared on: under the models' channels, on what validates, if any."""
    own = [one for one in record["ranges"] if one["use"] == "validate"] or record["ranges"]
    used = [{**one, "use": "identify"} for one in own]
    return {**record, "inputs": list(inputs), "outputs": list(outputs), "ranges": used}


def compare_in_python(cards: Sequence[Mapping[str, Any]], record: Mapping[str, Any]) -> str:
    """Lines that compare saved models on a record."""
    names = [f"Estimate.load({saved_as(card['name'], '.json')!r})" for card in cards]
    of = "pieces" if _identified(record) else "record"
    return "\n".join(
        [
            "from tridentify import Estimate, compare",
            record_in_python(record),
            "# the models as Export wrote them: Model (JSON)",
            f"print(compare([{', '.join(names)}], {of}).summary())",
        ]
    )


def compare_in_shell(cards: Sequence[Mapping[str, Any]], record: Mapping[str, Any]) -> str:
    """A command line that compares saved models on a record."""
    files = [saved_as(card["name"], ".json") for card in cards]
    return shlex.join(["tridentify", "compare", *files, *_source(record)])
