"""Likelihood of autoregressions with missing samples, against the filter and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lfilter

from tridentify.numerics.autoregression import (
    burg,
    deviance,
    fit_autoregression,
    most_coefficients,
)
from tridentify.numerics.incomplete import Incomplete
from tridentify.numerics.levinson import polynomial


def with_gaps(rng, n, share, k=(-0.9, 0.5)):
    series = lfilter([1.0], np.append(1.0, polynomial(np.array(k))), rng.standard_normal(n + 300))
    series = series[300:]
    series[rng.random(n) < share] = np.nan
    return series


@pytest.mark.parametrize(
    ("sizes", "order", "share"),
    [((60, 30), 3, 0.3), ((200,), 8, 0.5), ((12, 9, 4), 6, 0.2), ((50,), 5, 0.0), ((40,), 1, 0.9)],
)
def test_value_is_that_of_the_filter_and_slopes_are_its_differences(sizes, order, share):
    """The third has series that are shorter than the order."""
    rng = np.random.default_rng(order)
    k = rng.uniform(-0.85, 0.85, order)
    series = [with_gaps(rng, n, share) for n in sizes]
    found = Incomplete(series, order)
    value, slopes = found.with_slopes(k)
    assert value == pytest.approx(deviance(series, polynomial(k)), abs=1e-9)
    steps = 1e-6 * np.eye(order)
    numeric = [(found.deviance(k + e) - found.deviance(k - e)) / 2e-6 for e in steps]
    assert np.allclose(slopes, numeric, rtol=1e-5, atol=1e-4)


def test_a_long_outage_at_an_end_is_as_if_it_were_not_there():
    rng = np.random.default_rng(3)
    series = with_gaps(rng, 90, 0.1)
    padded = np.concatenate([np.full(40, np.nan), series, np.full(25, np.nan)])
    k = np.array([-0.7, 0.4, 0.1])
    one, other = Incomplete([series], 3).with_slopes(k), Incomplete([padded], 3).with_slopes(k)
    assert one[0] == pytest.approx(other[0], abs=1e-8)
    assert np.allclose(one[1], other[1], atol=1e-7)


@pytest.mark.parametrize("share", [0.01, 0.4])
def test_best_is_where_a_search_without_derivatives_ends(share):
    rng = np.random.default_rng(4)
    series = [with_gaps(rng, 300, share), with_gaps(rng, 200, share)]
    start = burg(series, 2)[0]
    found = Incomplete(series, 2).best(start)
    searched = minimize(
        lambda u: deviance(series, polynomial(np.tanh(u))),
        np.arctanh(start),
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-10, "maxiter": 2000},
    )
    assert np.allclose(found, np.tanh(searched.x), atol=1e-5)


def test_a_long_order_takes_few_values_of_the_likelihood(monkeypatch):
    """Differences would take thirty values for each step."""
    rng = np.random.default_rng(5)
    series = with_gaps(rng, 1200, 0.01)
    values = 0
    plain = Incomplete.with_slopes

    def counted(self, k):
        nonlocal values
        values += 1
        return plain(self, k)

    monkeypatch.setattr(Incomplete, "with_slopes", counted)
    a = fit_autoregression([series], most_coefficients(1200), order=30)
    assert a.size == 30
    assert values <= 40


def test_burg_with_gaps_is_the_recursion_on_whole_stretches():
    """Step by step as written, on every window that is whole."""
    rng = np.random.default_rng(6)
    series = with_gaps(rng, 120, 0.08)
    reflection, power = burg([series], 6)
    a, energies = np.ones(1), [np.nanmean(series**2)]
    for p in range(reflection.size):
        windows = np.lib.stride_tricks.sliding_window_view(series, p + 2)
        windows = windows[np.isfinite(windows).all(axis=1)][:, ::-1]
        forward, backward = windows[:, :-1] @ a, windows[:, 1:] @ a[::-1]
        k = -2.0 * forward @ backward / (forward @ forward + backward @ backward)
        assert reflection[p] == pytest.approx(k, abs=1e-12)
        a = np.append(a, 0.0) + k * np.append(a, 0.0)[::-1]
        energies.append(energies[-1] * (1.0 - k * k))
    assert reflection.size == 6
    assert np.allclose(power, energies)
