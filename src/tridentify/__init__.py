"""Three-model identification of continuous-time systems from sampled, noisy records.

>>> import tridentify
>>> tridentify.Structure(poles=2, zeros=0).names()
('a1', 'a0', 'b0')

Names are loaded when they are first used, so that the import itself stays quick.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # report, which asks here for the version, is a room too
    from tridentify import (
        data,
        excitation,
        export,
        fleet,
        online,
        physical,
        plots,
        studies,
        uncertainty,
    )
    from tridentify.errors import (
        ConvergenceError,
        DataError,
        IdentifiabilityError,
        MissingDependencyError,
        OutputPathError,
        StructureError,
        TridentifyError,
    )
    from tridentify.estimation.answer.estimate import Estimate, Parameter, Status, Trace
    from tridentify.estimation.answer.finding import Finding
    from tridentify.estimation.methods.closed_loop.projection import Projection
    from tridentify.estimation.methods.closed_loop.simulated_instruments import (
        ClosedLoopRefinedInstrumentalVariable,
    )
    from tridentify.estimation.methods.closed_loop.two_stage import TwoStage
    from tridentify.estimation.methods.filtered.asymptotic_bias import asymptotic_bias
    from tridentify.estimation.methods.filtered.bias_compensated_least_squares import (
        BiasCompensatedLeastSquares,
    )
    from tridentify.estimation.methods.filtered.refined_instrumental_variable import (
        RefinedInstrumentalVariable,
    )
    from tridentify.estimation.methods.filtered.svf_instrumental_variable import (
        SvfInstrumentalVariable,
    )
    from tridentify.estimation.methods.filtered.svf_least_squares import SvfLeastSquares
    from tridentify.estimation.methods.output_error import OutputError
    from tridentify.estimation.methods.three_model import ThreeModel
    from tridentify.identify import METHODS, identify
    from tridentify.judgement.advice import (
        Advice,
        FrequencyResponse,
        advise,
        find_manoeuvres,
        frequency_response,
    )
    from tridentify.judgement.comparison import Comparison, compare
    from tridentify.judgement.selection import Selection, select_structure
    from tridentify.judgement.validation import Validation, validate
    from tridentify.models.simulate import simulate
    from tridentify.options import from_options, list_options
    from tridentify.record.formats.frames import frame_from_record, record_from_frame
    from tridentify.record.formats.read import list_channels, read_record, read_records
    from tridentify.record.formats.roles import guess_roles
    from tridentify.record.formats.series import read_series
    from tridentify.record.long_record import LongRecord, open_record
    from tridentify.record.record import Record
    from tridentify.structure import Structure
    from tridentify.transfer_function import TransferFunction

__version__ = "0.1.0"

__all__ = [
    "METHODS",
    "Advice",
    "BiasCompensatedLeastSquares",
    "ClosedLoopRefinedInstrumentalVariable",
    "Comparison",
    "ConvergenceError",
    "DataError",
    "Estimate",
    "Finding",
    "FrequencyResponse",
    "IdentifiabilityError",
    "LongRecord",
    "MissingDependencyError",
    "OutputError",
    "OutputPathError",
    "Parameter",
    "Projection",
    "Record",
    "RefinedInstrumentalVariable",
    "Selection",
    "Status",
    "Structure",
    "StructureError",
    "SvfInstrumentalVariable",
    "SvfLeastSquares",
    "ThreeModel",
    "Trace",
    "TransferFunction",
    "TridentifyError",
    "TwoStage",
    "Validation",
    "__version__",
    "advise",
    "asymptotic_bias",
    "compare",
    "data",
    "excitation",
    "export",
    "find_manoeuvres",
    "fleet",
    "frame_from_record",
    "frequency_response",
    "from_options",
    "guess_roles",
    "identify",
    "list_channels",
    "list_options",
    "online",
    "open_record",
    "physical",
    "plots",
    "read_record",
    "read_records",
    "read_series",
    "record_from_frame",
    "report",
    "select_structure",
    "simulate",
    "studies",
    "uncertainty",
    "validate",
]

_HOMES = {
    "errors": "ConvergenceError DataError IdentifiabilityError MissingDependencyError "
    "OutputPathError StructureError TridentifyError",
    "estimation.answer.estimate": "Estimate Parameter Status Trace",
    "estimation.answer.finding": "Finding",
    "estimation.methods.closed_loop.projection": "Projection",
    "estimation.methods.closed_loop.simulated_instruments": "ClosedLoopRefinedInstrumentalVariable",
    "estimation.methods.closed_loop.two_stage": "TwoStage",
    "estimation.methods.filtered.asymptotic_bias": "asymptotic_bias",
    "estimation.methods.filtered.bias_compensated_least_squares": "BiasCompensatedLeastSquares",
    "estimation.methods.filtered.refined_instrumental_variable": "RefinedInstrumentalVariable",
    "estimation.methods.filtered.svf_instrumental_variable": "SvfInstrumentalVariable",
    "estimation.methods.filtered.svf_least_squares": "SvfLeastSquares",
    "estimation.methods.output_error": "OutputError",
    "estimation.methods.three_model": "ThreeModel",
    "identify": "METHODS identify",
    "judgement.advice": "Advice FrequencyResponse advise find_manoeuvres frequency_response",
    "judgement.comparison": "Comparison compare",
    "judgement.selection": "Selection select_structure",
    "judgement.validation": "Validation validate",
    "models.simulate": "simulate",
    "options": "from_options list_options",
    "record.formats.frames": "frame_from_record record_from_frame",
    "record.formats.read": "list_channels read_record read_records",
    "record.formats.roles": "guess_roles",
    "record.formats.series": "read_series",
    "record.long_record": "LongRecord open_record",
    "record.record": "Record",
    "structure": "Structure",
    "transfer_function": "TransferFunction",
}
_HOME = {name: home for home, names in _HOMES.items() for name in names.split()}
_ROOMS = frozenset(__all__).difference(_HOME, ["__version__"])
"""Rooms that are reached from here: ``tridentify.plots`` needs no import of its own."""


def __getattr__(name: str) -> Any:
    home = name if name in _ROOMS else _HOME.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"{__name__}.{home}")
    value = module if name in _ROOMS else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


class _Package(ModuleType):
    """A package in which a function keeps its name although a submodule has the same one.

    After `tridentify.identify` has been imported from anywhere, the import system binds the module
    to that name in the package, over the function. Such a binding is passed over here.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
