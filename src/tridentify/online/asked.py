"""Checks of what an on-line estimator is given, and what it says where it cannot answer.

Samples as they arrive: the interval before each, and its channels in the inbox.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import (
    ChannelCountError,
    OptionError,
    SampleTypeError,
    SamplingError,
    UndeterminedError,
    UnsupportedError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.online.kernels import slots
from tridentify.online.layout import Setting
from tridentify.online.saved.state import State
from tridentify.record.checks.scales import MOST_STEPS

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
        raise OptionError.found("state=", state, "what init, step or State.load gave", "pass that")


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
    if setting.structure.drift not in (False, "auto"):
        raise UnsupportedError(
            f"found drift={setting.structure.drift}; {name} on-line estimates no drift; "
            "leave it out, or use online.ThreeModel()"
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
        raise OptionError.found(
            f"{name}=", value, f"a number above zero, in {unit}", "leave it out or correct it"
        )


MANY_A_COEFFICIENT = 100
"""Samples for each coefficient without a model from which more of them are not all that is
missing: records that tell one have it within twenty."""


def not_ready(count: int, what: str) -> NotReadyError:
    """The error that says so, with what to do."""
    return NotReadyError(
        f"found {count} samples, which {what}; expected samples that excite all coefficients; go "
        "on stepping, or give a model with start="
    )


def still_searched(count: int, n_coefficients: int) -> NotReadyError:
    """The same where no model was found; after many samples with what may be in the way."""
    if count < MANY_A_COEFFICIENT * n_coefficients:
        return not_ready(count, "are still searched for a model")
    return NotReadyError(
        f"found {count} samples that no stable model explains well enough; expected an input that "
        "moves the output of a stable plant; record them and identify them off-line, with "
        "reference= where a controller holds a plant that is unstable (advise(record) says what "
        "they can tell), fix a pole at zero where it integrates (fixed={'a0': 0}), or give a model "
        "with start="
    )


SAME = 1e-9
"""Relative difference within which two sampling intervals are one: rounding of times that are
counted from far away."""


def checked_interval(state: State, interval: float) -> tuple[bool, float]:
    """Whether an interval is the usual one, and the interval [s].

    Raises
    ------
    SamplingError
        It is not above zero, or out of proportion to the usual one.
    UnsupportedError
        It is not the usual one, and there are delays.
    """
    if not is_number(interval) or not 0.0 < float(interval) < math.inf:
        raise SamplingError(
            f"found interval={shown(interval)}; expected the time since the sample before, above "
            "zero, in seconds; leave the sample out, or correct it"
        )
    seconds = float(interval)
    setting = state.stage.setting
    if abs(seconds - setting.dt) <= SAME * setting.dt or state.values[slots.COUNT] == 0.0:
        return True, setting.dt
    if not 1.0 / MOST_STEPS <= seconds / setting.dt <= MOST_STEPS:
        raise SamplingError(
            f"found interval={seconds:g} s; expected the time since the sample before, within a "
            f"factor of {MOST_STEPS:.1e} of {setting.dt:g} s; leave the sample out, or correct it"
        )
    if any(setting.delays):
        raise UnsupportedError(
            f"found interval={seconds:g} s with a delay; expected samples every {setting.dt:g} s, "
            "since the delayed input is kept in samples; resample the stream, or drop the delay"
        )
    return False, seconds


def bounded_intervals(intervals: Array, dt: float) -> Array:
    """Intervals that are not looked at yet, where they have matrices at all."""
    held = np.where(np.isfinite(intervals), intervals, dt)
    return np.clip(held, max(SAME, 1.0 / MOST_STEPS) * dt, MOST_STEPS * dt)


def constants_after(state: State, interval: float) -> tuple[Array, float]:
    """``c`` of the kernels for a sample that comes after an interval, and the interval [s]."""
    regular, seconds = checked_interval(state, interval)
    setting, blueprint = state.stage.setting, state.stage.blueprint
    if regular:
        return blueprint.constants, seconds
    return state.method.constants_for(blueprint, setting, np.array([seconds]))[0], seconds


def put_sample(x: Array, setting: Setting, u: ArrayLike, y: ArrayLike) -> None:
    """Put one value of every channel into the inbox of a state.

    Raises
    ------
    SampleTypeError, ChannelCountError
    """
    at = slots.INBOX
    for what, value, names in (("u", u, setting.input_names), ("y", y, setting.output_names)):
        if isinstance(value, str):
            raise SampleTypeError.found(f"{what}=", value, "numbers", "convert the sample first")
        try:
            row = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise SampleTypeError(
                f"found {what}={shown(value)}; expected {len(names)} "
                f"number{'s' if len(names) > 1 else ''}; convert the sample first"
            ) from error
        if row.size != len(names) or row.ndim > 1:
            raise ChannelCountError(
                f"found {what} of shape {row.shape}; expected {len(names)} "
                f"value{'s' if len(names) > 1 else ''} ({', '.join(names)}); give one for each "
                "channel"
            )
        x[at : at + len(names)] = row
        at += len(names)


def as_table(values: Array) -> Array:
    """Samples of one channel as a column."""
    values = np.asarray(values)
    return values[:, None] if values.ndim == 1 else values


def names_given(what: str, names: Sequence[str]) -> list[str]:
    """Names of channels as a list.

    Raises
    ------
    OptionError
    """
    if isinstance(names, str) or not all(isinstance(name, str) for name in names) or not names:
        raise OptionError.found(
            f"{what}=", names, "names of channels", f"write for example {what}=['elevator']"
        )
    return list(names)
