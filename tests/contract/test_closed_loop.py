"""Records taken with a controller at work: what the reference route promises, from outside.

Every record comes from the simulators of `oracles`, which share no line with the package. An
estimate must lie within four of its own standard errors of the truth; the open-loop estimate of
the same record is shown to be further off where the noise is in the input.
"""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter
from typer.testing import CliRunner

import tridentify as tri
from oracles import continuous_loop, sampled_loop
from tridentify.cli.app import program

CHANNEL = ([1.0, 2.0], [1.0, 1.2, 4.0])
TRUTH = {"a1": 1.2, "a0": 4.0, "b1": 1.0, "b0": 2.0}
DT = 0.1
ORDERS = tri.Structure(2, 1)
CLOSE = 4.0


def switching(rng, n, hold=15):
    return np.repeat(rng.choice([-1.0, 1.0], size=n // hold + 1), hold)[:n]


def rule(r, *, gain=2.0, rate=1.0, dither=None, limit=np.inf):
    """A sampled proportional and integral controller, held within limits, with a dither added."""
    total = 0.0

    def control(k, y):
        nonlocal total
        error = r[k] - y[0]
        total += rate * DT * error
        added = 0.0 if dither is None else dither[k]
        return np.clip(gain * error + total + added, -limit, limit)

    return control


def record_of(seed=1, *, n=600, noise=0.2, colour=None, missing=0, **options):
    rng = np.random.default_rng(seed)
    r = switching(rng, n)
    e = noise * rng.standard_normal(n)
    if colour is not None:
        e = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], e)
    initial = options.pop("initial", None)
    shift, slope = options.pop("shift", 0.0), options.pop("slope", 0.0)
    e = e + shift + slope * DT * np.arange(n)
    u, y = sampled_loop([[CHANNEL]], rule(r, **options), e[:, None], DT, initial=initial)
    if missing:
        y[rng.choice(n, missing, replace=False)] = np.nan
    return tri.Record(u, y, dt=DT, reference=r)


@cache
def answered(seed=1, n=600):
    """Of one of these records, by default; the same for every test that asks for it."""
    return tri.identify(record_of(seed, n=n), ORDERS)


