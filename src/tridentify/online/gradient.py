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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import OptionError, UnsupportedError, shown
from tridentify.estimation.answer.estimate import Estimate, Status, Trace
from tridentify.estimation.methods.filtered.state_variable_filters import checked_filter
from tridentify.numerics.arrays import Array
from tridentify.numerics.realization import denominator
from tridentify.numerics.slices import Slices
from tridentify.numerics.threads import one_blas_thread
from tridentify.online.asked import check_choice, not_ready
from tridentify.online.estimator import CompiledKernels, check_asked, kept_samples
from tridentify.online.findings import noise_finding, with_findings
from tridentify.online.gradient_periods import (
    PERIODS_TO_BE_SURE,
    as_scattered,
    average,
    begin_period,
    coefficients_of,
    columns_between,
    expected_covariance,
    first_rate,
    fitted_to,
    mean_of,
    near_enough,
    outputs_of,
    present,
    samples_of_period,
    scatter,
    stable_poles,
    used_of,
)
from tridentify.online.gradient_plan import Basis, Tables, plan
from tridentify.online.gradient_vector import (
    as_expected,
    models_of,
    moments_of,
    noise_of,
    put_parallel,
    put_unknowns,
    refer,
    signals_of,
    still_series,
    write_moments,
)
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.layout import (
    Blueprint,
    NuisanceColumns,
    Setting,
    collecting,
    constants_for,
    fresh,
    watch_of,
)
from tridentify.online.result import assembled
from tridentify.online.search import (
    FoundPoles,
    check_rates,
    checked_start,
    far_off,
    filter_poles,
    first_try,
    poles_of_start,
    searching,
)
from tridentify.online.starting import (
    admissible,
    advanced,
    again,
    calm,
    idle,
    run_kept,
    shortened,
    take_clocks,
    without,
)
from tridentify.online.state import Stage, State
from tridentify.online.summary import carried
from tridentify.online.suspecting import MOST_KEPT, Suspecting
from tridentify.online.task import Task
from tridentify.transfer_function import TransferFunction

WARM_UP = 10
"""Samples for each unknown before the first period begins, and one over the quickest rate in
samples."""
MOST_PERIODS, FIXED_PERIODS = 16, 8
"""Periods that are kept before neighbours are joined and the clock slows down; those that are
averaged where the rate is fixed."""
SCATTERED = 10
"""Periods from which their scatter gives the standard errors: ten tell one to a quarter."""
LINEAR = 0.1
"""Standard error over value of a denominator's coefficients up to which a first model is near
enough to linearise about."""
REFIT_ROUNDS = 3
"""Times that the kept samples are fitted again without those that the model finds doubtful."""
SETTLING = 2
"""Periods on a first basis before the poles are moved: the first one still forgets where it
began."""


