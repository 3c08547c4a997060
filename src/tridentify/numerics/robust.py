"""Robust losses, their scales, and the samples that make least squares minimise them.

With residuals ``r_k`` of one output, a scale ``s`` and ``x = r / s`` an M-estimate solves
``sum psi(x_k) dr_k = 0`` (Huber 1964). Two losses are offered.

*Huber*: ``psi(x) = max(-k, min(x, k))`` with ``k = 1.345``, convex, 95 % efficient where the noise
is Gaussian. Its scale is Huber's second proposal, ``sum psi(x)^2 = (N - p) E psi(z)^2`` with ``z``
standard normal and ``p`` unknowns: consistent for Gaussian noise, no jump where a sample
crosses a limit, and finite for up to 39 % of samples that are arbitrarily far off.

*Student*: maximum likelihood for noise of Student's distribution with scale ``s`` and ``nu``
degrees of freedom, ``psi(x) = (nu + 1) x / (nu + x^2)``. Both are estimated from the residuals:
the scale by the fixed point ``mean(psi(x) x) = 1`` of the EM algorithm, ``nu`` by the likelihood
along that curve (Lange, Little & Taylor 1989). It takes far samples out altogether, and becomes
least squares where the noise is Gaussian (``nu`` large). ``nu`` is kept at 1 (Cauchy) or above,
as the likelihood has no maximum for very small values (Fernandez & Steel 1999).

*Pseudo-samples.* Let ``f`` be the fitted output and ``m = mean psi'(x)``. The least-squares fit of

    y* = f + s psi(x) / m

has the normal equations of the M-estimate, so ``f`` is its own least-squares fit exactly at an
M-estimate (Cox 1983; Oh, Nychka & Lee 2007). So any least-squares method, with whatever it can do,
becomes a robust one by fitting ``y*`` in place of ``y`` until nothing moves. Three things make this
division by ``m`` the right one:

1. each round is a Newton step with ``psi'`` replaced by its mean, so few rounds are needed;
2. the residual variance of ``y*``, ``V = s^2 mean(psi^2) / m^2``, times ``(J' J)^{-1}`` is the
   asymptotic covariance of the M-estimate (Huber 1981, section 7.6), so least squares' own
   standard errors are the right ones, whatever the distribution of the noise. Huber's correction
   ``1 + (p / N) var(psi') / m^2`` for few samples is put into ``y*``;
3. where several outputs share unknowns, least squares weights each by ``1 / V``: its own precision.

References: P. Huber, Annals of Mathematical Statistics 35 (1964) 73-101; *Robust Statistics*, Wiley
(1981). K. Lange, R. Little & J. Taylor, J. American Statistical Association 84 (1989) 881-896.
C. Fernandez & M. Steel, Biometrika 86 (1999) 153-167. D. Cox, Annals of Statistics 11 (1983)
530-551. H.-S. Oh, D. Nychka & T. Lee, Biometrika 94 (2007) 893-904.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import gammaln, ndtr

from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import median

Loss = Literal["squared", "huber", "student"]

LOSSES = ("squared", "huber", "student")
TUNING = 1.345
"""Huber's ``k``: 95 % efficient where the noise is Gaussian."""
MAD_OF_NORMAL = 0.6744897501960817
"""Median of the magnitude of a standard normal variable."""
FEWEST_DEGREES, MOST_DEGREES = 1.0, 200.0
"""Cauchy's distribution, below which the likelihood may have no maximum; and what cannot be told
from a normal one by any record."""
LOOKED_AT = 20_000
"""Samples on which the degrees of freedom are searched: more cost time, and change hardly a
weight."""
ROUNDS = 200
"""Of a fixed point: many times what it takes."""
SCALE_STILL = 1e-10
"""Relative change of a scale that stands still: far within its standard error."""
LEAST_SLOPE = 0.2
"""Of the mean of ``psi'``, which is divided by: no step is more than five times that of least
squares."""
LEAST_SCALE = 1e-13
"""Relative to the output: residuals below it are rounding."""


class Judged(NamedTuple):
    """What a loss makes of the residuals of one output.

    ``spread`` [output units], the noise's standard deviation as its middle shows it (Huber's second
    proposal, for either loss); ``degrees`` of freedom, infinite but for Student's distribution;
    ``weights`` (N,), ``psi(x) / x`` with 1 for a sample that counts in full; and ``pseudo`` (N,),
    the residuals of the pseudo-samples. The latter two are ``nan`` where a sample is missing.
    """

    spread: float
    degrees: float
    weights: Array
    pseudo: Array


def median_scale(residuals: Array, unknowns: float = 0.0) -> float:
    """Scale from the median absolute value, consistent for Gaussian noise.

    Parameters
    ----------
    residuals : (N,) array
        Without ``nan``.
    unknowns : float
        As many of the smallest are left out: a fit by least absolute values makes them zero.

    Examples
    --------
    >>> round(median_scale(np.array([-1.0, 1.0, -1.0, 1.0, 90.0])), 3)
    1.483
    """
    kept = np.abs(residuals)
    left_out = min(int(unknowns), kept.size - 1)
    if left_out:
        kept = np.partition(kept, left_out)[left_out:]
    return median(kept) / MAD_OF_NORMAL


