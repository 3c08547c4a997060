"""What precision a planned input will give, before anything is recorded.

The inverse of the Fisher information (`tridentify.excitation.information`) is the smallest
covariance that an unbiased estimator can have, and that of the maximum likelihood for long records.
It needs the coefficients it is to tell, so a plan is as good as the model it begins with. Where
that is an `Estimate`, the plan is worked out again for draws of its coefficients, and the spread of
the answers says how much is owed to the one model (Pronzato & Walter 1985: robust design).

The information is proportional to the square of the amplitude and to the number of repetitions, so
what amplitude, or how many repetitions, a wanted precision takes is known exactly.

References: S. M. Kay, *Fundamentals of Statistical Signal Processing: Estimation Theory*, Prentice
Hall 1993, section 3.9. R. K. Mehra, IEEE Trans. Automatic Control 19 (1974) 753-768. L. Pronzato &
E. Walter, Mathematical Biosciences 75 (1985) 103-120. V. Klein & E. A. Morelli, *Aircraft System
Identification*, AIAA 2006, chapter 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import ChannelCountError, DelayError, OptionError, TridentifyError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.excitation.checks import count
from tridentify.excitation.information import (
    Information,
    coefficients_of,
    fullest,
    information,
    structure_of,
)
from tridentify.excitation.precision_result import Precision
from tridentify.excitation.signal import Excitation
from tridentify.numerics.arrays import Array
from tridentify.numerics.levinson import autocovariance
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction
from tridentify.uncertainty.sampled import sample

Plan = Excitation | Record

SAME_STEP = 1e-3
"""Relative difference of two sampling steps that are one: steps are written with three digits."""


def precision(
    model: TransferFunction | Estimate,
    plans: Plan | Sequence[Plan],
    structure: Structure | None = None,
    *,
    noise_std: ArrayLike | None = None,
    n_draws: int = 40,
    seed: int = 0,
) -> Precision:
    """Standard errors of the coefficients that planned experiments will give.

    Parameters
    ----------
    model : TransferFunction or Estimate
        What is known of the plant so far. Of an `Estimate` the covariance is used too: the plan is
        worked out for `n_draws` draws of its coefficients.
    plans : Excitation or Record, or a sequence of them
        The inputs; of a record also the instants, and which output samples are missing. Several are
        several experiments, each with nuisance terms of its own.
    structure : Structure, optional
        What will be asked of the record: orders, delays, nuisance terms, knowledge. By default that
        of the estimate, or the orders of the model.
    noise_std : float or (n_outputs,) array_like, optional
        Standard deviation of the noise [output units]. By default that of the estimate, with its
        colour where the plan is sampled as the estimate's record was.
    n_draws : int
        Draws of an estimate's coefficients; 0 for none.
    seed : int
        Of the draws.

    Returns
    -------
    Precision

    Raises
    ------
    OptionError
        The noise is not known, or not positive.
    UndeterminedError
        The experiments cannot tell the coefficients apart.
    ConstantInputError, TooFewSamplesError, DelayError
        As `identify` would refuse such a record.
    ChannelCountError, OrderError, UnsupportedError
        Model, plan and structure do not fit each other, or the model is not stable.

    Notes
    -----
    The plant is taken to be at rest (in trim) before the first sample, or with
    ``initial_state="equilibrium"`` in the equilibrium of the first input. What the structure leaves
    to the data (``"auto"``) is taken to be estimated along: the larger errors. At a delay of a
    whole number of samples, a held input and one more pole than zeros, the output has a kink in the
    delay, and its standard error is that of one side.

    Examples
    --------
    >>> from tridentify import Structure, TransferFunction
    >>> from tridentify.excitation import doublet
    >>> model = TransferFunction([2.0], [1.0, 2.0, 9.0])
    >>> rest = Structure(2, 0, offset=False, initial_state="rest")
    >>> plan = doublet(1.0, dt=0.02, for_frequency=3.0, tail=4.0)
    >>> ahead = precision(model, plan, rest, noise_std=0.01)
    >>> dict(zip(ahead.names, (100 * ahead.relative).round(2).tolist()))
    {'a1': 1.09, 'a0': 0.39, 'b0': 0.92}
    >>> ahead.amplitude_for({"a1": 0.02}).round(2).tolist()
    [0.55]
    """
    like = model.model if isinstance(model, Estimate) else model
    records = _shaped(_records(plans), like)
    structure = asked(model, like, structure)
    theta = coefficients_of(like, structure)
    noise, colour, innovations = noise_of(model, noise_std, records, like.n_outputs)
    nuisances, left_open = fullest(records, structure)
    notes = _notes(nuisances.label, left_open)

    def of(values: Array) -> Information:
        return information(values, records, structure, nuisances, innovations, like, colour)

    own = of(theta)
    cov = own.covariance()
    draws, values, unused = _drawn(model, structure, like, of, n_draws, seed)
    if unused:
        notes += (f"{unused} draws of the model were unstable and are not counted",)
    return Precision(
        structure.names(like.input_names, like.output_names),
        theta,
        cov,
        np.max([np.abs(record.u).max(axis=0) for record in records], axis=0),
        noise,
        nuisances.label,
        notes,
        draws,
        values,
        own,
    )


def _records(plans: Plan | Sequence[Plan]) -> list[Record]:
    given = [plans] if isinstance(plans, (Excitation, Record)) else list(plans)
    if not given or not all(isinstance(one, (Excitation, Record)) for one in given):
        raise OptionError(
            f"found {shown(plans)}; expected an Excitation or a Record, or a sequence of them; "
            "make one with tridentify.excitation"
        )
    return [one.record() if isinstance(one, Excitation) else one for one in given]


def _shaped(records: Sequence[Record], like: TransferFunction) -> list[Record]:
    """The records with as many outputs as the model has."""
    found = []
    for record in records:
        if record.n_inputs != like.n_inputs:
            raise ChannelCountError(
                f"found {record.n_inputs} inputs; expected {like.n_inputs} as in the model; give "
                "one column per input"
            )
        if record.n_outputs != like.n_outputs:
            y = np.zeros((record.n_samples, like.n_outputs))
            t = record.t if record.dt is None else None
            between = record.behaviour
            record = Record(record.u, y, dt=record.dt, t=t, intersample=between, **record._loop)
        found.append(record)
    return found


def asked(
    model: TransferFunction | Estimate, like: TransferFunction, structure: Structure | None
) -> Structure:
    """The structure asked for; a delay that only the model has is known."""
    if structure is None:
        return model.structure if isinstance(model, Estimate) else structure_of(like)
    if structure.delay == "free" or not np.any(like.delay):
        return structure
    stated = np.array(structure.delay_matrix(like.n_outputs, like.n_inputs))
    if not np.any(stated):
        return replace(structure, delay=cast("Any", like.delay.tolist()))
    if not np.allclose(stated, like.delay, rtol=1e-9, atol=0.0):
        raise DelayError(
            f"found delays {shown(stated.tolist())} in the structure and "
            f"{shown(like.delay.tolist())} in the model; expected the same; correct one of the two"
        )
    return structure


def noise_of(
    model: TransferFunction | Estimate,
    noise_std: ArrayLike | None,
    records: Sequence[Record],
    n_outputs: int,
) -> tuple[Array, tuple[Array, ...], Array]:
    """Standard deviation of the noise, its colour, and the deviation of its innovations."""
    if noise_std is None:
        if not isinstance(model, Estimate):
            raise OptionError(
                "found no noise_std; expected the standard deviation of the noise on each output; "
                "give it, or plan from an Estimate"
            )
        std = np.sqrt(model.noise_variance)
        steps = [record.dt for record in records]
        alike = model.dt is not None and all(
            step is not None and abs(step - model.dt) <= SAME_STEP * model.dt for step in steps
        )
        colour = tuple(model.noise_model) if alike else ()
        if not any(a.size for a in colour):
            return std, (), std
        gain = np.array([autocovariance(a, 0)[0] if a.size else 1.0 for a in colour])
        return std, colour, std / np.sqrt(gain)
    try:
        given = np.asarray(noise_std, dtype=np.float64)
    except (TypeError, ValueError):
        given = np.full(1, np.nan)
    if given.shape not in ((), (1,), (n_outputs,)) or not np.all((given > 0) & (given < np.inf)):
        raise OptionError.found(
            "noise_std=", noise_std, f"a positive number, or one for each of {n_outputs} outputs"
        )
    std = np.broadcast_to(given, (n_outputs,)).astype(np.float64)
    return std, (), std


def _notes(label: str, left_open: bool) -> tuple[str, ...]:
    if not left_open:
        return ()
    return (
        f"the structure leaves to the data what is estimated along; planned with {label}, the "
        "most that it allows; state offset, drift and initial_state for other numbers",
    )


def _drawn(
    model: TransferFunction | Estimate,
    structure: Structure,
    like: TransferFunction,
    of: Any,
    n_draws: int,
    seed: int,
) -> tuple[Array, Array, int]:
    """Standard errors for draws of an estimate's coefficients, the draws, and those left out."""
    n_draws = count("n_draws", n_draws, least=0)
    p = structure.n_parameters(like.n_outputs, like.n_inputs)
    nothing = np.zeros((0, p)), np.zeros((0, p)), 0
    if not isinstance(model, Estimate) or not n_draws or not np.all(np.isfinite(model.cov)):
        return nothing
    if model.names != structure.names(like.input_names, like.output_names):
        return nothing
    found, values = [], []
    for theta in sample(model, n_draws, seed).theta:
        try:
            found.append(np.sqrt(np.diag(of(theta).covariance())))
        except TridentifyError:
            continue
        values.append(theta)
    if not found:
        return nothing
    return np.array(found), np.array(values), n_draws - len(found)
