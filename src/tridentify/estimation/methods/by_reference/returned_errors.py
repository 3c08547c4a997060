"""Standard errors of a root, whose residual hangs on the coefficients in more ways than one.

The root of ``sum Z e = 0`` lies ``(Z' T)^{-1} Z' e`` from the truth, with ``T`` all that the
residual changes by, so that its covariance is

    sigma^2  (Z' T)^{-1}  Z' S Z  (Z' T)^{-T},                                            (1)

``S`` the correlation of ``e``. The fit takes ``T`` for ``Z``, which it is on the mean. In a record
it is not: with

    e(theta)  =  y - G(theta) u_M(theta) - G(theta) held(u - u_M(theta))

``T = Z + N + D``. What noise makes of the input gives ``N``. It is independent of ``Z``, but where
a controller of high gain makes it larger than what the reference drives, hundreds of samples are
few, and the errors of this record may be two times those of the mean.

``D`` is there where what the reference drives between the samples of a continuous controller was
found with the help of the model: apart from the noise that a model leaves
(`closed_loop.noise_driven`), or simulated in the model's loop. At the samples nothing hangs on it,
as what is taken from one part of the input is added to the other; between them an error of the
coefficients comes back through the loop. In loops that are slow beside their samples ``D`` is
nothing. The direct gain of a fast one, which the samples hardly tell from what the controller does
between them, has twice the error and more. The derivatives are differences over one standard
error. With ``Z + D`` for instruments in place of ``Z`` the errors would be smaller by up to 5 %
(`benchmarks/closed_loop.py`, whose bound they are). Where ``D`` makes an error smaller, that does
not count: what hangs on the model is known no better than what is recorded.

``S`` is one where the model of the noise whitens ``e``. What a continuous controller makes of the
noise between the samples colours it, which short records hardly show: of 150 samples the order of
lowest AICc is 0 or 1, and the errors 0.6 to 0.9 times what they should be. But that colour is known
where the driven input was found apart from white noise (`closed_loop.noise_driven.colour`), and
``S`` is what the model of the noise leaves of it. Scores that the fit found scattered have seen it.

An order of lowest AICc may also be chance's: in three of 54 loops with 200 samples and noise of the
first order it was 12 or more, and errors half of what they should be. No error is smaller than with
the ``S`` that such a model leaves of noise of the order of least BIC (Schwarz 1978).

A plant that is slow for the record's length adds up what noise between the samples makes of the
input, which no model of the noise shows there: up to `LONGEST` samples no error is smaller than in
such noise (`closed_loop.added_up`).

What the reference drives is known at the samples. Between them it is what the operators make of it,
and in a loop that is fast beside its samples they may make something else. Descriptions of other
rates through the same samples (`driven.described_otherwise`) move the coefficients by
``(Z' T)^{-1} Z'`` of what they change: by next to nothing in slow loops, by ten standard errors and
more in fast ones, and the truth is about as far off. These moves join the covariance.

References: T. Soderstrom & P. Stoica, *Instrumental Variable Methods for System Identification*
(1983), on the covariance of a root. G. Schwarz, Annals of Statistics 6 (1978) 461-464.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_banded

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.closed_loop.added_up import Series, added_up, pulse
from tridentify.estimation.closed_loop.as_recorded import AsRecorded
from tridentify.estimation.closed_loop.between_samples import Loop, with_input
from tridentify.estimation.closed_loop.driven import Driven, described_otherwise
from tridentify.estimation.closed_loop.noise_driven import colour, made
from tridentify.estimation.closed_loop.simulated import Simulated
from tridentify.estimation.likelihood.noise.estimated_noise import LONGEST
from tridentify.estimation.methods.by_reference.passes import Rooted, apart, model_like, residuals
from tridentify.models.simulate import free_responses, simulate
from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.autoregression import burg, whiten
from tridentify.numerics.levinson import stationary_polynomial
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

NOTABLE = 1.02
"""Factor of a standard error from which it is told."""
MOST_RETURNED = 10.0
"""Factor of a standard error beyond which differences over one of them say nothing."""


def with_returned_errors(found: Rooted) -> tuple[Rooted, str]:
    """The root with the covariance (1), and what is told of ``D``; empty where it is next to none.

    Parameters
    ----------
    found : Rooted
    """
    estimate = found.estimate
    if not found.still:
        return found, ""
    free = np.flatnonzero(estimate.std > 0)
    try:
        tables = _tables(found, free)
        if tables is None:
            return found, ""
        cov = _in_their_colour(found, tables, estimate.cov[np.ix_(free, free)])
        covs = [one @ cov @ one.T for one in _back(tables, free)[:2]]
    except (TridentifyError, np.linalg.LinAlgError):
        return found, ""
    size, held = (np.sqrt(np.diag(one)) for one in covs)
    most = size / estimate.std[free]
    if not np.isfinite(most).all() or most.max() > MOST_RETURNED:
        return found, ""
    cov = np.array(estimate.cov)
    cov[np.ix_(free, free)] = _no_less(covs[0], covs[1])
    told, share = "", np.maximum(size / held, 1.0)
    if share.max() > NOTABLE:
        told = (
            f"standard errors {share.min():.2f} to {share.max():.2f} times those of an input that "
            "is known between the samples: what is known of it hangs on the model"
        )
    return replace(found, estimate=replace(estimate, cov=cov)), told


def sees_nothing(found: Rooted) -> bool:
    """Whether the instruments see so little of what the output changes by that no error is known.

    Parameters
    ----------
    found : Rooted
        For white noise.
    """
    free = np.flatnonzero(found.estimate.std > 0)
    try:
        tables = _tables(found, free)
        seen = None if tables is None else _back(tables, free)[1]
    except (TridentifyError, np.linalg.LinAlgError):
        return False
    if seen is None:
        return False
    errors = np.sqrt(np.diag(seen @ found.estimate.cov[np.ix_(free, free)] @ seen.T))
    return not bool(np.max(errors / found.estimate.std[free], initial=0.0) <= MOST_RETURNED)


def moves_between(found: Rooted) -> tuple[Array, ...]:
    """How far the coefficients move with other descriptions of what lies between the samples.

    Parameters
    ----------
    found : Rooted
    """
    estimate, free = found.estimate, np.flatnonzero(found.estimate.std > 0)
    try:
        others = _described_otherwise(found.loops, estimate.model)
        tables = _tables(found, free, others) if found.still and free.size and others else None
        if tables is None:
            return ()
        _, inverse, off = _back(tables, free)
    except (TridentifyError, np.linalg.LinAlgError):
        return ()
    moved = np.zeros((len(others), estimate.theta.size))
    moved[:, free] = (inverse @ off).T
    return tuple(moved) if np.isfinite(moved).all() else ()


def _described_otherwise(loops: Sequence[Loop], model: TransferFunction) -> list[list[Array]]:
    """What a model makes of the input by other descriptions, beyond that by the present one."""
    fitted = [one.driven for one in loops if isinstance(one.driven, Driven)]
    if loops[0].sampling == "sampled" or len(fitted) < len(loops):
        return []
    now = [made(one, model) for one in loops]
    return [
        [
            made(replace(loop, driven=part), model) - own
            for loop, part, own in zip(loops, parts, now, strict=True)
        ]
        for parts in zip(*(described_otherwise(one) for one in fitted), strict=True)
    ]


def _back(tables: Sequence[Array], free: Indices) -> tuple[Array, Array, Array]:
    """`returned`, of `_tables`, and what of their last columns follows the instruments."""
    table, count = np.vstack(tables), free.size
    size = np.linalg.norm(table[:, :count], axis=0)
    share = np.linalg.lstsq(table[:, :count] / size, table[:, count:], rcond=None)[0]
    held, back, off = np.split(share / size[:, None], [count, 2 * count], axis=1)
    return np.linalg.inv(held + back), np.linalg.inv(held), off


def _tables(found: Rooted, free: Indices, others: Sequence[list[Array]] = ()) -> list[Array] | None:
    """``Z``, ``Z + N``, ``D`` as the fit weighs them, per record and output, and other columns.

    (n_samples, 3 n_free + n_others). None where a difference leads to no model. ``D`` is left out
    where there are others.
    """
    estimate = found.estimate
    follow = not others and all(_follows_the_model(one) for one in found.loops)
    base = _at(found.loops, estimate, estimate.model) if follow else list(found.loops)
    instruments, slopes, changes = [], [], []
    for j in free:
        model, step = _moved(estimate, int(j))
        if model is None:
            return None
        loops = _at(found.loops, estimate, model) if follow else base
        instruments.append(
            [
                simulate(model, one.instrument) - simulate(estimate.model, one.instrument)
                for one in base
            ]
        )
        slopes.append([made(one, model) - made(one, estimate.model) for one in base])
        changes.append(
            [
                made(one, estimate.model) - made(was, estimate.model)
                for one, was in zip(loops, base, strict=True)
            ]
        )
        for each in (instruments, slopes, changes):
            each[-1] = [one / step for one in each[-1]]
    left, columns = residuals(found.loops, estimate), (*instruments, *slopes, *changes, *others)
    return [
        weighted(loop, estimate, e, i, left[e], [one[e] for one in columns])
        for e, loop in enumerate(base)
        for i in range(loop.record.n_outputs)
    ]


def _in_their_colour(found: Rooted, tables: Sequence[Array], cov: Array) -> Array:
    """The covariance of the fit with ``S`` of (1), where that is known and not yet in it."""
    estimate, n_free = found.estimate, len(cov)
    if estimate.errors != "likelihood":
        return cov
    left, few = residuals(found.loops, estimate), estimate.n_samples < LONGEST
    sparing, colours = False, []
    for loop, series in zip(found.loops, left, strict=True):
        seen = None if loop.sampling == "sampled" else colour(loop, estimate.model)
        if seen is None and few:
            seen = _sparing(series, estimate.noise_model)
            sparing = sparing or seen is not None
        colours.append(seen)
    n_outputs = found.loops[0].record.n_outputs
    size = np.linalg.norm(np.vstack(tables)[:, :n_free], axis=0)
    q, r = np.linalg.qr(np.vstack(tables)[:, :n_free] / size)
    parts = np.split(q, np.cumsum([len(one) for one in tables])[:-1])
    middle = np.zeros((n_free, n_free))
    for e, response in enumerate(colours):
        own = parts[e * n_outputs : (e + 1) * n_outputs]
        if response is None:
            middle += sum(one.T @ one for one in own)
            continue
        whole = np.stack([_whitened(estimate, i, response[:, i]) for i in range(n_outputs)], axis=1)
        whole /= np.linalg.norm(whole, axis=(0, 2))[None, :, None]
        length = 2 * len(whole)
        back = np.fft.rfft(whole, length, axis=0).conj()
        columns = np.fft.rfft(np.stack(own, axis=1), length, axis=0)
        felt = np.fft.irfft(np.einsum("fij,fik->fjk", back, columns), length, axis=0)
        flat = felt[: len(whole)].reshape(-1, n_free)
        middle += flat.T @ flat
    r = r * size
    root_of = np.linalg.solve(r, np.linalg.cholesky(r @ cov @ r.T))
    coloured = np.asarray(root_of @ middle @ root_of.T)
    coloured = _no_less(cov, coloured) if sparing else coloured
    if found.loops[0].sampling == "sampled" or not few:
        return coloured
    slow = root_of @ _added_up(found, q, tables, left) @ root_of.T
    return _no_less(coloured, np.asarray(slow))


def _added_up(found: Rooted, q: Array, tables: Sequence[Array], left: Sequence[Array]) -> Array:
    """``Z' S Z`` in noise that the plant may have added up (`closed_loop.added_up`)."""
    estimate, at = found.estimate, 0
    series: list[Series] = []
    for e, loop in enumerate(found.loops):
        response = simulate(estimate.model, with_input(loop.record, pulse(loop), "zoh"))
        for i in range(loop.record.n_outputs):
            table, n_free = tables[len(series)], q.shape[1]
            beside = _whitened(estimate, i, _nuisance(loop.record, estimate, e, i))
            series.append(
                Series(
                    weighted(loop, estimate, e, i, left[e], [left[e]])[:, 0],
                    q[at : at + len(table)],
                    np.hstack([table[:, n_free : 2 * n_free], beside]),
                    response[:, i],
                    estimate.noise_model[i] if i < len(estimate.noise_model) else np.zeros(0),
                    i,
                )
            )
            at += len(table)
    return added_up(series)


