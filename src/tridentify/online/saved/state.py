"""The state of an on-line estimator: a plain value.

What may be wrong with the samples or with what they say.
"""

from __future__ import annotations

import base64
import dataclasses
import enum
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tridentify.errors import TridentifyError, shown
from tridentify.estimation.answer.encoding import load_document, save_document
from tridentify.numerics.arrays import Array
from tridentify.online.kernels import slots
from tridentify.online.layout import DOUBTS, Blueprint, Doubt, NuisanceColumns, Setting, Stage
from tridentify.online.saved.integrity import MOST_ORDER, check_orders, check_room, check_sound
from tridentify.record.checks.values import check_keys, checked, texts
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction


class Flag(enum.Flag):
    """What a sample, or the samples of late, are found to be. Nothing is ``Flag(0)``.

    Examples
    --------
    >>> from tridentify import online
    >>> flags = online.Flag.STUCK | online.Flag.OUTLIER
    >>> online.Flag.STUCK in flags, bool(online.Flag(0))
    (True, False)
    >>> online.Flag.STUCK.words
    ('an output that stands still while the model moves; it is not used',)
    """

    MISSING_OUTPUT = enum.auto()
    MISSING_INPUT = enum.auto()
    JITTER = enum.auto()
    OUTLIER = enum.auto()
    STUCK = enum.auto()
    SATURATED = enum.auto()
    NOT_EXCITED = enum.auto()
    CHANGED = enum.auto()
    NOT_READY = enum.auto()

    @property
    def words(self) -> tuple[str, ...]:
        """What is the matter, a sentence for each flag."""
        return tuple(_WORDS[one] for one in self)


_WORDS = {
    Flag.MISSING_OUTPUT: "an output sample is missing",
    Flag.MISSING_INPUT: "an input sample is missing; the one before is held",
    Flag.JITTER: "the time since the sample before is not the sampling interval",
    Flag.OUTLIER: "an output far from what is expected of it; it is not used",
    Flag.STUCK: "an output that stands still while the model moves; it is not used",
    Flag.SATURATED: "an output at its limit while the model is beyond; it is not used",
    Flag.NOT_EXCITED: "the input tells nothing new of some combination of coefficients",
    Flag.CHANGED: "the coefficients have moved",
    Flag.NOT_READY: "the samples so far do not determine the coefficients",
}


SCHEMA = 1
"""Version of the file format."""
KEY = "online_state"
KEYS = (
    "method", "structure", "dt", "input_names", "output_names", "units", "intersample", "nuisance",
    "ints", "constants", "bank", "poles", "past", "changes", "searching", "extra", "doubt",
    "values",
)  # fmt: skip
_NOT_READY = Flag.NOT_READY.value


MAKERS: dict[str, type[Any]] = {}
"""Name -> class of the estimators, each entered where it is defined."""


class State(NamedTuple):
    """All that an estimator knows: numbers, and the stage that says what they mean.

    Attributes
    ----------
    values : array
        Never changed in place: every step gives a new one.
    stage : Stage

    Examples
    --------
    >>> from tridentify import Structure, online
    >>> state = online.ThreeModel().init(Structure(1, 0), dt=0.1)
    >>> state, innovation = online.ThreeModel().step(state, 1.0, 0.0)
    >>> state.n_samples, state.flags
    (1, <Flag.NOT_READY: 256>)
    """

    values: Array
    stage: Stage

    @property
    def n_samples(self) -> int:
        """Samples taken in so far."""
        return int(self.values[slots.COUNT])

    @property
    def time(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.values[slots.TIME])

    @property
    def flags(self) -> Flag:
        """What is the matter now."""
        waiting = 0 if self.stage.method.is_ready(self) else _NOT_READY
        return Flag((int(self.values[slots.FLAGS]) & ~_NOT_READY) | waiting)

    @property
    def seen(self) -> Flag:
        """Everything that was the matter since the beginning, but for not being ready."""
        return Flag(int(self.values[slots.SEEN])) | (self.flags & ~Flag.NOT_READY)

    @property
    def changes(self) -> tuple[int, ...]:
        """Samples, counted from zero, at which the coefficients were found to have moved."""
        return self.stage.changes

    @property
    def method(self) -> Any:
        """The estimator that made it."""
        return self.stage.method

    @property
    def structure(self) -> Structure:
        """What is estimated."""
        return self.stage.setting.structure

    @property
    def dt(self) -> float:
        """Sampling interval [s]."""
        return self.stage.setting.dt

    @property
    def input_names(self) -> tuple[str, ...]:
        """Of the inputs."""
        return self.stage.setting.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        """Of the outputs."""
        return self.stage.setting.output_names

    @property
    def innovations(self) -> Array:
        """(n_outputs,) of the last sample; ``nan`` where there is none."""
        ints = self.stage.blueprint.ints
        at = int(ints[slots.AT_WATCH]) + slots.INNOVATION
        return self.values[at :: int(ints[slots.WATCH])][: int(ints[slots.OUTPUTS])].copy()

    @property
    def noise_std(self) -> Array:
        """(n_outputs,) standard deviation of the noise, robust [unit of the output]."""
        ints = self.stage.blueprint.ints
        at = int(ints[slots.AT_WATCH]) + slots.SCALE
        return self.values[at :: int(ints[slots.WATCH])][: int(ints[slots.OUTPUTS])].copy()

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the state as JSON, whole or not at all; every bit is kept.

        Parameters
        ----------
        path : str or path

        Returns
        -------
        Path

        Raises
        ------
        OutputPathError
            The file cannot be written.
        """
        return save_document(path, KEY, SCHEMA, self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain values, ready for JSON; every bit is kept."""
        stage, setting = self.stage, self.stage.setting
        return {
            "method": stage.method.to_dict(),
            "structure": setting.structure.to_dict(),
            "dt": setting.dt.hex(),
            "input_names": list(setting.input_names),
            "output_names": list(setting.output_names),
            "units": dict(setting.units),
            "intersample": setting.intersample,
            "nuisance": [bool(one) for one in stage.blueprint.nuisance],
            "ints": stage.blueprint.ints.tolist(),
            "constants": packed(stage.blueprint.constants),
            "bank": packed(stage.blueprint.poles.view(np.float64)),
            "poles": packed(stage.poles.view(np.float64)),
            "past": [packed(one.ravel()) for one in stage.past],
            "changes": list(stage.changes),
            "searching": stage.searching,
            "extra": [packed(one) for one in stage.extra],
            "doubt": None if stage.doubt is None else [stage.doubt.code, stage.doubt.share.hex()],
            "values": packed(self.values),
        }

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> State:
        """Read what `save` wrote.

        The file may come from a stranger: what no estimator can have come to is refused.

        Parameters
        ----------
        path : str or path

        Raises
        ------
        UnreadableFileError
            There is no such file, or it is not JSON.
        DataError
            It is damaged, or of another version.
        """
        return load_document(path, KEY, SCHEMA, cls.from_dict, "state", "State")

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> State:
        """Undo `to_dict`.

        Raises
        ------
        ValueError
            No estimator can have come to such a state.
        """
        try:
            with np.errstate(all="ignore"):
                return _build(document)
        except RecursionError as error:
            raise ValueError("values nested too deeply") from error
        except (
            ArithmeticError, AttributeError, LookupError, MemoryError, TypeError, ValueError,
            TridentifyError,
        ) as error:  # fmt: skip
            raise ValueError(shown(str(error), 200)) from error


