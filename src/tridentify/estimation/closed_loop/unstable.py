"""Steps 1, 2 and 4 for a plant that may be unstable or integrate, from what a reference drives.

*Step 1* is `driven`: ``u_M`` and ``y_M`` are bounded, whatever the plant, as the loop is stable.

*Step 2* is the equation error of the two. With a stable ``c(p)``

    (p^n / c) y_M = - sum a_k (p^k / c) y_M + sum b_k (p^k / c) u_M

is linear in the coefficients and carries no noise; its poles are taken as they come. ``c`` is
``(p + g)^n`` with the rate ``g`` of the operators and its neighbours, then the mirrored ``a``.

*Step 4* is the root of ``sum Z e = 0`` with the errors ``e`` of the mirrored predictor and their
driven derivatives ``Z`` (`predictor`): steps ``(Z' Z)^{-1} Z' e``, halved while they do not bring
the driven part of ``e`` down. Start and offset are columns beside ``Z``; where the noise is
coloured all of them are whitened. ``sigma^2 (Z' Z)^{-1}`` is the covariance
(`methods.reference`, eq. 2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.estimation.answer.assemble import Request, Solved, assemble
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.parameter import Nuisance
from tridentify.estimation.answer.trace import Status, Trace
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.predictor import (
    Plant,
    Predictor,
    Signals,
    driven_signals,
    recorded,
    slopes,
)
from tridentify.models.regression import Experiment, response_of
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import fit_autoregression, most_coefficients, whiten
from tridentify.numerics.information import aicc_price
from tridentify.numerics.realization import cascade, denominator, monomials, sort_poles
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

BY_PREDICTOR = "reference route by the mirrored predictor"
"""How the trace begins to say it."""
SHARES = (1.0, 0.3, 3.0, 0.1)
"""Rates of the first filters over that of the operators, which is one of the loop's."""
START_PASSES = 6
"""Of Step 2 on the mirrored denominator; they settle in three or not at all."""
MOST_STEPS = 60
"""Of Step 4; five to ten are usual."""
STILL = 1e-4
"""Standard errors that the coefficients move by in the last step."""
AS_WELL = 1e4
"""Condition of the derivatives as the instruments see them, over that of the driven ones."""
SCATTER = 4.0
"""Times its expectation that the driven part of the errors may be without telling of a wrong plant:
a root of as many equations as unknowns does not minimise it."""
HALVINGS = 8
"""Of a step that does not lower the driven error: 1/256 of it is none."""
MOST_NOISE_ROUNDS = 4
"""Fits of the noise model and of the coefficients in turn."""


@dataclass(frozen=True, eq=False)
class Found:
    """Where Step 4 ended.

    Attributes
    ----------
    plant : Plant
    cov : (n, n) array
        Of its coefficients.
    errors : tuple of (n_samples,) arrays
        ``e`` less start and offset, per experiment; ``nan`` where nothing was recorded.
    noise : (p,) array
        Autoregressive coefficients of ``e``; empty where it is white.
    variance : float
        Of the innovations of ``e``.
    amplification : float
        Of the output's noise in ``e``, in standard deviations.
    nuisance : tuple of arrays
        Per experiment: initial state, offset [output units].
    freedom : int
        Samples less unknowns.
    condition : float
        Of ``Z`` with unit columns.
    steps : int
    moved : float
        By the last step [standard errors].
    """

    plant: Plant
    cov: Array
    errors: tuple[Array, ...]
    noise: Array
    variance: float
    amplification: float
    nuisance: tuple[Array, ...]
    freedom: int
    condition: float
    steps: int
    moved: float

    @property
    def still(self) -> bool:
        """Whether it is a root."""
        return self.moved <= STILL

    def driven_share(self, loops: Sequence[Loop]) -> float:
        """Mean square of what the references explain of the errors, over its expectation."""
        total, columns = 0.0, 0
        for loop, left in zip(loops, self.errors, strict=True):
            seen = np.isfinite(left)
            q = np.linalg.qr(loop.fitted.columns[seen])[0]
            total += float(np.sum((q.T @ left[seen]) ** 2)) / float(np.mean(left[seen] ** 2))
            columns += q.shape[1]
        return total / columns