def driven(seed, intersample, n=600, noise=0.2):
    """The same plant under a continuous controller; the reference held, joined or band-limited."""
    rng = np.random.default_rng(seed)
    controller = (np.zeros((1, 1)), np.ones(1), np.array([1.0]), 2.0)
    e = noise * rng.standard_normal(n)
    if intersample == "band-limited":
        fine, t = 20, np.arange(20 * n) * DT / 20
        lines = np.arange(1, 60, 2) * 2 * np.pi / (n * DT)
        r = np.cos(np.outer(t, lines) + rng.uniform(0, 2 * np.pi, lines.size)).sum(axis=1) / 4
        u, y = continuous_loop(
            CHANNEL, controller, r, np.repeat(e, fine), DT / fine, intersample="foh"
        )
        u, y, r = u[::fine], y[::fine], r[::fine]
    else:
        r = switching(rng, n)
        if intersample == "foh":
            r = np.interp(np.arange(n), np.arange(0, n + 15, 15), rng.normal(size=n // 15 + 1))
        u, y = continuous_loop(CHANNEL, controller, r, e, DT, intersample=intersample)
    return tri.Record(
        u,
        y,
        dt=DT,
        reference=r,
        reference_intersample=intersample,
        intersample="zoh" if intersample == "zoh" else intersample,
    )


def errors(estimate, truth=TRUTH):
    return np.array(
        [
            (estimate.parameters[k].value - v) / estimate.parameters[k].std
            for k, v in truth.items()
            if estimate.parameters[k].std > 0
        ]
    )


def distance(estimate, truth=TRUTH):
    """Relative errors, the square root of the sum of squares."""
    return np.linalg.norm([estimate.parameters[k].value / v - 1 for k, v in truth.items()])


def right(estimate, truth=TRUTH):
    assert estimate.route == "reference"
    assert np.abs(errors(estimate, truth)).max() < CLOSE
    assert distance(estimate, truth) < 0.6


def worse_in_open_loop(record, truth=TRUTH, structure=ORDERS, **options):
    forced = tri.identify(record, structure, tri.ThreeModel(route="open-loop", **options))
    assert forced.route == "open-loop"
    assert np.abs(errors(forced, truth)).max() > CLOSE
    return forced


@pytest.mark.unjudged
def test_the_reference_route_is_taken_by_itself_and_told():
    record = record_of(n=300)
    estimate = answered(n=300)
    right(estimate)
    assert "reference" in estimate.summary()
    told = tri.identify(record, ORDERS, tri.ThreeModel(route="reference"))
    np.testing.assert_array_equal(told.theta, estimate.theta)
    # a held input and white noise: open loop is no worse here, and its route is told all the same
    forced = tri.identify(record, ORDERS, tri.ThreeModel(route="open-loop"))
    assert forced.route == "open-loop"
    assert not np.array_equal(forced.theta, estimate.theta)


@pytest.mark.unjudged
@pytest.mark.slow
def test_without_a_reference_the_route_is_not_reference():
    record = record_of(n=300)
    bare = tri.Record(record.u, record.y, dt=DT)
    assert tri.identify(bare, ORDERS).route != "reference"


def test_the_reference_route_without_a_reference_is_refused():
    record = record_of(n=300)
    bare = tri.Record(record.u, record.y, dt=DT)
    with pytest.raises(tri.errors.TridentifyError, match="reference"):
        tri.identify(bare, ORDERS, tri.ThreeModel(route="reference"))


def test_a_right_estimate_warns_of_nothing():
    estimate = tri.identify(record_of(3, n=300), ORDERS, tri.ThreeModel(controller="sampled"))
    right(estimate)
    loud = [f.code for f in estimate.findings if f.severity in ("error", "warning")]
    assert loud == []
    assert "feedback" not in [f.code for f in estimate.findings]


@pytest.mark.slow
def test_a_kind_of_controller_that_was_only_assumed_is_warned_of_where_it_matters():
    exact = record_of(3)
    # rounded numbers hide the controller's rule, which exact ones show
    record = tri.Record(
        np.round(exact.u, 2), np.round(exact.y, 2), dt=DT, reference=exact.reference
    )
    open_ = tri.identify(record, ORDERS)
    assert not [f for f in answered(3).findings if f.code == "intersample"]
    [found] = [f for f in open_.findings if f.code == "intersample"]
    assert found.severity == "warning"
    assert "standard errors" in found.message
    other = tri.identify(record, ORDERS, tri.ThreeModel(controller="continuous"))
    moved = np.abs(other.theta - open_.theta)
    assert np.max(moved / other.std) > 3.0
    # whoever leaves the kind open gets errors that reach the other one
    assert np.max(moved / open_.std) < 2.0


@pytest.mark.slow
def test_the_input_as_reference_leaves_no_kind_of_controller_to_ask_for():
    record = record_of(3)
    same = tri.Record(record.u, record.y, dt=DT, reference=record.u)
    estimate = tri.identify(same, ORDERS)
    assert "intersample" not in [f.code for f in estimate.findings]


@pytest.mark.slow
@pytest.mark.parametrize("intersample", ["zoh", "foh", "band-limited"])
@pytest.mark.parametrize("controller", ["continuous", "unknown"])
@pytest.mark.unjudged
def test_a_continuous_controller_and_each_kind_of_reference(controller, intersample):
    record = driven(5, intersample, n=150)
    assert record.reference_behaviour == intersample
    right(tri.identify(record, ORDERS, tri.ThreeModel(controller=controller)))


def beside_measured(record, **options):
    """The same with an input that is stated to be joined by lines."""
    drawn = {"dt": DT, "intersample": "foh", "reference": record.reference, **options}
    return tri.Record(record.u, record.y, **drawn)


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_switched_reference_is_held_beside_a_measured_input_unasked():
    record = beside_measured(driven(5, "zoh", n=240, noise=0.05))
    found = tri.identify(record, ORDERS, tri.ThreeModel(controller="continuous", noise="white"))
    right(found)
    assert "reference taken as held between its samples (zoh)" in found.trace.decisions


@pytest.mark.unjudged
@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6, 7, 8])
def test_joined_by_lines_it_would_be_half_a_sample_early(seed):
    held = driven(seed, "zoh", noise=0.05)
    found = tri.identify(beside_measured(held), ORDERS)
    right(found)
    joined = tri.identify(beside_measured(held, reference_intersample="foh"), ORDERS)
    assert distance(joined) > 2.0 * distance(found)


# in the fast tests: test_a_right_estimate_warns_of_nothing
@pytest.mark.parametrize("controller", ["unknown", "sampled"])
@pytest.mark.slow
@pytest.mark.unjudged
def test_a_sampled_controller(controller):
    right(tri.identify(record_of(6, n=300), ORDERS, tri.ThreeModel(controller=controller)))


