"""Coefficients from and to the models of python-control and SciPy.

A state-space model becomes polynomials without determinants of its matrices: the denominator has
the eigenvalues of ``A`` as its roots, and the numerator of a channel is the polynomial of degree
``n`` through the values of ``(c (s - A)^{-1} b + d) a(s)`` at ``n + 1`` points on a circle, which
one Fourier transform finds. Coefficients that are small on one circle are large on another, so
there is a circle between any two groups of poles, and each coefficient is taken from where it
counts most. What lies below rounding everywhere, as all leading coefficients of a strictly proper
model do, is zero. Poles that no input reaches or no output shows stay in both
polynomials: which of them cancel is not for a conversion to decide.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tridentify.errors import CoefficientError, MissingDependencyError, UnsupportedError, shown
from tridentify.numerics.arrays import Array

Nested = list[list[Array]]

ROUNDING = 1e-12
"""Share of the largest term below which a coefficient of another package's model is zero."""
APART = 1.5
"""Ratio of two magnitudes from which roots are no cluster."""


class Coefficients(NamedTuple):
    """What a `TransferFunction` is made of; None for names that were made up."""

    num: Nested
    den: Nested
    input_names: list[str] | None
    output_names: list[str] | None


def import_control() -> Any:
    """python-control.

    Raises
    ------
    MissingDependencyError
        It is not installed.
    """
    try:
        import control
    except ImportError as error:
        raise MissingDependencyError(
            "found no python-control; expected it for this conversion; pip install control"
        ) from error
    return control


def refuse_delay(delay: Array, package: str) -> None:
    """Refuse a dead time that another package cannot hold.

    Raises
    ------
    UnsupportedError
    """
    if np.any(delay > 0.0):
        raise UnsupportedError(
            f"found a delay of {delay.max():.6g} s; expected none, since {package} cannot "
            "hold it; build the model again without delay, or with a Pade approximation"
        )


def to_control(
    num: Sequence[Sequence[Array]],
    den: Sequence[Sequence[Array]],
    input_names: Sequence[str],
    output_names: Sequence[str],
) -> Any:
    """A `control.TransferFunction`; names without dots, which python-control keeps for itself."""
    return import_control().TransferFunction(
        [[np.array(item) for item in row] for row in num],
        [[np.array(item) for item in row] for row in den],
        inputs=_without_dots(input_names),
        outputs=_without_dots(output_names),
    )


def _without_dots(names: Sequence[str]) -> list[str]:
    """Names with underscores in place of dots, still all different.

    Examples
    --------
    >>> _without_dots(["q.x", "q_x", "p"])
    ['q_x_2', 'q_x', 'p']
    """
    found: list[str] = []
    taken = {name for name in names if "." not in name}
    for name in names:
        made, k = name.replace(".", "_"), 2
        other = made
        while "." in name and other in taken:
            other, k = f"{made}_{k}", k + 1
        taken.add(other)
        found.append(other)
    return found


def from_control(system: Any) -> Coefficients:
    """Coefficients of a continuous-time model of python-control.

    Raises
    ------
    MissingDependencyError
        python-control is not installed.
    UnsupportedError
        `system` is another kind of model, or one in discrete time.
    """
    control = import_control()
    kinds = (control.TransferFunction, control.StateSpace)
    if not isinstance(system, kinds) or system.isdtime(strict=True):
        step = f" with time step {system.dt}" if isinstance(system, kinds) else ""
        raise UnsupportedError(
            f"found {shown(type(system).__name__)}{step}; expected a continuous-time "
            "control.TransferFunction "
            "or control.StateSpace; convert it first, a discrete one by identification"
        )
    if isinstance(system, control.StateSpace):
        num, den = polynomials_of(system.A, system.B, system.C, system.D)
    else:
        rows, columns = range(system.noutputs), range(system.ninputs)
        num = [[np.asarray(system.num[i][j], dtype=float) for j in columns] for i in rows]
        den = [[np.asarray(system.den[i][j], dtype=float) for j in columns] for i in rows]
    return Coefficients(num, den, _given(system.input_labels), _given(system.output_labels))


def _given(labels: list[str]) -> list[str] | None:
    """Names of channels, unless python-control made them up."""
    made_up = re.compile(r"[uy]\[\d+\]")
    return None if all(made_up.fullmatch(name) for name in labels) else list(labels)


def to_scipy(num: Array, den: Array) -> Any:
    """A `scipy.signal.TransferFunction`; its numerator without leading zeros."""
    from scipy.signal import TransferFunction as ScipyTransferFunction

    return ScipyTransferFunction(np.array(num), np.array(den))


def from_scipy(system: Any) -> Coefficients:
    """Coefficients of a continuous-time model of SciPy, or of a tuple as SciPy takes it.

    Raises
    ------
    UnsupportedError
        `system` is in discrete time, or no such model.
    CoefficientError
        It makes no polynomials.
    """
    from scipy import signal

    if isinstance(system, signal.dlti):
        raise UnsupportedError(
            f"found {shown(type(system).__name__)} with time step {system.dt}; expected a model in "
            "continuous time; identify one from its response, or convert it before"
        )
    if isinstance(system, signal.StateSpace):
        parts: tuple[Any, ...] = (system.A, system.B, system.C, system.D)
    elif isinstance(system, signal.ZerosPolesGain):
        parts = (system.zeros, system.poles, system.gain)
    elif isinstance(system, signal.TransferFunction):
        parts = (system.num, system.den)
    elif isinstance(system, (tuple, list)) and len(system) in (2, 3, 4):
        parts = tuple(system)
    else:
        raise UnsupportedError(
            f"found {shown(type(system).__name__)}; expected a scipy.signal.lti, or a tuple (num, "
            "den), (zeros, poles, gain) or (A, B, C, D); convert it first"
        )
    try:
        num, den = _from_parts(parts)
    except (TypeError, ValueError) as error:
        raise CoefficientError(
            f"found {shown(parts)}; expected real numbers that make (num, den), (zeros, poles, "
            "gain) or (A, B, C, D); correct them"
        ) from error
    return Coefficients(num, den, None, None)


