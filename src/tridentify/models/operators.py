"""Banks of operators ``W_i(p)``, applied exactly.

The parallel and the series model are weighted sums of operators (paper, eq. 3). All banks here
live on an orthonormal cascade (`numerics.realization`): each operator is a fixed combination of
the cascade's states and, for all-pass powers, of the input itself. Applied to a held or ramping
input they are exact at the samples.

`AllPass` and `Laguerre` with the same ``gamma`` span, together with ``W_0 = 1``, the same
space: ``((p - g) / (p + g))^i`` is ``1 - sum_{k <= i} sqrt(2 g) L_k(p)``. The fit is the same;
the conditioning is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import cascade, sort_poles
from tridentify.numerics.sampled import Sampled, States
from tridentify.record.checks.scales import LARGEST_TIME
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record


class OperatorBank(Protocol):
    """What the parallel and the series model ask of a bank."""

    @property
    def poles(self) -> Complex:
        """Poles of the cascade on which the operators live."""

    @property
    def rows(self) -> Array:
        """(n_operators, n_states): operators as combinations of the states."""

    @property
    def direct(self) -> Array:
        """(n_operators,): their direct terms."""


def _check(gamma: float, order: int) -> None:
    if not (isinstance(gamma, (int, float)) and 1.0 / LARGEST_TIME <= gamma <= LARGEST_TIME):
        raise OptionError(
            f"found gamma={shown(gamma)}; expected a positive number of rad/s, at most "
            f"{LARGEST_TIME:.0e}; correct it"
        )
    if not isinstance(order, int) or order < 1:
        raise OptionError(f"found order={order!r}; expected a whole number >= 1; correct it")


@dataclass(frozen=True)
class OneRate:
    """Operators that have their poles at one place.

    Parameters
    ----------
    gamma : float
        [rad/s], positive.
    order : int
        Number of operators.
    """

    gamma: float
    order: int

    def __post_init__(self) -> None:
        _check(self.gamma, self.order)

    @property
    def poles(self) -> Complex:
        """``-gamma``, ``order`` times."""
        return np.full(self.order, -self.gamma, dtype=np.complex128)


@dataclass(frozen=True)
class AllPass(OneRate):
    """Powers of an all-pass, ``W_i = ((p - gamma) / (p + gamma))^i`` (paper, eq. 4).

    Parameters
    ----------
    gamma : float
        [rad/s], positive.
    order : int
        Number of operators.

    Raises
    ------
    OptionError
        For a ``gamma`` that is not positive or an order below one.

    Examples
    --------
    >>> AllPass(2.0, 3).direct.tolist()
    [1.0, 1.0, 1.0]
    """

    @property
    def rows(self) -> Array:
        """``-sqrt(2 gamma)`` on and below the diagonal."""
        return np.asarray(-np.sqrt(2.0 * self.gamma) * np.tri(self.order))

    @property
    def direct(self) -> Array:
        """All one."""
        return np.ones(self.order)


@dataclass(frozen=True)
class Laguerre(OneRate):
    """Orthonormal Laguerre functions, ``W_i = sqrt(2 gamma) (p - gamma)^(i-1) / (p + gamma)^i``.

    Parameters
    ----------
    gamma : float
        [rad/s], positive.
    order : int
        Number of operators.

    Raises
    ------
    OptionError
        For a ``gamma`` that is not positive or an order below one.

    References
    ----------
    .. [1] B. Wahlberg, System identification using Laguerre models, IEEE Trans. AC 36(5), 1991.

    Examples
    --------
    >>> Laguerre(1.0, 2).rows.tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """

    @property
    def rows(self) -> Array:
        """The states themselves."""
        return np.eye(self.order)

    @property
    def direct(self) -> Array:
        """All zero."""
        return np.zeros(self.order)


@dataclass(frozen=True)
class GeneralizedBasis:
    """Orthonormal (Takenaka-Malmquist) functions on any stable poles, repeated or not.

    Parameters
    ----------
    pole_list : sequence of complex
        Closed under conjugation, in the open left half plane [rad/s].

    Raises
    ------
    OptionError
        For an unstable pole or a complex pole without its conjugate.

    References
    ----------
    .. [1] B. Ninness, F. Gustafsson, A unifying construction of orthonormal bases for system
       identification, IEEE Trans. AC 42(4), 1997.

    Examples
    --------
    >>> GeneralizedBasis((-1 + 2j, -1 - 2j, -5)).rows.shape
    (3, 3)
    """

    pole_list: tuple[complex, ...]

    def __post_init__(self) -> None:
        poles = np.asarray(self.pole_list, dtype=np.complex128)
        if poles.size == 0 or not np.all(np.isfinite(poles)) or np.any(poles.real >= 0):
            raise OptionError(
                f"found poles {self.pole_list}; expected negative real parts; correct them"
            )
        mirrored = np.sort_complex(poles.conjugate())
        if not np.allclose(
            np.sort_complex(poles), mirrored, rtol=0, atol=1e-12 * np.abs(poles).max()
        ):
            raise OptionError(
                f"found poles {self.pole_list}; expected conjugate pairs; add the missing conjugate"
            )

    @property
    def poles(self) -> Complex:
        """Pairs side by side, slow to fast."""
        return sort_poles(np.asarray(self.pole_list, dtype=np.complex128))

    @property
    def rows(self) -> Array:
        """The states themselves."""
        return np.eye(len(self.pole_list))

    @property
    def direct(self) -> Array:
        """All zero."""
        return np.zeros(len(self.pole_list))


def Kautz(pole: complex, order: int) -> GeneralizedBasis:
    """Orthonormal Kautz functions: one conjugate pair, repeated.

    Parameters
    ----------
    pole : complex
        One pole of the pair [rad/s].
    order : int
        Number of pairs.

    Examples
    --------
    >>> Kautz(-0.5 + 3j, 2).poles.tolist()
    [(-0.5+3j), (-0.5-3j), (-0.5+3j), (-0.5-3j)]
    """
    _check(abs(pole), order)
    return GeneralizedBasis((complex(pole), complex(pole).conjugate()) * order)


def apply_operators(bank: OperatorBank, record: Record) -> Array:
    """Pass every input of a record through every operator, exactly.

    Parameters
    ----------
    bank : OperatorBank
    record : Record

    Returns
    -------
    (n_samples, n_inputs, n_operators) array
        In units of the inputs (times sqrt(s) for orthonormal functions).

    Examples
    --------
    >>> record = Record(np.ones(3), np.ones(3), dt=0.5)
    >>> apply_operators(AllPass(1.0, 1), record)[:, 0, 0].round(6).tolist()
    [1.0, 0.213061, -0.264241]
    """
    since = record.t - record.t[0]
    signal = Sampled(
        np.ascontiguousarray(record.u),
        typical_step(record.t) if record.dt is None else record.dt,
        record.behaviour,
        since if record.dt is None else None,
    )
    c = cascade(bank.poles)
    states = np.empty((record.n_inputs * c.order, record.n_samples))
    runner = States(signal, c.a, c.b, upper=int(np.any(c.poles.imag != 0)))
    runner.advance(0, record.n_samples, states)
    n_states = bank.rows.shape[1]
    shaped = states.reshape(record.n_inputs, n_states, record.n_samples)
    value = np.einsum("jqk,iq->kji", shaped, bank.rows)
    return np.asarray(value + record.u[:, :, None] * bank.direct)
