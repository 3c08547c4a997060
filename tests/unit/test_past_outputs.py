"""Feedback that past outputs show in what an input does next, where no residual shows it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter, lsim

from tridentify import OutputError, Record, Structure, advise, identify
from tridentify.judgement.causes.past_outputs import told_by_past
from tridentify.judgement.direct_findings import about_direct
from tridentify.judgement.selection.paired import Unseen
from tridentify.judgement.selection.rule import Trial, recommend

DT, FINE, GAIN = 0.1, 5, 4.8


def held_by_a_servo(seed: int, n: int = 440) -> Record:
    """A plant that runs away (a ball on a beam), held by a servo that answers late."""
    rng = np.random.default_rng(seed)
    h, place, speed, force, angle, dither = DT / FINE, 0.0, 0.0, 0.0, 0.0, 0.0
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n):
        seen = place + 0.0005 * rng.standard_normal()
        wanted = 0.06 * np.sin(0.078 * k + seed) * (1.0 if (k // 60) % 2 else 0.3)
        asked = -0.12 * (place - wanted) - 0.11 * speed + 0.004 * dither
        dither = 0.9 * dither + 0.5 * rng.standard_normal()
        u[k], y[k] = angle, seen
        for _ in range(FINE):
            angle += h * 4.0 * (asked - angle)
            force += -0.5 * h * force + 0.012 * np.sqrt(h) * rng.standard_normal()
            place, speed = place + h * speed, speed + h * (0.1225 * place + GAIN * angle + force)
    return Record(u, y, dt=DT, intersample="foh")


def test_past_outputs_tell_what_a_slow_controller_does() -> None:
    record = held_by_a_servo(1)
    told = told_by_past([record])[0]
    assert told is not None
    assert told.p_value < 1e-5
    # the same input beside the output of another run
    assert told_by_past([record.with_outputs(held_by_a_servo(12).y)]) == [None]


@pytest.mark.parametrize("kind", ["sweep", "sines", "between", "wandering", "steps"])
def test_past_outputs_of_an_open_loop_tell_nothing(kind: str) -> None:
    rng = np.random.default_rng(3)
    n, fine = 400, 10
    t = np.arange(n * fine) * DT / fine
    if kind == "sweep":
        u = np.sin(2 * np.pi * (0.05 * t + 0.5 * t**2 / (n * DT)))
    elif kind == "sines":
        u = sum(np.cos(2 * np.pi * k * t / (n * DT) + k * k) for k in range(1, 30))
    elif kind == "between":  # what lies between the samples acts too
        u = lfilter([0.05], [1.0, -0.95], rng.standard_normal(t.size))
    elif kind == "wandering":
        u = np.interp(t, t[::fine], np.cumsum(rng.standard_normal(n)))
    else:
        u = np.repeat(rng.standard_normal(n // 10), 10 * fine)
    y = lsim(([4.0], [1.0, 1.0, 4.0]), u, t)[1][::fine]
    drift = np.cumsum(rng.standard_normal(n))
    y = y + 0.05 * np.std(y) * drift / np.std(drift)
    assert told_by_past([Record(u[::fine], y, dt=DT, intersample="foh")]) == [None]


@pytest.mark.slow
def test_advice_tells_of_a_plant_that_is_held() -> None:
    found = [one for one in advise(held_by_a_servo(1)).findings if one.code == "feedback"]
    assert [one.severity for one in found] == ["warning"]
    assert "Past samples of y tell" in found[0].message


def held_by_samples(seed: int, n: int = 400) -> Record:
    """A magnet that would fall, held by a controller that acts on every sample at once."""
    rng = np.random.default_rng(seed)
    dt, fine = 0.005, 5
    h, place, speed, force, before = dt / fine, 0.0, 0.0, 0.0, 0.0
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n):
        y[k] = place + 0.0002 * rng.standard_normal()
        error = 0.05 * np.sin(0.05 * k) - y[k]
        u[k] = -1.3 * error + 0.055 * (y[k] - before) / dt
        before = y[k]
        for _ in range(fine):
            force = 0.99 * force + 0.1 * rng.standard_normal()
            place, speed = place + h * speed, speed + h * (350.0 * place - 600.0 * u[k] + force)
    return Record(u, y, dt=dt)


def test_an_output_that_a_controller_answers_at_once_does_not_hide_it() -> None:
    assert told_by_past([held_by_samples(1)])[0] is not None


def test_a_smooth_input_on_a_floor_of_noise_is_not_asked() -> None:
    rng = np.random.default_rng(4)
    n, fine = 800, 10
    t = np.arange(n * fine) * DT / fine
    u = rng.standard_normal(t.size)
    for _ in range(3):
        u = lfilter([0.02], [1.0, -0.98], u)
    y = lsim(([1.0], [1.0, 1.0]), u, t)[1][::fine]
    measured = u[::fine] + 0.1 * np.std(u) * rng.standard_normal(n)
    assert told_by_past([Record(measured, y, dt=DT, intersample="foh")]) == [None]


def test_of_a_held_plant_an_open_loop_model_is_an_error() -> None:
    record = held_by_a_servo(1)
    model = OutputError().estimate([record], Structure(1, 0))
    (found,) = about_direct((), model, [record])
    assert (found.code, found.severity) == ("feedback", "error")
    assert "controller, backwards" in found.effect
    # a reference says what else moved the input
    known = Record(record.u, record.y, dt=DT, intersample="foh", reference=np.sin(record.t))
    assert about_direct((), model, [known]) == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20, 22))
def test_identify_takes_the_direct_route_to_a_plant_that_is_held(seed: int) -> None:
    record = held_by_a_servo(seed)
    if told_by_past([record]) == [None]:
        pytest.skip("such a loop moves too little to tell in one of eight")
    found = identify(record, (2, 0), throw=False)
    gain = found.parameters["b0"]
    assert found.route == "direct"
    assert [one.code for one in found.findings].count("feedback") == 1
    assert abs(gain.value - GAIN) < 3.5 * gain.std < GAIN


def test_what_explains_nothing_is_not_recommended_beside_what_explains_much() -> None:
    rng = np.random.default_rng(0)
    wave = np.sin(0.3 * np.arange(200))[:, None] / 10.0  # of a unit of energy
    level = (np.ones((200, 1)),)

    def unseen(left: float) -> Unseen:
        errors = left * (wave + 0.001 * rng.standard_normal((200, 1)))
        return Unseen((errors,), (level,))

    nothing, much = unseen(1.2), unseen(0.2)
    assert nothing.loss > 1.0
    assert much.loss < 0.5
    # whitened by a noise model of many coefficients both look alike
    trials = [
        Trial(2, nothing, unseen(0.1), sound=True, usable=True),
        Trial(8, much, unseen(0.1), sound=False, usable=True, vague=True),
    ]
    assert recommend(trials, 0, explains=True, sharp=True).place == 1
    # where none explains anything the likelihood decides
    alike = [replace(one, unseen=nothing) for one in trials]
    assert recommend(alike, 0, explains=True, sharp=True).place == 0
