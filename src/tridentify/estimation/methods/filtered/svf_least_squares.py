"""State-variable-filter least squares: one linear regression on the raw record.

The equation error ``(a / c) y - (b / c) u - (c_0 / c) delta`` of the *recorded* output is
minimised by least squares (Young 1964; Garnier, Mensler & Richard 2003). It is the series-parallel
model of the paper applied to the raw data, and the yardstick for what the three models gain. The
equations, the nuisance terms and the covariance are derived in
`methods.filtered.state_variable_filters`.

*Bias.* The noise of ``y`` stands in the regressors, so its square enters the normal equations: the
estimate tends to a limit that is not the truth, the further away the more noise there is (paper,
eq. 6-9; Soderstrom & Stoica 1989, section 8.1). The covariance is that about the limit, from the
derivative of the solution with respect to the samples; it does not contain the bias. Without noise
an error of order ``dt^2`` remains, as ``y`` between samples is joined by straight lines.

*Filter.* Where none is given, ``c = (p + lambda)^n`` with ``lambda`` on a logarithmic grid, three a
decade, from the fastest rate that the record can show (0.7 / dt) down to the slowest (3 / T). The
grid hangs at the fast end, so that a record that is cut a little differently has the same one.
Every ``lambda`` gives a model; the one with the lowest AICc of its *simulated* output is taken,
after one more half a grid step on either side of it, as the models of a resonant plant are
sensitive to ``lambda``. The equation error itself cannot judge, as its size depends on the filter.
Nothing is tuned: the estimate of a record whose time is counted in other units is the same.

*Nuisance terms* that the structure leaves open are decided by the same number. The grid is run for
the leanest and the fullest choice; the others are solved at the better filter of the two, and the
grid is run for the best of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tridentify.errors import IdentifiabilityError, UnsupportedOrderError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Pass, Start, Status, Step, Trace
from tridentify.estimation.likelihood.literal import literal_estimate
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build, candidates
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.methods.base import Progress, check
from tridentify.estimation.methods.capability import Capability, refuse_missing
from tridentify.estimation.methods.filtered.filter_cascade import (
    Filter,
    check_rates,
    checked_filter,
    filter_cascade,
)
from tridentify.estimation.methods.filtered.state_variable_filters import (
    SvfFit,
    backward,
    bank_of,
    coefficient_map,
    equation,
    fit,
    unreduced,
    with_filtered,
)
from tridentify.estimation.search.band import rate_limits
from tridentify.models.regression import Experiment
from tridentify.numerics.arrays import Array
from tridentify.numerics.realization import cascade
from tridentify.record.record import Record
from tridentify.structure import Structure

PER_DECADE = 3.0
"""Filters tried in a decade, a factor of two apart; those halfway to the best one's neighbours are
tried too. Halved, three of ten estimates move; doubled, one."""
BIASED = "standard errors: about the limit to which noise biases the estimate, without that bias"


@dataclass(frozen=True)
class SvfLeastSquares:
    """Least squares on the filtered input and output: quick, and biased by noise.

    Parameters
    ----------
    filter : sequence of float, optional
        Coefficients of ``c(p)``, descending powers; stable, of at least as many roots as there are
        poles. None: ``(p + lambda)^n`` chosen from the record.

    Raises
    ------
    OptionError
        For a filter that makes no sense.

    References
    ----------
    .. [1] P. C. Young, Simulation 3(1) (1964), 45-58.
    .. [2] H. Garnier, M. Mensler, A. Richard, Int. J. Control 76(13) (2003), 1337-1357.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, SvfLeastSquares, TransferFunction
    >>> from tridentify import identify, simulate
    >>> u = np.sign(np.sin(np.arange(100) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.01))
    >>> estimate = identify(Record(u, y, dt=0.01), Structure(1, 0), SvfLeastSquares())
    >>> estimate.theta.round(2).tolist()
    [4.0, 2.0]
    """

    filter: Sequence[float] | None = None

    name: ClassVar[str] = "SvfLeastSquares"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = Capability.NONE
    """The plain case only."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "filter", checked_filter(self.filter))

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Progress | None = None
    ) -> Estimate:
        """Estimate the coefficients.

        Parameters
        ----------
        records : sequence of Record
        structure : Structure
        progress : callable, optional

        Returns
        -------
        Estimate
            Its status is `Status.SETTLED`, as least squares on the equation error does not end on
            a stationary point of the output error; ``nan`` covariance if a pole was reflected.

        Raises
        ------
        DataError, StructureError
            If records and structure are not usable or not supported, such as missing outputs.
        IdentifiabilityError
            If the filtered signals are linearly dependent.
        """
        check(records, structure, self.name, self.capabilities)
        refuse_missing(records, self.name)
        if progress:
            progress("least squares on the filtered record")
        best = least_squares(records, structure, self.filter)
        best = replace(best, decisions=(*best.decisions, BIASED))
        stopped = "one linear least-squares problem for each filter"
        return svf_estimate(best, best.fit, (), records, structure, stopped, self.name)