def _sparing(left: Array, models: Sequence[Array]) -> Array | None:
    """(n, n_outputs, n_outputs) responses of noises of least BIC; None where none is lower."""
    if len(models) < left.shape[1] or not np.isfinite(left).all():
        return None
    found, lower = np.zeros((len(left), left.shape[1], left.shape[1])), False
    for i, a in enumerate(models):
        reflection, power = burg([left[:, i] - left[:, i].mean()], a.size)
        price = np.log(len(left)) * np.arange(power.size)
        order = int(np.argmin(len(left) * np.log(power + 1e-300) + price))
        lower = lower or order < a.size
        own = stationary_polynomial(reflection[:order]) if order < a.size else a
        bands = np.tile(np.append(1.0, own)[:, None], len(left))
        found[:, i, i] = solve_banded((own.size, 0), bands, np.eye(1, len(left))[0])
    return found if lower else None


def _no_less(cov: Array, least: Array) -> Array:
    """A covariance with standard errors no less than those of another."""
    wider = np.sqrt(np.maximum(np.diag(least) / np.diag(cov), 1.0))
    return np.asarray(cov * np.outer(wider, wider))


def _whitened(estimate: Estimate, i: int, response: Array) -> Array:
    """(n, k) responses of an output as its model of the noise sees them."""
    modelled = i < len(estimate.noise_model) and estimate.noise_model[i].size
    if not modelled or not response.shape[1]:
        return response
    taps = np.append(1.0, estimate.noise_model[i])
    return np.column_stack([np.convolve(one, taps)[: len(one)] for one in response.T])


