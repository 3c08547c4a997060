"""Pulses of whole units of time with alternating signs: doublet and 3-2-1-1.

A pulse train of unit ``D`` spreads its energy over a band about a frequency of its own; it excites
a mode best where the band lies on the mode. For a doublet, ``|U(w)| = 4 A sin^2(w D / 2) / w`` is
largest where ``tan x = 2 x``, ``x = w D / 2 = 1.166``: ``w D = 2.33``. A 3-2-1-1 is within 3 dB of
its largest from ``w D = 0.28`` to ``2.65``, and ``w D = 1.6`` puts the mode into the upper half of
that band, where it is also told from what lies above (Jategaonkar 2006, chapter 2).

The doublet leaves the trim where it was. The 3-2-1-1 covers a wider band, so it is right where the
modes are known roughly (Jategaonkar 2006, chapter 2; Mulder, Sridhar & Breeman 1994). Its mean is
not zero: one unit of the first sign is left over.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tridentify.errors import OptionError
from tridentify.excitation.checks import not_negative, positive, samples_of
from tridentify.excitation.signal import Excitation


class Pulses(NamedTuple):
    """Pulses of alternating sign.

    Attributes
    ----------
    units : tuple of int
        Length of each pulse, in units.
    per_frequency : float
        Unit times natural frequency of the mode that is to be excited.
    what : str
        Name of the signal.
    """

    units: tuple[int, ...]
    per_frequency: float
    what: str


def pulse_train(
    pulses: Pulses,
    amplitude: float,
    width: float | None,
    for_frequency: float | None,
    dt: float,
    lead: float,
    tail: float,
) -> Excitation:
    """Pulses of alternating sign, each a whole number of units long, at rest before and after.

    Parameters
    ----------
    pulses : Pulses
    amplitude : float
        Of the first pulse; its sign is the first pulse's.
    width, for_frequency : float, optional
        The unit [s], or the natural frequency of the mode that is to be excited [rad/s]; one of
        the two.
    dt, lead, tail : float
        Sampling interval, rest before and after [s].
    """
    dt = positive("dt", dt)
    if (width is None) == (for_frequency is None):
        raise OptionError(
            f"found width={width} and for_frequency={for_frequency}; expected one of the two; give "
            "the width of a pulse [s], or the natural frequency of the mode [rad/s]"
        )
    if width is None:
        width = pulses.per_frequency / positive("for_frequency", for_frequency)
    unit = samples_of("width", positive("width", width), dt)
    if not np.isfinite(amplitude) or amplitude == 0:
        raise OptionError(
            f"found amplitude={amplitude}; expected a finite number that is not zero; correct it"
        )
    lead_samples = round(not_negative("lead", lead) / dt)
    tail_samples = round(not_negative("tail", tail) / dt)
    parts = [np.zeros(lead_samples)]
    for k, length in enumerate(pulses.units):
        parts.append(np.full(length * unit, amplitude * (-1.0) ** k))
    parts.append(np.zeros(tail_samples))
    return Excitation(np.concatenate(parts), dt, "zoh", f"{pulses.what} {unit * dt:.6g} s")


DOUBLET = Pulses((1, 1), 2.3, "doublet of 2 x")
PULSES = Pulses((3, 2, 1, 1), 1.6, "3-2-1-1 of")


def doublet(
    amplitude: float,
    width: float | None = None,
    *,
    dt: float,
    for_frequency: float | None = None,
    lead: float = 0.0,
    tail: float = 0.0,
) -> Excitation:
    """Two pulses of opposite sign.

    Parameters
    ----------
    amplitude : float
        Of the first pulse, with its sign.
    width : float, optional
        Of each pulse [s], rounded to whole samples.
    dt : float
        Sampling interval [s].
    for_frequency : float, optional
        In place of `width`: natural frequency [rad/s] of the mode to be excited; the width is then
        2.3 over it.
    lead, tail : float
        Rest before and after [s].

    Returns
    -------
    Excitation
        Held between the samples.

    Raises
    ------
    OptionError
        A time is not positive, a pulse is shorter than a sample, or both or neither of `width` and
        `for_frequency` are given.

    References
    ----------
    .. [1] R. V. Jategaonkar, Flight Vehicle System Identification: A Time Domain Methodology,
       AIAA 2006, chapter 2.

    Examples
    --------
    >>> doublet(0.05, dt=0.02, for_frequency=4.6, lead=1.0, tail=5.0)
    Excitation(doublet of 2 x 0.5 s: 350 samples, 7 s, dt=0.02 s, zoh, u: 0.05)
    """
    return pulse_train(DOUBLET, amplitude, width, for_frequency, dt, lead, tail)


def three_two_one_one(
    amplitude: float,
    width: float | None = None,
    *,
    dt: float,
    for_frequency: float | None = None,
    lead: float = 0.0,
    tail: float = 0.0,
) -> Excitation:
    """Pulses of 3, 2, 1 and 1 units with alternating signs.

    Parameters
    ----------
    amplitude : float
        Of the first pulse, with its sign.
    width : float, optional
        Of one unit [s], rounded to whole samples.
    dt : float
        Sampling interval [s].
    for_frequency : float, optional
        In place of `width`: natural frequency [rad/s] of the mode to be excited; the unit is then
        1.6 over it.
    lead, tail : float
        Rest before and after [s].

    Returns
    -------
    Excitation
        Held between the samples.

    Raises
    ------
    OptionError
        As `doublet`.

    References
    ----------
    .. [1] R. V. Jategaonkar, Flight Vehicle System Identification: A Time Domain Methodology,
       AIAA 2006, chapter 2.

    Examples
    --------
    >>> three_two_one_one(1.0, 1.0, dt=1.0).u.ravel().tolist()
    [1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0]
    """
    return pulse_train(PULSES, amplitude, width, for_frequency, dt, lead, tail)
