"""State-variable-filter instrumental variables: the same regression, with the bias taken out.

The equation error ``eps = (a / c) y - (b / c) u - ...`` of
`methods.filtered.state_variable_filters` is made orthogonal not to its own regressors, which
contain the noise of ``y``, but to instruments that do not:

    Z' eps = 0,    Z = [K y_0, - K u, ...],

with the same filtered inputs, and the output ``y_0`` of a model in place of the recorded one (Young
1970; Soderstrom & Stoica 1989, section 8.2). The first model is that of `svf_least_squares`, with
unstable poles reflected; the model found gives the instruments of the next pass, which brings their
quality to that of the true output. ``y_0`` is known between the samples, so ``Z`` is exact.

``Z' eps`` has mean zero at the truth whatever the noise, as long as it has nothing to do with
``u``: the estimate is consistent, but for the error of order ``dt^2`` of joining the samples of
``y`` by lines. It is not efficient, for the noise in ``eps`` is ``(a / c) e`` and not white;
prefiltering with ``1 / a`` makes it so (`refined_instrumental_variable`). The covariance is the
asymptotic one for white noise at the samples, ``Z`` filtered backward by ``a / c``.

*Passes*: three, the number after which the instruments' error no longer shows to first order. The
one whose model has the lowest AICc of its simulated output is reported.

*Filter*: as for least squares, but the filter is taken whose model *after one pass* has the lowest
AICc. To judge by the biased models would prefer the filter whose least squares happen to be helped
by the noise at hand, and that choice gives back a part of the bias: for 3 / (s^2 + 4 s + 3), 1016
samples and 10 dB it moved the mean of the coefficients by 0.7 %, a sixth of their standard error.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar

from tridentify.errors import IdentifiabilityError
from tridentify.estimation.answer.estimate import Estimate, Pass
from tridentify.estimation.methods.base import Progress, check
from tridentify.estimation.methods.capability import Capability, refuse_missing
from tridentify.estimation.methods.filtered.filter_cascade import checked_filter
from tridentify.estimation.methods.filtered.state_variable_filters import SvfFit, fit
from tridentify.estimation.methods.filtered.svf_least_squares import (
    Chosen,
    described,
    least_squares,
    svf_estimate,
)
from tridentify.record.record import Record
from tridentify.structure import Structure

PASSES = 3
"""Passes with instruments from the model of the pass before, by default; the best of them
counts."""


@dataclass(frozen=True)
class SvfInstrumentalVariable:
    """Instrumental variables on the filtered input and output: consistent, not efficient.

    Parameters
    ----------
    filter : sequence of float, optional
        Coefficients of ``c(p)``, descending powers; stable, of at least as many roots as there are
        poles. None: ``(p + lambda)^n`` chosen from the record.

    Raises
    ------
    OptionError
        For a filter that makes no sense.

    References
    ----------
    .. [1] P. C. Young, Automatica 6(2) (1970), 271-287.
    .. [2] T. Soderstrom, P. Stoica, System Identification, Prentice Hall 1989, chapter 8.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, SvfInstrumentalVariable, TransferFunction
    >>> from tridentify import identify, simulate
    >>> u = np.sign(np.sin(np.arange(100) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.01))
    >>> estimate = identify(Record(u, y, dt=0.01), Structure(1, 0), SvfInstrumentalVariable())
    >>> estimate.theta.round(2).tolist()
    [4.0, 2.0]
    """

    filter: Sequence[float] | None = None

    name: ClassVar[str] = "SvfInstrumentalVariable"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = Capability.NONE
    """The plain case only."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "filter", checked_filter(self.filter))

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Progress | None = None
    ) -> Estimate:
        """Estimate the coefficients.

        Parameters
        ----------
        records : sequence of Record
        structure : Structure
        progress : callable, optional

        Returns
        -------
        Estimate
            Its status is `Status.SETTLED`, as the equations solved are not those of the least
            output error; ``nan`` covariance if a pole was reflected.

        Raises
        ------
        DataError, StructureError
            If records and structure are not usable or not supported, such as missing outputs.
        IdentifiabilityError
            If the filtered signals are linearly dependent.
        """
        check(records, structure, self.name, self.capabilities)
        refuse_missing(records, self.name)
        if progress:
            progress("instrumental variables on the filtered record")
        first = _refiltered(least_squares(records, structure, self.filter))
        found, passes = instrumental_passes(first)
        stopped = f"{len(passes) - 1} passes with instruments from the model before"
        return svf_estimate(first, found, passes, records, structure, stopped, self.name)


def _refiltered(chosen: Chosen) -> Chosen:
    """The filter whose model after one pass has the lowest AICc."""
    found = []
    for one in chosen.tried:
        with suppress(IdentifiabilityError):
            after = fit(chosen.problem, one.experiments, one.fit.c, one.fit.model)
            found.append((after.model.criterion, one))
    if not found:
        return chosen
    best = min(found, key=lambda pair: pair[0])[1]
    return replace(chosen, experiments=best.experiments, fit=best.fit, label=best.label)


def instrumental_passes(chosen: Chosen, most: int = PASSES) -> tuple[SvfFit, tuple[Pass, ...]]:
    """Passes that begin with a least-squares model; the best of them, and all up to it.

    Parameters
    ----------
    chosen : Chosen
    most : int
        Number of passes.

    Raises
    ------
    IdentifiabilityError
        If the first pass finds signals that cannot be told apart.
    """
    found: list[SvfFit] = []
    label = chosen.label
    passes = [described(1, chosen.fit, f"least squares on the recorded output, {label}")]
    source = chosen.fit.model
    for number in range(most):
        try:
            one = fit(chosen.problem, chosen.experiments, chosen.fit.c, source)
        except IdentifiabilityError:
            if not found:
                raise
            break
        note = f"instruments from pass {number + 1}, {label}"
        found.append(one)
        passes.append(described(number + 2, one, note))
        source = one.model
    best = min(range(len(found)), key=lambda k: found[k].model.criterion)
    return found[best], tuple(passes[: best + 2])
