"""Exact simulation of a transfer function on a record's input.

Every denominator is realised once, as an orthonormal cascade when it is stable and as a
balanced companion form otherwise, and driven by all inputs; outputs are combinations of its
states. Instants need not be uniform, and delays need not be whole samples (`numerics.sampled`).
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain

import numpy as np
import scipy.linalg

from tridentify.errors import ChannelCountError, SampleTypeError, ScaleError, TridentifyError, shown
from tridentify.numerics.arrays import Array
from tridentify.numerics.realization import cascade, monomials, sort_poles
from tridentify.numerics.recent import recent
from tridentify.numerics.sampled import Sampled, States
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

BLOCK = 4096


def simulate(
    model: TransferFunction,
    record: Record,
    *,
    free_response: Array | None = None,
    free_after: float = 0.0,
) -> Array:
    """Output of a model for the input of a record, from rest or with a given free response.

    Parameters
    ----------
    model : TransferFunction
        Or an estimate: its model is taken, without the offset and the start of its record.
    record : Record
        Only its input, time and intersample behaviour are used. Before its first sample the input
        counts as zero.
    free_response : (n_outputs, n) or (n_outputs, n_inputs, n) array, optional
        Numerators ``c_0(p)``, descending powers, of the free response ``c_0(p) / a(p) delta(t -
        t0 - free_after)`` of each output, with ``a`` its (first) denominator, or of each channel
        with its own.
    free_after : float
        When the free response begins, after the first sample [s]; at a sample.

    Returns
    -------
    (n_samples, n_outputs) array
        In units of the outputs; exact at the samples for the record's ``intersample``.

    Raises
    ------
    ChannelCountError
        If the numbers of inputs differ.
    ScaleError
        If the output leaves the range of a float, as that of an unstable model does in the end.
    SampleTypeError
        If they are no model and no record, or the other way round.

    Examples
    --------
    >>> record = Record(np.ones(4), np.ones(4), dt=1.0)
    >>> simulate(TransferFunction([1.0], [1.0, 1.0]), record)[:, 0].round(4).tolist()
    [0.0, 0.6321, 0.8647, 0.9502]
    >>> uneven = Record(np.ones(4), np.ones(4), t=[0.0, 0.5, 2.0, 2.5])
    >>> simulate(TransferFunction([1.0], [1.0, 1.0], delay=1.5), uneven)[:, 0].round(4).tolist()
    [0.0, 0.0, 0.3935, 0.6321]
    """
    # an estimate stands floors above
    model = getattr(model, "model", model)
    if not (isinstance(model, TransferFunction) and isinstance(record, Record)):
        found = ", ".join(shown(type(one).__name__) for one in (model, record))
        raise SampleTypeError(
            f"found {found}; expected a TransferFunction and a Record; write simulate(model, "
            "record)"
        )
    if record.n_inputs != model.n_inputs:
        raise ChannelCountError(
            f"found a record with {record.n_inputs} inputs; expected {model.n_inputs} as in the "
            "model; select the channels"
        )
    # what overflows is not finite at the end, and said there in one line
    with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
        try:
            result = _response(model, record, free_response, free_after)
        except (np.linalg.LinAlgError, ValueError) as error:
            if isinstance(error, TridentifyError):
                raise
            raise _no_room(model.n_outputs, record) from error
    if not np.isfinite(result).all():
        raise _no_room(model.n_outputs, record)
    return result


def simulate_each(
    num: Array | list[Array], den: Array, delay: float, record: Record, inputs: Array
) -> Array:
    """As `simulate` from rest, of models of one channel driven by each of several inputs alone.

    Parameters
    ----------
    num : array or list of arrays
        Descending powers; one for all inputs, or one for each (or several for one input).
    den : array
        Descending powers, beginning with one.
    delay : float
        [s].
    record : Record
        Only its time and intersample behaviour are used.
    inputs : (n_samples, k) array
        Finite.

    Returns
    -------
    (n_samples, k) array

    Raises
    ------
    ScaleError
        As `simulate`.

    Examples
    --------
    >>> record = Record(np.ones(3), np.ones(3), dt=1.0)
    >>> inputs = np.stack([np.ones(3), np.zeros(3)], axis=1)
    >>> simulate_each(np.ones(1), np.ones(2), 0.0, record, inputs).round(4).tolist()
    [[0.0, 0.0], [0.6321, 0.0], [0.8647, 0.0]]
    >>> both = [np.ones(1), 2.0 * np.ones(1)]
    >>> simulate_each(both, np.ones(2), 0.0, record, inputs[:, :1]).round(4).tolist()
    [[0.0, 0.0], [0.6321, 1.2642], [0.8647, 1.7293]]
    """
    numerators = num if isinstance(num, list) else [num] * inputs.shape[1]
    k, last = len(numerators), inputs.shape[1] - 1
    result = np.zeros((record.n_samples, k))
    signal = _signal(record, np.ascontiguousarray(inputs), (delay,) * (last + 1))
    with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
        try:
            channels = [(i, min(i, last)) for i in range(k)]
            _drive(result, den, channels, numerators, signal)
        except (np.linalg.LinAlgError, ValueError) as error:
            if isinstance(error, TridentifyError):
                raise
            raise _no_room(k, record) from error
    if not np.isfinite(result).all():
        raise _no_room(k, record)
    return result


def free_responses(den: Array, record: Record, after: float = 0.0) -> Array:
    """Whatever a denominator may still do by itself, at the samples of a record.

    Parameters
    ----------
    den : (n + 1,) array
        Descending powers.
    record : Record
        Only its time is used.
    after : float
        When it begins, after the first sample [s]; at a sample.

    Returns
    -------
    (n_samples, n) array
        Responses ``p^k / a(p) delta(t - t0 - after)``, which span those to any initial state.

    Examples
    --------
    >>> record = Record(np.zeros(3), np.ones(3), dt=1.0)
    >>> free_responses(np.array([1.0, 2.0]), record)[:, 0].round(4).tolist()
    [1.0, 0.1353, 0.0183]
    """
    n = den.size - 1
    names = [f"x{k}" for k in range(n)]
    still = Record(
        np.zeros(record.n_samples),
        np.zeros((record.n_samples, n)),
        output_names=names,
        intersample=record.behaviour,
        t=record.t,
    )
    model = TransferFunction([[[0.0]]] * n, den, output_names=names)
    return simulate(model, still, free_response=np.eye(n), free_after=after)


def _no_room(n_outputs: int, record: Record) -> ScaleError:
    return ScaleError(
        f"found a model of {n_outputs} outputs whose response over {record.duration:.3g} s "
        "leaves the range of numbers; expected one below 1e308; shorten the record, or correct the "
        "poles, the gain or the units of the model"
    )


def _response(
    model: TransferFunction, record: Record, free_response: Array | None, free_after: float
) -> Array:
    """The output, not finite where it leaves the range of a float."""
    result = np.zeros((record.n_samples, model.n_outputs))
    moved = bool(np.any(record.u))
    for delays in dict.fromkeys(tuple(row) for row in model.delay.tolist()) if moved else ():
        signal = _signal(record, np.ascontiguousarray(record.u), delays)
        late = [i for i in range(model.n_outputs) if tuple(model.delay[i].tolist()) == delays]
        for den in distinct(chain.from_iterable(model.den)):
            channels = [
                (i, j)
                for i in late
                for j in range(model.n_inputs)
                if np.array_equal(model.den[i][j], den)
            ]
            if channels:
                numerators = [model.num[i][j] for i, j in channels]
                _drive(result, den, channels, numerators, signal)
    if free_response is not None:
        nothing = _signal(record, np.zeros((record.n_samples, 1)), ())
        since = record.t - record.t[0]
        begin = int(np.searchsorted(since, (1.0 - 1e-9) * free_after))
        free = np.atleast_2d(free_response)
        own = free if free.ndim == 3 else free[:, None, :]
        known: dict[tuple[bytes, bytes], Array] = {}
        for i, j in zip(*np.nonzero(np.any(own, axis=2)), strict=True):
            den = model.den[i][j]
            c_0 = own[i, j, -(den.size - 1) :]
            key = den.tobytes(), c_0.tobytes()
            if key not in known:
                known[key] = np.zeros((record.n_samples, 1))
                _drive(known[key], den, [(0, 0)], [c_0], nothing, impulse=begin)
            result[:, i] += known[key][:, 0]
    return result


def _signal(record: Record, u: Array, delays: tuple[float, ...]) -> Sampled:
    if record.dt is not None:
        return Sampled(u, record.dt, record.behaviour, delays=delays)
    since = record.t - record.t[0]
    return Sampled(u, typical_step(record.t), record.behaviour, since, delays)


def distinct(denominators: Iterable[Array]) -> list[Array]:
    """Each of them once, in their order."""
    found: list[Array] = []
    for den in denominators:
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
    padded = np.zeros((len(numerators), n + 1))
    for row, num in zip(padded, numerators, strict=True):
        row[n + 1 - num.size :] = num
    direct = padded[:, 0] / den[0]
    proper = padded[:, 1:] - np.outer(direct, den[1:])
    if n == 0:
        return np.zeros((0, 0)), np.zeros(0), np.zeros((direct.size, 0)), direct, 0
    stable = _orthonormal(den)
    if stable:
        ((a, b, powers, upper),) = stable
        return a, b, proper[:, ::-1] @ powers, direct, upper
    companion = np.zeros((n, n))
    companion[0] = -den[1:] / den[0]
    companion[1:, :-1] = np.eye(n - 1)
    balanced, (scaling, _) = scipy.linalg.matrix_balance(companion, permute=False, separate=True)
    b = np.zeros(n)
    b[0] = 1.0 / scaling[0]
    return np.asarray(balanced), b, np.asarray(proper * scaling), direct, n


@recent(32)
def _orthonormal(den: Array) -> tuple[tuple[Array, Array, Array, int], ...]:
    """``a``, ``b``, powers of p on the states and diagonals of a cascade; none if not stable."""
    poles = sort_poles(np.roots(den).astype(np.complex128))
    if poles.size < den.size - 1 or not np.all(poles.real < 0):
        return ()
    bank = cascade(poles)
    powers = monomials(bank, den.size - 1)
    return ((bank.a, bank.b, powers, int(np.any(poles.imag != 0))),)


def _drive(
    result: Array,
    den: Array,
    channels: list[tuple[int, int]],
    numerators: list[Array],
    signal: Sampled,
    *,
    impulse: int | None = None,
) -> None:
    """Add the response of all channels with one denominator to ``result``.

    With ``impulse`` the response to an impulse at that sample instead.
    """
    a, b, c, d, upper = realize(den, numerators)
    q, (n_samples, n_inputs) = b.size, signal.u.shape
    for (i, j), gain in zip(channels, d, strict=True):
        if gain and impulse is None:
            result[:, i] += gain * signal.direct[:, j]
    if q == 0:
        return
    states = States(signal, a, b, upper=upper if upper <= 1 else q)
    runner = states if impulse is None else states.impulse(impulse)
    block = np.empty((n_inputs * q, min(BLOCK, n_samples)))
    each = len(channels) > 1 and channels == [(k, k) for k in range(n_inputs)]
    for start in range(0, n_samples, BLOCK):
        stop = min(start + BLOCK, n_samples)
        runner.advance(start, stop, block)
        if each:
            own = block[:, : stop - start].reshape(n_inputs, q, -1)
            result[start:stop] += np.einsum("kq,kqt->tk", c, own)
            continue
        for (i, j), row in zip(channels, c, strict=True):
            result[start:stop, i] += row @ block[j * q : (j + 1) * q, : stop - start]
