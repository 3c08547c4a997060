"""Exact simulation of a transfer function on a record's input.

Every denominator is realised once, as an orthonormal cascade when it is stable and as a
balanced companion form otherwise, and driven by all inputs; outputs are combinations of its
states.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from tridentify.errors import ChannelCountError, NonUniformTimeError, UnsupportedError
from tridentify.numerics.discretize import discretize
from tridentify.numerics.propagate import propagate
from tridentify.numerics.realization import cascade, monomials, sort_poles
from tridentify.record import Record
from tridentify.transfer_function import TransferFunction

Array = NDArray[np.float64]

BLOCK = 4096


def simulate(
    model: TransferFunction, record: Record, *, free_response: Array | None = None
) -> Array:
    """Output of a model for the input of a record, from rest or with a given free response.

    Parameters
    ----------
    model : TransferFunction
    record : Record
        Only its input, time and intersample behaviour are used.
    free_response : (n_outputs, n) or (n_outputs, n_inputs, n) array, optional
        Numerators ``c_0(p)``, descending powers, of the free response ``c_0(p) / a(p) delta(t -
        t0)`` of each output, with ``a`` its (first) denominator, or of each channel with its own.

    Returns
    -------
    (n_samples, n_outputs) array
        In units of the outputs; exact at the samples for the record's ``intersample``.

    Raises
    ------
    NonUniformTimeError
        If the record has no uniform sampling interval.
    ChannelCountError
        If the numbers of inputs differ.
    UnsupportedError
        For a model with a delay.

    Examples
    --------
    >>> record = Record(np.ones(4), np.ones(4), dt=1.0)
    >>> simulate(TransferFunction([1.0], [1.0, 1.0]), record)[:, 0].round(4).tolist()
    [0.0, 0.6321, 0.8647, 0.9502]
    """
    if record.dt is None:
        raise NonUniformTimeError(
            "found a record without a uniform step; expected one; resample it first"
        )
    if record.n_inputs != model.n_inputs:
        raise ChannelCountError(
            f"found a record with {record.n_inputs} inputs; expected {model.n_inputs} as in the "
            "model; select the channels"
        )
    if np.any(model.delay):
        raise UnsupportedError(
            "found a model with a delay; expected none; shift the input by whole samples instead"
        )
    result = np.zeros((record.n_samples, model.n_outputs))
    inputs = np.ascontiguousarray(record.u)
    for den in _distinct(model):
        channels = [
            (i, j)
            for i in range(model.n_outputs)
            for j in range(model.n_inputs)
            if np.array_equal(model.den[i][j], den)
        ]
        numerators = [model.num[i][j] for i, j in channels]
        _drive(result, den, channels, numerators, inputs, record.dt, record.intersample)
    if free_response is not None:
        free = np.atleast_2d(free_response)
        own = free if free.ndim == 3 else free[:, None, :]
        for i, j in zip(*np.nonzero(np.any(own, axis=2)), strict=True):
            response = np.zeros((record.n_samples, 1))
            none = np.zeros((record.n_samples, 1))
            c_0 = own[i, j, -(model.den[i][j].size - 1) :]
            _drive(
                response, model.den[i][j], [(0, 0)], [c_0], none, record.dt,
                record.intersample, impulse=True,
            )  # fmt: skip
            result[:, i] += response[:, 0]
    return result


def _distinct(model: TransferFunction) -> list[Array]:
    found: list[Array] = []
    for row in model.den:
        for den in row:
            if not any(np.array_equal(den, other) for other in found):
                found.append(den)
    return found


def realize(den: Array, numerators: list[Array]) -> tuple[Array, Array, Array, Array, int]:
    """State equation of several numerators over one denominator.

    Returns
    -------
    a, b, c, d : (n, n), (n,), (k, n), (k,) arrays
    upper : int
        Non-zero diagonals of ``a`` above the main one.
    """
    n = den.size - 1
    padded = np.array([np.pad(num, (n + 1 - num.size, 0)) for num in numerators])
    direct = padded[:, 0] / den[0]
    proper = padded[:, 1:] - np.outer(direct, den[1:])
    if n == 0:
        return np.zeros((0, 0)), np.zeros(0), np.zeros((direct.size, 0)), direct, 0
    poles = sort_poles(np.roots(den).astype(np.complex128))
    if poles.size == n and np.all(poles.real < 0):
        bank = cascade(poles)
        c = proper[:, ::-1] @ monomials(bank, n)
        return bank.a, bank.b, c, direct, int(np.any(poles.imag != 0))
    companion = np.zeros((n, n))
    companion[0] = -den[1:] / den[0]
    companion[1:, :-1] = np.eye(n - 1)
    balanced, (scaling, _) = scipy.linalg.matrix_balance(companion, permute=False, separate=True)
    b = np.zeros(n)
    b[0] = 1.0 / scaling[0]
    return np.asarray(balanced), b, np.asarray(proper * scaling), direct, n


def _drive(
    result: Array,
    den: Array,
    channels: list[tuple[int, int]],
    numerators: list[Array],
    u: Array,
    dt: float,
    intersample: str,
    *,
    impulse: bool = False,
) -> None:
    """Add the response of all channels with one denominator to ``result``."""
    a, b, c, d, upper = realize(den, numerators)
    q, (n_samples, n_inputs) = b.size, u.shape
    for (i, j), gain in zip(channels, d, strict=True):
        if gain:
            result[:, i] += gain * u[:, j]
    if q == 0:
        return
    step = discretize(a, b[:, None], dt, intersample)
    state = np.tile(b, (n_inputs, 1)) if impulse else np.zeros((n_inputs, q))
    full = q if upper > 1 or not np.allclose(np.triu(step.transition, 2), 0.0) else upper
    block = np.empty((n_inputs * q, min(BLOCK, n_samples)))
    for start in range(0, n_samples, BLOCK):
        stop = min(start + BLOCK, n_samples)
        propagate(
            step.transition, step.from_current[:, 0], step.from_next[:, 0], u, state, block,
            start=start, stop=stop, upper=full,
        )  # fmt: skip
        for (i, j), row in zip(channels, c, strict=True):
            result[start:stop, i] += row @ block[j * q : (j + 1) * q, : stop - start]
