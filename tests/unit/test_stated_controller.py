"""A kind of controller that was stated and is not what the record shows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from oracles import binary, companion
from tridentify import Record, Structure, ThreeModel
from tridentify.estimation.methods.by_reference.controller_kind import assumed

pytestmark = pytest.mark.unjudged
DT, FINE = 0.06, 4
UNSTABLE = ([3.0], [1.0, 0.6, -9.0])
STABLE = ([3.0], [1.0, 1.2, 4.0])
LAWS = {
    "unstable": companion([30.0, 90.0], [1.0, 10.0]),
    "stable": companion([8.0, 30.0], [1.0, 10.0]),
}
"""Lead; each in continuous time."""


def loop(
    name: str,
    sampled: bool,
    seed: int = 1,
    count: int = 200,
    noise: float = 0.02,
    stays: int = 0,
) -> Record:
    """Step by step on a fine grid, every step an exponential; ``u = -C (y + v) + r``.

    The noise moves between the samples, and a sampled controller holds what it made of one. One
    that is not is a computer with `FINE` steps a sample, so that ``a1`` is off as continuous, too.
    With ``stays`` the noise stays as it is for so many samples.
    """
    a, b, c, _ = companion(*(UNSTABLE if name == "unstable" else STABLE))
    e, f, g, d = LAWS[name]
    step, n = DT / FINE, len(a)
    held = expm(np.block([[a, b[:, None]], [np.zeros((1, n + 1))]]) * step)
    own = expm(np.block([[e, f[:, None]], [np.zeros((1, len(e) + 1))]]) * (DT if sampled else step))
    r = binary(count, 8, seed)
    v = lfilter([1.0], [1.0, -0.7], np.random.default_rng(seed).standard_normal(count * FINE))
    if stays:
        v = np.repeat(v[::FINE][: count // stays + 1], stays * FINE)
    x, z, u, y = np.zeros(n), np.zeros(len(e)), np.empty(count), np.empty(count)
    for k in range(count):
        for j in range(FINE):
            seen = c @ x + noise * v[k * FINE + j]
            if j == 0 or not sampled:
                now = g @ z - d * seen + r[k]
                z = own[:-1, :-1] @ z - own[:-1, -1] * seen
            if j == 0:
                u[k], y[k] = now, seen
            x = held[:-1, :-1] @ x + held[:-1, -1] * now
    return Record(u, y, dt=DT, reference=r)


def said(name: str, sampled: bool, stated: str, **how):
    record = loop(name, sampled, **how)
    found = ThreeModel(controller=stated, noise="white").estimate([record], Structure(2, 0))
    plant = UNSTABLE if name == "unstable" else STABLE
    truth = np.array([*plant[1][1:], *plant[0]])
    told = [one for one in found.findings if one.code == "intersample"]
    return told, np.max(np.abs(found.theta - truth) / found.std)


UNSTABLE_ONES = [pytest.param("unstable", k, marks=pytest.mark.slow) for k in range(3, 9)]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("stable", 3), *UNSTABLE_ONES])
def test_sampled_and_stated_as_continuous(name, seed):
    """An answer beyond its intervals is an error; errors that allow for it leave a warning."""
    told, off = said(name, True, "continuous", seed=seed)
    [one] = [one for one in told if "stated as continuous" in one.message]
    assert one.severity == ("error" if off > 3.0 else "warning")
    assert off > 3.0 or name == "unstable"
    assert "standard errors" in one.effect
    assert "sampled" in one.remedy


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_continuous_and_stated_as_sampled(seed):
    [one], _ = said("unstable", False, "sampled", seed=seed)
    assert "stated as sampled" in one.message
    assert one.severity == "warning"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_that_stays_for_samples_leaves_a_rule_that_is_too_long(seed):
    """Of a continuous controller; that of a sampled one is as short as ever."""
    told, off = said("stable", False, "sampled", seed=seed, count=600, noise=0.01, stays=3)
    assert off > 3.0
    [one] = [one for one in told if "stated as sampled" in one.message]
    assert one.severity == "warning"
    assert "standard errors" in one.effect
    told, _ = said("stable", True, "sampled", seed=seed, count=600, noise=0.01, stays=3)
    assert not any("stated" in one.message for one in told)


@pytest.mark.parametrize("sampled", [True, False])
def test_what_the_input_shows_of_it(sampled):
    record = loop("stable", sampled, count=150)
    kinds = {kind: assumed(kind, [record], Structure(2, 0)) for kind in ("sampled", "continuous")}
    assert all(one.stated for one in kinds.values())
    assert bool(kinds["continuous"].against) is sampled
    assert (kinds["sampled"].missing is not None) is not sampled


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stable", "unstable"])
def test_no_alarm_of_what_is_stated_rightly(name):
    for seed in range(20, 28):
        for sampled, stated in ((True, "sampled"), (False, "continuous")):
            told, _ = said(name, sampled, stated, seed=seed)
            assert not any("stated" in one.message for one in told)
