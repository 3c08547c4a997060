"""The bias of the series-parallel model on raw noisy data, predicted.

The paper explains by its equations (6)-(9) why Step 2 on the recorded ``y`` underestimates ``a``:
the square of the noise, through the filters ``p^k / c``, stands in the normal equations. With
``Y``, ``Z``, ``Q`` and ``Lambda`` as in `methods.filtered.noise_through_filters` and ``Y = Y* + L
zeta``, least squares minimise ``|(1 - Q Q') Y (alpha, 1)|^2`` over ``alpha``, where 1 belongs to
the monic column. The expected value of that is

    |(1 - Q Q') Y* (alpha, 1)|^2 + sigma^2 (alpha, 1) Lambda (alpha, 1)',

whose minimum is the limit that the estimates have for a long record of this kind. It is again a
least-squares problem: the triangle of ``(1 - Q Q') Y*`` on top of ``sigma`` times a factor of
``Lambda``. The second term pulls ``alpha`` towards the denominator that lets the least noise
through, whatever the record says, with a strength proportional to the square of the noise ratio.

*Finite records.* The minimum of an expected value is not the mean of the minima. The two differ by
a term of the order of the estimates' relative variance, ``O(1 / N)``, which this prediction leaves
out. For 1000 samples and more of a rich input it was hardly visible in 200 draws; on the paper's
record of 100 samples at a noise ratio of one half it is larger than the predicted bias.

The output joined by straight lines between its samples is an error of order ``dt^2`` that remains
without noise. It is part of the prediction.

References
----------
A. Silvestrov et al., System Research and Information Technologies 2025(2), equations (6)-(9).
P. Stoica, T. Soderstrom, Bias correction in least-squares identification, Int. J. Control 35(3),
1982, 449-457.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import ChannelCountError, NonUniformTimeError, OptionError, UnsupportedError
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.methods.filtered.filter_cascade import (
    check_rates,
    checked_filter,
    filter_cascade,
)
from tridentify.estimation.methods.filtered.noise_through_filters import factor, separate
from tridentify.estimation.methods.filtered.state_variable_filters import (
    coefficient_map,
    with_filtered,
)
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.least_squares import solve
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction


def asymptotic_bias(
    model: TransferFunction,
    record: Record,
    noise_variance: float | ArrayLike,
    filter: Sequence[float],
    *,
    offset: bool = False,
    drift: bool = False,
    initial_state: str = "rest",
) -> Array:
    """Predicted bias of the series-parallel model fitted to a raw noisy output.

    Parameters
    ----------
    model : TransferFunction
        The true system; one denominator for all channels, no delay.
    record : Record
        Its input, time and intersample behaviour are used, not its output. The system is at rest
        at the first sample.
    noise_variance : float or (n_outputs,) array-like
        Of white noise at the samples [output units squared].
    filter : sequence of float
        Coefficients of ``c(p)``, descending powers, degree at least that of the denominator.
    offset, drift : bool
        Whether these are fitted along.
    initial_state : {"rest", "free"}
        Whether the initial state is fitted along.

    Returns
    -------
    (n_coefficients,) array
        Limit of the estimates of `SvfLeastSquares` with this filter minus the true coefficients, in
        the order of `Structure.names`: ``a_{n-1}, ..., a_0``, then each numerator.

    Raises
    ------
    OptionError
        If the filter is unstable or of too low a degree, a variance is negative, or an initial
        state is unknown.
    UnsupportedError
        For a delay or several denominators.
    IdentifiabilityError
        If the input does not determine the coefficients.

    Notes
    -----
    For a finite record the mean of the estimates differs from this limit by ``O(1/N)``.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, TransferFunction
    >>> u = np.sign(np.sin(np.arange(2000) ** 1.5))
    >>> model = TransferFunction([3.0], [1.0, 4.0, 3.0])
    >>> record = Record(u, u, dt=0.01)
    >>> asymptotic_bias(model, record, 0.0, [1.0, 4.0, 4.0]).round(2).tolist()
    [-0.0, -0.0, -0.0]
    >>> asymptotic_bias(model, record, 0.01, [1.0, 4.0, 4.0]).round(1).tolist()
    [-2.0, -0.9, -1.2]
    """
    nuisances = _nuisances(offset, drift, initial_state)
    c = checked_filter(filter)
    if c is None:
        raise OptionError("found filter=None; expected the coefficients of c(p); give a filter")
    problem, truth = _clean(model, record, nuisances)
    variance = _variances(noise_variance, problem.n_outputs)
    given = filter_cascade(c, problem.n_poles)
    check_rates(given.poles, "filter", problem.experiments)
    experiments = [with_filtered(e, given) for e in problem.experiments]
    weights = 1.0 / np.sqrt(np.maximum(problem.power + variance, 1e-300))
    found = separate(problem, experiments, given, weights, variance)
    rows = found.triangle
    if np.any(variance):
        rows = np.vstack([rows, factor(found.noise)])
    alpha = solve(rows[:, :-1], -rows[:, -1]).x
    constant, matrix = coefficient_map(problem, given, found.equation.width)
    return np.asarray(constant + matrix @ found.unknowns(alpha) - truth)


def _nuisances(offset: bool, drift: bool, initial_state: str) -> Nuisances:
    if initial_state not in ("rest", "free"):
        raise OptionError(
            f"found initial_state={initial_state!r}; expected 'rest' or 'free'; choose one"
        )
    return Nuisances(initial_state, bool(offset), bool(drift))


def _clean(model: TransferFunction, record: Record, nuisances: Nuisances) -> tuple[Problem, Array]:
    """The record with the model's own output, and the model's coefficients."""
    den = model.common_denominator
    if den is None:
        raise UnsupportedError(
            "found a model with several denominators; expected one that all channels share; take "
            "the channels one by one"
        )
    if np.any(model.delay):
        raise UnsupportedError(
            f"found a model with a delay of {model.delay.max():g} s; expected none; shift the "
            "input by whole samples instead"
        )
    if record.dt is None:
        raise NonUniformTimeError(
            "found a record without a uniform step; expected one; resample it first"
        )
    if record.behaviour == "band-limited":
        raise UnsupportedError(
            "found intersample='band-limited'; expected 'zoh' or 'foh'; state what the input does "
            "between its samples"
        )
    if record.n_inputs != model.n_inputs:
        raise ChannelCountError(
            f"found a record with {record.n_inputs} inputs; expected {model.n_inputs} as in the "
            "model; select the channels"
        )
    zeros = [[num.size - 1 for num in row] for row in model.num]
    clean = Record(record.u, simulate(model, record), dt=record.dt, intersample=record.behaviour)
    problem = build([clean], Structure(den.size - 1, zeros), nuisances)
    truth = np.concatenate([den[1:], *(num for row in model.num for num in row)])
    return problem, truth


def _variances(noise_variance: float | ArrayLike, n_outputs: int) -> Array:
    given = np.asarray(noise_variance, dtype=np.float64)
    usable = given.shape in ((), (n_outputs,)) and np.all(np.isfinite(given)) and np.all(given >= 0)
    if not usable:
        raise OptionError(
            f"found noise_variance={noise_variance!r}; expected zero or more, one number or one "
            f"for each of {n_outputs} outputs; correct it"
        )
    return np.array(np.broadcast_to(given, (n_outputs,)))