def _follows_the_model(loop: Loop) -> bool:
    """Whether what the reference drives between the samples was found with a model's help."""
    if loop.sampling == "sampled" or isinstance(loop.driven, AsRecorded):
        return False
    return isinstance(loop.driven, Simulated) or loop.driven.noise is not None


def _at(loops: Sequence[Loop], estimate: Estimate, model: TransferFunction) -> list[Loop]:
    """The loops as a model shows them."""
    fitted = all(isinstance(one.driven, Driven) for one in loops)
    return apart(loops, estimate, model) if fitted else [one.at(model) for one in loops]


def _moved(estimate: Estimate, j: int) -> tuple[TransferFunction | None, float]:
    """A stable model with one coefficient moved by its standard error, up or down; by how much."""
    for step in (estimate.std[j], -estimate.std[j]):
        theta = np.array(estimate.theta)
        theta[j] += step
        model = model_like(estimate, theta)
        if model.is_stable:
            return model, float(step)
    return None, 0.0


def weighted(
    loop: Loop, estimate: Estimate, e: int, i: int, left: Array, columns: Sequence[Array]
) -> Array:
    """(n_samples, k) columns of one output as the fit weighs them, what its nuisance may be out.

    Rows of missing samples are zero.
    """
    record, series = loop.record, left[:, i]
    seen = np.isfinite(series)
    beside = _nuisance(record, estimate, e, i)
    table = np.column_stack([series, *(one[:, i] for one in columns), beside])
    if i < len(estimate.noise_model) and estimate.noise_model[i].size:
        noise = estimate.noise_model[i]
        table = np.column_stack([whiten(np.where(seen, one, np.nan), noise)[0] for one in table.T])
    table = table[seen] / np.std(table[seen, 0])
    mine, own = table[:, 1 : 1 + len(columns)], table[:, 1 + len(columns) :]
    basis = np.linalg.qr(own / (np.linalg.norm(own, axis=0) + 1e-300))[0]
    found = np.zeros((seen.size, len(columns)))
    found[seen] = mine - basis @ (basis.T @ mine)
    return found


def _nuisance(record: Record, estimate: Estimate, e: int, i: int) -> Array:
    """(n_samples, k) what start, offset and drift may add to an output."""
    columns = [np.zeros((record.n_samples, 0))]
    if estimate.nuisance[e].initial_state == "free":
        known: list[Array] = []
        for den in estimate.model.den[i]:
            if not any(np.array_equal(den, other) for other in known):
                known.append(den)
                columns.append(free_responses(den, record))
    if estimate.structure.offset:
        columns.append(np.ones((record.n_samples, 1)))
    if estimate.structure.drift:
        columns.append((record.t - record.t[0])[:, None])
    return np.hstack(columns)
