"""One experiment: what went in, what came out, and when.

A `Record` holds the sampled inputs ``u`` and outputs ``y`` of one experiment, time along the first
axis. The sampled input stands for a function of continuous time: `intersample` says which one, held
between samples (``"zoh"``, a computer's output), joined by straight lines (``"foh"``, a measured
smooth signal) or without content above half the sampling rate (``"band-limited"``, a signal
measured behind an anti-aliasing filter); ``"auto"`` leaves it to `identify`, which compares
them. Where a controller set the input, ``reference`` holds what drove the loop from outside.
Arrays are copied once, checked and made read-only; every
method gives a new record that shares the memory it can share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import SampleTypeError, SamplingError, shown
from tridentify.record.checks.rates import merge_rates
from tridentify.record.checks.references import (
    check_shared,
    reference_array,
    reference_between,
    settled_reference,
)
from tridentify.record.checks.samples import (
    Intersample,
    channel_labels,
    check_band_limited,
    check_distinct,
    check_inputs,
    check_intersample,
    check_lengths,
    check_outputs,
    checked_units,
    sample_array,
)
from tridentify.record.checks.times import instant, time_axis
from tridentify.record.in_words import RecordInWords
from tridentify.record.resampled import Resampled
from tridentify.record.selected import Selected
from tridentify.writing.pointers import OF_A_RECORD, Pointers
from tridentify.writing.views import RecordViews

__all__ = ["Intersample", "Record", "in_memory"]


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Record(Selected, Resampled, RecordInWords, RecordViews, Pointers):
    """Sampled inputs and outputs of one experiment.

    Parameters
    ----------
    u : array_like, shape (n_samples,) or (n_samples, n_inputs)
        Inputs, finite. A one-dimensional array is one channel.
    y : array_like, shape (n_samples,) or (n_samples, n_outputs)
        Outputs. ``nan`` marks a missing sample; infinity is refused.
    dt : float, optional
        Uniform sampling interval [s]; time then begins at zero. Give exactly one of `dt` and `t`.
    t : array_like, shape (n_samples,), optional
        Sampling instants [s], strictly increasing; or dates, which count from the first, or
        durations.
    intersample : {"zoh", "foh", "band-limited", "auto"}
        What the input does between samples: it is held, joined by straight lines, or the
        band-limited signal through its samples (uniform time only). With "auto" `identify` takes
        what explains the record best; all else takes `behaviour`.
    reference : array_like, shape (n_samples,) or (n_samples, n_references), optional
        For a record that was taken with a controller at work: what drove the loop from outside, set
        points or signals added to the controller's output, one column each. Finite. Neither noise
        nor the output may have had a part in it. Only its changes matter, not where it counts from.
        An input that no controller moves, a known disturbance, belongs here too, by its own name.
    reference_names : sequence of str, optional
        As `input_names`; by default the labels of its columns, else ``r`` or ``r1, r2, ...``.
    reference_intersample : {"zoh", "foh", "band-limited", "auto"}, optional
        What the reference does between samples. By default what `intersample` says, but held where
        it rests and is switched; with "auto" its own samples decide, see `reference_behaviour`.
    input_names, output_names : sequence of str, optional
        One name per channel, all different. By default what the columns of a frame or a series of
        pandas, polars, pyarrow or xarray are called (``q [deg/s]`` also states the unit), else
        ``u`` or ``u1, u2, ...`` and likewise ``y``.
    units : mapping of str to str, optional
        Channel name (or ``"t"``) to unit.
    name : str, optional
        What to call this experiment in tables and pictures.

    Attributes
    ----------
    u : ndarray, shape (n_samples, n_inputs)
    y : ndarray, shape (n_samples, n_outputs)
    t : ndarray, shape (n_samples,)
        Always present [s].
    dt : float or None
        None when `t` is not uniform to a thousandth of a step.
    reference : ndarray, shape (n_samples, n_references), or None
    reference_names : tuple of str
        Empty where there is no reference.
    reference_intersample : str or None
        As stated, or as was taken when the record was made; None without a reference.

    Raises
    ------
    SampleTypeError, ShapeError, LengthMismatchError, TooFewSamplesError
        The arrays are not real numbers, not one or two-dimensional, not of one length of 2 or more.
    NotFiniteError, EmptyChannelError
        An input or a reference is not finite; an output is infinite or holds nothing but nan.
    SamplingError, TimeNotIncreasingError
        Both or neither of `dt` and `t`, `dt` not positive, or time that does not increase.
    ScaleError
        Samples beyond 1e300, steps below 1e-150 s, a duration above 1e150 s or above 4.5e15 steps.
    ChannelNameError, UnitError, OptionError
        Names, units or `intersample` do not fit.

    Notes
    -----
    Read-only float64 arrays which own their memory (those of another record, for one) are shared
    instead of copied.

    Examples
    --------
    >>> from tridentify import Record
    >>> record = Record([0, 1, 1, 1], [0.0, 0.1, 0.3, 0.4], dt=0.5, output_names=["alpha"])
    >>> record
    Record(4 samples, 1.5 s, dt=0.5 s, zoh, inputs: u, outputs: alpha)
    >>> record.slice(0.5, 1.0).t
    array([0.5, 1. ])
    """

    _elsewhere = OF_A_RECORD

    def __init__(
        self,
        u: ArrayLike,
        y: ArrayLike,
        *unnamed: object,
        dt: float | None = None,
        t: ArrayLike | None = None,
        intersample: Intersample = "zoh",
        reference: ArrayLike | None = None,
        reference_names: Sequence[str] | None = None,
        reference_intersample: Intersample | None = None,
        input_names: Sequence[str] | None = None,
        output_names: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
        name: str | None = None,
    ) -> None:
        if unnamed:
            raise SamplingError(
                f"found {shown(unnamed[0])} as a third argument without a name; expected input, "
                "output, and all else by its name; write Record(u, y, dt=0.02), or t=times"
            )
        check_intersample(intersample)
        inputs, outputs = sample_array("u", u), sample_array("y", y)
        step, time = time_axis(dt, t, len(inputs))
        check_lengths(inputs, outputs, time)
        if intersample == "band-limited":
            check_band_limited(step, len(inputs))
        driven = reference_array(reference, reference_names, len(inputs))
        between = reference_between(reference_intersample, intersample, driven, step)
        (names_in, names_out, names_ref), own = channel_labels(
            [
                (u, input_names, inputs.shape[1], "u"),
                (y, output_names, outputs.shape[1], "y"),
                (reference, reference_names, 0 if driven is None else driven.shape[1], "r"),
            ]
        )
        names = (*names_in, *names_out, *names_ref)
        check_distinct((*names_in, *names_out))
        check_shared((names_in, inputs), names_out, (names_ref, driven))
        check_inputs(inputs, names_in)
        check_outputs(outputs, names_out)
        if driven is not None:
            check_inputs(driven, names_ref, "reference")
        self._set(
            u=inputs,
            y=outputs,
            dt=step,
            t=time,
            intersample=intersample,
            input_names=names_in,
            output_names=names_out,
            units=MappingProxyType(own | dict(checked_units(units, names))),
            name="" if name is None else str(name),
            reference=driven,
            reference_names=names_ref,
            reference_intersample=between,
        )

    @classmethod
    def from_rates(
        cls,
        u: ArrayLike,
        y: ArrayLike,
        *,
        u_dt: float,
        y_dt: float,
        y_start: float = 0.0,
        intersample: Intersample = "zoh",
        reference: ArrayLike | None = None,
        reference_names: Sequence[str] | None = None,
        reference_intersample: Intersample | None = None,
        input_names: Sequence[str] | None = None,
        output_names: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
        name: str | None = None,
    ) -> Self:
        """One record of inputs and outputs that were sampled at different rates.

        Nothing is interpolated in the outputs: they are ``nan`` at instants at which only the
        input was sampled. Inputs at instants of outputs alone are what `intersample` says.

        Parameters
        ----------
        u, y : array_like, shape (n,) or (n, n_channels)
            Each with its own number of samples.
        u_dt, y_dt : float
            Sampling intervals of inputs and outputs [s].
        y_start : float
            When the first output was taken, the first input being at zero [s].
        reference : array_like, shape (n,) or (n, n_references), optional
            Sampled together with the inputs.
        intersample, reference_names, reference_intersample, input_names, output_names, units, name
            As in `Record`.

        Returns
        -------
        Record
            On the finer grid where one interval is a whole multiple of the other, else on the
            instants of both.

        Raises
        ------
        SamplingError
            An interval is not positive.
        LengthMismatchError
            Outputs lie before the first input or after the last one ends.
        NonUniformTimeError
            A band-limited input whose grid does not hold all instants of the outputs.

        Examples
        --------
        >>> record = Record.from_rates([0, 1, 1, 0, 0], [0.0, 0.3, 0.2], u_dt=0.1, y_dt=0.2)
        >>> record.y.ravel()
        array([0. , nan, 0.3, nan, 0.2])
        """
        inputs, outputs = sample_array("u", u), sample_array("y", y)
        y_start = instant("y_start", y_start)
        if not np.isfinite(y_start):
            raise SamplingError(
                f"found y_start={y_start}; expected seconds after the first input; correct it"
            )
        own = time_axis(u_dt, None, len(inputs))[1]
        other = time_axis(y_dt, None, len(outputs))[1] + y_start
        t, u_all, y_all = merge_rates(own, inputs, other, outputs, intersample)
        driven = reference_array(reference, reference_names, len(inputs))
        between = reference_between(reference_intersample, intersample, driven, float(u_dt))
        follows = settled_reference(between, driven)
        if driven is not None and follows is not None:
            driven = merge_rates(own, driven, other, outputs, follows)[1]
        return cls(
            u_all,
            y_all,
            t=t,
            intersample=intersample,
            reference=driven,
            reference_names=reference_names,
            reference_intersample=between,
            input_names=input_names,
            output_names=output_names,
            units=units,
            name=name,
        )


def in_memory(given: object) -> Record:
    """What was given, if it is a record whose samples are in memory.

    Parameters
    ----------
    given : object

    Raises
    ------
    SampleTypeError
        It is something else.
    """
    if isinstance(given, Record):
        return given
    raise SampleTypeError(
        f"found {type(given).__name__} in place of a record; expected a Record, whose samples are "
        "in memory; write Record(u, y, dt=...), or of a long record a stretch: record.part(a, b)"
    )
