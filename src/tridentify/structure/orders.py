"""How many poles and zeros every channel has, and how a parameter vector is cut by them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import ChannelCountError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.checks.orders import Matrix, channel_matrix


@dataclass(frozen=True)
class Orders:
    """Poles, zeros and delay of a model, as `Structure` takes them."""

    poles: int | Sequence[Sequence[int]]
    zeros: int | Sequence[Sequence[int]] = None  # type: ignore[assignment]
    _: KW_ONLY
    delay: float | Sequence[Sequence[float]] | Literal["free"] = 0.0

    @property
    def shared(self) -> bool:
        """Whether one denominator is shared by all channels; a single channel shares its own."""
        return isinstance(self.poles, int) or (len(self.poles), len(self.poles[0])) == (1, 1)

    @property
    def common_poles(self) -> int:
        """Degree of the denominator that all channels share.

        Raises
        ------
        ChannelCountError
            The channels have separate denominators.
        """
        if isinstance(self.poles, int):
            return self.poles
        if not self.shared:
            raise ChannelCountError(
                f"found separate denominators, poles={shown(self.poles)}; expected one that all "
                "channels share; give poles as one number"
            )
        return self.poles[0][0]

    def poles_matrix(self, n_outputs: int, n_inputs: int) -> Matrix[int]:
        """Give the number of poles of every channel.

        Parameters
        ----------
        n_outputs, n_inputs : int
            Numbers of channels of the record.

        Returns
        -------
        tuple of tuple of int, ``[output][input]``

        Raises
        ------
        ChannelCountError
            The nested orders are for other numbers of channels.

        Examples
        --------
        >>> from tridentify import Structure
        >>> Structure(2, 0).poles_matrix(1, 2)
        ((2, 2),)
        """
        return channel_matrix("poles", cast("int | Matrix[int]", self.poles), n_outputs, n_inputs)

    def zeros_matrix(self, n_outputs: int, n_inputs: int) -> Matrix[int]:
        """Give the degree of the numerator of every channel.

        Parameters
        ----------
        n_outputs, n_inputs : int
            Numbers of channels of the record.

        Returns
        -------
        tuple of tuple of int, ``[output][input]``

        Raises
        ------
        ChannelCountError
            The nested orders are for other numbers of channels.

        Examples
        --------
        >>> from tridentify import Structure
        >>> Structure(2, [[1], [0]]).zeros_matrix(2, 1)
        ((1,), (0,))
        """
        return channel_matrix("zeros", cast("int | Matrix[int]", self.zeros), n_outputs, n_inputs)

    def delay_matrix(self, n_outputs: int, n_inputs: int) -> Matrix[float]:
        """Give the known delay of every channel.

        Parameters
        ----------
        n_outputs, n_inputs : int
            Numbers of channels of the record.

        Returns
        -------
        tuple of tuple of float, ``[output][input]`` [s]
            Zero where the delay is to be estimated.

        Raises
        ------
        ChannelCountError
            The nested delays are for other numbers of channels.

        Examples
        --------
        >>> from tridentify import Structure
        >>> Structure(2, 0, delay=0.1).delay_matrix(1, 2)
        ((0.1, 0.1),)
        """
        known = 0.0 if self.delay == "free" else cast("float | Matrix[float]", self.delay)
        return channel_matrix("delay", known, n_outputs, n_inputs)

    def n_parameters(self, n_outputs: int = 1, n_inputs: int = 1) -> int:
        """Count the coefficients, fixed ones included.

        Parameters
        ----------
        n_outputs, n_inputs : int
            Numbers of channels of the record.

        Returns
        -------
        int
            Length of the parameter vector.

        Raises
        ------
        ChannelCountError
            Nested orders are for other numbers of channels.

        Examples
        --------
        >>> from tridentify import Structure
        >>> Structure(2, 1).n_parameters(2, 1)
        6
        """
        poles = self.poles_matrix(n_outputs, n_inputs)
        zeros = self.zeros_matrix(n_outputs, n_inputs)
        denominators = poles[0][0] if self.shared else sum(map(sum, poles))
        numerators = sum(map(sum, zeros)) + n_outputs * n_inputs
        return denominators + numerators + (n_inputs if self.delay == "free" else 0)

    def split(
        self, theta: ArrayLike, n_outputs: int = 1, n_inputs: int = 1
    ) -> tuple[list[list[Array]], list[list[Array]]]:
        """Cut a parameter vector into numerators and monic denominators.

        Parameters
        ----------
        theta : array_like, shape (n_parameters,)
            Coefficients in the order of `names`; free delays at its end are passed over.
        n_outputs, n_inputs : int
            Numbers of channels.

        Returns
        -------
        num, den : list of list of ndarray, ``[output][input]``
            Descending powers, lengths zeros + 1 and poles + 1.

        Raises
        ------
        ChannelCountError
            `theta` has another length, or nested orders are for other numbers of channels.

        Examples
        --------
        >>> from tridentify import Structure
        >>> num, den = Structure(2, 0).split([1.0, 3.0, 0.5])
        >>> num[0][0], den[0][0]
        (array([0.5]), array([1., 1., 3.]))
        """
        values = np.asarray(theta, dtype=np.float64)
        expected = self.n_parameters(n_outputs, n_inputs)
        if values.shape != (expected,):
            raise ChannelCountError(
                f"found theta of shape {values.shape}; expected ({expected},) for {n_outputs} "
                f"outputs and {n_inputs} inputs; order it as names() does"
            )
        poles = self.poles_matrix(n_outputs, n_inputs)
        zeros = self.zeros_matrix(n_outputs, n_inputs)
        position = poles[0][0] if self.shared else 0
        common = values[:position]
        num: list[list[Array]] = [[] for _ in range(n_outputs)]
        den: list[list[Array]] = [[] for _ in range(n_outputs)]
        for i in range(n_outputs):
            for j in range(n_inputs):
                own = 0 if self.shared else poles[i][j]
                lower = common if self.shared else values[position : position + own]
                den[i].append(np.concatenate(([1.0], lower)))
                position += own
                num[i].append(values[position : position + zeros[i][j] + 1].copy())
                position += zeros[i][j] + 1
        return num, den
