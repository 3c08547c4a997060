r"""Experiments whose noise has levels of their own.

With one variance ``sigma_e^2`` for each experiment (and output) the likelihood is

    -2 log L = sum_e n_e log sigma_e^2 + RSS_e / sigma_e^2,

least squares of rows that are divided by ``sigma_e``. Levels and coefficients are found in turn;
where both stand still is the maximum, but for the degrees of freedom: with the weighted derivatives
``J`` of the outputs and ``h_e`` the trace of their projection ``J (J'J)^{-1} J'`` within an
experiment, the residual there has the expectation ``(n_e - h_e) sigma_e^2``, so that

    sigma_e^2 = RSS_e / (n_e - h_e),

which keeps a short experiment from being followed more closely than its noise allows (the REML
estimate; Patterson & Thompson 1971). Multiplied by a common factor such that ``sum n_e log s_e =
0`` the levels change no ``log L`` but by what they explain: all that compares costs stays as it is.

*An experiment of another system* leaves what is no noise. Whether it does, a test of its own
derivatives and of past inputs says: what they explain of its residual, over what is left beside
them, is F distributed where the model is that of all. Where they explain more its level is that of
what is left, so that an experiment that differs is not believed less for it, and is seen to differ.

*Whether.* Variances that are equal within chance (Bartlett 1937) are taken as one.

References
----------
M. S. Bartlett, Proc. Royal Society A 160 (1937), 268-282.
H. D. Patterson, R. Thompson, Biometrika 58 (1971), 545-554.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from scipy.special import chdtrc, fdtrc

from tridentify.estimation.likelihood.curvature import Curvature
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten_columns
from tridentify.numerics.lagrange import span
from tridentify.record.record import Record

BY_CHANCE = 1e-3
"""Probability that equal variances are taken for different ones."""

WORTH_WEIGHTS = 1.15
"""Largest standard deviation over the smallest from which weights are worth while: below it one
variance costs less than half a per cent of a standard error."""

OF_ANOTHER_SYSTEM = 1e-4
"""Probability that an experiment of the same system passes for one of another."""

FEWEST = 8.0
"""Degrees of freedom from which an experiment has a level of its own; with fewer it has that of all
others together."""

LEAST = 1e-4
"""Of the largest level: no level is below it, as weights of more digits lose those of the rest."""

PAST, PER_LAG = 40, 8
"""Samples of past inputs that may explain a residual, and samples of the record for each."""

LONGEST = 20_000
"""Samples of an experiment on which that is looked for."""

ROUNDING = 1e-9
"""Residual over output below which there is no noise."""


@dataclass(frozen=True, eq=False)
class NoiseLevels:
    """Variances of the noise, and how well they are known.

    Attributes
    ----------
    variance, freedom : (n_experiments, n_outputs) arrays
        [output units squared]; degrees of freedom, zero where nothing is known.
    """

    variance: Array
    freedom: Array

    @classmethod
    def at(cls, curvature: Curvature) -> NoiseLevels:
        """Those that the residual at a point shows."""
        point = curvature.point
        shape = len(point.regressions), point.problem.n_outputs
        variance, freedom = np.zeros(shape), np.zeros(shape)
        every = np.eye(max(place.stop for place in point.width.values()))
        for i, fit in enumerate(point.fits):
            moves, row = point.sensitivities(every, i), 0
            for e, (regression, experiment) in enumerate(
                zip(point.regressions, point.problem.experiments, strict=True)
            ):
                rows = point.changes(e, i)
                left = fit.residual[row : row + len(rows)]
                row += len(rows)
                along = rows @ curvature.root / np.sqrt(max(curvature.noise[i], 1e-300))
                n = max(float(regression.counts[i]) - float(np.einsum("ij,ij->", along, along)), 0)
                own = float(left @ left) / max(n, 1.0) * experiment.scale_of(i) ** 2
                noise = point.problem.noise[i] if point.problem.noise else np.zeros(0)
                beside = _beside_response(point.residuals()[e][:, i], moves[e], experiment.u, noise)
                variance[e, i], freedom[e, i] = beside or (own, n)
        return cls(variance, freedom)

    @classmethod
    def of(cls, residuals: Sequence[Array], unknowns: float) -> NoiseLevels:
        """Those of residuals (n_samples, n_outputs), each less its share of the unknowns."""
        counts = np.array([np.isfinite(one).sum(axis=0) for one in residuals], dtype=np.float64)
        rss = np.array([np.nansum(one**2, axis=0) for one in residuals])
        freedom = np.maximum(counts * (1.0 - unknowns / max(float(counts.sum()), 1.0)), 0.0)
        return cls(rss / np.maximum(freedom, 1.0), np.where(counts > 0, freedom, 0.0))

    @property
    def known(self) -> NoiseLevels:
        """With the mean of all others where an experiment is too short for a level of its own."""
        enough = self.freedom >= FEWEST
        weight = np.where(enough, self.freedom, 0.0)
        mean = (weight * self.variance).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
        variance = np.where(enough, self.variance, mean)
        return NoiseLevels(np.maximum(variance, LEAST**2 * variance.max(axis=0)), self.freedom)

    @property
    def differ(self) -> Array:
        """(n_outputs,) bool, whether the levels of the experiments are more than one."""
        found = np.zeros(self.variance.shape[1], dtype=bool)
        for i, (v, n) in enumerate(zip(self.variance.T, self.freedom.T, strict=True)):
            v, n = v[n >= FEWEST], n[n >= FEWEST]
            if v.size < 2 or not np.all(v > 0):
                continue
            mean = float(n @ v / n.sum())
            fall = float(n.sum() * np.log(mean) - n @ np.log(v))
            fall /= 1.0 + (np.sum(1.0 / n) - 1.0 / n.sum()) / (3.0 * (v.size - 1))
            wide = v.max() > WORTH_WEIGHTS**2 * v.min()
            found[i] = wide and chdtrc(v.size - 1, fall) < BY_CHANCE / found.size
        return found


def _beside_response(
    left: Array, moved: Array, u: Array, noise: Array
) -> tuple[float, float] | None:
    """Variance and degrees of freedom beside all that follows the input, where something does.

    Parameters
    ----------
    left : (n,) array
        Residual; ``nan`` where a sample is missing.
    moved : (n, k) array
        Derivatives by all that was fitted.
    u : (n, n_inputs) array
    noise : (p,) array
        Model of the noise.
    """
    left, moved, u = left[:LONGEST], moved[:LONGEST], u[:LONGEST]
    seen = np.isfinite(left)
    count = int(seen.sum())
    most = min(PAST, count // (PER_LAG * u.shape[1]))
    late = [np.roll(u - u[0], lag, axis=0) for lag in range(most)]
    for lag, one in enumerate(late):
        one[:lag] = 0.0
    columns = np.column_stack([np.nan_to_num(moved), *late])
    norms = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    columns = np.column_stack([columns[:, norms > 0] / norms[norms > 0], np.nan_to_num(left)])
    white = whiten_columns([columns], [seen], noise)
    basis, e = span(white[:, :-1]), white[:, -1]
    freedom = float(count - basis.shape[1])
    if freedom < FEWEST or not basis.shape[1]:
        return None
    along = basis.T @ e
    more, rest = float(along @ along), float(e @ e - along @ along)
    f = more / basis.shape[1] * freedom / max(rest, 1e-300)
    if rest > 0 and fdtrc(basis.shape[1], freedom, f) < OF_ANOTHER_SYSTEM:
        return rest / freedom, freedom
    return None


def scales_of(levels: Sequence[Array], records: Sequence[Record]) -> list[Array]:
    """Levels over what they are together, so that ``sum n_e log s_e = 0`` for every output.

    Examples
    --------
    >>> record = Record([0, 1, 1, 1], [0.0, 0.1, 0.3, 0.4], dt=0.5)
    >>> [one.tolist() for one in scales_of([np.array([0.5]), np.array([2.0])], [record] * 2)]
    [[0.5], [2.0]]
    """
    counts = np.array([np.isfinite(record.y).sum(axis=0) for record in records], dtype=np.float64)
    logs = np.log(np.array(levels))
    logs = logs - (counts * logs).sum(axis=0) / counts.sum(axis=0)
    return list(np.exp(np.round(logs, 10)))


def noise_sizes(records: Sequence[Record], output: int) -> tuple[float, ...]:
    """Noise of an output in each experiment over that of all; empty where it is one.

    Parameters
    ----------
    records : sequence of Record
        Weighted, or not.
    output : int
    """
    scales = [record._noise_scale for record in records]
    if all(one is None for one in scales):
        return ()
    return tuple(1.0 if one is None else float(one[output]) for one in scales)


_beside: WeakKeyDictionary[Record, Record] = WeakKeyDictionary()
"""Every record as it was weighed last: who looks at an estimate next is given the same ones."""


def weighed(records: Sequence[Record], levels: Sequence[Array]) -> list[Record]:
    """The records with these noise levels; as they are where there are none.

    Parameters
    ----------
    records : sequence of Record
    levels : sequence of (n_outputs,) arrays
        Standard deviations, one for each experiment; empty for one level of all.
    """
    if len(levels) != len(records):
        return list(records)
    found = []
    for record, scale in zip(records, scales_of(levels, records), strict=True):
        own = _beside.get(record)
        known = None if own is None else own._noise_scale
        if own is None or known is None or not np.array_equal(known, scale):
            own = record._weighed(scale)
            if own is not record:
                _beside[record] = own
        found.append(own)
    return found
