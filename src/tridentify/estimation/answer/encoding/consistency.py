"""Whether the parts of an estimate that was read from a file belong together.

Each part has its type by then (`values`). Here their sizes and numbers are compared with each
other, so that whatever is loaded can be printed, simulated and exported.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np

from tridentify.errors import CoefficientError, DataError, OptionError, ShapeError, shown
from tridentify.estimation.answer.parameter import Nuisance
from tridentify.numerics.arrays import Array
from tridentify.numerics.levinson import reflections
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

MOST_COEFFICIENTS = 2000
"""Most coefficients of an estimate that is read: their covariance alone then fills the largest
file."""

MOST_OF_NOISE = 200
"""Highest order of a model of the noise; that of twenty million samples has at most 73."""

ROUNDING = 1e-6
"""How far a covariance may be from symmetric and from positive semi-definite, as a correlation."""

SAME = 1e-9
"""Relative difference between a coefficient and its place in the model that counts as rounding."""


LARGEST = 1e145
"""Largest coefficient that is read, and inverted smallest: its square, a variance, is a float with
room to spare."""


def check_model(
    model: TransferFunction,
    structure: Structure,
    theta: Array,
    input_names: Sequence[str],
    output_names: Sequence[str],
) -> None:
    """Refuse a model that is not the one of these coefficients.

    Raises
    ------
    ShapeError, CoefficientError
        There are too many coefficients, or the model has others or other channels.
    """
    if theta.size > MOST_COEFFICIENTS:
        raise ShapeError(
            f"found {theta.size} coefficients; expected at most {MOST_COEFFICIENTS} in a file; "
            "estimate the outputs one by one"
        )
    sizes = np.abs(theta[theta != 0.0])
    if np.any(sizes > LARGEST) or np.any(sizes < 1.0 / LARGEST):
        raise CoefficientError(
            f"found theta {shown(theta.tolist())}; expected sizes from "
            f"{1.0 / LARGEST:.0e} to {LARGEST:.0e}"
        )
    if (model.input_names, model.output_names) != (tuple(input_names), tuple(output_names)):
        raise CoefficientError(
            f"found a model of {shown((*model.output_names, *model.input_names), 80)}; expected "
            "the channels of the estimate"
        )
    num, den = structure.split(theta, model.n_outputs, model.n_inputs)
    delay = np.array(structure.delay_matrix(model.n_outputs, model.n_inputs))
    if structure.delay == "free":
        delay = np.tile(theta[-model.n_inputs :], (model.n_outputs, 1))
    found = [*(one for row in (*model.num, *model.den) for one in row), model.delay]
    expected = [*(one for row in (*num, *den) for one in row), delay]
    for one, other in zip(found, expected, strict=True):
        if one.shape != other.shape or not np.allclose(one, other, rtol=SAME, atol=0.0):
            raise CoefficientError(
                f"found {shown(one.tolist(), 80)} in the model; expected "
                f"{shown(other.tolist(), 80)} by theta and the structure"
            )


def check_covariance(cov: Array) -> None:
    """Refuse what is no covariance, beyond rounding.

    What is not known has a variance that is not finite, and so may its row and column be.

    Raises
    ------
    CoefficientError
        A variance is negative, the rest not finite, not symmetric or not positive semi-definite.

    Examples
    --------
    >>> check_covariance(np.array([[4.0, 2.0], [2.0, 1.0]]))
    """
    variance = np.diag(cov)
    known = np.isfinite(variance)
    part, spread = cov[np.ix_(known, known)], np.sqrt(np.maximum(variance[known], 0.0))
    unknown = ~(known[:, None] & known)
    if np.any(variance < 0.0) or not np.all(np.isfinite(cov) | unknown):
        raise CoefficientError(
            "found a covariance with a variance below zero, or that is not finite; expected one "
            "as it was estimated"
        )
    scale = np.where(spread > 0.0, spread, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        correlation = part / scale[:, None] / scale
    bounded = np.all(np.abs(correlation) <= 1.0 + ROUNDING)  # where the scale is right
    if not bounded or np.any(np.abs(correlation - correlation.T) > ROUNDING):
        raise CoefficientError(
            "found a covariance that is not symmetric, or larger than its variances allow; "
            "expected one as it was estimated"
        )
    held = spread == 0.0
    lowest = np.linalg.eigvalsh(correlation)[0] if correlation.size else 0.0
    if np.any(part[held]) or lowest < -ROUNDING * max(len(part), 1):
        raise CoefficientError(
            "found a covariance that is not positive semi-definite; expected one as it was "
            "estimated"
        )


def check_draws(draws: Array, n_parameters: int) -> None:
    """Refuse draws that are not one row of finite coefficients each.

    Raises
    ------
    ShapeError
    """
    fits = draws.ndim == 2 and draws.shape[1] == n_parameters and np.all(np.isfinite(draws))
    if not fits:
        raise ShapeError(
            f"found draws of shape {draws.shape}; expected finite numbers, {n_parameters} a row"
        )


def check_noise(variance: Array, fit: Array, model: Sequence[Array]) -> None:
    """Refuse noise that is none.

    Raises
    ------
    CoefficientError
        A variance is negative, a fit above 100 %, or an autoregression not stationary.
    """
    if np.any(variance < 0.0) or np.any(fit > 100.0 * (1.0 + SAME)):
        raise CoefficientError(
            f"found noise_variance {shown(variance.tolist())} and fit {shown(fit.tolist())}; "
            "expected variances of zero or more, and fits of at most 100 percent"
        )
    for one in model:
        if one.size > MOST_OF_NOISE or not np.all(np.isfinite(reflections(one))):
            raise CoefficientError(
                f"found the noise model {shown(one.tolist())}; expected a stationary "
                f"autoregression of at most {MOST_OF_NOISE} coefficients"
            )


def check_nuisance(nuisance: Sequence[Nuisance], model: TransferFunction) -> None:
    """Refuse nuisance terms that are none, or not of these channels.

    Raises
    ------
    ShapeError, OptionError
    """
    if not nuisance:
        raise ShapeError("found no nuisance terms; expected those of one experiment or more")
    n_outputs, n_inputs = model.n_outputs, model.n_inputs
    longest = max(den.size - 1 for row in model.den for den in row)
    outputs = ("offset", "drift", "offset_std", "drift_std")
    shapes = {"input_reference": (n_inputs,), **dict.fromkeys(outputs, (n_outputs,))}
    for terms in nuisance:
        for name, shape in shapes.items():
            if getattr(terms, name).shape != shape or np.any(np.isinf(getattr(terms, name))):
                raise ShapeError(
                    f"found {name} {shown(getattr(terms, name).tolist())}; expected finite numbers "
                    f"of shape {shape}"
                )
        free = terms.free_response.shape
        fits = free in ((n_outputs, longest), (n_outputs, n_inputs, longest))
        if not fits or np.any(np.isinf(terms.free_response)):
            raise ShapeError(
                f"found a free response of shape {free}; expected finite numbers of shape "
                f"{(n_outputs, longest)} or {(n_outputs, n_inputs, longest)}"
            )
        bends = terms.bends.shape[:1] in ((n_outputs,), (0,)) and terms.duration >= 0.0
        if not bends or not np.all(np.isfinite([terms.duration, *terms.bends.ravel()])):
            raise ShapeError(
                f"found bends {shown(terms.bends.tolist())} over {terms.duration} s; expected "
                f"finite numbers, for {n_outputs} outputs"
            )
        if np.any(terms.offset_std < 0.0) or np.any(terms.drift_std < 0.0):
            raise ShapeError("found a standard error of an offset below zero; expected none")
        if terms.initial_state not in ("rest", "equilibrium", "free", "auto"):
            raise OptionError(
                f"found initial_state={shown(terms.initial_state)}; expected 'free', 'rest' or "
                "'equilibrium'"
            )
        if not (math.isfinite(terms.t0) and 0.0 <= terms.free_after < math.inf):
            raise DataError(
                f"found t0={terms.t0} and free_after={terms.free_after}; expected seconds, the "
                "latter zero or more"
            )


def check_outliers(outliers: Array, n_experiments: int, n_outputs: int, n_samples: int) -> None:
    """Refuse outliers that are no samples of the record.

    Raises
    ------
    ShapeError
    """
    limits = np.array([n_experiments - 1, n_outputs - 1, n_samples - 1, 1.0])
    sound = outliers.ndim == 2 and outliers.shape[1] == 4
    if sound and outliers.size:
        whole = outliers[:, :3]
        sound = bool(np.all((outliers >= 0.0) & (outliers <= limits)))
        sound = sound and bool(np.all(whole == np.floor(whole)))
    if not sound:
        raise ShapeError(
            f"found outliers of shape {outliers.shape}; expected rows of experiment, output, "
            "sample and a weight from 0 to 1"
        )


def check_route(route: object, known: Collection[str]) -> None:
    """Refuse a way to an estimate that there is not.

    Raises
    ------
    DataError
    """
    if not isinstance(route, str) or route not in known:
        raise DataError(f"found route={shown(route)}; expected one of {', '.join(known)}")


def check_sampling(
    n_samples: int, degrees_of_freedom: int, dt: float | None, intersample: str, loss: str
) -> None:
    """Refuse what no record has.

    Raises
    ------
    DataError, OptionError
    """
    if n_samples < 1 or not degrees_of_freedom >= 0:
        raise DataError(
            f"found {n_samples} samples and {degrees_of_freedom} degrees of freedom; expected at "
            "least one sample"
        )
    if dt is not None and not 0.0 < dt < math.inf:
        raise DataError(f"found dt={dt}; expected a positive number of seconds, or none")
    if intersample not in ("zoh", "foh", "band-limited"):
        raise OptionError(
            f"found intersample={shown(intersample)}; expected 'zoh', 'foh' or 'band-limited'"
        )
    if loss not in ("squared", "huber", "student"):
        raise OptionError(f"found loss={shown(loss)}; expected 'squared', 'huber' or 'student'")
