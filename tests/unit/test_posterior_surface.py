"""The posterior density against a dense computation that shares nothing with it but the formula.

Here the columns are companion-form states sample by sample, least squares is `lstsq`, coloured
noise is whitened by the Cholesky factor of its covariance, and the prior's volume is taken by
central differences along the coordinates. So Jacobian and scores are not used either.
"""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy.signal import lfilter

from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.posterior import surface as module
from tridentify.estimation.posterior.many_cascades import Sections
from tridentify.estimation.posterior.surface import surface, unit_of
from tridentify.models.regression import Experiment
from tridentify.numerics.realization import sort_poles

DT = 0.05
STEP = 1e-5


def made(n_samples, n_inputs, n_outputs, *, seed=0, dt=DT, missing=0, noise=(), **terms):
    """An experiment of pure noise: nothing but the formula says what comes out."""
    rng = np.random.default_rng(seed)
    u = np.ascontiguousarray(rng.standard_normal((n_samples, n_inputs)).cumsum(axis=0))
    y = rng.standard_normal((n_samples, n_outputs)).cumsum(axis=0)
    y[rng.choice(n_samples, missing, replace=False), 0] = np.nan
    chosen = {"intersample": "zoh", "free": False, "offset": False, "drift": False} | terms
    return Experiment(u, y, dt, noise=noise, **chosen)