def packed(values: Array) -> str:
    """Every bit of an array as text."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode("ascii")


def unpacked(text: object) -> Array:
    """The array that `packed` was given."""
    data = base64.b64decode(checked(text, str), validate=True)
    return np.frombuffer(data, dtype="<f8").astype(np.float64)


def method_from_dict(document: Mapping[str, Any]) -> Any:
    """The estimator that ``to_dict`` described.

    Raises
    ------
    KeyError, TypeError, ValueError
        There is no such estimator, or it has no such options.
    """
    check_keys(document, ("name", "options"))
    cls = MAKERS[checked(document["name"], str)]
    check_keys(document["options"], [field.name for field in dataclasses.fields(cls)])
    options: dict[str, Any] = {}
    for key, value in document["options"].items():
        _check_lengths(value)
        if isinstance(value, Mapping) and "transfer_function" in value:
            value = TransferFunction.from_dict(value["transfer_function"])
        elif isinstance(value, Mapping):
            value = dict(value["mapping"])
        elif isinstance(value, list):
            value = tuple(value)
        options[key] = value
    return cls(**options)


def _build(document: Mapping[str, Any]) -> State:
    check_keys(document, KEYS)
    method = method_from_dict(document["method"])
    setting = _setting_of(document, method)
    ints, values = np.array(_ints(document["ints"]), dtype=np.int64), unpacked(document["values"])
    if ints.size != slots.N_INTS:
        raise ValueError(f"{ints.size} numbers in the plan in place of {slots.N_INTS}")
    nuisance = NuisanceColumns(*(checked(one, bool) for one in checked(document["nuisance"], list)))
    bank = unpacked(document["bank"]).view(np.complex128)
    blueprint = Blueprint(ints, unpacked(document["constants"]), values.size, bank, nuisance)
    check_room(setting, blueprint, shared=method.one_triangle)
    rebuilt = method.rebuilt(setting, blueprint)
    width = setting.n_inputs + setting.n_outputs + 1
    stage = Stage(
        method,
        setting,
        blueprint,
        unpacked(document["poles"]).view(np.complex128),
        tuple(unpacked(one).reshape(-1, width) for one in checked(document["past"], list)),
        tuple(_ints(document["changes"])),
        checked(document["searching"], bool),
        tuple(unpacked(one) for one in checked(document["extra"], list)),
        doubt=_doubt_of(document["doubt"]),
    )
    check_sound(stage, values, rebuilt)
    return State(values, stage)


def _doubt_of(value: object) -> Doubt | None:
    """What spoke against the model: a code that there is, and a share."""
    if value is None:
        return None
    code, share = (checked(one, str) for one in checked(value, list))
    found = Doubt(code, float.fromhex(share))
    if code not in DOUBTS or not 0.0 <= found.share <= 1.0:
        raise ValueError(f"{shown(code, 40)} with a share of {found.share:g} for a doubt")
    return found


def _setting_of(document: Mapping[str, Any], method: Any) -> Setting:
    """What the estimator was told, checked as if it were told now."""
    inputs, outputs = texts(document["input_names"]), texts(document["output_names"])
    structure = checked(document["structure"], dict)
    check_orders(structure["poles"], structure["zeros"], len(inputs), len(outputs))
    units = checked(document["units"], dict)
    dt, intersample = (checked(document[key], str) for key in ("dt", "intersample"))
    setting: Setting = method.setting(
        Structure.from_dict(structure), float.fromhex(dt), inputs, outputs, units, intersample
    )
    # as they were told, in their order
    return dataclasses.replace(setting, units=tuple(units.items()))


def _ints(values: object) -> list[int]:
    return [checked(value, int) for value in checked(values, list)]


def _check_lengths(value: object) -> None:
    """Roots of long polynomials take long."""
    if isinstance(value, (list, Mapping)):
        if len(value) > MOST_ORDER + 1:
            raise ValueError(f"an option of {len(value)} values; at most {MOST_ORDER + 1} can be")
        for inner in value.values() if isinstance(value, Mapping) else value:
            _check_lengths(inner)
