"""A planned input: samples, what they do between the samples, and what they are.

The *crest factor* is the largest magnitude over the root mean square. At a given amplitude limit it
says how much power an input brings: a held binary signal has 1, a sine 1.41, noise 3 and more.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import OptionError, ShapeError, shown
from tridentify.excitation.checks import count, not_negative, positive
from tridentify.numerics.arrays import Array
from tridentify.record.checks.names import check_units
from tridentify.record.checks.samples import Intersample, channel_names
from tridentify.record.record import Record
from tridentify.writing.files import columns_over_time, write_atomically
from tridentify.writing.layout import format_table, html_table
from tridentify.writing.notebook import sparkline


@dataclass(frozen=True, eq=False, repr=False)
class Excitation:
    """Inputs that are planned, for a record that is still to be made.

    Parameters
    ----------
    u : array_like, shape (n_samples,) or (n_samples, n_inputs)
        Inputs, about their trim values.
    dt : float
        Sampling interval [s].
    intersample : {"zoh", "foh", "band-limited"}
        What the input does between the samples.
    what : str
        In words.
    period : int
        Samples of one period; 0 for a signal that has none.
    input_names : sequence of str, optional
    units : mapping of str to str, optional
        Of the channels.

    Raises
    ------
    OptionError, ShapeError
        The samples are no finite array, or `dt` is not positive.
    ChannelNameError, UnitError
        A name or a unit is not printable or too long, or a name is repeated.

    Examples
    --------
    >>> from tridentify.excitation import doublet
    >>> plan = doublet(0.05, 0.5, dt=0.25, tail=0.5)
    >>> plan.u.ravel().tolist()
    [0.05, 0.05, -0.05, -0.05, 0.0, 0.0]
    >>> plan
    Excitation(doublet of 2 x 0.5 s: 6 samples, 1.5 s, dt=0.25 s, zoh, u: 0.05)
    """

    u: Array
    dt: float
    intersample: Intersample = "zoh"
    what: str = "input"
    period: int = 0
    input_names: Sequence[str] = ()
    units: Mapping[str, str] | None = None

    def __post_init__(self) -> None:
        try:
            u = np.array(self.u, dtype=np.float64)
        except (TypeError, ValueError):
            u = np.zeros(())
        u = u[:, None] if u.ndim == 1 else u
        if u.ndim != 2 or u.shape[0] < 2 or u.shape[1] < 1 or not np.all(np.isfinite(u)):
            raise ShapeError(
                f"found u={shown(self.u)}; expected finite samples (n_samples, n_inputs), two or "
                "more; give one column per input"
            )
        if self.intersample not in ("zoh", "foh", "band-limited"):
            raise OptionError.found(
                "intersample=", self.intersample, "'zoh', 'foh' or 'band-limited'", "choose one"
            )
        u.setflags(write=False)
        names = channel_names(self.input_names or None, u.shape[1], "u")
        check_units(self.units or {})
        fields: dict[str, object] = {
            "u": u,
            "dt": positive("dt", self.dt),
            "input_names": names,
            "units": MappingProxyType(dict(self.units or {})),
        }
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.u.shape[0])

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return int(self.u.shape[1])

    @property
    def duration(self) -> float:
        """How long the samples last, the hold after the last one included [s]."""
        return self.n_samples * self.dt

    @property
    def t(self) -> Array:
        """(n_samples,) instants from zero [s]."""
        return np.asarray(np.arange(self.n_samples) * self.dt)

    @property
    def amplitude(self) -> Array:
        """(n_inputs,) largest magnitudes."""
        return np.asarray(np.abs(self.u).max(axis=0))

    @property
    def rms(self) -> Array:
        """(n_inputs,) root mean squares."""
        return np.asarray(np.sqrt(np.mean(self.u**2, axis=0)))

    @property
    def crest_factor(self) -> Array:
        """(n_inputs,) largest magnitude over root mean square; nan for an input of zeros."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.amplitude / self.rms)

    def scaled(self, factor: ArrayLike) -> Excitation:
        """The same course with another amplitude.

        Parameters
        ----------
        factor : float or (n_inputs,) array_like

        Returns
        -------
        Excitation
        """
        given = np.asarray(factor, dtype=np.float64)
        if given.shape not in ((), (self.n_inputs,)) or not np.all(np.isfinite(given)):
            raise OptionError.found(
                "factor=", factor, f"a finite number, or one for each of {self.n_inputs} inputs"
            )
        return replace(self, u=self.u * given)

    def repeated(self, times: int) -> Excitation:
        """The same course several times, one after the other."""
        times = count("times", times)
        return replace(self, u=np.tile(self.u, (times, 1)), what=f"{times} x {self.what}")

    def with_rest(self, lead: float = 0.0, tail: float = 0.0) -> Excitation:
        """The same course with all inputs at rest before and after it.

        Before it the trim is seen, which the offset is estimated from; after it the response dies
        out.

        Parameters
        ----------
        lead, tail : float
            How long [s], rounded to whole samples.

        Returns
        -------
        Excitation
            Without a period, unless both are zero.

        Raises
        ------
        OptionError
            A time is negative or not finite.

        Examples
        --------
        >>> from tridentify.excitation import doublet
        >>> doublet(1.0, 1.0, dt=0.5).with_rest(0.5, 1.0).u.ravel().tolist()
        [0.0, 1.0, 1.0, -1.0, -1.0, 0.0, 0.0]
        """
        before, after = (
            round(not_negative(name, value) / self.dt)
            for name, value in (("lead", lead), ("tail", tail))
        )
        if not before + after:
            return self
        parts = [np.zeros((before, self.n_inputs)), self.u, np.zeros((after, self.n_inputs))]
        rest = f"rest {before * self.dt:.4g} s before, {after * self.dt:.4g} s after"
        return replace(self, u=np.concatenate(parts), period=0, what=f"{self.what}, {rest}")

    def named(
        self, input_names: Sequence[str], units: Mapping[str, str] | None = None
    ) -> Excitation:
        """The same samples for channels of these names and units."""
        return replace(self, input_names=tuple(input_names), units=units or self.units)

    def record(
        self, y: ArrayLike | None = None, *, output_names: Sequence[str] | None = None
    ) -> Record:
        """Make a record of the input.

        Parameters
        ----------
        y : array_like, shape (n_samples,) or (n_samples, n_outputs), optional
            What was measured. Without it the outputs are zeros, one for each of `output_names`
            (one by default): enough for `simulate`, which looks at the input alone.
        output_names : sequence of str, optional

        Returns
        -------
        Record

        Examples
        --------
        >>> from tridentify import TransferFunction, simulate
        >>> from tridentify.excitation import doublet
        >>> plan = doublet(1.0, 1.0, dt=0.5)
        >>> simulate(TransferFunction([1.0], [1.0, 1.0]), plan.record()).shape
        (4, 1)
        """
        if y is None:
            y = np.zeros((self.n_samples, 1 if output_names is None else len(output_names)))
        known = (*self.input_names, *(output_names or ()))
        return Record(
            self.u,
            y,
            dt=self.dt,
            intersample=self.intersample,
            input_names=self.input_names,
            output_names=output_names,
            units={k: v for k, v in (self.units or {}).items() if k in known},
            name=self.what,
        )

    def spectrum(self) -> tuple[Array, Array]:
        """Amplitude spectrum.

        Returns
        -------
        omega : (n_omega,) array
            [rad/s], from zero to half the sampling rate.
        amplitude : (n_omega, n_inputs) array
            Of the sines that the samples are made of, in units of the input: ``2 |U_k| / N``.
        """
        n = self.n_samples
        omega = 2.0 * np.pi * np.fft.rfftfreq(n, self.dt)
        lines = 2.0 * np.abs(np.fft.rfft(self.u, axis=0)) / n
        lines[0] *= 0.5
        if n % 2 == 0:
            lines[-1] *= 0.5
        return np.asarray(omega), np.asarray(lines)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a CSV file: time and every input, with units in the header, no digit lost.

        Parameters
        ----------
        path : path-like

        Returns
        -------
        Path

        Raises
        ------
        OutputPathError
            The file cannot be written; nothing is left behind.
        """
        text = columns_over_time(self.t, self.u, self.input_names, self.units or {})
        return write_atomically(path, text)

    def _rows(self) -> list[tuple[str, ...]]:
        units = self.units or {}
        return [
            (name, f"{a:.4g}", f"{r:.4g}", f"{c:.3f}", units.get(name, ""))
            for name, a, r, c in zip(
                self.input_names, self.amplitude, self.rms, self.crest_factor, strict=True
            )
        ]

    def summary(self) -> str:
        """What it is, and amplitude, root mean square and crest factor of every input."""
        head = f"{self.what}: {self.n_samples:,} samples, {self.duration:.6g} s, dt={self.dt:.6g} s"
        table = format_table(_TITLES, self._rows())
        return "\n".join([f"{head}, {self.intersample}", "", *table])

    def _repr_html_(self) -> str:
        caption = f"{self.what}, {self.duration:.6g} s, dt={self.dt:.6g} s, {self.intersample}"
        drawn = zip(self.input_names, self.u.T, strict=True)
        return html_table(_TITLES, self._rows(), caption) + "".join(
            f"<div>{sparkline(signal, name)}</div>" for name, signal in drawn
        )

    def __repr__(self) -> str:
        pairs = zip(self.input_names, self.amplitude, strict=True)
        sizes = ", ".join(f"{name}: {amplitude:.6g}" for name, amplitude in pairs)
        return (
            f"Excitation({self.what}: {self.n_samples} samples, {self.duration:.6g} s, "
            f"dt={self.dt:.6g} s, {self.intersample}, {sizes})"
        )

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "units": dict(self.units or {})}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for key, value in {**state, "units": MappingProxyType(state["units"])}.items():
            object.__setattr__(self, key, value)
        self.u.setflags(write=False)


_TITLES = ("input", "amplitude", "rms", "crest factor", "unit")
