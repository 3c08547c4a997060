"""Which physical parameters the coefficients determine, and which combinations of the others.

With ``L = d theta / d log|phi|`` (log-sensitivities, so that units have no part in it), a direction
``v`` with ``L v = 0`` moves the parameters without moving a coefficient. Where ``L`` has fewer
independent rows than there are parameters, not all of these are determined (Rothenberg 1971). The
rank at one point could be an accident, so ``L`` is looked at in several points around the estimate.
Two kinds of statement hold in all of them:

- *determined products*: ``phi_1^{w_1} phi_2^{w_2} ...`` is a function of the coefficients if ``w``
  is orthogonal to every null direction of every point. A unit vector ``w`` is a parameter that is
  determined by itself;
- *free scalings*: ``phi_i -> phi_i lambda^{v_i}`` changes no coefficient if ``L v = 0`` in every
  point.

Both are linear spaces; their echelon forms have small rational entries where they can be put into
words. What is determined beyond the products (sums, for instance) is counted; a combination that
the model declares is determined if its gradient, too, is orthogonal to every null direction.

References: T. J. Rothenberg, Econometrica 39(3), 577-591 (1971).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import CoefficientMapError
from tridentify.numerics.arrays import Array
from tridentify.physical.model import DIFFERENCE_STEP, PhysicalModel, differences
from tridentify.writing.layout import quotient

Powers = tuple[tuple[str, Fraction], ...]

POINTS = 8
"""Around the estimate: the rank at one or two of them may be an accident."""
BEST = 5
"""Points that decide: those where the null space is told apart best."""
SPREAD = 1.5
"""Of the points, in logarithms: factors up to 4.5."""
INDEPENDENT = 1e-9
"""Relative size of a row or singular value below which it is zero: differences have ten digits."""
LARGEST_DENOMINATOR = 12
"""Of an exponent that is put into words."""
EXACT = 1e-6
"""Sizes below it are zero: the points agree on a direction to some eight digits."""


@dataclass(frozen=True)
class Identifiability:
    """What the coefficients say about the parameters that are not known.

    Attributes
    ----------
    unknown : tuple of str
        The parameters that are not known.
    rank : int
        How many independent functions of them are determined.
    determined : tuple of str
        Parameters that are determined by themselves.
    products : tuple of tuple of (str, Fraction)
        Products of powers that are determined, of parameters that are not.
    scalings : tuple of tuple of (str, Fraction)
        Powers of any factor by which the parameters can be multiplied without any effect.
    combinations : tuple of str
        Names of the model's combinations that are determined.

    Examples
    --------
    >>> from tridentify.physical import rc_circuit
    >>> report = identifiability(rc_circuit())
    >>> report.rank, report.determined
    (1, ())
    >>> print("; ".join(report.lines()))
    only 1 of the 2 unknown parameters R, C can be determined; determined: R*C;
    no effect: R times k with C divided by k
    """

    unknown: tuple[str, ...]
    rank: int
    determined: tuple[str, ...]
    products: tuple[Powers, ...]
    scalings: tuple[Powers, ...]
    combinations: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether every parameter is determined by itself, at least locally."""
        return self.rank == len(self.unknown)

    def lines(self) -> tuple[str, ...]:
        """The report in words, a statement each; empty where everything is determined."""
        if self.complete:
            return ()
        rest = self.rank - len(self.determined)
        if self.determined:
            found = [
                f"{', '.join(self.determined)} can be determined, of the others only {rest} "
                f"combination{'' if rest == 1 else 's'}"
            ]
        else:
            found = [
                f"only {rest} of the {len(self.unknown)} unknown parameters "
                f"{', '.join(self.unknown)} can be determined"
            ]
        named = [product_text(p) for p in self.products]
        beyond = [name for name in self.combinations if name not in named]
        if named or beyond:
            found.append(f"determined: {', '.join(named + beyond)}")
        if rest > len(self.products) and not beyond:
            found.append("what is determined beyond that are no products of powers")
        return (*found, *(f"no effect: {scaling_text(s)}" for s in self.scalings))