def places(n, count=6, seed=1):
    """Coordinates about a tenth of the sampling rate, complex and real pairs."""
    rng = np.random.default_rng(seed)
    phi = np.log(0.1) + 0.6 * rng.standard_normal((count, n))
    for k in range(n // 2):
        phi[:, 2 * k + 1] = np.log(0.7) + 0.7 * rng.standard_normal(count)
    return phi


# ---------------------------------------------------------------------------------- dense reference
def states(a, e, drive, dt):
    """(n_samples, n) of ``p^{n-1} / a .. 1 / a`` on a signal; from ``delta`` where None."""
    n = a.size
    whole = np.zeros((n + 2, n + 2))
    whole[0, :n] = -a
    whole[1:n, : n - 1] += np.eye(n - 1)
    whole[0, n] = whole[n, n + 1] = 1.0
    step = scipy.linalg.expm(whole * dt)
    slope = np.zeros(e.n_samples)
    if e.intersample == "foh" and drive is not None:
        slope[:-1] = np.diff(drive) / dt
    x = np.eye(n)[0] if drive is None else np.zeros(n)
    level = np.zeros(e.n_samples) if drive is None else drive
    found = np.empty((e.n_samples, n))
    for k in range(e.n_samples):
        found[k] = x
        x = step[:n, :n] @ x + step[:n, n] * level[k] + step[:n, n + 1] * slope[k]
    return found


def covariance_of(noise, n_samples):
    """Of stationary autoregressive noise with innovations of variance one."""
    reply = lfilter([1.0], np.append(1.0, noise), np.eye(1, 5000)[0])
    row = [reply[k:] @ reply[: reply.size - k] for k in range(n_samples)]
    return scipy.linalg.toeplitz(row)


class Dense:
    """One output at one denominator; rates in units of one over the shortest interval."""

    def __init__(self, problem, output, a):
        self.problem, self.output = problem, output
        unit, n = min(e.dt for e in problem.experiments), problem.n_poles
        linear, apart, target = [], [], []
        count = len(problem.experiments)
        for number, e in enumerate(problem.experiments):
            dt = e.dt / unit
            blocks = []
            for j, m in enumerate(problem.n_zeros[output]):
                x = states(a, e, e.u[:, j], dt)
                if m == n:
                    x = np.column_stack([e.u[:, j] - x @ a, x])
                blocks.append(x[:, x.shape[1] - m - 1 :])
            own = [states(a, e, None, dt)] if e.free else []
            own += [np.ones((e.n_samples, 1))] if e.offset else []
            own += [np.linspace(0.0, 1.0, e.n_samples)[:, None]] if e.drift else []
            own = np.hstack([np.zeros((e.n_samples, 0)), *own])
            padded = np.zeros((e.n_samples, own.shape[1] * count))
            padded[:, own.shape[1] * number : own.shape[1] * (number + 1)] = own
            rows = np.hstack([*blocks, padded, e.y[:, [output]]])
            rows = self._white(e, rows)
            width = sum(block.shape[1] for block in blocks)
            linear.append(rows[:, :width])
            apart.append(rows[:, width:-1])
            target.append(rows[:, -1])
        self.linear, self.apart = np.vstack(linear), np.vstack(apart)
        self.target = np.concatenate(target)
        self.columns = np.hstack([self.linear, self.apart])
        x, _, _, _ = np.linalg.lstsq(self._scaled(self.columns), self.target, rcond=None)
        self.theta = x / np.linalg.norm(self.columns, axis=0)
        self.b = self.theta[: self.linear.shape[1]]
        self.rss = float(np.sum((self.target - self.columns @ self.theta) ** 2))
        self.freedom = self.target.size - self.columns.shape[1]

    def _white(self, e, rows):
        seen = np.isfinite(e.y[:, self.output])
        noise = e.noise[self.output] if e.noise else np.zeros(0)
        if not noise.size:
            return rows[seen]
        root = np.linalg.cholesky(covariance_of(noise, e.n_samples)[np.ix_(seen, seen)])
        return scipy.linalg.solve_triangular(root, rows[seen], lower=True)

    @staticmethod
    def _scaled(columns):
        return columns / np.linalg.norm(columns, axis=0)

    def off(self, signals, columns):
        """Projected off the columns."""
        if not columns.shape[1]:
            return signals
        q = np.linalg.qr(self._scaled(columns))[0]
        return signals - q @ (q.T @ signals)

    @property
    def covariance(self):
        """Of ``b``."""
        size = np.linalg.norm(self.columns, axis=0)
        inverse = np.linalg.pinv(self.columns / size)
        whole = inverse @ inverse.T / np.outer(size, size) * self.rss / self.freedom
        return whole[: self.b.size, : self.b.size]


def denominator_at(phi):
    return Sections.of(phi[None], phi.size).polynomials()[0, 1:]


def dense_log_density(problem, phi):
    """Up to a constant."""
    n = problem.n_poles
    likelihood, energy, scores = 0.0, 0.0, []
    for i in range(problem.n_outputs):
        here = Dense(problem, i, denominator_at(phi))
        likelihood -= 0.5 * here.freedom * np.log(here.rss)
        weight = here.freedom / here.rss
        energy += weight * np.sum(here.off(here.linear @ here.b, here.apart) ** 2)
        columns = []
        for step in STEP * np.eye(n):
            up, down = (
                Dense(problem, i, denominator_at(phi + sign * step)).linear @ here.b
                for sign in (1.0, -1.0)
            )
            columns.append((up - down) / (2.0 * STEP))
        moved = here.off(np.stack(columns, axis=1), here.columns)
        scores.append(np.sqrt(weight) * moved)
    volume = np.log(np.linalg.svd(np.vstack(scores), compute_uv=False)).sum()
    return likelihood + volume - 0.5 * n * np.log(energy) + outside(problem, phi)


def outside(problem, phi):
    """Roll-off, and one over the number of coordinates of this denominator."""
    sections = Sections.of(phi[None], phi.size)
    size = np.abs(sections.roots())
    length = max(e.duration for e in problem.experiments) / min(e.dt for e in problem.experiments)
    fast, slow = size.max() / 1.5, 1.0 / (size.min() * length)
    band = -2.0 * (np.log1p(fast**4) + np.log1p(slow**4))
    return band - sections.log_multiplicity()[0]


AR2 = (np.array([-0.7, 0.2]), np.zeros(0))
CASES = {
    "first order": ([made(60, 1, 1)], 1, ((0,),)),
    "first order, direct": ([made(60, 1, 1)], 1, ((1,),)),
    "second order": ([made(70, 1, 1)], 2, ((0,),)),
    "zero": ([made(70, 1, 1)], 2, ((1,),)),
    "direct": ([made(70, 1, 1)], 2, ((2,),)),
    "third order, linear input": ([made(80, 1, 1, intersample="foh")], 3, ((1,),)),
    "offset and drift": ([made(80, 1, 1, offset=True, drift=True)], 2, ((1,),)),
    "free": ([made(80, 1, 1, free=True, offset=True)], 2, ((0,),)),
    "missing": ([made(90, 1, 1, missing=9, offset=True)], 2, ((0,),)),
    "coloured": ([made(90, 1, 1, noise=AR2[:1], offset=True)], 2, ((0,),)),
    "coloured and missing": ([made(90, 1, 2, missing=7, noise=AR2)], 2, ((0,), (1,))),
    "two by two": ([made(90, 2, 2, offset=True)], 3, ((1, 2), (0, 3))),
    "two experiments": (
        [made(60, 1, 2, free=True), made(80, 1, 2, seed=5, dt=2.0 * DT, free=True)],
        2,
        ((1,), (0,)),
    ),
    "fourth order": ([made(120, 1, 1)], 4, ((2,),)),
}
every_case = pytest.mark.parametrize("name", CASES)


def case(name):
    experiments, n, zeros = CASES[name]
    return Problem.of(experiments, n, zeros), places(n)


def powers(problem):
    """What one unit of rate does to each coefficient of the numerators."""
    n = problem.n_poles
    return np.concatenate([n - np.arange(m, -1.0, -1.0) for row in problem.n_zeros for m in row])


@every_case
@pytest.mark.fast("first order, direct", "first order", "direct", "zero")
def test_density_is_the_dense_one_up_to_a_constant(name):
    problem, phi = case(name)
    found = surface(problem, phi).log_density
    expected = np.array([dense_log_density(problem, one) for one in phi])
    assert np.ptp(expected) > 1.0
    assert found - found[0] == pytest.approx(expected - expected[0], abs=1e-4)


@every_case
def test_numerators_and_their_covariance_are_the_dense_ones(name):
    problem, phi = case(name)
    found = surface(problem, phi)
    for s, one in enumerate(phi):
        dense = [Dense(problem, i, denominator_at(one)) for i in range(problem.n_outputs)]
        b = np.concatenate([d.b for d in dense])
        covariance = scipy.linalg.block_diag(*(d.covariance for d in dense))
        std = np.sqrt(np.diag(covariance))
        assert found.numerators[s] == pytest.approx(b, abs=1e-6 * std.min() + 1e-6 * abs(b).max())
        scaled = found.roots[s] @ found.roots[s].T / np.outer(std, std)
        assert scaled == pytest.approx(covariance / np.outer(std, std), abs=1e-6)


@every_case
def test_coefficients_are_those_of_one_denominator(name):
    """`likelihood.cost` at the same poles, in physical units."""
    problem, phi = case(name)
    found, unit = surface(problem, phi), unit_of(problem)
    n, sections = problem.n_poles, Sections.of(phi, problem.n_poles)
    for s in range(len(phi)):
        theta = coefficients(evaluate(problem, sort_poles(sections.roots()[s]) / unit))
        a = found.denominators[s] / unit ** np.arange(1, n + 1)
        b = found.numerators[s] / unit ** powers(problem)
        assert a == pytest.approx(theta[:n], rel=1e-9)
        assert b == pytest.approx(theta[n:], rel=1e-6, abs=1e-8 * np.abs(theta[n:]).max())


@pytest.mark.parametrize("n", [1, 2, 3])
def test_prior_is_the_volume_of_the_outputs_direction(n):
    """With one coefficient above and no nuisance the shape is a unit vector: differentiate it."""
    problem, phi = Problem.of([made(80, 1, 1)], n, ((0,),)), places(n)

    def direction(at):
        x = Dense(problem, 0, denominator_at(at)).linear[:, 0]
        return x / np.linalg.norm(x)

    expected = []
    for one in phi:
        columns = [
            (direction(one + step) - direction(one - step)) / (2.0 * STEP)
            for step in STEP * np.eye(n)
        ]
        lengths = np.linalg.svd(np.stack(columns, axis=1), compute_uv=False)
        here = Dense(problem, 0, denominator_at(one))
        likelihood = -0.5 * (80 - 1) * np.log(here.rss)
        expected.append(likelihood + np.log(lengths).sum() + outside(problem, one))
    found = surface(problem, phi).log_density
    assert found - found[0] == pytest.approx(np.array(expected) - expected[0], abs=1e-4)


# ------------------------------------------------------------------------------------ invariances
def changed(name, **changes):
    experiments, n, zeros = CASES[name]
    fields = ("u", "y", "dt", "intersample", "free", "offset", "drift", "noise")
    new = []
    for e in experiments:
        values = {field: getattr(e, field) for field in fields}
        for field, factor in changes.items():
            values[field] = values[field] * factor
        new.append(Experiment(**values))
    return Problem.of(new, n, zeros)


@every_case
@pytest.mark.parametrize("change", [{"dt": 1e6}, {"dt": 1e-6}, {"y": 1e3}, {"y": 1e-9}, {"u": 1e5}])
def test_units_do_not_matter(name, change):
    """Another unit of time changes nothing, one of a signal adds a constant."""
    problem, phi = case(name)
    before, after = surface(problem, phi), surface(changed(name, **change), phi)
    difference = after.log_density - before.log_density
    assert difference == pytest.approx(np.full(len(phi), difference[0]), abs=1e-6)
    if "dt" in change:
        assert difference[0] == pytest.approx(0.0, abs=1e-6)
    factor = change.get("y", 1.0) / change.get("u", 1.0)
    size = np.abs(before.numerators).max()
    expected = factor * before.numerators
    assert after.numerators == pytest.approx(expected, rel=1e-7, abs=1e-9 * factor * size)
    size = np.abs(before.roots).max()
    assert after.roots == pytest.approx(factor * before.roots, rel=1e-6, abs=1e-8 * factor * size)


@every_case
def test_a_batch_is_one_denominator_after_the_other(name, monkeypatch):
    problem, phi = case(name)
    whole = surface(problem, phi)
    monkeypatch.setattr(module, "LARGEST_BLOCK", 1)
    for one, other in zip(whole, surface(problem, phi), strict=True):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-9 * np.abs(other).max())


