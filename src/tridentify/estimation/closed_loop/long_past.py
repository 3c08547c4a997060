"""A plant to start from where a controller was running and its reference is not recorded.

A regression of the output on many past outputs and inputs is the best forecast: it has the plant
in it and whatever noise there is beside it, so that feedback does not bend it (Ljung, *System
Identification*, 2nd ed., 1999, sections 10.1 and 13.4). What a pulse of an input does to the
outputs to come is realised with ``n`` states (Ho & Kalman, Regelungstechnik 14, 1966, 545-548); the
numerators are then linear in that response.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.linear_errors import slowest
from tridentify.estimation.closed_loop.predictor import Plant, recorded
from tridentify.estimation.closed_loop.unstable_starts import lagged
from tridentify.models.simulate import simulate_each
from tridentify.numerics.arrays import Array, Complex
from tridentify.record.record import Record

LONGEST = 24
"""Samples of the past that a forecast goes by: controller, plant and noise of orders to about eight
are in it, whatever they are together."""

RATES = 4
"""Of poles beside integrators, that are tried: each three or so times the one before."""

PER_COLUMN = 8
"""Samples for each of its weights, at least."""


def plants_of_forecast(
    loops: Sequence[Loop], n: int, zeros: Sequence[int], integrators: int = 0
) -> list[Plant]:
    """Plants in the best forecast of the output from a long past.

    Parameters
    ----------
    loops : sequence of Loop
    n : int
        Number of poles.
    zeros : sequence of int
        Of every input.
    integrators : int
        Poles that are known to be at zero. Others are then tried over the rates that a past tells,
        as what is realised knows nothing of the former.

    Returns
    -------
    list of Plant
        With the poles that are realised, and one that integrates: poles slower than the past tells
        are known by what the gain does. Empty where the record is too short for a past.
    """
    samples = sum(loop.record.n_samples for loop in loops)
    past = min(LONGEST, samples // (PER_COLUMN * (len(zeros) + 1)))
    if past < 2 * n + 2:  # the realisation needs as many pulses again, and two
        return []
    pulses = _pulses(loops, past, [m == n for m in zeros])
    step = float(loops[0].record.dt or 0.0)
    slow = np.full(n, -slowest(loops), dtype=np.complex128)
    rates = np.geomspace(1.0 / past, 1.0, RATES) / step if 0 < integrators < n else ()
    others = [np.append(slow[:integrators], np.full(n - integrators, -rate)) for rate in rates]
    found = []
    for poles in (_realised(pulses, n, step), slow, *others):
        if poles is not None:
            a = np.real(np.poly(poles))
            own = zip(zeros, pulses, strict=True)
            found.append(Plant(a[1:], tuple(_numerator(a, m, one, loops[0]) for m, one in own)))
    return found


def _pulses(loops: Sequence[Loop], past: int, at_once: Sequence[bool]) -> list[Array]:
    """(past,) outputs from the sample of a pulse of each input on."""
    rows, target = [], []
    for number, loop in enumerate(loops):
        y = recorded(loop).y
        signals = np.column_stack([y, loop.record.u])
        lags = [range(1, past + 1), *(range(0 if now else 1, past + 1) for now in at_once)]
        level = np.zeros((len(y) - past, len(loops)))
        level[:, number] = 1.0
        rows.append(np.hstack([lagged(signals, lags, past), level]))
        target.append(y[past:])
    table, wanted = np.vstack(rows), np.concatenate(target)
    seen = np.isfinite(table).all(axis=1) & np.isfinite(wanted)
    size = np.linalg.norm(table[seen], axis=0) + 1e-300
    weights = np.linalg.lstsq(table[seen] / size, wanted[seen], rcond=1e-12)[0] / size
    found, at = [], past
    for now in at_once:
        own = weights[at : at + past + now]
        at += own.size
        moved = np.concatenate([own if now else np.append(0.0, own), np.zeros(past)])
        own_past = np.append(1.0, -weights[: past - 1])
        # unity on its diagonal, so that it is solved exactly forward
        recursion = scipy.linalg.toeplitz(own_past, np.zeros(past))
        found.append(scipy.linalg.solve_triangular(recursion, moved[:past], lower=True))
    return found


def _realised(pulses: Sequence[Array], n: int, step: float) -> Complex | None:
    """(n,) poles [rad/s] of the responses to pulses."""
    half = (len(pulses[0]) - 2) // 2
    now = np.hstack(
        [scipy.linalg.hankel(one[1 : half + 1], one[half : 2 * half]) for one in pulses]
    )
    later = np.hstack(
        [scipy.linalg.hankel(one[2 : half + 2], one[half + 1 : 2 * half + 1]) for one in pulses]
    )
    if not (np.isfinite(now).all() and np.isfinite(later).all()):
        return None
    u, values, turned = np.linalg.svd(now)
    if not values[n - 1] > 1e-12 * values[0]:
        return None
    root = np.sqrt(values[:n])
    moved = (u[:, :n] / root).T @ later @ (turned[:n].T / root)
    roots = np.linalg.eigvals(moved)
    if np.any((roots.imag == 0) & (roots.real <= 0)):
        return None
    return np.asarray(np.log(roots.astype(np.complex128)) / step, dtype=np.complex128)


def _numerator(a: Array, zeros: int, pulse: Array, loop: Loop) -> Array:
    """(zeros + 1,) coefficients whose response to a held pulse comes nearest."""
    u = np.zeros((pulse.size, 1))
    u[0] = 1.0
    record = Record(u, pulse, dt=loop.record.dt)
    ways = []
    for k in range(zeros, -1, -1):
        ways.append(simulate_each(np.eye(k + 1)[0], a, 0.0, record, u)[:, 0])
    table = np.column_stack(ways)
    size = np.linalg.norm(table, axis=0) + 1e-300
    return np.asarray(np.linalg.lstsq(table / size, pulse, rcond=1e-12)[0] / size)
