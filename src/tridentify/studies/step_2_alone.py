"""Step 2 alone: the series-parallel model on the recorded, noisy output.

This is what the paper compares its strategy with. The equation error

    eps = (a(p) / c(p)) y - (b(p) / c(p)) x,        deg c > deg a                  (eq. 5, Fig. 7)

is linear in the coefficients of ``a`` (monic) and ``b``, which follow by least squares from the
filtered signals ``p^k y / c`` and ``p^k x / c``. Because the noise of ``y`` stands in the
regressors, its square enters the normal equations, and the estimates of ``a`` are biased towards
smaller values as the noise grows (eq. 6-9). They may be unstable; nothing here prevents that.

The input is filtered exactly as it was held. Between its samples ``y`` is not known: here it is
joined by straight lines, and that signal is filtered exactly. The difference between the true
output and those lines is an error that remains without any noise, of order ``dt^2``. For the
paper's aircraft (``y'' + y' + 3 y = 0.5 x``, unit step, 5 s) it moves the coefficients of a
noise-free record by at most 0.05 % at 0.05 s, and four times less at 0.025 s [tests].
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from tridentify.errors import IdentifiabilityError
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.least_squares import triangle
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction


def step_2_alone(record: Record, n_poles: int, n_zeros: int, filter: ArrayLike) -> Array:
    """Least-squares coefficients of the series-parallel model on the recorded output.

    Parameters
    ----------
    record : Record
        One input and one output, uniform, at rest at its first sample, no sample missing.
    n_poles, n_zeros : int
        Degrees of ``a`` and ``b``.
    filter : (> n_poles + 1,) array-like
        Coefficients of the stable ``c(p)``, descending powers.

    Returns
    -------
    (n_poles + n_zeros + 1,) array
        ``a_{n-1}, ..., a_0, b_m, ..., b_0``.

    Raises
    ------
    IdentifiabilityError
        The filtered signals are linearly dependent.

    Examples
    --------
    >>> model, x = TransferFunction([2.0], [1.0, 4.0]), np.ones(2000)
    >>> y = simulate(model, Record(x, x, dt=0.001))
    >>> step_2_alone(Record(x, y, dt=0.001), 1, 0, [1.0, 6.0, 9.0]).round(3).tolist()
    [4.0, 2.0]
    """
    joined = Record(record.y, record.y, t=record.t, intersample="foh")
    outputs = _filtered(joined, n_poles, filter)
    inputs = _filtered(record, n_zeros, filter)
    columns = np.column_stack([-outputs[:, 1:], inputs, outputs[:, 0]])
    factor = triangle(columns)
    diagonal = np.abs(np.diag(factor))[:-1]
    if factor.shape[0] < columns.shape[1] or not diagonal.min() > 1e-12 * diagonal.max():
        raise IdentifiabilityError(
            "found linearly dependent filtered signals; expected a record that determines "
            f"{diagonal.size} coefficients; record longer or lower the orders"
        )
    return np.asarray(scipy.linalg.solve_triangular(factor[:-1, :-1], factor[:-1, -1]))


def _filtered(record: Record, degree: int, filter: ArrayLike) -> Array:
    """``p^k / c`` of the record's input for ``k = degree, ..., 0``: (n_samples, degree + 1)."""
    powers = [[row] for row in np.eye(degree + 1)]
    c = np.asarray(filter, dtype=np.float64)
    return simulate(TransferFunction(powers, c), record)