@dataclass(frozen=True)
class Gradient(Suspecting):
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
    own_arrays: ClassVar[int] = 2

    @staticmethod
    @cache
    def kernels() -> CompiledKernels:
        """The compiled sample loop."""
        from tridentify.online.kernels.gradient import gradient_step

        return CompiledKernels(gradient_step)

    def __post_init__(self) -> None:
        _check_above_zero("rate", self.rate, "1/s")
        _check_above_zero("gamma", self.gamma, "rad/s")
        whole = isinstance(self.n_operators, int) and not isinstance(self.n_operators, bool)
        if not whole or self.n_operators < 1:
            raise OptionError(
                f"found n_operators={shown(self.n_operators)}; expected a whole number above zero; "
                "correct it"
            )
        object.__setattr__(self, "filter", checked_filter(self.filter))
        object.__setattr__(self, "start", checked_start(self.start))
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
        if setting.structure.drift is True:
            raise UnsupportedError(
                f"found drift=True; {self.name} on-line estimates no drift; leave it out, or use "
                "online.ThreeModel()"
            )
        if not self.fixed and self.start is None:
            blueprint = collecting(setting)
            x = fresh(blueprint)
            x[slots.TICK] = first_try(setting)
            return State(x, Stage(self, setting, blueprint, blueprint.poles))
        nuisance = _nuisance(setting, False)
        if self.start is None:
            basis = self._paper_basis(setting, nuisance)
            return self._begun(basis, np.zeros(basis.unknowns))
        poles = poles_of_start(self.start, setting)
        basis = Basis.on_model(setting, nuisance, poles)
        return self._begun(basis, basis.unknowns_of(coefficients_of(self.start, setting)))

    def _paper_basis(self, setting: Setting, nuisance: NuisanceColumns) -> Basis:
        n, gamma = setting.n_poles, self.gamma
        if self.filter is None:
            assert gamma is not None
            poles = np.full(n + 1, -gamma, dtype=np.complex128)
        else:
            poles = filter_poles(self.filter, setting)
            if gamma is None:
                gamma = float(np.exp(np.mean(np.log(np.abs(poles)))))
        check_rates(np.array([gamma], dtype=np.complex128), "gamma", setting)
        return Basis.fixed(setting, nuisance, gamma, self.n_operators, poles)

    def _begun(self, basis: Basis, unknowns: Array) -> State:
        """With nothing known of the input."""
        setting = basis.setting
        blueprint = plan(basis, True)
        rate = self.rate or first_rate(basis, 0.0)
        models = outputs_of(basis, unknowns)
        tables = self._tables(basis, models, models, None, np.ones(setting.n_outputs))
        quick = max(rate, 1.0 / (WARM_UP * setting.dt))
        blueprint = replace(tables, rate=quick).written(basis, blueprint)
        x = fresh(blueprint)
        x[places.FROM] = np.inf
        x[slots.TICK] = setting.late + WARM_UP * (basis.unknowns + setting.n_inputs)
        put_unknowns(blueprint, x, unknowns)
        stage = Stage(self, setting, blueprint, basis.filter_poles, searching=False)
        return State(x, stage.but(extra=_extra(np.zeros((0, 0)), rate, 0)))

    def rebuilt(self, setting: Setting, blueprint: Blueprint) -> Blueprint:
        """The plan of a blueprint from a file, made again."""
        bank, keep = blueprint.poles, bool(blueprint.ints[slots.CHUNK])
        if not bank.size:
            return collecting(setting)
        nuisance = _nuisance(setting, blueprint.nuisance.free)
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
        batches = _read(stage)[0]
        if not len(batches) and x[places.SUMMED] < basis.unknowns:
            batches = present(basis, blueprint, x)
        elif x[places.SUMMED] > 0:
            theta, _ = mean_of(basis, blueprint, x)
            row = np.concatenate([[x[places.SUMMED]], theta])[None, :]
            batches = np.vstack([batches.reshape(-1, row.size), row])
        if not basis.adapted or (len(batches) and batches[:, 0].sum() < basis.unknowns):
            return batches[:0]
        return batches

    def constants_for(self, blueprint: Blueprint, setting: Setting, intervals: Array) -> Array:
        """``c`` for samples that come after other intervals."""
        return constants_for(blueprint, setting, intervals)

    # ------------------------------------------------------------------------------- the slow clock
    def adapt(self, state: State) -> State:
        """A slice of the search, or let the model follow Step 2."""
        if state.stage.searching:
            return self._search(state)
        return self._follow(state)

    def _search(self, state: State) -> State:
        x, kept = state.values, kept_samples(state)
        begun_anew = x[slots.COUNT] > len(kept)
        if not x[slots.WORK_DONE]:
            x[slots.WORK_AT] = float(len(kept))
        count = int(x[slots.WORK_AT])
        full = count >= MOST_KEPT
        task = state.stage.task
        if task is None:
            now = State(x.copy(), state.stage)
            task = Task(_searching, self, now, kept[:count], begun_anew, full)
        further = advanced(state, task)
        if further is not None:
            return further
        answer, state = task.result(), idle(state)
        if answer is not None:
            found, samples = answer
            samples = np.vstack([samples, kept[count:]])
            launched = self.launched(state, found, samples, begun_anew, full)
            if launched is not None:
                return launched[0]
        again(x, len(kept), len(kept) - count)
        return shortened(state, kept) if full else state

    def launched(
        self, state: State, found: FoundPoles, samples: Array, begun_anew: bool, full: bool
    ) -> tuple[State, NDArray[np.int64]] | None:
        """The models that begin at what was found, and the flags of the samples; None if unsure."""
        x, stage = state
        setting = stage.setting
        poles = admissible(setting, found.poles, samples)
        basis = Basis.on_model(setting, _nuisance(setting, begun_anew), poles)
        rows = self._rows(x, stage, basis, samples)
        unknowns, models = fitted_to(basis, rows, samples)
        constant, matrix = basis.physical
        theta = constant + matrix @ unknowns
        moments = rows.T @ rows / len(rows)
        noise = found.noise_std
        cov = expected_covariance(basis, models, moments, noise**2, len(rows))[0]
        cov = matrix @ cov @ matrix.T
        a = slice(0, setting.n_poles)
        near = np.all(np.isfinite(cov)) and np.all(
            np.sqrt(np.diagonal(cov)[a]) < LINEAR * np.abs(theta[a])
        )
        if not near and not full:
            return None
        tables = self._tables(basis, models, models, moments, noise**2)
        return self._replayed(state, basis, samples, tables, unknowns, noise)

    def _replayed(
        self, state: State, basis: Basis, samples: Array, tables: Tables, unknowns: Array,
        noise: Array,
    ) -> tuple[State, NDArray[np.int64]]:  # fmt: skip
        """The kept samples on the bank of the model that was found in them, and their flags."""
        old, stage = state
        setting, count = stage.setting, float(len(samples))
        rate = self.rate or first_rate(basis, count)
        assert tables.moments is not None
        begun = replace(tables, rate=rate, ready=places.DOUBTS)
        blueprint = begun.written(basis, plan(basis, len(samples) < MOST_KEPT))
        x = fresh(blueprint)
        refer(old, x, blueprint)
        for i in range(setting.n_outputs):
            x[watch_of(blueprint, i) + slots.SCALE] = noise[i]
        write_moments(blueprint, x, tables.moments, count)
        put_unknowns(blueprint, x, unknowns)
        x[places.FROM] = np.inf
        flags = run_kept(self, setting, blueprint, x, samples)
        take_clocks(old, stage.blueprint, x, blueprint, len(samples))
        x[slots.FILLED] = 0.0
        put_unknowns(blueprint, x, unknowns)
        still_series(basis, blueprint, x)
        constant, matrix = basis.physical
        first = np.concatenate([[count], constant + matrix @ unknowns])
        found = stage.but(
            blueprint=blueprint, poles=basis.filter_poles, past=(samples,), searching=False,
            extra=_extra(first[None, :], rate, 0),
        )  # fmt: skip
        calm(x, found)
        begin_period(x, setting, rate, rested=False)
        return State(x, found), flags

    def _rows(self, old: Array, stage: Stage, basis: Basis, samples: Array) -> Array:
        """The row of each kept sample."""
        setting, blueprint = stage.setting, plan(basis)
        x = fresh(blueprint)
        refer(old, x, blueprint)
        n, at, m = blueprint.n_columns, int(blueprint.ints[slots.AT_ROW]), setting.n_inputs
        rows = np.zeros((len(samples), n))
        for k, after in enumerate(samples[:, 0].tolist()):
            c = blueprint.constants
            if k and abs(after - setting.dt) > 1e-9 * setting.dt:
                c = constants_for(blueprint, setting, np.array([after]))[0]
            x[slots.INBOX : slots.INBOX + m] = samples[k, 1 : 1 + m]
            x[slots.INBOX + m : slots.INBOX + samples.shape[1] - 1] = samples[k, 1 + m :]
            self.kernels().step(blueprint.ints, c, x, after)
            if not (basis.nuisance.free and k < setting.late):
                rows[k, int(x[slots.FIRST]) :] = x[at + int(x[slots.FIRST]) : at + n]
        return rows

    def _follow(self, state: State) -> State:
        x, stage = state
        setting, blueprint = stage.setting, stage.blueprint
        batches, rate, periods = _read(stage)
        basis = Basis.of(setting, blueprint)
        if not blueprint.constants[places.KNOWN]:
            begin_period(x, setting, rate, rested=False)
            return self._again(State(x, stage), basis, batches, rate, 0)
        if x[places.FROM] == np.inf:
            begin_period(x, setting, rate, rested=True)
            return self._again(State(x, stage), basis, batches, rate, periods)
        if x[places.SUMMED] < 0.5 * samples_of_period(setting, rate):
            x[slots.TICK] = x[slots.COUNT] + np.ceil(0.5 * samples_of_period(setting, rate))
            return state
        theta, mean = mean_of(basis, blueprint, x)
        if not basis.adapted and periods + 1 < SETTLING:
            begin_period(x, setting, rate, rested=False)
            return self._again(state, basis, batches, rate, periods + 1)
        if basis.adapted:
            row = np.concatenate([[x[places.SUMMED]], theta])[None, :]
            batches = np.vstack([batches.reshape(-1, row.size), row])
            batches, rate = self._joined(batches, rate)
        target = theta if len(batches) < 2 * PERIODS_TO_BE_SURE else average(batches)
        if not np.all(np.isfinite(target)):
            target = theta
        poles = stable_poles(target[: setting.n_poles], setting)
        if poles is None or (basis.adapted and near_enough(poles, basis, batches)):
            begin_period(x, setting, rate, rested=True)
            return self._again(state, basis, batches, rate, periods + 1)
        new = Basis.on_model(setting, blueprint.nuisance, poles)
        target = np.concatenate([denominator(poles)[1:], target[setting.n_poles :]])
        return self._moved(state, basis, new, target, mean, (batches, rate, periods + 1))

    def _joined(self, batches: Array, rate: float) -> tuple[Array, float]:
        """Not too many periods; the clock slows down where it may."""
        if self.rate is not None:
            return batches[-FIXED_PERIODS:], rate
        if len(batches) < MOST_PERIODS:
            return batches, rate
        pairs = batches.reshape(-1, 2, batches.shape[1])
        weights = pairs[:, :, :1]
        total = weights.sum(axis=1)
        return np.hstack([total, (weights * pairs[:, :, 1:]).sum(axis=1) / total]), 0.5 * rate

    def _tables(
        self, basis: Basis, models: Array, signals: Array, moments: Array | None, noise: Array
    ) -> Tables:
        """Tables with neither a rate nor readiness yet."""
        weights = 1.0 / np.maximum(noise, 1e-12 * max(float(noise.max()), 1e-280))
        return Tables(models, signals, weights / weights.mean(), moments, self.orthogonal, 0.0, 0.0)

    def _again(
        self, state: State, basis: Basis, batches: Array, rate: float, periods: int
    ) -> State:
        """The same model; the step lengths are brought up to date."""
        x, stage = state
        blueprint = stage.blueprint
        models = models_of(basis, blueprint)
        signals = signals_of(basis, blueprint, x)[1]
        tables = self._tables(
            basis, models, signals, moments_of(blueprint, x), noise_of(blueprint, x)
        )
        ready = _readiness(basis, blueprint, batches)
        found = replace(tables, rate=rate, ready=ready).written(basis, blueprint)
        as_expected(blueprint, x)
        return State(x, stage.but(blueprint=found, extra=_kept(stage, batches, rate, periods)))

    def _moved(
        self, state: State, old: Basis, new: Basis, theta: Array, mean: Array,
        extra: tuple[Array, float, int],
    ) -> State:  # fmt: skip
        """The models on the bank of another denominator."""
        x, stage = state
        batches, rate, periods = extra
        setting, was = stage.setting, stage.blueprint
        blueprint = plan(new, bool(was.ints[slots.CHUNK]))
        found = carried(was, x, blueprint)
        if old.adapted:
            a, b = int(was.ints[slots.AT_WATCH]), int(blueprint.ints[slots.AT_WATCH])
            size = setting.n_outputs * int(was.ints[slots.WATCH])
            found[b : b + size] = x[a : a + size]
        move = columns_between(old, new)
        at, to = int(was.ints[slots.AT_ROW]), int(blueprint.ints[slots.AT_ROW])
        found[to : to + new.width] = move @ x[at : at + old.width]
        if found[slots.FIRST]:
            found[slots.FIRST] = new.poles.size
        moments = move @ moments_of(was, x) @ move.T
        write_moments(blueprint, found, moments, float(x[places.MOMENTS]))
        parallel, working = (one @ move.T for one in signals_of(old, was, x))
        unknowns = new.unknowns_of(theta)
        models = outputs_of(new, unknowns)
        if new.nuisance.free:
            impulse = slice(0, new.kept)
            models[:, impulse] = working[:, impulse]
        if new.nuisance.offset:
            models[:, -1] = working[:, -1]
        put_parallel(new, blueprint, found, parallel)
        put_unknowns(blueprint, found, unknowns)
        tables = self._tables(new, models, models, moments, noise_of(was, x))
        tables = replace(tables, rate=rate, ready=_readiness(new, was, batches))
        blueprint = tables.written(new, blueprint)
        as_expected(blueprint, found)
        begin_period(found, setting, rate, rested=False)
        return State(
            found,
            stage.but(
                blueprint=blueprint,
                poles=new.filter_poles,
                extra=_kept(stage, batches, rate, periods),
            ),
        )

    def begun_again(self, state: State, found: FoundPoles, samples: Array) -> State:
        """The estimator that goes on from the samples since a change."""
        launched = self.launched(state, found, samples, True, True)
        assert launched is not None
        return launched[0]

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
        notes = (f"mean over {len(used)} periods", f"rate {blueprint.constants[places.RATE]:.3g}")
        trace = Trace((), (), notes, "gradient rule")
        found = assembled(
            setting, blueprint, x, theta, cov, noise, Status.SETTLED, trace, self.name, condition
        )
        return with_findings(state, replace(found, findings=told))