def judge(residuals: Array, loss: Loss, unknowns: float, size: float, damping: float) -> Judged:
    """Scale, weights and pseudo-residuals of one output.

    Parameters
    ----------
    residuals : (N,) array
        Recorded minus fitted; ``nan`` marks a missing sample.
    loss : {"huber", "student"}
    unknowns : float
        That were fitted to this output.
    size : float
        Root mean square of the output as recorded: what rounding is relative to.
    damping : float
        Share of the round's step that is taken, at most 1.

    Returns
    -------
    Judged
    """
    seen = np.isfinite(residuals)
    r = residuals[seen]
    least = max(LEAST_SCALE * size, 1e-300)
    degrees = math.inf
    spread = scale = huber_scale(r, unknowns, least)
    if loss == "huber":
        x = r / scale
        psi, slope = np.clip(x, -TUNING, TUNING), (np.abs(x) <= TUNING).astype(np.float64)
        weights = np.minimum(TUNING / np.maximum(np.abs(x), TUNING), 1.0)
    else:
        scale, degrees = student_scale(r, least)
        x = r / scale
        weights = (degrees + 1.0) / (degrees + x * x)
        psi = weights * x
        slope = weights * (degrees - x * x) / (degrees + x * x)
        weights = weights * degrees / (degrees + 1.0)
    mean = max(float(slope.mean()), LEAST_SLOPE)
    few = 1.0 + unknowns / r.size * float(slope.var()) / mean**2
    whole = np.full((2, residuals.size), np.nan)
    whole[0, seen], whole[1, seen] = weights, damping * few * scale * psi / mean
    return Judged(spread, degrees, whole[0], whole[1])


def huber_scale(r: Array, unknowns: float, least: float) -> float:
    """Huber's second proposal for the scale of residuals (N,), not below ``least``.

    Examples
    --------
    >>> r = np.random.default_rng(0).standard_normal(10_000)
    >>> round(huber_scale(r, 0.0, 0.0), 2)
    1.0
    """
    wanted = max(r.size - unknowns, 1.0) * _mean_square_of_normal()
    scale = max(median_scale(r), least)
    if scale == 0:
        return least
    for _ in range(ROUNDS):
        psi = np.clip(r / scale, -TUNING, TUNING)
        factor = math.sqrt(float(psi @ psi) / wanted)
        following = max(scale * factor, least)
        done = abs(following - scale) <= SCALE_STILL * scale
        scale = following
        if done:
            break
    return scale


def student_scale(r: Array, least: float) -> tuple[float, float]:
    """Scale and degrees of freedom of Student's distribution, by maximum likelihood.

    Parameters
    ----------
    r : (N,) array
        The degrees of freedom are taken from at most 20,000 of them, evenly spaced.
    least : float
        Smallest scale.

    Examples
    --------
    >>> r = np.random.default_rng(0).standard_t(3.0, 20_000)
    >>> [round(v, 1) for v in student_scale(2.0 * r, 0.0)]
    [2.0, 2.9]
    """
    start = max(median_scale(r), least)
    if start == 0:
        return least, math.inf
    part = r[:: -(-r.size // LOOKED_AT)] / start

    def loss(log_degrees: float) -> float:
        degrees = math.exp(log_degrees)
        scale = _student_scale(part, degrees)
        terms = float(np.log1p((part / scale) ** 2 / degrees).mean())
        constant = gammaln(0.5 * (degrees + 1.0)) - gammaln(0.5 * degrees)
        normed = constant - 0.5 * log_degrees - math.log(scale)
        return float(0.5 * (degrees + 1.0) * terms - normed)

    ends = (math.log(FEWEST_DEGREES), math.log(MOST_DEGREES))
    # slow to import, seldom needed
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(loss, bounds=ends, method="bounded", options={"xatol": 1e-6})
    degrees = math.exp(min([float(found.x), *ends], key=loss))
    return max(start * _student_scale(r / start, degrees), least), degrees


def _student_scale(r: Array, degrees: float) -> float:
    """The EM algorithm's fixed point for the scale, each step extrapolated by its known rate."""
    squares, scale = r * r, 1.0
    for _ in range(ROUNDS):
        before = scale
        weighted = float(((degrees + 1.0) * squares / (degrees * scale**2 + squares)).mean())
        scale *= weighted ** (0.5 * (degrees + 3.0) / degrees)
        if scale <= LEAST_SCALE or abs(scale - before) <= SCALE_STILL * before:
            break
    return scale


def _mean_square_of_normal() -> float:
    """``E psi(z)^2`` for Huber's loss and standard normal ``z``."""
    k = TUNING
    density = math.exp(-0.5 * k * k) / math.sqrt(2.0 * math.pi)
    inside = 2.0 * float(ndtr(k)) - 1.0
    return inside - 2.0 * k * density + k * k * (1.0 - inside)
