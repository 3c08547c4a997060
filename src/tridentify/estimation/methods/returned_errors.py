"""Standard errors where what the reference drives was found with the help of the model.

Between the samples of a continuous controller the driven input is not recorded. It is found apart
from the noise that a model leaves (`closed_loop.noise_driven`), or simulated in the model's loop:
either way it is a function ``u_M(theta)``. At the samples nothing hangs on it, as what is taken
from one part of the input is added to the other; between them the residual

    e(theta)  =  y - G(theta) u_M(theta) - G(theta) held(u - u_M(theta))

moves with ``theta`` by ``-(Z_0 + D)``, with ``Z_0`` the derivative for an input that is known and
``D`` what the change of ``u_M`` makes between the samples. The root of ``sum Z e = 0`` therefore
lies ``(Z' (Z + D))^{-1} Z' e`` from the truth: an error of the coefficients comes back through the
loop, larger by ``(I + A)^{-1}`` with ``A = (Z' Z)^{-1} Z' D``, and the covariance is

    (I + A)^{-1}  sigma^2 (Z' Z)^{-1}  (I + A)^{-T}.                                          (1)

In loops that are slow beside their samples ``A`` is nothing. The direct gain of a fast one, which
the samples hardly tell from what the controller does between them, has twice the error and more.
The derivatives are differences over one standard error. With ``Z + D`` for instruments in place of
``Z`` the errors would be smaller by up to 5 % (`benchmarks/closed_loop.py`, whose bound they are).

References: T. Soderstrom & P. Stoica, *Instrumental Variable Methods for System Identification*
(1983), on the covariance of a root.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.closed_loop.as_recorded import AsRecorded
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.driven import Driven
from tridentify.estimation.closed_loop.noise_driven import made
from tridentify.estimation.closed_loop.simulated import Simulated
from tridentify.estimation.methods.passes import Rooted, apart, model_like, residuals
from tridentify.models.simulate import free_responses, simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

NOTABLE = 1.02
"""Factor of a standard error from which it is told."""
MOST_RETURNED = 10.0
"""Factor of a standard error beyond which differences over one of them say nothing."""


def with_returned_errors(found: Rooted) -> tuple[Rooted, str]:
    """The root with the covariance (1), and what is told of it; empty where nothing changes.

    Parameters
    ----------
    found : Rooted
    """
    estimate = found.estimate
    if not all(_follows_the_model(one) for one in found.loops) or not found.still:
        return found, ""
    try:
        back = returned(found)
    except (TridentifyError, np.linalg.LinAlgError):
        return found, ""
    if back is None:
        return found, ""
    cov = np.array(estimate.cov)
    free = np.flatnonzero(estimate.std > 0)
    cov[np.ix_(free, free)] = back @ cov[np.ix_(free, free)] @ back.T
    share = np.sqrt(np.diag(cov)[free]) / estimate.std[free]
    if not np.isfinite(share).all() or share.max() > MOST_RETURNED:
        return found, ""
    told = ""
    if share.max() > NOTABLE:
        told = (
            f"standard errors {share.min():.2f} to {share.max():.2f} times those of an input that "
            "is known between the samples: what is known of it hangs on the model"
        )
    return replace(found, estimate=replace(estimate, cov=cov)), told


def returned(found: Rooted) -> Array | None:
    """(n_free, n_free) ``(I + A)^{-1}`` of (1); None where a difference leads to no model.

    Parameters
    ----------
    found : Rooted
    """
    estimate = found.estimate
    free = np.flatnonzero(estimate.std > 0)
    base = _at(found.loops, estimate, estimate.model)
    slopes: list[list[Array]] = []
    changes: list[list[Array]] = []
    for j in free:
        model, step = _moved(estimate, int(j))
        if model is None:
            return None
        loops = _at(found.loops, estimate, model)
        slopes.append(
            [
                (simulate(model, one.instrument) - simulate(estimate.model, one.instrument)) / step
                for one in base
            ]
        )
        changes.append(
            [
                (made(one, estimate.model) - made(was, estimate.model)) / step
                for one, was in zip(loops, base, strict=True)
            ]
        )
    left, count = residuals(found.loops, estimate), free.size
    rows = [
        _weighted(loop, estimate, e, i, left[e], [one[e] for one in (*slopes, *changes)])
        for e, loop in enumerate(base)
        for i in range(loop.record.n_outputs)
    ]
    table = np.vstack(rows)
    size = np.linalg.norm(table[:, :count], axis=0)
    share = np.linalg.lstsq(table[:, :count] / size, table[:, count:], rcond=None)[0]
    return np.asarray(np.linalg.inv(np.eye(count) + share / size[:, None]))


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


def _weighted(
    loop: Loop, estimate: Estimate, e: int, i: int, left: Array, columns: Sequence[Array]
) -> Array:
    """(n_seen, k) columns of one output, as the fit weighs them, what its nuisance may be out."""
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
    return np.asarray(mine - basis @ (basis.T @ mine))


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
