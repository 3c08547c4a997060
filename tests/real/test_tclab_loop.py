"""Two heaters and two sensors on a board, the same device in open loop and under two controllers.

Three poles for each sensor: two coupled heaters and the sensor's own lag; the way across passes
both heaters and has no zero. One sample of five seconds, the heaters' means over it. What three
records of 85 minutes tell:

- Over the same set points the two controllers give the same coefficients within three joint
  standard errors, and each model explains the other's record by more than 92 percent.
- Controller 3 lets go after 1500 s, and from 2100 s on both heaters are off: no record of a loop
  any more, so only what is before is used.
- Over *all* set points heater 1 seems to act on sensor 2 by a tenth less than over the first 1500
  s. The set points there are others; the plant is not quite linear, and the errors of 1000 samples
  are small enough to show it.
- The open-loop record is the worse one: steps of 10 percent, and a fit of 75 to 80 percent, since
  the room drifts by as much as a step makes. Its steady gains are those of the closed loop within
  three joint standard errors; for heater 2, a third above, only just. Radiation would make a few
  percent of that between 30 and 50 percent of power. Its faster poles it does not know.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, identify
from tridentify.uncertainty import derived

pytestmark = [pytest.mark.unjudged, pytest.mark.slow]

STEP = 5
"""[s]."""
TRACKED = 1500
"""[s] that controller 3 follows its set points."""
JOINT = 3.0
"""Joint standard errors."""
SENSORS = {
    "y1": Structure(3, [[1, 0]], offset=True, initial_state="free"),
    "y2": Structure(3, [[0, 1]], offset=True, initial_state="free"),
}
HELD = ThreeModel(controller="sampled")
"""The controllers act once a second, which is the clock of the files."""


@pytest.fixture(scope="module")
def record(folder):
    def read(name, sensor, until=None, step=STEP):
        path = folder("tclab-closed-loop") / f"{name}.csv"
        table = np.genfromtxt(path, delimiter=",", names=True)[:until]
        count = len(table) // step

        def blocks(*names):
            return np.stack([table[n][: count * step].reshape(count, step) for n in names], axis=1)

        closed = "r1" in table.dtype.names
        return Record(
            blocks("u1", "u2").mean(axis=2),
            blocks(sensor)[:, :, 0],
            dt=float(step),
            reference=blocks("r1", "r2")[:, :, 0] if closed else None,
            input_names=["u1", "u2"],
            output_names=[sensor],
        )

    return read


@pytest.fixture(scope="module")
def estimate(record):
    known = {}

    def find(name, sensor, until=None):
        key = (name, sensor, until)
        if key not in known:
            known[key] = identify(record(*key), SENSORS[sensor], HELD)
        return known[key]

    return find


def gains(estimate):
    """Steady gain from each heater, and its standard error [K/%]."""
    rows = [row for row in derived(estimate) if row.name.startswith("dc gain")]
    assert len(rows) == 2
    return np.array([row.value for row in rows]), np.array([row.std for row in rows])


def apart(one, other):
    """Differences of the coefficients in joint standard errors."""
    assert one.names == other.names
    places = [k for k, name in enumerate(one.names) if name[0] in "ab"]
    joint = np.hypot(one.std, other.std)
    return ((one.theta - other.theta) / joint)[places]


@pytest.mark.parametrize("sensor", SENSORS)
def test_two_controllers_give_one_model(estimate, sensor):
    first, third = (estimate(f"closed_loop_{k}", sensor, TRACKED) for k in (1, 3))
    for one in (first, third):
        assert one.route == "reference"
        assert one.fit[0] > 94.0
        assert one.model.is_stable
    assert np.abs(apart(first, third)).max() < JOINT
    (here, small), (there, large) = gains(first), gains(third)
    assert np.abs((here - there) / np.hypot(small, large)).max() < JOINT
    # and that says something: no gain's joint error is above a sixth of it
    assert (np.hypot(small, large) / here).max() < 1.0 / 6.0


@pytest.mark.parametrize("sensor", SENSORS)
def test_each_controllers_model_predicts_the_others_record(record, estimate, judged, sensor):
    for own, other in ((1, 3), (3, 1)):
        model = estimate(f"closed_loop_{own}", sensor, TRACKED).model
        assert judged(model, record(f"closed_loop_{other}", sensor, TRACKED))[0] > 92.0


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_whole_record_is_a_thermal_model(estimate, sensor):
    """Three real stable poles, the sensor's lag of 20 to 30 s the fastest; heat flows one way."""
    found = estimate("closed_loop_1", sensor)
    poles = np.sort(found.model.poles[0][0])
    assert np.all(np.abs(poles.imag) < 1e-12)
    assert np.all(poles.real < 0.0)
    assert 15.0 < -1.0 / poles.real[0] < 40.0
    own, across = (0, 1) if sensor == "y1" else (1, 0)
    value, error = gains(found)
    assert np.all(value > 5.0 * error)
    assert value[own] > value[across]


@pytest.mark.parametrize("sensor", SENSORS)
def test_steady_gains_are_those_of_open_loop(record, estimate, judged, sensor):
    closed, opened = estimate("closed_loop_1", sensor), estimate("open_loop", sensor)
    assert (closed.route, opened.route) == ("reference", "open-loop")
    (here, small), (there, large) = gains(closed), gains(opened)
    assert np.abs((here - there) / np.hypot(small, large)).max() < JOINT
    # the closed loop knows them better, and explains the open-loop record nearly as well
    assert np.all(small < 0.5 * large)
    seen = record("open_loop", sensor)
    assert judged(closed.model, seen)[0] > judged(opened.model, seen)[0] - 10.0
    assert judged(opened.model, record("closed_loop_1", sensor))[0] < 85.0


def test_two_poles_are_too_few(record, judged):
    """Otherwise agreement would be that of two wrong models."""
    few = Structure(2, [[0, 0]], offset=True, initial_state="free")
    whole = record("closed_loop_1", "y2")
    found = identify(whole, few, HELD)
    assert judged(found.model, whole)[0] < 85.0


@pytest.mark.judged
@pytest.mark.parametrize(("controller", "sensor"), [(1, "y1"), (1, "y2"), (3, "y2")])
def test_constant_set_points_excite_nothing_and_that_is_told(record, controller, sensor):
    """Five minutes before the first step: noise runs round the loop, and no more than that."""
    still = record(f"closed_loop_{controller}", sensor, 300, step=1)
    assert np.all(still.reference == still.reference[0])
    own = int(sensor[1]) - 1
    bare = Record(still.u[:, own], still.y, dt=1.0)
    found = identify(bare, Structure(2, 0, offset=True, initial_state="free"), throw=False)
    codes = {one.code for one in found.findings}
    assert "feedback" in codes
    assert codes & {"loop-not-excited", "no-response"}


@pytest.mark.judged
@pytest.mark.parametrize("sensor", SENSORS)
def test_without_the_set_points_feedback_is_found(record, sensor):
    seen = record("closed_loop_1", sensor)
    found = identify(Record(seen.u, seen.y, dt=seen.dt), SENSORS[sensor], ThreeModel())
    assert "feedback" in {one.code for one in found.findings}
