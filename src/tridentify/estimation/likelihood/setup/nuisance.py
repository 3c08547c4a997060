"""Which nuisance terms are estimated along: the choices a structure leaves open.

An unknown constant on an input is, at the output, a constant plus a free response; so an offset
on every output and a free initial state cover trim values on both sides. What can be estimated
along are the rows of a short list: ``rest``, ``rest + offset``, ``equilibrium``, ``free``,
``free + offset``, each with or without drift. The structure narrows the list; where more than
one row is left, the method decides between them by the data.

With delays a free initial state stands for the inputs before the record only from the moment on
when the last of the recorded inputs has arrived. Output samples before it could be explained by
nothing that is known, and where a free state is possible (``free`` and ``auto``) they are not used,
by no choice, so that the choices are compared on the same samples. Rest and equilibrium, stated by
the user, say what the input was before, and every sample counts; so does an input that rests at
zero when the record begins (`held_past`).

All rows are nested in the largest one, so one pass over the samples serves them all (`Variant`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, cast

import numpy as np

from tridentify.errors import ConstantInputError, DelayError, OptionError, TooFewSamplesError
from tridentify.estimation.answer.decision import DecisionKind, KnownDecision
from tridentify.estimation.likelihood.setup.held_past import held_before
from tridentify.estimation.likelihood.setup.problem import Problem, Variant, states_of
from tridentify.models.experiment import MIDDLING, Experiment
from tridentify.numerics.arrays import Array
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record
from tridentify.structure import InitialState, Structure

SLACK = 1e-6
"""Share of a sampling interval within which a time counts as that of a sample: rounding of times
that are counted from far away."""


KEPT = 8
"""Experiments that are kept: a search, its judgement and the next structure share a few of them."""


@dataclass(frozen=True)
class Nuisances:
    """One choice of what is estimated along."""

    initial_state: str
    offset: bool
    drift: int

    @property
    def label(self) -> str:
        """In words."""
        words = [f"initial state {self.initial_state}"]
        words.append("offset" if self.offset else "no offset")
        if self.drift:
            words.append("drift" if self.drift == 1 else f"drift of degree {self.drift}")
        return ", ".join(words)

    def told(self, why: str) -> KnownDecision:
        """That this choice was made."""
        return KnownDecision(f"{self.label}: {why}", DecisionKind.INITIAL_STATE)

    def count(self, n_poles: int, n_outputs: int, n_experiments: int) -> int:
        """Number of unknowns."""
        return self.total((n_poles,) * n_outputs, n_experiments)

    def total(self, states: Sequence[int], n_experiments: int) -> int:
        """Number of unknowns where each output has states of its own number."""
        fixed = self.offset + self.drift
        free = self.initial_state == "free"
        return sum(n * free + fixed for n in states) * n_experiments

    def split(self, terms: Array, duration: float) -> tuple[float, float, Array]:
        """Offset, slope per second and bends of one output, of its constants or their errors."""
        offset, drift = float(terms[0]) if self.offset else 0.0, terms[int(self.offset) :]
        slope = float(drift[0]) / duration if self.drift else 0.0
        return offset, slope, np.asarray(drift[1:])

    def resolved(self, structure: Structure) -> Structure:
        """The structure with this choice in place of what it leaves open."""
        own = structure.initial_state, structure.offset, structure.drift
        if own == (self.initial_state, self.offset, self.drift):
            return structure
        if not structure.constrained:
            return with_terms(structure.poles, structure.zeros, structure.delay, self)
        return replace(
            structure,
            offset=self.offset,
            drift=self.drift,
            initial_state=cast("InitialState", self.initial_state),
        )


@lru_cache(maxsize=64)
def with_terms(
    poles: int | tuple[tuple[int, ...], ...],
    zeros: int | tuple[tuple[int, ...], ...],
    delay: float | Literal["free"] | tuple[tuple[float, ...], ...],
    nuisances: Nuisances,
) -> Structure:
    """A structure of these nuisance terms, without constraints."""
    return Structure(
        poles,
        zeros,
        delay=delay,
        offset=nuisances.offset,
        drift=nuisances.drift,
        initial_state=cast("InitialState", nuisances.initial_state),
    )


def candidates(records: Sequence[Record], structure: Structure) -> tuple[Nuisances, ...]:
    """The choices of nuisance terms that the structure leaves open, the leanest first.

    Raises
    ------
    ConstantInputError
        If the initial state is free (or in equilibrium) and the input never changes.
    TooFewSamplesError
        If no choice leaves more samples than unknowns.
    DelayError
        If no input arrives within the record, or no output sample is left after that.
    """
    _check_delays(records, structure)
    still = [
        all(not np.ptp(record.u[:, j]) for record in records) for j in range(records[0].n_inputs)
    ]
    at_zero = all(not np.any(record.u[0]) for record in records)
    found = open_choices(structure, records[0], still, at_zero=at_zero)
    return _affordable(found, records, structure)


def open_choices(
    structure: Structure, first: Record, still: Sequence[bool], *, at_zero: bool
) -> list[Nuisances]:
    """The choices that a structure leaves open, whatever the number of samples.

    Parameters
    ----------
    structure : Structure
    first : Record
        The first experiment, or its beginning: names and first values of the inputs.
    still : sequence of bool
        For each input, whether it never changes, in no experiment.
    at_zero : bool
        Whether all inputs begin at zero, in all experiments.

    Raises
    ------
    ConstantInputError, OptionError
        As `candidates`.
    """
    offsets = (False, True) if structure.offset == "auto" else (bool(structure.offset),)
    drifts = (0, 1) if structure.drift == "auto" else (structure.drift_degree,)
    if structure.initial_state == "equilibrium" and structure.offset is False:
        raise OptionError(
            "found initial_state='equilibrium' with offset=False; expected an offset, which is the "
            "output of the equilibrium; leave offset out"
        )
    constant = all(still)
    if structure.initial_state == "equilibrium" or (
        structure.initial_state == "free" and (constant or structure.offset is True)
    ):
        _refuse_constant(first, structure, still)
    states = (
        (("rest",) if constant else ("rest", "equilibrium", "free"))
        if structure.initial_state == "auto"
        else (structure.initial_state,)
    )
    found = []
    for drift in drifts:
        for state in states:
            for offset in offsets:
                if state == "equilibrium" and (not offset or (at_zero and len(states) > 1)):
                    continue
                if any(still) and (state == "equilibrium" or (state == "free" and offset)):
                    continue
                found.append(Nuisances(state, offset, drift))
    return found


def _refuse_constant(record: Record, structure: Structure, still: Sequence[bool]) -> None:
    """Refuse inputs that an offset and a free state, or an equilibrium, leave nothing of."""
    for j, name in enumerate(record.input_names):
        if still[j] and (structure.fixed or {}).get("a0") == 0.0:
            raise ConstantInputError(
                f"found input {name!r} that stays at {record.u[0, j]:g} and an integrator "
                "(a0 = 0), whose response to it is a ramp; expected an input that changes; leave "
                "the channel out and state drift=True, which is such a ramp"
            )
        if still[j]:
            raise ConstantInputError(
                f"found input {name!r} that stays at {record.u[0, j]:g} while the initial state is "
                f"{structure.initial_state}; expected an input that changes; record a change of "
                "it, or state initial_state='rest' if it was switched on at the first sample"
            )


def _affordable(
    found: list[Nuisances], records: Sequence[Record], structure: Structure
) -> tuple[Nuisances, ...]:
    first = records[0]
    n_coefficients = len(structure.names(first.input_names, first.output_names))
    seen = [np.isfinite(explained(record, structure)).sum(axis=0) for record in records]
    samples = int(sum(counts.sum() for counts in seen))
    states = states_of(structure, first.n_outputs, first.n_inputs)

    def unknowns(nuisances: Nuisances) -> int:
        return n_coefficients + nuisances.total(states, len(records))

    def enough(nuisances: Nuisances) -> bool:
        return all(
            int(n) > nuisances.total((own,), 1)
            for counts in seen
            for n, own in zip(counts, states, strict=True)
        )

    kept = [n for n in found if samples > unknowns(n) + 2 and enough(n)]
    if not kept:
        fewest = min(found, key=unknowns)
        raise TooFewSamplesError(
            f"found {samples} output samples for {unknowns(fewest)} unknowns; expected at least "
            f"{unknowns(fewest) + 3}; record longer or lower the orders"
        )
    return tuple(sorted(kept, key=unknowns))


def build(
    records: Sequence[Record],
    structure: Structure,
    nuisances: Nuisances,
    *,
    shift: bool = True,
) -> Problem:
    """The problem for one choice of nuisance terms.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
    nuisances : Nuisances
    shift : bool
        Whether the input counts from its reference (`reference_of`) or as recorded.
    """
    first = records[0]
    experiments = [_experiment(record, structure, nuisances, shift) for record in records]
    zeros = structure.zeros_matrix(first.n_outputs, first.n_inputs)
    return Problem.of(experiments, structure.poles, zeros)


_experiments: list[tuple[Record, tuple[object, ...], Experiment]] = []


def _experiment(
    record: Record, structure: Structure, nuisances: Nuisances, shift: bool
) -> Experiment:
    """A record as one choice of nuisance terms sees it; those of the last ones are kept.

    The search, the judgement of its end and the next structure ask for the same ones, and what the
    filters are given of an experiment is made once for each.
    """
    reference = reference_of(record, nuisances) if shift else np.zeros(record.n_inputs)
    delays = np.array(structure.delay_matrix(record.n_outputs, record.n_inputs))
    start = first_explained(record, structure)
    terms = nuisances.initial_state == "free", nuisances.offset, nuisances.drift
    samples = reference.tobytes(), delays.tobytes(), start
    kept = [(asked, own) for one, asked, own in list(_experiments) if one is record]
    same = {asked[:3]: own for asked, own in kept if asked[3:] == samples}
    found = same.get(terms)
    if found is None and same:
        found = next(iter(same.values())).beside(*terms)
    elif found is None:
        u = np.asarray(record.u)
        found = Experiment(
            np.ascontiguousarray(u - reference) if np.any(reference) else u,
            explained(record, structure),
            typical_step(record.t) if record.dt is None else record.dt,
            record.behaviour,
            *terms,
            t=record.t - record.t[0] if record.dt is None else None,
            delays=delays if np.any(delays) else None,
            start=start,
            scale=record._noise_scale,
        )
    if terms not in same and record.n_samples <= MIDDLING:
        _experiments[:] = [*_experiments[1 - KEPT :], (record, (*terms, *samples), found)]
    return found


def first_explained(record: Record, structure: Structure) -> int:
    """The first sample whose inputs, delayed, are all known; 0 if the past is stated.

    Those before the record are where it begins at rest (`held_past`).

    Examples
    --------
    >>> record = Record([0, 1, 1, 1], [0.0, 0.1, 0.3, 0.4], dt=0.5)
    >>> first_explained(record, Structure(1, 0, delay=0.7))
    2
    """
    if structure.initial_state not in ("free", "auto"):
        return 0
    longest = _longest_delay(record, structure)
    if not longest:
        return 0
    since = record.t - record.t[0]
    slack = SLACK * float(np.median(np.diff(since)))
    unknown = longest - held_before(record.u, since)
    return int(np.searchsorted(since, unknown - slack)) if unknown > slack else 0


def _longest_delay(record: Record, structure: Structure) -> float:
    return max(map(max, structure.delay_matrix(record.n_outputs, record.n_inputs)))


def explained(record: Record, structure: Structure) -> Array:
    """(n_samples, n_outputs) outputs, ``nan`` where no recorded input can explain them."""
    start = first_explained(record, structure)
    y = np.asarray(record.y)
    if not start:
        return y
    y = y.copy()
    y[:start] = np.nan
    return y


def _check_delays(records: Sequence[Record], structure: Structure) -> None:
    """Refuse delays that leave nothing to explain."""
    for record in records:
        longest = _longest_delay(record, structure)
        if not longest:
            continue
        if longest >= (1.0 - SLACK) * record.duration:
            raise DelayError(
                f"found a delay of {longest:.6g} s and a record of {record.duration:.6g} s; "
                "expected a delay shorter than the record, which shows nothing of a later "
                "response; correct the delay or its unit, or record longer"
            )
        left = np.isfinite(explained(record, structure)).sum(axis=0)
        if not left.all():
            name = record.output_names[int(np.argmin(left))]
            raise DelayError(
                f"found no sample of output {name!r} after the delay of {longest:.6g} s; expected "
                "output samples that the recorded input can explain; correct the delay, record "
                "longer, or state initial_state='rest' or 'equilibrium'"
            )


def reference_of(record: Record, nuisances: Nuisances) -> Array:
    """(n_inputs,) what is subtracted from the input.

    With an equilibrium start it is the first value, by definition. With a free state and an
    offset any constant is absorbed by the two, and the first value keeps the columns small. In
    the other cases the input counts as recorded.
    """
    shifted = nuisances.initial_state == "equilibrium" or (
        nuisances.initial_state == "free" and nuisances.offset
    )
    return np.asarray(record.u[0]) if shifted else np.zeros(record.n_inputs)


def build_base(
    records: Sequence[Record], structure: Structure, choices: Sequence[Nuisances]
) -> tuple[Problem, tuple[Variant, ...]]:
    """One problem that holds every choice, and each choice as a variant of it.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
    choices : sequence of Nuisances
        From `candidates`.

    Returns
    -------
    base : Problem
    variants : tuple of Variant
        In the order of ``choices``.
    """
    only_shifted = all(c.initial_state == "equilibrium" for c in choices)
    # adding a constant back to the inputs takes the impulse states (`regression.restricted`)
    free = any(c.initial_state in ("free", "equilibrium") for c in choices)
    fullest = Nuisances(
        "equilibrium" if only_shifted else "free" if free else "rest",
        any(c.offset for c in choices),
        max(c.drift for c in choices),
    )
    base = build(records, structure, fullest, shift=only_shifted)
    variants = []
    for choice in choices:
        shifted = choice.initial_state == "equilibrium" and not only_shifted
        constants = tuple(-np.asarray(record.u[0]) if shifted else None for record in records)
        variants.append(
            Variant(choice.initial_state == "free", choice.offset, choice.drift, constants)
        )
    return base, tuple(variants)
