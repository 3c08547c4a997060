"""A record at another sampling rate: every k-th sample, interpolated, or behind a filter."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from tridentify.errors import DataWarning, OptionError, ResampleError
from tridentify.numerics.arrays import Array
from tridentify.numerics.interpolation import FEWEST, lowpass
from tridentify.record.checks.rates import evaluated, filtered, interpolate
from tridentify.record.checks.samples import Intersample, warn_if_input_moves
from tridentify.record.checks.times import instant
from tridentify.record.samples import Samples

MOST_SAMPLES = 20_000_000
"""160 MB a channel; more is a step in microseconds, or a gap of years."""


class Resampled(Samples):
    """The verbs of a `Record` that change its times."""

    def _resampled(
        self, t: Array, u: Array, y: Array, intersample: Intersample, loop: Mapping[str, Any]
    ) -> Self:
        """A record of other samples of the same channels; ``loop`` is its reference."""
        kind: Any = type(self)
        made: Self = kind(
            u,
            y,
            t=t,
            intersample=intersample,
            **loop,
            input_names=self.input_names,
            output_names=self.output_names,
            units=self.units,
            name=self.name,
        )
        return made._weighed(self._noise_scale)

    def resample(self, dt: float) -> Self:
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
        >>> from tridentify import Record
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
    ) -> Self:
        driven = loop["reference"]
        fewer = {**loop, "reference": None if driven is None else driven[::factor]}
        return self._resampled(self.t[::factor], u[::factor], y[::factor], intersample, fewer)

    def _interpolated(self, dt: float) -> Self:
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
        return self._resampled(grid, u, y, self.intersample, self._loop_at(grid))

    def _loop_at(self, instants: Array) -> dict[str, Any]:
        """The reference at other instants, as `Record` takes it."""
        if self.reference is None:
            return self._loop
        driven = evaluated(self.t, self.reference, instants, str(self.reference_behaviour))
        return {**self._loop, "reference": driven}

    def decimate(self, factor: int) -> Self:
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
        >>> from tridentify import Record
        >>> t = np.arange(2000) * 0.01
        >>> thin = Record(np.sin(t), np.cos(t), dt=0.01, intersample="foh").decimate(10)
        >>> thin
        Record(200 samples, 19.9 s, dt=0.1 s, band-limited, inputs: u, outputs: y)
        >>> bool(np.nanmax(np.abs(thin.y[:, 0] - np.cos(thin.t))) < 1e-4)
        True
        """
        if not isinstance(factor, int) or isinstance(factor, bool) or factor < 2:
            raise OptionError.found("factor=", factor, "a whole number of at least 2")
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
