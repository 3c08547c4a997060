"""Likelihood and reference prior over many denominators at once.

*Likelihood.* At a denominator everything else is linear (`likelihood.cost`). With a flat
prior on the fitted output, not on its coefficients (Zellner 1986 with ``g -> inf``), and
``1 / sigma`` on the noise level, ``b``, nuisance terms and ``sigma`` integrate out to

    p(y | a) ~ prod_i RSS_i^{-(N_i - k_i) / 2},

``k_i`` the number of linear unknowns of output ``i``.

*Prior.* Denominators that cannot be told apart by this experiment must not be counted as many:
all poles far beyond the sampling give the same static gain, all poles far below the record's
length the same power of ``t``. The prior is therefore uniform over distinguishable *shapes* of the
output: the volume element of the model outputs, normalised to unit size and seen through the
projection that removes ``b`` and the nuisance terms,

    pi(a) da ~ sqrt(det(S' S)) / |y_0|^n  da,   S = (I - Q Q') d y_0 / d a,

Jeffreys' prior with the signal's size factored out (Jeffreys 1961; Kass 1989; Bernardo 1979). It
does not depend on the coordinates, it adapts to the input, the record's length and the sampling,
and it vanishes where the record is blind. One statement is added: whoever recorded for ``T`` at
``dt`` thought the slowest pole faster than about ``1 / T`` and the fastest one slower than about
``1.5 / dt``; beyond, the prior falls off as the eighth power.

With the scores ``- X y_0`` on the orthonormal functions ``X`` of the poles
(`likelihood.cost`) and coordinates ``phi`` (`posterior.many_cascades`), ``pi(phi) = vol(alpha)
|da/dphi| / |da/dalpha|``, where ``|da/dalpha|`` is the determinant of the numerators of ``X``.

Everything is computed for a batch of denominators at once, exactly as for one; samples that are
missing or coloured are treated as in `regression`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.posterior.many_cascades import (
    Sections,
    degree_bases,
    filtered_rows,
    numerator_tables,
)
from tridentify.models.regression import Experiment
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import Whitener, gains
from tridentify.numerics.sampled import Sampled, States

FASTEST = 1.5
"""Rate times sampling interval beyond which the prior falls off: four samples a period, a time
constant of two thirds of a sample. A statement on whoever chose the sampling, as the next two:
halved or doubled, each moves most posterior means by more than a tenth of a standard error. With
0.7, nine samples a period, a lag of a sample or so was denied beside a slower pair: of 60 samples
of such plants (three poles, 12 dB) the intervals of 95 % held 82 % for 93 %, at the same RMSE."""
SLOWEST = 1.0
"""Rate times length of the record below which the prior falls off: such a pole decays by less than
a factor of e within it."""
ROLL_OFF = 2.0
"""Twice the fourth power: the prior falls as the eighth beyond the band, so that its tail holds
nothing even for several poles."""
LARGEST_BLOCK = 6_000_000
"""Numbers in the largest array of a batch: 48 MB."""
TINY = 1e-280
"""Keeps the logarithms of a shape of nothing finite: above the smallest double by room for a
product."""


@dataclass(frozen=True, eq=False)
class Linear:
    """The linear fit of one output at many denominators.

    Attributes
    ----------
    orthonormal, triangle : (s, r, k), (s, k, k) arrays
        QR factors of the columns.
    projection : (s, k) array
        The output on ``orthonormal``.
    residual : (s, r) array
    rows : (s, n_inputs, n) array
        ``b / a`` of each channel on the cascade, direct terms apart.
    direct : (s, n_inputs) array
    """

    orthonormal: Array
    triangle: Array
    projection: Array
    residual: Array
    rows: Array
    direct: Array


class Surface(NamedTuple):
    """A batch of denominators.

    Attributes
    ----------
    log_density : (s,) array
        Log posterior density in the coordinates ``phi``, up to a constant.
    denominators : (s, n) array
        ``a_{n-1} .. a_0``, in units of one over the sampling interval.
    numerators : (s, n_b) array
        Least-squares ``b`` of all channels, in the order of `Structure.names`, same units.
    roots : (s, n_b, n_b) array
        ``r r'`` is the covariance of ``numerators``.
    scale : (s,) array
        Geometric mean of the pole magnitudes.
    """

    log_density: Array
    denominators: Array
    numerators: Array
    roots: Array
    scale: Array

    @classmethod
    def joined(cls, parts: list[Surface]) -> Surface:
        """Several batches as one."""
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def unit_of(problem: Problem) -> float:
    """The sampling interval that rates are measured in [s]."""
    return min(e.dt for e in problem.experiments)


def surface(problem: Problem, phi: Array) -> Surface:
    """Posterior density and linear fits at many denominators.

    Parameters
    ----------
    problem : Problem
    phi : (s, n) array
        Coordinates (`posterior.many_cascades`), rates times `unit_of`.
    """
    n = problem.n_poles
    longest = max(e.n_samples for e in problem.experiments)
    columns = 2 * n * (problem.n_inputs + 1) + problem.n_inputs + problem.n_outputs + 2
    size = max(1, LARGEST_BLOCK // (longest * columns))
    parts = [_surface(problem, phi[k : k + size]) for k in range(0, phi.shape[0], size)]
    return parts[0] if len(parts) == 1 else Surface.joined(parts)


def _surface(problem: Problem, phi: Array) -> Surface:
    n = problem.n_poles
    sections = Sections.of(phi, n)
    bank_a, bank_b = sections.cascade(2)
    a, b = bank_a[:, :n, :n], bank_b[:, :n]
    polynomials = sections.polynomials()
    tables = numerator_tables(a, b, polynomials)
    unit = unit_of(problem)
    data = [_triangles(e, bank_a, bank_b, n, unit) for e in problem.experiments]
    bases = degree_bases(a, b)
    likelihood = np.zeros(phi.shape[0])
    energy = np.zeros(phi.shape[0])
    scores, numerators, roots = [], [], []
    for i in range(problem.n_outputs):
        blocks = [(r[:, :, :-1], r[:, :, -1]) for r in (own[i] for own in data)]
        signals = np.concatenate([block[0] for block in blocks], axis=1)
        target = np.concatenate([block[1] for block in blocks], axis=1)
        fit = _fit(problem, i, signals, target, bases)
        count = sum(int(np.isfinite(e.y[:, i]).sum()) for e in problem.experiments)
        terms = sum(n * e.free + e.offset + e.drift for e in problem.experiments)
        freedom = max(count - terms - fit.projection.shape[1], 1)
        cost = np.einsum("sr,sr->s", fit.residual, fit.residual)
        cost = cost + 1e-30 * count * problem.size[i]
        likelihood -= 0.5 * freedom * np.log(cost)
        weight = freedom / cost
        energy += weight * np.einsum("sk,sk->s", fit.projection, fit.projection)
        scores.append(
            np.sqrt(weight)[:, None, None] * _scores(problem, signals, fit, bank_a, bank_b)
        )
        found, root = _physical(problem, i, fit, bases, tables, polynomials)
        numerators.append(found)
        roots.append(root * np.sqrt(cost / freedom)[:, None, None])
    lengths = np.abs(np.einsum("skk->sk", np.linalg.qr(np.concatenate(scores, axis=1), mode="r")))
    shape = np.log(np.maximum(lengths, TINY)).sum(axis=1) - 0.5 * n * np.log(energy + TINY)
    volume = shape + sections.log_jacobian() - np.linalg.slogdet(tables)[1]
    volume -= sections.log_multiplicity()
    return Surface(
        likelihood + volume + _band(problem, sections),
        polynomials[:, 1:],
        np.concatenate(numerators, axis=1),
        _block_diagonal(roots),
        sections.geometric_mean(),
    )


def _band(problem: Problem, sections: Sections) -> Array:
    """Log of the roll-off outside the recorded band."""
    length = max(e.duration for e in problem.experiments) / unit_of(problem)
    size = np.abs(sections.roots())
    fast = np.log1p((size.max(axis=1) / FASTEST) ** 4)
    slow = np.log1p((SLOWEST / (size.min(axis=1) * length)) ** 4)
    return np.asarray(-ROLL_OFF * (fast + slow))


def _block_diagonal(blocks: list[Array]) -> Array:
    size = sum(block.shape[1] for block in blocks)
    whole = np.zeros((blocks[0].shape[0], size, size))
    at = 0
    for block in blocks:
        width = block.shape[1]
        whole[:, at : at + width, at : at + width] = block
        at += width
    return whole


def _triangles(e: Experiment, bank_a: Array, bank_b: Array, n: int, unit: float) -> list[Array]:
    """Per output the triangle (s, r, columns) of [states | inputs | y], nuisance terms removed.

    The nuisance columns come first in the factorisation, so what stands below their rows is
    already orthogonal to them.
    """
    found: dict[int, Array] = {}
    for signal in dict.fromkeys(e.sampled):
        held = e.intersample != "band-limited"
        outputs = [i for i, own in enumerate(e.sampled) if own is signal]
        if signal.t is None and not any(signal.delays) and held:
            for i in outputs:
                found[i] = _uniform(e, i, signal, bank_a, bank_b, n, e.dt / unit)
            continue
        columns, nuisance = _filled(e, signal, bank_a, bank_b, n, unit)
        for i in outputs:
            found[i] = _reduced(e, i, columns, nuisance)
    return [found[i] for i in range(e.y.shape[1])]


def _uniform(
    e: Experiment, output: int, signal: Sampled, bank_a: Array, bank_b: Array, n: int, dt: float
) -> Array:
    """The triangle of one output on uniform time, in machine code."""
    from tridentify.estimation.posterior.compiled_triangles import reduced_banks

    n_samples, n_inputs = e.u.shape
    seen = np.isfinite(e.y[:, output])
    common = [np.ones(n_samples)] * e.offset + [*e.drifts]
    before = np.array(common).reshape(len(common), n_samples)
    last = np.where(seen, e.y[:, output], 0.0)
    after = np.ascontiguousarray(np.vstack([signal.direct.T, last]))
    noise = np.array(e.noise[output]) if e.noise else np.zeros(0)
    gain, scale = np.full((n_samples, 1), -1.0), np.ones(n_samples)
    if noise.size:
        gain, scale, _ = gains(noise, seen)
    impulse = n * e.free
    nuisance = impulse + len(common)
    width = nuisance + n_inputs * (bank_b.shape[1] + 1) + 1
    found = np.zeros((bank_b.shape[0], width, width))
    reduced_banks(
        np.ascontiguousarray(bank_a), np.ascontiguousarray(bank_b), impulse, dt,
        e.intersample == "foh", np.array(e.u.T, order="C"), before, after, seen, noise, gain,
        scale, found,
    )  # fmt: skip
    return found[:, nuisance:, nuisance:]


def _filled(
    e: Experiment, signal: Sampled, bank_a: Array, bank_b: Array, n: int, unit: float
) -> tuple[Array, int]:
    """Columns (s, columns, n_samples), the last one left empty, and how many are nuisance terms."""
    count, q = bank_b.shape
    n_samples, n_inputs = e.u.shape
    nuisance = n * e.free + e.offset + e.drift
    width = nuisance + n_inputs * (q + 1) + 1
    columns = np.zeros((count, width, n_samples))
    at = n * e.free
    if e.offset:
        columns[:, at] = 1.0
        at += 1
    columns[:, at : at + e.drift] = e.drifts
    _fill_any(columns, e, signal.in_units(unit), bank_a, bank_b, n, nuisance)
    columns[:, nuisance + n_inputs * q : width - 1] = signal.direct.T
    return columns, nuisance


def _fill_any(
    columns: Array,
    e: Experiment,
    signal: Sampled,
    bank_a: Array,
    bank_b: Array,
    n: int,
    nuisance: int,
) -> None:
    """States of many banks, bank by bank, for any instants and delays."""
    for s in range(bank_b.shape[0]):
        states = States(signal, bank_a[s], bank_b[s], upper=1)
        states.advance(0, e.n_samples, columns[s, nuisance:])
        if e.free:
            inner = States(signal, bank_a[s, :n, :n], bank_b[s, :n], upper=1)
            inner.impulse(e.start).advance(0, e.n_samples, columns[s])


def _reduced(e: Experiment, output: int, columns: Array, nuisance: int) -> Array:
    seen = np.isfinite(e.y[:, output])
    columns[:, -1] = np.where(seen, e.y[:, output], 0.0)
    noise = e.noise[output] if e.noise else np.zeros(0)
    if noise.size:
        flat = columns.reshape(-1, columns.shape[2])
        white = np.empty_like(flat)
        Whitener(noise, flat.shape[0]).apply(flat, seen, white)
        rows = white.reshape(columns.shape)
    else:
        rows = columns if seen.all() else columns * seen
    triangle = np.asarray(np.linalg.qr(rows.transpose(0, 2, 1), mode="r"))
    return triangle[:, nuisance:, nuisance:]


def _fit(problem: Problem, output: int, signals: Array, target: Array, bases: Array) -> Linear:
    """Least squares on the numerators of all channels."""
    n, q = problem.n_poles, 2 * problem.n_poles
    zeros = problem.n_zeros[output]
    blocks = []
    for j, m in enumerate(zeros):
        basis = bases[:, :, n - min(m + 1, n) :]
        blocks.append(signals[:, :, j * q : j * q + n] @ basis)
        if m == n:
            at = problem.n_inputs * q + j
            blocks.append(signals[:, :, at : at + 1])
    orthonormal, triangle = np.linalg.qr(np.concatenate(blocks, axis=2))
    projection = np.einsum("srk,sr->sk", orthonormal, target)
    residual = target - np.einsum("srk,sk->sr", orthonormal, projection)
    beta = np.linalg.solve(_regular(triangle), projection[:, :, None])[:, :, 0]
    rows = np.zeros((target.shape[0], problem.n_inputs, n))
    direct = np.zeros((target.shape[0], problem.n_inputs))
    at = 0
    for j, m in enumerate(zeros):
        k = min(m + 1, n)
        rows[:, j] = np.einsum("snk,sk->sn", bases[:, :, n - k :], beta[:, at : at + k])
        at += k
        if m == n:
            direct[:, j] = beta[:, at]
            at += 1
    return Linear(orthonormal, triangle, projection, residual, rows, direct)


def _regular(triangle: Array) -> Array:
    """The triangle with vanishing diagonal entries lifted to rounding."""
    diagonal = np.abs(np.einsum("skk->sk", triangle))
    floor = 1e-14 * diagonal.max(axis=1, keepdims=True) + TINY
    lift = np.where(diagonal < floor, floor, 0.0)
    return triangle + lift[:, :, None] * np.eye(triangle.shape[2])


def _scores(problem: Problem, signals: Array, fit: Linear, bank_a: Array, bank_b: Array) -> Array:
    """(s, r, n) ``X y_0``, projected off the linear columns."""
    n, q = problem.n_poles, 2 * problem.n_poles
    rows = fit.direct[:, :, None] * bank_b[:, None]
    rows[:, :, :n] += fit.rows
    answers = filtered_rows(bank_a[:, :n, :n], bank_b[:, :n], bank_a, rows)
    found = np.zeros((*signals.shape[:2], n))
    for j in range(problem.n_inputs):
        found += signals[:, :, j * q : (j + 1) * q] @ answers[:, j].transpose(0, 2, 1)
    inside = fit.orthonormal.transpose(0, 2, 1) @ found
    return np.asarray(found - fit.orthonormal @ inside)


def _physical(
    problem: Problem, output: int, fit: Linear, bases: Array, tables: Array, polynomials: Array
) -> tuple[Array, Array]:
    """``b`` of one output's channels, and a root of its covariance over the noise variance."""
    n = problem.n_poles
    zeros = problem.n_zeros[output]
    width = fit.triangle.shape[1]
    transform = np.zeros((fit.rows.shape[0], sum(m + 1 for m in zeros), width))
    row = column = 0
    for m in zeros:
        k = min(m + 1, n)
        proper = np.einsum("snk,snp->spk", bases[:, :, n - k :], tables)
        transform[:, row + (m == n) : row + m + 1, column : column + k] = proper[:, n - k :]
        column += k
        if m == n:
            transform[:, row : row + m + 1, column] = polynomials
            column += 1
        row += m + 1
    inverse = np.linalg.inv(_regular(fit.triangle))
    root = transform @ inverse
    return np.einsum("sbk,sk->sb", root, fit.projection), root
