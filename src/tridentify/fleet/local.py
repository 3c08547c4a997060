r"""What one unit says of coefficients near a point: a triangle, which adds up over units.

With ``J`` the derivatives of the outputs by the physical coefficients and ``r`` the residual at a
point ``theta``, both with the unit's own free responses, offsets and drifts projected off, the cost
near the point is ``|r - J (x - theta)|^2``. All that is needed of ``[J r]`` is the triangle of its
QR factorisation, ``(n + 1, n + 1)`` for each output, whatever the length of the records. Those of
two units, one below the other, have a triangle again that stands for both
(`numerics.least_squares`): this is how a fleet is added up, on any number of workers.

Filters, columns and derivatives are those of the output-error cost (`likelihood.cost`), at a point
that is given and not fitted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tridentify.errors import UnsupportedError
from tridentify.estimation.likelihood.cost import Point, bank_of
from tridentify.estimation.likelihood.curvature import physical_transform
from tridentify.estimation.likelihood.linear_fit import Linear
from tridentify.estimation.likelihood.setup.linear_columns import free_states, linear_blocks
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build, candidates
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.likelihood.setup.triangles import Triangles
from tridentify.estimation.methods.base import check
from tridentify.estimation.methods.capability import EVERYTHING
from tridentify.fleet.attempt import RecordJob
from tridentify.fleet.job import Item
from tridentify.models.regression import regress
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.least_squares import solve, triangle
from tridentify.record.formats.assemble import Wanted
from tridentify.record.record import Record
from tridentify.structure import AutoStructure, Structure


@dataclass(frozen=True, eq=False)
class Piece:
    """What some units say near a point, for one choice of nuisance terms.

    Attributes
    ----------
    triangles : (n_outputs, n + 1, n + 1) array
        Of ``[J r]``.
    counts : (n_outputs,) array
        Samples.
    own : (n_outputs,) array
        Nuisance terms that were projected off.
    shared : (n_outputs,) array
        Coefficients that an output pays for: its numerators, and its part of the denominators.
    power : (n_outputs,) array
        Sums of squares of the outputs about their means.
    """

    triangles: Array
    counts: Array
    own: Array
    shared: Array
    power: Array

    def __add__(self, other: Piece) -> Piece:
        both = [
            triangle(np.vstack(pair)) for pair in zip(self.triangles, other.triangles, strict=True)
        ]
        return Piece(
            np.array(both),
            self.counts + other.counts,
            self.own + other.own,
            self.shared,
            self.power + other.power,
        )

    @property
    def rss(self) -> Array:
        """(n_outputs,) residual sums of squares at the point."""
        return np.asarray(np.sum(self.triangles[:, :, -1] ** 2, axis=1))

    @property
    def scores(self) -> Array:
        """(n_outputs, n + 1, n) the columns of ``J``."""
        return self.triangles[:, :, :-1]

    def plain(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {name: getattr(self, name).tolist() for name in self.__dataclass_fields__}

    @classmethod
    def of(cls, given: dict[str, Any]) -> Piece:
        """What `plain` gave."""
        return cls(**{name: np.array(value) for name, value in given.items()})


@dataclass(frozen=True, eq=False)
class Local(RecordJob):
    """The job of a pass over the fleet: what every unit says near a point.

    Attributes
    ----------
    structure : Structure
    theta : tuple of float
        The point, where an item brings none of its own.
    choices : tuple of Nuisances
        Those that are asked about; all that the structure leaves open if there is none.
    wanted : Wanted
    """

    structure: Structure
    theta: tuple[float, ...]
    choices: tuple[Nuisances, ...]
    wanted: Wanted

    def run(self, item: Item, records: Sequence[Record]) -> dict[str, Any]:
        """The pieces by the label of their choice."""
        refuse_references(name for one in records for name in one.reference_names)
        theta = np.array(item.about or self.theta)
        found = local_pieces(records, self.structure, theta, self.choices)
        return {
            "names": list(self.structure.names(records[0].input_names, records[0].output_names)),
            "choices": [[c.initial_state, c.offset, c.drift] for c in found],
            "pieces": [piece.plain() for piece in found.values()],
        }


def summable(structure: Structure | AutoStructure) -> Structure:
    """A structure whose units can be added up here.

    Raises
    ------
    UnsupportedError
        Orders are left open, delays are to be estimated, or something is known of coefficients.
    """
    why = ""
    if isinstance(structure, AutoStructure):
        why = "orders that each record chooses"
    elif structure.delay == "free":
        why = "delays that are to be estimated"
    elif structure.constrained:
        why = "knowledge of coefficients"
    if why or isinstance(structure, AutoStructure):
        raise UnsupportedError(
            f"found {why}; expected a structure of stated orders and delays without constraints "
            "where a fleet is added up; state them, or leave --together and --pool out"
        )
    return structure


def refuse_references(names: Iterable[str]) -> None:
    """Refuse to add up records of a loop: what is added up is the open-loop likelihood.

    Parameters
    ----------
    names : iterable of str
        The references.

    Raises
    ------
    UnsupportedError
    """
    found = sorted(set(names))
    if found:
        raise UnsupportedError(
            f"found references ({', '.join(found)}); expected none where a fleet is added up, as "
            "that is done in open loop; leave --together and --pool out, or the references"
        )


def local_pieces(
    records: Sequence[Record],
    structure: Structure,
    theta: Array,
    choices: Sequence[Nuisances] = (),
) -> dict[Nuisances, Piece]:
    """What the records of one unit say near a point, for each choice of nuisance terms.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
    theta : (n,) array
        Physical coefficients in the order of `Structure.names`.
    choices : sequence of Nuisances, optional
        All that the structure leaves open for these records if there is none.

    Raises
    ------
    TridentifyError
        The records cannot be used.

    Examples
    --------
    >>> u = np.sign(np.sin(np.arange(50) ** 1.5))
    >>> record = Record(u, np.sin(np.arange(50)), dt=0.1, intersample="zoh")
    >>> structure = Structure(1, 0, offset=False, initial_state="rest")
    >>> (one,) = local_pieces([record], structure, np.array([1.0, 2.0])).values()
    >>> (both,) = local_pieces([record, record], structure, np.array([1.0, 2.0])).values()
    >>> bool(np.allclose((one + one).rss, both.rss)), one.triangles.shape
    (True, (1, 3, 3))
    """
    check(records, structure, "a fleet", EVERYTHING)
    found: dict[Nuisances, Piece] = {}
    for choice in choices or candidates(records, structure):
        found[choice] = _piece(build(records, structure, choice), theta)
    return found


def _piece(problem: Problem, theta: Array) -> Piece:
    point, residuals = _held(problem, theta)
    matrix, owner = point.jacobian()
    shared = _shared(point.width)
    transform = physical_transform(point, matrix.shape[1])[:, shared]
    local = np.setdiff1d(np.arange(matrix.shape[1]), shared)
    triangles, own = [], []
    for i, residual in enumerate(residuals):
        rows = matrix[owner == i]
        scores = np.linalg.solve(transform.T, rows[:, shared].T).T
        mine = rows[:, local]
        mine = mine[:, np.any(mine, axis=0)]
        basis = solve(mine, residual).basis
        both = np.column_stack([scores, residual])
        both = both - basis @ (basis.T @ both)
        found = triangle(both)
        triangles.append(np.pad(found, ((0, both.shape[1] - len(found)), (0, 0))))
        own.append(mine.shape[1])
    counts = point.counts
    taken = np.array(own, dtype=np.float64)
    return Piece(np.array(triangles), counts, taken, _shares(problem), problem.power * counts)


def _shares(problem: Problem) -> Array:
    """(n_outputs,) coefficients of each output, a shared denominator split evenly."""
    found = np.array([sum(m + 1 for m in row) for row in problem.n_zeros], dtype=np.float64)
    for group in problem.groups:
        outputs = sorted({i for i, _ in group.channels})
        found[outputs] += group.order / len(outputs)
    return found


def _shared(width: dict[object, slice]) -> Any:
    """Positions of ``alpha`` and ``b`` among all unknowns."""
    found = []
    for key, place in width.items():
        inner = key[1] if isinstance(key, tuple) else None
        if key == "a" or (isinstance(inner, tuple) and inner[0] == "b"):
            found += list(range(place.start, place.stop))
    return np.array(found, dtype=np.intp)


def _held(problem: Problem, theta: Array) -> tuple[Point, list[Array]]:
    """The point of given coefficients, with the best nuisance terms; residuals of each output."""
    found = bank_of(problem, poles_at(problem, theta), 2)
    bank, branches = found.cascade, found.branches
    regressions = tuple(regress(e, bank) for e in problem.experiments)
    rows = np.zeros((problem.n_outputs, problem.n_inputs, bank.order))
    direct = np.zeros((problem.n_outputs, problem.n_inputs))
    free = np.zeros((len(problem.experiments), problem.n_outputs, bank.order))
    triangles = Triangles.of(regressions, found)
    point = Point(problem, found.poles, triangles, Linear.given(rows, direct, free))
    betas = _numerators(point, theta)
    residuals = []
    for i in range(problem.n_outputs):
        for j, m in enumerate(problem.n_zeros[i]):
            branch = next(one for one in branches if one.channels[i, j])
            n, beta = branch.inner.order, betas[i, j]
            rows[i, j, branch.own] = beta[:n] @ branch.basis.rows[: min(m + 1, n)]
            direct[i, j] = beta[n] if m == n else 0.0
        parts, started = [], free_states(branches, i)
        for e, regression in enumerate(regressions):
            blocks = linear_blocks(problem, branches, regression, e, i)
            target = regression.targets[i]
            for j in range(problem.n_inputs):
                target = target - blocks.pop(("b", j)) @ betas[i, j]
            if blocks:
                mine = np.hstack(list(blocks.values()))
                terms = solve(mine, target).x
                target = target - mine @ terms
                if regression.layout.free:  # the first of the blocks that are left
                    free[e, i, started] = terms[: started.size]
            parts.append(target)
        residuals.append(np.concatenate(parts))
    return Point(problem, found.poles, triangles, Linear.given(rows, direct, free)), residuals


def _numerators(point: Point, theta: Array) -> dict[tuple[int, int], Array]:
    """Numerators of all channels, on the functions that their columns are made with."""
    width = point.width
    transform = physical_transform(point, max(place.stop for place in width.values()))
    return {
        (i, j): np.asarray(np.linalg.solve(transform[place, width[i, ("b", j)]], theta[place]))
        for (i, j), place in point.problem.places()[1].items()
    }


def poles_at(problem: Problem, theta: Array) -> Complex:
    """Poles of all denominators, where the records can see them."""
    parts = [np.roots(np.concatenate([[1.0], theta[place]])) for place in problem.places()[0]]
    return problem.admissible(np.concatenate(parts).astype(np.complex128))[0]
