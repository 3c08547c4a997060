"""The state of an on-line estimator: a plain value."""

from __future__ import annotations

import base64
import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tridentify.encoding import load_document, save_document
from tridentify.errors import TridentifyError
from tridentify.numerics.realization import Complex
from tridentify.online.blueprint import Blueprint, Nuisance, Setting
from tridentify.online.flags import Flag
from tridentify.online.kernels import slots
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

Array = NDArray[np.float64]

SCHEMA = 1
KEY = "online_state"
_NOT_READY = Flag.NOT_READY.value


class Maker(Protocol):
    """What a state asks of the estimator that made it."""

    def to_dict(self) -> dict[str, Any]:
        """Name and options, ready for JSON."""

    def size_of(self, setting: Setting, blueprint: Blueprint) -> int:
        """Length of the vector that goes with a blueprint."""


MAKERS: dict[str, type[Any]] = {}
"""Name -> class of the estimators, each entered where it is defined."""


@dataclass(frozen=True, eq=False)
class Stage:
    """What holds between two events of an estimator.

    Attributes
    ----------
    method : Estimator
    setting : Setting
    blueprint : Blueprint
    poles : (n,) complex array
        Of the model, as last solved for; empty before the first time.
    past : tuple of (k, n_inputs + n_outputs + 1) arrays
        Samples that are kept: interval, inputs, outputs.
    changes : tuple of int
        Samples at which the coefficients were found to have moved.
    searching : bool
        Whether a model is still looked for.
    extra : tuple of arrays
        What else a method keeps.
    """

    method: Any
    setting: Setting
    blueprint: Blueprint
    poles: Complex
    past: tuple[Array, ...] = ()
    changes: tuple[int, ...] = ()
    searching: bool = True
    extra: tuple[Array, ...] = ()

    def but(self, **changes: Any) -> Stage:
        """A copy with other values."""
        return dataclasses.replace(self, **changes)


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
        stage, setting = self.stage, self.stage.setting
        document = {
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
            "values": packed(self.values),
        }
        return save_document(path, KEY, SCHEMA, document)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> State:
        """Read what `save` wrote.

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
        return load_document(path, KEY, SCHEMA, _checked, "state", "State")


def packed(values: Array) -> str:
    """Every bit of an array as text."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode("ascii")


def unpacked(text: str) -> Array:
    """The array that `packed` was given."""
    return np.frombuffer(base64.b64decode(text, validate=True), dtype="<f8").astype(np.float64)


def method_from_dict(document: Mapping[str, Any]) -> Maker:
    """The estimator that ``to_dict`` described.

    Raises
    ------
    KeyError, TypeError, ValueError
        There is no such estimator, or it has no such options.
    """
    options: dict[str, Any] = {}
    for key, value in document["options"].items():
        if isinstance(value, Mapping) and "transfer_function" in value:
            value = TransferFunction.from_dict(value["transfer_function"])
        elif isinstance(value, Mapping):
            value = dict(value["mapping"])
        elif isinstance(value, list):
            value = tuple(value)
        options[key] = value
    made: Maker = MAKERS[document["name"]](**options)
    return made


def _checked(document: dict[str, Any]) -> State:
    try:
        return _build(document)
    except (IndexError, OverflowError, TridentifyError) as error:
        raise ValueError(str(error)) from error


def _build(document: Mapping[str, Any]) -> State:
    setting = Setting(
        Structure.from_dict(document["structure"]),
        float.fromhex(document["dt"]),
        tuple(document["input_names"]),
        tuple(document["output_names"]),
        tuple((str(k), str(v)) for k, v in document["units"].items()),
        str(document["intersample"]),
    )
    ints = np.array(document["ints"], dtype=np.int64)
    values = unpacked(document["values"])
    blueprint = Blueprint(
        ints,
        unpacked(document["constants"]),
        values.size,
        unpacked(document["bank"]).view(np.complex128),
        Nuisance(*document["nuisance"]),
    )
    width = setting.n_inputs + setting.n_outputs + 1
    method = method_from_dict(document["method"])
    expected = method.size_of(setting, blueprint)
    if (ints.size, values.size) != (slots.N_INTS, expected) or ints.min() < 0:
        raise ValueError(f"{values.size} numbers in place of {expected}")
    stage = Stage(
        method,
        setting,
        blueprint,
        unpacked(document["poles"]).view(np.complex128),
        tuple(unpacked(one).reshape(-1, width) for one in document["past"]),
        tuple(int(k) for k in document["changes"]),
        bool(document["searching"]),
        tuple(unpacked(one) for one in document["extra"]),
    )
    return State(values, stage)
