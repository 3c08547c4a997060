"""The seam: what a method is, and what it refuses.

A method is a frozen set of options with a name and one verb, `Method.estimate`. It holds no data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from numbers import Real
from typing import Protocol, runtime_checkable

import numpy as np

from tridentify.errors import (
    ChannelCountError,
    ConstantOutputError,
    DataError,
    DependentInputsError,
    OptionError,
    ScaleError,
    TooFewSamplesError,
    UnitMismatchError,
    UnsupportedOrderError,
    ZeroInputError,
    ZeroOutputError,
    shown,
)
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.setup.problem import states_of
from tridentify.estimation.methods.capability import Capability, refuse_unsupported
from tridentify.numerics.arrays import Array
from tridentify.record.checks.scales import (
    LARGEST_SIGNAL,
    check_coefficients,
    check_span,
    check_time,
)
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.writing.layout import unit_factors, unit_product

Progress = Callable[[str], None]

MOST_POLES = 20
"""Poles of one denominator: more than any record determines, and the most for which polynomials
keep some digits."""
DEPENDENT = 1e-10
"""Share of an input that the others do not hold, below which they hold all of it."""


@runtime_checkable
class Method(Protocol):
    """An estimation method: options only, no data.

    Those of this package also say in ``capabilities`` what they can do beyond the plain case.
    """

    @property
    def name(self) -> str:
        """What tables and files call it."""

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Progress | None = None
    ) -> Estimate:
        """Estimate the coefficients of ``structure`` from ``records``."""


def check(records: Sequence[Record], structure: Structure, method: str, can: Capability) -> None:
    """Refuse what cannot be estimated, in one clear line.

    Raises
    ------
    DataError, NonUniformTimeError, ZeroInputError, ZeroOutputError, TooFewSamplesError,
    UnitMismatchError
        About the records.
    ChannelCountError, UnsupportedError
        About the structure.
    DependentInputsError
        Inputs are linear combinations of each other.
    """
    if not records:
        raise DataError("found no record; expected at least one; pass a Record or a list of them")
    first = records[0]
    for record in records:
        if (record.input_names, record.output_names) != (first.input_names, first.output_names):
            raise ChannelCountError(
                f"found records with channels {record.input_names} -> {record.output_names} and "
                f"{first.input_names} -> {first.output_names}; expected the same; select them alike"
            )
    _check_units(records)
    refuse_unsupported(records, structure, method, can)
    _check_order(structure)
    u, y = check_signals(records)
    for j, name in enumerate(first.input_names):
        if not u[j] > 0.0:
            raise ZeroInputError(
                f"found input {name!r} zero throughout; expected a signal that moves the system; "
                "choose the channel that was excited"
            )
    for i, name in enumerate(first.output_names):
        if not y[i] > 0.0:
            raise ZeroOutputError(
                f"found output {name!r} zero throughout; expected a response to the input; choose "
                "another channel"
            )
        if all(_constant(record.y[:, i]) for record in records):
            raise ConstantOutputError(
                f"found output {name!r} constant throughout; expected a response to the input; "
                "choose another channel, or excite the system"
            )
    check_scale(records, structure, u, y)
    _check_dependence(records, structure)
    _check_outputs(records, structure)
    n_parameters = len(structure.names(first.input_names, first.output_names))
    samples = sum(int(np.isfinite(record.y).sum()) for record in records)
    if samples <= n_parameters:
        raise TooFewSamplesError(
            f"found {samples} output samples for {n_parameters} coefficients; expected more "
            "samples than unknowns; record longer or lower the orders"
        )


def check_count(name: str, value: object, least: int = 1) -> None:
    """Refuse an option that is no whole number of at least ``least``.

    Raises
    ------
    OptionError
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise OptionError(
            f"found {name}={shown(value)}; expected a whole number of at least {least}; leave it "
            "out or correct it"
        )


def check_tolerance(value: object) -> None:
    """Refuse a tolerance that is no positive number.

    Raises
    ------
    OptionError
    """
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not 0.0 < float(value) < np.inf:  # type: ignore[arg-type]
        raise OptionError(
            f"found tolerance={shown(value)}; expected a positive number, a fall of -2 log L; "
            "leave it out or correct it"
        )


def _constant(values: Array) -> bool:
    seen = values[np.isfinite(values)]
    return bool(seen.size == 0 or seen.min() == seen.max())


def check_signals(records: Sequence[Record]) -> tuple[list[float], list[float]]:
    """Refuse channels whose squares overflow or vanish; those of zeros are not judged here.

    Returns
    -------
    u, y : lists of float
        The largest size of every channel; ``nan`` where no sample of it is there.

    Raises
    ------
    ScaleError
    """
    found = []
    for signals in ([record.u for record in records], [record.y for record in records]):
        every = [np.fmax.reduce(np.abs(one), axis=0).tolist() for one in signals]
        for size in (size for sizes in every for size in sizes):
            if size > LARGEST_SIGNAL or 0.0 < size < 1.0 / LARGEST_SIGNAL:
                raise ScaleError(
                    f"found values of the order {size:.0e}; expected between "
                    f"{1 / LARGEST_SIGNAL:.0e} and {LARGEST_SIGNAL:.0e}; choose other units"
                )
        found.append(every[0] if len(every) == 1 else np.fmax.reduce(every).tolist())
    u, y = found
    return u, y