@pytest.mark.parametrize(
    ("structure", "options"),
    [
        (tri.Structure(2, 1, offset=True), {"shift": 3.0}),
        (tri.Structure(2, 1, offset=True, drift=True), {"shift": 1.0, "slope": 0.05}),
        (tri.Structure(2, 1, initial_state="free"), {"initial": [0.0, 3.0]}),
        (ORDERS, {"missing": 30}),
        (ORDERS, {"colour": 0.8}),
    ],
    ids=["offset", "drift", "state", "missing", "coloured"],
)
@pytest.mark.unjudged
@pytest.mark.fast("drift")
def test_what_records_have_beside_noise(structure, options):
    right(tri.identify(record_of(7, n=300, **options), structure))


@pytest.mark.unjudged
@pytest.mark.slow
def test_two_experiments_with_two_controllers():
    pair = [record_of(8, n=400), record_of(9, n=400, gain=0.5, rate=0.5)]
    estimate = tri.identify(pair, ORDERS)
    right(estimate)
    alone = tri.identify(pair[0], ORDERS)
    assert np.all(estimate.std[:4] < alone.std[:4])


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_known_delay():
    late = 3
    rng = np.random.default_rng(10)
    r, e = switching(rng, 300), 0.15 * rng.standard_normal(300)
    waiting = [0.0] * late
    inner, asked = rule(r, gain=0.8, rate=0.5), []

    def control(k, y):
        asked.append(float(inner(k, y)))
        waiting.append(asked[-1])
        return waiting[k]

    _, y = sampled_loop([[CHANNEL]], control, e[:, None], DT)
    record = tri.Record(np.array(asked), y, dt=DT, reference=r)
    right(tri.identify(record, tri.Structure(2, 1, delay=late * DT)))


@pytest.mark.slow
@pytest.mark.unjudged
def test_a_fixed_coefficient():
    fixed = tri.identify(record_of(11, n=225), tri.Structure(2, 1, fixed={"a0": 4.0}))
    assert fixed.parameters["a0"].value == pytest.approx(4.0, abs=1e-12)
    right(fixed)


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_coefficient_at_its_bound():
    bound = tri.Structure(2, 1, bounds={"a1": (1.6, None)})
    held = tri.identify(record_of(11, n=400), bound)
    assert held.parameters["a1"].value >= 1.6 - 1e-9


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_coefficient_within_its_bound():
    bound = tri.Structure(2, 1, bounds={"b1": (0.0, None)})
    right(tri.identify(record_of(11, n=400), bound))


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_set_point_and_a_dither():
    rng = np.random.default_rng(12)
    n = 600
    r, d = switching(rng, n, 25), 0.8 * switching(rng, n, 4)
    e = 0.2 * rng.standard_normal((n, 1))
    u, y = sampled_loop([[CHANNEL]], rule(r, dither=d), e, DT)
    both = tri.identify(tri.Record(u, y, dt=DT, reference=np.column_stack([r, d])), ORDERS)
    right(both)
    alone = tri.identify(tri.Record(u, y, dt=DT, reference=r), ORDERS)
    assert both.parameters["b1"].std < alone.parameters["b1"].std


@pytest.mark.unjudged
@pytest.mark.slow
def test_experiments_with_different_references():
    """A set point alone in one, with a dither in the other."""
    rng = np.random.default_rng(16)
    n = 400
    records = []
    for second in (False, True):
        r, d = switching(rng, n, 15), second * 0.8 * switching(rng, n, 4)
        e = 0.2 * rng.standard_normal((n, 1))
        u, y = sampled_loop([[CHANNEL]], rule(r, dither=d), e, DT)
        drove = np.column_stack([r, d]) if second else r
        records.append(tri.Record(u, y, dt=DT, reference=drove))
    right(tri.identify(records, ORDERS))


@pytest.mark.slow
@pytest.mark.unjudged
def test_an_input_that_no_controller_moves():
    """A measured disturbance beside the controlled input: a reference by its own name."""
    rng = np.random.default_rng(17)
    n, pole = 300, float(np.exp(-0.1))
    r, d = switching(rng, n, 15), switching(rng, n, 10)
    e, x, u, y = 0.05 * rng.standard_normal(n), 0.0, np.zeros(n), np.zeros(n)
    for k in range(n):
        y[k] = x + e[k]
        u[k] = 2.0 * (r[k] - y[k])
        x = pole * x + (1.0 - pole) * (u[k] + 0.5 * d[k])
    record = tri.Record(
        np.column_stack([u, d]), y, dt=0.1, input_names=["u", "d"],
        reference=np.column_stack([r, d]), reference_names=["r", "d"],
    )  # fmt: skip
    estimate = tri.identify(record, tri.Structure(1, 0), tri.ThreeModel(controller="sampled"))
    right(estimate, {"a0": 1.0, "b0[y,u]": 1.0, "b0[y,d]": 0.5})


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_dither_alone_at_the_input():
    rng = np.random.default_rng(13)
    n = 400
    d = switching(rng, n, 8)
    u, y = sampled_loop(
        [[CHANNEL]], rule(np.zeros(n), dither=d), 0.1 * rng.standard_normal((n, 1)), DT
    )
    right(tri.identify(tri.Record(u, y, dt=DT, reference=d), ORDERS))


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_controller_that_saturates():
    record = record_of(14, limit=2.0, n=800)
    assert np.mean(np.abs(record.u) == 2.0) > 0.05
    right(tri.identify(record, ORDERS))


