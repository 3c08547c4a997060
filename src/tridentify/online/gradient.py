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
doubles and the rate is halved, so that the gain falls like ``1 / t`` and the estimate, the mean over
all but the oldest quarter (and the first two periods), converges. A ``rate`` that is given stays, and the mean is over the last
eight periods: that is for coefficients that move.

*Standard errors* are those of the scatter of ten or more periods (batch means), widened by Student's
distribution; with fewer they are those of least squares over the samples averaged, for white noise.
Neither tells of a bias or a lag: what a convergence that is not complete leaves, or coefficients
that move. The regressors of Step 2 hold what noise the weights of Step 3 carry: a bias of second
order, which shrinks with the rate.

References
----------
A. Silvestrov, M. Ostroverkhov, L. Spinul, O. Khalimovskyy, H. Veshchykov, System Research and
Information Technologies 2025(2).
B. T. Polyak, A. B. Juditsky, SIAM J. Control Optim. 30(4) (1992), 838-855.
L. Ljung, T. Soderstrom, Theory and Practice of Recursive Identification, MIT Press 1983.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from tridentify.errors import OptionError, UnsupportedError, shown
from tridentify.estimate import Estimate, Status, Trace
from tridentify.methods.filtered import checked_filter
from tridentify.numerics.realization import Complex, sort_poles
from tridentify.numerics.threads import one_blas_thread
from tridentify.online import gradient_kernel as kernel
from tridentify.online import intake
from tridentify.online.blueprint import (
    Blueprint,
    Nuisance,
    Setting,
    collecting,
    constants_for,
    fresh,
    watch_of,
)
from tridentify.online.gradient_kernel import MEMORY, gradient_run, gradient_step
from tridentify.online.gradient_plan import (
    Basis,
    Tables,
    inverse_of,
    moments_of,
    plan,
    signals_of,
    size_of,
    without_constant,
    write_moments,
)
from tridentify.online.result import assembled
from tridentify.online.seam import Estimator, check_choice, kept_samples, not_ready
from tridentify.online.search import (
    checked_start,
    far_off,
    first_try,
    next_try,
    poles_of_start,
    search,
)
from tridentify.online.starting import admissible, calm, run_kept, shortened, take_clocks, without
from tridentify.online.state import Stage, State
from tridentify.online.summary import carried, transfer
from tridentify.transfer_function import TransferFunction

Array = NDArray[np.float64]

MOST_KEPT = 2000
ALARM_LASTS = 200
PER_UNKNOWN, SLOWER = 10, 4.0
WARM_UP = 10
MOST_PERIODS, FIXED_PERIODS = 16, 8
SCATTERED = 10
SURE = 4
FIRST = 2
LINEAR = 0.1
SMALL = 0.1
SETTLING = 2
DEGENERATE = 1e-13
FASTEST, BELOW_NYQUIST, LEAST_DAMPED = 20.0, 0.98, 1e-6
ROUNDING = 1e-12


