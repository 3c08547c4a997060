"""Correlation of the residual with an input at every lag, and the exact width of its bounds.

With ``z_k`` the input ``k`` samples earlier, its mean taken off, and both whitened by the model of
the noise, ``c_k = r' z_k / (|r| max |z|)`` has, for white noise of variance ``s^2`` before the
fit, the variance ``s^2 z_k' (I - Q Q') z_k / (...)``: an input that is correlated with its own
past makes the values at neighbouring lags alike, but not the bounds at one lag wrong, and what the
fit took narrows them. On another record the errors of the coefficients come on top, ``|D'
z_k|^2``. This is the variance ``sum r_e(k) r_u(k)`` of Box, Jenkins & Reinsel (*Time Series
Analysis*, 4th ed., section 12.1) after whitening, without the assumption of a long record.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from tridentify.judgement.validation.residuals import View
from tridentify.judgement.validation.result import CrossCorrelation
from tridentify.judgement.validation.statistics.columns import moved_input, waves
from tridentify.numerics.arrays import Array
from tridentify.numerics.lagrange import span

AT_ONCE = 16
"""Lags that are whitened together: enough to share the work, few enough for long records."""


def correlate(
    view: View,
    index: int,
    channel: int,
    noise: Array,
    n_lags: int,
    level: float,
    p_value: float,
    drifts: bool = False,
) -> CrossCorrelation:
    """Correlate one residual with one input.

    Parameters
    ----------
    view : View
    index, channel : int
        Of the output and of the input.
    noise : (p,) array
        Model of the noise.
    n_lags : int
    level : float
        Of the bounds at each lag.
    p_value : float
        To go with it.
    drifts : bool
        Whether a slow drift was found, which is taken off.
    """
    output = view.outputs[index]
    moves = output.white(output.coefficients, noise)
    rest = output.white(output.nuisance, noise)
    if drifts:
        rest = np.hstack([rest, output.white(waves(view), noise)])
    basis = span(np.hstack([rest, moves]) if view.own else rest)
    r = output.white(tuple(np.nan_to_num(one) for one in output.residual), noise)
    r = r - basis @ (basis.T @ r)
    # a correlation has no unit: neither side has to be squared in its own
    large = float(np.abs(r).max(initial=0.0)) or 1.0
    r, moves = r / large, moves / large
    largest = max(float(np.ptp(record.u[:, channel])) for record in view.records) or 1.0
    everything = span(np.hstack([rest, moves]))
    left = r - everything @ (everything.T @ r)
    freedom = max(output.count - everything.shape[1], 1)
    variance = float(left @ left) / freedom
    lags = np.arange(-n_lags, n_lags + 1)
    product, spread, size = np.zeros((3, lags.size))
    for first in range(0, lags.size, AT_ONCE):
        at = slice(first, first + AT_ONCE)
        each = [_centred(view, channel, lag) for lag in lags[at].tolist()]
        z = output.white(
            [np.stack(one, axis=1) / largest for one in zip(*each, strict=True)], noise
        )
        own = z - basis @ (basis.T @ z)
        product[at], size[at] = r @ own, np.sqrt(np.einsum("ij,ij->j", z, z))
        spread[at] = variance * np.einsum("ij,ij->j", own, own)
        if not view.own and view.has_errors:
            spread[at] += np.sum((moves.T @ own) ** 2, axis=0)
    whole = float(np.sqrt(r @ r)) * float(size.max())
    whole = whole if whole > 0 else 1.0
    return CrossCorrelation(
        output.name,
        view.records[0].input_names[channel],
        np.asarray(lags * view.step, dtype=np.float64),
        np.asarray(product / whole, dtype=np.float64),
        np.asarray(float(ndtri(0.5 + level / 2)) * np.sqrt(spread) / whole, dtype=np.float64),
        p_value,
    )


def _centred(view: View, channel: int, lag: int) -> tuple[Array, ...]:
    found = []
    for one, record in zip(moved_input(view, channel, lag), view.records, strict=True):
        k = min(abs(lag), record.n_samples)
        here = one - float(np.mean(record.u[:, channel] - record.u[0, channel]))
        here[: k if lag > 0 else 0] = 0.0
        if lag < 0:
            here[record.n_samples - k :] = 0.0
        found.append(here)
    return tuple(found)
