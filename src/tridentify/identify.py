"""The front door: records and a structure in, an estimate out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from tridentify.errors import ConvergenceError
from tridentify.estimate import Estimate
from tridentify.methods.base import Method, Progress
from tridentify.methods.three_model import ThreeModel
from tridentify.record import Record
from tridentify.structure import Structure

METHODS: Mapping[str, Callable[[], Method]] = MappingProxyType({"three-model": ThreeModel})
"""Name -> method with its default options; the command line and the contract tests read it."""


def identify(
    records: Record | Sequence[Record],
    structure: Structure,
    method: Method | None = None,
    *,
    throw: bool = True,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the physical coefficients of a continuous-time model.

    Parameters
    ----------
    records : Record or sequence of Record
        One or several experiments on the same system.
    structure : Structure
        Numbers of poles and zeros, and which nuisance terms are estimated along.
    method : Method, optional
        Default ``ThreeModel()``.
    throw : bool
        Whether an estimate that is not usable raises; otherwise it is returned and its
        ``status`` says so.
    progress : callable, optional
        Called with a few words at the start of each stage.

    Returns
    -------
    Estimate

    Raises
    ------
    DataError, StructureError
        If records and structure are not usable.
    IdentifiabilityError
        If the data cannot determine the coefficients.
    ConvergenceError
        If no stationary point was reached and ``throw`` is true.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> u = np.sign(np.sin(np.arange(200) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))
    >>> identify(Record(u, y, dt=0.02), Structure(1, 0)).parameters["a0"].value
    4.0
    """
    listed = [records] if isinstance(records, Record) else list(records)
    chosen: Method = ThreeModel() if method is None else method
    estimate = chosen.estimate(listed, structure, progress)
    if throw and not estimate.status.ok:
        raise ConvergenceError(
            f"{chosen.name} ended without a usable estimate: {estimate.status.message}; "
            f"{estimate.status.remedy} (throw=False returns the estimate all the same)"
        )
    return estimate