@dataclass(frozen=True)
class Gradient(Estimator):
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
    step_kernel = staticmethod(gradient_step)
    run_kernel = staticmethod(gradient_run)

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
            x[intake.TICK] = first_try(setting)
            return State(x, Stage(self, setting, blueprint, blueprint.poles))
        nuisance = _nuisance(setting, False)
        if self.start is None:
            basis = self._paper_basis(setting, nuisance)
            return self._begun(basis, np.zeros(basis.unknowns))
        poles = poles_of_start(self.start, setting)
        basis = Basis.on_model(setting, nuisance, poles)
        return self._begun(basis, basis.unknowns_of(_coefficients(self.start, setting)))

    def _paper_basis(self, setting: Setting, nuisance: Nuisance) -> Basis:
        n, gamma = setting.n_poles, self.gamma
        if self.filter is None:
            assert gamma is not None
            poles = np.full(n + 1, -gamma, dtype=np.complex128)
        else:
            poles = sort_poles(np.roots(self.filter).astype(np.complex128))
            if gamma is None:
                gamma = float(np.exp(np.mean(np.log(np.abs(poles)))))
        if poles.size < n:
            raise OptionError(
                f"found filter={self.filter} of degree {poles.size} with {n} poles; expected a "
                "degree of at least the number of poles; raise the degree"
            )
        return Basis.fixed(setting, nuisance, gamma, self.n_operators, poles)

    def _begun(self, basis: Basis, unknowns: Array) -> State:
        """With nothing known of the input."""
        setting = basis.setting
        blueprint = plan(basis)
        rate = self.rate or _rate(basis, 0.0)
        models = _models(basis, unknowns)
        tables = self._tables(basis, models, models, None, np.ones(setting.n_outputs))
        quick = max(rate, 1.0 / (WARM_UP * setting.dt))
        blueprint = replace(tables, rate=quick).written(basis, blueprint)
        x = fresh(blueprint)
        x[kernel.FROM] = np.inf
        x[intake.TICK] = setting.late + WARM_UP * (basis.unknowns + setting.n_inputs)
        _put_unknowns(blueprint, x, unknowns)
        stage = Stage(self, setting, blueprint, basis.filter_poles, searching=False)
        return State(x, stage.but(extra=_extra(np.zeros((0, 0)), rate, 0)))

    def size_of(self, setting: Setting, blueprint: Blueprint) -> int:
        """Length of the vector that goes with a blueprint."""
        return size_of(blueprint) if blueprint.poles.size else collecting(setting).size

    def constants_for(self, blueprint: Blueprint, setting: Setting, intervals: Array) -> Array:
        """``c`` for samples that come after other intervals."""
        return constants_for(blueprint, setting, intervals)

    # ------------------------------------------------------------------------------- the slow clock
    def tick(self, state: State) -> State:
        """Search, or let the model follow Step 2."""
        with one_blas_thread():
            return self._search(state) if state.stage.searching else self._follow(state)

    def _search(self, state: State) -> State:
        x, stage = state
        setting = stage.setting
        samples = far_off(setting, kept_samples(state))
        begun_anew = x[intake.COUNT] > len(samples)
        found = search(setting, samples, begun_anew)
        full = len(samples) >= MOST_KEPT
        if found is None or not (found.certain or full):
            x[intake.TICK] = x[intake.COUNT] + next_try(len(samples)) - len(samples)
            return shortened(state, samples) if full else state
        poles = admissible(setting, found.poles, samples)
        basis = Basis.on_model(setting, _nuisance(setting, begun_anew), poles)
        rows = self._rows(x, stage, basis, samples)
        unknowns, models = _fitted(basis, rows, samples)
        constant, matrix = basis.physical
        theta = constant + matrix @ unknowns
        moments = rows.T @ rows / len(rows)
        cov = _expected_covariance(basis, models, moments, found.noise_std**2, len(rows))[0]
        a = slice(0, setting.n_poles)
        near = np.all(np.isfinite(cov)) and np.all(
            np.sqrt(np.diagonal(cov)[a]) < LINEAR * np.abs(theta[a])
        )
        if not near and not full:
            x[intake.TICK] = x[intake.COUNT] + next_try(len(samples)) - len(samples)
            return state
        tables = self._tables(basis, models, models, moments, found.noise_std**2)
        begun = self._replayed(state, basis, samples, tables, unknowns, found.noise_std)
        cleaned = without(samples, begun[1], setting.n_inputs)
        if cleaned is None:
            return begun[0]
        unknowns, models = _fitted(basis, rows, cleaned)
        tables = replace(tables, models=models, signals=models)
        return self._replayed(state, basis, cleaned, tables, unknowns, found.noise_std)[0]

    def _replayed(
        self, state: State, basis: Basis, samples: Array, tables: Tables, unknowns: Array,
        noise: Array,
    ) -> tuple[State, NDArray[np.int64]]:  # fmt: skip
        """The kept samples on the bank of the model that was found in them, and their flags."""
        old, stage = state
        setting, count = stage.setting, float(len(samples))
        rate = self.rate or _rate(basis, count)
        assert tables.moments is not None
        blueprint = replace(tables, rate=rate).written(basis, plan(basis))
        x = fresh(blueprint)
        _refer(old, x, blueprint)
        for i in range(setting.n_outputs):
            x[watch_of(blueprint, i) + intake.SCALE] = noise[i]
        write_moments(blueprint, x, tables.moments, count)
        _put_unknowns(blueprint, x, unknowns)
        x[kernel.FROM] = np.inf
        flags = run_kept(self, setting, blueprint, x, samples)
        take_clocks(old, stage.blueprint, x, blueprint, len(samples))
        x[intake.FILLED] = 0.0
        _put_unknowns(blueprint, x, unknowns)
        _still_series(basis, blueprint, x)
        constant, matrix = basis.physical
        first = np.concatenate([[count], constant + matrix @ unknowns])
        found = stage.but(
            blueprint=blueprint, poles=basis.filter_poles, past=(), searching=False,
            extra=_extra(first[None, :], rate, 0),
        )  # fmt: skip
        calm(x, found)
        _new_period(x, setting, rate, rested=False)
        return State(x, found), flags

    def _rows(self, old: Array, stage: Stage, basis: Basis, samples: Array) -> Array:
        """The row of each kept sample."""
        setting, blueprint = stage.setting, plan(basis)
        x = fresh(blueprint)
        _refer(old, x, blueprint)
        n, at, m = blueprint.n_columns, int(blueprint.ints[intake.AT_ROW]), setting.n_inputs
        rows = np.zeros((len(samples), n))
        for k, after in enumerate(samples[:, 0].tolist()):
            c = blueprint.constants
            if k and abs(after - setting.dt) > 1e-9 * setting.dt:
                c = constants_for(blueprint, setting, np.array([after]))[0]
            x[intake.INBOX : intake.INBOX + m] = samples[k, 1 : 1 + m]
            x[intake.INBOX + m : intake.INBOX + samples.shape[1] - 1] = samples[k, 1 + m :]
            gradient_step(blueprint.ints, c, x, after)
            if not (basis.nuisance.free and k < setting.late):
                rows[k, int(x[intake.FIRST]) :] = x[at + int(x[intake.FIRST]) : at + n]
        return rows

    def _follow(self, state: State) -> State:
        x, stage = state
        setting, blueprint = stage.setting, stage.blueprint
        batches, rate, periods = _read(stage)
        basis = Basis.of(setting, blueprint)
        if not blueprint.constants[kernel.KNOWN]:
            _new_period(x, setting, rate, rested=False)
            return self._again(State(x, stage), basis, batches, rate, 0)
        if x[kernel.FROM] == np.inf:
            _new_period(x, setting, rate, rested=True)
            return self._again(State(x, stage), basis, batches, rate, periods)
        if x[kernel.SUMMED] < 0.5 * _share(setting, rate):
            x[intake.TICK] = x[intake.COUNT] + np.ceil(0.5 * _share(setting, rate))
            return state
        theta, mean = _mean(basis, blueprint, x)
        if not basis.adapted and periods + 1 < SETTLING:
            _new_period(x, setting, rate, rested=False)
            return self._again(state, basis, batches, rate, periods + 1)
        if basis.adapted:
            row = np.concatenate([[x[kernel.SUMMED]], theta])[None, :]
            batches = np.vstack([batches.reshape(-1, row.size), row])
            batches, rate = self._joined(batches, rate)
        target = theta if len(batches) < 2 * SURE else _average(batches)
        if not np.all(np.isfinite(target)):
            target = theta
        poles = _stable(target[: setting.n_poles], setting)
        if poles is None or (basis.adapted and _near(poles, basis, batches)):
            _new_period(x, setting, rate, rested=True)
            return self._again(state, basis, batches, rate, periods + 1)
        new = Basis.on_model(setting, blueprint.nuisance, poles)
        target = np.concatenate([_polynomial(poles), target[setting.n_poles :]])
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
        return Tables(
            models, signals, weights / weights.mean(), moments, self.orthogonal, 0.0, False
        )

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
        ready = basis.adapted and len(batches) >= SURE
        found = replace(tables, rate=rate, ready=ready).written(basis, blueprint)
        _expected(blueprint, x)
        return State(x, stage.but(blueprint=found, extra=_extra(batches, rate, periods)))

    def _moved(
        self, state: State, old: Basis, new: Basis, theta: Array, mean: Array,
        extra: tuple[Array, float, int],
    ) -> State:  # fmt: skip
        """The models on the bank of another denominator."""
        x, stage = state
        batches, rate, periods = extra
        setting, was = stage.setting, stage.blueprint
        blueprint = plan(new)
        found = carried(was, x, blueprint)
        if old.adapted:
            a, b = int(was.ints[intake.AT_WATCH]), int(blueprint.ints[intake.AT_WATCH])
            size = setting.n_outputs * int(was.ints[intake.WATCH])
            found[b : b + size] = x[a : a + size]
        move = _columns(old, new)
        at, to = int(was.ints[intake.AT_ROW]), int(blueprint.ints[intake.AT_ROW])
        found[to : to + new.width] = move @ x[at : at + old.width]
        if found[intake.FIRST]:
            found[intake.FIRST] = new.poles.size
        moments = move @ moments_of(was, x) @ move.T
        write_moments(blueprint, found, moments, float(x[kernel.MOMENTS]))
        parallel, working = (one @ move.T for one in signals_of(old, was, x))
        unknowns = new.unknowns_of(theta)
        models = _models(new, unknowns)
        if new.nuisance.free:
            impulse = slice(0, new.kept)
            models[:, impulse] = working[:, impulse]
        if new.nuisance.offset:
            models[:, -1] = working[:, -1]
        _put_parallel(new, blueprint, found, parallel)
        _put_unknowns(blueprint, found, unknowns)
        tables = self._tables(new, models, models, moments, noise_of(was, x))
        tables = replace(tables, rate=rate, ready=len(batches) >= SURE)
        blueprint = tables.written(new, blueprint)
        _expected(blueprint, found)
        _new_period(found, setting, rate, rested=False)
        return State(
            found,
            stage.but(
                blueprint=blueprint,
                poles=new.filter_poles,
                extra=_extra(batches, rate, periods),
            ),
        )

    # --------------------------------------------------------------------------------- a change
    def alarmed(self, state: State) -> State:
        """Note the change; begin anew if so told."""
        x, stage = state
        here = int(x[intake.COUNT])
        changed = stage.but(changes=(*stage.changes, here - 1))
        x[intake.ALARM] = here + ALARM_LASTS
        x[intake.FLAGS] = float(int(x[intake.FLAGS]) | intake.CHANGED)
        calm(x, changed)
        if self.on_change == "flag":
            return State(x, changed)
        if self.fixed or self.start is not None:
            return self._refreshed(State(x, changed))
        if not stage.blueprint.poles.size:
            return State(x, changed)
        basis = Basis.of(stage.setting, stage.blueprint)
        blueprint = replace(plan(basis, True), constants=stage.blueprint.constants.copy())
        blueprint.constants[kernel.READY] = 0.0
        blueprint.constants[kernel.RATE] = self.rate or _rate(basis, 0.0)
        anew = fresh(blueprint)
        head = int(blueprint.ints[intake.AT_CHUNK])
        a, b = int(stage.blueprint.ints[intake.AT_WATCH]), int(blueprint.ints[intake.AT_WATCH])
        anew[:head], anew[b:] = x[:head], x[a:]
        anew[intake.FILLED] = anew[kernel.SUMMED] = 0.0
        anew[kernel.FROM] = np.inf
        anew[intake.BORN] = x[intake.TIME] + stage.setting.dt
        anew[intake.TICK] = here + first_try(stage.setting)
        return State(anew, changed.but(blueprint=blueprint, past=(), searching=True))

    def _refreshed(self, state: State) -> State:
        """From the present model, at the rate of the beginning."""
        x, stage = state
        basis = Basis.of(stage.setting, stage.blueprint)
        if not stage.blueprint.constants[kernel.KNOWN]:
            return state
        rate = self.rate or _rate(basis, 0.0)
        _new_period(x, stage.setting, rate, rested=False)
        with one_blas_thread():
            return self._again(State(x, stage), basis, np.zeros((0, 0)), rate, 0)

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
        x, stage = state
        count = int(x[intake.COUNT])
        if stage.searching:
            raise not_ready(count, "are still searched for a model")
        setting, blueprint = stage.setting, stage.blueprint
        basis = Basis.of(setting, blueprint)
        batches = _read(stage)[0]
        if not len(batches) and x[kernel.SUMMED] < basis.unknowns:
            batches = _present(basis, blueprint, x)
        elif x[kernel.SUMMED] > 0:
            theta, _ = _mean(basis, blueprint, x)
            row = np.concatenate([[x[kernel.SUMMED]], theta])[None, :]
            batches = np.vstack([batches.reshape(-1, row.size), row])
        if not basis.adapted or not len(batches) or batches[:, 0].sum() < basis.unknowns:
            raise not_ready(count, "are too few for the gradient rule to come to rest")
        used = _used(batches)
        theta = _average(batches)
        with one_blas_thread():
            cov, condition = _expected_covariance(
                basis, signals_of(basis, blueprint, x)[1], moments_of(blueprint, x),
                noise_of(blueprint, x), float(used[:, 0].sum()),
            )  # fmt: skip
        if not np.all(np.isfinite(cov)) or not np.all(np.isfinite(theta)):
            raise not_ready(count, "do not determine the coefficients")
        if len(used) >= SCATTERED:
            cov = _scatter(used)
        noise = noise_of(blueprint, x)
        notes = (f"mean over {len(used)} periods", f"rate {blueprint.constants[kernel.RATE]:.3g}")
        trace = Trace((), (), notes, "gradient rule")
        return assembled(
            setting, blueprint, x, theta, cov, noise, Status.SETTLED, trace, self.name, condition
        )


