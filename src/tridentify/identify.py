"""The front door: records and a structure in, an estimate out."""

from __future__ import annotations

from collections.abc import Sequence

from tridentify.choice import METHODS, checked_method, listed, with_behaviour, with_judgement
from tridentify.errors import ConvergenceError, OptionError, UnsupportedOrderError
from tridentify.estimate import Estimate, Status
from tridentify.methods.base import Method, Progress
from tridentify.numerics.threads import one_blas_thread
from tridentify.record import Record
from tridentify.structure import Structure

__all__ = ["METHODS", "identify"]


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
    OptionError
        If ``method`` is a name or a class instead of a method with its options.
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
    given = listed(records)
    if not isinstance(structure, Structure):
        raise OptionError(
            f"found structure={type(structure).__name__}; expected a Structure; write for example "
            "Structure(poles=2, zeros=1)"
        )
    chosen = checked_method(method)
    with one_blas_thread():
        estimate, seen, between, told = with_behaviour(chosen, given, structure, progress)
        estimate = with_judgement(estimate, seen, chosen, between, told)
    if throw and estimate.status is Status.AT_SAMPLING_LIMIT:
        raise UnsupportedOrderError(
            f"found a pole that runs away from the record with {structure.poles} poles: "
            f"{estimate.status.message}; expected poles that leave a trace between the samples; "
            f"{estimate.status.remedy} (throw=False returns the estimate all the same)"
        )
    if throw and not estimate.status.ok:
        raise ConvergenceError(
            f"{chosen.name} ended without a usable estimate: {estimate.status.message}; "
            f"{estimate.status.remedy} (throw=False returns the estimate all the same)"
        )
    return estimate
