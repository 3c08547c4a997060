"""Whether numbers have room in a float: the limits, and what is said beyond them.

A float reaches from 1e-308 to 1e308, and estimation squares nearly everything. Signals and time
are scaled before they are squared, so nanoseconds and years, micro- and gigavolts give one answer;
what no scaling can help is a coefficient whose own variance has no room. Per unit of time that
decides by powers: a model of ``n`` poles at the rate ``r`` has ``a_0 = r^n`` and a variance of the
order ``r^2n``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tridentify.errors import ScaleError, shown
from tridentify.numerics.arrays import Array, Complex

LARGEST_SAMPLE = 1e300
"""Largest sample of a record: differences, and sums over 1e8 samples, are floats."""
LARGEST_SIGNAL = 1e40
"""Largest signal to identify from, and inverted smallest: a gain may then be 1e80, and the product
of two variances of one is a float. What SI units measure lies between 1e-35 and 1e35."""
LARGEST_SPAN = 1e40
"""Longest record to identify from and, inverted, shortest step [s]: as of signals, so that a slope
of a signal, or its integral, has a variance too."""
LARGEST_TIME = 1e150
"""Longest record and, inverted, shortest step [s]: squares of time and of rates are floats."""
MOST_STEPS = 2.0**52
"""Duration in steps of a typical length, above which rounding swallows a step at the end."""
LARGEST_COEFFICIENT = 1e145
"""Largest coefficient, and inverted smallest: its square has a factor of 1e18 to spare."""
LARGEST_KNOWN = 1e150
"""Largest number, and inverted smallest, known of a coefficient: its square is a float."""
REACH = 1e30
"""How far what is known of a coefficient may lie from the size that a record gives it: squares of
both stand beside each other in one sum, and 1e60 leaves no digit of the smaller one."""
MOST_RATE = 1e12
"""A filter's rate times a step, and inverted times the record: beyond it passes the samples as they
are, or integrates them, to the last digit that a float leaves for the difference."""
MARGIN = 10.0
"""Poles are sought up to so many times the inverse of a step, and down to that of the record."""


def check_samples(label: str, samples: Array) -> None:
    """Refuse samples whose sums have no room; ``nan`` is passed over.

    Raises
    ------
    ScaleError
    """
    high, low = np.fmax.reduce(samples, axis=None), np.fmin.reduce(samples, axis=None)
    largest = max(float(high), -float(low))
    if largest > LARGEST_SAMPLE:
        raise ScaleError(
            f"found a value of {largest:.3g} in {label}; expected at most {LARGEST_SAMPLE:.0e}, as "
            "sums would leave the range of numbers; mark it as missing (nan) if it stands for "
            "none, or choose another unit"
        )


def check_time(first: float, last: float, step: float) -> None:
    """Refuse a time axis on which rates, or single steps, have no room.

    Parameters
    ----------
    first, last : float
        Instants [s].
    step : float
        Typical distance of two of them [s].

    Raises
    ------
    ScaleError

    Examples
    --------
    >>> check_time(0.0, 3e10, 1e-3)
    """
    half = 0.5 * last - 0.5 * first
    if not (2.0 * half <= LARGEST_TIME and step >= 1.0 / LARGEST_TIME):
        raise ScaleError(
            f"found steps of {step:.3g} s in a record from {first:.3g} s to {last:.3g} s; expected "
            f"steps of at least {1.0 / LARGEST_TIME:.0e} s and a duration of at most "
            f"{LARGEST_TIME:.0e} s; choose another unit of time"
        )
    if 2.0 * half > MOST_STEPS * step:
        raise ScaleError(
            f"found steps of {step:.3g} s in a record of {2.0 * half:.3g} s; expected a duration "
            f"of at most {MOST_STEPS:.1e} steps, beyond which rounding swallows them; cut the "
            "record at its gap, or correct the time"
        )


def check_coefficients(
    orders: Sequence[tuple[int, int, float]], shortest: float, longest: float
) -> None:
    """Refuse orders of which the coefficients, per unit of time and signal, have no room.

    Parameters
    ----------
    orders : sequence of (int, int, float)
        Poles, zeros, and size of the output over that of the input, of every channel.
    shortest, longest : float
        Typical step and duration [s].

    Raises
    ------
    ScaleError

    Examples
    --------
    >>> check_coefficients([(2, 1, 1.0)], 1e-9, 1e-6)
    """
    rates = (math.log10(MARGIN / shortest), -math.log10(MARGIN * longest))
    room = math.log10(LARGEST_COEFFICIENT)
    for n, m, ratio in orders:
        powers = [n * rate for rate in rates]
        gains = [math.log10(ratio) + k * rate for rate in rates for k in (n - m, n)]
        worst = max([*powers, *gains], key=abs)
        if abs(worst) > room:
            raise ScaleError(
                f"found coefficients of the order 1e{worst:+.0f} for {n} poles, from steps of "
                f"{shortest:.3g} s, a record of {longest:.3g} s and outputs {ratio:.3g} times the "
                f"inputs; expected 1e-{room:.0f} to 1e+{room:.0f}, whose squares are numbers; "
                "choose another unit of time, or of the signals"
            )


def check_span(shortest: float, longest: float) -> None:
    """Refuse a time axis on which integrals of signals, or slopes of them, have no variance.

    Parameters
    ----------
    shortest, longest : float
        Typical step and duration [s].

    Raises
    ------
    ScaleError

    Examples
    --------
    >>> check_span(1e-15, 1e20)
    """
    if not (longest <= LARGEST_SPAN and shortest >= 1.0 / LARGEST_SPAN):
        raise ScaleError(
            f"found steps of {shortest:.3g} s in a record of {longest:.3g} s to identify from; "
            f"expected steps of at least {1.0 / LARGEST_SPAN:.0e} s and a duration of at most "
            f"{LARGEST_SPAN:.0e} s; choose another unit of time"
        )


def check_filter(roots: Complex, what: str, shortest: float, longest: float) -> None:
    """Refuse a filter that decides everything within, or nothing throughout, a record.

    Parameters
    ----------
    roots : ndarray
        Poles of the filter [1/s].
    what : str
        What to call it.
    shortest, longest : float
        Typical step and duration [s].

    Raises
    ------
    ScaleError

    Examples
    --------
    >>> check_filter(np.array([-2.0 + 0j]), "the filter", 0.1, 10.0)
    """
    sizes = np.abs(roots)
    far = sizes.max() > MOST_RATE / shortest or sizes.min() < 1.0 / MOST_RATE / longest
    if far:
        raise ScaleError(
            f"found {what} with roots of {shown(sizes.min().item())} to "
            f"{shown(sizes.max().item())} rad/s for steps of {shortest:.3g} s in a record of "
            f"{longest:.3g} s; expected at most {MOST_RATE:.0e} per step and no less than "
            f"{1.0 / MOST_RATE:.0e} per record; choose rates that the record can show"
        )


def check_known(what: str, value: float) -> str | None:
    """Say what is wrong with a number that is known of a coefficient, or None.

    Examples
    --------
    >>> check_known("a value", 1e-200)
    'a value of 1e-200; expected zero, or a size of 1e-150 to 1e+150, whose square is a number'
    >>> check_known("a value", 0.0)
    """
    size = abs(value)
    if size == 0.0 or 1.0 / LARGEST_KNOWN <= size <= LARGEST_KNOWN:
        return None
    return (
        f"{what} of {value:.6g}; expected zero, or a size of {1.0 / LARGEST_KNOWN:.0e} to "
        f"{LARGEST_KNOWN:.0e}, whose square is a number"
    )