# ------------------------------------------------------------------------------------ the periods
def _rate(basis: Basis, searched: float) -> float:
    """Where the rate begins [1/s]: slower than the slowest pole, with samples for each unknown."""
    dt = basis.setting.dt
    few = PER_UNKNOWN * basis.unknowns * dt
    slow = SLOWER / float(np.min(np.abs(basis.filter_poles)))
    most = max(searched, 2.0 * PER_UNKNOWN * basis.unknowns) * dt
    return 1.0 / max(few, 0.25 * searched * dt, min(slow, most))


def _share(setting: Setting, rate: float) -> float:
    """Samples of a period."""
    return max(float(np.ceil(MEMORY / (rate * setting.dt))), 8.0)


def _new_period(x: Array, setting: Setting, rate: float, *, rested: bool) -> None:
    """Begin to average: at once, or where models begin anew after half of a period."""
    length = _share(setting, rate)
    x[intake.TICK] = x[intake.COUNT] + np.ceil(length if rested else 0.5 * length)
    x[kernel.FROM] = x[intake.COUNT] if rested else np.inf
    x[kernel.SUMMED] = 0.0


def _mean(basis: Basis, blueprint: Blueprint, x: Array) -> tuple[Array, Array]:
    """Mean of the coefficients, and of the unknowns, over the present period."""
    at, k = int(blueprint.ints[kernel.X_SECOND]), basis.unknowns
    mean = x[at + k + 1 : at + 2 * k + 1] / max(float(x[kernel.SUMMED]), 1.0)
    constant, matrix = basis.physical
    return constant + matrix @ mean, mean