def test_the_order_of_sections_does_not_matter():
    problem, phi = case("fourth order")
    swapped = phi[:, [2, 3, 0, 1]]
    found = surface(problem, swapped).log_density
    assert found == pytest.approx(surface(problem, phi).log_density, abs=1e-6)


def test_density_is_smooth_where_a_pair_becomes_real():
    """Inside the band: the roll-off follows the faster pole, which turns off from the other."""
    problem = case("zero")[0]
    phi = np.array([[np.log(0.1), damping] for damping in np.linspace(-1e-3, 1e-3, 21)])
    found = surface(problem, phi).log_density - [outside(problem, one) for one in phi]
    assert np.abs(np.diff(found, 2)).max() < 1e-8


# ------------------------------------------------------------------------------------------ edges
@pytest.mark.parametrize("name", ["first order", "zero", "offset and drift", "fourth order"])
def test_density_is_finite_and_low_where_the_record_is_blind(name):
    problem, phi = case(name)
    here = surface(problem, phi).log_density.max()
    for edge in (-40.0, 12.0):
        far = phi.copy()
        n = phi.shape[1]
        far[:, : 2 * (n // 2) : 2] += edge
        far[:, n - n % 2 :] += edge
        found = surface(problem, far)
        assert np.all(np.isfinite(found.log_density))
        assert np.all(np.isfinite(found.numerators))
        assert found.log_density.max() < here - 5.0


def test_a_noise_free_record_does_not_divide_by_zero():
    e = made(60, 1, 1)
    phi = places(2)
    dense = Dense(Problem.of([e], 2, ((1,),)), 0, denominator_at(phi[0]))
    y = (dense.linear @ np.array([0.3, 0.7]))[:, None]
    exact = Experiment(e.u, y, DT, "zoh", False, False, False)
    found = surface(Problem.of([exact], 2, ((1,),)), phi)
    assert np.all(np.isfinite(found.log_density))
    assert found.log_density.argmax() == 0
    assert found.numerators[0] == pytest.approx([0.3, 0.7], rel=1e-9)


def test_rates_are_in_units_of_the_shortest_interval():
    assert unit_of(case("two experiments")[0]) == DT
