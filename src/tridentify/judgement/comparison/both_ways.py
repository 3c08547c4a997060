"""Responses of models with growing modes: the growing part is worked out backward in time.

Forward, a mode ``exp(lambda t)`` with a positive real part magnifies whatever rounding there is,
and after some forty doublings nothing is left of the response. But its initial state is free here
anyway, and a free initial state is a free final state: with ``G = G_s + G_u``, the partial fraction
of decaying and growing modes, the response of ``G_u`` obeys in reversed time ``tau = T - t`` the
transfer function ``G_u(-q)``, whose modes decay. The two parts are simulated each in its direction,
and what both may do by themselves is what the free states of either end do.
"""

from __future__ import annotations

import numpy as np

from tridentify.models.simulate import free_responses, simulate
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

GROWN = 12.0
"""Of a mode's real part times the record's length, from which it is taken backward: exp(12) costs
five digits of sixteen, which are not missed; a mode near zero is as well known forward."""


def grows(model: TransferFunction, duration: float) -> bool:
    """Whether a mode grows so much that it is better taken backward, and can be.

    Parameters
    ----------
    model : TransferFunction
    duration : float
        [s].

    Examples
    --------
    >>> fast = TransferFunction([1.0], [1.0, -2.0])
    >>> grows(fast, 3.0), grows(fast, 60.0)
    (False, True)
    """
    dens = [den for row in model.den for den in row]
    poles = np.concatenate([np.roots(den) for den in dens])
    # a late input would have to be known beyond the ends of the record
    return not np.any(model.delay) and bool(np.any(poles.real * duration > GROWN))


def responses(model: TransferFunction, record: Record) -> tuple[Array, list[list[Array]]]:
    """Driven and free responses of a model without delays, growing modes backward.

    Parameters
    ----------
    model : TransferFunction
    record : Record
        Of the model's inputs.

    Returns
    -------
    driven : (n_samples, n_outputs) array
        From an unknown start.
    free : list of list of (n_samples, n) arrays
        Of every output.

    Examples
    --------
    >>> t = np.arange(200.0)
    >>> model = TransferFunction([1.0], [1.0, -1.0])
    >>> driven, free = responses(model, Record(np.ones(200), np.ones(200), t=t))
    >>> driven[:3, 0].round(6).tolist(), free[0][0][-3:, 0].round(4).tolist()
    ([-1.0, -1.0, -1.0], [0.1353, 0.3679, 1.0])
    """
    back = _reversed(record)
    far = GROWN / record.duration
    driven = np.zeros((record.n_samples, model.n_outputs))
    free: list[list[Array]] = [[] for _ in range(model.n_outputs)]
    for i in range(model.n_outputs):
        known: set[bytes] = set()
        for j in range(model.n_inputs):
            (num, den), (num_back, den_back) = split(model.num[i][j], model.den[i][j], far)
            own = record._derive(u=np.ascontiguousarray(record.u[:, [j]]))
            behind = back._derive(u=np.ascontiguousarray(back.u[:, [j]]))
            driven[:, i] += simulate(TransferFunction(num, den), own)[:, 0]
            driven[:, i] += simulate(TransferFunction(num_back, den_back), behind)[::-1, 0]
            key = model.den[i][j].tobytes()
            if key not in known:
                known.add(key)
                if den.size > 1:
                    free[i].append(free_responses(den, record))
                if den_back.size > 1:
                    free[i].append(free_responses(den_back, back)[::-1])
    return driven, free


def split(num: Array, den: Array, far: float) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Partial fraction into modes that grow slower and faster than a rate, the latter reversed.

    Parameters
    ----------
    num, den : array
        Descending powers, ``den`` monic.
    far : float
        Real part [1/s].

    Returns
    -------
    (num, den), (num, den)
        The first forward in time, with what passes at once; the second in reversed time.

    Examples
    --------
    >>> forward, backward = split(np.array([2.0, -1.0]), np.array([1.0, -1.0, -2.0]), 0.0)
    >>> [part.round(12).tolist() for part in (*forward, *backward)]
    [[0.0, 1.0], [1.0, 1.0], [-1.0], [1.0, 2.0]]
    """
    roots = np.roots(den)
    slow, fast = (np.atleast_1d(np.real(np.poly(roots[kept])))
                  for kept in (roots.real <= far, roots.real > far))  # fmt: skip
    n, n_fast = den.size - 1, fast.size - 1
    direct = num[0] if num.size == den.size else 0.0
    rest = np.pad(num, (den.size - num.size, 0)) - direct * den
    # rest = num_slow fast + num_fast slow
    columns = [np.pad(fast, (k, n - n_fast - 1 - k)) for k in range(n - n_fast)]
    columns += [np.pad(slow, (k, n_fast - 1 - k)) for k in range(n_fast)]
    parts = np.linalg.solve(np.array(columns).T, rest[1:])
    num_slow, num_fast = parts[: n - n_fast], parts[n - n_fast :]
    with_direct = direct * slow
    with_direct[1:] += num_slow
    signs = (-1.0) ** np.arange(n_fast, -1, -1)
    sign = (-1.0) ** n_fast
    back = sign * num_fast * signs[1:] if n_fast else np.zeros(1)
    return (with_direct if np.any(with_direct) else np.zeros(1), slow), (back, sign * fast * signs)


def _reversed(record: Record) -> Record:
    """The record in reversed time, its input doing between the samples what it did."""
    u = record.u[::-1]
    if record.behaviour == "zoh":
        # held until the next sample, which comes before it now
        u = np.vstack([u[1:], u[-1:]])
    return Record(
        np.ascontiguousarray(u),
        np.zeros(record.n_samples),
        t=record.t[-1] - record.t[::-1],
        intersample=record.behaviour,
        input_names=record.input_names,
        output_names=["reversed"],
    )
