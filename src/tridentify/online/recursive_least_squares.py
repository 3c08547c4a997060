"""Recursive least squares on the equation error (`online.equation`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from tridentify.online.asked import check_choice, check_forgetting
from tridentify.online.equation import KINDS, EquationError
from tridentify.transfer_function import TransferFunction


@dataclass(frozen=True)
class RecursiveLeastSquares(EquationError):
    """Recursive least squares on state-variable filters.

    Parameters
    ----------
    forgetting : float
        Factor by which the past counts less with every sample; 1 forgets nothing.
    forget : {"exponential", "directional", "resetting"}
        Whether all of the past fades (as long as the input renews it), only what the new sample
        speaks of, or nothing, but its weight is cut to a tenth every ``1 / (1 - forgetting)``
        samples.
    filter : sequence of float, optional
        Coefficients of ``c(p)``, descending powers, stable, of a degree not below the number of
        poles. Without it the first samples are searched.
    start : TransferFunction or Estimate, optional
        Model whose denominator is the filter.
    on_change : {"flag", "restart"}
        Whether a change of the coefficients is only flagged, or makes the estimator begin anew on
        the samples since.

    Raises
    ------
    OptionError
        An option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, online, simulate
    >>> u = np.sign(np.sin(np.arange(500) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.01))
    >>> method = online.RecursiveLeastSquares(filter=(1.0, 5.0))
    >>> found = online.run(method, Record(u, y, dt=0.01), Structure(1, 0))
    >>> found.estimate.theta.round(2).tolist()
    [4.0, 2.0]
    """

    forgetting: float = 1.0
    forget: str = "exponential"
    filter: tuple[float, ...] | None = None
    start: TransferFunction | None = None
    on_change: str = "flag"

    name: ClassVar[str] = "recursive-least-squares"

    def __post_init__(self) -> None:
        check_forgetting(self.forgetting)
        check_choice("forget", self.forget, tuple(KINDS))
        self._check()
