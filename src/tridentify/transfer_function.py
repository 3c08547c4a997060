"""Linear continuous-time models as ratios of polynomials in the differential operator p.

``y_i = sum_j num[i][j](p) / den[i][j](p) u_j(t - delay[i][j])``, coefficients in descending powers,
every denominator monic, no numerator of a higher degree than its denominator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import (
    ChannelCountError,
    OptionError,
    UnsupportedError,
)
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.rational import rational_response, scaled_roots
from tridentify.record.checks.coefficients import (
    channel_delays,
    is_flat,
    monic,
    nested_coefficients,
    stripped,
)
from tridentify.record.checks.names import check_channel
from tridentify.record.checks.samples import channel_names
from tridentify.record.checks.values import made_from
from tridentify.writing import interop
from tridentify.writing.layout import format_polynomial
from tridentify.writing.notebook import fraction
from tridentify.writing.views import ModelViews

Polynomials = tuple[tuple[Array, ...], ...]


@dataclass(frozen=True, eq=False, init=False, repr=False)
class TransferFunction(ModelViews):
    """A matrix of proper rational transfer functions with delays.

    Parameters
    ----------
    num, den : array_like or nested sequence of array_like
        Coefficients in descending powers: one-dimensional for a single channel, nested
        ``num[output][input]`` for several. A one-dimensional `den` with nested `num` is a common
        denominator. Denominators are made monic, numerators scaled along.
    delay : float or nested sequence of float
        Dead time [s], zero or more; one number, or ``delay[output][input]``.
    input_names, output_names : sequence of str, optional
        One name per channel; ``u`` or ``u1, u2, ...`` and likewise ``y`` by default.

    Attributes
    ----------
    num, den : tuple of tuple of ndarray, ``[output][input]``
        Read-only coefficients, descending powers.
    delay : ndarray, shape (n_outputs, n_inputs)
        Dead times [s].

    Raises
    ------
    CoefficientError
        Coefficients are empty or not finite, or a denominator is zero.
    ChannelCountError
        Nested entries do not fit each other.
    ImproperModelError
        A numerator has a higher degree than its denominator.
    OptionError
        A delay is negative or not finite.
    ChannelNameError
        Names are repeated, blank or not as many as the channels.

    Examples
    --------
    >>> from tridentify import TransferFunction
    >>> model = TransferFunction([0.5], [1.0, 1.0, 3.0])
    >>> print(model)
         0.5
    -------------
    s^2 + s + 3
    >>> model.natural_frequency.round(4), model.damping.round(4)
    (array([1.7321, 1.7321]), array([0.2887, 0.2887]))
    """

    num: Polynomials
    den: Polynomials
    delay: Array
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]

    def __init__(
        self,
        num: Any,
        den: Any,
        *,
        delay: float | ArrayLike = 0.0,
        input_names: Sequence[str] | None = None,
        output_names: Sequence[str] | None = None,
    ) -> None:
        numerators = nested_coefficients("num", num)
        shape = (len(numerators), len(numerators[0]))
        denominators = nested_coefficients("den", den)
        if is_flat(den):
            denominators = [denominators[0] * shape[1]] * shape[0]
        if (len(denominators), len(denominators[0])) != shape:
            raise ChannelCountError(
                f"found den for {len(denominators)} outputs x {len(denominators[0])} inputs; "
                f"expected {shape[0]} x {shape[1]} as in num; nest them alike"
            )
        pairs = [
            [monic(n, d) for n, d in zip(row_n, row_d, strict=True)]
            for row_n, row_d in zip(numerators, denominators, strict=True)
        ]
        fields = {
            "num": tuple(tuple(pair[0] for pair in row) for row in pairs),
            "den": tuple(tuple(pair[1] for pair in row) for row in pairs),
            "delay": channel_delays(delay, shape),
            "input_names": channel_names(input_names, shape[1], "u"),
            "output_names": channel_names(output_names, shape[0], "y"),
        }
        self.__dict__.update(fields)

    @classmethod
    def of_monic(
        cls,
        num: Sequence[Sequence[Array]],
        den: Sequence[Sequence[Array]],
        input_names: tuple[str, ...],
        output_names: tuple[str, ...],
    ) -> TransferFunction:
        """A model without delays of polynomials that are finite, proper, monic; not copied."""
        found, delay = object.__new__(cls), np.zeros((len(num), len(num[0])))
        for one in (delay, *(one for row in (*num, *den) for one in row)):
            one.flags.writeable = False
        own = tuple(map(tuple, num)), tuple(map(tuple, den)), delay, input_names, output_names
        found.__dict__.update(zip(cls.__dataclass_fields__, own, strict=True))
        return found

    @property
    def n_inputs(self) -> int:
        """Number of input channels."""
        return len(self.input_names)

    @property
    def n_outputs(self) -> int:
        """Number of output channels."""
        return len(self.output_names)

    @property
    def is_siso(self) -> bool:
        """Whether there is one input and one output."""
        return self.n_inputs == self.n_outputs == 1

    def channel(self, output: int, source: int) -> TransferFunction:
        """Give the model from one input to one output.

        Parameters
        ----------
        output, source : int
            Numbers of the output and of the input, from zero.

        Returns
        -------
        TransferFunction
            With one input and one output.

        Raises
        ------
        ChannelNumberError
            There is no such channel; it is an IndexError, too.

        Examples
        --------
        >>> TransferFunction([[[1.0], [2.0]]], [1.0, 3.0]).channel(0, 1).num[0][0]
        array([2.])
        """
        check_channel(output, source, self.output_names, self.input_names)
        return TransferFunction(
            self.num[output][source],
            self.den[output][source],
            delay=float(self.delay[output, source]),
            input_names=(self.input_names[source],),
            output_names=(self.output_names[output],),
        )

    @property
    def common_denominator(self) -> Array | None:
        """The denominator that all channels share, or None where they differ."""
        first = self.den[0][0]
        same = all(np.array_equal(first, den) for row in self.den for den in row)
        return first if same else None

    @property
    def poles(self) -> Any:
        """Poles [rad/s]: a complex array (SISO), or lists ``[output][input]`` of such arrays."""
        return _roots(self.den)

    @property
    def zeros(self) -> Any:
        """Zeros [rad/s]: a complex array (SISO), or lists ``[output][input]`` of such arrays."""
        return _roots(self.num)

    @property
    def dc_gain(self) -> Array:
        """Steady-state gain, shape (n_outputs, n_inputs); infinite for an integrator."""
        gain: Array = self.frequency_response([0.0])[0].real.copy()
        return gain

    def _common_poles(self) -> Complex:
        den = self.common_denominator
        if den is None:
            raise UnsupportedError(
                "found different denominators in the channels; expected a common one; ask "
                "channel(output, input) for the modes of each"
            )
        return _sorted_roots(den)

    @property
    def natural_frequency(self) -> Array:
        """Natural frequency [rad/s] of every pole of the common denominator, shape (n_poles,)."""
        magnitude: Array = np.abs(self._common_poles())
        return magnitude

    @property
    def damping(self) -> Array:
        """Damping ratio of every pole of the common denominator; nan for a pole at zero."""
        poles = self._common_poles()
        with np.errstate(invalid="ignore"):
            ratio: Array = -poles.real / np.abs(poles)
        return ratio

    @property
    def is_stable(self) -> bool:
        """Whether every pole has a negative real part."""
        return all(bool(np.all(_sorted_roots(den).real < 0.0)) for row in self.den for den in row)

    def frequency_response(self, omega: ArrayLike) -> Complex:
        """Evaluate the model on the imaginary axis.

        Parameters
        ----------
        omega : array_like, shape (n_omega,)
            Angular frequencies [rad/s].

        Returns
        -------
        ndarray of complex, shape (n_omega, n_outputs, n_inputs)
            Infinite where a pole lies on the axis.

        Raises
        ------
        OptionError
            A frequency is not a finite real number.

        Notes
        -----
        Above 1 rad/s the polynomials are evaluated in ``1/s``, so that no power overflows.

        Examples
        --------
        >>> TransferFunction([1.0], [1.0, 1.0]).frequency_response([0.0, 1.0]).ravel()
        array([1. +0.j , 0.5-0.5j])
        """
        frequency = np.atleast_1d(np.asarray(omega))
        if (
            frequency.ndim != 1
            or frequency.dtype.kind not in "fiu"
            or not np.isfinite(frequency).all()
        ):
            raise OptionError.found(
                "omega=", omega, "finite real frequencies [rad/s] in one dimension", "correct omega"
            )
        s = 1j * frequency.astype(np.complex128)
        response = np.empty((s.size, self.n_outputs, self.n_inputs), dtype=np.complex128)
        for i in range(self.n_outputs):
            for j in range(self.n_inputs):
                ratio = rational_response(self.num[i][j], self.den[i][j], s)
                # a complex infinity turns into nan when it is multiplied
                finite = np.isfinite(ratio)
                ratio[finite] *= np.exp(-s[finite] * self.delay[i, j])
                response[:, i, j] = ratio
        return response

    def to_control(self) -> Any:
        """Convert to a `control.TransferFunction`.

        Returns
        -------
        control.TransferFunction

        Raises
        ------
        MissingDependencyError
            python-control is not installed.
        UnsupportedError
            The model has a delay, which python-control cannot hold.

        Examples
        --------
        >>> TransferFunction([0.5], [1.0, 1.0, 3.0]).to_control().den[0][0]
        array([1., 1., 3.])
        """
        interop.import_control()
        interop.refuse_delay(self.delay, "python-control")
        return interop.to_control(self.num, self.den, self.input_names, self.output_names)

    @classmethod
    def from_control(cls, system: Any) -> TransferFunction:
        """Convert from a continuous-time model of python-control.

        Parameters
        ----------
        system : control.TransferFunction or control.StateSpace
            Model in continuous time. Of a state-space model the channels share one denominator.

        Returns
        -------
        TransferFunction
            Channels keep the names they were given.

        Raises
        ------
        MissingDependencyError
            python-control is not installed.
        UnsupportedError
            `system` is another kind of model, or one in discrete time.

        Examples
        --------
        >>> import control
        >>> TransferFunction.from_control(control.tf([2.0], [2.0, 4.0])).den[0][0]
        array([1., 2.])
        """
        return cls._of(interop.from_control(system))

    @classmethod
    def from_scipy(cls, system: Any) -> TransferFunction:
        """Convert from a continuous-time model of SciPy.

        Parameters
        ----------
        system : scipy.signal.lti or tuple
            `TransferFunction`, `ZerosPolesGain` or `StateSpace`, or a tuple as SciPy takes it:
            ``(num, den)``, ``(zeros, poles, gain)`` or ``(A, B, C, D)``.

        Returns
        -------
        TransferFunction

        Raises
        ------
        UnsupportedError
            `system` is another kind of model, or one in discrete time.
        CoefficientError
            It makes no real polynomials.

        Examples
        --------
        >>> from scipy.signal import ZerosPolesGain
        >>> TransferFunction.from_scipy(ZerosPolesGain([], [-1.0, -2.0], 4.0))
        TransferFunction([4.0], [1.0, 3.0, 2.0])
        >>> TransferFunction.from_scipy(([1.0], [2.0, 4.0])).num[0][0]
        array([0.5])
        """
        return cls._of(interop.from_scipy(system))

    @classmethod
    def _of(cls, found: interop.Coefficients) -> TransferFunction:
        return cls(
            found.num,
            found.den,
            input_names=found.input_names,
            output_names=found.output_names,
        )

    def to_scipy(self) -> Any:
        """Convert to a `scipy.signal.TransferFunction`.

        Returns
        -------
        scipy.signal.TransferFunction

        Raises
        ------
        UnsupportedError
            The model has several channels or a delay, which SciPy cannot hold.

        Examples
        --------
        >>> TransferFunction([1.0], [2.0, 4.0]).to_scipy().num
        array([0.5])
        """
        interop.refuse_delay(self.delay, "scipy")
        if not self.is_siso:
            raise UnsupportedError(
                f"found {self.n_outputs} outputs and {self.n_inputs} inputs; expected one of each "
                "for scipy; convert channel(output, input)"
            )
        return interop.to_scipy(stripped(self.num[0][0]), self.den[0][0])

    def _channels(self) -> list[tuple[int, int, str]]:
        return [
            (i, j, "" if self.is_siso else f"{self.output_names[i]} <- {self.input_names[j]}")
            for i in range(self.n_outputs)
            for j in range(self.n_inputs)
        ]

    def __str__(self) -> str:
        blocks = []
        for i, j, label in self._channels():
            fraction = _fraction_text(self.num[i][j], self.den[i][j], float(self.delay[i, j]))
            blocks.append(f"{label}:\n{fraction}" if label else fraction)
        return "\n\n".join(blocks)

    def _repr_html_(self) -> str:
        """Every channel as MathML."""
        found = []
        for i, j, label in self._channels():
            top, below = ([(c, 0.0) for c in p.tolist()] for p in (self.num[i][j], self.den[i][j]))
            late = float(self.delay[i, j])
            left = label or f"{self.output_names[i]} <- {self.input_names[j]}"
            found.append(fraction(left, top, below, f"exp(-{late:.6g} s) " if late else ""))
        return "".join(found)

    def __repr__(self) -> str:
        content = self.to_dict()
        num, den = (content[k][0][0] if self.is_siso else content[k] for k in ("num", "den"))
        delay = f", delay={content['delay']}" if np.any(self.delay) else ""
        return f"TransferFunction({num}, {den}{delay})"

    def to_dict(self) -> dict[str, Any]:
        """Give plain numbers, text and lists, ready for JSON.

        Returns
        -------
        dict

        Examples
        --------
        >>> TransferFunction([1.0], [1.0, 2.0]).to_dict()["den"]
        [[[1.0, 2.0]]]
        """
        return {
            "num": [[item.tolist() for item in row] for row in self.num],
            "den": [[item.tolist() for item in row] for row in self.den],
            "delay": self.delay.tolist(),
            "input_names": list(self.input_names),
            "output_names": list(self.output_names),
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> TransferFunction:
        """Undo `to_dict`.

        Parameters
        ----------
        content : mapping
            What `to_dict` gave.

        Returns
        -------
        TransferFunction

        Raises
        ------
        StructureError
            Keys are missing or unknown, or the values make no model.

        Examples
        --------
        >>> model = TransferFunction([1.0], [1.0, 2.0], delay=0.1)
        >>> TransferFunction.from_dict(model.to_dict())
        TransferFunction([1.0], [1.0, 2.0], delay=[[0.1]])
        """
        return made_from(cls, content, "num", "den")

    def __reduce__(self) -> tuple[Any, ...]:
        return TransferFunction.from_dict, (self.to_dict(),)


def _fraction_text(num: Array, den: Array, delay: float) -> str:
    top, bottom = (format_polynomial(p.tolist(), [0.0] * p.size) for p in (num, den))
    width = max(len(top), len(bottom)) + 2
    front = f"exp(-{delay:.6g} s) " if delay > 0.0 else ""
    margin = " " * len(front)
    lines = (margin + top.center(width), front + "-" * width, margin + bottom.center(width))
    return "\n".join(line.rstrip() for line in lines)


def _sorted_roots(coefficients: Array) -> Complex:
    return np.sort_complex(scaled_roots(coefficients))


def _roots(polynomials: Polynomials) -> Any:
    roots = [[_sorted_roots(item) for item in row] for row in polynomials]
    return roots[0][0] if len(roots) == len(roots[0]) == 1 else roots
