"""Every action as lines of Python and of the command line, to be copied."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from tridentify.app.options import DEFAULTS, checked, method_of, structure_of
from tridentify.structure import AutoStructure


def _arguments(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={value!r}" for name, value in values.items())


def _path(card: Mapping[str, Any]) -> str:
    return str(card["path"] or card["file"])


def record_in_python(card: Mapping[str, Any]) -> str:
    """Lines that make the records which a card describes."""
    between = {} if card["intersample"] == "auto" else {"intersample": card["intersample"]}
    references = {"references": card["references"]} if card["references"] else {}
    step = {"dt": card["given_dt"]} if card.get("given_dt") else {}
    asked = {"inputs": card["inputs"], "outputs": card["outputs"], **references, **between, **step}
    lines = [
        "from tridentify import read_record",
        "",
        f"record = read_record({_path(card)!r}, {_arguments(asked)})",
    ]
    for one in card["bad"]:
        start, end = (card["t0"] + one[side] for side in ("start", "end"))
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


def record_in_shell(card: Mapping[str, Any]) -> str:
    """A command line that looks at the record."""
    return shlex.join(["tridentify", "advise", *_source(card)])


def _source(card: Mapping[str, Any]) -> list[str]:
    words = [_path(card)]
    for option, role in (
        ("--input", "inputs"),
        ("--output", "outputs"),
        ("--reference", "references"),
    ):
        for name in card[role]:
            words += [option, name]
    if card["intersample"] != "auto":
        words += ["--intersample", card["intersample"]]
    if card.get("given_dt"):
        words += ["--dt", repr(card["given_dt"])]
    ranges = [one for one in card["ranges"] if one["use"] == "identify"]
    if len(ranges) == 1:
        words += ["--start", repr(card["t0"] + ranges[0]["start"])]
        words += ["--stop", repr(card["t0"] + ranges[0]["end"])]
    return words


def model_in_python(card: Mapping[str, Any], options: Mapping[str, Any]) -> str:
    """Lines that estimate the model again."""
    chosen = checked(options)
    structure, method = structure_of(chosen), method_of(chosen)
    if isinstance(structure, AutoStructure):
        asked = "Structure.auto()"
    else:
        terms = {
            name: getattr(structure, name)
            for name in ("delay", "offset", "drift", "initial_state", "fixed", "bounds", "priors")
            if chosen[name] != DEFAULTS[name]
        }
        plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in terms.items()}
        orders = {"poles": structure.poles, "zeros": structure.zeros}
        asked = f"Structure({_arguments({**orders, **plain})})"
    of = "pieces" if any(one["use"] == "identify" for one in card["ranges"]) else "record"
    name = type(method).__name__
    given = {key: chosen[key] for key in ("noise", "loss", "route") if chosen[key] != DEFAULTS[key]}
    return "\n".join(
        [
            f"from tridentify import Structure, {name}, identify",
            "",
            f"estimate = identify({of}, {asked}, {name}({_arguments(given)}))",
            "print(estimate.summary())",
        ]
    )


def model_in_shell(card: Mapping[str, Any], options: Mapping[str, Any]) -> str:
    """A command line that estimates the model again; several ranges are several commands' work."""
    chosen = checked(options)
    words = ["tridentify", "identify", *_source(card)]
    if chosen["poles"] != "auto":
        zeros = int(chosen["poles"]) - 1 if chosen["zeros"] == "auto" else int(chosen["zeros"])
        words += ["--poles", chosen["poles"], "--zeros", str(zeros)]
    names = {"initial_state": "--initial-state"}
    for name in ("delay", "offset", "drift", "initial_state", "noise", "loss", "method", "route"):
        if chosen[name] != DEFAULTS[name]:
            words += [names.get(name, f"--{name}"), chosen[name]]
    for name, option in (("fixed", "--fix"), ("bounds", "--bound"), ("priors", "--prior")):
        for part in filter(None, (one.strip() for one in chosen[name].split(","))):
            words += [option, part]
    line = shlex.join(words)
    several = len([one for one in card["ranges"] if one["use"] == "identify"]) > 1
    return f"# several ranges: one file each, then\n{line}" if several else line


def compare_in_python(cards: Sequence[Mapping[str, Any]], record: Mapping[str, Any]) -> str:
    """Lines that compare saved models on a record."""
    names = [f"Estimate.load({card['name'] + '.json'!r})" for card in cards]
    return "\n".join(
        [
            "from tridentify import Estimate, compare",
            record_in_python(record),
            f"print(compare([{', '.join(names)}], record).summary())",
        ]
    )


def compare_in_shell(cards: Sequence[Mapping[str, Any]], record: Mapping[str, Any]) -> str:
    """A command line that compares saved models on a record."""
    files = [f"{card['name']}.json" for card in cards]
    return shlex.join(["tridentify", "compare", *files, *_source(record)])
