"""Pseudo-random binary sequences of maximum length.

A shift register of ``n`` bits whose input is the sum modulo 2 of chosen bits (the coefficients of a
primitive polynomial) runs through all ``N = 2^n - 1`` states but zero before it repeats. Its output
has one more one than zeros; written as levels ``+1, -1`` its periodic autocorrelation is 1 at lag
zero and ``-1 / N`` at every other lag (Golomb 1967), as near to white noise as a binary signal
comes. A sequence held for ``T_c`` [s] a bit has the spectrum ``(sin x / x)^2``, ``x = w T_c / 2``:
half its power at ``2.8 / T_c`` [rad/s], nothing at ``2 pi / T_c``; its lines lie ``2 pi / (N T_c)``
apart (Soderstrom & Stoica 1989, section 5.3).

Several inputs get the same sequence, each later by an equal share of the period: two of them are
correlated at that one lag only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import OptionError, shown
from tridentify.excitation.checks import count, levels_of, positive, samples_of
from tridentify.excitation.signal import Excitation

TAPS: dict[int, tuple[int, ...]] = {
    2: (2, 1),
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 6, 4, 1),
    13: (13, 4, 3, 1),
    14: (14, 5, 3, 1),
    15: (15, 14),
    16: (16, 15, 13, 4),
    17: (17, 14),
    18: (18, 11),
    19: (19, 6, 2, 1),
    20: (20, 17),
}
"""Bits that are fed back, counted from one, by the length of the register."""


def prbs(
    order: int,
    *,
    dt: float,
    clock: float | None = None,
    levels: tuple[float, float] = (-1.0, 1.0),
    periods: int = 1,
    register: Sequence[int] | None = None,
    n_inputs: int = 1,
) -> Excitation:
    """A maximum-length sequence.

    Parameters
    ----------
    order : int
        Bits of the register, 2 to 20; a period has ``2^order - 1`` bits.
    dt : float
        Sampling interval [s].
    clock : float, optional
        Time that each bit is held [s], a whole number of sampling intervals; one by default.
    levels : (float, float)
        Lower and upper level.
    periods : int
        How often the sequence is run through.
    register : sequence of int, optional
        Initial bits, not all zero: where in the period the signal begins. All ones by default.
    n_inputs : int
        Inputs beyond the first are delayed by equal shares of the period.

    Returns
    -------
    Excitation
        Held between the samples.

    Raises
    ------
    OptionError
        The order is not offered, the register does not fit, or the clock is not a whole number of
        sampling intervals.

    References
    ----------
    .. [1] S. W. Golomb, Shift Register Sequences, Holden-Day 1967.
    .. [2] T. Soderstrom, P. Stoica, System Identification, Prentice Hall 1989, section 5.3.

    Examples
    --------
    >>> plan = prbs(3, dt=0.1, clock=0.2)
    >>> plan.u.ravel()[::2].tolist()
    [1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0]
    >>> plan.period, float(plan.crest_factor[0])
    (14, 1.0)
    """
    dt = positive("dt", dt)
    if order not in TAPS or isinstance(order, bool):
        raise OptionError(f"found order={shown(order)}; expected 2 to 20; choose one")
    low, high = levels_of(levels)
    clock = dt if clock is None else positive("clock", clock)
    held = samples_of("clock", clock, dt, exact=True)
    inputs = count("n_inputs", n_inputs, most=2**order - 1)
    bits = sequence(order, register)
    columns = [np.roll(bits, (k * bits.size) // inputs) for k in range(inputs)]
    one = np.repeat(np.column_stack(columns), held, axis=0)
    samples_of("signal", one.shape[0] * count("periods", periods) * dt, dt)
    u = np.where(np.tile(one, (periods, 1)) > 0, high, low)
    what = f"PRBS of {order} stages, {held * dt:.6g} s a bit"
    return Excitation(u, dt, "zoh", what, one.shape[0])


def sequence(order: int, register: Sequence[int] | None = None) -> NDArray[np.int8]:
    """One period of a maximum-length sequence, zeros and ones.

    Parameters
    ----------
    order : int
        2 to 20.
    register : sequence of int, optional
        Initial bits, the oldest last.

    Returns
    -------
    (2^order - 1,) int array

    Examples
    --------
    >>> sequence(3).tolist()
    [1, 1, 1, 0, 0, 1, 0]
    """
    given = [1] * order if register is None else list(register)
    if len(given) != order or any(bit not in (0, 1) for bit in given) or not any(given):
        raise OptionError.found("register=", register, f"{order} bits of 0 and 1, not all zero")
    # what is newest stands first in the register, so the output begins with its last bit
    out = given[::-1]
    taps = TAPS[order]
    for _ in range(2**order - 1 - order):
        bit = 0
        for tap in taps:
            bit ^= out[-tap]
        out.append(bit)
    return np.array(out, dtype=np.int8)