def identifiability(
    model: PhysicalModel,
    values: Mapping[str, float] | None = None,
    known: Sequence[str] = (),
) -> Identifiability:
    """Ask which parameters, or combinations of them, the coefficients of a model determine.

    Parameters
    ----------
    model : PhysicalModel
    values : mapping of str to float, optional
        Where to look; the guesses if not given.
    known : sequence of str
        Parameters that are known and held.

    Returns
    -------
    Identifiability

    Raises
    ------
    CoefficientMapError
        The map gives no finite numbers in the neighbourhood of the values.

    Examples
    --------
    >>> from tridentify.physical import rc_circuit
    >>> identifiability(rc_circuit(), known=["R"]).determined
    ('C',)
    """
    centre = model.guess if values is None else np.array([values[n] for n in model.names])
    free = np.array([name not in known for name in model.names])
    unknown = tuple(name for name in model.names if name not in known)
    found = []
    for z in _points(model, centre, free):
        table = log_sensitivity(model, z)[:, free]
        if np.all(np.isfinite(table)):
            found.append((z, table, *_null_space(table)))
    if len(found) < BEST:
        raise CoefficientMapError(
            f"found no finite coefficients of {model.name} near its values; expected a map that is "
            "defined there; correct the map or the guesses"
        )
    # the rank of a generic point; of the points that have it, those that show it most clearly
    width = min(null.shape[1] for _, _, null, _ in found)
    generic = [one for one in found if one[2].shape[1] == width]
    generic = sorted(generic, key=lambda one: -one[3])[:BEST]
    points, nulls = [one[0] for one in generic], [one[2] for one in generic]
    moving = np.hstack(nulls)
    steady = _null_space(moving.T)[0] if width else np.eye(len(unknown))
    still = _null_space(np.vstack([one[1] for one in generic]))[0]
    determined = tuple(name for i, name in enumerate(unknown) if np.all(np.abs(moving[i]) < EXACT))
    products = _in_words(steady, unknown, leave=determined)
    return Identifiability(
        unknown=unknown,
        rank=len(unknown) - width,
        determined=determined,
        products=products,
        scalings=_in_words(still, unknown),
        combinations=_declared(model, points, nulls, free),
    )


def _points(model: PhysicalModel, centre: Array, free: NDArray[np.bool_]) -> list[Array]:
    """The centre, the guesses and places around both, the same in every run."""
    rng = np.random.default_rng(20)
    factors = np.exp(SPREAD * rng.uniform(-1.0, 1.0, (POINTS, centre.size)))
    start = np.where(centre == 0, model.guess, centre)
    guess = np.where(free, model.guess, start)
    around = [one * np.where(free, row, 1.0) for row in factors for one in (start, guess)]
    return [model.coordinates(one) for one in (start, guess, *around)]


def log_sensitivity(model: PhysicalModel, z: Array) -> Array:
    """(n_coefficients, n_parameters) derivatives by log|phi|, every row of length one."""
    values = model.values(z)
    with np.errstate(all="ignore"):
        table = model.jacobian(z) / model.slope(z) * values
    length = np.linalg.norm(table, axis=1, keepdims=True)
    # a coefficient that does not depend on the parameters leaves a row of rounding
    size = np.abs(model.theta_at(z))[:, None]
    return np.where(length <= INDEPENDENT * size, 0.0, table / np.where(length == 0, 1.0, length))


def _null_space(table: Array) -> tuple[Array, float]:
    """Orthonormal columns that the rows do not see, and the least of what they do see."""
    _, s, vt = np.linalg.svd(table, full_matrices=True)
    rank = int(np.sum(s > INDEPENDENT * max(s[0], INDEPENDENT))) if s.size else 0
    return np.asarray(vt[rank:].T), float(s[rank - 1] / s[0]) if rank else 1.0


