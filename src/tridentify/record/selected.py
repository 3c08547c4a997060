"""Part of a record: a stretch of its time, some of its channels, samples that count; no trend."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import EmptyRangeError, OptionError, SampleTypeError, ShapeError, shown
from tridentify.record.checks.samples import check_band_limited, chosen_channels, sample_array
from tridentify.record.checks.times import instant, sample_range, time_slack, uniform_step
from tridentify.record.samples import Samples


class Selected(Samples):
    """The verbs of a `Record` that leave samples where they are."""

    def slice(self, start: float | None = None, stop: float | None = None) -> Self:
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
        >>> from tridentify import Record
        >>> Record([0, 1, 1, 1], [0, 1, 2, 3], dt=0.1).slice(0.1, 0.3).n_samples
        3
        """
        return self._part(*sample_range(self.t, start, stop))

    def split(self, at: float, *more: float) -> tuple[Self, ...]:
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
        >>> from tridentify import Record
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

    def _part(self, first: int, last: int) -> Self:
        t = self.t[first:last]
        if "band-limited" in (self.intersample, self.reference_intersample):
            check_band_limited(self.dt, len(t))
        step = uniform_step(t) if self.dt is None else self.dt
        driven = None if self.reference is None else self.reference[first:last]
        return self._derive(
            u=self.u[first:last], y=self.y[first:last], reference=driven, t=t, dt=step
        )

    def detrend(self, order: Literal[0, 1] = 0) -> Self:
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
        >>> from tridentify import Record
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

    def select(
        self,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        references: Sequence[str] | None = None,
    ) -> Self:
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
        >>> from tridentify import Record
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
            _noise_scale=None if self._noise_scale is None else self._noise_scale[columns_out],
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

    def mask(self, where: ArrayLike) -> Self:
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
        >>> from tridentify import Record
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

    def with_outputs(self, y: ArrayLike) -> Self:
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
        >>> from tridentify import Record
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
