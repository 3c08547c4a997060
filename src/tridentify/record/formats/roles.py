"""What each channel of a file may be: by its name first, then by how it moves."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tridentify.numerics.arrays import Array

Role = Literal["input", "output", "reference", "unused"]

REFERENCE = re.compile(
    r"^(ref|reference|set_?point|sp|target|desired|demand)(_|\b)|"
    r"(_|\b)(ref|sp|cmd_?ref|setpoint|target|desired|des)$",
    re.I,
)
INPUT = re.compile(
    r"^(u|input\d*|in\d*|x_?in|cmd|command|delta.*|elev.*|ail.*|rud.*|thr.*|stick.*|flap.*|canard.*|"
    r"volt.*|v_?in|pwm.*|duty.*|torque.*|force.*|current.*|heat.*|q\d+_?heater|valve.*|pump.*|"
    r"power.*|motor.*|act.*|actuator.*|drive.*|load.*|steer.*|fuel.*|q1|q2)$|"
    r"(_|\b)(cmd|command|input|in|valve|heater|pump|pwm|duty)\d*$",
    re.I,
)
LETTER_INPUT = re.compile(r"^u(\d|_(?!m_?s|mps|m/s|kt|kn|ft))", re.I)
"""A name that begins as the inputs of textbooks do, and is no speed along the body axis."""
LETTER_OUTPUT = re.compile(r"^y(\d|_|$)", re.I)
LETTER_REFERENCE = re.compile(r"^r(\d|_|$)", re.I)
"""A set point beside outputs that are called y; alone, r is as often a yaw rate."""
CLOCK = re.compile(
    r"^(t|time|timestamp|time_?stamp|epoch|clock|date|datetime|zeit|index|idx|sample|samples|row|"
    r"frame|counter|n|k|no)$|^(t|time|zeit)_|(_|\b)(t|time|timestamp|stamp)$",
    re.I,
)
"""What logs call their clocks and counters, of which one alone is the time of the samples."""
KNOWN = re.compile(r"(_|\b)(true|truth|exact|noise_?free)$", re.I)
"""Names of what a simulation knows and nobody measures."""
FEW_LEVELS = 0.02
"""Different values of a channel, as a share of its samples, below which it is made rather than
measured: a sequence of steps."""
MOST_OUTPUTS = 2
"""Outputs that are all taken at first."""
LARGEST_SHARE = 10_000
"""Samples that are looked at."""


def guess_roles(names: Sequence[str], samples: Sequence[ArrayLike]) -> list[Role]:
    """What each channel of a file may be: by its name first, then by how it moves.

    A guess to begin with, for whoever looks at a file of which nothing else is known. Where two
    channels move, there is an input and an output among them; of many outputs the first is taken,
    with those that are numbered like it.

    Parameters
    ----------
    names : sequence of str
    samples : sequence of (n,) array
        Of each channel; nan where one is missing.

    Returns
    -------
    list of {"input", "output", "reference", "unused"}

    Examples
    --------
    >>> t = np.arange(100.0)
    >>> guess_roles(["elevator", "q", "q_true"], [np.sign(np.sin(t)), np.cos(t), np.cos(t)])
    ['input', 'output', 'unused']
    """
    bare = [name.rsplit(".", 1)[-1].strip() for name in names]
    values = [np.asarray(own, dtype=float) for own in samples]
    lettered = any(LETTER_OUTPUT.search(name) for name in bare)
    roles: list[Role] = [
        _by_name(name, lettered) if _moves(own) and not _is_clock(name, own) else "unused"
        for name, own in zip(bare, values, strict=True)
    ]
    if "input" not in roles:
        possible = [k for k, role in enumerate(roles) if role == "output"]
        made = [k for k in possible if _is_made(values[k])]
        chosen = made if 0 < len(made) < len(possible) else possible[:1]
        for k in chosen if len(possible) > 1 else ():
            roles[k] = "input"
    if "output" not in roles and roles.count("input") > 1:
        roles[len(roles) - 1 - roles[::-1].index("input")] = "output"
    return _few_outputs(roles, bare)


def _few_outputs(roles: Sequence[Role], names: Sequence[str]) -> list[Role]:
    """Of many outputs the first alone, with those that are numbered like it.

    A model of all that was recorded at once is seldom what is asked for first.
    """
    outputs = [k for k, role in enumerate(roles) if role == "output"]
    if len(outputs) <= MOST_OUTPUTS:
        return list(roles)
    stem = _stem(names[outputs[0]])
    kept = {outputs[0], *(k for k in outputs if stem and _stem(names[k]) == stem)}
    return ["unused" if k in outputs and k not in kept else role for k, role in enumerate(roles)]


def _stem(name: str) -> str:
    """A name without the number that it ends with; empty where there is none."""
    match = re.fullmatch(r"(.*?\D)\d+", name)
    return match[1] if match else ""


def _by_name(bare: str, lettered: bool) -> Role:
    if KNOWN.search(bare):
        return "unused"
    if REFERENCE.search(bare) or (lettered and LETTER_REFERENCE.search(bare)):
        return "reference"
    if LETTER_OUTPUT.search(bare):
        return "output"
    return "input" if INPUT.search(bare) or LETTER_INPUT.search(bare) else "output"


def _moves(values: Array) -> bool:
    seen = values[np.isfinite(values)]
    return bool(seen.size > 1 and np.ptp(seen) > 0.0)


def _is_clock(name: str, values: Array) -> bool:
    """Whether a channel counts the time or the samples once more."""
    return bool(CLOCK.search(name) and np.all(np.diff(values[:LARGEST_SHARE]) > 0.0))


def _is_made(values: Array) -> bool:
    seen = values[np.isfinite(values)][:LARGEST_SHARE]
    return bool(np.unique(seen).size <= max(3, FEW_LEVELS * seen.size))
