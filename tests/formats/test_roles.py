"""What each channel of a file is taken for at first."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.record.formats.roles import guess_roles

N = 400


def steps(seed):
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], N // 20), 20)


def wave(seed):
    return np.cumsum(np.random.default_rng(seed).standard_normal(N))


def roles(**channels):
    found = guess_roles(list(channels), list(channels.values()))
    return dict(zip(channels, found, strict=True))


def alike(kind, *names):
    return {name: kind(seed) for seed, name in enumerate(names)}


@pytest.mark.parametrize(
    ("names", "inputs", "outputs", "references"),
    [
        (("u_elevator", "y_q", "y_alpha", "y_theta", "y_V"), ["u_elevator"], ["y_q"], []),
        (("u1", "u2", "r1", "r2", "y1", "y2"), ["u1", "u2"], ["y1", "y2"], ["r1", "r2"]),
        (("u_volt", "y_pos", "r_pos"), ["u_volt"], ["y_pos"], ["r_pos"]),
        (("u_heater1", "u_heater2", "y_T1", "y_T2"), ["u_heater1", "u_heater2"],
         ["y_T1", "y_T2"], []),
        (("steam_valve", "load", "pressure", "speed"), ["steam_valve", "load"],
         ["pressure", "speed"], []),
        (("current", "voltage"), ["current"], ["voltage"], []),
        (("iq_ref", "iq_cmd", "theta_m", "omega_m", "theta_l"), ["iq_cmd"], ["theta_m"],
         ["iq_ref"]),
        (("u", "y_current"), ["u"], ["y_current"], []),
        (("rudder", "r", "u_m_s"), ["rudder"], ["r", "u_m_s"], []),
    ],
)  # fmt: skip
def test_names_tell(names, inputs, outputs, references):
    found = roles(**alike(wave, *names))
    for role, wanted in (("input", inputs), ("output", outputs), ("reference", references)):
        assert [name for name in names if found[name] == role] == wanted


def test_without_names_what_moves_in_steps_is_an_input():
    channels = {"a": steps(1), "b": wave(2), "c": steps(3), "d": wave(4)}
    assert roles(**channels) == {"a": "input", "b": "output", "c": "input", "d": "output"}


def test_where_all_are_alike_the_first_is_the_input():
    assert roles(**alike(wave, "a", "b")) == {"a": "input", "b": "output"}
    assert roles(**alike(steps, "a", "b")) == {"a": "input", "b": "output"}


def test_what_stands_still_is_not_used():
    assert roles(u=steps(1), y=wave(2), spare=np.ones(N))["spare"] == "unused"


def test_clocks_and_counters_are_no_signals():
    t = np.linspace(35.1, 95.1, 200)
    names = ["timestamp", "setpoint", "y", "duty", "t_rel", "sample"]
    samples = [
        1.7e9 + t,
        np.sign(np.sin(0.1 * t)),
        np.cos(t),
        np.sign(np.sin(t)),
        t,
        np.arange(200),
    ]
    found = guess_roles(names, samples)
    assert found == ["unused", "reference", "output", "input", "unused", "unused"]
    # a shaft's time constant is a signal as long as it does not only grow
    assert guess_roles(["u", "settling_time"], [np.sign(np.sin(t)), np.cos(t)])[1] == "output"
