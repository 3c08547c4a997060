"""A suspected change: the old model is kept until a new one is clearly better on the samples since.

An alarm (`online.kernels.intake`) says that the innovations speak for other coefficients. So do
gusts, slow disturbances and bursts of noise, now and then. Since the alarm the samples are kept;
they are searched for a model of their own, and the plant has changed only if all of this holds:

*Likelihood.* The old coefficients, as they were at the alarm, and the new ones are taken through
the samples since, each with a free initial state and an offset. What they leave is whitened by an
autoregression of its own: coloured noise is no longer evidence. The logarithm of the ratio of the
two remaining sums of squares is summed over short pieces, each with a scale of its own, as the
strength of gusts varies; the piece that speaks loudest is left out. The sum must be ``CLEAR``, and
most pieces must agree.

*Standard errors.* The coefficients must differ by more than what the two covariances explain,
that of the new ones enlarged for coloured noise: its variance of a mean is ``1 + 2 sum r(l) s(l)``
times that of white noise, with the autocorrelations of what is left and of the model's output, for
which the sensitivities look alike.

*A model.* The new one must be certain of its poles, also with errors so enlarged.

As long as it does not hold, the search is repeated on half as many samples again; in the end the
suspicion is dropped. Samples that came meanwhile have counted for the old model as all others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.linalg
import scipy.stats
from numpy.typing import NDArray

from tridentify.errors import TridentifyError
from tridentify.estimate import Estimate
from tridentify.numerics.realization import Complex
from tridentify.numerics.slices import Slices
from tridentify.online.blueprint import Blueprint, Nuisance, Setting
from tridentify.online.launch import Launch, launching
from tridentify.online.residual import gain_of, left_by
from tridentify.online.search import VAGUE, Found, far_off, record_of, searching
from tridentify.online.steps import estimate_of, solving
from tridentify.record import Record

if TYPE_CHECKING:
    from tridentify.online.three_model import ThreeModel

Array = NDArray[np.float64]

CLEAR = 30.0  # of -2 log L: one in a million for four coefficients, were the noise model true
AGREEING = 0.6  # of the pieces; of noise alone, half
RARE = 1e-5
FEWEST = 40  # samples that a comparison takes


class Old(NamedTuple):
    """The coefficients at the alarm, and their covariance."""

    theta: Array
    cov: Array


def trying(
    method: ThreeModel,
    setting: Setting,
    blueprint: Blueprint,
    poles: Complex,
    x: Array,
    samples: Array,
    reference: Array,
) -> Slices[Launch | None]:
    """Whether the samples since an alarm are of another plant, and how to go on from them.

    Parameters
    ----------
    method : ThreeModel
    setting : Setting
    blueprint : Blueprint
    poles : (n,) complex array
    x : array
        Of the estimator at the alarm.
    samples : (k, n_inputs + n_outputs + 1) array
        Since the alarm.
    reference : (n_inputs,) array
        Trim input.
    """
    if len(samples) < FEWEST:
        return None
    try:
        solution = yield from solving(setting, blueprint, x, poles, choose=False)
        yield
        estimate = estimate_of(setting, blueprint, x, solution, "", poles)
    except (TridentifyError, np.linalg.LinAlgError):
        return None
    samples = yield from far_off(setting, samples)
    found = yield from searching(setting, samples, True)
    if found is None or not found.certain:
        return None
    old = Old(estimate.theta, estimate.cov)
    better = yield from _is_better(setting, samples, old, found)
    if not better:
        return None
    nuisance = Nuisance.of(setting.structure, True)
    return (
        yield from launching(
            method, setting, found.poles, nuisance, samples, found.noise_std, reference
        )
    )[0]


def _is_better(setting: Setting, samples: Array, old: Old, found: Found) -> Slices[bool]:
    """Whether the new coefficients explain the samples clearly better than the old ones."""
    record, new = record_of(setting, samples), found.estimate
    yield
    before = left_by(setting, record, old.theta)
    yield
    after = left_by(setting, record, new.theta)
    yield
    gains = np.sum([gain_of(before[:, i], after[:, i]) for i in range(setting.n_outputs)], axis=0)
    if gains.sum() - gains.max() < CLEAR or np.mean(gains > 0.0) < AGREEING:
        return False
    return _differ(old, new, _enlarged(record, after))


def _differ(old: Old, new: Estimate, enlarged: float) -> bool:
    """Whether the coefficients are others, by both covariances."""
    n = new.model.den[0][0].size - 1
    if np.any(np.sqrt(enlarged) * new.std[:n] > VAGUE * np.abs(new.theta[:n])):
        return False
    move, cov = new.theta - old.theta, old.cov + enlarged * new.cov
    unit = 1.0 / np.sqrt(np.diagonal(cov))
    scaled = np.linalg.lstsq(unit[:, None] * cov * unit, unit * move, rcond=1e-12)[0]
    distance = float(unit * move @ scaled)
    return distance > float(scipy.stats.chi2.isf(RARE, move.size))


def _enlarged(record: Record, left: Array) -> float:
    """How much larger than for white noise variances are, the largest over the outputs."""
    found = 1.0
    for i in range(record.n_outputs):
        r, s = (_autocorrelation(one[:, i]) for one in (left, record.y))
        found = max(found, 1.0 + 2.0 * float(np.sum(r * s)))
    return found


def _autocorrelation(values: Array) -> Array:
    """Of lags one to an eighth of the length."""
    seen = np.isfinite(values)
    mean = np.mean(values[seen])
    filled = np.where(seen, values - mean, 0.0)
    power = float(filled @ filled)
    count = max(filled.size // 8, 1)
    if not power > 0.0:
        return np.zeros(count)
    found = np.array([filled[k:] @ filled[:-k] for k in range(1, count + 1)]) / power
    return np.asarray(found)
