"""The doublet: one pulse up, one down; it leaves the trim where it was.

Its energy lies about ``2.33 / width`` [rad/s], see `tridentify.excitation.pulses`.
"""

from __future__ import annotations

from tridentify.excitation.pulses import Pulses, pulse_train
from tridentify.excitation.signal import Excitation

DOUBLET = Pulses((1, 1), 2.3, "doublet of 2 x")


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
