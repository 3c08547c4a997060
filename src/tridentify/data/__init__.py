"""Records that ship with the package, so that an example runs as it stands.

`short_period` is what ``tridentify demo`` works on. Its true coefficients and where they come from
are in ``short_period.json`` and ``README.md`` beside this file.
"""

from __future__ import annotations

from importlib.resources import as_file, files

from tridentify.record.formats.read import read_record
from tridentify.record.record import Record

__all__ = ["short_period"]


def short_period() -> Record:
    """Ten seconds of simulated flight test: an aircraft's short period after elevator pulses.

    Returns
    -------
    Record
        501 samples at 50 Hz. Input ``delta_e`` [rad], held between samples; outputs ``alpha`` [rad]
        and ``q`` [rad/s] with white noise of 0.25 deg and 0.2 deg/s. JSBSim, a nonlinear flight
        dynamics engine, flew it; the coefficients of its linearised equations are
        ``a1 = 2.042``, ``a0 = 12.29``, for ``q`` ``b1 = -11.97``, ``b0 = -11.96``.

    Examples
    --------
    >>> from tridentify.data import short_period
    >>> short_period()
    Record('short_period', 501 samples, 10 s, dt=0.02 s, zoh, inputs: delta_e [rad],
           outputs: alpha [rad], q [rad/s])
    """
    with as_file(files(__name__) / "short_period.csv") as path:
        return read_record(
            path,
            time="t",
            inputs=["delta_e"],
            outputs=["alpha", "q"],
            units={"t": "s", "delta_e": "rad", "alpha": "rad", "q": "rad/s"},
            intersample="zoh",
        )
