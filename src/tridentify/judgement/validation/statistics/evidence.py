"""Every test of one output's residual, each allowing for what the others found.

All tests but those of distribution and scale are score tests of added columns
(`numerics.lagrange`) on samples that are whitened by a model of the noise; the columns are those of
`validation.statistics.columns`. Two things need care.

*The noise.* An estimate that takes the noise for white may be right about the system and wrong
about the noise. So the noise is looked at where it cannot be confused with a response that the
model misses: in what is left after past inputs and slow drifts have been fitted along. If that is
not white, an autoregressive model is fitted to it, allowing for what the columns took
(`numerics.autoregression`), and the tests of added columns are made on samples whitened by that
model.

*Confusion.* A drift may look like a late response to a step, and missing dynamics like a change of
the coefficients. Where both drift and past inputs are called for, each is tested again beside the
other. Later tests are made beside whatever was found before: feedback beside past inputs, changed
coefficients and bends beside both. And where a cause was found (`tridentify.judgement.causes`), all
but the past inputs is tested on what that leaves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.validation.residuals import Output, View
from tridentify.judgement.validation.result import Normality
from tridentify.judgement.validation.statistics import columns
from tridentify.judgement.validation.statistics.distribution import distribution
from tridentify.judgement.validation.statistics.likelihood_ratio import (
    CALLED,
    LONG,
    ROUNDS,
    Fitted,
    Known,
    checked,
    joined,
    least_checked,
    modelled,
    split,
    whitened,
)
from tridentify.judgement.validation.statistics.sizes import size_of_stretches
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import most_coefficients
from tridentify.numerics.kept import cached_property
from tridentify.numerics.lagrange import added_each, span
from tridentify.numerics.local_size import (
    changes_size,
    over_local_size,
    over_own_size,
    over_phases,
)
from tridentify.numerics.portmanteau import (
    Autocorrelation,
    Portmanteau,
    autocorrelation_of_fit,
    portmanteau,
    spread_of_products,
)
from tridentify.numerics.robust import median_scale

PRETEST = 0.05
"""p-value of whiteness up to which a noise model is fitted before other tests."""
SUSPICIOUS = 0.02
"""p-value of all score tests together from which an estimate is looked at more closely: what
follows costs many times the fit."""
WORTH_MODELLING = 0.02
"""p-value of a score test up to which the noise is modelled again beside its columns."""
LEAST_FEEDBACK = 0.02
"""Share of the residual that samples of the input to come must explain to be called feedback."""
HEAVY = 0.9
"""Leverage from which a sample is left out, as its residual is mostly its own doing."""


class Evidence:
    """What was found about one output: each test is made when its result is first asked for.

    Parameters
    ----------
    tests : the tests of an output
    **given
        Results that are known otherwise, by their names below.

    Attributes
    ----------
    autocorrelation : Autocorrelation
        Under the estimate's own model of the noise.
    whiteness : Portmanteau
    coloured : float
        p-value of what is left after past inputs and drifts being white.
    plainly_white : float
        The same under white noise, whatever the noise model of the estimate.
    noise : (p,) array
        The model of the noise that the other tests use.
    past, level, feedback, later, linear, scale, scale_within : float
        p-values; the last of the size of the noise within the experiments, whatever it is in each.
    by_input : tuple of float
        p-values of the past of each input beside that of the others.
    lags : tuple of int
        At which past inputs were looked for [samples].
    normality : Normality
    edges, scales : array
        See `result.Stationarity`.
    innovations : tuple of (n_samples,) arrays
        Under the estimate's own model of the noise, of variance one.
    """

    autocorrelation: Autocorrelation
    whiteness: Portmanteau
    coloured: float
    plainly_white: float
    noise: Array
    past: float
    level: float
    feedback: float
    later: float
    linear: float
    scale: float
    scale_within: float
    by_input: tuple[float, ...]
    lags: tuple[int, ...]
    normality: Normality
    edges: Array
    scales: Array
    innovations: tuple[Array, ...]

    def __init__(self, tests: _Tests, **given: Any) -> None:
        self._tests, self._given = tests, given

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return self._given[name] if name in self._given else getattr(self._tests, name)

    def having(self, **given: Any) -> Evidence:
        """The same, but for some results; tests that build on these stay as they were."""
        return Evidence(self._tests, **{**self._given, **given})


def examine(view: View, index: int, estimate: Estimate, n_lags: int, rate: float) -> Evidence:
    """All tests of one output.

    Parameters
    ----------
    view : View
    index : int
        Of the output.
    estimate : Estimate
    n_lags : int
        Of the autocorrelation.
    rate : float
        Probability of a false outlier.
    """
    return Evidence(_Tests(view, index, estimate, n_lags, rate))


class _Tests:
    """The tests of one output, as `Evidence` names their results; parameters as of `examine`."""

    def __init__(
        self, view: View, index: int, estimate: Estimate, n_lags: int, rate: float
    ) -> None:
        self._output = view.outputs[index]
        self._times = tuple(record.t for record in view.records)
        self._found = columns.searched_columns(view, index, estimate)
        self._n_lags, self._rate = n_lags, rate
        self.lags = self._found.lags

    @cached_property
    def _fitted(self) -> tuple[Array, ...]:
        return _fitted(self._output)

    @cached_property
    def _larger(self) -> tuple[Array, ...]:
        return joined(self._fitted, self._found.past, self._found.wave)

    @cached_property
    def _own(self) -> tuple[Array, Array]:
        return whitened(self._output, self._output.noise, self._fitted)

    @cached_property
    def autocorrelation(self) -> Autocorrelation:
        return _autocorrelation(self._output, self._own, self._n_lags)

    @cached_property
    def noise(self) -> Array:
        return _noise(self._output, self._larger, lambda: self.plainly_white)

    @cached_property
    def plainly_white(self) -> float:
        return _is_white(self._output, self._larger, np.zeros(0))

    @cached_property
    def _past_and_level(self) -> tuple[float, float]:
        return _past_and_level(
            self._output, self._found, self._white_fit, self._alone, self._white_past
        )

    @property
    def past(self) -> float:
        return self._past_and_level[0]

    @property
    def level(self) -> float:
        return self._past_and_level[1]

    @cached_property
    def _white_fit(self) -> tuple[Array, Array]:
        return whitened(self._output, self.noise, self._fitted)

    @cached_property
    def _white_past(self) -> Array:
        return self._output.white(self._found.past, self.noise)

    @cached_property
    def _alone(self) -> Known:
        return Known(self._output, self._fitted, self.noise)

    @cached_property
    def by_input(self) -> tuple[float, ...]:
        n_lags, (e, basis) = len(self.lags), self._white_fit
        n_inputs = int(self._found.past[0].shape[1]) // n_lags
        if self.past >= CALLED:
            return (1.0,) * n_inputs
        past, n = self._white_past, self._output.count
        return tuple(_one_input(past, j, basis, e, n_lags, n) for j in range(n_inputs))

    @cached_property
    def _drift(self) -> tuple[tuple[Array, ...], ...]:
        return (self._found.wave,) if self.level < CALLED else ()

    @cached_property
    def _wide(self) -> Known:
        columns = joined(self._fitted, self._found.past, *self._drift)
        return Known(self._output, columns, self.noise)

    @cached_property
    def feedback(self) -> float:
        extra = self._found.coming
        return checked(self._wide, extra, self._score(extra, self._wide, LEAST_FEEDBACK))

    @cached_property
    def later(self) -> float:
        more = (self._found.past,) if self.past < CALLED else ()
        known = self._alone
        if more or self._drift:
            columns = joined(self._fitted, *more, *self._drift)
            known = Known(self._output, columns, self.noise)
        return checked(known, self._found.later, self._score(self._found.later, known))

    @cached_property
    def linear(self) -> float:
        kinds = self._found.bends
        bent = [(self._bent(one, CALLED / len(kinds)), one) for one in kinds]
        return least_checked(self._wide, bent)

    def _bent(self, extra: tuple[Array, ...], enough: float) -> float:
        """By score, with a noise model that has not taken for noise what the columns explain."""
        p = self._score(extra, self._wide)
        output, known = self._output, self._wide
        if not self.noise.size or not enough < p < WORTH_MODELLING or output.count > LONG:
            return p
        noise = np.zeros(0)
        both = Fitted(output, joined(known.columns, extra))
        for _ in range(ROUNDS):
            noise = modelled(output, both, noise, known.most, 0)
        e, basis = whitened(output, noise, known.columns)
        (test,) = added_each(e, basis, [output.white(extra, noise)], output.count)
        return min(p, test.p_value)

    def _score(self, extra: tuple[Array, ...], known: Known, least: float = 0.0) -> float:
        output, e = self._output, self._white_fit[0]
        white = output.white(extra, self.noise)
        (test,) = added_each(e, known.basis, [white], output.count)
        # in a long record the slightest imperfection is significant, and means nothing
        return test.p_value if test.share > least else max(test.p_value, PRETEST)

    @cached_property
    def _plain(self) -> tuple[Array, ...]:
        """The residual beside what was found, over its size."""
        output, (e, basis) = self._output, self._white_fit
        if self.past < CALLED:
            basis = np.hstack([basis, span(self._white_past, basis)])
        if self.level < CALLED:
            basis = np.hstack([basis, span(output.white(self._found.wave, self.noise), basis)])
        return _studentised(output, e, basis)

    @cached_property
    def _stretches(self) -> tuple[float, Array, Array]:
        return size_of_stretches(self._output, self._plain, self._own[0])

    @property
    def scale(self) -> float:
        return self._stretches[0]

    @cached_property
    def scale_within(self) -> float:
        even = over_own_size(self._plain)
        own = np.nan_to_num(np.concatenate(over_own_size(self.innovations)))
        return size_of_stretches(self._output, even, own)[0]

    @property
    def edges(self) -> Array:
        return self._stretches[1]

    @property
    def scales(self) -> Array:
        return self._stretches[2]

    @cached_property
    def normality(self) -> Normality:
        plain, changes = tuple(map(over_phases, self._plain)), False
        if self.scale < CALLED:
            # noise that changes its size has far samples and uncertain correlations
            plain, changes = self._levelled(plain), any(map(changes_size, over_own_size(plain)))
        return distribution(
            self._output.name, plain, self._times, self._rate, self.noise, levelled=changes
        )

    def _levelled(self, plain: tuple[Array, ...]) -> tuple[Array, ...]:
        """Over the size of the noise around each sample, or of its stretch where few are large.

        Of several experiments each has noise of its own.
        """
        plain = over_own_size(plain)
        if any(changes_size(one) for one in plain):
            return tuple(over_local_size(one) for one in plain)
        joined = np.concatenate(plain)
        for a, b in pairwise(self.edges.astype(int).tolist()):
            seen = joined[a:b][np.isfinite(joined[a:b])]
            size = median_scale(seen) if seen.size else 0.0
            joined[a:b] /= size if size > 0 else 1.0
        return tuple(split(self._output, joined))

    @cached_property
    def whiteness(self) -> Portmanteau:
        own, found = self._own, self.autocorrelation
        if self.scale < CALLED:
            even = self._levelled(self.innovations)
            own = np.nan_to_num(np.concatenate(even)), own[1]
            found = _autocorrelation(self._output, own, self._n_lags)
        return portmanteau(found, self._output.noise)

    @cached_property
    def coloured(self) -> float:
        noise = self._output.noise
        own = _is_white(self._output, self._larger, noise) if noise.size else self.plainly_white
        return max(own, self.whiteness.p_value) if self.scale < CALLED else own

    @cached_property
    def innovations(self) -> tuple[Array, ...]:
        return _studentised(self._output, *self._own)


def suspicious(view: View, index: int, estimate: Estimate) -> bool:
    """Whether a look at one output's residual calls for all tests and other explanations.

    The score tests alone, under the noise model of the estimate and without what makes their
    p-values exact: one in fifty right records is called for, and what follows then decides.
    """
    output = view.outputs[index]
    found = columns.searched_columns(view, index, estimate)
    e, basis = whitened(output, output.noise, _fitted(output))
    kinds = (*found.late, *found.bends, found.past, found.wave, found.later, found.coming)
    # column after column in memory, as they are whitened and tested
    beside = [np.vstack([one.T for one in own]).T for own in zip(*kinds, strict=True)]
    white = output.white(beside, output.noise)
    ends = [0, *accumulate(one[0].shape[1] for one in kinds)]
    tests = added_each(e, basis, [white[:, a:b] for a, b in pairwise(ends)], output.count)
    return len(tests) * min(test.p_value for test in tests) < SUSPICIOUS


def _fitted(output: Output) -> tuple[Array, ...]:
    """Derivatives by all that was fitted."""
    return joined(output.coefficients, output.nuisance)


def _past_and_level(
    output: Output,
    found: columns.SearchedColumns,
    fit: tuple[Array, Array],
    alone: Known,
    past: Array,
) -> tuple[float, float]:
    """p-values of past inputs and of a drift, each beside the other where both are called for."""
    (e, basis), n, n_lags = fit, output.count, len(found.lags)
    wave = output.white(found.wave, alone.noise)
    p_past = _past(past, basis, e, n_lags, n)
    late = [output.white(one, alone.noise) for one in found.late]
    level, *of_late = (test.p_value for test in added_each(e, basis, [wave, *late], n))
    by_score = [(p_past, found.past), *zip(of_late, found.late, strict=True)]
    p_past = least_checked(alone, by_score)
    level = checked(alone, found.wave, level)
    if p_past < CALLED and level < CALLED:
        return _told_apart(past, wave, (basis, e), n_lags, n, p_past)
    return p_past, level


def without_outliers(view: View, index: int, found: Evidence) -> View:
    """The same view with the outliers of one output missing, for tests that they would spoil."""
    output = view.outputs[index]
    residual = [np.array(one) for one in output.residual]
    for e, t, _ in found.normality.outliers:
        times = view.records[int(e)].t
        residual[int(e)][int(np.argmin(np.abs(times - t)))] = np.nan
    outputs = list(view.outputs)
    outputs[index] = replace(output, residual=tuple(residual))
    return replace(view, outputs=tuple(outputs))


def _autocorrelation(output: Output, own: tuple[Array, Array], n_lags: int) -> Autocorrelation:
    seen = [one.astype(np.float64) for one in output.seen]
    left = split(output, own[0])
    found = autocorrelation_of_fit(left, seen, split(output, own[1]), n_lags)
    if all(over_phases(one) is one for one in left):
        return found
    size = np.sqrt(spread_of_products(left, n_lags))
    return found._replace(value=found.mean + (found.value - found.mean) / np.maximum(size, 1.0))


def _is_white(output: Output, larger: tuple[Array, ...], noise: Array) -> float:
    """p-value of what no column explains being white under a model."""
    fit = whitened(output, noise, larger)
    n_lags = max(most_coefficients(output.count), output.noise.size + 4)
    found = _autocorrelation(output, fit, n_lags)
    return portmanteau(found, noise).p_value


def _noise(output: Output, larger: tuple[Array, ...], free: Callable[[], float]) -> Array:
    """A model of what no column explains; none where that is white (``free`` is its p-value).

    The estimate's own model may have taken a missed response for noise, so that this one begins
    with white noise.
    """
    noise, most = np.zeros(0), most_coefficients(output.count)
    stated = output.noise.size > 0
    if most and (stated or free() <= PRETEST):
        fitted = Fitted(output, larger)
        for _ in range(ROUNDS):
            noise = modelled(output, fitted, noise, most, int(stated))
    return noise


def _past(past: Array, basis: Array, e: Array, n_lags: int, n: int) -> float:
    """Test of past inputs, at the first few lags and at all of them."""
    first = np.arange(past.shape[1]) % n_lags < columns.FIRST_LAGS
    return min(
        1.0, 2.0 * min(one.p_value for one in added_each(e, basis, [past[:, first], past], n))
    )


def _told_apart(
    past: Array, wave: Array, fit: tuple[Array, Array], n_lags: int, n: int, p_past: float
) -> tuple[float, float]:
    """p-values of past inputs beside a drift, and of a drift beside past inputs."""
    basis, e = fit
    with_wave = np.hstack([basis, span(wave, basis)])
    p_beside = _past(past, with_wave, e, n_lags, n)
    with_past = np.hstack([basis, span(past, basis)])
    level = added_each(e, with_past, [wave], n)[0].p_value
    if min(p_beside, level) > CALLED:
        # either alone explains the other; the response is the simpler cause
        return p_past, level
    return p_beside, level


def _one_input(past: Array, j: int, basis: Array, e: Array, n_lags: int, n: int) -> float:
    """Test of one input's past, beside that of the others."""
    mine = np.arange(past.shape[1]) // n_lags == j
    known = np.hstack([basis, span(past[:, ~mine], basis)])
    return _past(past[:, mine], known, e, n_lags, n)


def _studentised(output: Output, e: Array, basis: Array) -> tuple[Array, ...]:
    """The residual over the standard deviation that it has at each sample."""
    left = e - basis @ (basis.T @ e)
    freedom = max(output.count - basis.shape[1], 1)
    spread = np.sqrt(left @ left / freedom)
    kept = 1.0 - np.einsum("ij,ij->i", basis, basis)
    there = np.concatenate(output.seen) & (kept > 1.0 - HEAVY)
    scale = spread * np.sqrt(np.where(there, kept, 1.0))
    found = np.where(there, left / np.where(scale > 0, scale, 1.0), np.nan)
    return tuple(split(output, found))
