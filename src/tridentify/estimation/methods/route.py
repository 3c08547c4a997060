"""What to make of a controller that may have been running: the routes to an estimate.

A controller acts on what it measures, noise and all, so that the input carries the noise, and the
open-loop fit is biased.

- *open-loop*: nothing is made of it.
- *reference*: what of input and output follows a recorded reference is fitted; noise has no part
  in it, whatever the controller.
- *direct*: input and output as they are, the noise with a model. Innovations are independent of
  past inputs, so that the maximum of the likelihood is where it would be without a controller,
  *if* the model of the noise is right. Where it is not, the coefficients are wrong.

References: L. Ljung, *System Identification*, 2nd ed., section 13.4 (1999). U. Forssell & L. Ljung,
Automatica 35 (1999) 1215-1241.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.closed_loop.moving import any_moves, refuse_still
from tridentify.estimation.likelihood.noise.noise_model import NoiseChoice
from tridentify.record.record import Record

Route = Literal["auto", "open-loop", "reference", "direct"]

CHOICES = ("auto", "open-loop", "reference", "direct")


def check_route(route: object, noise: NoiseChoice, loss: str) -> None:
    """Refuse an unknown route, or options that contradict it.

    Raises
    ------
    OptionError
    """
    if route not in CHOICES:
        raise OptionError(
            f"found route={shown(route)}; expected 'auto', 'open-loop', 'reference' or 'direct'; "
            "choose one of them"
        )
    if route == "direct" and (noise == "white" or loss != "squared"):
        beside = f"loss={loss!r}" if loss != "squared" else "noise='white'"
        raise OptionError(
            f"found route='direct' with {beside}; expected one of the two, as that route gives the "
            "noise a model; leave one out"
        )


def refuse_without_reference(route: Route, records: Sequence[Record]) -> None:
    """Refuse the reference route where a record has no reference.

    Raises
    ------
    OptionError
    """
    if route == "reference":
        refuse_unreferenced("route='reference'", records, "leave the route out")


def refuse_unreferenced(asked: str, records: Sequence[Record], instead: str) -> None:
    """Refuse records without a reference, or with none that moves.

    Parameters
    ----------
    asked : str
        What needs one.
    records : sequence of Record
    instead : str
        What else to do.

    Raises
    ------
    OptionError
    ConstantReferenceError
    """
    without = [k for k, one in enumerate(records) if getattr(one, "reference", None) is None]
    if without:
        raise OptionError(
            f"found {asked} and {_which(without, len(records))} without a reference; "
            "expected the signal that the controller was told to follow; write Record(u, y, "
            f"reference=...), or {instead}"
        )
    refuse_still(asked, records, instead)


def referenced(
    route: Route | None, records: Sequence[Record]
) -> tuple[list[Record], tuple[Finding, ...]]:
    """Experiments that count, and what is said of others: those that somebody gave a reference.

    A reference says that a controller ran. Nothing says what moved the others: by the direct route
    all would hang on the model of the noise, and taken as open loop they would bend the answer.
    """
    own = [one for one in records if one.reference is not None]
    if route != "auto" or not own or len(own) == len(records) or not any_moves(own):
        return list(records), ()
    left = f"{len(records) - len(own)} of {len(records)} experiments without a reference"
    return own, (
        Finding(
            "samples-left-out",
            "warning",
            f"{left} had no part in the estimate: nothing says whether a controller moved them.",
            "Give their references; identify those without a controller by themselves and compare.",
        ),
    )


def having_left_out(estimate: Estimate, said: tuple[Finding, ...]) -> Estimate:
    """An estimate that says what `referenced` left out."""
    if not said:
        return estimate
    trace = estimate.trace.told(*(one.message for one in said))
    return replace(estimate, findings=(*said, *estimate.findings), trace=trace)


def by_reference(route: Route, records: Sequence[Record]) -> bool:
    """Whether the reference route is taken: as asked for, or where every record has a reference.

    References that stand still throughout are none.
    """
    return route == "reference" or (
        route == "auto"
        and all(record.reference is not None for record in records)
        and any_moves(records)
    )


def taken_by(route: Route, noise: NoiseChoice) -> tuple[str, NoiseChoice]:
    """The route of a fit to input and output as they are, and what the noise is taken for.

    Parameters
    ----------
    route : {"auto", "open-loop", "reference", "direct"}
    noise : {"white", "ar", "auto"}
        As asked for.

    Examples
    --------
    >>> taken_by("auto", "auto"), taken_by("direct", "auto")
    (('open-loop', 'auto'), ('direct', 'ar'))
    """
    return ("direct", "ar") if route == "direct" else ("open-loop", noise)


def _which(places: Sequence[int], count: int) -> str:
    return "a record" if count == 1 else f"experiment {places[0] + 1}"
