"""The 3-2-1-1: pulses of three, two, one and one units with alternating signs.

It covers a wider band than a doublet, so it is right where the modes are known roughly (Jategaonkar
2006, chapter 2; Mulder, Sridhar & Breeman 1994). Its mean is not zero: one unit of the first sign
is left over.
"""

from __future__ import annotations

from tridentify.excitation.pulses import Pulses, pulse_train
from tridentify.excitation.signal import Excitation

PULSES = Pulses((3, 2, 1, 1), 1.6, "3-2-1-1 of")


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