def _searching(
    method: Gradient, state: State, samples: Array, begun_anew: bool, full: bool
) -> Slices[tuple[FoundPoles, Array] | None]:
    """A model to begin with, and the kept samples without those that it finds doubtful."""
    setting, answer = state.stage.setting, None
    samples = yield from far_off(setting, samples)
    for _ in range(REFIT_ROUNDS):
        found = yield from searching(setting, samples, begun_anew)
        if found is None or not (found.certain or full):
            break
        yield
        launched = method.launched(state, found, samples, begun_anew, full)
        if launched is None:
            break
        answer = found, samples
        cleaned = without(samples, launched[1], setting.n_inputs)
        if cleaned is None:
            break
        samples = cleaned
    return answer


def _extra(batches: Array, rate: float, periods: int) -> tuple[Array, ...]:
    return (batches.ravel(), np.array([rate, float(periods)]))


def _kept(stage: Stage, batches: Array, rate: float, periods: int) -> tuple[Array, ...]:
    """With what is kept of a suspicion behind them."""
    return *_extra(batches, rate, periods), *stage.extra[Gradient.own_arrays :]


def _read(stage: Stage) -> tuple[Array, float, int]:
    flat, (rate, periods) = stage.extra[: Gradient.own_arrays]
    return flat.reshape(-1, len(stage.setting.names) + 1), float(rate), int(periods)


def _readiness(basis: Basis, before: Blueprint, batches: Array) -> float:
    """Whether samples may be doubted and changes told; what may be doubted stays so."""
    if basis.adapted and len(batches) >= PERIODS_TO_BE_SURE:
        return places.TELLS
    return min(float(before.constants[places.READY]), places.DOUBTS)


def _nuisance(setting: Setting, restarted: bool) -> NuisanceColumns:
    found = NuisanceColumns.of(setting.structure, restarted)
    return NuisanceColumns(found.free, found.offset, False)


def _check_above_zero(name: str, value: object, unit: str) -> None:
    number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    if value is not None and not (number and 0.0 < float(value) < np.inf):  # type: ignore[arg-type]
        raise OptionError(
            f"found {name}={shown(value)}; expected a number above zero, in {unit}; leave it out "
            "or correct it"
        )


__all__: Sequence[str] = ("Gradient",)
