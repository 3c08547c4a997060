"""Refined instrumental variables (SRIVC): prefilter and instruments follow the estimate.

For white noise at the samples the equation error ``(a / c) y - (b / c) u`` is white when ``c`` is
``a`` itself, and the best instruments are then the noise-free regressors (Young & Jakeman 1980;
Soderstrom & Stoica 1989, section 8.2). Neither is known, so both come from the estimate before:

    y_0 = (b_hat / a_hat) u + (c_0 / a_hat) delta,
    Z = [- p^k / a_hat y_0, p^j / a_hat u, ...],   Phi = [- p^k / a_hat y, p^j / a_hat u, ...],
    Z' ((p^n / a_hat) y - Phi theta) = 0,                                                     (1)

until ``theta`` stops moving. Here ``a = a_hat (1 + alpha X)`` on the orthonormal functions ``X`` of
the poles of ``a_hat``, and the columns of ``b`` and of the nuisance terms are projected out of both
sides (Frisch-Waugh), so that with ``S`` the projected ``X y_0`` and ``r`` the output error,

    S' (r + X y alpha) = 0.                                                                   (2)

*Where it ends.* At a fixed point ``alpha = 0``, and (2) says ``S' r = 0``. ``-S`` are the
derivatives of the output error with respect to ``alpha``: a fixed point of (1) *is* a stationary
point of the output-error cost, for every record and not only for long ones. So for white Gaussian
noise the estimate is that of maximum likelihood and its covariance ``sigma^2 (Psi' Psi)^{-1}``, the
Cramer-Rao bound (Pan, Gonzalez, Welsh & Rojas 2020 prove consistency). The gradient is reported.

*Between the samples.* The input is what the record says; ``y_0`` and ``Z`` are exact. The recorded
``y`` is joined by straight lines for ``X y``. That error, ``O(dt^2)``, changes how fast the passes
settle but not where: at ``alpha = 0`` the column ``X y`` has no weight, and ``r`` has only the
samples of ``y`` in it. Without noise the coefficients come back to rounding at any ``dt`` at which
the passes settle [tests].

*Nuisance terms.* Offset and drift are taken off ``y`` before it is filtered, at their
least-squares values at ``a_hat``, and are columns of the output error; the free response is a
column too. Which of them a record needs is decided by AICc: the most promising choice is finished
first, then any other that promises a lower value after one Gauss-Newton step from there.

*Several outputs* share (2), each weighted by one over its output-error variance, which makes the
fixed points those of the concentrated likelihood.

*Start*: the better of `svf_least_squares` and one pass of `svf_instrumental_variable`, by AICc of
the simulated output.
A pole that becomes unstable, or leaves the band that the record can show, is reflected or held and
the trace says so. No proof of convergence exists for finite records; passes that run out are
reported as such.

References
----------
P. C. Young, A. J. Jakeman, Int. J. Control 31(4) (1980), 741-764.
P. C. Young, Recursive Estimation and Time-Series Analysis, 2nd ed., Springer 2011, chapter 8.
S. Pan, R. A. Gonzalez, J. S. Welsh, C. R. Rojas, Automatica 112 (2020), 108703.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from numbers import Integral, Real
from typing import ClassVar

import numpy as np

from tridentify.errors import IdentifiabilityError, OptionError, shown
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Pass, Start, Status, Step, Trace
from tridentify.estimation.likelihood.answer import Ending, estimate_from
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    at_rounding,
    coefficients,
    criterion,
    mean_square,
    status_at,
)
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build, candidates
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.likelihood.thresholds import TRUSTED
from tridentify.estimation.methods.base import Progress, check
from tridentify.estimation.methods.capability import Capability, refuse_missing
from tridentify.estimation.methods.filtered.state_variable_filters import (
    constants,
    filtered_outputs,
)
from tridentify.estimation.methods.filtered.svf_instrumental_variable import instrumental_passes
from tridentify.estimation.methods.filtered.svf_least_squares import least_squares
from tridentify.models.regression import Regression, regress
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.least_squares import column_norms, solve
from tridentify.numerics.realization import Cascade, cascade, denominator, roots_of
from tridentify.record.record import Record
from tridentify.structure import Structure


@dataclass(frozen=True)
class RefinedInstrumentalVariable:
    """Refined instrumental variables for continuous time (SRIVC): efficient for white noise.

    Parameters
    ----------
    max_passes : int
        Most passes for each choice of nuisance terms.
    tolerance : float
        The passes stop when one would move the coefficients by less than this many standard
        errors.

    Raises
    ------
    OptionError
        For options that make no sense.

    References
    ----------
    .. [1] P. C. Young, A. J. Jakeman, Int. J. Control 31(4) (1980), 741-764.
    .. [2] S. Pan, R. A. Gonzalez, J. S. Welsh, C. R. Rojas, Automatica 112 (2020), 108703.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, RefinedInstrumentalVariable, Structure, TransferFunction
    >>> from tridentify import identify, simulate
    >>> u = np.sign(np.sin(np.arange(200) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))
    >>> estimate = identify(Record(u, y, dt=0.02), Structure(1, 0), RefinedInstrumentalVariable())
    >>> estimate.theta.round(8).tolist()
    [4.0, 2.0]
    """

    max_passes: int = 50
    tolerance: float = 1e-4

    name: ClassVar[str] = "RefinedInstrumentalVariable"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = Capability.NONE
    """The plain case only."""

    def __post_init__(self) -> None:
        if not (isinstance(self.max_passes, Integral) and self.max_passes >= 1):
            raise OptionError(
                f"found max_passes={shown(self.max_passes)}; expected a whole number, at least 1; "
                "correct it"
            )
        if not (isinstance(self.tolerance, Real) and 0.0 < self.tolerance < np.inf):
            raise OptionError(
                f"found tolerance={shown(self.tolerance)}; expected a positive number of standard "
                "errors; correct it"
            )

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
            `Status.CONVERGED` when the coefficients stopped moving, else `Status.MAX_PASSES`.

        Raises
        ------
        DataError, StructureError
            If records and structure are not usable or not supported, such as missing outputs.
        IdentifiabilityError
            If the data cannot determine the coefficients.
        """
        say = progress or (lambda _: None)
        check(records, structure, self.name, self.capabilities)
        refuse_missing(records, self.name)
        say("least squares and instrumental variables on the filtered record")
        poles, starts = _start(records, structure)
        best, decisions = self._decide(records, structure, poles, say)
        trace = Trace(best.passes, starts, decisions, best.why)
        ending = Ending(best.point, best.nuisances, best.status, criterion(best.point), trace)
        return estimate_from(ending, Request.of(records, structure, self.name))

    def _decide(
        self, records: Sequence[Record], structure: Structure, poles: Complex, say: Progress
    ) -> tuple[_Settled, tuple[str, ...]]:
        """Settle the choices of nuisance terms in the order of what they promise."""
        choices = list(candidates(records, structure))
        problems = {choice: build(records, structure, choice) for choice in choices}
        done: list[_Settled] = []
        best: _Settled | None = None
        promised: dict[Nuisances, float] = {}
        while len(done) < len(choices):
            left = [choice for choice in choices if all(choice != one.nuisances for one in done)]
            if len(choices) > 1:
                promised = {choice: _promise(problems[choice], poles) for choice in left}
            choice = min(left, key=lambda one: promised.get(one, 0.0))
            if best and best.status.ok and criterion(best.point) <= promised[choice]:
                break
            say(f"refined instrumental variables ({choice.label})")
            done.append(_settle(problems[choice], choice, poles, self.max_passes, self.tolerance))
            best = min(done, key=_rank)
            poles = best.point.poles
        assert best is not None
        finished = {one.nuisances for one in done}
        open_ = {choice: value for choice, value in promised.items() if choice not in finished}
        return best, _decisions(best, done, open_)


