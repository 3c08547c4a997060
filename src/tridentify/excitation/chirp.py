"""The chirp, or frequency sweep: a sine whose frequency runs through a band.

With ``phi(t)`` the integral of the angular frequency, ``u = A w(t) sin phi(t)``. A linear sweep has
``phi = w_0 t + (w_1 - w_0) t^2 / (2 T)`` and equal power at all frequencies of the band, a
logarithmic one ``phi = w_0 T / log(w_1 / w_0) (exp(log(w_1 / w_0) t / T) - 1)`` and equal power in
every octave. The taper ``w`` raises and lowers the amplitude along half cosine waves (Tukey's
window), so that the input begins and ends at rest (Tischler & Remple 2012, chapter 5).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.excitation.checks import band_of, positive, samples_of
from tridentify.excitation.signal import Excitation
from tridentify.record.checks.samples import Intersample


def chirp(
    band: tuple[float, float],
    duration: float,
    *,
    dt: float,
    amplitude: float = 1.0,
    sweep: Literal["linear", "logarithmic"] = "linear",
    taper: float = 0.1,
    intersample: Intersample = "zoh",
) -> Excitation:
    """A frequency sweep.

    Parameters
    ----------
    band : (float, float)
        Lowest and highest angular frequency [rad/s]; the sweep goes upward.
    duration : float
        [s].
    dt : float
        Sampling interval [s].
    amplitude : float
    sweep : {"linear", "logarithmic"}
        How the frequency rises with time.
    taper : float
        Share of the duration in which the amplitude rises and falls, 0 to 1, half of it at each
        end.
    intersample : {"zoh", "foh", "band-limited"}
        What the input will do between the samples.

    Returns
    -------
    Excitation

    Raises
    ------
    OptionError
        The band is none, reaches beyond half the sampling rate, or begins at zero in a logarithmic
        sweep; the taper is not from 0 to 1.

    References
    ----------
    .. [1] M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed.,
       AIAA 2012, chapter 5.

    Examples
    --------
    >>> plan = chirp((0.5, 20.0), 60.0, dt=0.02, sweep="logarithmic")
    >>> plan.n_samples, float(plan.u[0, 0])
    (3000, 0.0)
    """
    dt = positive("dt", dt)
    low, high = band_of(band, np.pi / dt)
    n = samples_of("duration", positive("duration", duration), dt)
    size = positive("amplitude", amplitude)
    if sweep not in ("linear", "logarithmic") or (sweep == "logarithmic" and low == 0.0):
        raise OptionError(
            f"found sweep={shown(sweep)} from {low:g} rad/s; expected 'linear', or 'logarithmic' "
            "from a frequency above zero; choose one"
        )
    if not isinstance(taper, (int, float)) or not 0.0 <= taper <= 1.0:
        raise OptionError.found("taper=", taper, "a share of the duration from 0 to 1")
    t, span = np.arange(n) * dt, n * dt
    if sweep == "linear":
        phase = low * t + 0.5 * (high - low) * t**2 / span
    else:
        rate = np.log(high / low) / span
        phase = low / rate * np.expm1(rate * t)
    from scipy.signal.windows import tukey  # slow to import, seldom needed

    u = size * tukey(n, taper) * np.sin(phase)
    return Excitation(u, dt, intersample, f"{sweep} chirp of {low:.4g} to {high:.4g} rad/s")
