"""The three models on-line as the paper has them: every weight by the gradient rule.

    d beta_i / dt = lambda_i eps phi_i                                     (paper, Step 1)

moves the weights of all three models with every sample, in cascade:

*Step 1*, the parallel model ``y_M = sum beta_i W_i u``. ``W_i`` are orthonormal functions: Laguerre
functions, which span what the all-pass powers of the paper's eq. (4) span, or those on the poles of
the model, twice each.

*Step 2*, the series-parallel model on a noise-free output, ``eps = (a / c) y_M - (b / c) u``. Its
regressors are ``y_M`` and ``u`` through the filter; as ``y_M`` is a combination of the states of a
bank, so are they, with weights that are linear in the present ``beta``. Nothing is lost between the
samples.

*Step 3*, the series model ``y ~ (b_hat / a_hat) u + sum beta_i W_i (b_hat / a_hat) u``, with the
model as of the last tick. A weight of ``W_0 = 1`` can only scale ``b_hat``. Where ``b`` has several
coefficients each of them gets a weight, ``sum_j beta_j (p^j / a_hat) u``; for a constant ``b``
that is the paper's model. The regressors are then the derivatives of the output with respect to
all coefficients, so a point where nothing moves is a stationary point of the output error.

*Step 4*: from the first tick on Step 2 works on the output of Step 3. At a tick the model becomes
what Step 2 has found, ``c`` its denominator, and the bank moves on to its poles, three times each;
states and weights go over so that the parallel model does not jump, and Steps 2 and 3 begin anew at
the same physical model, ``beta = (1, 0, ..., 0)``. A model that has hardly moved, such that what is
of second order in the move stays below the standard error, is left as it is.

*Step length.* Backward Euler over a sample is stable for any rate (`numerics.recursive`).
``lambda_i`` is ``rate`` over the mean square of ``phi_i``: then a coefficient has the time constant
``1 / rate`` whatever the units, if the regressors are orthogonal. The paper asks for operators that
are; functions that are orthonormal for white noise are not for a recorded input, and the rule is
then slower by the condition number of their correlations, often thousands. So at each tick the
operators are made orthogonal for the input seen, by the running mean of ``z z'``
(``orthogonal=False`` leaves them as they are). Directions that carry less than 1e-8 of what
their members do are left slow.

*Averages.* At a fixed rate the weights never come to rest: they hold the noise of the last ``1 /
rate`` seconds. The mean over many time constants is as good as least squares (Polyak & Juditsky
1992). Step 2's coefficients are averaged over periods of six time constants. If ``rate`` is not
given the clock slows down: when there are sixteen periods they are joined two by two, the period
doubles and the rate is halved, so that the gain falls like ``1 / t`` and the estimate, the mean
over all but the oldest quarter (and the first two periods), converges. A ``rate`` that is given
stays, and the mean is over the last six periods: that is for coefficients that move. One over the
rate should be many samples for each unknown; a rate near one over the sampling interval is stable
but biased, as Step 2 then works on the noise that Step 3 has followed.

*Standard errors* are those of the scatter of ten or more periods (batch means), widened by
Student's distribution; with fewer they are those of least squares over the samples averaged. Where
the scores say that the noise is coloured, neither is less than their scatter makes that of least
squares (`online.scatter`). Neither tells of a bias or a lag: what a convergence that is not
complete leaves, or coefficients that move. The regressors of Step 2 hold what noise the weights of
Step 3 carry, and so does its equation error: a bias of second order, which shrinks with the rate,
and may be as large as the standard error where noise is strong.

References
----------
A. Silvestrov, M. Ostroverkhov, L. Spinul, O. Khalimovskyy, H. Veshchykov, System Research and
Information Technologies 2025(2).
B. T. Polyak, A. B. Juditsky, SIAM J. Control Optim. 30(4) (1992), 838-855.
L. Ljung, T. Soderstrom, Theory and Practice of Recursive Identification, MIT Press 1983.
P. C. Young, Recursive Estimation and Time-Series Analysis, 2nd ed., Springer 2011.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np

from tridentify.errors import OptionError
from tridentify.estimation.answer.estimate import Estimate, Status, Trace
from tridentify.estimation.methods.base import check_count
from tridentify.estimation.methods.filtered.filter_cascade import checked_filter
from tridentify.numerics.arrays import Array
from tridentify.numerics.slices import Slices, drain
from tridentify.numerics.threads import one_blas_thread
from tridentify.online import search
from tridentify.online.asked import check_above_zero, check_choice, not_ready, refuse_drift
from tridentify.online.estimator import CompiledKernels, check_asked, kept_samples
from tridentify.online.findings import noise_finding, with_findings
from tridentify.online.gradient_rule.follow import (
    GradientRule,
    extra_of,
    followed,
    launched,
    nuisance_of,
    periods_of,
)
from tridentify.online.gradient_rule.periods import (
    as_scattered,
    average,
    coefficients_of,
    expected_covariance,
    first_rate,
    mean_of,
    moments_of,
    noise_of,
    outputs_of,
    present,
    put_unknowns,
    scatter,
    signals_of,
    used_of,
)
from tridentify.online.gradient_rule.plan import Basis, plan, with_tables
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.layout import Blueprint, NuisanceColumns, Setting, Stage, collecting, fresh
from tridentify.online.result import assembled
from tridentify.online.saved.state import State
from tridentify.online.starting import waiting, without
from tridentify.online.steps import doubted
from tridentify.online.task import Task
from tridentify.online.unexplained import doubt_finding, doubting
from tridentify.transfer_function import TransferFunction

WARM_UP = 10
"""Samples for each unknown before the first period begins, and one over the quickest rate in
samples."""
SCATTERED = 10
"""Periods from which their scatter gives the standard errors: ten tell one to a quarter."""
REFIT_ROUNDS = 3
"""Times that the kept samples are fitted again without those that the model finds doubtful."""


@dataclass(frozen=True)
class Gradient(GradientRule):
    """The three models by the gradient rule, one sample at a time.

    Parameters
    ----------
    rate : float, optional
        One over the time constant of every weight [1/s]. Without it the rate begins with what the
        first samples suggest and falls like one over the time, so that the estimate converges.
    gamma : float, optional
        Parameter of the Laguerre functions of the paper's fixed basis [rad/s]: then nothing is
        searched, and the strategy begins on this basis.
    n_operators : int
        How many of them.
    filter : sequence of float, optional
        Coefficients of the first ``c(p)``, descending powers; by default ``(p + gamma)^(n + 1)``.
        Given without ``gamma``, the latter is the geometric mean of its roots' magnitudes.
    start : TransferFunction or Estimate, optional
        Model to begin with; without it and without ``gamma`` the first samples are searched.
    on_change : {"restart", "flag"}
        Whether a change of the coefficients makes the estimator begin anew, or is only flagged.
    orthogonal : bool
        Whether the operators are made orthogonal for the input that was seen.

    Raises
    ------
    OptionError
        An option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, online, simulate
    >>> u = np.sign(np.sin(np.arange(2000) ** 1.5))
    >>> y = simulate(TransferFunction([0.5], [1.0, 1.0, 3.0]), Record(u, u, dt=0.05))
    >>> method = online.Gradient(gamma=2.0, filter=(1.0, 5.0, 6.0, 7.0))
    >>> run = online.run(method, Record(u, y, dt=0.05), Structure(2, 0))
    >>> run.estimate.theta.round(2).tolist()
    [1.0, 3.0, 0.5]
    """

    rate: float | None = None
    gamma: float | None = None
    n_operators: int = 3
    filter: tuple[float, ...] | None = None
    start: TransferFunction | None = None
    on_change: str = "restart"
    orthogonal: bool = True

    name: ClassVar[str] = "gradient"

    @staticmethod
    @cache
    def kernels() -> CompiledKernels:
        """The compiled sample loop."""
        from tridentify.online.kernels.gradient import gradient_step

        return CompiledKernels(gradient_step)

    def __post_init__(self) -> None:
        check_above_zero("rate", self.rate, "1/s")
        check_above_zero("gamma", self.gamma, "rad/s")
        check_count("n_operators", self.n_operators)
        object.__setattr__(self, "filter", checked_filter(self.filter))
        object.__setattr__(self, "start", search.checked_start(self.start))
        check_choice("on_change", self.on_change, ("restart", "flag"))
        if self.start is not None and self.fixed:
            raise OptionError(
                "found start with gamma or filter; expected one of the two, as both say where to "
                "begin; leave one out"
            )

    @property
    def fixed(self) -> bool:
        """Whether it begins on the fixed basis of the paper."""
        return self.gamma is not None or self.filter is not None

    # ------------------------------------------------------------------------------ the beginning
    def begin(self, setting: Setting) -> State:
        """The state before the first sample."""
        refuse_drift(self.name, setting)
        if not self.fixed and self.start is None:
            return waiting(self, setting)
        nuisance = nuisance_of(setting, False)
        if self.start is None:
            basis = self._paper_basis(setting, nuisance)
            return self._begun(basis, np.zeros(basis.unknowns))
        poles = search.poles_of_start(self.start, setting)
        basis = Basis.on_model(setting, nuisance, poles)
        return self._begun(basis, basis.unknowns_of(coefficients_of(self.start, setting)))

    def _paper_basis(self, setting: Setting, nuisance: NuisanceColumns) -> Basis:
        n, gamma = setting.n_poles, self.gamma
        if self.filter is None:
            assert gamma is not None
            poles = np.full(n + 1, -gamma, dtype=np.complex128)
        else:
            poles = search.filter_poles(self.filter, setting)
            if gamma is None:
                gamma = float(np.exp(np.mean(np.log(np.abs(poles)))))
        search.check_rates(np.array([gamma], dtype=np.complex128), "gamma", setting)
        return Basis.fixed(setting, nuisance, gamma, self.n_operators, poles)

    def _begun(self, basis: Basis, unknowns: Array) -> State:
        """With nothing known of the input."""
        setting = basis.setting
        rate = self.rate or first_rate(basis, 0.0)
        models = outputs_of(basis, unknowns)
        quick = max(rate, 1.0 / (WARM_UP * setting.dt))
        blueprint = with_tables(
            basis, plan(basis, True), models, models, None, np.ones(setting.n_outputs),
            orthogonal=self.orthogonal, rate=quick,
        )  # fmt: skip
        x = fresh(blueprint)
        x[places.FROM] = np.inf
        x[slots.TICK] = setting.late + WARM_UP * (basis.unknowns + setting.n_inputs)
        put_unknowns(blueprint, x, unknowns)
        stage = Stage(self, setting, blueprint, basis.filter_poles, searching=False)
        return State(x, stage.but(extra=extra_of(np.zeros((0, 0)), rate, 0)))

    def rebuilt(self, setting: Setting, blueprint: Blueprint) -> Blueprint:
        """The plan of a blueprint from a file, made again."""
        bank, keep = blueprint.poles, bool(blueprint.ints[slots.CHUNK])
        if not bank.size:
            return collecting(setting)
        nuisance = nuisance_of(setting, blueprint.nuisance.free)
        basis = Basis.on_model(setting, nuisance, bank[: setting.n_poles])
        if not blueprint.ints[places.SERIES]:
            kept = self.n_operators if self.fixed else bank.size
            basis = Basis(setting, nuisance, bank, bank[kept:], kept, False)
        if not np.array_equal(bank, basis.poles) or basis.filter_poles.size < setting.n_poles:
            raise ValueError("a bank that is not of this estimator")
        return plan(basis, keep)

    def is_ready(self, state: State) -> bool:
        """Whether the coefficients have been averaged, or are at least known in part."""
        return state.stage.blueprint.poles.size > 0 and len(self._batches(state)) > 0

    def _batches(self, state: State) -> Array:
        """All periods, the present one with them; none while there are too few samples."""
        x, stage = state
        blueprint = stage.blueprint
        basis = Basis.of(stage.setting, blueprint)
        batches = periods_of(stage)[0]
        if not len(batches) and x[places.SUMMED] < basis.unknowns:
            batches = present(basis, blueprint, x)
        elif x[places.SUMMED] > 0:
            theta, _ = mean_of(basis, blueprint, x)
            row = np.concatenate([[x[places.SUMMED]], theta])[None, :]
            batches = np.vstack([batches.reshape(-1, row.size), row])
        if not basis.adapted or (len(batches) and batches[:, 0].sum() < basis.unknowns):
            return batches[:0]
        return batches

    # ------------------------------------------------------------------------------- the slow clock
    def adapt(self, state: State) -> State:
        """A slice of the search, or let the model follow Step 2."""
        return self.search(state) if state.stage.searching else followed(self, state)

    def _searching_task(self, state: State, samples: Array, begun_anew: bool, full: bool) -> Task:
        """A model to begin with, from samples that it does not find doubtful."""
        now = State(state.values.copy(), state.stage)
        return Task(_searching, self, now, samples, begun_anew, full)

    def from_search(
        self,
        state: State,
        found: tuple[search.FoundPoles, Array] | None,
        newest: Array,
        begun_anew: bool,
        full: bool,
    ) -> State | None:
        """The models that begin at what was found."""
        if found is None:
            return None
        poles, samples = found
        begun = launched(self, state, poles, np.vstack([samples, newest]), begun_anew, full)
        return None if begun is None else begun[0]

    def begun_again(self, state: State, found: search.FoundPoles, samples: Array) -> State:
        """The estimator that goes on from the samples since a change."""
        begun = launched(self, state, found, samples, True, True)
        assert begun is not None
        return begun[0]

    # ------------------------------------------------------------------------------- the estimate
    def estimate(self, state: State) -> Estimate:
        """The coefficients with their standard errors.

        Parameters
        ----------
        state : State

        Returns
        -------
        Estimate
            Mean over the periods, as the module says.

        Raises
        ------
        NotReadyError
            The samples so far do not determine them.
        """
        check_asked(self, state)
        since, kept = int(state.values[slots.SINCE]), kept_samples(state)
        if not state.stage.blueprint.poles.size or since > len(kept):
            return self._bare(state)
        with one_blas_thread():
            return self._bare(state, kept[len(kept) - since :])

    def _bare(self, state: State, again: Array | None = None) -> Estimate:
        """The estimate; with all of its samples, if they are given, for a second look."""
        x, stage = state
        count = int(x[slots.COUNT])
        if not stage.blueprint.poles.size:
            raise not_ready(count, "are still searched for a model")
        setting, blueprint = stage.setting, stage.blueprint
        basis = Basis.of(setting, blueprint)
        batches = self._batches(state)
        if not len(batches):
            raise not_ready(count, "are too few for the gradient rule to come to rest")
        used = used_of(batches)
        theta = average(batches)
        try:
            # what overflows is not finite, and is refused below
            with one_blas_thread(), np.errstate(over="ignore", invalid="ignore"):
                noise = noise_of(blueprint, x)
                inverse, condition = expected_covariance(
                    basis, signals_of(basis, blueprint, x)[1], moments_of(blueprint, x), noise,
                    float(used[:, 0].sum()),
                )  # fmt: skip
                coloured = as_scattered(basis, blueprint, x, inverse, noise)
        except np.linalg.LinAlgError as error:
            raise not_ready(count, "do not determine the coefficients") from error
        matrix = basis.physical[1]
        with np.errstate(over="ignore", invalid="ignore"):
            white, cov = (matrix @ one @ matrix.T for one in (inverse, coloured))
        if not np.all(np.isfinite(cov)) or not np.all(np.isfinite(theta)):
            raise not_ready(count, "do not determine the coefficients")
        told = noise_finding(white, cov)
        if len(used) >= SCATTERED:
            periods = scatter(used)
            sizes = np.sqrt(np.diagonal(periods))
            least = np.sqrt(np.diagonal(cov)) / np.where(sizes > 0.0, sizes, np.inf)
            least = np.maximum(least, 1.0)
            cov = least[:, None] * periods * least if told else periods
        if again is not None:
            # what the rule has still to go is in this too
            std, cov = np.sqrt(np.diagonal(cov)), doubted(setting, again, theta, cov)
            doubt = drain(doubting(setting, again, theta, std))
            told = noise_finding(white, cov)
            told = told if doubt is None else (doubt_finding(doubt), *told)
        notes = (f"mean over {len(used)} periods", f"rate {blueprint.constants[places.RATE]:.3g}")
        trace = Trace((), (), notes, "gradient rule")
        found = assembled(
            setting, blueprint, x, theta, cov, noise, Status.SETTLED, trace, self.name, condition
        )
        return with_findings(state, replace(found, findings=told))


def _searching(
    method: Gradient, state: State, samples: Array, begun_anew: bool, full: bool
) -> Slices[tuple[search.FoundPoles, Array] | None]:
    """A model to begin with, and the kept samples without those that it finds doubtful."""
    setting, answer = state.stage.setting, None
    samples = yield from search.far_off(setting, samples)
    for _ in range(REFIT_ROUNDS):
        found = yield from search.searching(setting, samples, begun_anew)
        if found is None or not (found.certain or full):
            break
        yield
        begun = launched(method, state, found, samples, begun_anew, full)
        if begun is None:
            break
        answer = found, samples
        cleaned = without(samples, begun[1], setting.n_inputs)
        if cleaned is None:
            break
        samples = cleaned
    return answer