@dataclass(frozen=True, eq=False)
class _Settled:
    """One choice of nuisance terms, and where its passes ended."""

    nuisances: Nuisances
    point: Point
    status: Status
    why: str
    passes: tuple[Pass, ...]


def _rank(one: _Settled) -> tuple[bool, float]:
    """Ends that are usable first, then AICc."""
    return not one.status.ok, criterion(one.point)


def _start(records: Sequence[Record], structure: Structure) -> tuple[Complex, tuple[Start, ...]]:
    """Poles of the better of least squares and instrumental variables."""
    first = least_squares(records, structure, None)
    models = [first.fit.model]
    with suppress(IdentifiabilityError):
        models.append(instrumental_passes(first, 1)[0].model)
    names = ("SvfLeastSquares", "SvfInstrumentalVariable")
    starts = tuple(
        Start(name, model.theta, model.mean_square)
        for name, model in zip(names, models, strict=False)
    )
    return min(models, key=lambda model: model.criterion).poles, starts


def _settle(
    problem: Problem, nuisances: Nuisances, poles: Complex, most: int, tolerance: float
) -> _Settled:
    """Passes from given poles until the coefficients stop moving."""
    passes: list[Pass] = []
    note, status, why = "", Status.MAX_PASSES, f"{most} passes"
    for number in range(1, most + 1):
        point, filtered = _filtered_point(problem, poles)
        alpha, moved, condition = _instrumental_step(point, filtered)
        step = Step(
            "series-parallel",
            denominator(point.poles)[1:],
            float(point.rss.sum() / point.counts.sum()),
            condition,
            "prefilter 1/a and instruments from the model of the pass before",
        )
        passes.append(_described(number, point, step, note))
        if moved < tolerance:
            status = status_at(note)
            why = f"the next pass would move the coefficients by {moved:.0e} standard errors"
            break
        if at_rounding(point):
            status, why = Status.CONVERGED, "the residual is down to rounding"
            break
        before = poles
        poles, note = problem.admissible(roots_of(point.inner, alpha))
        if note and np.allclose(poles, before, rtol=1e-9):
            status, why = status_at(note), f"stands still: {note}"
            break
    return _Settled(nuisances, point, status, why, tuple(passes))


