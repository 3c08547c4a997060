"""Noise-free and noisy records from a generator of its own: sums of modes, exact sample by sample.

Nothing here uses `tridentify.simulate` to make data. A system is a set of poles, zeros and a gain;
each mode is one complex first-order recursion whose weights come from the series of
``(exp(z) - 1) / z`` and ``(exp(z) - 1 - z) / z^2``.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter

from tridentify import (
    IdentifiabilityError,
    Record,
    Status,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)

pytestmark = pytest.mark.unjudged

EXACT = 1e-8
YEAR = 365.25 * 86400.0


# ------------------------------------------------------------------------------- the generator
def phi(z):
    """``(e^z - 1) / z`` and ``(e^z - 1 - z) / z^2`` to full precision."""
    if abs(z) > 0.7:
        return np.expm1(z) / z, (np.expm1(z) - z) / z**2
    second, term, k = 0.0, 0.5 + 0.0j, 2
    while abs(term) > 1e-19:
        second, k = second + term, k + 1
        term *= z / k
    return 1.0 + z * second, second


def mode(pole, u, dt, intersample):
    """State of ``x' = pole x + u`` at the samples, from rest."""
    z = complex(pole) * dt
    first, second = phi(z) if z else (1.0, 0.5)
    late = second if intersample == "foh" else 0.0
    weights = np.array([late, first - late]) * dt
    start = np.array([-weights[0] * u[0]])
    return lfilter(weights, [1.0, -np.exp(z)], u.astype(complex), zi=start)[0]


def respond(poles, zeros, gain, u, dt, intersample="zoh"):
    """Output of ``gain prod(s - zeros) / prod(s - poles)``, simple poles, from rest."""
    y = gain * u if len(zeros) == len(poles) else np.zeros(u.size)
    zeros = np.asarray(zeros, complex)
    for i, pole in enumerate(poles):
        others = np.delete(np.asarray(poles, complex), i)
        residue = gain * np.prod(pole - zeros) / np.prod(pole - others)
        y = y + (residue * mode(pole, u, dt, intersample)).real
    return y


def relaxing(poles, weights, n_samples, dt):
    """Free response: one weight for each pole, the same for both of a conjugate pair."""
    t = np.arange(n_samples) * dt
    return sum(
        (w * np.exp(p * t)).real for p, w in zip(np.asarray(poles, complex), weights, strict=True)
    )


def polynomial(roots):
    return np.real(np.poly(roots)) if len(roots) else np.ones(1)


def coefficients(poles, zeros, gain):
    return np.concatenate([polynomial(poles)[1:], gain * polynomial(zeros)])