def starting_plants(loops: Sequence[Loop], n: int, zeros: Sequence[int]) -> list[Plant]:
    """Step 2 from several filters.

    Parameters
    ----------
    loops : sequence of Loop
    n : int
        Number of poles.
    zeros : sequence of int
        Of every input.
    """
    found = []
    for share in SHARES:
        poles = np.full(n, -share * loops[0].fitted.rate, dtype=np.complex128)
        try:
            for _ in range(START_PASSES):
                plant = _equation_error(loops, poles, zeros)
                poles = _mirrored(plant, loops)
        except (np.linalg.LinAlgError, ValueError):
            continue
        if np.all(np.isfinite(plant.theta)):
            found.append(plant)
    sampled = _difference_equation(loops, n, zeros)
    return found if sampled is None else [*found, sampled]


def _difference_equation(loops: Sequence[Loop], n: int, zeros: Sequence[int]) -> Plant | None:
    """Step 2 in discrete time: the same equation between samples, by instrumental variables.

    ``y_k = - sum alpha_i y_{k-i} + sum beta_i u_{k-i}`` is exact for a held input, and needs
    nothing of what lies between the samples; its instruments are the same lags of the driven
    signals. The numerators follow from the poles, as ``e`` is linear in them.
    """
    rows, mates, target = [], [], []
    for loop in loops:
        part, y = loop.fitted, recorded(loop).y
        signals = np.column_stack([y, loop.record.u])
        free = np.column_stack([part.outputs[:, 0] - part.outputs[0, 0], part.inputs])
        lags = [range(1, n + 1), *(range(n + 1) for _ in zeros)]
        rows.append(_lagged(signals, lags, n))
        mates.append(_lagged(free, lags, n))
        target.append(y[n:])
    phi, z = np.vstack(rows), np.vstack(mates)
    norms = np.linalg.norm(z, axis=0) + 1e-300
    alpha = -np.linalg.lstsq(
        (z / norms).T @ phi, (z / norms).T @ np.concatenate(target), rcond=1e-12
    )[0][:n]
    roots = np.roots(np.concatenate([[1.0], alpha]))
    if not np.isfinite(roots).all() or np.any((roots.imag == 0) & (roots.real <= 0)):
        return None
    step = float(loops[0].record.dt or 0.0)
    a = np.real(np.poly(np.log(roots) / step))[1:]
    plant = Plant(a, tuple(np.zeros(m + 1) for m in zeros))
    linear = _linear(loops, plant, np.zeros(0))
    if not linear.is_finite:
        return None
    matrix = np.hstack([linear.slopes[:, n:], linear.rest])
    norms = np.linalg.norm(matrix, axis=0) + 1e-300
    weights = np.linalg.lstsq(matrix / norms, linear.errors, rcond=1e-12)[0] / norms
    return plant.with_theta(np.concatenate([a, weights[: plant.theta.size - n]]))


def _lagged(signals: Array, lags: Sequence[range], most: int) -> Array:
    """(n_samples - most, k) lags of the signals, and a constant."""
    columns = [
        signals[most - lag : len(signals) - lag, j] for j, own in enumerate(lags) for lag in own
    ]
    return np.column_stack([*columns, np.ones(len(signals) - most)])


def _mirrored(plant: Plant, loops: Sequence[Loop]) -> Complex:
    step = float(loops[0].record.dt or 0.0)
    return sort_poles(Predictor(plant, step, slowest(loops)).mirrored)


def slowest(loops: Sequence[Loop]) -> float:
    """Slowest decay of a predictor: once within the shortest record [rad/s]."""
    return 1.0 / min(loop.record.duration for loop in loops)