def _described(number: int, point: Point, step: Step, note: str) -> Pass:
    theta = coefficients(point)
    return Pass(number, (step,), theta, mean_square(point), gradient=point.gradient, note=note)


def _filtered_point(problem: Problem, poles: Complex) -> tuple[Point, list[list[Array]]]:
    """The output error at given poles, and ``X y`` of every output and experiment beside it.

    Returns
    -------
    point : Point
    filtered : nested list of (r, n) arrays
        ``filtered[output][experiment]``, the constants of ``y`` taken off.
    """
    inner, bank = cascade(poles), cascade(np.tile(poles, 2))
    whole = [_with_states(problem, k, inner, bank) for k in range(len(problem.experiments))]
    n, n_outputs = problem.n_poles, problem.n_outputs
    kept = tuple(
        replace(
            one,
            signals=one.signals[:n_outputs],
            targets=one.targets[:n_outputs],
            counts=one.counts[:n_outputs],
        )
        for one in whole
    )
    point = evaluate(problem, poles, 2, kept)
    filtered: list[list[Array]] = []
    for i, fit in enumerate(point.fits):
        filtered.append([])
        for e, regression in enumerate(whole):
            states = np.column_stack(regression.targets[n_outputs:])
            own = states[:, n * i : n * (i + 1)]
            terms = fit.columns.pick(fit.solution.x, ("nuisance", e, i))
            # the constant is filtered for a drift too, but has a value only with an offset
            shift = states.shape[1] - n * (n_outputs + terms.size)
            for k, value in enumerate(terms):
                first = n * (n_outputs + k) + shift
                own = own - value * states[:, first : first + n]
            filtered[i].append(own)
    return point, filtered


def _with_states(problem: Problem, k: int, inner: Cascade, bank: Cascade) -> Regression:
    """The triangle of an experiment with ``X y`` as further outputs."""
    experiment = problem.experiments[k]
    states = filtered_outputs(experiment, inner, *constants(experiment))
    return regress(replace(experiment, y=np.column_stack([experiment.y, states])), bank)


def _instrumental_step(
    point: Point, filtered: Sequence[Sequence[Array]]
) -> tuple[Array, float, float]:
    """Equation (2): ``alpha``, its length in standard errors, and the condition."""
    scores, states, residual = [], [], []
    for i, fit in enumerate(point.fits):
        w = point.weights[i]
        raw = np.vstack(
            [point.score_states.signals(r, e, i) for e, r in enumerate(point.regressions)]
        )
        q = fit.solution.basis
        scores.append(w * (raw - q @ (q.T @ raw)))
        states.append(w * np.vstack(filtered[i]))
        residual.append(w * fit.residual)
    s = np.vstack(scores)
    basis = np.linalg.qr(s / column_norms(s))[0]
    found = solve(basis.T @ np.vstack(states), -(basis.T @ np.concatenate(residual)))
    return found.x, float(np.linalg.norm(s @ found.x)), found.condition


def _promise(problem: Problem, poles: Complex) -> float:
    """AICc at given poles, one Gauss-Newton step ahead."""
    point = evaluate(problem, poles)
    return criterion(point, min(point.decrease(), TRUSTED * float(point.counts.sum())))


def _decisions(
    best: _Settled, done: Sequence[_Settled], promised: dict[Nuisances, float]
) -> tuple[str, ...]:
    found = {one.nuisances: criterion(one.point) for one in done if one is not best} | promised
    if not found:
        return ()
    unusable = {one.nuisances: f" ({one.status.value})" for one in done if not one.status.ok}
    lowest = criterion(best.point)
    listed = "; ".join(
        f"{choice.label} {found[choice] - lowest:+.1f}{unusable.get(choice, '')}"
        for choice in sorted(found, key=lambda choice: found[choice])
    )
    return (best.nuisances.told(f"lowest AICc ({listed})"),)
