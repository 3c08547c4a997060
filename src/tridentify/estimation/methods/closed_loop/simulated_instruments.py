"""Refined instrumental variables in closed loop (CLSRIVC): the loop of the model as instruments.

SRIVC (`filtered.refined_instrumental_variable`) takes its instruments from the model driven by the
recorded input, which in a loop carries the noise. Where the controller is known, the loop of the
present model can be simulated without noise, and the instruments come from there:

    u_0 = the input of the loop of (b_hat / a_hat) and C, driven by r,   y_0 = (b_hat / a_hat) u_0,
    Z = [- p^k / a_hat y_0, p^j / a_hat u_0],
    Z' ((p^n / a_hat) y - Phi theta) = 0                                                      (1)

with the recorded ``u`` and ``y`` in `Phi`, filtered by ``1 / a_hat``, repeated until ``theta``
stands still. At a fixed point of (1) the equation error filtered by ``1 / a_hat`` is the output
error, and ``Z`` are its derivatives for the input ``u_0``:

    Z' (y - (b_hat / a_hat) u) = 0,                                                           (2)

which is solved here as the reference route solves it (`reference`): the fixed points are
the same, the way there is not. For white noise at the output and a controller that works on samples
the estimate is efficient among those with instruments.

*Standard errors.* Instruments that are not quite the noise-free regressors ``T`` cost accuracy, and
the covariance is ``sigma^2 (Z' T)^-1 Z' Z (Z' T)^-T`` (`returned_errors`), not that of a fit to the
simulated input.

*Between the samples.* As the authors do, the recorded ``u`` is taken as held. Of a controller in
continuous time it is not, and (2) is then biased, the more so the coarser the samples are
(Gonzalez, Pan, Rojas & Welsh 2024). `ThreeModel` with the same controller is without that error.

*What is known* is the controller in continuous time, of one input and one output, and where the
reference enters is found from the record (`closed_loop.simulated`). A controller that works on
samples is taken for the continuous one that it was made of; instruments need not be exact.

References
----------
M. Gilson, H. Garnier, P. Young & P. Van den Hof, in *Identification of Continuous-time Models from
Sampled Data* (Garnier & Wang, eds.), Springer 2008, chapter 5; IET Control Theory & Applications
5(10) (2011), 1147-1154.
R. Gonzalez, S. Pan, C. Rojas & J. Welsh, Automatica 166 (2024).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.closed_loop.known_controller import known_loop, refuse_unknown_loop
from tridentify.estimation.likelihood.question import silently
from tridentify.estimation.methods.base import Progress, check
from tridentify.estimation.methods.by_reference.passes import root
from tridentify.estimation.methods.by_reference.reference import completed
from tridentify.estimation.methods.by_reference.returned_errors import with_returned_errors
from tridentify.estimation.methods.capability import Capability
from tridentify.estimation.methods.closed_loop.second_stage import OPEN_LOOP
from tridentify.estimation.methods.output_error import OutputError
from tridentify.estimation.methods.route import refuse_unreferenced
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction


@dataclass(frozen=True)
class ClosedLoopRefinedInstrumentalVariable:
    """Refined instrumental variables in closed loop (CLSRIVC), with a known controller.

    Parameters
    ----------
    controller : TransferFunction
        ``C`` of ``u = r - C y`` or ``u = C (r - y)``, in continuous time.

    Raises
    ------
    OptionError
        It is no transfer function.

    References
    ----------
    .. [1] M. Gilson, H. Garnier, P. Young, P. Van den Hof, IET Control Theory & Applications 5(10)
       (2011), 1147-1154.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import ClosedLoopRefinedInstrumentalVariable, Record, Structure
    >>> from tridentify import TransferFunction, identify, simulate
    >>> r = np.sign(np.sin(np.arange(400) ** 1.5))
    >>> loop = TransferFunction([[[1, 4]], [[2]]], [[[1, 10]], [[1, 10]]])
    >>> u, y = simulate(loop, Record(r, np.column_stack([r, r]), dt=0.002)).T
    >>> record = Record(u, y, dt=0.002, reference=r, intersample="zoh")
    >>> method = ClosedLoopRefinedInstrumentalVariable(TransferFunction([3.0], [1.0]))
    >>> identify(record, Structure(1, 0), method).theta.round(1).tolist()
    [4.0, 2.0]
    """

    controller: TransferFunction

    name: ClassVar[str] = "ClosedLoopRefinedInstrumentalVariable"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = Capability.NONE
    """The plain case only."""

    def __post_init__(self) -> None:
        if not isinstance(self.controller, TransferFunction):
            raise OptionError(
                f"found controller={shown(self.controller)}; expected a TransferFunction; write "
                "for example TransferFunction([2.0, 1.0], [1.0, 0.0]), or use TwoStage(), which "
                "needs none"
            )

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Progress | None = None
    ) -> Estimate:
        """Estimate the coefficients.

        Parameters
        ----------
        records : sequence of Record
            Each with its references, one input and one output.
        structure : Structure
        progress : callable, optional

        Returns
        -------
        Estimate

        Raises
        ------
        OptionError
            A record has no reference.
        DataError, StructureError
            If records and structure are not usable or not supported; `DataError` too if the
            controller makes no stable loop.
        IdentifiabilityError
            If the data cannot determine the coefficients, or no reference moves.
        """
        say = progress or silently
        check(records, structure, self.name, self.capabilities)
        refuse_unreferenced(f"{self.name}(...)", records, "use ThreeModel(route='direct')")
        refuse_unknown_loop(records, structure, self.controller)
        say("the two-stage estimate")
        parts = [driven(record) for record in records]
        begun = [Loop(part, "sampled").instrument for part in parts]
        first = OPEN_LOOP.estimate(begun, structure, say)
        loops = [known_loop(part, first.model, self.controller, "sampled") for part in parts]
        found, told = with_returned_errors(root(loops, structure, first, OutputError, say))
        words = (told,) if told else ()
        return completed(Request.of(records, structure, self.name), found, *words)
