"""Checks of what an on-line estimator is given, and what it says where it cannot answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.errors import OptionError, UndeterminedError, UnsupportedError, shown
from tridentify.online.layout import Setting
from tridentify.online.state import State

LEAST_FORGETTING = 0.5
"""Least factor of forgetting: two samples are remembered there, and no model is known from them."""


class NotReadyError(UndeterminedError):
    """The samples so far do not determine the coefficients."""


def check_state(state: object) -> None:
    """Refuse what is no state.

    Raises
    ------
    OptionError
    """
    if not isinstance(state, State):
        raise OptionError(
            f"found state={shown(state)}; expected what init, step or State.load gave; pass that"
        )


def check_forgetting(forgetting: object) -> None:
    """Refuse what is no forgetting factor.

    Raises
    ------
    OptionError
    """
    if not is_number(forgetting) or not LEAST_FORGETTING <= float(forgetting) <= 1.0:  # type: ignore[arg-type]
        raise OptionError(
            f"found forgetting={shown(forgetting)}; expected a factor from {LEAST_FORGETTING:g} to "
            "1 (1 forgets nothing; 1 / (1 - forgetting) samples are remembered); correct it"
        )


def check_choice(name: str, value: object, choices: Sequence[str]) -> None:
    """Refuse what is not among the choices.

    Raises
    ------
    OptionError
    """
    if value not in choices:
        raise OptionError(
            f"found {name}={shown(value)}; expected {' or '.join(map(repr, choices))}; choose one"
        )


def refuse_drift(name: str, setting: Setting) -> None:
    """Refuse a drift that is asked for.

    Raises
    ------
    UnsupportedError
    """
    if setting.structure.drift is True:
        raise UnsupportedError(
            f"found drift=True; {name} on-line estimates no drift; leave it out, or use "
            "online.ThreeModel()"
        )


def is_number(value: object) -> bool:
    """Whether a value is a real number."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def check_above_zero(name: str, value: object, unit: str) -> None:
    """Refuse what is neither left out nor a finite number above zero.

    Raises
    ------
    OptionError
    """
    if value is not None and not (is_number(value) and 0.0 < float(value) < np.inf):  # type: ignore[arg-type]
        raise OptionError(
            f"found {name}={shown(value)}; expected a number above zero, in {unit}; leave it out "
            "or correct it"
        )


def not_ready(count: int, what: str) -> NotReadyError:
    """The error that says so, with what to do."""
    return NotReadyError(
        f"found {count} samples, which {what}; expected samples that excite all coefficients; go "
        "on stepping, or give a model with start="
    )
