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

import html
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import (
    DataWarning,
    EmptyRangeError,
    OptionError,
    ResampleError,
    SampleTypeError,
    SamplingError,
    ShapeError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.numerics.interpolation import FEWEST, lowpass
from tridentify.record.checks.rates import evaluated, filtered, interpolate, merge_rates
from tridentify.record.checks.references import (
    check_shared,
    reference_array,
    reference_between,
    settled_reference,
)
from tridentify.record.checks.samples import (
    Behaviour,
    Intersample,
    channel_labels,
    check_band_limited,
    check_distinct,
    check_inputs,
    check_intersample,
    check_lengths,
    check_outputs,
    checked_units,
    chosen_channels,
    looks_measured,
    sample_array,
    warn_if_input_moves,
)
from tridentify.record.checks.times import (
    instant,
    sample_range,
    time_axis,
    time_slack,
    uniform_step,
)
from tridentify.writing.notebook import sparkline
from tridentify.writing.pointers import OF_A_RECORD, Pointers
from tridentify.writing.views import RecordViews

__all__ = ["Intersample", "Record", "in_memory"]

MOST_SAMPLES = 20_000_000
_DRAWN = 6
"""Channels drawn in a notebook."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Record(RecordViews, Pointers):
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
        What the reference does between samples. By default what `intersample` says; with "auto" its
        own samples decide, see `reference_behaviour`.
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
        As stated, or as `intersample` was when the record was made; None without a reference.

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

    u: Array
    y: Array
    dt: float | None
    t: Array
    intersample: Intersample
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    units: Mapping[str, str]
    name: str
    # of the class, so that records that were pickled before there were references have none
    reference: Array | None = None
    reference_names: tuple[str, ...] = ()
    reference_intersample: Intersample | None = None

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

    def _set(self, **fields: object) -> None:
        for key, value in fields.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, key, value)

    def _derive(self, **changes: object) -> Record:
        """Make a record that differs in fields which are known to be sound, without a copy."""
        record = object.__new__(Record)
        record._set(**{**self.__dict__, **changes})
        check_outputs(record.y, record.output_names)
        return record

    @property
    def _loop(self) -> dict[str, Any]:
        """The reference as `Record` takes it, for a record that is made of this one."""
        return {
            "reference": self.reference,
            "reference_names": self.reference_names,
            "reference_intersample": self.reference_intersample,
        }

    @property
    def _units_of_a_model(self) -> dict[str, str]:
        """Units without those of references, which are no channels of a model."""
        alone = set(self.reference_names) - set(self.input_names)
        return {k: unit for k, unit in self.units.items() if k not in alone}

    def _on_its_times(self, u: Array) -> Record:
        """The same record with another input, and the step that its instants have on the mean."""
        return self._derive(u=u, dt=uniform_step(self.t))

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "units": dict(self.units)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._set(**{**state, "units": MappingProxyType(state["units"])})

    @property
    def behaviour(self) -> Behaviour:
        """What the input is taken to do between its samples.

        As stated; where that is left open, what the samples suggest: an input that moves at most
        samples, and mostly on in the direction in which it moved before, was measured ("foh"); any
        other was set and held ("zoh").

        Examples
        --------
        >>> Record([0, 1, 1, 1], [0, 1, 2, 3], dt=0.1, intersample="auto").behaviour
        'zoh'
        """
        if self.intersample != "auto":
            return self.intersample
        return "foh" if looks_measured(self.u) else "zoh"

    @property
    def reference_behaviour(self) -> Behaviour | None:
        """What the reference is taken to do between its samples; None without one.

        As stated; where that is left open, what its samples suggest, as with `behaviour`.

        Examples
        --------
        >>> r, u = [0, 1, 1, 1], [0, 0.5, 0.8, 0.9]
        >>> measured = Record(u, [0, 1, 2, 3], dt=0.1, intersample="auto", reference=r)
        >>> measured.behaviour, measured.reference_behaviour
        ('foh', 'zoh')
        """
        return settled_reference(self.reference_intersample, self.reference)

    def between(self, intersample: Intersample) -> Record:
        """The same samples with another behaviour of the input between them.

        A reference keeps its own.

        Parameters
        ----------
        intersample : {"zoh", "foh", "band-limited", "auto"}

        Raises
        ------
        OptionError, NonUniformTimeError, TooFewSamplesError
            There is no such behaviour, or the record does not allow it.

        Examples
        --------
        >>> Record([0, 1, 1, 1], [0, 1, 2, 3], dt=0.1).between("foh").intersample
        'foh'
        """
        check_intersample(intersample)
        if intersample == "band-limited":
            check_band_limited(self.dt, self.n_samples)
        return self._derive(intersample=intersample)

    def settled(self, behaviour: str) -> Record:
        """The record with a behaviour of its input where that was left open, else itself.

        Examples
        --------
        >>> Record([0, 1, 1, 1], [0, 1, 2, 3], dt=0.1).settled("foh").intersample
        'zoh'
        """
        if self.intersample != "auto":
            return self
        if behaviour == "band-limited" and (self.dt is None or self.n_samples < FEWEST):
            behaviour = "foh"
        return self.between(behaviour)  # type: ignore[arg-type]

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.u.shape[0])

    @property
    def n_inputs(self) -> int:
        """Number of input channels."""
        return int(self.u.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of output channels."""
        return int(self.y.shape[1])

    @property
    def n_references(self) -> int:
        """Number of references; 0 where none is known."""
        return 0 if self.reference is None else int(self.reference.shape[1])

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.t[-1] - self.t[0])

    def slice(self, start: float | None = None, stop: float | None = None) -> Record:
        """Cut out a stretch of time.

        Parameters
        ----------
        start, stop : float, optional
            First and last instant [s] on the record's own time axis; samples at either end belong
            to the stretch. None means from the beginning, or to the end.

        Returns
        -------
        Record
            The samples in between, at the times they had.

        Raises
        ------
        EmptyRangeError
            Fewer than two samples lie in between.

        Examples
        --------
        >>> Record([0, 1, 1, 1], [0, 1, 2, 3], dt=0.1).slice(0.1, 0.3).n_samples
        3
        """
        return self._part(*sample_range(self.t, start, stop))

    def split(self, at: float, *more: float) -> tuple[Record, ...]:
        """Divide the record at instants, say into one to identify with and one to validate with.

        Parameters
        ----------
        at : float
            Instant [s]; a sample at `at` belongs to the part after it.
        *more : float
            Further instants, in any order.

        Returns
        -------
        tuple of Record
            The samples before, and those from each instant on. No sample is in two parts.

        Raises
        ------
        EmptyRangeError
            One of the parts has fewer than two samples.

        Examples
        --------
        >>> first, second = Record([0, 1, 1, 1], [0, 1, 2, 3], dt=0.1).split(0.2)
        >>> first.n_samples, second.n_samples
        (2, 2)
        """
        instants = sorted(instant("at", one) for one in (at, *more))
        slack = time_slack(self.t)
        ends = [0, *(int(np.searchsorted(self.t, one - slack)) for one in instants), self.n_samples]
        for one, before, here, after in zip(instants, ends, ends[1:], ends[2:], strict=False):
            if np.isnan(one) or min(here - before, after - here) < 2:
                raise EmptyRangeError(
                    f"found no two samples on each side of {one:.6g} s; expected a time between "
                    f"{self.t[0]:.6g} s and {self.t[-1]:.6g} s; split elsewhere"
                )
        return tuple(self._part(first, last) for first, last in pairwise(ends))

    def _part(self, first: int, last: int) -> Record:
        t = self.t[first:last]
        if "band-limited" in (self.intersample, self.reference_intersample):
            check_band_limited(self.dt, len(t))
        step = uniform_step(t) if self.dt is None else self.dt
        driven = None if self.reference is None else self.reference[first:last]
        return self._derive(
            u=self.u[first:last], y=self.y[first:last], reference=driven, t=t, dt=step
        )

    def detrend(self, order: Literal[0, 1] = 0) -> Record:
        """Take the mean, or the straight line, out of every output.

        An offset or a drift is better estimated along (`Structure(offset=..., drift=...)`): to take
        it out beforehand also takes out part of the response.

        Parameters
        ----------
        order : {0, 1}
            0 for the mean, 1 for the least-squares straight line. Missing samples do not count.

        Returns
        -------
        Record
            Same inputs and references (only their changes matter), outputs without trend.

        Raises
        ------
        OptionError
            `order` is neither 0 nor 1.

        Examples
        --------
        >>> Record([0, 1, 1], [1.0, 2.0, 3.0], dt=0.1).detrend(1).y.round(12).ravel() + 0.0
        array([0., 0., 0.])
        """
        if order not in (0, 1):
            raise OptionError(f"found order={shown(order)}; expected 0 (mean) or 1 (line)")
        present = ~np.isnan(self.y)
        count = present.sum(axis=0)
        y = self.y - np.nansum(self.y, axis=0) / count
        if order == 1:
            time = np.where(present, self.t[:, np.newaxis], 0.0)
            time = np.where(present, self.t[:, np.newaxis] - time.sum(axis=0) / count, 0.0)
            energy = (time**2).sum(axis=0)
            slope = np.nansum(time * y, axis=0) / np.where(energy > 0.0, energy, 1.0)
            y -= time * slope
        return self._derive(y=y)

    def resample(self, dt: float) -> Record:
        """Keep every k-th sample, or interpolate a record that is not uniform onto a uniform grid.

        Parameters
        ----------
        dt : float
            New sampling interval [s]; on uniform time a whole multiple of the present one.

        Returns
        -------
        Record
            On uniform time every k-th sample, beginning with the first. No filter is applied: a
            continuous-time model needs none, since samples of the output stay samples of the
            output (`decimate` is the one that filters). Otherwise the outputs on straight lines
            between their samples, ``nan`` where two of them lie more than three typical intervals
            apart or one is missing, and inputs and references as `intersample` and
            `reference_intersample` have them.

        Raises
        ------
        ResampleError
            `dt` is not a whole multiple of a uniform step, or no interval that fits the record.

        Warns
        -----
        DataWarning
            An input or a reference changes between the samples that are kept, so that its
            behaviour between samples is no longer what is stated of it, and a model identified from
            the result will be biased. Or the outputs were
            interpolated, which smooths and colours their noise: `ThreeModel` and `OutputError` take
            the record as it is.

        Examples
        --------
        >>> Record([0, 0, 1, 1, 1], [0, 1, 2, 3, 4], dt=0.1).resample(0.2).y.ravel()
        array([0., 2., 4.])
        """
        dt = instant("dt", dt)
        if self.dt is None:
            return self._interpolated(dt)
        ratio = dt / self.dt if np.isfinite(dt) else np.nan
        factor = round(ratio) if ratio >= 0.5 and np.isfinite(ratio) else 0
        if factor < 1 or abs(ratio - factor) > 1e-6 * factor or self.n_samples <= factor:
            raise ResampleError(
                f"found dt={dt:.6g} s; expected a whole multiple of {self.dt:.6g} s below "
                f"{self.duration:.6g} s; choose such a step, or interpolate u and "
                "y before they become a record"
            )
        warn_if_input_moves(self.u, factor, self.behaviour)
        if self.reference is not None and self.reference_behaviour is not None:
            warn_if_input_moves(self.reference, factor, self.reference_behaviour, "a reference")
        return self._thinned(self.u, self.y, factor, self.intersample, self._loop)

    def _thinned(
        self, u: Array, y: Array, factor: int, intersample: Intersample, loop: dict[str, Any]
    ) -> Record:
        assert self.dt is not None
        driven = loop["reference"]
        return Record(
            u[::factor],
            y[::factor],
            t=self.t[::factor],
            intersample=intersample,
            **{**loop, "reference": None if driven is None else driven[::factor]},
            input_names=self.input_names,
            output_names=self.output_names,
            units=self.units,
            name=self.name,
        )

    def _interpolated(self, dt: float) -> Record:
        if not 0.0 < dt < self.duration:
            raise ResampleError(
                f"found dt={dt:.6g} s; expected a step between 0 and the duration of "
                f"{self.duration:.6g} s; choose such a step"
            )
        if self.duration / dt > MOST_SAMPLES:
            raise ResampleError(
                f"found dt={dt:.6g} s for a record of {self.duration:.6g} s; expected at most "
                f"{MOST_SAMPLES} samples; choose a longer step, or slice the record at its gaps"
            )
        grid = np.arange(int(self.duration / dt * (1.0 + 1e-9)) + 1) * dt + self.t[0]
        warnings.warn(
            "found outputs between whose samples the new ones lie; expected samples as they were "
            "taken, since interpolation smooths and colours the noise; identify the record as it "
            "is, with ThreeModel() or OutputError()",
            DataWarning,
            stacklevel=3,
        )
        u, y = interpolate(self.t, self.u, self.y, grid, self.behaviour)
        return Record(
            u,
            y,
            t=grid,
            intersample=self.intersample,
            **self._loop_at(grid),
            input_names=self.input_names,
            output_names=self.output_names,
            units=self.units,
            name=self.name,
        )

    def _loop_at(self, instants: Array) -> dict[str, Any]:
        """The reference at other instants, as `Record` takes it."""
        if self.reference is None:
            return self._loop
        driven = evaluated(self.t, self.reference, instants, str(self.reference_behaviour))
        return {**self._loop, "reference": driven}

    def decimate(self, factor: int) -> Record:
        """Lower the sampling rate behind an anti-aliasing filter.

        Inputs, outputs and references are filtered by one and the same filter without phase, as
        functions of time (`intersample` says which function the input is, `reference_intersample`
        which one the reference). A linear system and a filter may be
        exchanged, so the filtered output is the same system's response to the filtered input, and
        the model is kept. What is left is the band below 0.7 of the new Nyquist rate, and some of
        the noise: the standard errors tell what that costs.

        Parameters
        ----------
        factor : int
            How many samples become one, at least 2.

        Returns
        -------
        Record
            With ``intersample="band-limited"``, of references too. Outputs are ``nan`` where the
            filter reaches beyond
            the record, 17 samples from either end of the result, and where a sample is missing
            within its reach.

        Raises
        ------
        ResampleError
            The record is not uniform, or too short for the filter.
        OptionError
            `factor` is no whole number of at least 2.

        Examples
        --------
        >>> t = np.arange(2000) * 0.01
        >>> thin = Record(np.sin(t), np.cos(t), dt=0.01, intersample="foh").decimate(10)
        >>> thin
        Record(200 samples, 19.9 s, dt=0.1 s, band-limited, inputs: u, outputs: y)
        >>> bool(np.nanmax(np.abs(thin.y[:, 0] - np.cos(thin.t))) < 1e-4)
        True
        """
        if not isinstance(factor, int) or isinstance(factor, bool) or factor < 2:
            raise OptionError(
                f"found factor={shown(factor)}; expected a whole number of at least 2; correct it"
            )
        if self.dt is None:
            raise ResampleError(
                "found a time axis that is not uniform; expected a uniform one to filter; identify "
                "the record as it is, or resample it first"
            )
        reach = lowpass(factor, "band-limited").size
        if self.n_samples < reach + FEWEST * factor:
            raise ResampleError(
                f"found {self.n_samples} samples; expected at least {reach + FEWEST * factor} for "
                f"an anti-aliasing filter at factor {factor}; choose a smaller factor, or resample"
            )
        u = filtered(self.u, lowpass(factor, self.behaviour), extend=True)
        y = filtered(self.y, lowpass(factor, "band-limited"), extend=False)
        loop = self._loop
        if self.reference is not None and self.reference_behaviour is not None:
            smooth = filtered(
                self.reference, lowpass(factor, self.reference_behaviour), extend=True
            )
            loop |= {"reference": smooth, "reference_intersample": "band-limited"}
        return self._thinned(u, y, factor, "band-limited", loop)

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
    ) -> Record:
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

    def select(
        self,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        references: Sequence[str] | None = None,
    ) -> Record:
        """Choose channels by name.

        Parameters
        ----------
        inputs, outputs : sequence of str, optional
            Names of the channels to keep, in that order; None keeps all.
        references : sequence of str, optional
            Likewise; an empty one keeps none.

        Returns
        -------
        Record
            Same samples, chosen channels.

        Raises
        ------
        ChannelNameError
            There is no channel of that name, or no input or no output was chosen.

        Examples
        --------
        >>> record = Record([0, 1], [[0, 5], [1, 6]], dt=0.1, output_names=["q", "alpha"])
        >>> record.select(outputs=["alpha"]).y.ravel()
        array([5., 6.])
        """
        columns_in, names_in = chosen_channels(inputs, self.input_names, "input")
        columns_out, names_out = chosen_channels(outputs, self.output_names, "output")
        loop = self._driven_by(references)
        kept = {"t", *names_in, *names_out, *loop["reference_names"]}
        return self._derive(
            u=np.ascontiguousarray(self.u[:, columns_in]),
            y=np.ascontiguousarray(self.y[:, columns_out]),
            **loop,
            input_names=names_in,
            output_names=names_out,
            units=MappingProxyType({k: v for k, v in self.units.items() if k in kept}),
        )

    def _driven_by(self, references: Sequence[str] | None) -> dict[str, Any]:
        """Some references, as `Record` takes them."""
        if references is None:
            return self._loop
        if not len(references):
            return {"reference": None, "reference_names": (), "reference_intersample": None}
        columns, names = chosen_channels(references, self.reference_names, "reference")
        assert self.reference is not None
        driven = np.ascontiguousarray(self.reference[:, columns])
        return {**self._loop, "reference": driven, "reference_names": names}

    def mask(self, where: ArrayLike) -> Record:
        """Mark output samples as missing, say those where the sensor was saturated.

        A missing sample tells nothing about the model. That a saturated one lay beyond the limit
        is lost with it; where noise decides which samples are beyond, the rest is a little biased.

        Parameters
        ----------
        where : array_like of bool, shape (n_samples, n_outputs) or (n_samples,)
            True for a sample that does not count; one column goes for all outputs.

        Returns
        -------
        Record
            The same with ``nan`` there.

        Raises
        ------
        ShapeError
            The flags do not fit the outputs.
        SampleTypeError
            They are not boolean.
        EmptyChannelError
            An output would have no sample left.

        Examples
        --------
        >>> record = Record([0, 1, 1], [0.0, 1.0, 9.99], dt=0.1)
        >>> record.mask(record.y >= 9.99).y.ravel()
        array([ 0.,  1., nan])
        """
        flags = np.asarray(where)
        if flags.dtype != np.bool_:
            raise SampleTypeError(
                f"found flags of type {flags.dtype}; expected True or False for each sample; "
                "compare the outputs with a limit, as in record.y >= 9.99"
            )
        if flags.shape not in (self.y.shape, (self.n_samples,)):
            raise ShapeError(
                f"found flags of shape {flags.shape}; expected {self.y.shape}, or "
                f"{(self.n_samples,)} for all outputs alike; keep the shape of record.y"
            )
        column = flags if flags.ndim == 2 else flags[:, np.newaxis]
        return self._derive(y=np.where(column, np.nan, self.y))

    def with_outputs(self, y: ArrayLike) -> Record:
        """Put other samples in place of the outputs.

        Parameters
        ----------
        y : array_like, shape (n_samples, n_outputs)
            ``nan`` marks a missing sample.

        Returns
        -------
        Record
            Same inputs, references, time, names and units.

        Raises
        ------
        ShapeError, SampleTypeError, NotFiniteError, EmptyChannelError
            The samples do not fit, or are not usable.

        Examples
        --------
        >>> record = Record([0, 1, 1], [0.0, 1.0, 9.9], dt=0.1)
        >>> record.with_outputs(np.where(record.y >= 9.9, np.nan, record.y)).y.ravel()
        array([ 0.,  1., nan])
        """
        outputs = sample_array("y", y)
        if outputs.shape != self.y.shape:
            raise ShapeError(
                f"found outputs of shape {outputs.shape}; expected {self.y.shape}, one value for "
                "each of the present ones; keep the shape of record.y"
            )
        return self._derive(y=outputs)

    def _labelled(self, names: tuple[str, ...]) -> str:
        return ", ".join(f"{n} [{self.units[n]}]" if n in self.units else n for n in names)

    def __repr__(self) -> str:
        step = "time not uniform" if self.dt is None else f"dt={self.dt:.6g} s"
        label = f"{self.name!r}, " if self.name else ""
        return (
            f"Record({label}{self.n_samples} samples, {self.duration:.6g} s, {step}, "
            f"{self.intersample}, inputs: {self._labelled(self.input_names)}, "
            f"outputs: {self._labelled(self.output_names)}{self._driven()})"
        )

    def _driven(self) -> str:
        """The references in words, and what they do between samples where that differs."""
        if self.reference is None:
            return ""
        same = self.reference_intersample == self.intersample
        own = "" if same else f" ({self.reference_intersample})"
        return f", references: {self._labelled(self.reference_names)}{own}"

    def _repr_html_(self) -> str:
        missing = int(np.isnan(self.y).sum())
        rows = {
            "samples": f"{self.n_samples} ({missing} missing)" if missing else str(self.n_samples),
            "time": f"{self.t[0]:.6g} s to {self.t[-1]:.6g} s",
            "step": "not uniform" if self.dt is None else f"{self.dt:.6g} s, {self.intersample}",
            "inputs": self._labelled(self.input_names),
            "outputs": self._labelled(self.output_names),
        }
        drawn = [(self.input_names, self.u), (self.output_names, self.y)]
        if self.reference is not None:
            rows["references"] = self._driven().partition(": ")[2]
            drawn.append((self.reference_names, self.reference))
        cells = "".join(f"<tr><th>{k}</th><td>{html.escape(v)}</td></tr>" for k, v in rows.items())
        for names, signals in drawn:
            for name, signal in list(zip(names, signals.T, strict=True))[:_DRAWN]:
                drawing = sparkline(signal, name)
                cells += f"<tr><th>{html.escape(name)}</th><td>{drawing}</td></tr>"
        return f"<table><caption>Record {html.escape(self.name)}</caption>{cells}</table>"


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