def steps_and_length(records: Sequence[Record]) -> tuple[float, float]:
    """The shortest typical step and the longest duration [s]."""
    steps = [typical_step(r.t) if r.dt is None else r.dt for r in records]
    return min(steps), max(r.duration for r in records)


def check_times(records: Sequence[Record]) -> None:
    """Refuse time axes on which rates, integrals or slopes of signals have no room in a float.

    Raises
    ------
    ScaleError
    """
    shortest, longest = steps_and_length(records)
    check_time(0.0, longest, shortest)
    check_span(shortest, longest)


def check_scale(
    records: Sequence[Record], structure: Structure, u: Sequence[float], y: Sequence[float]
) -> None:
    """Refuse orders and units whose coefficients have no room in a float.

    ``u``, ``y`` as of `check_signals`.
    """
    first = records[0]
    shortest, longest = steps_and_length(records)
    check_time(0.0, longest, shortest)
    poles = structure.poles_matrix(first.n_outputs, first.n_inputs)
    zeros = structure.zeros_matrix(first.n_outputs, first.n_inputs)
    check_coefficients(
        [
            (poles[i][j], zeros[i][j], y[i] / u[j])
            for i in range(first.n_outputs)
            for j in range(first.n_inputs)
            # a channel of zeros is refused for that
            if y[i] > 0.0 and u[j] > 0.0
        ],
        shortest,
        longest,
    )
    check_span(shortest, longest)


def _check_dependence(records: Sequence[Record], structure: Structure) -> None:
    """Refuse inputs that are combinations of others, where nothing else tells them apart.

    Delays of their own, denominators of their own, or knowledge of a numerator may do so.
    """
    first = records[0]
    delays = structure.delay_matrix(first.n_outputs, first.n_inputs)
    alike = structure.delay != "free" and all(len(set(row)) == 1 for row in delays)
    told = structure.static_gain is not None or any(n.startswith("b") for n in structure.known)
    if first.n_inputs == 1 or not structure.shared or not alike or told:
        return
    upper = np.zeros((0, first.n_inputs))
    for record in records:
        upper = np.asarray(np.linalg.qr(np.vstack([upper, record.u]), mode="r"))
    _, s, vt = np.linalg.svd(upper / np.linalg.norm(upper, axis=0))
    null = vt[np.sum(s > DEPENDENT * s[0]) :]
    if len(null) == 0:
        return
    # where there are several relations, one is enough to act on
    shares = np.abs(null[-1])
    names = [n for n, w in zip(first.input_names, shares, strict=True) if w > DEPENDENT**0.5]
    which = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
    what = "proportional to each other" if len(names) == 2 else "linearly dependent"
    raise DependentInputsError(
        f"found the inputs {which} {what}, over all records together; expected inputs that move "
        "independently, since the effects of these cannot be told apart; leave one of them out, or "
        "excite them one after the other"
    )


def _check_outputs(records: Sequence[Record], structure: Structure) -> None:
    """Every output must have more samples than coefficients of its own."""
    first = records[0]
    zeros = structure.zeros_matrix(first.n_outputs, first.n_inputs)
    states = states_of(structure, first.n_outputs, first.n_inputs)
    for i, name in enumerate(first.output_names):
        samples = sum(int(np.isfinite(record.y[:, i]).sum()) for record in records)
        own = sum(m + 1 for m in zeros[i]) + states[i]
        if samples <= own:
            raise TooFewSamplesError(
                f"found {samples} samples of output {name!r} for {own} "
                f"unknowns; expected more samples than unknowns; record longer, lower the orders, "
                "or leave the channel out"
            )


def _check_units(records: Sequence[Record]) -> None:
    """Refuse records that state different units of a channel; one that states none agrees."""
    first = records[0]
    for name in (*first.input_names, *first.output_names):
        texts = (record.units.get(name, "").strip() for record in records)
        # s^-1 and 1/s are one unit
        stated = {unit_product(unit_factors(text)): text for text in texts if text}
        if len(stated) > 1:
            found = " and ".join(shown(text) for text in stated.values())
            raise UnitMismatchError(
                f"found the units {found} of {shown(name)} in records identified together; "
                "expected one unit; convert one of the records"
            )


def _check_order(structure: Structure) -> None:
    poles = structure.poles
    if (poles if isinstance(poles, int) else max(map(max, poles))) > MOST_POLES:
        raise UnsupportedOrderError(
            f"found {structure.poles} poles; expected at most {MOST_POLES}, more than any record "
            "determines; lower the number of poles"
        )
