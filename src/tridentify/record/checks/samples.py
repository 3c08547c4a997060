"""Checks of sampled data, each with its own exception: arrays in, sound arrays out.

They copy an array once at the most and never guess: which axis is time, which step was meant, or
what a repeated name stands for.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tridentify.errors import (
    ChannelNameError,
    DataWarning,
    EmptyChannelError,
    LengthMismatchError,
    NonUniformTimeError,
    NotFiniteError,
    OptionError,
    SampleTypeError,
    ShapeError,
    TooFewSamplesError,
    UnitError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.numerics.interpolation import FEWEST
from tridentify.record.checks.names import check_names, check_units, did_you_mean, labels_of
from tridentify.record.checks.scales import check_samples

Intersample = Literal["zoh", "foh", "band-limited", "auto"]
Behaviour = Literal["zoh", "foh", "band-limited"]

MOVING = 0.5
"""Share of samples at which a measured input moves, at least."""

POSITIONS = 3
"""Values that a switched input takes, at most: off, on, and one more."""

BY_STEPS = 0.5
"""Share of all its way that a signal of steps goes in moves with a rest before and after."""

ROUNDED = 1.0 / 8.0
"""Largest of all moves over the whole range below which moves with rests between them may be those
of a smooth signal, rounded: three bits and more."""


def channel_names(names: Sequence[str] | None, n_channels: int, default: str) -> tuple[str, ...]:
    """Check the names of channels, or make default ones.

    Parameters
    ----------
    names : sequence of str, or None
        One name per channel. A single string is one name.
    n_channels : int
        Number of channels.
    default : str
        Stem of the default names.

    Returns
    -------
    tuple of str, length n_channels

    Raises
    ------
    ChannelNameError
        Names are repeated, blank, not printable, too long, or not as many as the channels.

    Examples
    --------
    >>> channel_names(None, 2, "u")
    ('u1', 'u2')
    """
    if names is None:
        return (
            (default,) if n_channels == 1 else tuple(f"{default}{k + 1}" for k in range(n_channels))
        )
    chosen = (names,) if isinstance(names, str) else tuple(names)
    if len(chosen) != n_channels:
        raise ChannelNameError(
            f"found {len(chosen)} names {shown(list(chosen))} for {n_channels} channels of "
            f"{default}; expected one name per channel; give as many names as columns"
        )
    check_names(chosen)
    check_distinct(chosen)
    return chosen


def channel_labels(
    sides: Sequence[tuple[object, Sequence[str] | None, int, str]],
) -> tuple[tuple[tuple[str, ...], ...], dict[str, str]]:
    """Names of inputs, outputs and references, and what units the names not given carry.

    Parameters
    ----------
    sides : sequence of (array_like, names or None, int, str)
        Of each side the samples as given (pandas, polars, pyarrow or xarray may name their
        columns), the names that were given (None where the labels of the array count), the number
        of channels, and the stem of default names.

    Returns
    -------
    names : tuple of tuple of str
        Of each side; default names where an array has no labels, or where one occurs twice.
    units : dict

    Raises
    ------
    ChannelNameError

    Examples
    --------
    >>> import polars as pl
    >>> channel_labels([(pl.Series("de [deg]", [0]), None, 1, "u"), ([0], None, 1, "y")])
    ((('de',), ('y',)), {'de': 'deg'})
    """
    own = [labels_of(samples, n) if names is None else None for samples, names, n, _ in sides]
    for labels in (own, [None] * len(own)):
        found = tuple(
            channel_names([name for name, _ in label] if label else names, n, default)
            for label, (_, names, n, default) in zip(labels, sides, strict=True)
        )
        if len(set().union(*found)) == sum(map(len, found)):
            break
    units = dict(pair for label in labels for pair in label or () if pair[1])
    return found, units


def shared_numbers(label: str, value: ArrayLike) -> Array:
    """Copy `value` into a float64 array, once, or share an array that cannot change."""
    if isinstance(value, np.ma.MaskedArray):
        masked: Any = value.astype(np.float64)
        value = masked.filled(np.nan)
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as error:
        raise SampleTypeError(
            f"found {label} that is no array (rows of different length?); expected real numbers; "
            "give one number per sample and channel"
        ) from error
    if array.dtype.kind not in "fiub":
        raise SampleTypeError(
            f"found {label} of type {array.dtype}; expected real numbers; convert it to float"
        )
    if _is_immutable(array):
        return cast(Array, array)
    copied = np.array(array, dtype=np.float64, order="C", copy=True)
    copied.flags.writeable = False
    return copied


def _is_immutable(array: NDArray[Any]) -> bool:
    owner = array if array.base is None else array.base
    return (
        array.dtype == np.float64
        and array.flags.c_contiguous
        and type(owner) is np.ndarray
        and bool(owner.flags.owndata)
        and not array.flags.writeable
        and not owner.flags.writeable
    )


def sample_array(label: str, value: ArrayLike) -> Array:
    """Give read-only samples of shape (n_samples, n_channels)."""
    array = shared_numbers(label, value)
    if array.ndim not in (1, 2) or (array.ndim == 2 and array.shape[1] == 0):
        raise ShapeError(
            f"found {label} of shape {array.shape}; expected (n_samples,) or "
            "(n_samples, n_channels), time first; reshape it"
        )
    return array[:, np.newaxis] if array.ndim == 1 else array


def check_lengths(u: Array, y: Array, t: Array) -> None:
    """Refuse arrays of different length, of fewer than two samples, or with time along a row."""
    if not len(u) == len(y) == len(t):
        raise LengthMismatchError(
            f"found {len(u)} samples of u, {len(y)} of y and {len(t)} of t; expected equal lengths "
            "along the first axis; cut the longer ones, or transpose if time runs along a row"
        )
    if len(u) < 2:
        raise TooFewSamplesError(
            f"found {len(u)} samples; expected at least 2; record for longer"
            + (", or transpose if time runs along a row" if u.shape[1] > 1 else "")
        )
    for label, samples in (("u", u), ("y", y)):
        check_tall(label, samples)


def check_tall(label: str, samples: Array) -> None:
    """Refuse an array of more channels than samples."""
    if samples.shape[1] > len(samples):
        raise ShapeError(
            f"found {label} of shape {samples.shape}, more channels than samples; expected "
            f"time along the first axis; transpose it, as in {label}.T"
        )


def check_intersample(
    intersample: object, option: str = "intersample", kind: str = "input"
) -> None:
    """Refuse an unknown behaviour of the input, or of the reference, between its samples."""
    words = ("zoh", "foh", "band-limited", "auto")
    if not isinstance(intersample, str) or intersample not in words:
        raise OptionError(
            f"found {option}={shown(intersample)}; expected 'zoh' ({kind} held between "
            "samples), 'foh' (straight lines), 'band-limited', or 'auto' to have them compared; "
            "choose one"
        )


def looks_measured(u: Array) -> bool:
    """Whether an input was measured rather than set, to judge by its samples alone.

    A signal that is set moves at few samples, or independently of where it was going. One that is
    measured moves at most of them, and goes on as it went: neighbouring increments have one sign
    more often than not.

    Examples
    --------
    >>> bool(looks_measured(np.sin(0.1 * np.arange(200))[:, None]))
    True
    >>> pulses = np.repeat([0.0, 2.0, 0.0, -2.0], 50)
    >>> noise = 0.01 * np.random.default_rng(0).standard_normal(200)
    >>> bool(looks_measured((pulses + noise)[:, None]))
    False
    """
    steps = np.diff(u, axis=0)
    return any(bool(np.mean(own != 0.0) > MOVING) and _goes_on(own) for own in steps.T)


def is_switched(u: Array) -> bool:
    """Whether one of the inputs goes to and fro between two or three values, as a thermostat.

    Examples
    --------
    >>> weather = np.sin(0.1 * np.arange(200))
    >>> is_switched(np.stack([weather, np.repeat([0.0, 1.0, 0.0, 1.0], 50)], axis=1))
    True
    >>> is_switched(weather[:, None])
    False
    """
    return any(1 < np.unique(own).size <= POSITIONS for own in u.T)


def rests_between_steps(signals: Sequence[Array]) -> bool:
    """Whether signals rest and jump within one sampling interval, as set points that are switched.

    A slope moves at neighbouring samples; a smooth signal that was rounded moves by small steps. A
    signal of two values is switched, however often. Signals that never move say nothing.

    Examples
    --------
    >>> rest_and_jump, t = np.repeat([0.0, 2.0, 1.0, -2.0], 5), 0.1 * np.arange(20)
    >>> [rests_between_steps([r]) for r in (rest_and_jump, t, np.clip(t, 0.5, 1.0), np.sin(t))]
    [True, False, False, False]
    """
    moving = [own for own in signals if np.any(own != own[0])]
    return bool(moving) and all(_by_steps(own) for own in moving)


def _by_steps(own: Array) -> bool:
    moves = np.abs(np.diff(own))
    if np.unique(own).size == 2:
        return True
    around = np.pad(moves, 1)
    alone = (around[:-2] == 0.0) & (around[2:] == 0.0)
    large = bool(moves.max() >= ROUNDED * np.ptp(own))
    return large and float(moves[alone].sum()) > BY_STEPS * float(moves.sum())


def _goes_on(steps: Array) -> bool:
    """Whether increments go on as they went, by their products and without their single jumps.

    The product of a jump with the noise beside it is as large as many of a slope, and has the sign
    of that noise: it may not decide alone. The lesser of two neighbours knows of both.
    """
    one, other = steps[1:], steps[:-1]
    lesser = np.minimum(np.abs(one), np.abs(other)) ** 2
    return float(one @ other) > 0.0 and float(np.sign(one * other) @ lesser) > 0.0


def check_band_limited(step: float | None, n_samples: int, option: str = "intersample") -> None:
    """Refuse what no band-limited signal can be drawn through."""
    if step is None:
        raise NonUniformTimeError(
            f"found time that is not uniform with {option}='band-limited'; expected a uniform "
            "step; state 'zoh' or 'foh', or resample the record"
        )
    if n_samples < FEWEST:
        raise TooFewSamplesError(
            f"found {n_samples} samples with {option}='band-limited'; expected at least "
            f"{FEWEST} to say what lies between them; record for longer, or state 'zoh' or 'foh'"
        )


def check_distinct(names: tuple[str, ...]) -> None:
    """Refuse repeated names."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ChannelNameError(
                f"found the channel name {shown(name)} more than once; expected all inputs, "
                "outputs and references to have different names; rename one"
            )
        seen.add(name)