def _present(basis: Basis, blueprint: Blueprint, x: Array) -> Array:
    """The coefficients as they are, as one period; none before the step lengths are known."""
    constant, matrix = basis.physical
    if not blueprint.constants[kernel.KNOWN]:
        return np.zeros((0, constant.size + 1))
    at = int(blueprint.ints[kernel.X_SECOND])
    remembered = 2.0 / float(blueprint.constants[kernel.RATE] * basis.setting.dt)
    row = [min(float(x[intake.COUNT]), remembered)], constant + matrix @ x[at : at + basis.unknowns]
    return np.concatenate(row)[None, :]


def _used(batches: Array) -> Array:
    """All periods but the oldest quarter, and the first two."""
    return batches[max(len(batches) // 4, min(FIRST, len(batches) - 1)) :]


def _average(batches: Array) -> Array:
    used = _used(batches)
    return np.asarray(used[:, 0] @ used[:, 1:] / used[:, 0].sum())


def _scatter(used: Array) -> Array:
    """Covariance of the mean from the scatter of the periods."""
    weights = used[:, 0] / used[:, 0].sum()
    off = used[:, 1:] - weights @ used[:, 1:]
    k = len(used)
    widened = float(scipy.stats.t.ppf(0.975, k - 1) / scipy.stats.norm.ppf(0.975))
    return np.asarray(widened**2 * (off.T * weights) @ off / (k - 1))


def _extra(batches: Array, rate: float, periods: int) -> tuple[Array, ...]:
    return (batches.ravel(), np.array([rate, float(periods)]))


def _read(stage: Stage) -> tuple[Array, float, int]:
    flat, (rate, periods) = stage.extra
    return flat.reshape(-1, len(stage.setting.names) + 1), float(rate), int(periods)


# ------------------------------------------------------------------------------------- the model
def _models(basis: Basis, unknowns: Array) -> Array:
    outputs = range(basis.setting.n_outputs)
    return np.array([basis.output_of(i, unknowns) for i in outputs])


def models_of(basis: Basis, blueprint: Blueprint) -> Array:
    """(n_outputs, n) the rows ``t_0`` of a blueprint."""
    ints, n = blueprint.ints, blueprint.n_columns
    k1 = int(ints[kernel.PARALLEL_UNKNOWNS])
    found = np.zeros((basis.setting.n_outputs, n))
    for i in range(len(found)):
        at = int(ints[kernel.C_FITS]) + i * kernel.fits_stride(ints) + k1 * (n + k1)
        found[i] = blueprint.constants[at : at + n]
    return found


def noise_of(blueprint: Blueprint, x: Array) -> Array:
    """(n_outputs,) variance of the noise: of the innovations, less what the weights add."""
    ints, c = blueprint.ints, blueprint.constants
    p = int(ints[intake.OUTPUTS])
    k = int(ints[kernel.SERIES_UNKNOWNS] if ints[kernel.SERIES] else ints[kernel.PARALLEL_UNKNOWNS])
    added = 1.0 + min(0.5 * float(c[kernel.RATE] * c[intake.INTERVAL]) * k, 0.9)
    found = np.zeros(p)
    for i in range(p):
        w = watch_of(blueprint, i)
        found[i] = x[w + intake.SQUARES] / max(float(x[w + intake.WEIGHT]), 1.0) / added
    return found


def _fitted(basis: Basis, rows: Array, samples: Array) -> tuple[Array, Array]:
    """``b``, free response and constant by least squares for given poles."""
    setting = basis.setting
    unknowns = np.zeros(basis.unknowns)
    models = np.zeros((setting.n_outputs, basis.width))
    for i in range(setting.n_outputs):
        y = samples[:, 1 + setting.n_inputs + i]
        good = (np.abs(y) < intake.LARGEST) & np.any(rows != 0, axis=1)
        table = basis.numerators(i)
        if basis.nuisance.offset:
            table = np.vstack([table, basis.at(basis.width - 1)])
        columns = rows[good] @ table.T
        sizes = np.linalg.norm(columns, axis=0)
        sizes = np.where(sizes > 0, sizes, 1.0)
        weights = np.linalg.lstsq(columns / sizes, y[good], rcond=None)[0] / sizes
        place = basis.n_poles + i * basis.own
        unknowns[place : place + basis.own] = weights[: basis.own]
        models[i] = weights @ table
    return unknowns, models


def _coefficients(start: TransferFunction, setting: Setting) -> Array:
    """Coefficients of a model that was given, on the orders that are asked for."""
    den = np.asarray(start.den[0][0], dtype=np.float64)
    parts = [den[1:] / den[0]]
    for i, row in enumerate(setting.zeros):
        for j, m in enumerate(row):
            try:
                num = np.trim_zeros(np.asarray(start.num[i][j], dtype=np.float64), "f") / den[0]
            except IndexError:
                num = np.zeros(m + 2)
            if num.size > m + 1:
                raise OptionError(
                    f"found a start with other channels or more than {m} zeros; expected those of "
                    "the structure; give another model, or leave start out"
                )
            parts.append(np.pad(num, (m + 1 - num.size, 0)))
    return np.concatenate(parts)


def _stable(a: Array, setting: Setting) -> Complex | None:
    """Roots of a denominator, reflected and held where samples can show them."""
    if not np.all(np.isfinite(a)):
        return None
    n = a.size
    unit = max(float(np.max(np.abs(a) ** (1.0 / np.arange(1, n + 1)))), 1e-300)
    scaled = np.concatenate([[1.0], a / unit ** np.arange(1, n + 1)])
    poles = unit * np.roots(scaled).astype(np.complex128)
    if poles.size != n or not np.all(np.isfinite(poles)):
        return None
    poles = poles * np.minimum(1.0, FASTEST / setting.dt / np.maximum(np.abs(poles), 1e-300))
    limit = BELOW_NYQUIST * np.pi / setting.dt
    imag = np.clip(poles.imag, -limit, limit)
    least = np.maximum(LEAST_DAMPED * np.abs(imag), 1e-6 * float(np.max(np.abs(poles))))
    return sort_poles(-np.maximum(np.abs(poles.real), least) + 1j * imag)


def _polynomial(poles: Complex) -> Array:
    return np.asarray(np.poly(poles).real[1:], dtype=np.float64)


def _near(poles: Complex, basis: Basis, batches: Array) -> bool:
    """Whether a move of the poles may be left out: its square is far below the standard error."""
    old = basis.filter_poles
    rates = np.maximum(-old.real, LEAST_DAMPED * np.abs(old))
    distance = float(np.max(np.abs(poles - old) / rates))
    if distance < ROUNDING:
        return True
    used = _used(batches)
    if len(used) < SURE:
        return False
    n = basis.n_poles
    std = np.sqrt(np.diagonal(_scatter(used)))[:n]
    sizes = np.maximum(np.abs(_average(batches)[:n]), 1e-300)
    return distance**2 < SMALL * float(np.min(std / sizes))


def _columns(old: Basis, new: Basis) -> Array:
    """(n', n) what takes a row on the columns of one bank to those of another."""
    move = transfer(old.bank, new.bank)
    found = np.zeros((new.width, old.width))
    for j in range(-int(old.nuisance.free), old.setting.n_inputs):
        found[new.channel(j), old.channel(j)] = move
    rest = old.width - old.direct(0)
    found[new.width - rest :, old.width - rest :] = np.eye(rest)
    return found


def _expected_covariance(
    basis: Basis, signals: Array, moments: Array, noise: Array, count: float
) -> tuple[Array, float]:
    """Covariance of least squares over so many samples, and the condition of its columns."""
    p, k, offset = basis.setting.n_outputs, basis.unknowns, basis.nuisance.offset
    size = k + p * offset
    noise = np.maximum(noise, 1e-300)
    total = np.zeros((size, size))
    for i in range(p):
        table = np.zeros((size, basis.width))
        table[:k] = basis.second(i, without_constant(basis, signals[i]))
        if offset:
            table[k + i, -1] = 1.0
        total += table @ moments @ table.T / noise[i]
    means = np.diagonal(total)
    live = means > 1e-24 * max(float(means.max()), 1e-300)
    live &= means > 0
    root = np.where(live, 1.0 / np.sqrt(np.where(live, means, 1.0)), 0.0)
    scaled = (total * root[:, None] * root)[np.ix_(live, live)]
    values = np.linalg.eigvalsh(scaled) if scaled.size else np.zeros(1)
    if not live[: basis.n_poles].all() or values[0] < DEGENERATE:
        return np.full((1, 1), np.nan), np.inf
    inverse = np.zeros((k, k))
    inside = np.flatnonzero(live)
    whole = inverse_of(total[np.ix_(live, live)], DEGENERATE)
    own = inside < k
    inverse[np.ix_(inside[own], inside[own])] = whole[np.ix_(own, own)] / count
    matrix = basis.physical[1]
    return matrix @ inverse @ matrix.T, float(np.sqrt(values[-1] / values[0]))


# ------------------------------------------------------------------------------------ the vector
def _nuisance(setting: Setting, restarted: bool) -> Nuisance:
    found = Nuisance.of(setting.structure, restarted)
    return Nuisance(found.free, found.offset, False)


def _refer(old: Array, x: Array, blueprint: Blueprint) -> None:
    """The trim input, where samples begin in the middle."""
    ints = blueprint.ints
    if ints[intake.EQUILIBRIUM] and ints[intake.FREE]:
        at, m = int(ints[intake.AT_REFERENCE]), int(ints[intake.INPUTS])
        x[at : at + m] = old[at : at + m]
        x[intake.COUNT] = 1.0


def _put_unknowns(blueprint: Blueprint, x: Array, unknowns: Array) -> None:
    """Step 2 begins at a model."""
    at, k = int(blueprint.ints[kernel.X_SECOND]), unknowns.size
    x[at : at + k] = unknowns
    x[at + k : at + 2 * k + 1] = 0.0
    _expected(blueprint, x)


def _expected(blueprint: Blueprint, x: Array) -> None:
    """The means of ``phi' P phi`` are what they ought to be; sums begin anew."""
    ints = blueprint.ints
    k1, k3 = int(ints[kernel.PARALLEL_UNKNOWNS]), int(ints[kernel.SERIES_UNKNOWNS])
    p, at = int(ints[intake.OUTPUTS]), int(ints[kernel.X_FITS])
    for i in range(p):
        x[at + i * (k1 + k3 + 2) + k1] = k1
        x[at + i * (k1 + k3 + 2) + k1 + k3 + 1] = k3
    k = int(ints[kernel.POLES] + p * ints[kernel.OWN])
    at = int(ints[kernel.X_SECOND])
    x[at + k] = k / p
    x[at + k + 1 : at + 2 * k + 1] = 0.0


def _still_series(basis: Basis, blueprint: Blueprint, x: Array) -> None:
    """``beta = (1, 0, ..., 0)``."""
    ints = blueprint.ints
    k1, k3 = int(ints[kernel.PARALLEL_UNKNOWNS]), int(ints[kernel.SERIES_UNKNOWNS])
    for i in range(basis.setting.n_outputs):
        at = int(ints[kernel.X_FITS]) + i * (k1 + k3 + 2) + k1 + 1
        x[at : at + k3] = 0.0


def _put_parallel(basis: Basis, blueprint: Blueprint, x: Array, signals: Array) -> None:
    """The weights of the parallel model whose output is a row, as far as it can be."""
    ints = blueprint.ints
    k1, k3 = int(ints[kernel.PARALLEL_UNKNOWNS]), int(ints[kernel.SERIES_UNKNOWNS])
    for i, signal in enumerate(signals):
        at = int(ints[kernel.X_FITS]) + i * (k1 + k3 + 2)
        x[at : at + k1] = basis.parallel @ signal


def _check_above_zero(name: str, value: object, unit: str) -> None:
    number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    if value is not None and not (number and 0.0 < float(value) < np.inf):  # type: ignore[arg-type]
        raise OptionError(
            f"found {name}={shown(value)}; expected a number above zero, in {unit}; leave it out "
            "or correct it"
        )


__all__: Sequence[str] = ("Gradient",)
