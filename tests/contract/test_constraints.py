"""What every method owes that promises to honour knowledge of the coefficients.

A row of `METHODS` that raises `Capability.CONSTRAINTS` is tested here; the others must refuse.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lsim

from oracles import by_exponential
from tridentify import (
    METHODS,
    Estimate,
    Record,
    Status,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify import errors as err
from tridentify.estimation.methods.capability import Capability
from tridentify.numerics.autoregression import whiten

pytestmark = pytest.mark.unjudged

ABLE = [key for key, make in METHODS.items() if Capability.CONSTRAINTS in make().capabilities]
UNABLE = [key for key in METHODS if key not in ABLE]
REST = {"offset": False, "initial_state": "rest"}
DT = 0.05

every_able = pytest.mark.parametrize("key", ABLE)


def respond(num, den, u, dt=DT):
    return by_exponential(num, den, u, dt)


def binary(n_samples=300, hold=5, seed=3):
    signs = np.sign(np.random.default_rng(seed).standard_normal(-(-n_samples // hold)))
    return np.repeat(signs, hold)[:n_samples]


def record_of(num, den, noise=0.0, *, offset=0.0, dt=DT, seed=0, n_samples=300):
    u = binary(n_samples)
    clean = respond(num, den, u, dt)
    e = np.random.default_rng(seed).standard_normal(u.size)
    return Record(u, clean + offset + noise * np.std(clean) * e, dt=dt)


# ------------------------------------------------------------------- exact without noise
POLES = {
    1: ([-1.0], []),
    2: ([-0.6 + 1.4j, -0.6 - 1.4j], [-3.0]),
    3: ([-0.6 + 1.4j, -0.6 - 1.4j, -2.5], [-3.0]),
    4: ([-0.6 + 1.4j, -0.6 - 1.4j, -0.4 + 3j, -0.4 - 3j], [-0.5 + 2j, -0.5 - 2j]),
}


def system(n, rate):
    poles, zeros = POLES[n]
    den = np.poly(np.array(poles) * rate).real
    num = 1.7 * rate ** (n - len(zeros)) * np.atleast_1d(np.poly(np.array(zeros) * rate)).real
    return num, den


def knowledge(truth):
    n = sum(name.startswith("a") for name in truth)
    top = f"a{n - 1}"
    gain = truth["b0"] / truth["a0"]
    return {
        "fixed": {"fixed": {"a0": truth["a0"]}},
        "equality": {"equalities": [({"b0": 1 / truth["b0"], top: 1 / truth[top]}, 2.0)]},
        "static gain": {"static_gain": gain},
        "bounds": {"bounds": {name: (0.3 * v, 3.0 * v) for name, v in truth.items()}},
        "active bound": {"bounds": {"b0": (truth["b0"], None)}, "static_gain": gain},
        "prior": {"priors": {"a0": (truth["a0"], 0.1 * truth["a0"])}},
        "several": {"fixed": {"b0": truth["b0"]}, "priors": {top: (truth[top], truth[top])}},
    }


@every_able
@pytest.mark.parametrize("dt", [pytest.param(1e-6, marks=pytest.mark.slow), 1.0, 1e6])
@pytest.mark.parametrize("n", [1, 2, *(pytest.param(n, marks=pytest.mark.slow) for n in (3, 4))])
@pytest.mark.fast("1-1000000.0-three-model", "1-1.0-output-error")
def test_without_noise_the_truth_comes_back(key, n, dt):
    num, den = system(n, 0.1 / dt)
    record = record_of(num, den, offset=0.7, dt=dt)
    structure = Structure(n, len(num) - 1)
    truth = dict(zip(structure.names(), [*den[1:], *num], strict=True))
    for label, known in knowledge(truth).items():
        found = identify(record, Structure(n, len(num) - 1, **known), METHODS[key]())
        assert np.allclose(found.theta, list(truth.values()), rtol=1e-9, atol=0.0), label


# ------------------------------------------------- with noise: the optimum of another solver
OTHERS = {
    "fixed": ({"fixed": {"a0": 3.2}}, [lambda t: t[1] - 3.2], None, None),
    "equality": ({"equalities": [({"b1": 1, "a1": -0.3}, 0)]}, [lambda t: t[2] - 0.3 * t[0]], 0, 0),
    "static gain": ({"static_gain": 0.2}, [lambda t: t[3] - 0.2 * t[1]], None, None),
    "bounds": (
        {"bounds": {"b1": (0.3, None), "a0": (None, 2.8)}},
        [],
        [(None, None), (None, 2.8), (0.3, None), (None, None)],
        None,
    ),
    "priors": (
        {"priors": {"a1": (1.3, 0.05), "b0": (0.4, 0.02)}},
        [],
        None,
        lambda t: ((t[0] - 1.3) / 0.05) ** 2 + ((t[3] - 0.4) / 0.02) ** 2,
    ),
    "all at once": (
        {"priors": {"a1": (1.3, 0.05)}, "static_gain": 0.2, "bounds": {"b1": (0.3, None)}},
        [lambda t: t[3] - 0.2 * t[1]],
        [(None, None), (None, None), (0.3, None), (None, None)],
        lambda t: ((t[0] - 1.3) / 0.05) ** 2,
    ),
}


@every_able
@pytest.mark.parametrize("case", OTHERS)
@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.filterwarnings("ignore:invalid")
@pytest.mark.fast("all at once-*")
def test_with_noise_it_is_the_optimum_of_a_general_solver(key, case):
    known, equalities, bounds, prior = OTHERS[case]
    record = record_of([0.2, 0.5], [1.0, 1.0, 3.0], 0.1)

    def cost(t):
        r = record.y[:, 0] - respond(t[2:], [1.0, *t[:2]], record.u[:, 0])
        return r.size * np.log(r @ r / r.size) + (prior(t) if prior else 0.0)

    found = identify(record, Structure(2, 1, **known, **REST), METHODS[key]())
    expected = minimize(
        cost,
        [1.0, 3.0, 0.2, 0.5],
        method="SLSQP",
        bounds=bounds or None,
        constraints=[{"type": "eq", "fun": one} for one in equalities],
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert cost(found.theta) <= expected.fun + 1e-6
    assert np.allclose(found.theta, expected.x, rtol=2e-4)
    for one in equalities:
        assert abs(one(found.theta)) < 1e-12
    assert found.status is Status.CONVERGED


# ------------------------------------------------------------------------ what is said of it
@pytest.mark.judged
@every_able
def test_what_is_fixed_has_no_variance_and_no_unknown(key):
    record = record_of([0.2, 0.5], [1.0, 1.0, 3.0], 0.1)
    found = identify(record, Structure(2, 1, fixed={"a0": 3.1}, **REST), METHODS[key]())
    free = identify(record, Structure(2, 1, **REST), METHODS[key]())
    assert found.parameters["a0"].value == 3.1
    assert found.parameters["a0"].std == 0.0
    assert not found.cov[1].any()
    assert found.degrees_of_freedom == free.degrees_of_freedom + 1
    # AICc counts one unknown less: 2 (k + 1) - 2 k with k + 1 = 5 unknowns of 300 samples
    likelihood = 300 * np.log(found.cost / free.cost)
    count = 2.0 + 2 * (5 * 6 / 294 - 4 * 5 / 295)
    assert found.aicc - free.aicc == pytest.approx(likelihood - count, abs=1e-6)
    assert any("determined beforehand: a0" in line for line in found.trace.decisions)
    assert "a0" in found.summary()


@every_able
def test_covariance_is_the_constrained_one(key):
    """N (N' I N)^-1 N' from the free one, where the constraint holds at the free optimum."""
    record = record_of([0.2, 0.5], [1.0, 1.0, 3.0], 0.1)
    free = identify(record, Structure(2, 1, **REST), METHODS[key]())
    a1, a0, _, b0 = free.theta
    known = {"static_gain": b0 / a0, "priors": {"a1": (a1, 0.02)}}
    found = identify(record, Structure(2, 1, **known, **REST), METHODS[key]())
    n = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, b0 / a0, 0]], float)
    # one degree of freedom more leaves a smaller noise variance
    information = np.linalg.inv(free.cov) * free.noise_variance / found.noise_variance
    information[0, 0] += 1 / 0.02**2
    expected = n @ np.linalg.inv(n.T @ information @ n) @ n.T
    assert np.allclose(found.theta, free.theta, rtol=1e-4)
    assert np.allclose(found.cov, expected, rtol=2e-3, atol=1e-5 * np.abs(expected).max())


@every_able
def test_bounds_that_are_not_active_change_nothing(key):
    record = record_of([0.2, 0.5], [1.0, 1.0, 3.0], 0.1, offset=0.4)
    free = identify(record, Structure(2, 1), METHODS[key]())
    wide = {
        name: (v - 9 * abs(v), v + 9 * abs(v))
        for name, v in zip(free.names, free.theta, strict=True)
    }
    found = identify(record, Structure(2, 1, bounds=wide), METHODS[key]())
    assert np.allclose(found.theta, free.theta, rtol=1e-9, atol=0.0)
    assert np.allclose(found.cov, free.cov, rtol=1e-9, atol=0.0)
    assert dict(found.structure.bounds) == wide
    assert any("none active" in line for line in found.trace.decisions)


@pytest.mark.slow
@pytest.mark.judged
@every_able
def test_an_active_bound_is_held_and_said(key):
    record = record_of([0.2, 0.5], [1.0, 1.0, 3.0], 0.1)
    found = identify(record, Structure(2, 1, bounds={"a1": (2.0, None)}, **REST), METHODS[key]())
    assert found.parameters["a1"].value == 2.0
    assert found.parameters["a1"].std == 0.0
    assert any("Held by a bound: a1 = 2" in line for line in found.cautions)
    line = next(line for line in found.trace.decisions if "active bounds" in line)
    assert "a1 = 2 (multiplier +" in line
    assert found.gradient < 1e-4


@every_able
def test_a_prior_tighter_than_the_data_comes_back(key):
    record = record_of([0.2, 0.5], [1.0, 1.0, 3.0], 0.1)
    prior = {"a0": (3.3, 1e-5)}
    found = identify(record, Structure(2, 1, priors=prior, **REST), METHODS[key]())
    assert found.parameters["a0"].value == pytest.approx(3.3, abs=3e-5)
    assert found.parameters["a0"].std == pytest.approx(1e-5, rel=1e-3)
    vague = Structure(2, 1, priors={"a0": (3.3, 1e5)}, **REST)
    free = identify(record, Structure(2, 1, **REST), METHODS[key]())
    assert np.allclose(identify(record, vague, METHODS[key]()).theta, free.theta, rtol=1e-4)


@every_able
def test_estimates_survive_a_file(key, tmp_path):
    known = {"fixed": {"a1": 1.1}, "priors": {"b1": (0.2, 0.1)}, "static_gain": 0.17}
    record = record_of([0.2, 0.5], [1.0, 1.0, 3.0], 0.1)
    found = identify(record, Structure(2, 1, **known, **REST), METHODS[key]())
    again = Estimate.load(found.save(tmp_path / "found.json"))
    assert again.structure == found.structure
    assert np.array_equal(again.cov, found.cov)


# ------------------------------------------------------------------------------ integrators
@pytest.mark.parametrize(
    "extra",
    [
        {},
        {"initial_state": "free"},
        {"initial_state": "free", "offset": True},
        {"initial_state": "equilibrium"},
        {"initial_state": "equilibrium", "drift": True},
        {"initial_state": "free", "offset": True, "drift": True},
    ],
    ids=["auto", "free", "offset", "equilibrium", "drift", "free and drift"],
)
@pytest.mark.fast("offset", "drift")
def test_prediction_and_residual_are_those_of_the_fit(extra):
    """The free response and offset reported beside an integrator reproduce the fit."""
    record = record_of([2.0], [1.0, 2.0, 0.0], 0.05, offset=0.5)
    found = identify(record, Structure(2, 0, fixed={"a0": 0.0}, **extra), throw=False)
    residual = found.residual(record)[:, 0]
    # where the noise has a model, as beside a start that is not the true one, the cost is that
    # of the whitened output error
    (noise,) = found.noise_model
    innovations = whiten(residual, noise)[0] if noise.size else residual
    assert np.mean(innovations**2) == pytest.approx(found.cost, rel=1e-6)


def ramps(u):
    """Response of 2 / (s (s + 2)) to an input in straight lines, by scipy's `lsim`."""
    return lsim(([2.0], [1.0, 2.0, 0.0]), u, DT * np.arange(u.size), interp=True)[1]


@pytest.mark.judged
@every_able
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_a_drive_with_an_integrator(key, intersample):
    """Position over force of a mass with friction, b0 / (s (s + a1)); input held or in ramps."""
    u = binary(400)
    y = ramps(u) if intersample == "foh" else respond([2.0], [1.0, 2.0, 0.0], u)
    noise = 0.02 * np.std(y) * np.random.default_rng(0).standard_normal(u.size)
    record = Record(u, y + 0.5 + noise, dt=DT, intersample=intersample)
    found = identify(record, Structure(2, 0, fixed={"a0": 0.0}), METHODS[key]())
    assert found.parameters["a0"].value == 0.0
    assert found.parameters["a0"].std == 0.0
    for name, truth in (("a1", 2.0), ("b0", 2.0)):
        parameter = found.parameters[name]
        assert abs(parameter.value - truth) < 4.0 * parameter.std < 0.4
    assert not any("not stable" in line for line in found.cautions)
    assert "inf" in found.summary()


@every_able
def test_two_integrators_alone(key):
    record = record_of([0.5], [1.0, 0.0, 0.0], 0.01, offset=2.0)
    structure = Structure(2, 0, fixed={"a0": 0.0, "a1": 0.0})
    found = identify(record, structure, METHODS[key]())
    b0 = found.parameters["b0"]
    assert abs(b0.value - 0.5) < 4.0 * b0.std < 0.01


# --------------------------------------------------------------------------- several channels
@every_able
def test_several_outputs_and_records_share_what_is_known(key):
    den, nums = [1.0, 2.4, 6.3], ([-7.0, -6.5], [-0.1, -5.0])
    records = []
    for seed, n_samples in ((3, 300), (4, 200)):
        u, rng = binary(n_samples, seed=seed), np.random.default_rng(seed)
        y = np.stack([respond(num, den, u) for num in nums], axis=1)
        y = y + 0.05 * np.std(y, axis=0) * rng.standard_normal(y.shape) + [0.5, 2.0]
        y[10:14, 0] = np.nan
        records.append(Record(u, y, dt=DT, input_names=["e"], output_names=["q", "alpha"]))
    structure = Structure(
        2, 1, fixed={"b1[q,e]": -7.0}, static_gain=[[-6.5 / 6.3], [None]], bounds={"a1": (0, 9)}
    )
    found = identify(records, structure, METHODS[key]())
    truth = np.array([2.4, 6.3, -7.0, -6.5, -0.1, -5.0])
    assert found.parameters["b1[q,e]"].value == -7.0
    assert found.parameters["b0[q,e]"].value == pytest.approx(
        -6.5 / 6.3 * found.parameters["a0"].value, rel=1e-12
    )
    assert np.all(np.abs(found.theta - truth) <= 4.0 * found.std + 1e-12)
    assert len(found.nuisance) == 2


# ------------------------------------------------------------------------------- refusals
REFUSED = {
    "contradiction": ({"fixed": {"a0": -1.0}}, err.ContradictoryConstraintsError),
    "no stable model": (
        {"fixed": {"a1": 1.0}, "bounds": {"a0": (None, 0.0)}},
        err.ContradictoryConstraintsError,
    ),
    "everything known": (
        {"fixed": {"a1": 1.0, "a0": 3.0, "b1": 0.2, "b0": 0.5}},
        err.ContradictoryConstraintsError,
    ),
    "another channel": ({"fixed": {"b0[q,e]": 1.0}}, err.ParameterNameError),
    "gain of other channels": ({"static_gain": [[1.0, 2.0]]}, err.StaticGainError),
}


@every_able
@pytest.mark.parametrize("case", REFUSED)
def test_refusals_are_one_clear_line_of_their_own_class(key, case):
    known, expected = REFUSED[case]
    with pytest.raises(expected) as caught:
        identify(record_of([0.2, 0.5], [1.0, 1.0, 3.0]), Structure(2, 1, **known), METHODS[key]())
    message = str(caught.value)
    assert "found" in message
    assert "expect" in message
    assert "\n" not in message


@every_able
def test_bounds_without_a_stable_model_are_refused(key):
    """a2 a1 > a0 is what stability takes; no linear program sees it."""
    known = {"fixed": {"a2": 1.0, "a1": 1.0}, "bounds": {"a0": (1.5, None)}}
    with pytest.raises(err.ContradictoryConstraintsError, match="no stable denominator"):
        identify(
            record_of([0.5], [1.0, 2.0, 3.0, 4.0], 0.05), Structure(3, 0, **known), METHODS[key]()
        )


@pytest.mark.slow
@every_able
def test_poles_stay_stable_where_the_record_pulls_them_out(key):
    """With a2 = a1 = 1 the best a0 is beyond 1, where the poles leave the left half plane."""
    record = record_of([0.5], [1.0, 2.0, 3.0, 4.0], 0.05)
    structure = Structure(3, 0, fixed={"a2": 1.0, "a1": 1.0})
    found = identify(record, structure, METHODS[key](), throw=False)
    assert np.all(found.model.poles.real < 0)
    assert 0.0 < found.parameters["a0"].value < 1.0


@pytest.mark.parametrize("key", UNABLE)
@pytest.mark.parametrize(
    "known",
    [
        {"fixed": {"a0": 3.0}},
        {"bounds": {"a0": (1.0, None)}},
        {"equalities": [({"a0": 1.0, "b0": 2.0}, 4.0)]},
        {"priors": {"a0": (3.0, 0.1)}},
        {"static_gain": 0.2},
        {"static_gain": 0.0},
    ],
    ids=["fixed", "bounds", "equalities", "priors", "gain", "no gain"],
)
def test_other_methods_refuse(key, known):
    with pytest.raises(err.UnsupportedError, match="found"):
        identify(record_of([0.2, 0.5], [1.0, 1.0, 3.0]), Structure(2, 1, **known), METHODS[key]())


def test_the_posterior_mean_is_refused_where_it_is_asked_for():
    record = record_of([0.2, 0.5], [1.0, 1.0, 3.0], 0.1)
    with pytest.raises(err.UnsupportedError, match="posterior"):
        identify(record, Structure(2, 1, static_gain=0.2), ThreeModel(finish="posterior"))


# -------------------------------------------------------------------------- units and starts
@every_able
@pytest.mark.parametrize(
    ("dt", "input_unit", "output_unit"),
    [(1e-6, 1e3, 1.0), pytest.param(1e5, 1.0, 1e-6, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("case", ["gain", "bound and prior", "equality", "integrator"])
@pytest.mark.fast("gain-1e-06-1000.0-1.0-three-model", "integrator-1e-06-1000.0-1.0-output-error")
def test_units_change_nothing_but_the_units(key, case, dt, input_unit, output_unit):
    num, den = ([2.0], [1.0, 2.0, 0.0]) if case == "integrator" else ([0.2, 0.5], [1.0, 1.0, 3.0])

    def found(step, gain_in, gain_out):
        plain = record_of(num, den, 0.1, offset=0.3)
        record = Record(gain_in * np.array(plain.u), gain_out * np.array(plain.y), dt=step)
        rate, gain = DT / step, gain_out / gain_in
        size = {"a1": rate, "a0": rate**2, "b1": gain * rate, "b0": gain * rate**2}
        known = {
            "gain": {"static_gain": gain * 0.5 / 3.0},
            "bound and prior": {
                "bounds": {"a1": (1.5 * size["a1"], None)},
                "priors": {"b1": (0.3 * size["b1"], 0.05 * size["b1"])},
            },
            "equality": {"equalities": [({"a1": 1 / size["a1"], "a0": 1 / size["a0"]}, 4.2)]},
            "integrator": {"fixed": {"a0": 0.0}},
        }[case]
        estimate = identify(record, Structure(2, len(num) - 1, **known), METHODS[key]())
        scale = np.array([size[name] for name in estimate.names])
        return estimate.theta / scale, estimate.std / scale

    theta, std = found(DT, 1.0, 1.0)
    again, others = found(dt, input_unit, output_unit)
    assert np.allclose(again, theta, rtol=1e-9, atol=0.0)
    assert np.allclose(others, std, rtol=1e-9, atol=0.0)


@every_able
@pytest.mark.slow
def test_a_free_optimum_that_no_projection_keeps_stable_is_no_dead_end(key):
    """A short record of four slow poles; a0 fixed makes the free optimum's neighbours unstable."""
    den = np.poly([-0.32 + 0.46j, -0.32 - 0.46j, -0.28 + 0.53j, -0.28 - 0.53j]).real
    record = record_of([-2.4], den, 0.03, n_samples=80)
    structure = Structure(4, 0, fixed={"a0": den[-1]}, **REST)
    found = identify(record, structure, METHODS[key](), throw=False)
    noise = 0.03 * np.std(respond([-2.4], den, record.u[:, 0]))
    assert np.all(found.model.poles.real < 0)
    assert np.sqrt(found.cost) < 1.15 * noise


# ---------------------------------------------------- together with what else a method promises
@every_able
@pytest.mark.parametrize("case", ["delay", "jittered time"])
@pytest.mark.parametrize("integrates", [False, True], ids=["a gain", "an integrator"])
@pytest.mark.fast("a gain-delay-output-error", "an integrator-jittered time-three-model")
def test_knowledge_goes_with_delays_and_jitter(key, case, integrates):
    flag = Capability.DELAY if case == "delay" else Capability.NON_UNIFORM_TIME
    if flag not in METHODS[key]().capabilities:
        pytest.skip("not promised")
    u, rng = binary(), np.random.default_rng(0)
    time = np.cumsum(DT * (1.0 + 0.3 * rng.uniform(-1.0, 1.0, u.size)))
    stamps = {"dt": DT} if case == "delay" else {"t": time}
    delay = 0.13 if case == "delay" else 0.0
    num, den = ([2.0], [1.0, 2.0, 0.0]) if integrates else ([0.2, 0.5], [1.0, 1.0, 3.0])
    known = {"fixed": {"a0": 0.0}} if integrates else {"static_gain": 0.5 / 3.0}
    model = TransferFunction(num, den, delay=delay)
    y = simulate(model, Record(u, u, **stamps))[:, 0] + 0.3
    structure = Structure(2, len(num) - 1, delay=delay, **known)
    found = identify(Record(u, y, **stamps), structure, METHODS[key]())
    assert np.allclose(found.theta, [*den[1:], *num], rtol=1e-8, atol=0.0)
    assert found.model.delay[0][0] == delay


@every_able
@pytest.mark.parametrize(
    "structure",
    [Structure([[2, 2]], 1, static_gain=1.0), Structure(2, 1, delay="free", static_gain=1.0)],
    ids=["separate denominators", "free delay"],
)
def test_what_cannot_be_constrained_yet_is_refused(key, structure):
    one = record_of([0.2, 0.5], [1.0, 1.0, 3.0])
    two = Record(np.column_stack([one.u, np.roll(one.u, 37)]), one.y, dt=one.dt)
    with pytest.raises(err.UnsupportedError, match="found"):
        identify(two if structure.delay == 0.0 else one, structure, METHODS[key]())


@every_able
def test_nested_orders_of_one_channel_are_those_of_a_shared_denominator(key):
    record = record_of([0.2, 0.5], [1.0, 1.0, 3.0])
    plain, nested = (
        identify(record, Structure(poles, zeros, fixed={"a0": 3.0}), METHODS[key]())
        for poles, zeros in ((2, 1), ([[2]], [[1]]))
    )
    assert nested.names == plain.names == ("a1", "a0", "b1", "b0")
    assert np.array_equal(nested.theta, plain.theta)


@every_able
def test_what_is_known_of_a_combination_has_no_standard_error(key):
    clean = record_of([0.2, 0.5], [1.0, 1.0, 3.0])
    noise = 0.01 * np.random.default_rng(0).standard_normal(clean.y.shape)
    record = clean.with_outputs(clean.y + noise)
    structure = Structure(2, 1, equalities=[({"b0": 6.0, "a0": -1.0}, 0.0)])
    gain = next(
        p for p in identify(record, structure, METHODS[key]()).derived() if "gain" in p.name
    )
    assert gain.value == pytest.approx(1.0 / 6.0, rel=1e-12)
    assert gain.std == 0.0


@pytest.mark.parametrize("integrates", [False, True], ids=["a gain", "an integrator"])
def test_the_free_response_after_a_delay_is_that_of_the_fit(integrates):
    num, den = ([2.0], [1.0, 2.0, 0.0]) if integrates else ([0.2, 0.5], [1.0, 1.0, 3.0])
    known = {"fixed": {"a0": 0.0}} if integrates else {"static_gain": 0.5 / 3.0}
    u, rng = binary(), np.random.default_rng(0)
    y = simulate(TransferFunction(num, den, delay=0.13), Record(u, u, dt=DT))[:, 0]
    record = Record(u, y + 0.02 * rng.standard_normal(u.size), dt=DT)
    structure = Structure(2, len(num) - 1, delay=0.13, initial_state="free", offset=False, **known)
    found = identify(record, structure, METHODS["output-error"]())
    assert found.cost == pytest.approx(np.nanmean(found.residual(record) ** 2), rel=1e-6)