def check_inputs(u: Array, names: tuple[str, ...], kind: str = "input", first: int = 0) -> None:
    """Refuse inputs, or references, that are not finite or too large to be added.

    ``first`` is the number of the first sample, for a part of a record.
    """
    if np.isfinite(u).all():
        check_samples(f"{'an' if kind == 'input' else 'a'} {kind}", u)
        return
    row, column = (int(k) for k in np.argwhere(~np.isfinite(u))[0])
    raise NotFiniteError(
        f"found {kind} {shown(names[column])} = {u[row, column]} at sample {first + row}; "
        f"expected finite numbers, since the {kind} must be known throughout; repair it or cut the "
        "record"
    )


def check_outputs(y: Array, names: tuple[str, ...], first: int = 0, *, whole: bool = True) -> None:
    """Refuse infinite outputs, those too large to be added, and channels of nothing but nan.

    ``first`` is the number of the first sample; a part that is not the whole may be of nan.
    """
    if np.isinf(y).any():
        row, column = (int(k) for k in np.argwhere(np.isinf(y))[0])
        raise NotFiniteError(
            f"found output {shown(names[column])} = {y[row, column]} at sample {first + row}; "
            "expected finite numbers or nan for a missing sample; replace it by nan"
        )
    empty = np.isnan(y).all(axis=0)
    if whole and empty.any():
        raise EmptyChannelError(
            f"found nothing but nan in output {shown(names[int(np.argmax(empty))])}; expected at "
            "least one sample; leave the channel out"
        )
    check_samples("an output", y)


