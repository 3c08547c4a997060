"""Recursive least squares and a Kalman filter on the equation error of the recorded output.

    eps = (a / c) y - (b / c) u - (c_0 / c) delta - const

is linear in ``a``, ``b``, the initial state and the constant, with a fixed filter ``c``
(`methods.filtered` derives it; the unknowns are the weights of the orthonormal functions of ``c``
sorted by degree). One row a sample and output enters a triangle or a Kalman filter
(`numerics.recursive`).

*What it is for.* It needs no model to start from and takes few operations a sample. The noise of
``y`` stands in its regressors: it is biased, the more so the more noise there is (paper, eq.
6-9), and the standard errors, which take the equation error for white, say nothing of that.
`online.ThreeModel` is the answer; this is the yardstick, and the choice where noise is small or
the processor smaller.

*Filter.* Where none is given, the first samples are kept and searched by the off-line three models,
and ``c`` is the denominator found: the filter that is best at low noise (Young 2011, section 8.3).

*Drifting coefficients* (`Kalman`): a random walk of each physical coefficient, independent of the
others, ``theta(t + h) = theta(t) + w, cov w = h diag(drift^2)``. It begins as least squares and
takes over covariance and coefficients once there are ten samples for each unknown. While the
input does not excite (`online.intake`) the walk is held, as the covariance would grow without
limit.

References
----------
P. C. Young, Recursive Estimation and Time-Series Analysis, 2nd ed., Springer 2011.
L. Ljung, T. Soderstrom, Theory and Practice of Recursive Identification, MIT Press 1983.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from tridentify.errors import OptionError, UnsupportedError, shown
from tridentify.estimate import Estimate, Status, Trace
from tridentify.methods.filtered import checked_filter
from tridentify.numerics.realization import (
    Cascade,
    Complex,
    cascade,
    degree_basis,
    denominator,
    numerators,
    sort_poles,
)
from tridentify.numerics.threads import one_blas_thread
from tridentify.online import slots
from tridentify.online.blueprint import (
    NEGLIGIBLE,
    Blueprint,
    Nuisance,
    Plan,
    Setting,
    collecting,
    constants_for,
    discretize_each,
    fill_inputs,
    fresh,
    watch_of,
)
from tridentify.online.result import assembled
from tridentify.online.seam import (
    Estimator,
    Kernels,
    check_choice,
    check_forgetting,
    check_owner,
    check_state,
    kept_samples,
    not_ready,
)
from tridentify.online.search import (
    checked_start,
    far_off,
    first_try,
    next_try,
    poles_of_start,
    search,
)
from tridentify.online.slots import DIRECTIONAL, EXPONENTIAL, RESETTING, triangle_size
from tridentify.online.starting import admissible, calm, run_kept, shortened, take_clocks, without
from tridentify.online.state import Stage, State
from tridentify.transfer_function import TransferFunction

Array = NDArray[np.float64]

KINDS = {"exponential": EXPONENTIAL, "directional": DIRECTIONAL, "resetting": RESETTING}
MOST_KEPT = 2000
PER_UNKNOWN = 10
ALARM_LASTS = 200
WIDER = 1e4
LEARNING = 20  # blocks, as the equation error is never white


class Maps(NamedTuple):
    """Physical coefficients from the unknowns: ``theta = constant + matrix @ unknowns``."""

    matrix: Array
    constant: Array


def maps_of(setting: Setting, c: Cascade) -> Maps:
    """How the coefficients follow from the weights of the functions of ``c``."""
    n, q = setting.n_poles, c.order
    basis, table = degree_basis(c), numerators(c.poles)
    proper = basis.rows @ table
    count = len(setting.names)
    matrix, constant = np.zeros((count, count)), np.zeros(count)
    monic = denominator(c.poles)
    matrix[:n, :n] = proper[:n, q - n :].T
    constant[:n] = monic[1:] if q == n else (proper[n] / basis.leading[n])[q - n :]
    at = n
    for row in setting.zeros:
        for m in row:
            block = np.zeros((m + 1, m + 1))
            full = np.pad(proper[: min(m + 1, q)], ((0, 0), (1, 0)))
            if m == q:
                full = np.vstack([full, monic])
            block[:, :] = full[:, q - m :].T
            matrix[at : at + m + 1, at : at + m + 1] = block
            at += m + 1
    return Maps(matrix, constant)


def equation_blueprint(
    setting: Setting,
    poles: Complex,
    *,
    restarted: bool,
    weights: Array,
    forgetting: float = 1.0,
    kind: int = EXPONENTIAL,
    filtering: bool = False,
) -> Blueprint:
    """The plan of an estimator on the equation error.

    Parameters
    ----------
    setting : Setting
    poles : (q,) complex array
        Of the filter.
    restarted : bool
        Whether it begins in the middle, from any state.
    weights : (n_outputs,) array
        Of the outputs.
    forgetting : float
    kind : int
        Of forgetting.
    filtering : bool
        Whether the coefficients drift.
    """
    m, p, q = setting.n_inputs, setting.n_outputs, poles.size
    wanted = Nuisance.of(setting.structure, restarted)
    # a constant comes with the transient of the filter that it begins with
    nuisance = Nuisance(wanted.free or wanted.offset, wanted.offset, False)
    coefficients = len(setting.names)
    columns = p * (q * nuisance.free + nuisance.offset) + coefficients
    ints = np.zeros(slots.N_INTS, dtype=np.int64)
    ints[slots.INPUTS], ints[slots.OUTPUTS] = m, p
    ints[slots.ORDER], ints[slots.COLUMNS] = q, columns
    ints[slots.FREE], ints[slots.OFFSET], ints[slots.KIND] = (*nuisance[:2], kind)
    ints[slots.BEGIN] = setting.late if nuisance.free else 0
    ints[slots.UPPER] = int(np.any(poles.imag != 0))
    ints[slots.COEFFICIENTS] = coefficients
    ints[slots.DIRECTIONS], ints[slots.DIRECTIONS_STRIDE] = coefficients, 0
    ints[slots.BLOCK] = max(20, 4 * coefficients)
    ints[slots.FILTERING], ints[slots.LEARNING] = filtering, LEARNING
    ints[slots.WALKERS] = coefficients if filtering else 0
    plan = Plan(slots.INBOX + m + p)
    ints[slots.LINE] = max(whole for whole, _ in setting.shifts) + 3
    ints[slots.AT_LINE] = plan.take(m * int(ints[slots.LINE]))
    ints[slots.AT_REFERENCE] = plan.take(m)
    ints[slots.AT_FIRST_INPUT] = plan.take(m)
    ints[slots.AT_LARGEST] = plan.take(2 * (m + p))
    ints[slots.EQUILIBRIUM] = setting.structure.initial_state == "equilibrium"
    ints[slots.AT_CHUNK] = plan.take(0)
    judged = coefficients + coefficients * (coefficients + 1) // 2 + slots.SUMS
    ints[slots.WATCH] = slots.SCORES + 2 * coefficients + slots.SCALES * judged
    ints[slots.AT_WATCH] = plan.take(p * int(ints[slots.WATCH]))
    ints[slots.AT_ROW] = plan.take(columns)
    ints[slots.AT_WORK] = plan.take(max(columns, q))
    ints[slots.AT_IMPULSE] = plan.take(q)
    ints[slots.AT_INPUTS] = plan.take(m * q)
    ints[slots.AT_OUTPUTS] = plan.take(p * q)
    ints[slots.AT_BEFORE] = plan.take(p)
    ints[slots.AT_THETA] = plan.take(columns)
    ints[slots.FACTOR] = 0 if filtering else triangle_size(columns)
    ints[slots.AT_FACTOR] = plan.take(int(ints[slots.FACTOR]))
    if filtering:
        ints[slots.AT_COVARIANCE] = plan.take(columns * (columns + 1) // 2)
        ints[slots.AT_GAIN] = plan.take(columns + columns * (columns + coefficients))
    constants = Plan(slots.CONSTANTS)
    ints[slots.C_STEP] = constants.take(q * q)
    ints[slots.C_TAPS] = constants.take(3 * m * q)
    ints[slots.C_DIRECT] = constants.take(2 * m)
    ints[slots.C_START] = constants.take(1 + q)
    ints[slots.C_EXTRA] = constants.take(m)
    ints[slots.C_OUTPUT] = constants.take(2 * q)
    ints[slots.C_BASIS] = constants.take(q * q)
    ints[slots.C_MONIC] = constants.take(q + 1 + p)
    ints[slots.C_ZEROS] = constants.take(m * p + 1)
    if filtering:
        ints[slots.C_WALK] = constants.take(columns * coefficients)
        ints[slots.C_WIDTHS] = constants.take(coefficients)
    c = np.zeros(constants.at)
    # a triangle that all outputs share takes a row of each
    c[slots.INTERVAL], c[slots.FORGETTING] = setting.dt, forgetting ** (1.0 / p)
    c[slots.PACE] = min(1.0, max(5.0 * (1.0 - forgetting), 1e-3))
    _write_filter(c, ints, setting, cascade(poles), weights)
    return Blueprint(ints, c, plan.at, poles, nuisance)


def _write_filter(
    c: Array, ints: NDArray[np.int64], setting: Setting, bank: Cascade, weights: Array
) -> None:
    m, q, n = setting.n_inputs, bank.order, setting.n_poles
    for j, (whole, _) in enumerate(setting.shifts):
        c[ints[slots.C_EXTRA] + j] = whole
    at = int(ints[slots.C_START])
    c[at] = NEGLIGIBLE * np.abs(bank.b).max()
    c[at + 1 : at + 1 + q] = bank.b
    fill_inputs(c, ints, setting, bank, setting.dt)
    joined = discretize_each(bank, np.array([setting.dt]), "foh")
    at = int(ints[slots.C_OUTPUT])
    c[at : at + q], c[at + q : at + 2 * q] = joined.from_current[0], joined.from_next[0]
    basis = degree_basis(bank)
    at = int(ints[slots.C_BASIS])
    c[at : at + q * q] = basis.rows.ravel()
    at = int(ints[slots.C_MONIC])
    if q == n:
        c[at + q] = 1.0
    else:
        c[at : at + q] = basis.rows[n] / basis.leading[n]
    c[at + q + 1 : at + q + 1 + weights.size] = weights
    at = int(ints[slots.C_ZEROS])
    c[at : at + m * setting.n_outputs] = np.ravel(setting.zeros)
    c[at + m * setting.n_outputs] = n


class EquationError(Estimator):
    """What recursive least squares and the Kalman filter share."""

    filter: tuple[float, ...] | None
    start: TransferFunction | None
    on_change: str

    @staticmethod
    @cache
    def kernels() -> Kernels:
        """The compiled sample loop."""
        from tridentify.online.equation_kernel import equation_run, equation_step

        return Kernels(equation_step, equation_run)

    def plan(
        self, setting: Setting, poles: Complex, weights: Array, *, restarted: bool, filtering: bool
    ) -> Blueprint:
        """The blueprint with these options."""
        raise NotImplementedError

    def begin(self, setting: Setting) -> State:
        """The state before the first sample."""
        if setting.structure.drift is True:
            raise UnsupportedError(
                f"found drift=True; {self.name} on-line estimates no drift; leave it out, or use "
                "online.ThreeModel()"
            )
        weights = np.ones(setting.n_outputs)
        if self.filter is not None:
            poles = sort_poles(np.roots(self.filter).astype(np.complex128))
            if poles.size < setting.n_poles:
                raise OptionError(
                    f"found filter={self.filter} of degree {poles.size} with {setting.n_poles} "
                    "poles; expected a degree of at least the number of poles; raise the degree"
                )
        elif self.start is not None:
            poles = poles_of_start(self.start, setting)
        else:
            blueprint = collecting(setting)
            x = fresh(blueprint)
            x[slots.TICK] = first_try(setting)
            return State(x, Stage(self, setting, blueprint, blueprint.poles))
        blueprint = self.plan(setting, poles, weights, restarted=False, filtering=False)
        x = fresh(blueprint)
        x[slots.TICK] = self.wait(setting, blueprint)
        return State(x, Stage(self, setting, blueprint, poles, searching=False))

    def wait(self, setting: Setting, blueprint: Blueprint) -> float:
        """Samples from the beginning of the equation to its first tick; 0 for none."""
        return 0.0

    def size_of(self, setting: Setting, blueprint: Blueprint) -> int:
        """Length of the vector that goes with a blueprint."""
        if not blueprint.poles.size:
            return collecting(setting).size
        filtering = bool(blueprint.ints[slots.FILTERING])
        weights = np.ones(setting.n_outputs)
        restarted = blueprint.nuisance.free
        return self.plan(
            setting, blueprint.poles, weights, restarted=restarted, filtering=filtering
        ).size

    def is_ready(self, state: State) -> bool:
        """Whether `estimate` would answer."""
        x, stage = state
        if stage.searching:
            return False
        k = int(stage.blueprint.ints[slots.COEFFICIENTS])
        root = unknowns_of(stage.blueprint, x, stage.setting.n_outputs)[1]
        return bool(np.all(np.isfinite(root[-k:])))

    def constants_for(self, blueprint: Blueprint, setting: Setting, intervals: Array) -> Array:
        """``c`` for samples that come after other intervals."""
        c = constants_for(blueprint, setting, intervals)
        if blueprint.poles.size:
            joined = discretize_each(blueprint.bank, intervals, "foh")
            at, q = int(blueprint.ints[slots.C_OUTPUT]), blueprint.poles.size
            c[:, at : at + q] = joined.from_current
            c[:, at + q : at + 2 * q] = joined.from_next
        return c

    def tick(self, state: State) -> State:
        """Search for the filter."""
        if not state.stage.searching:
            return state
        x, stage = state
        setting = stage.setting
        samples = far_off(setting, kept_samples(state))
        begun_anew = x[slots.COUNT] > len(samples)
        with one_blas_thread():
            found = search(setting, samples, begun_anew)
        full = len(samples) >= MOST_KEPT
        if found is None or not (found.certain or full):
            x[slots.TICK] = x[slots.COUNT] + next_try(len(samples)) - len(samples)
            return shortened(state, samples) if full else state
        poles = admissible(setting, found.poles, samples)
        weights = 1.0 / np.where(found.noise_std > 0, found.noise_std, 1.0)
        weights = weights / weights[0]
        blueprint = self.plan(setting, poles, weights, restarted=begun_anew, filtering=False)
        fed = fresh(blueprint)
        flags = run_kept(self, setting, blueprint, fed, samples)
        cleaned = without(samples, flags, setting.n_inputs)
        if cleaned is not None:
            fed = fresh(blueprint)
            run_kept(self, setting, blueprint, fed, cleaned)
        take_clocks(x, stage.blueprint, fed, blueprint, len(samples))
        fed[slots.FILLED] = 0.0
        wait = self.wait(setting, blueprint)
        fed[slots.TICK] = max(wait - len(samples), 1.0) + fed[slots.COUNT] if wait else 0.0
        anew = stage.but(blueprint=blueprint, poles=poles, past=(), searching=False)
        calm(fed, anew)
        return State(fed, anew)

    def alarmed(self, state: State) -> State:
        """Note the change; take the weight off the past if so told."""
        x, stage = state
        here = int(x[slots.COUNT])
        changed = stage.but(changes=(*stage.changes, here - 1))
        x[slots.ALARM] = here + ALARM_LASTS
        x[slots.FLAGS] = float(int(x[slots.FLAGS]) | slots.CHANGED)
        calm(x, stage)
        if self.on_change == "restart":
            self.loosen(x, stage.blueprint)
        return State(x, changed)

    def loosen(self, x: Array, blueprint: Blueprint) -> None:
        """Leave the past the weight of one sample."""
        ints, n = blueprint.ints, blueprint.n_columns
        remembered = max(float(x[watch_of(blueprint, 0) + slots.WEIGHT]), 1.0)
        if ints[slots.FILTERING]:
            at = int(ints[slots.AT_COVARIANCE])
            x[at : at + n] *= WIDER
            return
        at = int(ints[slots.AT_FACTOR])
        x[at : at + n] /= remembered
        for i in range(int(ints[slots.OUTPUTS])):
            w = watch_of(blueprint, i)
            for slot in (slots.SQUARES, slots.WEIGHT, slots.WEIGHT2, slots.SPREAD):
                x[w + slot] /= remembered

    def estimate(self, state: State) -> Estimate:
        """The coefficients with their standard errors.

        Parameters
        ----------
        state : State

        Returns
        -------
        Estimate
            ``fit`` and ``noise_variance`` are those of the equation error.

        Raises
        ------
        NotReadyError
            The samples so far do not determine them.
        """
        check_state(state)
        check_owner(self, state.method)
        x, stage = state
        setting, blueprint = stage.setting, stage.blueprint
        count = int(x[slots.COUNT])
        if stage.searching:
            raise not_ready(count, "are still searched for a filter")
        k = int(blueprint.ints[slots.COEFFICIENTS])
        unknowns, root, noise = unknowns_of(blueprint, x, setting.n_outputs)
        if not np.all(np.isfinite(root[-k:])):
            raise not_ready(count, "do not determine the coefficients")
        maps = maps_of(setting, blueprint.bank)
        theta = maps.constant + maps.matrix @ unknowns[-k:]
        spread = maps.matrix @ root[-k:]
        filtering = bool(blueprint.ints[slots.FILTERING])
        trace = Trace((), (), (f"filter of degree {blueprint.poles.size}",), "recursive")
        return assembled(
            setting, blueprint, x, theta, spread @ spread.T, noise, Status.SETTLED, trace,
            self.name, None if filtering else float(np.linalg.cond(root[-k:])),
        )  # fmt: skip


def unknowns_of(blueprint: Blueprint, x: Array, n_outputs: int) -> tuple[Array, Array, Array]:
    """Unknowns, a root of their covariance (``nan`` where undetermined), variance of the error.

    Parameters
    ----------
    blueprint : Blueprint
    x : array
    n_outputs : int

    Returns
    -------
    unknowns : (n,) array
    root : (n, n) array
        Its product with its transpose is the covariance.
    noise : (n_outputs,) array
    """
    ints, n = blueprint.ints, blueprint.n_columns
    squares, weight, weight2, taken = np.zeros((4, n_outputs))
    for i in range(n_outputs):
        w = watch_of(blueprint, i)
        squares[i], weight[i] = x[w + slots.SQUARES], x[w + slots.WEIGHT]
        weight2[i], taken[i] = x[w + slots.WEIGHT2], x[w + slots.TAKEN]
    at = int(ints[slots.C_MONIC]) + blueprint.poles.size + 1
    scales = blueprint.constants[at : at + n_outputs]
    noise = squares / np.maximum(weight - n / n_outputs, 1.0) / scales**2
    if ints[slots.FILTERING]:
        at, theta = int(ints[slots.AT_COVARIANCE]), int(ints[slots.AT_THETA])
        upper = np.eye(n)
        for j in range(n):
            begin = at + n + j * (j - 1) // 2
            upper[:j, j] = x[begin : begin + j]
        return x[theta : theta + n].copy(), upper * np.sqrt(x[at : at + n]), noise
    at = int(ints[slots.AT_FACTOR])
    d = x[at : at + n]
    unit = np.eye(n)
    unit[np.triu_indices(n, 1)] = x[at + 4 * n : at + int(ints[slots.FACTOR])]
    live = d > 0
    unknowns = scipy.linalg.solve_triangular(unit, x[at + n : at + 2 * n], unit_diagonal=True)
    common = float(squares.sum() / max(weight.sum() - n, 1.0))
    share = float(weight2.sum() / max(weight.sum(), 1.0))
    inverse = scipy.linalg.solve_triangular(unit, np.eye(n), unit_diagonal=True)
    width = np.where(live, np.sqrt(common * share / np.where(live, d, 1.0)), np.nan)
    if taken.sum() <= n:
        width = np.full(n, np.nan)
    with np.errstate(invalid="ignore"):
        # a direction that was never seen only matters for the unknowns it belongs to
        root = np.where(inverse != 0.0, inverse * width, 0.0)
    return unknowns, root, noise


@dataclass(frozen=True)
class RecursiveLeastSquares(EquationError):
    """Recursive least squares on state-variable filters.

    Parameters
    ----------
    forgetting : float
        Factor by which the past counts less with every sample; 1 forgets nothing.
    forget : {"exponential", "directional", "resetting"}
        Whether all of the past fades (as long as the input renews it), only what the new sample
        speaks of, or nothing, but its weight is cut to a tenth every ``1 / (1 - forgetting)``
        samples.
    filter : sequence of float, optional
        Coefficients of ``c(p)``, descending powers, stable, of a degree not below the number of
        poles. Without it the first samples are searched.
    start : TransferFunction or Estimate, optional
        Model whose denominator is the filter.
    on_change : {"flag", "restart"}
        Whether a change of the coefficients is only flagged, or takes the weight off the past. The
        equation error is not white, so that false alarms are more frequent than with `ThreeModel`.

    Raises
    ------
    OptionError
        An option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, online, simulate
    >>> u = np.sign(np.sin(np.arange(500) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.01))
    >>> method = online.RecursiveLeastSquares(filter=(1.0, 5.0))
    >>> found = online.run(method, Record(u, y, dt=0.01), Structure(1, 0))
    >>> found.estimate.theta.round(2).tolist()
    [4.0, 2.0]
    """

    forgetting: float = 1.0
    forget: str = "exponential"
    filter: tuple[float, ...] | None = None
    start: TransferFunction | None = None
    on_change: str = "flag"

    name: ClassVar[str] = "recursive-least-squares"

    def __post_init__(self) -> None:
        check_forgetting(self.forgetting)
        check_choice("forget", self.forget, tuple(KINDS))
        check_choice("on_change", self.on_change, ("restart", "flag"))
        object.__setattr__(self, "filter", checked_filter(self.filter))
        object.__setattr__(self, "start", checked_start(self.start))

    def plan(
        self, setting: Setting, poles: Complex, weights: Array, *, restarted: bool, filtering: bool
    ) -> Blueprint:
        """The blueprint with these options."""
        return equation_blueprint(
            setting, poles, restarted=restarted, weights=weights, forgetting=self.forgetting,
            kind=KINDS[self.forget],
        )  # fmt: skip


@dataclass(frozen=True)
class Kalman(EquationError):
    """Coefficients that drift as random walks, on state-variable filters.

    Parameters
    ----------
    drift : float or mapping of str to float
        Standard deviation of the way that a coefficient goes in one second: one number relative
        to its size where the filter takes over, or in its own units by name (zero for those not
        named).
    filter : sequence of float, optional
        Coefficients of ``c(p)``, as for `RecursiveLeastSquares`.
    start : TransferFunction or Estimate, optional
        Model whose denominator is the filter.
    on_change : {"flag", "restart"}
        Whether a change of the coefficients is only flagged, or widens their covariance.

    Raises
    ------
    OptionError
        An option is out of range.

    Examples
    --------
    >>> from tridentify import online
    >>> online.Kalman(drift={"a1": 0.05}).drift
    {'a1': 0.05}
    """

    drift: float | Mapping[str, float] = 0.01
    filter: tuple[float, ...] | None = None
    start: TransferFunction | None = None
    on_change: str = "flag"

    name: ClassVar[str] = "kalman"

    def __post_init__(self) -> None:
        check_choice("on_change", self.on_change, ("restart", "flag"))
        object.__setattr__(self, "filter", checked_filter(self.filter))
        object.__setattr__(self, "start", checked_start(self.start))
        given = self.drift.values() if isinstance(self.drift, Mapping) else [self.drift]
        for one in given:
            number = isinstance(one, (int, float)) and not isinstance(one, bool)
            if not number or not 0.0 <= one < np.inf:
                raise OptionError(
                    f"found drift={shown(self.drift)}; expected numbers of at least zero: how far "
                    "a coefficient walks in one second; correct it"
                )
        if isinstance(self.drift, Mapping):
            object.__setattr__(self, "drift", dict(self.drift))

    def __hash__(self) -> int:
        drift = tuple(self.drift.items()) if isinstance(self.drift, Mapping) else self.drift
        return hash((drift, self.filter, self.start, self.on_change))

    def plan(
        self, setting: Setting, poles: Complex, weights: Array, *, restarted: bool, filtering: bool
    ) -> Blueprint:
        """The blueprint with these options."""
        return equation_blueprint(
            setting, poles, restarted=restarted, weights=weights, filtering=filtering
        )

    def begin(self, setting: Setting) -> State:
        """The state before the first sample."""
        if isinstance(self.drift, Mapping):
            wrong = [name for name in self.drift if name not in setting.names]
            if wrong:
                raise OptionError(
                    f"found drift of {shown(wrong[0])}; expected coefficients: "
                    f"{', '.join(setting.names)}; correct the name"
                )
        return super().begin(setting)

    def wait(self, setting: Setting, blueprint: Blueprint) -> float:
        """Samples that least squares is given."""
        return float(PER_UNKNOWN * blueprint.n_columns + setting.late)

    def tick(self, state: State) -> State:
        """Search for the filter, then take over from least squares."""
        x, stage = state
        if stage.searching:
            return super().tick(state)
        old, setting = stage.blueprint, stage.setting
        if old.ints[slots.FILTERING]:
            return state
        unknowns, root, _ = unknowns_of(old, x, setting.n_outputs)
        if not np.all(np.isfinite(root)):
            x[slots.TICK] = x[slots.COUNT] + self.wait(setting, old)
            return state
        at = int(old.ints[slots.C_MONIC]) + old.poles.size + 1
        weights = old.constants[at : at + setting.n_outputs]
        new = self.plan(setting, old.poles, weights, restarted=old.nuisance.free, filtering=True)
        walk, widths = self._walk(setting, new, unknowns)
        c = new.constants
        at = int(new.ints[slots.C_WALK])
        c[at : at + walk.size] = walk.ravel()
        at = int(new.ints[slots.C_WIDTHS])
        c[at : at + widths.size] = widths
        found = np.zeros(new.size)
        end = int(old.ints[slots.AT_FACTOR])
        found[:end] = x[:end]
        n = new.n_columns
        found[int(new.ints[slots.AT_THETA]) :][:n] = unknowns
        diagonal = np.diagonal(root)
        at = int(new.ints[slots.AT_COVARIANCE])
        found[at : at + n] = diagonal**2
        upper = root / diagonal
        for j in range(n):
            begin = at + n + j * (j - 1) // 2
            found[begin : begin + j] = upper[:j, j]
        return State(found, stage.but(blueprint=new))

    def _walk(self, setting: Setting, blueprint: Blueprint, unknowns: Array) -> tuple[Array, Array]:
        """Directions of the walk among the unknowns, and variances a second."""
        k = len(setting.names)
        maps = maps_of(setting, blueprint.bank)
        theta = maps.constant + maps.matrix @ unknowns[-k:]
        if isinstance(self.drift, Mapping):
            speed = np.array([float(self.drift.get(name, 0.0)) for name in setting.names])
        else:
            speed = self.drift * np.abs(theta)
        walk = np.zeros((blueprint.n_columns, k))
        walk[-k:] = np.linalg.inv(maps.matrix)
        return walk, speed**2