def _in_words(
    space: Array, names: tuple[str, ...], leave: tuple[str, ...] = ()
) -> tuple[Powers, ...]:
    """Echelon form of a space, the rows with small rational entries; parameters to leave out."""
    keep = [i for i, name in enumerate(names) if name not in leave]
    rows = echelon(space[keep].T)
    found = []
    for row in rows:
        powers = [Fraction(float(x)).limit_denominator(LARGEST_DENOMINATOR) for x in row]
        exact = all(
            abs(float(p) - x) < 1e3 * EXACT for p, x in zip(powers, row.tolist(), strict=True)
        )
        if exact and any(powers):
            scale = int(np.lcm.reduce([p.denominator for p in powers]))
            pairs = zip(keep, powers, strict=True)
            found.append(tuple((names[i], p * scale) for i, p in pairs if p))
    return tuple(found)


def echelon(rows: Array) -> Array:
    """Reduced row echelon form, with the largest pivot of each column; zero rows left out."""
    table = np.array(rows, dtype=np.float64)
    at = 0
    for column in range(table.shape[1]):
        if at == table.shape[0]:
            break
        best = at + int(np.argmax(np.abs(table[at:, column])))
        if abs(table[best, column]) < EXACT:
            continue
        table[[at, best]] = table[[best, at]]
        table[at] /= table[at, column]
        others = [i for i in range(table.shape[0]) if i != at]
        table[others] -= np.outer(table[others, column], table[at])
        at += 1
    return table[:at]


def _declared(
    model: PhysicalModel, points: Sequence[Array], nulls: Sequence[Array], free: NDArray[np.bool_]
) -> tuple[str, ...]:
    """Names of the declared combinations whose gradients no null direction sees."""
    found = []
    for name in model.combinations:
        gradients = [combination_gradient(model, name, z)[free] for z in points]
        seen = [
            np.linalg.norm(g @ null) <= EXACT * np.linalg.norm(g)
            for g, null in zip(gradients, nulls, strict=True)
        ]
        if all(seen) and any(np.any(g) for g in gradients):
            found.append(name)
    return tuple(found)


def combination_gradient(model: PhysicalModel, name: str, z: Array) -> Array:
    """(n_parameters,) derivatives of a declared combination by log|phi|."""
    function = model.combinations[name]
    step = DIFFERENCE_STEP * np.where(model.positive, 1.0, np.maximum(np.abs(z), 1.0))
    slope = differences(lambda w: np.array([function(model.at(w))]), z, step)[0]
    return np.asarray(slope / model.slope(z) * model.values(z))


def product_text(powers: Powers) -> str:
    """A product of powers, such as ``R*C`` or ``K/(J*L)``."""
    return quotient(powers, "*")


def product_unit(powers: Powers, units: Mapping[str, str]) -> str:
    """Unit of a product of powers; empty where one of its factors has none.

    Examples
    --------
    >>> product_unit((("K", Fraction(1)), ("J", Fraction(-1))), {"K": "V s/rad", "J": "kg m^2"})
    '(V s/rad)/(kg m^2)'
    """
    own = [(units[name], power) for name, power in powers if units[name] != "-"]
    if not own or not all(unit for unit, _ in own):
        return ""
    bracketed = [(unit if unit.isalpha() else f"({unit})", power) for unit, power in own]
    return product_text(tuple(bracketed))


def scaling_text(powers: Powers) -> str:
    """What is multiplied and divided by a power of the same factor, in words."""

    def side(sign: int, verb: str) -> str:
        groups: dict[Fraction, list[str]] = {}
        for name, p in powers:
            if sign * p > 0:
                groups.setdefault(sign * p, []).append(name)
        return " with ".join(
            f"{', '.join(names)} {verb} {'k' if p == 1 else f'k^{p}'}"
            for p, names in sorted(groups.items())
        )

    up, down = side(1, "times"), side(-1, "divided by")
    return f"{up} with {down}" if up and down else up or down
