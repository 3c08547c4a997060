"""Whether a record contradicts what is said to be known: a test against the free maximum.

With ``C(theta)`` minus two log likelihood, ``theta_f`` its free minimum and ``theta_c`` the minimum
within the knowledge of ``C`` plus the penalty of the priors,

    T = C(theta_c) + sum_j ((theta_cj - mu_j) / s_j)^2 - C(theta_f)

is, near the maximum, ``d' (S + V)^{-1} d``: ``d`` what each of the ``q`` pieces of knowledge (an
equality, an active bound, a prior) misses at ``theta_f``, ``V`` its covariance there and ``S`` the
variances of the priors. With true knowledge, and values that the priors are true of, ``T`` is
chi-square of ``q`` degrees of freedom (Wilks 1938); an active bound has a smaller tail. The noise
variance being estimated, ``(exp(T / N) - 1) (N - k) / q`` is compared with F(q, N - k), which is
exact where the model is linear. A model of the noise is that of the free search in both fits, as
one of the constrained residual would take the contradiction for noise; where noise was to be taken
for white and the free residual is not, both are fitted anew with a model of that residual.

The free maximum must mean something for this: steps that settle, and poles that stand away from
zero by their standard errors; otherwise nothing is said. Nor is it where a noise model comes from
fewer than 150 samples, as its own errors then widen the tail.

References: S. S. Wilks, Ann. Math. Statist. 9(1) (1938) 60-62. G. A. F. Seber & C. J. Wild,
*Nonlinear Regression*, Wiley (1989), section 5.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import fdtrc

from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.knowledge.affine import Knowledge, known_of
from tridentify.estimation.knowledge.answer import freedom, spread_of
from tridentify.estimation.knowledge.descend import ConstrainedEnd, descend, is_exact, is_stable
from tridentify.estimation.likelihood.curvature import SINGULAR
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Patience
from tridentify.estimation.likelihood.noise.noise_model import PER_UNKNOWN
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import fit_autoregression, most_coefficients
from tridentify.numerics.whiteness import is_white
from tridentify.record.record import Record
from tridentify.structure import Structure

LEVEL = 1e-3
"""Probability with which true knowledge is called contradicted: one record in a thousand."""
LEVEL_SHORT = 1e-6
"""The same below `FEWEST_COLOURED` degrees of freedom, where coloured noise cannot be told from
white and makes the ratio larger."""
FAR = 3.3
"""Standard errors from which a single piece of knowledge is named: a Gaussian is farther off with
probability 1e-3, as `LEVEL`."""
FEWEST_FREE = 30.0
"""Degrees of freedom below which nothing is said: the ratio has its distribution only in long
records."""
FEWEST_COLOURED = 150.0
"""Degrees of freedom below which nothing is said where the noise has a model: its own errors widen
the tail."""
CLEAR = 0.3
"""Standard error over value of a coefficient of the free denominator above which the free maximum
says nothing: three standard errors from zero."""


class KnownPiece(NamedTuple):
    """One thing that is known: ``weights . theta = value``, with a standard deviation."""

    words: str
    label: str
    weights: Array
    value: float
    std: float = 0.0


def disagreement(
    problem: Problem,
    within: ConstrainedEnd,
    seeds: Sequence[Array],
    structure: Structure,
    record: Record,
    scale: Array,
    patience: Patience,
) -> tuple[Finding, ...]:
    """A caution where the record contradicts what is known.

    Parameters
    ----------
    problem : Problem
        The one ``within`` was found for.
    within : ConstrainedEnd
        The maximum within the knowledge.
    seeds : sequence of (p,) arrays
        Ends of a free search.
    structure : Structure
        With its knowledge.
    record : Record
        Names the channels.
    scale : (p,) array
        Sizes of the coefficients.
    patience : Patience
        With the steps to the free maximum.

    Returns
    -------
    tuple of Finding
        Empty where the knowledge stands, or the free maximum says nothing.
    """
    known = within.known
    if known.integrators or not seeds or not within.status.ok:
        return ()
    free = _free_maximum(problem, within, seeds, structure, record, scale, patience)
    if free is None:
        return ()
    noise = _colour(free)
    if noise:
        coloured = problem.whitened(noise)
        within = descend(coloured, known, within.fit.theta, patience)
        free = _free_maximum(coloured, within, [free.fit.theta], structure, record, scale, patience)
    if free is None or not within.status.ok:
        return ()
    pieces = _pieces(structure, known, within, record)
    own = freedom(free.fit, free.known)
    left, total = float(own.sum()), float(free.fit.counts.sum())
    rank = known.origin.size - known.n_free + int(np.isfinite(known.spread).sum())
    degrees = rank + int(within.active.sum())
    coloured_noise = any(a.size for a in free.fit.problem.noise)
    if left < (FEWEST_COLOURED if coloured_noise else FEWEST_FREE) or not (degrees and pieces):
        return ()
    spread = spread_of(free, free.fit.rss / own)
    if not _means_something(free, spread.cov, spread.condition):
        return ()
    fall = max(within.cost - free.cost, 0.0)
    chance = _chance(fall, total, left, degrees)
    # too few samples to tell coloured noise from white: only gross contradictions count
    if not chance < (LEVEL if left >= FEWEST_COLOURED else LEVEL_SHORT):
        return ()
    return (_told(pieces, free.fit.theta, spread.cov, known.n_poles, chance),)


def _chance(fall: float, total: float, left: float, degrees: int) -> float:
    """Probability of a larger fall of the cost where the knowledge is true."""
    ratio = math.expm1(min(fall / total, 500.0)) * left / degrees
    return float(fdtrc(degrees, left, ratio))


def _free_maximum(
    problem: Problem,
    within: ConstrainedEnd,
    seeds: Sequence[Array],
    structure: Structure,
    record: Record,
    scale: Array,
    patience: Patience,
) -> ConstrainedEnd | None:
    """The free minimum of the same cost, or None where there is none to compare with."""
    open_ = known_of(structure.unconstrained, record.input_names, record.output_names, scale)
    starts = [seeds[0], within.fit.theta]
    ends = [
        descend(problem, open_, theta, patience)
        for theta in starts
        if is_stable(theta[open_.moving])
    ]
    settled = [end for end in ends if end.status.ok and not is_exact(end.fit)]
    return min(settled, key=lambda end: end.cost) if settled else None


def _colour(free: ConstrainedEnd) -> tuple[Array, ...]:
    """A noise model where noise was taken for white and the free residual is not."""
    here = free.fit
    if any(a.size for a in here.problem.noise):
        return ()
    found = []
    for i in range(here.problem.n_outputs):
        series = [one[:, i] for one in here.over_time()]
        room = int(here.counts[i] - PER_UNKNOWN * here.theta.size)
        most = 0 if is_white(series) else most_coefficients(room)
        found.append(fit_autoregression(series, most, fewest=1) if most else np.zeros(0))
    return tuple(found) if any(a.size for a in found) else ()


def _means_something(free: ConstrainedEnd, cov: Array, condition: float) -> bool:
    """Whether the free poles are more than noise."""
    n = free.known.n_poles
    std = np.sqrt(np.diag(cov))[:n]
    return condition < SINGULAR and bool(np.all(std < CLEAR * np.abs(free.fit.theta[:n])))


def _pieces(
    structure: Structure, known: Knowledge, within: ConstrainedEnd, record: Record
) -> list[KnownPiece]:
    """What is known, piece by piece."""
    names, found = known.names, []

    def row(weights: Mapping[str, float]) -> Array:
        whole = np.zeros(len(names))
        for name, weight in weights.items():
            whole[names.index(name)] = weight
        return whole

    for name, value in (structure.fixed or {}).items():
        found.append(
            KnownPiece(f"fixed {name} = {value:.6g}", name, row({name: 1.0}), float(value))
        )
    for weights, value in structure.equalities or ():
        sum_ = " + ".join(f"{w:g} {name}" for name, w in weights.items())
        found.append(KnownPiece(f"equality {sum_} = {value:.6g}", sum_, row(weights), float(value)))
    for name, (mean, std) in (structure.priors or {}).items():
        if np.isfinite(known.spread[names.index(name)]):
            words = f"prior {name} = {mean:.6g} +/- {std:.3g}"
            found.append(KnownPiece(words, name, row({name: 1.0}), float(mean), float(std)))
    for k in np.flatnonzero(within.active).tolist():
        value = float(within.fit.theta[k])
        found.append(
            KnownPiece(f"bound {names[k]} = {value:.6g}", names[k], row({names[k]: 1}), value)
        )
    outputs, inputs = record.output_names, record.input_names
    gains = structure.gain_matrix(len(outputs), len(inputs))
    for output, line in zip(outputs, gains, strict=True):
        for source, gain in zip(inputs, line, strict=True):
            if gain is not None:
                own = f"[{output},{source}]" if len(outputs) * len(inputs) > 1 else ""
                words, label = f"static gain{own} = {gain:.6g}", f"b0{own} - {gain:.6g} a0"
                found.append(KnownPiece(words, label, row({f"b0{own}": 1.0, "a0": -gain}), 0.0))
    return found


def _told(
    pieces: list[KnownPiece], theta: Array, cov: Array, n_poles: int, chance: float
) -> Finding:
    """Name what disagrees: all pieces that are far off alone, or the farthest."""
    rated = []
    for piece in pieces:
        estimate = float(piece.weights @ theta)
        error = math.sqrt(max(float(piece.weights @ cov @ piece.weights), 0.0))
        far = abs(estimate - piece.value) / max(math.hypot(error, piece.std), 1e-300)
        said = f"{piece.label} = {estimate:.5g} +/- {error:.2g}"
        if piece.words.startswith("static gain"):
            # b0 / a0, with the error of b0 - gain a0
            at = n_poles + int(np.argmax(piece.weights[n_poles:]))
            static = float(theta[n_poles - 1])
            said = f"{theta[at] / static:.5g} +/- {error / abs(static):.2g}"
        rated.append((far, f"{piece.words} (free estimate {said}, {far:.1f} standard errors off)"))
    rated.sort(key=lambda one: -one[0])
    named = [words for far, words in rated if far > FAR] or [rated[0][1]]
    shown = "p < 1e-12" if chance < 1e-12 else f"p = {chance:.1g}"
    return Finding(
        "contradiction",
        "error",
        f"The record contradicts what is said to be known: {'; '.join(named)}; likelihood ratio "
        f"against the free fit: {shown}. The other coefficients are bent to make up for it.",
        "Check the values and their units, drop the wrong one, or widen the prior.",
    )
