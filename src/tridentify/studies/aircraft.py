"""The paper's aircraft, over many noise draws.

The plant is the short-period motion of an aircraft,

    y'' + a1 y' + a0 y = b0 x,        a1 = 1 / s, a0 = 3 / s^2, b0 = 0.5 / s^2   (the paper's b),

at rest, driven by a unit step at the first sample. The noise is white and Gaussian, with a
standard deviation of `ratio` times the root mean square of ``y*`` over the record. Every noisy
record goes through three estimators:

- *Step 2 alone*: the series-parallel model on the recorded output (`studies.step_2_alone`), with
  the paper's filter ``c = p^3 + 5 p^2 + 6 p + 7``;
- *Steps 1-4*: ``ThreeModel.paper`` with three operators of eq. (4) and the same filter;
- *ThreeModel()*: the strategy with the changes that make it efficient.

All of them know that the record starts at rest and has no offset. What the paper leaves open:

*gamma* is not printed. Here it is the geometric mean of the corner frequencies of the printed
filter, ``7^(1/3) = 1.91 rad/s``: a value of the order of the filter's bandwidth that uses neither
the true coefficients nor the results. It hardly matters: at noise ratio 1, with 200 draws, gamma
between 1 and 4 rad/s gave medians of a1 from 0.78 to 0.80 on the short records and from 0.69 to
0.85 on the long ones, all with about the same spread. A copy of the file takes another one.

*The noise-to-signal ratio* is not defined; see above for the reading that is used.

*The record*: 5 s at 0.02 s are 250 samples, not 100. Here it is 100 samples at 0.05 s, and, where
the averages are to be seen behind the noise, 1000 samples over 50 s.

The study is declared in a file, ``studies/files/aircraft.toml``: it is run as any other, with the
same draws, and told in the paper's form (`studies.aircraft_result`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tridentify.studies.aircraft_result import AircraftResult
from tridentify.studies.base import Count
from tridentify.studies.declared.reading import read_study, shipped_study
from tridentify.studies.declared.run import run_study


@dataclass(frozen=True)
class AircraftStudy:
    """The paper's study of noise levels, as distributions over noise draws.

    Examples
    --------
    >>> AircraftStudy().name
    'aircraft'
    """

    name: str = "aircraft"
    description: str = "the paper's aircraft at five noise levels, next to the Cramer-Rao bound"

    def run(
        self,
        *,
        draws: int = 200,
        seed: int = 0,
        workers: Any = None,
        progress: Count | None = None,
    ) -> AircraftResult:
        """Estimate the coefficients from every noisy record.

        Parameters
        ----------
        draws : int
            Noise draws at each ratio and record length; without noise there is one record.
        seed : int
            Of all draws, 0 or more.
        workers : int, str or distributed.Client, optional
            As `run_study` takes them.
        progress : callable, optional
            Called with the number of estimates that are done and the number of all.

        Returns
        -------
        AircraftResult

        Raises
        ------
        OptionError
            For numbers that make no sense.
        TridentifyError
            A process died again and again.
        """
        declared = read_study(shipped_study(self.name))
        return AircraftResult.of(
            run_study(declared, workers=workers, draws=draws, seed=seed, progress=progress)
        )
