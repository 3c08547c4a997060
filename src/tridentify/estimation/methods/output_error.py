"""The output-error method as it is done by hand: one start, then Gauss-Newton on the cost.

The prediction error of ``y(t_k) = (b / a) u (t_k) + noise`` with white noise is the output error,
so its least squares are the maximum-likelihood estimate for Gaussian noise (Ljung 1999, section
7.4; in flight testing Jategaonkar 2015). For a given denominator the output is linear in the
numerators and in the nuisance terms, so only the poles are iterated (variable projection; Golub &
Pereyra 1973), by Levenberg-Marquardt on the exact derivatives (`likelihood.cost`,
`likelihood.minimum.levenberg_marquardt`).

The cost is not convex in ``a``: the end depends on the start, and this method has a single one.
That is either a model that the user gives, of which only the denominator matters, or the
series-parallel model fitted to the raw record through state-variable filters
(`SvfLeastSquares`), whose bias grows with the noise; missing samples of the output are joined by
straight lines for this start alone, and delayed or unevenly sampled records are put onto an even
grid. `ThreeModel` is the same finish with a search in front of it;
what the search is worth is the difference between the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from tridentify.errors import DataError, IdentifiabilityError, OptionError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Start, Step, Trace
from tridentify.estimation.likelihood.answer import Ending, estimate_from
from tridentify.estimation.likelihood.choose_nuisance import decide
from tridentify.estimation.likelihood.cost import evaluate_variant
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Patience,
    Recorder,
    coefficients,
    mean_square,
)
from tridentify.estimation.likelihood.question import Question, silently
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.thresholds import SETTLED
from tridentify.estimation.methods.around_maximum.constrained import within_constraints
from tridentify.estimation.methods.around_maximum.delays import over_delays
from tridentify.estimation.methods.around_maximum.levels import (
    at_own_levels,
    constrained_at_own_levels,
)
from tridentify.estimation.methods.around_maximum.maximum import Reached
from tridentify.estimation.methods.around_maximum.robust import check_loss, robust_estimate
from tridentify.estimation.methods.base import Progress, check, check_count, check_tolerance
from tridentify.estimation.methods.capability import EVERYTHING, Capability
from tridentify.estimation.methods.filtered.svf_least_squares import least_squares
from tridentify.estimation.search.delays import Located
from tridentify.estimation.search.starts import discrete_poles, laguerre_starts
from tridentify.numerics.arrays import Complex
from tridentify.numerics.realization import sort_poles
from tridentify.numerics.robust import Loss
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

GAP = 20.0
"""Typical intervals between two samples from which a record is taken for two stretches, as a
straight line across is no output. For the start only, as the next two."""
FEWEST = 20
"""Samples of a stretch that a start can be made from."""
MOST = 20_000
"""Samples on the even grid of a stretch: what a start needs of it."""


@dataclass(frozen=True)
class OutputError:
    """Least squares on the output error from a single start, by Levenberg-Marquardt.

    Parameters
    ----------
    start : TransferFunction, optional
        Where to begin. Only its denominators are used, which all channels must share where the
        structure says so: numerators and nuisance terms are fitted at every denominator. Unstable
        poles are reflected. Without it the start is a series-parallel model of the raw record; for
        separate denominators it is a Laguerre model, reduced channel by channel.
    max_passes : int
        Most steps on the output error.
    loss : {"squared", "huber", "student"}
        What is minimised, as in `ThreeModel`.
    tolerance : float
        Fall of ``-2 log L`` below which the next step is not worth while, as in `ThreeModel`.

    Raises
    ------
    OptionError
        For options that make no sense.

    References
    ----------
    .. [1] L. Ljung, System Identification: Theory for the User, 2nd ed., Prentice Hall 1999.
    .. [2] R. V. Jategaonkar, Flight Vehicle System Identification: A Time-Domain Methodology,
       2nd ed., AIAA 2015.
    .. [3] G. H. Golub, V. Pereyra, SIAM Journal on Numerical Analysis 10(2), 1973, 413-432.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> u = np.sign(np.sin(np.arange(200) ** 1.5))
    >>> y = simulate(TransferFunction([0.5], [1, 1, 3]), Record(u, u, dt=0.05))
    >>> method = OutputError(start=TransferFunction([1.0], [1, 2, 2]))
    >>> identify(Record(u, y, dt=0.05), Structure(2, 0), method).theta.round(8).tolist()
    [1.0, 3.0, 0.5]
    """

    start: TransferFunction | None = None
    max_passes: int = 60
    loss: Loss = "squared"
    tolerance: float = SETTLED

    name: ClassVar[str] = "OutputError"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = EVERYTHING
    """All of them."""

    def __post_init__(self) -> None:
        if not (self.start is None or isinstance(self.start, TransferFunction)):
            raise OptionError(
                f"found start={type(self.start).__name__}; expected a TransferFunction or None; "
                "write for example TransferFunction([1.0], [1.0, 2.0, 2.0])"
            )
        check_count("max_passes", self.max_passes)
        check_tolerance(self.tolerance)
        check_loss(self.loss)

    @property
    def patience(self) -> Patience:
        """How long steps on the output error go on."""
        return Patience(self.max_passes, self.tolerance)

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Progress | None = None
    ) -> Estimate:
        """Estimate the coefficients.

        Parameters
        ----------
        records : sequence of Record
            One or several experiments on the same system, each with nuisance terms of its own.
        structure : Structure
            Where nuisance terms are ``"auto"``, AICc decides among the choices.
        progress : callable, optional
            Told in words what is going on.

        Returns
        -------
        Estimate
            With the status of the point where the steps ended; a minimum, but not necessarily the
            lowest.

        Raises
        ------
        DataError, StructureError
            If records and structure are not usable or not supported; `OptionError` if the start's
            order or channels differ from those asked for.
        IdentifiabilityError
            If the data cannot determine the coefficients.
        """
        say = progress or silently
        check(records, structure, self.name, self.capabilities)
        self._check_start(records[0], structure)
        if self.loss != "squared":
            plain, near = (
                replace(self, loss="squared"),
                partial(OutputError, max_passes=self.max_passes, tolerance=self.tolerance),
            )
            return robust_estimate(records, structure, self.loss, plain, near, say)
        asked = Request.of(records, structure, self.name)
        if structure.constrained:
            return constrained_at_own_levels(
                lambda own: within_constraints(
                    self, replace(asked, records=tuple(own)), say, self.patience, "white"
                ),
                records,
            )
        given = None if self.start is None else self.start.delay.max(axis=0)

        def ended(own: Sequence[Record], _: Complex | None) -> Ending:
            if structure.delay == "free":
                return over_delays(self, own, structure, say, given)
            return self.maximise(own, structure, say)

        ending, used = at_own_levels(ended, records)
        return estimate_from(ending, replace(asked, records=tuple(used)))

    def maximise(
        self,
        records: Sequence[Record],
        structure: Structure,
        say: Progress,
        located: Located | None = None,
    ) -> Reached:
        """The minimum that the single start leads to.

        Parameters
        ----------
        records : sequence of Record
        structure : Structure
            With delays that are known, and nothing else.
        say : callable
            Is told what is going on.
        located : Located, optional
            Delays to take up, and how far they may go.
        """
        question = Question.of(records, structure, patience=self.patience, say=say)
        base, variants = question.base, question.variants
        say("a single start")
        # a model without its integrators is another one than the start given
        start = self.start if self._has_orders(records[0], structure) else None
        if located is None or located.place.poles.size == 0:
            poles, note = _start_poles(base, variants, records, structure, start)
        else:
            poles = located.place.poles
            note = "a Laguerre model at the delays found, reduced and refined"
        if located is not None:
            question = question.delayed(located.place.delays).freed(located.limits)
        found = decide(question, [poles])
        first = evaluate_variant(question.base, question.variant_of(found.best.nuisances), poles)
        recorder = Recorder()
        step = Step(
            "series-parallel" if start is None else "output error",
            base.lower_coefficients(first.poles),
            mean_square(first),
            first.condition,
            note,
        )
        recorder.add(first, lambda: (step,), np.nan, note)
        recorder.extend(found.best.recorder)
        begun = Start(note, coefficients(first), mean_square(first))
        trace = Trace(tuple(recorder.passes), (begun,), found.decisions, found.best.why)
        return Reached.of(found.best, trace)

    def weighed(self, reached: Reached, say: Progress) -> Ending:
        """There: at the minimum."""
        return reached

    def _has_orders(self, record: Record, structure: Structure) -> bool:
        """Whether the start has the denominators that are asked for."""
        if self.start is None:
            return False
        wanted = structure.poles_matrix(record.n_outputs, record.n_inputs)
        pairs = zip(self.start.den, wanted, strict=True)
        return all(
            d.size - 1 == n for dens, orders in pairs for d, n in zip(dens, orders, strict=True)
        )

    def _check_start(self, record: Record, structure: Structure) -> None:
        """Refuse a start for other orders or channels."""
        if self.start is None:
            return
        if self.start.n_inputs != record.n_inputs or self.start.n_outputs != record.n_outputs:
            raise OptionError(
                f"found a start with {self.start.n_inputs} inputs and {self.start.n_outputs} "
                f"outputs; expected {record.n_inputs} and {record.n_outputs} as in the record; "
                "give every channel a numerator"
            )
        if structure.shared and self.start.common_denominator is None:
            raise OptionError(
                "found a start whose channels have different denominators; expected one that all "
                "share; give TransferFunction a single den, or nest the poles of the structure"
            )
        wanted = structure.poles_matrix(record.n_outputs, record.n_inputs)
        for dens, orders in zip(self.start.den, wanted, strict=True):
            for den, n in zip(dens, orders, strict=True):
                if den.size - 1 != n:
                    raise OptionError(
                        f"found a start with {den.size - 1} poles for a structure with {n}; "
                        "expected the same order; change one of the two"
                    )


def _start_poles(
    base: Problem,
    variants: Sequence[Variant],
    records: Sequence[Record],
    structure: Structure,
    start: TransferFunction | None,
) -> tuple[Complex, str]:
    """Admissible poles to begin with, and in words where they come from."""
    if start is None and not structure.shared:
        best = laguerre_starts(base, variants)[0]
        points = [evaluate_variant(base, best.variant, one) for one in best.candidates()]
        poles = min(points, key=lambda point: point.objective).poles
        return poles, f"{best.name}, reduced channel by channel"
    if start is None:
        return _own_start(base, records, structure)
    found = []
    for group in base.groups:
        i, j = group.channels[0]
        found.append(sort_poles(np.roots(start.den[i][j]).astype(np.complex128)))
    poles, note = base.admissible(np.concatenate(found))
    return poles, f"the start given, {note}" if note else "the start given"


def _own_start(
    base: Problem, records: Sequence[Record], structure: Structure
) -> tuple[Complex, str]:
    """Poles of the series-parallel model of the raw record, or of a difference equation.

    The latter where no state-variable filter gives signals that can be told apart, as with many
    poles.
    """
    even = [part for record in records for part in _even(record, structure)]
    try:
        if not even:
            raise IdentifiabilityError("found no stretch without gaps")
        model = least_squares(even, replace(structure, delay=0.0), None).fit.model
    except (IdentifiabilityError, DataError):
        return discrete_poles(base), "discrete-time least squares on the raw record"
    note = "state-variable-filter least squares on the raw record"
    return base.admissible(model.poles)[0], f"{note}, {model.note}" if model.note else note


def _joined(record: Record) -> Record:
    """The record with missing output samples on straight lines between their neighbours."""
    missing = np.isnan(record.y)
    if not missing.any():
        return record
    y = np.array(record.y)
    for i, lost in enumerate(missing.T):
        if not lost.all():
            y[lost, i] = np.interp(record.t[lost], record.t[~lost], y[~lost, i])
    return record._derive(y=np.nan_to_num(y), intersample=record.behaviour)


def _even(record: Record, structure: Structure) -> list[Record]:
    """Stretches on an even grid, the inputs late by their delays: good enough for a start.

    What lies between the samples of the output is a straight line. Where an input has several
    delays its mean counts.
    """
    delays = np.mean(structure.delay_matrix(record.n_outputs, record.n_inputs), axis=0)
    held = record.behaviour != "band-limited"
    if record.dt is not None and not delays.any() and held:
        return [_joined(record)]
    steps = np.diff(record.t)
    edges = np.flatnonzero(steps > GAP * np.median(steps)) + 1
    found = []
    for part in np.split(np.arange(record.n_samples), edges):
        own = record.t[part]
        seen = np.isfinite(record.y[part])
        if part.size < FEWEST or seen.sum(axis=0).min() < FEWEST:
            continue
        duration = own[-1] - own[0]
        count = int(min(duration / typical_step(own), MOST))
        grid = own[0] + np.arange(count + 1) * (duration / count)
        u = np.empty((grid.size, record.n_inputs))
        for j, delay in enumerate(delays):
            if record.behaviour == "zoh":
                last = np.searchsorted(record.t, grid - delay + 1e-9 * duration / count, "right")
                u[:, j] = record.u[np.maximum(last - 1, 0), j]
            else:
                u[:, j] = np.interp(grid - delay, record.t, record.u[:, j])
        y = np.column_stack(
            [
                np.interp(grid, own[s], one[s])
                for s, one in zip(seen.T, record.y[part].T, strict=True)
            ]
        )
        found.append(
            Record(
                u,
                y,
                dt=duration / count,
                intersample="zoh" if record.behaviour == "zoh" else "foh",
                input_names=record.input_names,
                output_names=record.output_names,
            )
        )
    return found