def _equation_error(loops: Sequence[Loop], poles: Complex, zeros: Sequence[int]) -> Plant:
    bank, n = cascade(poles), len(poles)
    c = denominator(poles)
    powers = monomials(bank, n)
    rows, target = [], []
    for loop in loops:
        part = loop.fitted
        held = part.means(1, slice(0, loop.record.n_inputs + 1))
        held = held - np.column_stack([part.inputs, part.outputs])[0]
        width = held.shape[1]
        experiment = Experiment(
            np.ascontiguousarray(held), np.zeros((len(held), 1)), float(loop.record.dt or 0.0),
            "zoh", free=True, offset=False, drift=False,
        )  # fmt: skip
        q = n * (width + 1)
        pick = np.zeros((q, q + width + 2))
        pick[:, :q] = np.eye(q)
        states = response_of(experiment, bank, pick[:, : q + width], outputs=[0] * q)
        start, own = states[:, :n], states[:, n:].reshape(len(held), width, n)
        filtered = np.einsum("kjs,ps->kjp", own, powers)
        columns = [-filtered[:, -1, ::-1]]
        for j, m in enumerate(zeros):
            block = filtered[:, j, : min(m + 1, n)][:, ::-1]
            if m == n:
                block = np.column_stack([held[:, j], block])
                block[:, 0] -= filtered[:, j, :] @ c[:0:-1]
            columns.append(block)
        y = part.outputs[:, 0] - part.outputs[0, 0]
        rows.append(np.hstack([*columns, start, np.ones((len(y), 1))]))
        target.append(y - filtered[:, -1, :] @ c[:0:-1])
    n_theta = n + sum(m + 1 for m in zeros)
    matrix = _stacked([one[:, :n_theta] for one in rows], [one[:, n_theta:] for one in rows])
    norms = np.linalg.norm(matrix, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    theta = np.linalg.lstsq(matrix / scale, np.concatenate(target), rcond=1e-12)[0] / scale
    ends = np.cumsum([n, *(m + 1 for m in zeros)])
    parts = np.split(theta[:n_theta], ends[:-1])
    return Plant(parts[0], tuple(parts[1:]))


def _stacked(shared: Sequence[Array], own: Sequence[Array]) -> Array:
    """Columns of all experiments, and columns of each alone."""
    blocks = []
    width = sum(one.shape[1] for one in own)
    at = 0
    for left, right in zip(shared, own, strict=True):
        block = np.zeros((len(left), width))
        block[:, at : at + right.shape[1]] = right
        at += right.shape[1]
        blocks.append(np.hstack([left, block]))
    return np.vstack(blocks)


@dataclass(frozen=True, eq=False)
class _Linear:
    """Errors and columns at a plant, whitened; rows of missing samples are zero."""

    errors: Array
    slopes: Array
    full: Array
    rest: Array
    count: int

    @property
    def is_finite(self) -> bool:
        """Whether nothing ran away."""
        return bool(np.isfinite(self.errors).all() and np.isfinite(self.slopes).all())

    def step(self) -> tuple[Array, Array, Array]:
        """Change of all unknowns, the residual beside start and offset, and ``R`` of the columns.

        Newton's step for the root, with the derivatives of all of ``e`` beside the instruments;
        where these hardly know them, that of the driven part alone.
        """
        matrix = np.hstack([self.slopes, self.rest])
        norms = np.linalg.norm(matrix, axis=0)
        scale = np.where(norms > 0, norms, 1.0)
        q, r = np.linalg.qr(matrix / scale)
        full = q.T @ (np.hstack([self.full, self.rest]) / scale)
        if np.linalg.cond(np.linalg.solve(r.T, full.T)) > AS_WELL:
            full = r
        change = np.linalg.lstsq(full, q.T @ self.errors, rcond=1e-13)[0] / scale
        own = np.linalg.qr(self.rest)[0]
        return change, self.errors - own @ (own.T @ self.errors), r * scale


def root(
    loops: Sequence[Loop],
    plants: Sequence[Plant],
    choose_noise: Callable[[Sequence[Array]], Array] | None,
    say: Callable[[str], None],
) -> Found | None:
    """Step 4 from several plants, the one first of which the references explain least.

    Parameters
    ----------
    loops : sequence of Loop
    plants : sequence of Plant
    choose_noise : callable, optional
        Gives the autoregressive coefficients for the errors of the experiments; white without it.
    say : callable
        Is told what is going on.

    Returns
    -------
    Found or None
        None where no start leads anywhere.
    """
    noise = np.zeros(0)
    basis = _driven_basis(loops)
    sound = [one for one in plants if _linear(loops, one, noise).is_finite]
    found = None
    for plant in sorted(sound, key=lambda one: _merit(_linear(loops, one, noise), basis)):
        found = _descended(loops, plant, noise, basis)
        if found.still:
            break
    for _ in range(MOST_NOISE_ROUNDS if found is not None and found.still else 0):
        if choose_noise is None or found is None:
            break
        following = choose_noise(found.errors)
        if following.size == noise.size and np.allclose(following, noise, atol=1e-4):
            break
        say("coloured noise")
        noise = following
        found = _descended(loops, found.plant, noise, basis)
    return found


def _driven_basis(loops: Sequence[Loop]) -> Array:
    columns = [loop.fitted.columns for loop in loops]
    return np.linalg.qr(_stacked([one[:, :0] for one in columns], columns))[0]


def autoregressive(errors: Sequence[Array]) -> Array:
    """A model of the errors' colour, of the order of lowest AICc."""
    fewest = min(int(np.isfinite(one).sum()) for one in errors)
    return fit_autoregression(list(errors), most_coefficients(fewest))


def _descended(loops: Sequence[Loop], plant: Plant, noise: Array, basis: Array) -> Found:
    moved = np.inf
    linear = _linear(loops, plant, noise)
    for steps in range(1, MOST_STEPS + 1):  # noqa: B007 - counts after the loop
        change, left, upper = linear.step()
        n = plant.theta.size
        size = _deviation(upper, left, linear.count, n)
        moved = float(np.max(np.abs(change[:n]) / size))
        noise_level = SCATTER * basis.shape[1] * float(left @ left) / linear.count
        merit, share = max(_merit(linear, basis), noise_level), 1.0
        for _ in range(HALVINGS):
            following = plant.with_theta(plant.theta + share * change[:n])
            new = _linear(loops, following, noise)
            if new.is_finite and _merit(new, basis) <= merit * (1 + 1e-9):
                break
            share *= 0.5
        else:
            moved = np.inf
            break
        plant, linear = following, new
        if moved <= STILL:
            break
    return _found(loops, plant, noise, linear, (steps, moved))


def _deviation(upper: Array, left: Array, count: int, n: int) -> Array:
    variance = float(left @ left) / max(count - upper.shape[1], 1)
    inverse = np.linalg.pinv(upper)
    return np.asarray(np.sqrt(variance * np.sum(inverse[:n] ** 2, axis=1)) + 1e-300)


def _merit(linear: _Linear, basis: Array) -> float:
    """What the references explain of the errors beside start and offset."""
    q = np.linalg.qr(linear.rest)[0]
    left = linear.errors - q @ (q.T @ linear.errors)
    along = basis.T @ left
    return float(along @ along) if np.isfinite(along).all() else np.inf


def _linear(loops: Sequence[Loop], plant: Plant, noise: Array) -> _Linear:
    edge = slowest(loops)
    errors, shared, own, count = [], [], [], 0
    with np.errstate(all="ignore"):
        for loop in loops:
            signals = recorded(loop)
            predictor = Predictor(plant, signals.dt, edge)
            rest = predictor.starts(len(signals.y))
            seen = np.isfinite(loop.record.y[:, 0])
            e, every = _with_start(plant, predictor, signals, rest, seen)
            _, z = _with_start(plant, predictor, driven_signals(loop), rest, seen)
            count += int(seen.sum())
            table = _white(np.column_stack([e, z, every, rest]), seen, noise)
            errors.append(table[:, 0])
            shared.append(table[:, 1 : 1 + 2 * z.shape[1]])
            own.append(table[:, 1 + 2 * z.shape[1] :])
    blocks = _stacked(shared, own)
    n = plant.theta.size
    both = (blocks[:, :n], blocks[:, n : 2 * n])
    return _Linear(np.concatenate(errors), *both, blocks[:, 2 * n :], count)


def _with_start(
    plant: Plant, predictor: Predictor, signals: Signals, rest: Array, seen: Array
) -> tuple[Array, Array]:
    """Errors from rest, and slopes at the start and offset that suit the signals best."""
    e = predictor.errors(signals)
    if not (np.isfinite(e).all() and np.isfinite(rest).all()):
        return e, np.full((len(e), plant.theta.size), np.nan)
    start = np.linalg.lstsq(rest[seen], e[seen], rcond=None)[0]
    return e, slopes(plant, signals, predictor.slowest, start)


def _white(table: Array, seen: Array, noise: Array) -> Array:
    if not noise.size:
        return np.where(seen[:, None], table, 0.0)
    found = [whiten(np.where(seen, column, np.nan), noise)[0] for column in table.T]
    return np.nan_to_num(np.column_stack(found))


def _found(
    loops: Sequence[Loop], plant: Plant, noise: Array, linear: _Linear, walked: tuple[int, float]
) -> Found:
    change, left, upper = linear.step()
    n = plant.theta.size
    freedom = max(linear.count - upper.shape[1] - noise.size, 1)
    variance = float(left @ left) / freedom
    inverse = np.linalg.pinv(upper)
    columns = upper[:, :n] / np.linalg.norm(upper[:, :n], axis=0)
    rest = np.split(change[n:], len(loops))
    plain = _linear(loops, plant, np.zeros(0))
    whole = plain.errors - plain.rest @ change[n:]
    errors = np.split(whole, np.cumsum([loop.record.n_samples for loop in loops])[:-1])
    seen = [np.isfinite(loop.record.y[:, 0]) for loop in loops]
    step = float(loops[0].record.dt or 0.0)
    return Found(
        plant,
        variance * inverse[:n] @ inverse[:n].T,
        tuple(np.where(s, e, np.nan) for s, e in zip(seen, errors, strict=True)),
        noise,
        variance,
        Predictor(plant, step, slowest(loops)).amplification,
        tuple(rest),
        freedom,
        float(np.linalg.cond(columns)),
        *walked,
    )


def orders_of(
    records: Sequence[Record], structure: Structure
) -> tuple[int, tuple[int, ...]] | None:
    """Poles and zeros of what this route can do; None for anything else.

    That is one output, one shared denominator, no delay, nothing known beforehand, uniform time.
    """
    first = records[0]
    if (
        first.n_outputs != 1
        or not structure.shared
        or structure.constrained
        or structure.drift is True
        or structure.delay == "free"
        or np.any(structure.delay_matrix(1, first.n_inputs))
        or any(record.dt is None for record in records)
    ):
        return None
    zeros = structure.zeros_matrix(1, first.n_inputs)[0]
    return structure.common_poles, tuple(int(m) for m in zeros)


def estimate_of(
    asked: Request, loops: Sequence[Loop], found: Found, words: Sequence[str]
) -> Estimate:
    """The estimate of a plant that is not stable.

    Its fit is that of the predictor's errors, as those of the noise of the output; its start and
    offset are those at which the predictor began.
    """
    plant, names = found.plant, asked.records[0]
    zero = np.zeros(1)
    nuisance = []
    for loop, terms in zip(loops, found.nuisance, strict=True):
        record = loop.record
        seen = np.flatnonzero(np.isfinite(record.y[:, 0]))
        base = float(recorded_base(loop) if not seen.size or seen[0] else record.y[0, 0])
        predictor = Predictor(plant, float(record.dt or 0.0), slowest(loops))
        nuisance.append(
            Nuisance(
                input_reference=np.array(record.u[0]),
                offset=np.array([terms[-1] + base]),
                drift=zero,
                free_response=(terms[:-1] * predictor.start_numerators)[None, :],
                offset_std=zero,
                drift_std=zero,
                initial_state="free",
                t0=float(record.t[0]),
            )
        )
    variance = found.variance / found.amplification**2
    left = np.concatenate(found.errors) / found.amplification
    y = np.concatenate([r.y[:, 0] - np.nanmean(r.y[:, 0]) for r in asked.records])
    fit = 100.0 * (1.0 - np.sqrt(np.nansum(left**2) / np.nansum(y**2)))
    rates = ", ".join(f"{pole.real:.4g}" for pole in plant.poles if pole.real > -slowest(loops))
    told = (
        f"{BY_PREDICTOR}: {found.steps} steps",
        f"the plant is not stable: a pole with real part {rates} rad/s; fit and noise are those of "
        "the predictor's errors",
        *words,
    )
    count = float(sum(np.isfinite(one).sum() for one in found.errors))
    k = plant.theta.size + sum(one.size for one in found.nuisance) + 1.0 + found.noise.size
    solved = Solved(
        structure=replace(asked.structure, offset=True, drift=False, initial_state="free"),
        model=TransferFunction(
            [[one for one in plant.b]],
            [[np.concatenate([[1.0], plant.a])] * len(plant.b)],
            input_names=names.input_names,
            output_names=names.output_names,
        ),
        theta=plant.theta,
        cov=found.cov,
        noise_variance=np.array([variance]),
        fit=np.array([fit]),
        status=Status.CONVERGED,
        trace=Trace((), decisions=told, stopped="the coefficients stand still"),
        nuisance=tuple(nuisance),
        degrees_of_freedom=found.freedom,
        cost=float(np.nanmean(left**2)),
        aicc=count * float(np.log(np.nanmean(np.concatenate(found.errors) ** 2)))
        + aicc_price(k, count),
        condition=found.condition,
        gradient=0.0,
        noise_model=(found.noise,) if found.noise.size else (),
    )
    return replace(assemble(asked, solved), route="reference")


def recorded_base(loop: Loop) -> float:
    """What the first output counts as where it was not recorded."""
    return float(loop.fitted.outputs[0, 0])
