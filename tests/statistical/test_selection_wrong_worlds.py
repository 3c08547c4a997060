"""Order selection where no candidate is the true system, as on every measured record.

A plant of order two, as it is recorded: with gusts, drift, a sensor that rounds, an actuator and a
filter that nobody models, a spring that stiffens, an input that was measured, surroundings that
warm up, a sensor that ends. More poles always explain some of it, none of them is of the plant.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tridentify import Record, Structure, TransferFunction, select_structure, simulate

DT, COUNT = 0.05, 400
PLANT = TransferFunction([3.0, 4.0], [1.0, 2.2, 9.0])
CANDIDATES = [Structure(n, m) for n in range(1, 5) for m in range(n)]


def manoeuvre(rng):
    """3-2-1-1 twice, as a pilot flies it."""
    steps = np.concatenate([np.ones(14), -np.ones(10), np.ones(5), -np.ones(5)])
    u = np.zeros(COUNT)
    u[20:54], u[200:234] = steps, -steps
    return np.convolve(u, np.ones(3) / 3.0, mode="same") + 0.01 * rng.standard_normal(COUNT)


def slow(rng, rate):
    """Noise with a memory of ``1/rate`` seconds, of variance one."""
    e, keep = rng.standard_normal(COUNT), np.exp(-rate * DT)
    for k in range(1, COUNT):
        e[k] = keep * e[k - 1] + np.sqrt(1.0 - keep**2) * e[k]
    return e


def plain(u):
    return simulate(PLANT, Record(u, u, dt=DT, intersample="foh"))[:, 0]


def recorded(kind, seed):
    rng = np.random.default_rng([2031, seed])
    u = manoeuvre(rng)
    y = plain(u)
    size = np.std(y)
    if kind == "drift":
        y = y + 0.1 * size * np.cumsum(rng.standard_normal(COUNT)) / np.sqrt(COUNT)
    elif kind == "gusts":
        y = y + 0.15 * plain(slow(rng, 2.0)) * size / np.std(plain(slow(rng, 2.0)))
    elif kind == "rounding":
        quantum = 0.1 * size
        y = quantum * np.round(y / quantum)
    elif kind == "fast modes":
        lags = TransferFunction([1800.0], [1.0, 85.0, 1800.0])
        y = plain(simulate(lags, Record(u, u, dt=DT, intersample="foh"))[:, 0])
    elif kind == "cubic spring":
        force = lambda t: np.interp(t, DT * np.arange(COUNT), u)  # noqa: E731
        found = solve_ivp(
            lambda t, x: [x[1], force(t) - 2.2 * x[1] - 9.0 * x[0] - 60.0 * x[0] ** 3],
            (0.0, DT * (COUNT - 1)), [0.0, 0.0], t_eval=DT * np.arange(COUNT), max_step=DT,
        )  # fmt: skip
        y = 4.0 * found.y[0] + 3.0 * found.y[1]
    elif kind == "measured input":
        u = u + 0.03 * rng.standard_normal(COUNT)
    elif kind == "surroundings":
        # they warm up with what is at work, and are not warm by the end of the record
        slowly = TransferFunction([0.1], [1.0, 0.02])
        rise = simulate(slowly, Record(np.abs(y), y, dt=DT, intersample="foh"))[:, 0]
        y = y + 0.15 * size * rise / np.std(rise)
    elif kind == "saturation":
        y = np.clip(y, -0.75 * np.max(np.abs(y)), 0.75 * np.max(np.abs(y)))
    y = y + 0.01 * np.std(y) * rng.standard_normal(COUNT)
    return Record(u, y, dt=DT, intersample="foh")


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "kind",
    [
        *("gusts", "drift", "rounding", "cubic spring", "measured input"),
        *("surroundings", "saturation"),
    ],
)
def test_the_plants_poles_are_recommended_and_no_more(kind):
    found = select_structure(recorded(kind, 1), CANDIDATES)
    assert found.recommended.structure.poles == 2
    assert not found.recommended.doubts


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_lags_that_are_seen_get_a_pole_and_leave_the_plants_poles_right():
    found = select_structure(recorded("fast modes", 1), CANDIDATES)
    plant, own, short = (
        sort_by_size(np.roots(den))
        for den in (
            PLANT.den[0][0],
            found.recommended.estimate.model.den[0][0],
            found.rows[CANDIDATES.index(Structure(2, 1))].estimate.model.den[0][0],
        )
    )
    assert np.allclose(own[:2], plant, rtol=0.03)
    # what stands for lags of 35 and 50 rad/s
    assert own.size > 2
    assert np.all(np.abs(own[2:]) > 4.0 * np.abs(plant[0]))
    # two poles predict clearly worse, and are not those of the plant
    poor, good = found.rows[CANDIDATES.index(Structure(2, 1))], found.recommended
    assert poor.cross_fit[0] < good.cross_fit[0] - 5.0
    assert not np.allclose(short, plant, rtol=0.03)


def sort_by_size(poles):
    return poles[np.lexsort((poles.imag, np.abs(poles).round(9)))]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_where_none_explains_the_record_it_is_said_and_the_smallest_useful_is_named():
    found = select_structure(recorded("cubic spring", 3), CANDIDATES[:6])
    assert found.recommended.structure.poles == 2
    assert "does not explain the record: the smallest useful model" in found.reason
