r"""AIC, AICc, BIC and YIC of candidates, all on the same samples and the same noise.

With ``N_i`` samples of output ``i``, ``e_i`` the residual, whitened by a noise model of the order
that all candidates share, and ``k`` unknowns (coefficients, delays, nuisance terms, variances,
coefficients of the noise),

    -2 log L = sum_i N_i log(e_i' e_i / N_i) + log det         (constants left out)
    AIC  = -2 log L + 2 k
    AICc = AIC + 2 k (k + 1) / (N - k - 1)
    BIC  = -2 log L + k log N

(Akaike 1974; Hurvich & Tsai 1989; Schwarz 1978). Criteria that take noise for white credit a
candidate for following the noise's slow swings; whitening takes that away. The noise models must be
of one order for all: where one candidate just passes the test of whiteness and the next does not,
the difference of their criteria is that of the noise models.

Young's information criterion weighs fit against how well the coefficients are known,

    YIC = log(s^2 / s_y^2) + log((1 / n_theta) sum_j std_j^2 / theta_j^2),

with the variances of residual and output; the lower, the better (Young 1989; Young 2011, section
6.4.2). A coefficient near zero spoils it, so it is shown and not decided by.

References: H. Akaike, IEEE Trans. AC 19 (1974) 716-723. C. Hurvich & C.-L. Tsai, Biometrika 76
(1989) 297-307. G. Schwarz, Annals of Statistics 6 (1978) 461-464. P. Young, in: *Recursive
estimation, forecasting and adaptive control*, Control and Dynamic Systems 30 (1989) 119-166;
*Recursive Estimation and Time-Series Analysis*, 2nd ed., Springer (2011).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.fitted_point import ROUNDING_SQUARED
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.information import aicc_price
from tridentify.record.record import Record


@dataclass(frozen=True)
class Criteria:
    """The criteria of one candidate; ``deviance`` is ``-2 log L`` up to a constant."""

    n_unknowns: int
    n_samples: int
    deviance: float

    @property
    def aic(self) -> float:
        """Akaike's."""
        return self.deviance + 2.0 * self.n_unknowns

    @property
    def aicc(self) -> float:
        """Akaike's, corrected for few samples."""
        return self.deviance + aicc_price(float(self.n_unknowns), self.n_samples)

    @property
    def bic(self) -> float:
        """Schwarz's."""
        return self.deviance + self.n_unknowns * math.log(self.n_samples)


def criteria_of(
    residuals: Sequence[Array], noise: Sequence[Array], size: Array, n_unknowns: int
) -> Criteria:
    """The criteria from residuals.

    Parameters
    ----------
    residuals : sequence of (n_samples, n_outputs) arrays
        One for each experiment; ``nan`` marks a sample that does not count.
    noise : sequence of (p,) arrays
        Noise model of each output; empty for white.
    size : (n_outputs,) array
        Mean squares of the outputs: residuals below their rounding count as equal.
    n_unknowns : int
        Of the model: those of the noise are added.

    Examples
    --------
    >>> e = np.array([[1.0], [-1.0], [1.0], [-1.0]])
    >>> criteria_of([e], [np.zeros(0)], np.ones(1), 1).aic
    2.0
    """
    deviance, total = 0.0, 0
    for i, a in enumerate(noise):
        energy, count, scale = 0.0, 0, 0.0
        for one in residuals:
            innovations, log_scale = whiten(one[:, i], a) if a.size else (one[:, i], 0.0)
            seen = innovations[np.isfinite(innovations)]
            energy += float(seen @ seen)
            count += seen.size
            scale += log_scale
        deviance += (
            count * math.log(energy / max(count, 1) + ROUNDING_SQUARED * size[i] + 1e-300) + scale
        )
        total += count
    return Criteria(n_unknowns + sum(a.size for a in noise), total, deviance)


def own_criteria(estimate: Estimate, records: Sequence[Record]) -> Criteria:
    """Those of the estimate's own likelihood.

    Noise models are of any order, each estimate has its own: what it costs (AICc) counts as
    deviance.
    """
    k, n = unknowns_of(estimate), sum(int(np.isfinite(record.y).sum()) for record in records)
    return Criteria(k, n, estimate.aicc - aicc_price(float(k), float(n)))


def unknowns_of(estimate: Estimate) -> int:
    """Number of unknowns: coefficients that are not held, nuisance terms, and noise variances.

    Free responses count a term for each state; those of the noise model are left out.
    """
    along = 0
    n_outputs = len(estimate.output_names)
    shape = n_outputs, len(estimate.input_names)
    poles = estimate.structure.poles_matrix(*shape)
    states = sum(row[0] if estimate.structure.shared else sum(row) for row in poles)
    for terms in estimate.nuisance:
        along -= n_outputs * (bool(estimate.structure.offset) + estimate.structure.drift_degree)
        along -= states * (terms.initial_state == "free")
    return free_coefficients(estimate) - along + n_outputs


def free_coefficients(estimate: Estimate) -> int:
    """Number of coefficients that the record had to determine, delays among them."""
    held = sum(1 for name in estimate.structure.fixed or {} if name in estimate.names)
    return len(estimate.names) - held - len(estimate.structure.equalities or ())


def young(estimate: Estimate, spread: Array) -> float:
    """Young's information criterion.

    Parameters
    ----------
    estimate : Estimate
    spread : (n_outputs,) array
        Variances of the outputs.

    Returns
    -------
    float
        Mean over the outputs of the first term; nan where no coefficient has a standard error.
    """
    known = (estimate.std > 0) & np.isfinite(estimate.std)
    if not known.any() or np.any(spread <= 0):
        return math.nan
    with np.errstate(divide="ignore", over="ignore"):
        relative = estimate.std[known] / np.maximum(np.abs(estimate.theta[known]), 1e-300)
        first = float(np.mean(np.log(estimate.noise_variance / spread)))
        return first + float(np.log(np.mean(relative**2)))


def largest_relative_std(estimate: Estimate) -> tuple[float, str]:
    """The largest standard error relative to its coefficient, and whose it is."""
    relative = {
        name: item.relative_std for name, item in estimate.parameters.items() if item.std > 0
    }
    if not relative:
        return 0.0, ""
    name = max(relative, key=lambda one: relative[one])
    return relative[name], name