def binary(n_samples, hold, seed=0):
    """Random binary levels, each held for ``hold`` samples."""
    signs = np.sign(np.random.default_rng(seed).standard_normal(-(-n_samples // hold)))
    return np.repeat(signs, hold)[:n_samples]


def levels(n_samples, hold, seed=0):
    """Random Gaussian levels, each held for ``hold`` samples."""
    values = np.random.default_rng(seed).standard_normal(-(-n_samples // hold))
    return np.repeat(values, hold)[:n_samples]


def broad(n_samples, seed=0):
    """Random levels with holds from one sample to a tenth of the record."""
    rng = np.random.default_rng(seed)
    u = np.zeros(n_samples)
    hold = 1
    while hold < n_samples // 10:
        u += np.repeat(rng.standard_normal(-(-n_samples // hold)), hold)[:n_samples]
        hold *= 8
    return u


def worst(estimate, truth):
    """Largest relative error of a coefficient."""
    return float(np.max(np.abs(estimate.theta / truth - 1.0)))


def pair(real, imaginary):
    return [complex(real, imaginary), complex(real, -imaginary)]


# ------------------------------------------------------------------- noise-free: orders 1 to 6
POLES = {
    1: [-3.0],
    2: pair(-0.5, 1.658),
    3: [-1.0, *pair(-2.0, 5.0)],
    4: [-1.0, -3.0, *pair(-2.0, 5.0)],
    5: [-1.0, *pair(-0.7, 9.0), *pair(-2.0, 5.0)],
    6: [-1.0, -3.0, *pair(-0.7, 9.0), *pair(-2.0, 5.0)],
}
ZEROS = {
    0: [],
    1: [-2.0],
    2: pair(-1.0, 3.0),
    3: [6.0, *pair(-1.0, 3.0)],
    4: [-2.0, 6.0, *pair(-1.0, 3.0)],
    5: [-2.0, 6.0, -7.0, *pair(-1.0, 3.0)],
    6: [-2.0, 6.0, -7.0, -9.0, *pair(-1.0, 3.0)],
}


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize(("n", "m"), [(n, m) for n in POLES for m in range(n + 1)])
@pytest.mark.fast("*-zoh", "6-*-foh")
def test_noise_free_record_gives_the_coefficients_back(n, m, intersample):
    u = binary(1000, 4) if intersample == "zoh" else levels(1000, 3)
    y = respond(POLES[n], ZEROS[m], 5.0, u, 0.05, intersample)
    estimate = identify(Record(u, y, dt=0.05, intersample=intersample), Structure(n, m))
    assert worst(estimate, coefficients(POLES[n], ZEROS[m], 5.0)) < EXACT
    assert estimate.status.ok


STIFF = {
    "two real": ([-0.01, -100.0], [], 3.0),
    "two real, zero between": ([-0.01, -100.0], [-1.0], 3.0),
    "biproper": ([-0.01, -100.0], [-0.3, -20.0], 3.0),
    "three decades": ([-0.01, -1.0, -100.0], [-0.1], 3.0),
    "fast pair": ([-0.01, *pair(-60.0, 80.0)], [-0.1], 3.0),
    "slow pair": ([*pair(-0.006, 0.008), -100.0], [-0.1], 3.0),
    "four": ([-0.01, -0.3, -9.0, -100.0], [-0.1, -2.0], 3.0),
}


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("case", STIFF)
@pytest.mark.fast("three decades-zoh", "slow pair-foh", "biproper-foh")
def test_stiff_systems_with_poles_ten_thousand_apart(case, intersample):
    poles, zeros, gain = STIFF[case]
    dt = 0.02
    u = broad(20_000)
    y = respond(poles, zeros, gain, u, dt, intersample)
    record = Record(u, y, dt=dt, intersample=intersample)
    estimate = identify(record, Structure(len(poles), len(zeros)))
    assert worst(estimate, coefficients(poles, zeros, gain)) < EXACT


RESONANT = {
    "one pair": (pair(-0.02, 2.0), [], 4.0),
    "one pair, zero": (pair(-0.02, 2.0), [-3.0], 4.0),
    "one pair, biproper": (pair(-0.02, 2.0), pair(-0.05, 3.0), 4.0),
    "pair and lag": ([-0.5, *pair(-0.02, 2.0)], [1.0], 4.0),
    "two pairs": ([*pair(-0.02, 2.0), *pair(-0.09, 9.0)], pair(-0.05, 5.0), 4.0),
    "three pairs": (
        [*pair(-0.02, 2.0), *pair(-0.05, 5.0), *pair(-0.09, 9.0)],
        [*pair(-0.03, 3.0), *pair(-0.07, 7.0)],
        4.0,
    ),
}


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("case", RESONANT)
@pytest.mark.fast("*-zoh", "three pairs-foh")
def test_resonant_systems_of_damping_one_hundredth(case, intersample):
    poles, zeros, gain = RESONANT[case]
    u = levels(2000, 2)
    y = respond(poles, zeros, gain, u, 0.1, intersample)
    record = Record(u, y, dt=0.1, intersample=intersample)
    estimate = identify(record, Structure(len(poles), len(zeros)))
    assert worst(estimate, coefficients(poles, zeros, gain)) < EXACT


def test_stiff_and_resonant_at_once():
    poles, zeros, gain = [-0.01, *pair(-1.0, 100.0)], [-0.3], 2.0
    u = broad(25_000)
    record = Record(u, respond(poles, zeros, gain, u, 0.015), dt=0.015)
    assert worst(identify(record, Structure(3, 1)), coefficients(poles, zeros, gain)) < EXACT


@pytest.mark.parametrize("seconds", [1e-6, 1.0, YEAR], ids=["microseconds", "seconds", "years"])
@pytest.mark.parametrize("n", [2, 4, 6])
def test_unit_of_time_does_not_matter(n, seconds):
    poles, zeros = np.array(POLES[n]) / seconds, np.array(ZEROS[n // 2]) / seconds
    gain = 5.0 / seconds ** (n - n // 2)
    u = levels(1000, 3)
    dt = 0.05 * seconds
    record = Record(u, respond(poles, zeros, gain, u, dt), dt=dt)
    assert worst(identify(record, Structure(n, n // 2)), coefficients(poles, zeros, gain)) < EXACT


@pytest.mark.parametrize("u_scale", [1e-9, 1e6])
@pytest.mark.parametrize("y_scale", [1e-9, 1e6])
def test_units_of_input_and_output_do_not_matter(u_scale, y_scale):
    u = levels(1000, 3)
    y = respond(POLES[4], ZEROS[2], 5.0, u, 0.05)
    truth = coefficients(POLES[4], ZEROS[2], 5.0 * y_scale / u_scale)
    estimate = identify(Record(u_scale * u, y_scale * y, dt=0.05), Structure(4, 2))
    assert worst(estimate, truth) < EXACT


@pytest.mark.parametrize("n_samples", [20, 100, 250])
@pytest.mark.parametrize("m", [0, 1])
def test_step_from_rest_of_second_order(n_samples, m):
    u = np.ones(n_samples)
    poles, dt = np.roots([1.0, 1.0, 3.0]), 5.0 / n_samples
    record = Record(u, respond(poles, ZEROS[m], 0.5, u, dt), dt=dt)
    assert worst(identify(record, Structure(2, m)), coefficients(poles, ZEROS[m], 0.5)) < EXACT


@pytest.mark.parametrize(
    "poles",
    [
        pytest.param([0.0, -2.0], id="integrator"),
        pytest.param([0.3, -2.0], id="unstable"),
        pytest.param([0.0, *pair(-1.0, 3.0)], id="integrator and pair", marks=pytest.mark.slow),
        pytest.param(pair(0.1, 3.0), id="unstable pair", marks=pytest.mark.slow),
    ],
)
@pytest.mark.fast("integrator")
@pytest.mark.unjudged
def test_unstable_and_integrating_systems_are_right_or_refused(poles):
    """Outside the promise, but never a wrong answer called converged."""
    u = levels(400, 4)
    y = respond(poles, [], 2.0, u, 0.03)
    try:
        estimate = identify(Record(u, y, dt=0.03), Structure(len(poles), 0), throw=False)
    except IdentifiabilityError:
        return
    truth = coefficients(poles, [], 2.0)
    wrong = np.max(np.abs(estimate.theta - truth)) > EXACT * np.max(np.abs(truth))
    assert not (wrong and estimate.status is Status.CONVERGED)


# ------------------------------------------------------------------- noise-free: nuisance terms
def disturbed(poles, zeros, gain, *, offset=0.0, drift=0.0, trim=0.0, state=0.0, n=600, seed=0):
    """A record of 30 s with what is asked for added, and the true coefficients."""
    dt = 0.05
    u = levels(n, 5, seed)
    u[:4] = 0.0
    y = respond(poles, zeros, gain, u, dt) + offset + drift * np.arange(n) * dt
    if state:
        rng = np.random.default_rng(seed + 100)
        weights = np.full(len(poles), state * (1.0 + rng.random()) * np.std(y))
        y = y + relaxing(poles, weights, n, dt)
    return Record(u + trim, y, dt=dt), coefficients(poles, zeros, gain)


NUISANCES = {
    "offset": ({"offset": 7.0}, {"offset": True, "initial_state": "rest"}),
    "drift": ({"drift": 0.3}, {"offset": False, "drift": True, "initial_state": "rest"}),
    "state": ({"state": 1.0}, {"offset": False, "initial_state": "free"}),
    "offset and state": (
        {"offset": -4.0, "state": 1.0},
        {"offset": True, "initial_state": "free"},
    ),
    "everything": (
        {"offset": -4.0, "drift": 0.2, "state": 1.0, "trim": 0.7},
        {"offset": True, "drift": True, "initial_state": "free"},
    ),
    "trim": ({"offset": 2.0, "trim": -1.5}, {"offset": True, "initial_state": "equilibrium"}),
}


@pytest.mark.parametrize("case", NUISANCES)
@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 1), (3, 2), (4, 1), (6, 3)])
@pytest.mark.fast("2-1-*", "6-3-everything")
def test_nuisance_terms_known_to_be_there_leave_the_coefficients_exact(n, m, case):
    disturbances, options = NUISANCES[case]
    record, truth = disturbed(POLES[n], ZEROS[m], 5.0, **disturbances)
    estimate = identify(record, Structure(n, m, **options))
    assert worst(estimate, truth) < EXACT
    assert np.max(np.abs(estimate.residual(record))) < EXACT * np.ptp(record.y)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_offset_and_drift_themselves_are_exact(n):
    record, _ = disturbed(POLES[n], [], 5.0, offset=3.0, drift=-0.4, state=1.0)
    options = {"offset": True, "drift": True, "initial_state": "free"}
    found = identify(record, Structure(n, 0, **options)).nuisance[0]
    assert found.offset[0] == pytest.approx(3.0, rel=1e-8)
    assert found.drift[0] == pytest.approx(-0.4, rel=1e-8)
    assert found.initial_state == "free"


@pytest.mark.parametrize("n", [1, 2, 4])
def test_nothing_is_added_to_a_record_at_rest_without_offset(n):
    u = levels(600, 5)
    record = Record(u, respond(POLES[n], [], 5.0, u, 0.05), dt=0.05)
    estimate = identify(record, Structure(n, 0, offset="auto", drift="auto"))
    assert estimate.structure.initial_state == "rest"
    assert estimate.structure.offset is False
    assert estimate.structure.drift is False
    assert worst(estimate, coefficients(POLES[n], [], 5.0)) < 1e-10
    assert not np.any(estimate.nuisance[0].free_response)


def said(estimate, *words):
    text = " ".join(estimate.trace.decisions).lower()
    # The differences to the others are told; one below zero would belie the decision.
    assert "+-" not in text
    return all(word in text for word in words)


@pytest.mark.parametrize(
    "disturbances",
    [
        {"offset": 2.0, "trim": -1.5},
        {"state": 1.0},
        {"state": 1.0, "offset": 2.0, "trim": 0.4},
        {"offset": 2.0},
    ],
    ids=["trim", "free state", "free state and trim", "output offset"],
)
@pytest.mark.parametrize("n", [1, 2, 4])
def test_what_is_needed_is_added_by_itself_and_said(n, disturbances):
    record, truth = disturbed(POLES[n], ZEROS[n // 2], 5.0, **disturbances)
    estimate = identify(record, Structure(n, n // 2))
    assert worst(estimate, truth) < EXACT
    assert isinstance(estimate.structure.offset, bool)
    assert estimate.structure.initial_state in {"rest", "equilibrium", "free"}
    assert said(estimate, "offset")
    assert said(estimate, "aicc")
    if "state" in disturbances:
        assert estimate.structure.initial_state == "free"
        assert said(estimate, "free")
    if disturbances == {"offset": 2.0, "trim": -1.5}:
        assert estimate.structure.initial_state == "equilibrium" or estimate.structure.offset


def test_drift_is_found_by_itself():
    record, truth = disturbed(POLES[2], [], 5.0, drift=0.3, offset=1.0)
    estimate = identify(record, Structure(2, 0, drift="auto"))
    assert estimate.structure.drift is True
    assert worst(estimate, truth) < EXACT
    assert said(estimate, "drift")


def test_a_noisy_record_with_a_free_state_is_not_biased():
    rng = np.random.default_rng(3)
    record, truth = disturbed(POLES[2], [], 5.0, state=2.0, offset=1.0)
    y = record.y[:, 0] + 0.05 * np.std(record.y) * rng.standard_normal(record.n_samples)
    estimate = identify(Record(record.u, y, dt=record.dt), Structure(2, 0))
    assert estimate.structure.initial_state == "free"
    assert np.all(np.abs(estimate.theta - truth) < 4.5 * estimate.std)


@pytest.mark.parametrize(
    "draws", [range(12), pytest.param(range(12, 60), marks=pytest.mark.slow)], ids=["few", "more"]
)
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("n", range(1, 7))
@pytest.mark.fast("*-0.05-few")
def test_nuisance_terms_belong_to_the_fit_whose_cost_is_reported(n, noise, draws):
    """A large trim of the input: what `predict` gives must be what was fitted."""
    for seed in draws[n - 1 :: 6]:
        record, _ = disturbed(
            POLES[n], ZEROS[n // 2], 5.0, offset=-4.0, state=1.0, trim=50.0, seed=seed
        )
        added = noise * np.std(record.y) * np.random.default_rng(seed).standard_normal(600)
        record = Record(record.u, record.y[:, 0] + added, dt=record.dt)
        structure = Structure(n, n // 2, offset=True, initial_state="free")
        estimate = identify(record, structure)
        found = np.mean(estimate.residual(record) ** 2)
        fitted = estimate.noise_variance[0] * estimate.degrees_of_freedom / 600
        assert found <= 1.001 * fitted + 1e-20 * np.var(record.y) + 1e-24, seed


# ----------------------------------------------------------- several channels, several records
Q_ALPHA = {"input_names": ["elevator"], "output_names": ["q", "alpha"]}


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_elevator_to_pitch_rate_and_angle_of_attack(intersample):
    poles, dt = np.roots([1.0, 1.892, 8.898]), 0.02
    u = binary(1000, 25)
    q = respond(poles, [-0.928], -8.825, u, dt, intersample)
    alpha = respond(poles, [-162.0], -0.0548, u, dt, intersample)
    record = Record(u, np.stack([q, alpha], 1), dt=dt, intersample=intersample, **Q_ALPHA)
    estimate = identify(record, Structure(2, 1))
    truth = [1.892, 8.898, -8.825, -8.825 * 0.928, -0.0548, -0.0548 * 162.0]
    assert worst(estimate, np.array(truth)) < EXACT
    assert estimate.names[2:] == (
        "b1[q,elevator]",
        "b0[q,elevator]",
        "b1[alpha,elevator]",
        "b0[alpha,elevator]",
    )


@pytest.mark.parametrize("n", [1, 2, 4])
def test_two_inputs_two_outputs_one_denominator(n):
    dt = 0.05
    u = np.stack([binary(1500, 4, 1), levels(1500, 3, 2)], axis=1)
    numbers = [[0, 1], [1, 0]]
    y, truth = np.zeros((1500, 2)), [polynomial(POLES[n])[1:]]
    for i in range(2):
        for j in range(2):
            gain = 1.0 + i + 2.0 * j
            y[:, i] += respond(POLES[n], ZEROS[numbers[i][j]], gain, u[:, j], dt)
            truth.append(gain * polynomial(ZEROS[numbers[i][j]]))
    estimate = identify(Record(u, y, dt=dt), Structure(n, numbers))
    assert worst(estimate, np.concatenate(truth)) < EXACT


def test_outputs_of_very_different_size():
    u = levels(800, 3)
    y = np.stack([respond(POLES[3], z, g, u, 0.05) for z, g in ([[], 1e-6], [[-2.0], 1e5])], 1)
    estimate = identify(Record(u, y, dt=0.05), Structure(3, [[0], [1]]))
    truth = np.concatenate([polynomial(POLES[3])[1:], [1e-6], 1e5 * polynomial([-2.0])])
    assert worst(estimate, truth) < EXACT


def test_two_experiments_of_different_offset_length_and_sampling():
    poles, zeros, gain = POLES[3], ZEROS[1], 5.0
    records = []
    for seed, (n, dt, offset) in enumerate([(400, 0.05, 3.0), (700, 0.02, -20.0)]):
        u = levels(n, 4, seed)
        u[0] = 0.0  # the reference of the input, so that the offset is the one added here
        y = respond(poles, zeros, gain, u, dt) + offset
        y = y + relaxing(poles, [1.0 + seed, 0.5, 0.5], n, dt)
        records.append(Record(u, y, dt=dt))
    structure = Structure(3, 1, offset=True, initial_state="free")
    estimate = identify(records, structure)
    assert worst(estimate, coefficients(poles, zeros, gain)) < EXACT
    assert [term.offset[0] for term in estimate.nuisance] == pytest.approx([3.0, -20.0], rel=1e-8)
    assert estimate.n_samples == 1100
    for k, record in enumerate(records):
        assert np.max(np.abs(estimate.residual(record, experiment=k))) < 1e-9


def test_missing_output_samples_do_not_matter():
    u = levels(600, 4)
    y = respond(POLES[3], ZEROS[1], 5.0, u, 0.05)
    y[[3, 77, 78, 79, 500]] = np.nan
    y[200:260] = np.nan
    estimate = identify(Record(u, y, dt=0.05), Structure(3, 1))
    assert worst(estimate, coefficients(POLES[3], ZEROS[1], 5.0)) < EXACT


# ----------------------------------------------------------------- simulate against other routes
def by_expm(num, den, u, dt, intersample):
    """Companion form, one matrix exponential of the system with its input and its slope."""
    num = np.pad(np.atleast_1d(num).astype(float), (len(den) - len(num), 0))
    n = len(den) - 1
    block = np.zeros((n + 2, n + 2))
    block[0, :n] = -np.asarray(den[1:])
    block[1:n, : n - 1] = np.eye(n - 1)
    block[0, n], block[n, n + 1] = 1.0, 1.0
    step = expm(block * dt)
    slope = np.append(np.diff(u) / dt, 0.0) if intersample == "foh" else np.zeros(u.size)
    x, y = np.zeros(n), np.empty(u.size)
    row = num[1:] - num[0] * np.asarray(den[1:])
    for k in range(u.size):
        y[k] = row @ x + num[0] * u[k]
        x = step[:n, :n] @ x + step[:n, n] * u[k] + step[:n, n + 1] * slope[k]
    return y


SYSTEMS = {
    "stable": ([2.0, 1.0], [1.0, 1.0, 3.0]),
    "unstable": ([2.0, 1.0], [1.0, -0.3, 2.0]),
    "integrating": ([1.5], [1.0, 2.0, 0.0]),
    "double integrator": ([1.5], [1.0, 0.0, 0.0]),
    "biproper": ([2.0, 1.0, -4.0], [1.0, 1.0, 3.0]),
    "gain 0th order zero": ([0.7, 0.1], [1.0, 2.0]),
    "repeated poles": ([1.0], [1.0, 3.0, 3.0, 1.0]),
    "third order": ([1.0, 2.0], [1.0, 4.0, 30.0, 25.0]),
}


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("case", SYSTEMS)
def test_simulate_equals_the_matrix_exponential(case, intersample):
    num, den = SYSTEMS[case]
    u = levels(200, 1)
    record = Record(u, u, dt=0.07, intersample=intersample)
    expected = by_expm(num, den, u, 0.07, intersample)
    found = simulate(TransferFunction(num, den), record)[:, 0]
    assert np.max(np.abs(found - expected)) < 1e-11 * np.max(np.abs(expected))


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("case", ["stable", "unstable", "biproper", "third order"])
def test_simulate_equals_numerical_integration(case, intersample):
    num, den = SYSTEMS[case]
    n, dt, count = len(den) - 1, 0.2, 25
    u = levels(count, 1, 5)
    padded = np.pad(np.asarray(num), (n + 1 - len(num), 0))
    row, direct = padded[1:] - padded[0] * np.asarray(den[1:]), padded[0]

    def rate(t, x, begin, slope, start):
        drive = begin + slope * (t - start) - np.dot(den[1:], x)
        return np.concatenate([[drive], x[:-1]])

    x, expected = np.zeros(n), [direct * u[0]]
    for k in range(count - 1):
        slope = (u[k + 1] - u[k]) / dt if intersample == "foh" else 0.0
        span = (k * dt, (k + 1) * dt)
        arguments = (u[k], slope, span[0])
        x = solve_ivp(rate, span, x, "DOP853", args=arguments, rtol=1e-11, atol=1e-13).y[:, -1]
        expected.append(row @ x + direct * u[k + 1])
    record = Record(u, u, dt=dt, intersample=intersample)
    found = simulate(TransferFunction(num, den), record)[:, 0]
    assert np.allclose(found, expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_simulate_several_channels(intersample):
    dens = [[[1.0, 1.0, 3.0], [1.0, 2.0]], [[1.0, 0.2, 9.0], [1.0, 0.0]]]
    nums = [[[1.0], [2.0, 1.0]], [[1.0, 0.0, 4.0], [-3.0]]]
    u = np.stack([levels(300, 2, 1), binary(300, 3, 2)], axis=1)
    record = Record(u, u, dt=0.04, intersample=intersample)
    expected = np.stack(
        [
            sum(by_expm(nums[i][j], dens[i][j], u[:, j], 0.04, intersample) for j in range(2))
            for i in range(2)
        ],
        axis=1,
    )
    assert np.allclose(simulate(TransferFunction(nums, dens), record), expected, atol=1e-11)


def test_simulate_free_response_is_the_inverse_transform():
    # (2 s + 1) / ((s + 1)(s + 3)) = -0.5 / (s + 1) + 2.5 / (s + 3)
    record = Record(np.zeros(50), np.zeros(50), dt=0.1)
    model = TransferFunction([1.0], [1.0, 4.0, 3.0])
    found = simulate(model, record, free_response=np.array([[2.0, 1.0]]))[:, 0]
    expected = -0.5 * np.exp(-record.t) + 2.5 * np.exp(-3.0 * record.t)
    assert np.allclose(found, expected, rtol=0, atol=1e-13)


def test_simulate_stiff_over_a_long_record():
    poles, zeros = [-0.01, -100.0], [-1.0]
    u = broad(20_000)
    model = TransferFunction(3.0 * polynomial(zeros), polynomial(poles))
    for intersample in ("zoh", "foh"):
        expected = respond(poles, zeros, 3.0, u, 0.02, intersample)
        found = simulate(model, Record(u, u, dt=0.02, intersample=intersample))[:, 0]
        assert np.max(np.abs(found - expected)) < 1e-11 * np.max(np.abs(expected))


# ----------------------------------------------------- with noise: the least-squares estimate
def doublet(n_samples, dt):
    t = np.arange(n_samples) * dt
    return np.where(t < 1.0, 0.0, np.where(t < 2.0, 1.0, np.where(t < 3.0, -1.0, 0.0)))


def three_two_one_one(n_samples, dt):
    t = np.arange(n_samples) * dt - 1.0
    edges = [0.0, 1.5, 2.5, 3.0, 3.5]
    u = np.zeros(n_samples)
    for begin, end, sign in zip(edges[:-1], edges[1:], (1.0, -1.0, 1.0, -1.0), strict=True):
        u[(t >= begin - 1e-9) & (t < end - 1e-9)] = sign
    return u


INPUTS = {
    "prbs": lambda n, dt: binary(n, 7, 11),
    "doublet": doublet,
    "3-2-1-1": three_two_one_one,
}
PLANTS = {
    "second": (np.roots([1.0, 1.0, 3.0]), [-4.0], 0.5, 0.05, 300),
    "fourth": (
        np.roots([1.0, 5.0, 408.0, 416.0, 1600.0]),
        [0.25],
        -6400.0,
        0.01,
        1500,
    ),
}


class OutputError:
    """The sum of squared output errors of one record, written once more, modes by modes."""

    def __init__(self, record, n, *, offset=False, free=False):
        self.u, self.y, self.dt = record.u[:, 0], record.y[:, 0], record.dt
        self.n, self.offset, self.free = n, offset, free
        self.intersample = record.intersample

    def nuisance(self, theta):
        t = np.arange(self.y.size) * self.dt
        columns = [np.ones(t.size)] if self.offset else []
        if self.free:
            for pole in np.roots(np.append(1.0, theta[: self.n])):
                if pole.imag >= 0:
                    columns.append((np.exp(pole * t)).real)
                if pole.imag > 0:
                    columns.append((np.exp(pole * t)).imag)
        return np.stack(columns, axis=1) if columns else np.zeros((t.size, 0))

    def output(self, theta):
        den, num = np.append(1.0, theta[: self.n]), theta[self.n :]
        y = num[0] * self.u if num.size == den.size else np.zeros(self.u.size)
        for pole in np.roots(den):
            residue = np.polyval(num, pole) / np.polyval(np.polyder(den), pole)
            y = y + (residue * mode(pole, self.u, self.dt, self.intersample)).real
        return y

    def residual(self, theta):
        error = self.y - self.output(theta)
        columns = self.nuisance(theta)
        if columns.shape[1] == 0:
            return error
        basis = np.linalg.qr(columns)[0]
        return error - basis @ (basis.T @ error)

    def jacobian(self, theta):
        columns = []
        for k in range(theta.size):
            step = np.zeros(theta.size)
            step[k] = 1e-5 * abs(theta[k])
            difference = self.residual(theta + step) - self.residual(theta - step)
            columns.append(difference / (2.0 * step[k]))
        return np.stack(columns, axis=1)


def noisy(plant, signal, snr, seed, *, offset=0.0):
    poles, zeros, gain, dt, n_samples = PLANTS[plant]
    u = INPUTS[signal](n_samples, dt)
    clean = respond(poles, zeros, gain, u, dt)
    sigma = np.std(clean) * 10 ** (-snr / 20)
    noise = sigma * np.random.default_rng(seed).standard_normal(n_samples)
    return Record(u, clean + noise + offset, dt=dt), coefficients(poles, zeros, gain)


AT_REST = {"offset": False, "initial_state": "rest"}
FREE = {"offset": True, "initial_state": "free"}


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("snr", [20, 10])
@pytest.mark.parametrize("signal", INPUTS)
@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.fast("*-10-0", "*-20-1")
def test_the_estimate_is_the_lowest_output_error(plant, signal, snr, seed):
    record, truth = noisy(plant, signal, snr, seed)
    estimate = identify(record, Structure(len(PLANTS[plant][0]), 1, **AT_REST))
    own = OutputError(record, len(PLANTS[plant][0]))
    at_estimate = own.residual(estimate.theta)
    scores = own.jacobian(estimate.theta)
    along = np.abs(scores.T @ at_estimate) / np.linalg.norm(scores, axis=0)
    assert np.max(along) < 1e-4 * np.linalg.norm(at_estimate)
    assert estimate.gradient < 1e-4

    rival = least_squares(
        lambda x: own.residual(x * truth), np.ones(truth.size), xtol=1e-12, ftol=1e-12
    )
    assert at_estimate @ at_estimate <= 2.0 * rival.cost * (1 + 1e-6)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 0), (2, 1)])
def test_a_model_of_too_low_order_still_ends_on_the_lowest_output_error(n, m, seed):
    """Every real record: the structure is never all of the truth."""
    rng = np.random.default_rng(seed)
    omega, damping = np.exp(rng.uniform(0.3, 2.0)), rng.uniform(0.15, 0.9)
    poles = [-1.3 * omega, *pair(-damping * omega, omega * np.sqrt(1.0 - damping**2))]
    u = levels(400, 4, seed)
    y = respond(poles, [-2.0 * omega], 3.0, u, 0.05)
    y = y + 0.2 * np.std(y) * rng.standard_normal(400)
    record = Record(u, y, dt=0.05)
    method = ThreeModel(noise="white", finish="likelihood")
    estimate = identify(record, Structure(n, m, **AT_REST), method, throw=False)
    own = OutputError(record, n)
    at_estimate = own.residual(estimate.theta)
    rival = least_squares(
        lambda x: own.residual(x * estimate.theta),
        np.ones(estimate.theta.size),
        xtol=1e-12,
        ftol=1e-12,
    )
    assert at_estimate @ at_estimate <= 2.0 * rival.cost * (1 + 1e-6)
    assert estimate.status.ok, (estimate.status, estimate.gradient, estimate.trace.stopped)


@pytest.mark.parametrize("options", [AT_REST, FREE], ids=["rest", "free state, offset"])
@pytest.mark.parametrize(("plant", "signal"), [("second", "3-2-1-1"), ("fourth", "prbs")])
def test_covariance_is_that_of_the_linearised_problem(plant, signal, options):
    record, _ = noisy(plant, signal, 20, 4, offset=0.3 if options["offset"] else 0.0)
    n = len(PLANTS[plant][0])
    estimate = identify(record, Structure(n, 1, **options))
    own = OutputError(record, n, offset=options["offset"], free=options is FREE)
    residual = own.residual(estimate.theta)
    scores = own.jacobian(estimate.theta)
    unknowns = estimate.theta.size + (n + 1 if options is FREE else 0)
    assert estimate.degrees_of_freedom == record.n_samples - unknowns
    variance = residual @ residual / estimate.degrees_of_freedom
    assert estimate.noise_variance[0] == pytest.approx(variance, rel=1e-6)
    # The projected scores give the block of the coefficients, whatever is estimated along.
    expected = variance * np.linalg.inv(scores.T @ scores)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.max(np.abs(estimate.cov - expected) / scale) < 1e-3
    assert np.array_equal(estimate.std, np.sqrt(np.diag(estimate.cov)))
