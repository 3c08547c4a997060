"""Estimated physical parameters with their covariance, and what the record says about them."""

from __future__ import annotations

import dataclasses
import os
import textwrap
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from tridentify.errors import PhysicalParameterError, ShapeError, UndeterminedError
from tridentify.estimation.answer.encoding import (
    check_covariance,
    decode,
    load_document,
    save_document,
)
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.parameter import Parameter
from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.numerics.arrays import Array
from tridentify.physical.model import PhysicalParameter, model_of
from tridentify.transfer_function import TransferFunction
from tridentify.writing.layout import format_std, format_table, format_value, html_table, p_in_words

SCHEMA = 1
AS_WELL = "these explain the record as well"
"""Beginning of a note of other values, one for each row of `PhysicalEstimate.alternatives`."""
_WIDTH = 78
_TITLES = ("parameter", "value", "std error", "95 % from", "to", "unit")


@dataclasses.dataclass(frozen=True, eq=False)
class PhysicalEstimate:
    """Physical parameters, their covariance, and the coefficients that belong to them.

    Attributes
    ----------
    model_name : str
    names, units, descriptions : tuple of str
        Of the parameters.
    values : ndarray, shape (n_parameters,)
        ``nan`` for a parameter that the record does not determine.
    cov : ndarray, shape (n_parameters, n_parameters)
        Rows and columns of such a parameter are ``nan``; zero for what is known exactly.
    known : mapping of str to (float, float)
        Value and standard deviation of what was known beforehand.
    combinations : tuple of Parameter
        Products and declared combinations that are determined.
    notes : tuple of str
        What cannot be told apart, and what to be careful about.
    alternatives : ndarray, shape (n_others, n_parameters)
        Other values that explain the record as well.
    theta, theta_cov : ndarray
        Coefficients that belong to the parameters, in the order of ``estimate.names``, and their
        covariance.
    fit : ndarray, shape (n_outputs,)
        Normalised fit with these coefficients [percent]; of the samples that ``estimate.fit``
        counts, which under a robust loss are those that do not lie far off.
    statistic, p_value : float
        Test of the restrictions that the map puts on the coefficients: chi-square distributed with
        ``freedom`` degrees of freedom if they are true. ``nan`` where there is nothing to test.
    by_distance : ndarray, shape (n_parameters,)
        Parameters of least distance to the free coefficients, for comparison.
    estimate : Estimate
        The coefficients without the restrictions.
    """

    model_name: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    descriptions: tuple[str, ...]
    values: Array
    cov: Array
    known: Mapping[str, tuple[float, float]]
    combinations: tuple[Parameter, ...]
    notes: tuple[str, ...]
    alternatives: Array
    theta: Array
    theta_cov: Array
    fit: Array
    statistic: float
    freedom: int
    p_value: float
    by_distance: Array
    estimate: Estimate

    def __post_init__(self) -> None:
        freeze_arrays(self)
        object.__setattr__(self, "known", MappingProxyType(dict(self.known)))
        if not self.alternatives.size:
            object.__setattr__(self, "alternatives", np.zeros((0, len(self.names))))
            self.alternatives.setflags(write=False)

    def __repr__(self) -> str:
        pairs = zip(self.names, self.values.tolist(), self.std.tolist(), strict=True)
        listed = ", ".join(f"{name}={format_value(v, std)}" for name, v, std in pairs)
        return f"PhysicalEstimate({self.model_name}; {listed})"

    @property
    def std(self) -> Array:
        """Standard errors, shape (n_parameters,); ``nan`` for what is not determined."""
        variance = np.diag(self.cov)
        return np.asarray(np.sqrt(np.where(variance > 0, variance, 0.0 * variance)))

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Name -> `Parameter`, in the order of ``names``."""
        rows = zip(self.names, self.values.tolist(), self.std.tolist(), self.units, strict=True)
        return MappingProxyType({row[0]: Parameter(*row) for row in rows})

    def value(self, name: str) -> float:
        """One parameter or combination.

        Parameters
        ----------
        name : str

        Returns
        -------
        float

        Raises
        ------
        PhysicalParameterError
            There is none of that name.
        UndeterminedError
            The record does not determine it.
        """
        table = {**{p.name: p for p in self.combinations}, **self.parameters}
        if name not in table:
            raise PhysicalParameterError(
                f"found no {name!r} in {self.model_name}; expected one of {', '.join(table)}; "
                "correct the name"
            )
        if np.isnan(table[name].value):
            told = "; ".join(self.notes[:2])
            raise UndeterminedError(
                f"found no value of {name}: {told}; expected a parameter that is determined; state "
                "some of the others with known={...}"
            )
        return table[name].value

    @property
    def model(self) -> TransferFunction:
        """The transfer function that belongs to the parameters."""
        kept = self.estimate
        return model_of(kept.structure, self.theta, kept.input_names, kept.output_names)

    def summary(self) -> str:
        """Fixed-width text: parameters, combinations, cautions, test of the restrictions, notes."""
        head = f"{self.model_name}: {len(self.names)} parameters from {self.estimate.n_samples}"
        lines = ["=" * _WIDTH, *textwrap.wrap(f"{head} samples", _WIDTH), "=" * _WIDTH]
        lines += format_table(_TITLES, [self._row(p) for p in self.parameters.values()])
        if self.combinations:
            titles = ("combination", *_TITLES[1:])
            lines += ["", *format_table(titles, [self._row(p) for p in self.combinations])]
        outputs = zip(self.estimate.output_names, self.fit, self.estimate.fit, strict=True)
        fits = [(n, f"{f:.2f}", f"{free:.2f}", "%") for n, f, free in outputs]
        lines += ["", *format_table(("output", "fit", "fit of free coefficients", ""), fits), ""]
        for caution in self.estimate.cautions:
            lines += textwrap.wrap(caution, _WIDTH, initial_indent="! ", subsequent_indent="  ")
        for note in (self.test_note(), *self.notes):
            if note:
                lines += textwrap.wrap(note, _WIDTH, initial_indent="- ", subsequent_indent="  ")
        return "\n".join(line.rstrip() for line in (*lines, "=" * _WIDTH))

    def test_note(self) -> str:
        """The test of the restrictions in words; empty where there is nothing to test."""
        if self.freedom == 0 or np.isnan(self.statistic):
            return ""
        verdict = (
            "the coefficients agree with the map"
            if self.p_value >= 0.01
            else "the coefficients contradict the map: it, the noise or the record is not as stated"
        )
        return (
            f"restrictions of the map: chi-square {self.statistic:.3g} with {self.freedom} "
            f"degree{'' if self.freedom == 1 else 's'} of freedom, {p_in_words(self.p_value)}; "
            f"{verdict}"
        )

    def _row(self, parameter: Parameter) -> tuple[str, ...]:
        value, std = parameter.value, parameter.std
        if np.isnan(value):
            return parameter.name, "not determined", "", "", "", parameter.unit
        ends = [format_value(end, std) for end in parameter.interval()] if std > 0 else ["", ""]
        shown = format_std(std) if std > 0 else "known" if parameter.name in self.known else ""
        return parameter.name, format_value(value, std), shown, *ends, parameter.unit

    def _repr_html_(self) -> str:
        rows = [self._row(p) for p in (*self.parameters.values(), *self.combinations)]
        said = (self.model_name, *self.estimate.cautions, self.test_note(), *self.notes)
        caption = "; ".join(filter(None, said))
        return html_table(_TITLES, rows, caption)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything but the map as JSON.

        Raises
        ------
        OutputPathError
            The file cannot be written.
        """
        return save_document(path, "physical_schema", SCHEMA, self)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> PhysicalEstimate:
        """Read what `save` wrote.

        Raises
        ------
        UnreadableFileError
            There is no such file, or it is not JSON.
        DataError
            It is of another schema version, or damaged.
        """
        return load_document(
            path, "physical_schema", SCHEMA, _decoded, "physical estimate", "PhysicalEstimate"
        )


def _decoded(document: Mapping[str, Any]) -> PhysicalEstimate:
    """Build the estimate from what `encode` made of it, and compare its parts."""
    made: PhysicalEstimate = decode(
        PhysicalEstimate, dict(document), {"Estimate": Estimate.from_document}
    )
    n, m = len(made.names), len(made.estimate.names)
    shapes = {"values": (n,), "cov": (n, n), "by_distance": (n,), "theta": (m,)}
    shapes |= {"theta_cov": (m, m), "fit": (len(made.estimate.output_names),)}
    shapes["alternatives"] = (len(made.alternatives), n)
    for field, shape in shapes.items():
        if getattr(made, field).shape != shape:
            raise ShapeError(
                f"found {field} of shape {getattr(made, field).shape}; expected {shape}"
            )
    if len({len(made.names), len(made.units), len(made.descriptions)}) > 1:
        raise ShapeError("found other numbers of names, units and descriptions; expected one each")
    for parameter in (*made.parameters.values(), *made.combinations):
        PhysicalParameter(parameter.name, parameter.unit)
    check_covariance(made.cov)
    check_covariance(made.theta_cov)
    return made
