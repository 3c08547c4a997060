r"""One model for all of a fleet: the joint estimate, from triangles that are added up.

The joint likelihood of all records, each with nuisance terms of its own, needs at any point only
the sum of what the units say there (`fleet.local`). Steps of Gauss and Newton, damped where they
fail (Levenberg & Marquardt), lead to its maximum: a pass over the fleet each, some six to ten in
all, and a few numbers from every worker. The maximum is that of `identify` with the list of all
records and ``ThreeModel(noise="white")``, one level of the noise for all; that one machine holds
all samples is not needed, nor that their nuisance terms are solved for at once. By default
`identify` gives experiments of different noise a level each (`likelihood.noise.noise_levels`).

Which nuisance terms there are is decided as there, by AICc, for all units alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tridentify.errors import ConvergenceError, IdentifiabilityError
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.fleet.local import Piece
from tridentify.fleet.passes import Sums
from tridentify.numerics.arrays import Array
from tridentify.numerics.information import aicc_price
from tridentify.writing.layout import format_table, format_value

MOST_PASSES = 40
"""Passes over the fleet; from the median of the units' own estimates six to ten are enough."""

ENDED = 1e-22
"""Fall of ``-2 log L`` that the next step promises at the end: 1e-11 standard errors."""

NEAR = 1e-6
"""The same from which steps are judged by what they leave to gain: differences of the cost itself
drown in its rounding."""

LEAST_DAMPING = 1e-3
"""Share of a squared column that is added to it first."""

Pass = Callable[[Array, tuple[Nuisances, ...]], Sums]


@dataclass(frozen=True, eq=False)
class Without:
    """The same without units that show no response to their input.

    Attributes
    ----------
    units : mapping of str to str
        Key -> what was said of a unit.
    theta, std : ndarray, shape (n,)
        Coefficients and their standard errors.
    """

    units: Mapping[str, str]
    theta: Array
    std: Array


@dataclass(frozen=True, eq=False)
class Together:
    """One model for all units.

    Attributes
    ----------
    names : tuple of str
    theta : ndarray, shape (n,)
        Coefficients.
    cov : ndarray, shape (n, n)
        Their covariance, for units that have one model.
    noise_variance : ndarray, shape (n_outputs,)
        [output units squared].
    fit : ndarray, shape (n_outputs,)
        NRMSE over all units [percent].
    nuisance : str
        What was estimated along for every unit.
    n_units, n_samples : int
    passes : int
        Over the fleet.
    left_out : mapping of str to str
        Key -> why a unit is not in it.
    without : Without, optional
        What comes without units that show no response, where there are some.
    """

    names: tuple[str, ...]
    theta: Array
    cov: Array
    noise_variance: Array
    fit: Array
    nuisance: str
    n_units: int
    n_samples: int
    passes: int
    left_out: Mapping[str, str]
    without: Without | None = None

    @property
    def std(self) -> Array:
        """(n,) standard errors."""
        return np.asarray(np.sqrt(np.diag(self.cov)))

    def table(self) -> list[tuple[str, ...]]:
        """Coefficient, value and standard error, for people."""
        return _rows(self.names, self.theta, self.std)

    def summary(self) -> str:
        """Text for people."""
        out = f", {len(self.left_out)} left out" if self.left_out else ""
        head = [
            f"one model for {self.n_units} units{out}: {self.n_samples} samples, "
            f"{self.passes} passes",
            f"{self.nuisance}; fit {', '.join(f'{f:.1f} %' for f in self.fit)}",
            "one noise level for all units",
        ]
        titles = ("coefficient", "value", "std error")
        told = [*head, "", *format_table(titles, self.table())]
        if self.without is not None:
            count = len(self.without.units)
            which = "a unit that shows" if count == 1 else f"{count} units that show"
            rows = _rows(self.names, self.without.theta, self.without.std)
            told += ["", f"without {which} no response:", *format_table(titles, rows)]
        return "\n".join(told)

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "names": list(self.names),
            "theta": self.theta.tolist(),
            "cov": self.cov.tolist(),
            "noise_variance": self.noise_variance.tolist(),
            "fit": self.fit.tolist(),
            "nuisance": self.nuisance,
            "units": self.n_units,
            "samples": self.n_samples,
            "passes": self.passes,
            "left_out": dict(self.left_out),
            "without": None
            if self.without is None
            else {
                "units": dict(self.without.units),
                "theta": self.without.theta.tolist(),
                "std": self.without.std.tolist(),
            },
        }


def _rows(names: Sequence[str], theta: Array, std: Array) -> list[tuple[str, ...]]:
    """Coefficient, value and standard error, for people."""
    pairs = zip(names, theta.tolist(), std.tolist(), strict=True)
    return [(name, format_value(v, s), f"{s:.2g}") for name, v, s in pairs]