@dataclass(frozen=True, eq=False)
class Tried:
    """One filter and choice of nuisance terms.

    Attributes
    ----------
    choice : int
        Position among `likelihood.setup.nuisance.candidates`.
    label : str
        The filter in words.
    experiments : tuple of Experiment
        `with_filtered` by the filter.
    fit : SvfFit
    """

    choice: int
    label: str
    experiments: tuple[Experiment, ...]
    fit: SvfFit


@dataclass(frozen=True, eq=False)
class Chosen:
    """The filter and the nuisance terms that were taken, and how the others fared.

    Attributes
    ----------
    nuisances : Nuisances
    problem : Problem
    experiments : tuple of Experiment
        `with_filtered` by the filter.
    fit : SvfFit
    label : str
        The filter in words.
    tried : tuple of Tried
        Every filter, with these nuisance terms.
    decisions : tuple of str
    """

    nuisances: Nuisances
    problem: Problem
    experiments: tuple[Experiment, ...]
    fit: SvfFit
    label: str
    tried: tuple[Tried, ...]
    decisions: tuple[str, ...]

    @property
    def starts(self) -> tuple[Start, ...]:
        """Every filter tried, with the output error of its model."""
        return tuple(
            Start(one.label, one.fit.model.theta, one.fit.model.mean_square) for one in self.tried
        )


def least_squares(
    records: Sequence[Record], structure: Structure, filter: Sequence[float] | None
) -> Chosen:
    """Solve for every filter and choice of nuisance terms; the lowest AICc of the output error.

    Parameters
    ----------
    records : sequence of Record
        Checked.
    structure : Structure
    filter : sequence of float or None
        Given, or to be chosen.

    Raises
    ------
    IdentifiabilityError
        If no filter gives signals that can be told apart.
    """
    choices = candidates(records, structure)
    problems = [build(records, structure, one) for one in choices]
    tried: list[Tried] = []
    failed: list[IdentifiabilityError] = []

    def attempt(k: int, label: str, c: Filter) -> None:
        experiments = tuple(with_filtered(e, c) for e in problems[k].experiments)
        try:
            tried.append(Tried(k, label, experiments, fit(problems[k], experiments, c)))
        except IdentifiabilityError as error:
            failed.append(error)

    n_poles = problems[0].n_poles
    filters = candidate_filters(problems[0], filter)
    for k in sorted({0, len(choices) - 1}):
        for label, c in filters.items():
            attempt(k, label, c)
    if not tried:
        raise failed[0]
    likely = min(tried, key=_criterion).label
    between = range(1, len(choices) - 1)
    for k in between:
        attempt(k, likely, filters[likely])
    chosen = min(tried, key=_criterion).choice
    for label, c in filters.items() if chosen in between else ():
        if label != likely:
            attempt(chosen, label, c)
    if filter is None:
        lowest = min((one for one in tried if one.choice == chosen), key=_criterion)
        rate = -lowest.fit.c.poles[0].real
        for side in (-1, 1):
            attempt(chosen, *_power(rate * 10.0 ** (side / PER_DECADE / 2.0), n_poles))
    own = tuple(one for one in tried if one.choice == chosen)
    best = min(own, key=_criterion)
    decisions = _decided(choices, chosen, tried)
    return Chosen(
        choices[chosen], problems[chosen], best.experiments, best.fit, best.label, own, decisions
    )


def _criterion(one: Tried) -> float:
    return one.fit.model.criterion


def candidate_filters(problem: Problem, filter: Sequence[float] | None) -> dict[str, Filter]:
    """The filter given, or those on the grid, by what they are called."""
    n = problem.n_poles
    if filter is not None:
        given = filter_cascade(filter, n)
        check_rates(given.poles, "filter", problem.experiments)
        return {"given filter": given}
    low, high = rate_limits(problem)
    count = max(4, int(PER_DECADE * np.log10(high / low)) + 1)
    return dict(_power(high * 10.0 ** (-k / PER_DECADE), n) for k in range(count))


