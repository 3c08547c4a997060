"""Recursive least squares and a Kalman filter on the equation error of the recorded output.

    eps = (a / c) y - (b / c) u - (c_0 / c) delta - const

is linear in ``a``, ``b``, the initial state and the constant, with a fixed filter ``c``
(`methods.filtered.state_variable_filters` derives it; the unknowns are the weights of the
orthonormal functions of ``c`` sorted by degree). One row a sample and output enters a triangle or a
Kalman filter (`numerics.recursive`).

*What it is for.* It needs no model to start from and takes few operations a sample. The noise of
``y`` stands in its regressors: it is biased, the more so the more noise there is (paper, eq.
6-9), and the standard errors, which allow for an equation error that is not white
(`online.scatter`), say nothing of that; a caution does where that error follows its own past.
`online.ThreeModel` is the answer; this is the yardstick, and the choice where noise is small or
the processor smaller.

*Filter.* Where none is given, the first samples are kept and searched by the off-line three models,
and ``c`` is the denominator found: the filter that is best at low noise (Young 2011, section 8.3).

*Drifting coefficients* (`Kalman`): a random walk of each physical coefficient, independent of the
others, ``theta(t + h) = theta(t) + w, cov w = h diag(drift^2)``. It begins as least squares and
takes over covariance and coefficients once there are ten samples for each unknown. While the
input does not excite (`online.kernels.intake`) the walk is held, as the covariance would grow
without limit.

References
----------
P. C. Young, Recursive Estimation and Time-Series Analysis, 2nd ed., Springer 2011.
L. Ljung, T. Soderstrom, Theory and Practice of Recursive Identification, MIT Press 1983.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import ClassVar

import numpy as np
import scipy.linalg

from tridentify.estimation.answer.estimate import Estimate, Status, Trace
from tridentify.estimation.methods.filtered.filter_cascade import checked_filter
from tridentify.numerics.arrays import Array, Complex
from tridentify.online import search, starting
from tridentify.online.asked import check_choice, not_ready, refuse_drift
from tridentify.online.equation_plan import equation_blueprint, maps_of, output_weights
from tridentify.online.estimator import CompiledKernels, check_asked
from tridentify.online.findings import bias_finding, with_findings
from tridentify.online.kernels import slots
from tridentify.online.kernels.slots import DIRECTIONAL, EXPONENTIAL, RESETTING
from tridentify.online.layout import (
    Blueprint,
    Setting,
    Stage,
    collecting,
    constants_for,
    discretize_each,
    fresh,
    watch_of,
)
from tridentify.online.result import assembled
from tridentify.online.saved.state import State
from tridentify.online.scatter import widened, with_scatter
from tridentify.online.suspecting import MOST_KEPT, Suspecting
from tridentify.online.task import Task
from tridentify.transfer_function import TransferFunction

KINDS = {"exponential": EXPONENTIAL, "directional": DIRECTIONAL, "resetting": RESETTING}


class EquationError(Suspecting):
    """What recursive least squares and the Kalman filter share."""

    filter: tuple[float, ...] | None
    start: TransferFunction | None

    forgetting: float = 1.0
    forget: str = "exponential"
    one_triangle: ClassVar[bool] = True

    @staticmethod
    @cache
    def kernels() -> CompiledKernels:
        """The compiled sample loop."""
        from tridentify.online.kernels.equation import equation_step

        return CompiledKernels(equation_step, in_blocks=True)

    def _check(self) -> None:
        """Refuse options that are out of range."""
        check_choice("on_change", self.on_change, ("restart", "flag"))
        object.__setattr__(self, "filter", checked_filter(self.filter))
        object.__setattr__(self, "start", search.checked_start(self.start))

    def plan(
        self, setting: Setting, poles: Complex, weights: Array, *, restarted: bool,
        filtering: bool, keep: bool,
    ) -> Blueprint:  # fmt: skip
        """The blueprint with these options."""
        return equation_blueprint(
            setting, poles, restarted=restarted, weights=weights, forgetting=self.forgetting,
            kind=KINDS[self.forget], filtering=filtering, keep=keep,
        )  # fmt: skip

    def begin(self, setting: Setting) -> State:
        """The state before the first sample."""
        refuse_drift(self.name, setting)
        weights = np.ones(setting.n_outputs)
        if self.filter is not None:
            poles = search.filter_poles(self.filter, setting)
        elif self.start is not None:
            poles = search.poles_of_start(self.start, setting)
        else:
            return starting.waiting(self, setting)
        blueprint = self.plan(setting, poles, weights, restarted=False, filtering=False, keep=True)
        x = fresh(blueprint)
        x[slots.TICK] = self.wait(setting, blueprint)
        return State(x, Stage(self, setting, blueprint, poles, searching=False))

    def wait(self, setting: Setting, blueprint: Blueprint) -> float:
        """Samples from the beginning of the equation to its first tick; 0 for none."""
        return 0.0

    def rebuilt(self, setting: Setting, blueprint: Blueprint) -> Blueprint:
        """The plan of a blueprint from a file, made again."""
        poles, ints = blueprint.poles, blueprint.ints
        if not poles.size:
            return collecting(setting)
        degree = setting.n_poles if self.filter is None else len(self.filter) - 1
        if not poles.size == degree >= setting.n_poles:
            raise ValueError(f"a filter of degree {poles.size} in place of {degree}")
        # the weights were learnt: they are taken as they are
        weights = np.resize(output_weights(blueprint), setting.n_outputs)
        return self.plan(
            setting, poles, weights, restarted=blueprint.nuisance.free,
            filtering=bool(ints[slots.FILTERING]), keep=bool(ints[slots.CHUNK]),
        )  # fmt: skip

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

    def adapt(self, state: State) -> State:
        """Search for the filter."""
        return self.search(state) if state.stage.searching else state

    def _searching_task(self, state: State, samples: Array, begun_anew: bool, full: bool) -> Task:
        """The search for the filter."""
        return Task(search.clean_search, state.stage.setting, samples, begun_anew)

    def from_search(
        self,
        state: State,
        found: tuple[search.FoundPoles | None, Array],
        newest: Array,
        begun_anew: bool,
        full: bool,
    ) -> State | None:
        """Least squares on the filter that was found."""
        poles, samples = found
        if poles is None or not (poles.certain or full):
            return None
        return self._launched(state, poles, np.vstack([samples, newest]), begun_anew)

    def begun_again(self, state: State, found: search.FoundPoles, samples: Array) -> State:
        """The estimator that goes on from the samples since a change."""
        return self._launched(state, found, samples, True)

    def _launched(
        self, state: State, found: search.FoundPoles, samples: Array, begun_anew: bool
    ) -> State:
        """Kept samples on the filter that a model gives, or on that of the user."""
        x, stage = state
        setting = stage.setting
        if self.filter is None:
            poles = starting.admissible(setting, found.poles, samples)
        else:
            poles = stage.blueprint.poles
        weights = 1.0 / np.where(found.noise_std > 0, found.noise_std, 1.0)
        weights = weights / weights[0]
        blueprint = self.plan(
            setting, poles, weights, restarted=begun_anew, filtering=False,
            keep=len(samples) < MOST_KEPT,
        )  # fmt: skip
        fed = fresh(blueprint)
        flags = starting.run_kept(self, setting, blueprint, fed, samples)
        cleaned = starting.without(samples, flags, setting.n_inputs)
        if cleaned is not None:
            samples, fed = cleaned, fresh(blueprint)
            starting.run_kept(self, setting, blueprint, fed, samples)
        starting.take_clocks(x, stage.blueprint, fed, blueprint, len(samples))
        fed[slots.FILLED] = 0.0
        wait = self.wait(setting, blueprint)
        fed[slots.TICK] = max(wait - len(samples), 1.0) + fed[slots.COUNT] if wait else 0.0
        anew = stage.but(
            blueprint=blueprint, poles=poles, past=(samples,), searching=False, extra=()
        )
        starting.calm(fed, anew)
        return State(fed, anew)

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
        check_asked(self, state)
        x, stage = state
        setting, blueprint = stage.setting, stage.blueprint
        count = int(x[slots.COUNT])
        if stage.searching:
            raise not_ready(count, "are still searched for a filter")
        k = int(blueprint.ints[slots.COEFFICIENTS])
        unknowns, root, noise = unknowns_of(blueprint, x, setting.n_outputs)
        if not np.all(np.isfinite(root[-k:])) or not np.all(np.isfinite(unknowns[-k:])):
            raise not_ready(count, "do not determine the coefficients")
        maps = maps_of(setting, blueprint.bank)
        theta = maps.constant + maps.matrix @ unknowns[-k:]
        cov = root[-k:] @ root[-k:].T
        filtering = bool(blueprint.ints[slots.FILTERING])
        variance = noise * output_weights(blueprint) ** 2
        own, white = [np.arange(k)] * setting.n_outputs, cov
        if filtering:
            cov = widened(blueprint, x, cov, variance, own)
        else:
            cov = with_scatter(blueprint, x, cov, variance, own, np.eye(k))
        trace = Trace((), (), (f"filter of degree {blueprint.poles.size}",), "recursive")
        white, cov = (maps.matrix @ one @ maps.matrix.T for one in (white, cov))
        found = assembled(
            setting, blueprint, x, theta, cov, noise, Status.SETTLED, trace, self.name,
            None if filtering else float(np.linalg.cond(root[-k:])),
        )  # fmt: skip
        return with_findings(state, replace(found, findings=bias_finding(white, cov)))


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
    noise = squares / np.maximum(weight - n / n_outputs, 1.0) / output_weights(blueprint) ** 2
    if ints[slots.FILTERING]:
        at, theta = int(ints[slots.AT_COVARIANCE]), int(ints[slots.AT_THETA])
        upper = np.eye(n)
        for j in range(n):
            begin = at + n + j * (j - 1) // 2
            upper[:j, j] = x[begin : begin + j]
        # an entry that overflowed is undetermined
        with np.errstate(invalid="ignore", over="ignore"):
            root = upper * np.sqrt(x[at : at + n])
        return x[theta : theta + n].copy(), root, noise
    at = int(ints[slots.AT_FACTOR])
    d = x[at : at + n]
    unit = np.eye(n)
    unit[np.triu_indices(n, 1)] = x[at + 4 * n : at + int(ints[slots.FACTOR])]
    live = d > 0
    solved = partial(scipy.linalg.solve_triangular, unit_diagonal=True, check_finite=False)
    unknowns = solved(unit, x[at + n : at + 2 * n])
    common = float(squares.sum() / max(weight.sum() - n, 1.0))
    share = float(weight2.sum() / max(weight.sum(), 1.0))
    inverse = solved(unit, np.eye(n))
    with np.errstate(over="ignore"):
        width = np.where(live, np.sqrt(common * share / np.where(live, d, 1.0)), np.nan)
    if taken.sum() <= n:
        width = np.full(n, np.nan)
    with np.errstate(invalid="ignore"):
        # a direction that was never seen only matters for the unknowns it belongs to
        root = np.where(inverse != 0.0, inverse * width, 0.0)
    return unknowns, root, noise