@pytest.mark.unjudged
@pytest.mark.slow
def test_two_inputs_two_outputs_two_references():
    channels = [
        [([2.0], [1.0, 1.0]), ([0.5], [1.0, 2.0])],
        [([-0.6], [1.0, 1.5]), ([3.0], [1.0, 2.5])],
    ]
    rng = np.random.default_rng(15)
    n = 500
    r = np.column_stack([switching(rng, n, 12), switching(rng, n, 17)])
    total = np.zeros(2)

    def control(k, y):
        nonlocal total
        error = r[k] - y
        total = total + 0.6 * DT * error
        return np.array([1.2, 0.9]) * error + total

    u, y = sampled_loop(channels, control, 0.1 * rng.standard_normal((n, 2)), DT)
    record = tri.Record(u, y, dt=DT, reference=r)
    structure = tri.Structure([[1, 1], [1, 1]], [[0, 0], [0, 0]])
    estimate = tri.identify(record, structure)
    truth = {
        f"{letter}[y{i + 1},u{j + 1}]": value
        for i in range(2)
        for j in range(2)
        for letter, value in (("a0", channels[i][j][1][1]), ("b0", channels[i][j][0][0]))
    }
    assert estimate.route == "reference"
    assert np.abs(errors(estimate, truth)).max() < CLOSE


def test_a_saved_estimate_keeps_its_route(tmp_path):
    estimate = answered(n=300)
    estimate.save(tmp_path / "model.json")
    loaded = tri.Estimate.load(tmp_path / "model.json")
    assert loaded.route == "reference"
    np.testing.assert_array_equal(loaded.theta, estimate.theta)
    np.testing.assert_array_equal(loaded.cov, estimate.cov)


@pytest.mark.slow
def test_validate_and_compare_take_closed_loop_records():
    first, second = record_of(16), record_of(17)
    estimate = tri.identify(first, ORDERS)
    judged = tri.validate(estimate, second)
    assert not [f for f in judged.findings if f.severity == "error"]
    forced = tri.identify(first, ORDERS, tri.ThreeModel(route="open-loop"))
    compared = tri.compare([estimate, forced], [first, second])
    assert compared.fits.shape == (2, 2, 1)
    assert np.all(np.isfinite(compared.fits))


@pytest.mark.slow
def test_the_order_is_chosen():
    record = record_of(18, noise=0.1)
    estimate = tri.identify(record)
    assert estimate.route == "reference"
    names = {n for n in estimate.names if n.startswith(("a", "b"))}
    assert names == set(TRUTH)
    right(estimate)


@pytest.mark.slow
@pytest.mark.unjudged
def test_structures_are_compared_on_the_reference_route():
    candidates = [tri.Structure(1, 0), ORDERS]
    selection = tri.select_structure(record_of(19, noise=0.1), candidates)
    best = selection.recommended
    assert best.estimate.route == "reference"
    assert best.structure.poles == 2


@pytest.mark.slow
def test_the_command_line_takes_the_reference(tmp_path):
    record = record_of(n=300)
    table = np.column_stack([record.t, record.u, record.reference, record.y])
    path = tmp_path / "log.csv"
    np.savetxt(path, table, delimiter=",", header="t,u,r,y", comments="", fmt="%.17g")
    words = f"identify {path} --input u --output y --reference r --poles 2 --zeros 1 --json"
    ran = CliRunner().invoke(program(), words.split())
    assert ran.exit_code == 0, ran.output
    told = json.loads(ran.stdout)
    assert told["route"] == "reference"
    own = answered(n=300)
    found = {entry["name"]: entry["value"] for entry in told["parameters"]}
    for name, value in TRUTH.items():
        assert abs(found[name] - value) < CLOSE * own.parameters[name].std