def _from_parts(parts: tuple[Any, ...]) -> tuple[Nested, Nested]:
    if len(parts) == 4:
        a, b, c, d = (np.atleast_2d(np.asarray(part, dtype=float)) for part in parts)
        return polynomials_of(a, b, c, d)
    if len(parts) == 3:
        zeros, poles, gain = parts
        num = float(gain) * _real_polynomial(zeros)
        return [[num]], [[_real_polynomial(poles)]]
    rows = np.atleast_2d(np.asarray(parts[0], dtype=float))
    den = np.atleast_1d(np.asarray(parts[1], dtype=float))
    return [[_stripped(row)] for row in rows], [[den.copy()] for _ in rows]


def _stripped(num: Array) -> Array:
    """Without leading zeros; of zeros alone, one."""
    kept = np.trim_zeros(num, "f")
    return kept if kept.size else np.zeros(1)


def _real_polynomial(roots: Any) -> Array:
    """The monic polynomial of roots that are real or come in conjugate pairs."""
    given = np.atleast_1d(np.asarray(roots, dtype=complex))
    coefficients = np.atleast_1d(np.poly(given)) if given.size else np.ones(1)
    size = np.abs(np.poly(-np.abs(given))) if given.size else np.ones(1)
    if np.any(np.abs(np.imag(coefficients)) > 1e-9 * size):
        raise ValueError("found roots without their conjugates")
    return np.asarray(np.real(coefficients), dtype=float)


def polynomials_of(a: Array, b: Array, c: Array, d: Array) -> tuple[Nested, Nested]:
    """Numerators and the common denominator of a state-space model.

    Parameters
    ----------
    a, b, c, d : (n, n), (n, n_inputs), (n_outputs, n), (n_outputs, n_inputs) array

    Returns
    -------
    num, den : nested list of arrays, ``[output][input]``
        Descending powers.

    Raises
    ------
    ValueError
        The shapes do not fit each other.

    Examples
    --------
    >>> num, den = polynomials_of(
    ...     np.array([[-1.0, 0.0], [0.0, -2.0]]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1))
    ... )
    >>> num[0][0].round(12).tolist(), den[0][0].round(12).tolist()
    ([2.0, 3.0], [1.0, 3.0, 2.0])
    """
    n = a.shape[0]
    fits = a.shape == (n, n) and b.shape[0] == n and c.shape[1] == n
    if not fits or d.shape != (c.shape[0], b.shape[1]):
        raise ValueError("found matrices of shapes that do not fit; expected a state-space model")
    if n == 0:
        one = [[np.ones(1) for _ in row] for row in d]
        return [[np.array([float(value)]) for value in row] for row in d], one
    poles = np.linalg.eigvals(a)
    den = _real_polynomial(poles)
    num, share = np.zeros((n + 1, *d.shape)), np.zeros((n + 1, *d.shape))
    for radius in _radii(np.abs(poles)):
        rising = _on_circle(a, b, c, d, den, radius)
        own = np.abs(rising) / np.maximum(np.max(np.abs(rising), axis=0), 1e-300)
        better = own > share
        found = rising * (radius ** np.arange(float(n), -1.0, -1.0))[:, None, None]
        num, share = np.where(better, found, num), np.where(better, own, share)
    num = np.where(share > ROUNDING, num, 0.0)[::-1]
    rows, columns = range(d.shape[0]), range(d.shape[1])
    nums = [[_stripped(num[:, i, j]) for j in columns] for i in rows]
    return nums, [[den.copy() for _ in columns] for _ in rows]


def _radii(sizes: Array) -> list[float]:
    """Circles within, between and around the poles, with some distance to them."""
    sizes = np.unique(sizes[sizes > 1e-12 * sizes.max()]) if sizes.max() else np.ones(1)
    apart = sizes[1:] > APART * sizes[:-1]
    between = np.sqrt(sizes[1:] * sizes[:-1])[apart]
    return [float(2.0 * sizes[-1]), *between.tolist(), float(0.5 * sizes[0])]


def _on_circle(a: Array, b: Array, c: Array, d: Array, den: Array, radius: float) -> Array:
    """(n + 1, n_outputs, n_inputs) numerators, rising powers of ``s / radius``, over radius^n."""
    n = a.shape[0]
    unit = np.exp(2j * np.pi * np.arange(n + 1) / (n + 1))
    scaled = den / radius ** np.arange(n + 1)
    response = np.array(
        [c @ np.linalg.solve(radius * z * np.eye(n) - a, b.astype(complex)) + d for z in unit]
    )
    values = response * np.polyval(scaled, unit)[:, None, None]
    return np.asarray(np.real(np.fft.fft(values, axis=0)) / (n + 1))
