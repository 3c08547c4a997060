"""What would be flown otherwise: usual inputs of a given amplitude, length and sampling."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tridentify.errors import OptionError
from tridentify.excitation.checks import samples_of
from tridentify.excitation.multisine import multisine
from tridentify.excitation.prbs import prbs
from tridentify.excitation.pulses import doublet, three_two_one_one
from tridentify.excitation.signal import Excitation
from tridentify.numerics.arrays import Array
from tridentify.transfer_function import TransferFunction

HALF_POWER = 2.8
"""Clock period times the fastest frequency: there ``sinc(omega T / 2)^2``, the spectrum of a PRBS,
is half of its largest value."""


def usual_inputs(
    model: TransferFunction,
    limit: Array,
    fastest: float,
    band: tuple[float, float],
    duration: float,
    dt: float,
) -> list[Excitation]:
    """A PRBS, a multisine with equal power in a band, a 3-2-1-1 and a doublet.

    Parameters
    ----------
    model : TransferFunction
        Pulses are for the geometric mean of its natural frequencies.
    limit : (n_inputs,) array
        Amplitudes.
    fastest : float
        Where the PRBS has half its power [rad/s].
    band : (float, float)
        Of the multisine [rad/s], cut at nine tenths of half the sampling rate.
    duration, dt : float
        [s].

    Returns
    -------
    list of Excitation
        Those that can be made at this length.
    """

    def flat() -> Excitation:
        period = samples_of("duration", duration, dt) * dt
        high = min(band[1], 0.9 * np.pi / dt)
        return multisine(period, dt=dt, band=(band[0], high), n_inputs=limit.size, amplitude=limit)

    makers: tuple[Callable[[], Excitation], ...] = (
        lambda: _random(limit, fastest, duration, dt),
        flat,
        lambda: _pulses(model, limit, duration, dt, three=True),
        lambda: _pulses(model, limit, duration, dt, three=False),
    )
    found = []
    for make in makers:
        try:
            found.append(make())
        except OptionError:
            continue
    return found


def _random(limit: Array, fastest: float, duration: float, dt: float) -> Excitation:
    """A PRBS cut to length."""
    n = samples_of("duration", duration, dt)
    held = max(round(HALF_POWER / fastest / dt), 1)
    order = int(np.clip(np.ceil(np.log2(n / held + 1.0)), 2, 20))
    whole = prbs(order, dt=dt, clock=held * dt, n_inputs=limit.size)
    return Excitation(whole.u[:n] * limit, dt, "zoh", f"{whole.what}, cut to length")


def _pulses(
    model: TransferFunction, limit: Array, duration: float, dt: float, *, three: bool
) -> Excitation:
    """One input after the other, each with an equal share of the time."""
    poles = np.concatenate([np.roots(den) for row in model.den for den in row])
    sizes = np.abs(poles[np.abs(poles) > 0])
    if not sizes.size:
        raise OptionError("found only integrators; expected a natural frequency; give a width")
    n = samples_of("duration", duration, dt)
    share = n // limit.size
    make = three_two_one_one if three else doublet
    one = make(1.0, dt=dt, for_frequency=float(np.exp(np.mean(np.log(sizes)))))
    if one.n_samples > share:
        raise OptionError("found no room for the pulses; expected a longer duration; lengthen it")
    u = np.zeros((n, limit.size))
    for j, size in enumerate(limit):
        u[j * share : j * share + one.n_samples, j] = size * one.u[:, 0]
    return Excitation(u, dt, "zoh", one.what)
