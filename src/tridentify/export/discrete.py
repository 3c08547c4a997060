"""A model as difference equations that can be run sample by sample.

Each channel's denominator becomes one state equation ``x' = A x + b u``, an orthonormal cascade
where it is stable (`simulate.realize`): no polynomial is expanded, so many and slow poles lose no
digits. Channels with the same input, delay and denominator share their states.

*Zero-order hold* is exact for an input that is held between the samples, also with a delay ``tau =
d h + f`` that is no whole number of steps ``h``: within a step the state sees ``u_{k-d-1}`` for the
time ``f`` and ``u_{k-d}`` for the rest,

    x_{k+1} = e^{A h} x_k + e^{A (h - f)} G(f) u_{k-d-1} + G(h - f) u_{k-d},
    G(t) = t phi_1(A t) b.

*Tustin's method* puts ``s = c (z - 1) / (z + 1)``: the frequency response is that of the model at a
frequency that is bent; ``c = w / tan(w h / 2)`` makes it right at ``w``, ``c = 2 / h`` at zero:

    F = (c - A)^{-1} (c + A),  g = sqrt(2 c) (c - A)^{-1} b,  sqrt(2 c) C (c - A)^{-1},
    d + C (c - A)^{-1} b.

What is stored is ``F - I``, not ``F``: for poles that are slow against the sampling, ``F`` is near
the identity and its digits are spent on that; ``e^{A h} - I = A h phi_1(A h)`` and ``F - I = 2 (c -
A)^{-1} A`` have full relative accuracy, which matters most in single precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg

from tridentify.errors import OptionError, ScaleError, TridentifyError, UnsupportedError, shown
from tridentify.models.simulate import realize
from tridentify.numerics.arrays import Array
from tridentify.transfer_function import TransferFunction

Method = Literal["zoh", "tustin"]

WHOLE = 1e-9
"""Relative error of a delay over a step that passes for a whole number: rounding of the
quotient."""
LONGEST_DELAY = 1_000_000
"""Steps: each takes a place in the state of the program that is written."""


@dataclass(frozen=True, eq=False)
class Block:
    """States that one input drives: ``x += change x + new v_0 + old v_1``, ``v_i = u_{k-delay-i}``.

    Attributes
    ----------
    source : int
        The input.
    delay : int
        Whole steps.
    change : (n, n) array
        ``F - I``.
    new, old : (n,) arrays
        ``old`` is zero without a fractional delay.
    outputs : tuple of int
    rows : (k, n) array
        Of these outputs.
    direct, direct_old : (k,) arrays
        What ``v_0`` and ``v_1`` add to them.
    """

    source: int
    delay: int
    change: Array
    new: Array
    old: Array
    outputs: tuple[int, ...]
    rows: Array
    direct: Array
    direct_old: Array

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.change.shape[0])

    @property
    def is_finite(self) -> bool:
        """Whether every number has room in a float."""
        parts = (self.change, self.new, self.old, self.rows, self.direct, self.direct_old)
        return all(bool(np.all(np.isfinite(part))) for part in parts)

    @property
    def memory(self) -> int:
        """How many steps back an input is needed."""
        return self.delay + int(np.any(self.old) or np.any(self.direct_old))


def blocks_of(
    model: TransferFunction, dt: float, method: Method = "zoh", prewarp: float | None = None
) -> tuple[Block, ...]:
    """Difference equations of a model.

    Parameters
    ----------
    model : TransferFunction
    dt : float
        Sampling interval [s].
    method : {"zoh", "tustin"}
    prewarp : float, optional
        Where Tustin's response is exact [rad/s]; at zero by default.

    Returns
    -------
    tuple of Block

    Raises
    ------
    OptionError
        `dt` is not positive, `method` is not offered, `prewarp` is not below half the sampling
        rate, or a delay takes more than a million steps.
    UnsupportedError
        A delay is no whole number of steps with Tustin's method.

    Examples
    --------
    >>> (one,) = blocks_of(TransferFunction([2.0], [1.0, 2.0]), 0.5)
    >>> bool(np.isclose(1.0 + one.change[0, 0], np.exp(-1.0), rtol=1e-15))
    True
    """
    _check(dt, method, prewarp)
    # what overflows is not finite at the end, and said there in one line
    with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
        try:
            found = _blocks(model, dt, method, prewarp)
        except (np.linalg.LinAlgError, ValueError) as error:
            if isinstance(error, TridentifyError):
                raise
            raise _no_room(model, dt) from error
    if not all(block.is_finite for block in found):
        raise _no_room(model, dt)
    return found


def _no_room(model: TransferFunction, dt: float) -> ScaleError:
    return ScaleError(
        f"found a model of {model.n_outputs} outputs whose change within {dt:.3g} s leaves the "
        "range of numbers; expected one below 1e308; choose a shorter dt, or correct the poles, "
        "the gain or the units of the model"
    )


def _blocks(
    model: TransferFunction, dt: float, method: Method, prewarp: float | None
) -> tuple[Block, ...]:
    groups: dict[tuple[int, float, bytes], list[int]] = {}
    for j in range(model.n_inputs):
        for i in range(model.n_outputs):
            key = (j, float(model.delay[i, j]), model.den[i][j].tobytes())
            groups.setdefault(key, []).append(i)
    found = []
    for (j, _, _), outputs in groups.items():
        delay, part = _steps(float(model.delay[outputs[0], j]), dt)
        a, b, c, d, _ = realize(model.den[outputs[0]][j], [model.num[i][j] for i in outputs])
        if method == "zoh":
            change, new, old = _held(a, b, dt, part)
            straight, late = (np.zeros_like(d), d) if part else (d, np.zeros_like(d))
        else:
            if part:
                raise UnsupportedError(
                    f"found a delay of {model.delay[outputs[0], j]:.6g} s and steps of {dt:.6g} s; "
                    "expected a whole number of steps with method='tustin'; choose dt so, or "
                    "method='zoh'"
                )
            rate = 2.0 / dt if prewarp is None else prewarp / np.tan(0.5 * prewarp * dt)
            change, new, c, straight = _bilinear(a, b, c, d, rate)
            old, late = np.zeros_like(new), np.zeros_like(d)
        found.append(Block(j, delay, change, new, old, tuple(outputs), c, straight, late))
    return tuple(found)


def _check(dt: float, method: str, prewarp: float | None) -> None:
    if not (isinstance(dt, (int, float)) and np.isfinite(dt) and dt > 0):
        raise OptionError.found("dt=", dt, "a positive sampling interval in seconds", "correct dt")
    if method not in ("zoh", "tustin"):
        raise OptionError.found(
            "method=", method, "'zoh' (exact for a held input) or 'tustin'", "choose one"
        )
    if prewarp is None:
        return
    if method == "zoh" or not 0.0 < prewarp < np.pi / dt:
        raise OptionError(
            f"found prewarp={shown(prewarp)} with method={method!r}; expected a frequency in rad/s "
            f"below {np.pi / dt:.6g}, half the sampling rate, with method='tustin'; correct it or "
            "leave it out"
        )


def _steps(delay: float, dt: float) -> tuple[int, float]:
    """Whole steps, and the rest of the delay [s]."""
    ratio = delay / dt
    if ratio > LONGEST_DELAY:
        raise OptionError(
            f"found a delay of {ratio:.3g} steps; expected at most {LONGEST_DELAY:,}; sample more "
            "slowly"
        )
    whole = round(ratio)
    if abs(ratio - whole) <= WHOLE * max(whole, 1):
        return whole, 0.0
    whole = int(np.floor(ratio))
    return whole, delay - whole * dt


def _integrated(a: Array, time: float) -> Array:
    """``phi_1(A t)``."""
    n = a.shape[0]
    augmented = np.zeros((2 * n, 2 * n))
    augmented[:n, :n] = a * time
    augmented[:n, n:] = np.eye(n)
    return np.asarray(scipy.linalg.expm(augmented)[:n, n:])


def _held(a: Array, b: Array, dt: float, part: float) -> tuple[Array, Array, Array]:
    """``e^{A h} - I`` and what the later and the earlier of two held values add."""
    if not b.size:
        return a, b, b
    change = (a * dt) @ _integrated(a, dt)
    rest = dt - part
    new = _integrated(a, rest) @ (b * rest)
    if not part:
        return change, new, np.zeros_like(b)
    early = _integrated(a, part) @ (b * part)
    old = early + (a * rest) @ (_integrated(a, rest) @ early)
    return change, new, old


def _bilinear(
    a: Array, b: Array, c: Array, d: Array, rate: float
) -> tuple[Array, Array, Array, Array]:
    """``F - I``, input vector, rows and direct terms."""
    if not b.size:
        return a, b, c, d
    factor = scipy.linalg.lu_factor(np.eye(b.size) - a / rate)
    solved = scipy.linalg.lu_solve(factor, b / rate)
    root = np.sqrt(2.0 * rate)
    rows = scipy.linalg.lu_solve(factor, c.T, trans=1).T
    change = 2.0 * scipy.linalg.lu_solve(factor, a / rate)
    return change, root * solved, rows * (root / rate), d + c @ solved