def joint(look: Pass, start: Array) -> Together:
    """The joint estimate.

    Parameters
    ----------
    look : callable
        A pass over the fleet: the sums near coefficients, for some choices of nuisance terms (all
        that are open where none is named).
    start : (n,) array
        Coefficients to begin from.

    Raises
    ------
    ConvergenceError
        No maximum was reached.
    IdentifiabilityError
        All units together do not determine the coefficients.
    """
    passes, theta, choice = 0, start, None
    for _ in range(3):
        sums = look(theta, ())
        best = chosen_nuisance(sums)
        passes += 1
        if best == choice:
            break
        choice = best
        theta, steps = _descended(look, theta, choice, sums)
        passes += steps
    assert choice is not None
    final = look(theta, (choice,))
    return _answer(final, choice, theta, passes + 1)


def chosen_nuisance(sums: Sums) -> Nuisances:
    """The choice with the lowest AICc that one more step promises, of those open to all units."""
    most = max(sums.units.values())
    open_ = [choice for choice, units in sums.units.items() if units == most]
    return min(open_, key=lambda choice: _criterion(sums.pieces[choice]))


def _criterion(piece: Piece) -> float:
    n = float(piece.counts.sum())
    k = float(piece.own.sum() + piece.scores.shape[2] + len(piece.counts))
    return _objective(piece) - _promised(piece) + aicc_price(k, n)


def _objective(piece: Piece) -> float:
    """Minus two log likelihood, up to a constant."""
    return float(piece.counts @ np.log(np.maximum(piece.rss / piece.counts, 1e-300)))


def _weighted(piece: Piece) -> tuple[Array, Array]:
    """Scores and residual of all outputs over their noise's standard deviations."""
    weights = np.sqrt(piece.counts / np.maximum(piece.rss, 1e-300))
    rows = np.vstack([w * one for w, one in zip(weights, piece.triangles, strict=True)])
    return rows[:, :-1], rows[:, -1]


def _step(piece: Piece, damping: float) -> Array:
    scores, residual = _weighted(piece)
    size = np.sqrt(np.einsum("ij,ij->j", scores, scores))
    if not np.all(size > 0.0):
        raise IdentifiabilityError(
            "found coefficients that no unit of the fleet responds to; expected inputs that move "
            "the system; use fewer poles or zeros"
        )
    below = np.sqrt(damping) * np.eye(size.size)
    matrix = np.vstack([scores / size, below])
    target = np.concatenate([residual, np.zeros(size.size)])
    return np.asarray(np.linalg.lstsq(matrix, target, rcond=None)[0] / size)


def _promised(piece: Piece) -> float:
    """Fall of `_objective` that an undamped step promises."""
    moved = _weighted(piece)[0] @ _step(piece, 0.0)
    n = float(piece.counts.sum())
    return -n * float(np.log1p(-min(float(moved @ moved) / n, 1.0 - 1e-12)))


def _descended(look: Pass, theta: Array, choice: Nuisances, sums: Sums) -> tuple[Array, int]:
    """Down to the minimum for one choice of nuisance terms; passes that it took."""
    piece, damping, growth = sums.pieces[choice], 0.0, 2.0
    gone = set(sums.left_out)
    for number in range(MOST_PASSES):
        promised = _promised(piece)
        if promised < ENDED:
            return theta, number
        trial = theta + _step(piece, damping)
        found = look(trial, (choice,))
        if set(found.left_out) != gone:  # one more was lost on the way: costs do not compare
            gone = set(found.left_out)
            piece = look(theta, (choice,)).pieces[choice]
        other = found.pieces[choice]
        near = promised < NEAR
        if _promised(other) < promised if near else _objective(other) < _objective(piece):
            theta, piece = trial, other
            damping, growth = (damping / 3.0 if damping > 1e-6 else 0.0), 2.0
        elif near:  # down to rounding
            return theta, number + 1
        else:
            damping = max(damping * growth, LEAST_DAMPING)
            growth *= 2.0
    raise ConvergenceError(
        f"found no minimum within {MOST_PASSES} passes over the fleet; expected one from the "
        "median of the units' estimates; use fewer poles or zeros, or look at the units first"
    )


def _answer(sums: Sums, choice: Nuisances, theta: Array, passes: int) -> Together:
    piece = sums.pieces[choice]
    freedom = np.maximum(piece.counts - piece.own - piece.shared, 1.0)
    variance = piece.rss / freedom
    rows = np.vstack([one / np.sqrt(v) for one, v in zip(piece.scores, variance, strict=True)])
    size = np.sqrt(np.einsum("ij,ij->j", rows, rows))
    _, s, vt = np.linalg.svd(rows / size, full_matrices=False)
    if not s[-1] > 1e-12 * s[0]:
        raise IdentifiabilityError(
            "found coefficients that the fleet cannot tell apart; expected fewer poles or zeros, "
            "or richer inputs; lower the orders"
        )
    root = (vt.T / s) / size[:, None]
    return Together(
        sums.names,
        theta,
        root @ root.T,
        variance,
        100.0 * (1.0 - np.sqrt(piece.rss / np.maximum(piece.power, 1e-300))),
        choice.label,
        sums.units[choice],
        round(float(piece.counts.sum())),
        passes,
        dict(sums.left_out),
    )
