"""What is known of the coefficients, as linear algebra: ``theta = theta_0 + N z`` within bounds.

Fixed coefficients, linear equalities and static gains (``b_0 - gain a_0 = 0``) are linear
equalities in the physical coefficients. Those that say a coefficient alone are put in everywhere
first, over and over, so that what they determine is exact to the last digit. A null-space basis,
in coordinates of comparable size, holds the rest (Gill, Murray & Wright 1981, section 5.1); in it
the heaviest coefficient of an equality follows from the others.
Bounds stay inequalities; a Gaussian prior is a term of the cost.

``a_0 = ... = a_{k-1} = 0`` says ``k`` poles at the origin: integrators. All other poles are in
the open left half plane, which takes positive ``a_k, ..., a_{n-1}``; that much can be judged
before any data are looked at, by linear programming.

References: P. E. Gill, W. Murray & M. H. Wright, *Practical Optimization*, Academic Press 1981.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from tridentify.errors import (
    ContradictoryConstraintsError,
    ParameterNameError,
    UnsupportedError,
    shown,
)
from tridentify.numerics.arrays import Array, Flags
from tridentify.structure import Structure
from tridentify.writing.layout import format_sum

Rows = list[tuple[dict[int, float], float]]

CONSISTENT = 1e-9
"""Share of the sizes involved by which equalities may miss each other: far above rounding, far
below any digit that is measured."""
RANK = 1e-11
"""Singular values below this share of the largest count as zero: between rounding and
`CONSISTENT`."""
PLAIN = 1e50
"""Weights of up to this size, or its inverse, stay as they are written; others become about one."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known, resolved for the coefficients in the order of `Structure.names`.

    Attributes
    ----------
    names : tuple of str
    n_poles : int
    origin : (p,) array
        A point that meets the equalities.
    directions : (p, k) array
        Null space of the equalities: zero rows for what they determine.
    low, high : (p,) array
        Bounds; infinite where there is none.
    mean, spread : (p,) array
        Gaussian priors; infinite ``spread`` where there is none.
    integrators : int
        Poles at the origin.
    """

    names: tuple[str, ...]
    n_poles: int
    origin: Array
    directions: Array
    low: Array
    high: Array
    mean: Array
    spread: Array
    integrators: int

    @property
    def determined(self) -> Flags:
        """(p,) which coefficients the equalities determine."""
        return np.asarray(~np.any(self.directions, axis=1))

    @property
    def n_free(self) -> int:
        """Number of free directions."""
        return int(self.directions.shape[1])

    @property
    def moving(self) -> slice:
        """The coefficients ``a_{n-1}, ..., a_k`` of the poles that are not at the origin."""
        return slice(0, self.n_poles - self.integrators)

    @property
    def only_bounds(self) -> bool:
        """Whether bounds are all that is known."""
        return (
            not self.determined.any()
            and self.n_free == self.origin.size
            and not (np.isfinite(self.spread).any())
        )

    def prior_rows(self, directions: Array, theta: Array) -> tuple[Array, Array]:
        """What the priors say of a step along directions from ``theta``: rows and their targets."""
        prior = np.isfinite(self.spread)
        pull = (self.mean - theta)[prior] / self.spread[prior]
        return directions[prior] / self.spread[prior, None], pull

    def penalty(self, theta: Array) -> float:
        """Minus two log prior, up to a constant."""
        return float(np.sum(((theta - self.mean) / self.spread) ** 2))


def known_of(
    structure: Structure,
    input_names: Sequence[str],
    output_names: Sequence[str],
    scale: Array | None = None,
    *,
    stable: bool = True,
) -> Knowledge:
    """Resolve what a structure says of its coefficients.

    Parameters
    ----------
    structure : Structure
    input_names, output_names : sequence of str
        Of the record.
    scale : (p,) array, optional
        Sizes of the coefficients.
    stable : bool
        Whether poles that are not at the origin are to lie in the left half plane.

    Raises
    ------
    ContradictoryConstraintsError
        If it contradicts itself, leaves no stable model, or nothing to estimate.
    UnsupportedError
        With separate denominators or an estimated delay.
    """
    refuse_structure(structure)
    names = structure.names(input_names, output_names)
    size = np.ones(len(names)) if scale is None else scale
    values, rows = _substituted(equalities_of(structure, input_names, output_names), names)
    origin, directions = _null_space(values, rows, size, names)
    low, high = _bounds(structure, names)
    mean, spread = np.zeros(len(names)), np.full(len(names), np.inf)
    for name, (middle, width) in (structure.priors or {}).items():
        mean[names.index(name)], spread[names.index(name)] = middle, width
    alone = ~np.any(directions, axis=1)
    spread[alone] = np.inf
    n = structure.common_poles
    integrators = 0
    while integrators < n and alone[n - 1 - integrators] and origin[n - 1 - integrators] == 0.0:
        integrators += 1
    known = Knowledge(names, n, origin, directions, low, high, mean, spread, integrators)
    _refuse_contradictions(known, size)
    if stable:
        _refuse_unstable(known, structure, size)
    return known


def refuse_structure(structure: Structure) -> None:
    """Refuse structures whose coefficients cannot be constrained.

    Raises
    ------
    UnsupportedError
    """
    if not structure.shared or structure.delay == "free":
        what = "delay='free'" if structure.shared else "separate denominators"
        raise UnsupportedError(
            f"found {what} together with knowledge of the coefficients; expected one denominator "
            "shared by all channels and a known delay; leave one of the two out"
        )


def _refuse_unknown(structure: Structure, names: tuple[str, ...]) -> None:
    """Names of other channels; `Structure.names` cannot judge them for a single one."""
    for name in structure.known:
        if name not in names:
            raise ParameterNameError(
                f"found {shown(name)} among what is known; expected one of {', '.join(names)}; "
                "correct the name"
            )


def equalities_of(
    structure: Structure, input_names: Sequence[str], output_names: Sequence[str]
) -> Rows:
    """All that is said by equalities, as (weights by position, value).

    Parameters
    ----------
    structure : Structure
    input_names, output_names : sequence of str
        Of the record.

    Raises
    ------
    ParameterNameError
        If it names coefficients of other channels.
    """
    names = structure.names(input_names, output_names)
    _refuse_unknown(structure, names)
    rows: Rows = [({names.index(k): 1.0}, v) for k, v in (structure.fixed or {}).items()]
    for weights, value in structure.equalities or ():
        largest = max(abs(w) for w in weights.values())
        # a power of two, so that no digit is touched
        power = 0 if 1.0 / PLAIN <= largest <= PLAIN else -int(np.frexp(largest)[1])
        row = {names.index(name): float(np.ldexp(w, power)) for name, w in weights.items()}
        rows.append((row, float(np.ldexp(value, power))))
    gains = structure.gain_matrix(len(output_names), len(input_names))
    several = len(output_names) * len(input_names) > 1
    for output, line in zip(output_names, gains, strict=True):
        for source, gain in zip(input_names, line, strict=True):
            if gain is not None:
                own = f"b0[{output},{source}]" if several else "b0"
                weight = {names.index("a0"): -gain} if gain else {}
                rows.append(({names.index(own): 1.0, **weight}, 0.0))
    return rows


def _substituted(rows: Rows, names: tuple[str, ...]) -> tuple[dict[int, float], Rows]:
    """Values that rows say alone, put into the other rows until none does any more."""
    values: dict[int, float] = {}
    rest = list(rows)
    while True:
        left: Rows = []
        changed = False
        for weights, value in rest:
            known = [w * values[k] for k, w in weights.items() if k in values]
            open_ = {k: w for k, w in weights.items() if k not in values}
            right = value - sum(known)
            if abs(right) <= CONSISTENT**1.5 * (abs(value) + sum(map(abs, known))):
                right = 0.0
            if not open_:
                size = abs(value) + sum(map(abs, known))
                if abs(right) > CONSISTENT * size:
                    _contradict(_in_words(weights, value, names))
                continue
            if len(open_) == 1:
                ((k, w),) = open_.items()
                values[k] = right / w + 0.0
                changed = True
                continue
            left.append((weights, value))
        rest = left
        if not changed:
            break
    final: Rows = []
    for weights, value in rest:
        open_ = {k: w for k, w in weights.items() if k not in values}
        final.append((open_, value - sum(w * values[k] for k, w in weights.items() if k in values)))
    return values, final


def _null_space(
    values: dict[int, float], rows: Rows, scale: Array, names: tuple[str, ...]
) -> tuple[Array, Array]:
    """A point on all equalities, and a basis of the directions along them."""
    p = scale.size
    origin = np.zeros(p)
    for k, value in values.items():
        origin[k] = value
    coupled = sorted({k for weights, _ in rows for k in weights})
    alone = [k for k in range(p) if k not in values and k not in coupled]
    columns = [np.eye(p)[:, k] * scale[k] for k in alone]
    if not rows:
        return origin, np.array(columns).T.reshape(p, len(columns))
    matrix = np.array([[weights.get(k, 0.0) for k in coupled] for weights, _ in rows])
    matrix = matrix * scale[coupled]
    sizes = np.linalg.norm(matrix, axis=1)
    matrix, right = matrix / sizes[:, None], np.array([value for _, value in rows]) / sizes
    u, s, vt = np.linalg.svd(matrix)
    rank = int(np.sum(s > RANK * s[0]))
    point = vt[:rank].T @ ((u[:, :rank].T @ right) / s[:rank])
    off = np.abs(matrix @ point - right)
    worst = int(np.argmax(off))
    if off[worst] > CONSISTENT * (1e-300 + np.abs(right).max()):
        weights, value = rows[worst]
        _contradict(_in_words(weights, value, names))
    point, basis = _as_written(matrix, right, point, vt[rank:].T, rank)
    origin[coupled] = point * scale[coupled]
    for column in basis.T:
        direction = np.zeros(p)
        direction[coupled] = column * scale[coupled]
        columns.append(direction)
    return origin, np.array(columns).T.reshape(p, len(columns))


def _as_written(
    matrix: Array, right: Array, point: Array, basis: Array, rank: int
) -> tuple[Array, Array]:
    """A point and directions that meet each equality to the rounding of its own terms.

    Those of a singular value decomposition are exact to the rounding of their largest entry, in
    which a light coefficient's share of an equality may be lost. The heaviest coefficients follow
    from the others instead; one that several equalities determine together does not move.
    """
    lines = np.sort(scipy.linalg.qr(matrix.T, mode="r", pivoting=True)[1][:rank])
    order = scipy.linalg.qr(matrix[lines], mode="r", pivoting=True)[1]
    heavy, light = order[:rank], order[rank:]
    inverse, others = np.linalg.inv(matrix[np.ix_(lines, heavy)]), matrix[np.ix_(lines, light)]
    effects = inverse @ others
    effects[np.abs(effects) <= RANK * (np.abs(inverse) @ np.abs(others))] = 0.0
    point, basis = point.copy(), basis.copy()
    point[heavy] = inverse @ right[lines] - effects @ point[light]
    basis[heavy] = -effects @ basis[light]
    return point, basis


def _bounds(structure: Structure, names: tuple[str, ...]) -> tuple[Array, Array]:
    low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for name, (least, most) in (structure.bounds or {}).items():
        low[names.index(name)] = -np.inf if least is None else least
        high[names.index(name)] = np.inf if most is None else most
    return low, high


def _in_words(weights: dict[int, float], value: float, names: tuple[str, ...]) -> str:
    terms = format_sum({names[k]: w for k, w in weights.items()})
    return f"{terms} = {value:g} together with the other equalities"


def _contradict(what: str) -> None:
    raise ContradictoryConstraintsError(
        f"found {what}; expected constraints that a stable model can meet; correct or drop one"
    )


def _refuse_contradictions(known: Knowledge, scale: Array) -> None:
    for k in np.flatnonzero(known.determined).tolist():
        value, name = known.origin[k], known.names[k]
        slack = CONSISTENT * (abs(value) + scale[k] * RANK)
        if not known.low[k] - slack <= value <= known.high[k] + slack:
            _contradict(f"{name} = {value:g} outside its bounds")
    if not known.n_free:
        raise ContradictoryConstraintsError(
            "found constraints that determine every coefficient; expected something to estimate; "
            "drop one"
        )


def _refuse_unstable(known: Knowledge, structure: Structure, scale: Array) -> None:
    determined, n = known.determined, known.n_poles
    for k in np.flatnonzero(determined).tolist():
        value, name = known.origin[k], known.names[k]
        if k < n - known.integrators and value <= 0.0:
            _contradict(f"{name} = {value:g}, which leaves a pole outside the left half plane")
    for k in range(n - known.integrators):
        if known.high[k] <= 0.0:
            _contradict(f"{known.names[k]} <= {known.high[k]:g}, which leaves no stable model")
    if known.integrators and structure.static_gain is not None:
        _contradict("a static gain together with an integrator, which has none")
    fixed = determined[known.moving]
    if fixed.size and fixed.all():
        roots = np.roots(np.concatenate([[1.0], known.origin[known.moving]]))
        if np.any(roots.real >= 0):
            _contradict(f"a denominator with a pole at {roots[np.argmax(roots.real)]:.3g}")
    if not _is_feasible(known, scale):
        _contradict("bounds that contradict the equalities or the stability of the poles")


def _is_feasible(known: Knowledge, scale: Array) -> bool:
    """Whether bounds, equalities and positive coefficients of the poles go together."""
    low, high = known.low.copy(), known.high.copy()
    moving = known.moving
    low[moving] = np.maximum(low[moving], 0.0)
    kept = ~known.determined
    rows = known.directions[kept] / scale[kept, None]
    origin = known.origin[kept] / scale[kept]
    top, bottom = high[kept] / scale[kept] - origin, low[kept] / scale[kept] - origin
    matrix = np.vstack([rows[np.isfinite(top)], -rows[np.isfinite(bottom)]])
    right = np.concatenate([top[np.isfinite(top)], -bottom[np.isfinite(bottom)]])
    if not right.size:
        return True
    sizes = np.maximum(np.abs(right), np.linalg.norm(matrix, axis=1))
    # slow to import, seldom needed
    from scipy.optimize import linprog

    answer = linprog(
        np.zeros(rows.shape[1]), matrix / sizes[:, None], right / sizes, bounds=(None, None)
    )
    return bool(answer.status == 0)
