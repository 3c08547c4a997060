"""The methods that a study may declare, by name, and what they make of one record.

Besides those of `tridentify.identify.METHODS` there are two that need what a user does not know
exactly, or has no standard errors: ``paper``, Steps 1 to 4 as printed, and ``step-2-alone``, the
series-parallel model on the recorded output. Their ``gamma`` and ``filter`` may be stated for a
plant of the corner frequency ``corner`` [rad/s]; they are then scaled to that of each system.
``output-error`` takes ``start = "truth"``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from tridentify.errors import OptionError, TridentifyError, shown
from tridentify.estimation.methods.base import Method
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.identify import METHODS, search
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.studies.declared import nouns
from tridentify.studies.step_2_alone import step_2_alone

PAPER, STEP_2_ALONE, OUTPUT_ERROR = "paper", "step-2-alone", "output-error"
KINDS = (*METHODS, PAPER, STEP_2_ALONE)
"""Names of all methods."""
AT_TRUTH = "truth"
PAPER_FILTER = (1.0, 5.0, 6.0, 7.0)
SCALED = "corner"
AT_REST: Mapping[str, Any] = {"offset": False, "initial_state": "rest"}
"""What a method is told of the record unless the file says otherwise: the data are made so."""


class Answer(NamedTuple):
    """Coefficients, ends of their 95 % intervals (none: empty), and the status."""

    theta: Array
    intervals: Array
    status: str
    ok: bool


def options_of(kind: str) -> nouns.Offered:
    """Options that a method takes.

    Parameters
    ----------
    kind : str
        One of `KINDS`.

    Examples
    --------
    >>> options_of("step-2-alone").names
    ('filter', 'corner')
    """
    if kind == STEP_2_ALONE:
        return nouns.Offered(("filter", SCALED))
    if kind == PAPER:
        own = nouns.Offered.by(ThreeModel.paper)
        return nouns.Offered((*own.names, SCALED), own.needed)
    return nouns.Offered.by(METHODS[kind])


def checked_for(method: nouns.DeclaredMethod, system: nouns.DeclaredSystem) -> None:
    """Refuse a method that cannot be made for a system.

    Parameters
    ----------
    method : DeclaredMethod
    system : DeclaredSystem

    Raises
    ------
    OptionError
        An option has a value that is not offered.
    """
    try:
        _structure(method, system)
        if method.kind == STEP_2_ALONE:
            _filter(_scaled(method.options, system), system)
        else:
            _made(method, system)
    except (TridentifyError, TypeError, ValueError) as error:
        raise nouns.refusal(f"[methods.{method.name}]", error) from error


def attempt(method: nouns.DeclaredMethod, system: nouns.DeclaredSystem, record: Record) -> Answer:
    """Identify one record by one method.

    Parameters
    ----------
    method : DeclaredMethod
    system : DeclaredSystem
        Gives the orders, and the truth to those who are told it.
    record : Record

    Returns
    -------
    Answer

    Raises
    ------
    TridentifyError
        The method has no answer.
    """
    structure = _structure(method, system)
    if method.kind == STEP_2_ALONE:
        filter_ = _filter(_scaled(method.options, system), system)
        n_poles, n_zeros = len(system.den) - 1, len(system.num) - 1
        theta = step_2_alone(record, n_poles, n_zeros, filter_)
        return Answer(theta, np.empty((0, 2)), "CONVERGED", True)
    estimate = search(record, structure, _made(method, system)).estimate
    own = [estimate.parameters[name] for name in system.coefficients]
    ends = np.array([parameter.interval(0.95) for parameter in own])
    theta = np.array([parameter.value for parameter in own])
    return Answer(theta, ends, estimate.status.name, bool(estimate.status.ok))


def _structure(method: nouns.DeclaredMethod, system: nouns.DeclaredSystem) -> Structure:
    told = {**AT_REST, **dict(method.structure)}
    return Structure(len(system.den) - 1, len(system.num) - 1, **told)


def _made(method: nouns.DeclaredMethod, system: nouns.DeclaredSystem) -> Method:
    options = dict(method.options)
    if method.kind == PAPER:
        return ThreeModel.paper(**_scaled(method.options, system))
    if method.kind == OUTPUT_ERROR and "start" in options:
        if options["start"] != AT_TRUTH:
            raise OptionError(
                f"found start={shown(options['start'])}; expected {AT_TRUTH!r}; leave it out for a "
                "start from the record"
            )
        options["start"] = system.model
    made: Callable[..., Method] = METHODS[method.kind]
    return made(**options)


def _scaled(options: nouns.Options, system: nouns.DeclaredSystem) -> dict[str, Any]:
    """Options with gamma and filter for the corner frequency of the system."""
    found = dict(options)
    corner = found.pop(SCALED, None)
    if corner is None:
        return found
    if not corner > 0:
        raise OptionError(
            f"found {SCALED}={corner:g}; expected a frequency above zero [rad/s]; correct it"
        )
    factor = system.corner / corner
    if "gamma" in found:
        found["gamma"] = found["gamma"] * factor
    filter_ = found.get("filter", PAPER_FILTER)
    found["filter"] = tuple(value * factor**k for k, value in enumerate(filter_))
    return found


def _filter(options: Mapping[str, Any], system: nouns.DeclaredSystem) -> tuple[float, ...]:
    filter_ = tuple(options.get("filter", PAPER_FILTER))
    if not all(isinstance(value, int | float) for value in filter_):
        raise OptionError.found("filter=", filter_, "numbers in descending powers")
    if len(filter_) <= len(system.den):
        raise OptionError(
            f"found a filter of degree {len(filter_) - 1} for the {len(system.den) - 1} poles of "
            f"{shown(system.name)}; expected a higher degree; add a root to it"
        )
    return filter_
