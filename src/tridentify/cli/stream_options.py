"""The options of ``tridentify stream``, and the estimator that they describe."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.options import NUMBER

if TYPE_CHECKING:
    from tridentify.online import Estimator

method_option = partial(typer.Option, rich_help_panel="The method")


@dataclass(frozen=True)
class Asking:
    """Which estimator follows the coefficients, and its options.

    Attributes
    ----------
    method
        On-line method; a wrong name lists them.
    forgetting
        Forgetting factor of a sample; 1 is none.
    forget
        exponential, directional or resetting.
    walk
        How far coefficients wander in a second (kalman): a share of their size such as 0.01, or
        a1=0.1 for one of them in its own unit; may be repeated.
    filter
        Coefficients of the filter's denominator, the highest power first, such as 1,5,6; by default
        it is chosen from the first samples.
    start
        Begin from this model.json in place of a search.
    on_change
        When coefficients have moved: restart, or flag only.
    samples
        Samples that are collected for the first search.
    clock
        Seconds between two adaptations of filter and basis.
    rate
        Rate of the gradient.
    gamma
        Pole of the gradient's basis.
    """

    method: Annotated[str, method_option(metavar="NAME")] = "three-model"
    forgetting: Annotated[float | None, method_option(metavar="X")] = None
    forget: Annotated[
        Literal["exponential", "directional", "resetting"] | None,
        method_option("--forget", metavar="HOW"),
    ] = None
    walk: Annotated[list[str] | None, method_option("--walk", metavar="X")] = None
    filter: Annotated[str | None, method_option("--filter", metavar="C")] = None
    start: Annotated[Path | None, method_option("--start", metavar="FILE")] = None
    on_change: Annotated[
        Literal["restart", "flag"] | None, method_option("--on-change", metavar="HOW")
    ] = None
    samples: Annotated[int | None, method_option("--samples", min=1, metavar="N")] = None
    clock: Annotated[float | None, method_option("--clock", metavar="X")] = None
    rate: Annotated[float | None, method_option(metavar="X")] = None
    gamma: Annotated[float | None, method_option(metavar="X")] = None

    def chosen(self) -> Estimator:
        """The estimator with the options that were given.

        Raises
        ------
        OptionError
            There is no such method, or it has no such option, or refuses its value.
        """
        given = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        method, walk = given.pop("method"), given.pop("walk")
        read = {
            "drift": walk_from(walk or ()),
            "filter": filter_from(self.filter),
            "start": None if self.start is None else Estimate.load(self.start),
        }
        return chosen_estimator(method, given | read)


def chosen_estimator(name: str, given: Mapping[str, Any]) -> Estimator:
    """Make the method with the options that were given.

    Parameters
    ----------
    name : str
        A key of `tridentify.online.ESTIMATORS`.
    given : mapping
        Options by the names of their fields; None where one was left out.

    Returns
    -------
    Estimator

    Raises
    ------
    OptionError
        There is no such method, or it has no such option, or refuses its value.
    """
    from tridentify.online import ESTIMATORS

    if name not in ESTIMATORS:
        raise OptionError.found("--method ", name, f"one of {', '.join(ESTIMATORS)}", "choose one")
    options = {key: value for key, value in given.items() if value is not None}
    fields = {key: _fields(kind) for key, kind in ESTIMATORS.items()}
    for option in options:
        if option not in fields[name]:
            able = ", ".join(key for key, known in fields.items() if option in known)
            written = "--" + {"drift": "walk"}.get(option, option).replace("_", "-")
            raise OptionError(
                f"found {written} with --method {name}; expected one of {able}; leave {written} "
                "out or choose another method"
            )
    kind: Any = ESTIMATORS[name]
    made: Estimator = kind(**options)
    return made


def _fields(kind: Any) -> set[str]:
    return {field.name for field in dataclasses.fields(kind)}


def walk_from(given: Sequence[str]) -> float | dict[str, float] | None:
    """Read what ``--walk`` says.

    Raises
    ------
    OptionError

    Examples
    --------
    >>> walk_from(["0.01"]), walk_from(["a1=0.1", "b0=2"])
    (0.01, {'a1': 0.1, 'b0': 2.0})
    """
    if not given:
        return None
    if len(given) == 1 and re.fullmatch(NUMBER, given[0].strip()):
        return float(given[0])
    found: dict[str, float] = {}
    for text in given:
        name, sign, number = (part.strip() for part in text.rpartition("="))
        if not (name and sign and re.fullmatch(NUMBER, number)) or name in found:
            raise OptionError(
                f"found --walk {shown(text)}; expected one number such as 0.01, or a coefficient "
                "and its own such as a1=0.1, once for each; correct it"
            )
        found[name] = float(number)
    return found


def filter_from(given: str | None) -> tuple[float, ...] | None:
    """Read what ``--filter`` says.

    Raises
    ------
    OptionError

    Examples
    --------
    >>> filter_from("1, 5,6")
    (1.0, 5.0, 6.0)
    """
    if given is None:
        return None
    cells = [cell.strip() for cell in given.split(",")]
    if not all(re.fullmatch(NUMBER, cell) for cell in cells):
        raise OptionError.found(
            "--filter ", given, "coefficients such as 1,5,6, the highest power first"
        )
    return tuple(float(cell) for cell in cells)
