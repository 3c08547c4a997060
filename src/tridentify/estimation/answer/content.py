"""What an estimate holds: its fields, and whether they belong together."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from tridentify.errors import DataError, ParameterNameError, ShapeError, shown
from tridentify.estimation.answer.encoding import LEFT_OUT, check_route
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.answer.parameter import Nuisance
from tridentify.estimation.answer.trace import Status, Trace, freeze_arrays
from tridentify.numerics.arrays import Array
from tridentify.record.checks.names import check_names, check_units
from tridentify.record.checks.samples import check_distinct
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

ROUTES = MappingProxyType(
    {
        "open-loop": "",
        "reference": "by the reference route: a controller was running, and only what of input and "
        "output follows the reference counts",
        "direct": "by the direct route: a controller was running and no reference is given, so "
        "that the noise has a model, on which the coefficients depend",
    }
)
"""Way that an estimate was reached -> what is told of it."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Content:
    """The fields of an `Estimate`, in the order of its files."""

    model: TransferFunction
    structure: Structure
    theta: Array
    names: tuple[str, ...]
    cov: Array
    noise_variance: Array
    fit: Array
    status: Status
    trace: Trace
    method: str
    n_samples: int
    nuisance: tuple[Nuisance, ...]
    degrees_of_freedom: int
    cost: float
    aicc: float
    condition: float
    gradient: float
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    units: Mapping[str, str]
    intersample: str
    dt: float | None
    record_fingerprint: str = ""
    findings: tuple[Finding, ...] = ()
    noise_model: tuple[Array, ...] = ()
    draws: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    loss: str = "squared"
    outliers: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 4)))
    call: str = ""
    errors: str = "likelihood"
    route: str = dataclasses.field(default="open-loop", metadata=LEFT_OUT)
    loop: LoopTaken | None = dataclasses.field(default=None, metadata=LEFT_OUT)
    noise_levels: tuple[Array, ...] = dataclasses.field(default=(), metadata=LEFT_OUT)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        self._freeze_noise_model()
        self._freeze_noise_levels()
        if not self.draws.size:
            object.__setattr__(self, "draws", np.zeros((0, len(self.names))))
            self.draws.setflags(write=False)
        if not self.outliers.size:
            object.__setattr__(self, "outliers", np.zeros((0, 4)))
            self.outliers.setflags(write=False)
        if self.errors not in ("likelihood", "scores"):
            raise DataError(
                f"found errors={self.errors!r}; expected 'likelihood' or 'scores'; name one of them"
            )
        check_route(self.route, ROUTES)
        self._check_shapes()
        self._check_names()
        object.__setattr__(self, "units", dict(self.units))

    def saying(self, **words: Any) -> Self:
        """With other findings, trace or call: the numbers are sound already."""
        found = object.__new__(type(self))
        found.__dict__.update(self.__dict__, **words)
        return found

    def _check_shapes(self) -> None:
        n_parameters, n_outputs = len(self.names), len(self.output_names)
        shapes: dict[str, tuple[int, ...]] = {"theta": (n_parameters,), "fit": (n_outputs,)}
        shapes |= {"cov": (n_parameters, n_parameters), "noise_variance": (n_outputs,)}
        for field, shape in shapes.items():
            if getattr(self, field).shape != shape:
                found = getattr(self, field).shape
                raise ShapeError(
                    f"found {field} of shape {found}; expected {shape}; order it as names"
                )

    def _check_names(self) -> None:
        """Names and units stand in tables, files and code: they are what the structure gives."""
        inputs, outputs = self.input_names, self.output_names
        check_names((*inputs, *outputs))
        check_distinct((*inputs, *outputs))
        check_units(self.units)
        # counted first: to name the coefficients of a billion poles takes for ever
        n = len(self.names)
        same = (
            len(outputs) * len(inputs) <= n
            and n == self.structure.n_parameters(len(outputs), len(inputs))
            and self.names == self.structure.names(inputs, outputs)
        )
        if not same:
            raise ParameterNameError(
                f"found the {n} coefficients {shown(self.names, 120)} of {len(outputs)} outputs "
                f"and {len(inputs)} inputs; expected those that Structure.names gives; correct them"
            )

    def _freeze_noise_levels(self) -> None:
        levels = tuple(np.array(one, dtype=np.float64).reshape(-1) for one in self.noise_levels)
        n_outputs = len(self.output_names)
        known = len(levels) in (0, len(self.nuisance))
        if not known or any(one.size != n_outputs or not np.all(one > 0) for one in levels):
            raise ShapeError(
                f"found {len(levels)} noise levels for {len(self.nuisance)} experiments; expected "
                "none, or for each a standard deviation above zero of every output; correct them"
            )
        for one in levels:
            one.setflags(write=False)
        object.__setattr__(self, "noise_levels", levels)

    def _freeze_noise_model(self) -> None:
        given = self.noise_model or (np.zeros(0),) * len(self.output_names)
        if len(given) != len(self.output_names):
            raise ShapeError(
                f"found {len(given)} noise models; expected {len(self.output_names)}, one an "
                "output; give an empty one for white noise"
            )
        model = tuple(np.array(a, dtype=np.float64).reshape(-1) for a in given)
        for a in model:
            a.setflags(write=False)
        object.__setattr__(self, "noise_model", model)