def _power(rate: float, n_poles: int) -> tuple[str, Filter]:
    """``(p + rate)^n_poles``, with what it is called."""
    poles = np.full(n_poles, -rate, dtype=np.complex128)
    return f"filter (p + {rate:.4g})^{n_poles}", Filter.of(cascade(poles))


def _decided(choices: Sequence[Nuisances], best: int, tried: Sequence[Tried]) -> tuple[str, ...]:
    if len(choices) == 1:
        return ()
    lowest: dict[int, float] = {}
    for one in tried:
        lowest[one.choice] = min(_criterion(one), lowest.get(one.choice, np.inf))
    others = sorted((k for k in lowest if k != best), key=lambda k: lowest[k])
    listed = "; ".join(f"{choices[k].label} {lowest[k] - lowest[best]:+.1f}" for k in others)
    return (choices[best].told(f"lowest AICc of the simulated output ({listed})"),)


def described(number: int, found: SvfFit, note: str) -> Pass:
    """A linear solution as a pass of the trace."""
    step = Step("series-parallel", found.model.theta, found.cost, found.condition, note)
    model = found.model
    return Pass(number, (step,), model.theta, model.mean_square, note=model.note)


def svf_estimate(
    chosen: Chosen,
    found: SvfFit,
    passes: Sequence[Pass],
    records: Sequence[Record],
    structure: Structure,
    stopped: str,
    method: str,
) -> Estimate:
    """An `Estimate` of the model as solved, with the covariance of equation (2) of `filtered`.

    Parameters
    ----------
    chosen : Chosen
    found : SvfFit
        What is reported; ``passes`` are those that led to it (none: it is the first).
    passes : sequence of Pass
    records : sequence of Record
    structure : Structure
    stopped, method : str
    """
    model = found.model
    own = passes or (described(1, found, f"recorded output, {chosen.label}"),)
    literal = model.literal(chosen.nuisances)
    return literal_estimate(
        Request.of(records, structure, method),
        literal,
        Status.SETTLED,
        Trace(tuple(own), chosen.starts, chosen.decisions, stopped),
        cov=covariance(found, chosen.experiments, literal.noise_variance),
        aicc=model.criterion,
        condition=found.condition,
    )


def covariance(found: SvfFit, experiments: Sequence[Experiment], noise: Array) -> Array:
    """Covariance of ``theta`` for white noise at the samples, equation (2) of the filters.

    Parameters
    ----------
    found : SvfFit
    experiments : sequence of Experiment
        `with_filtered`.
    noise : (n_outputs,) array
        Noise variances.

    Returns
    -------
    (n_coefficients, n_coefficients) array
        ``nan`` where a pole was reflected or held: the model then is not the solution of (1).
    """
    problem, c, source = found.model.problem, found.c, found.source
    if found.model.note:
        return np.full((problem.n_coefficients,) * 2, np.nan)
    bank = bank_of(c, source)
    model = None if source is None else source.response
    rows = [unreduced(e, bank) for e in experiments]
    eq = equation(problem, rows, bank, c, found.weights, model)
    n, basis = problem.n_poles, Filter.of(c).basis
    filter_row = found.unknowns[eq.width["a"]] @ basis.rows[:n]
    direct = 1.0 if c.order == n else 0.0
    if c.order > n:
        filter_row = filter_row + basis.rows[n] / basis.leading[n]
    error = eq.matrix @ found.unknowns - eq.target
    root = []
    for e, experiment in enumerate(experiments):
        for i in range(problem.n_outputs):
            own = (eq.owner == (e, i)).all(axis=1)
            z = eq.instruments[own]
            g = direct * z + backward(z, filter_row, c, experiment.dt)
            if source is None:
                left = error[own][:, None]
                for k in range(n):
                    g[:, k] += backward(left, basis.rows[k], c, experiment.dt)[:, 0]
            root.append(np.sqrt(noise[i]) * found.weights[i] * g)
    scale = np.linalg.norm(eq.instruments, axis=0), np.linalg.norm(eq.matrix, axis=0)
    cross = (eq.instruments / scale[0]).T @ (eq.matrix / scale[1])
    try:
        gain = np.linalg.solve(cross, (np.vstack(root) / scale[0]).T) / scale[1][:, None]
    except np.linalg.LinAlgError as error:
        raise UnsupportedOrderError(
            "found instruments that are no more independent than their rounding; expected ones "
            "that tell the coefficients apart; use fewer poles or zeros, or move the input more"
        ) from error
    spread = coefficient_map(problem, c, eq.width)[1] @ gain
    return np.asarray(spread @ spread.T)
