"""What each channel of a file may be: by its name first, then by how it moves."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.record.formats.series import Series

Role = Literal["input", "output", "reference", "unused"]

REFERENCE = re.compile(
    r"^(r|ref|reference|set_?point|sp|target|desired|demand)\b|(_|\b)(ref|sp|cmd_?ref|setpoint|target|desired|des)$",
    re.I,
)
INPUT = re.compile(
    r"^(u\d*|input\d*|in\d*|x_?in|cmd|command|delta.*|elev.*|ail.*|rud.*|thr.*|stick.*|flap.*|canard.*|"
    r"volt.*|v_?in|pwm.*|duty.*|torque.*|force.*|current.*|heater.*|q\d+_?heater|valve.*|pump.*|"
    r"power.*|motor.*|act.*|actuator.*|drive.*|load.*|q1|q2)$|(_|\b)(cmd|command|input|in)$",
    re.I,
)
KNOWN = re.compile(r"(_|\b)(true|truth|exact|noise_?free)$", re.I)
"""Names of what a simulation knows and nobody measures."""
FEW_LEVELS = 0.02
"""Different values of a channel, as a share of its samples, below which it is made rather than
measured: a sequence of steps."""
LARGEST_SHARE = 10_000
"""Samples that are looked at."""


def guessed(channels: Sequence[Series]) -> list[Role]:
    """A role for every channel, with an input and an output where there are two channels.

    Parameters
    ----------
    channels : sequence of Series

    Returns
    -------
    list of {"input", "output", "reference", "unused"}
    """
    roles: list[Role] = [_by_name(one.channel.name) for one in channels]
    moving = [_moves(one.values) for one in channels]
    roles = [role if moves else "unused" for role, moves in zip(roles, moving, strict=True)]
    if "input" not in roles:
        made = [
            k for k, one in enumerate(channels) if roles[k] == "output" and _is_made(one.values)
        ]
        chosen = made or [k for k, role in enumerate(roles) if role == "output"]
        if chosen and roles.count("output") > 1:
            roles[chosen[0]] = "input"
    if "output" not in roles and roles.count("input") > 1:
        roles[len(roles) - 1 - roles[::-1].index("input")] = "output"
    return roles


def _by_name(name: str) -> Role:
    bare = name.rsplit(".", 1)[-1].strip()
    if KNOWN.search(bare):
        return "unused"
    if REFERENCE.search(bare):
        return "reference"
    return "input" if INPUT.search(bare) else "output"


def _moves(values: Array) -> bool:
    seen = values[np.isfinite(values)]
    return bool(seen.size > 1 and np.ptp(seen) > 0.0)


def _is_made(values: Array) -> bool:
    seen = values[np.isfinite(values)][:LARGEST_SHARE]
    return bool(np.unique(seen).size <= max(3, FEW_LEVELS * seen.size))