def checked_units(units: Mapping[str, str] | None, names: tuple[str, ...]) -> Mapping[str, str]:
    """Give a read-only mapping of channel names, or ``"t"``, to units."""
    if units is not None and not isinstance(units, Mapping):
        raise UnitError(
            f"found units={shown(units)}; expected a mapping of channel names to units; write for "
            "example units={'elevator': 'rad'}"
        )
    given: Mapping[str, object] = units or {}
    for key in given:
        if key != "t" and key not in names:
            raise UnitError(
                f"found a unit for {shown(key)}; expected a channel name among "
                f"{shown(', '.join(names), 300)[1:-1]} or 't'; correct the name"
                f"{did_you_mean(key, names)}"
            )
    check_units(given)
    return MappingProxyType(dict(units or {}))


def chosen_channels(
    wanted: Sequence[str] | None, present: tuple[str, ...], kind: str
) -> tuple[list[int], tuple[str, ...]]:
    """Find channels by name."""
    if wanted is None:
        return list(range(len(present))), present
    names = (wanted,) if isinstance(wanted, str) else tuple(wanted)
    for name in names:
        if name not in present:
            raise ChannelNameError(
                f"found no {kind} {shown(name)}; expected one of "
                f"{', '.join(present) or 'none, as the record has no ' + kind}; correct it"
                f"{did_you_mean(name, present)}"
            )
    if not names:
        raise ChannelNameError(f"found no {kind} chosen; expected one of {', '.join(present)}")
    check_distinct(names)
    return [present.index(name) for name in names], names


def warn_if_input_moves(
    u: Array, factor: int, intersample: Behaviour, kind: str = "an input"
) -> None:
    """Warn when dropped samples leave the input wrongly described."""
    if factor == 1:
        return
    whole = u[: (len(u) - 1) // factor * factor].reshape(-1, factor, u.shape[1])
    if intersample == "band-limited":
        moves = bool(np.any(u != u[0]))
    elif intersample == "zoh":
        moves = bool(np.any(whole != whole[:, :1]))
    else:
        bend = np.abs(np.diff(u, 2, axis=0))
        bend[factor - 1 :: factor] = 0.0
        moves = bool(np.any(bend > 1e-9 * np.abs(u).max()))
    if moves:
        warnings.warn(
            f"found {kind} that changes between the samples that are kept, one in {factor}; "
            f"expected it to be described by '{intersample}' at the new step; keep the finer step, "
            "or use decimate",
            DataWarning,
            stacklevel=3,
        )
