"""How often the true order is recommended, over random plants, inputs, noise levels and colours.

Measured with this generator over many more draws than are run here; the limits leave room for the
sampling error of these.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, select_structure, simulate

CANDIDATES = [Structure(n, m) for n in range(1, 5) for m in range(n)]
DRAWS = 12
KNOWN = 0.5


def plant(rng):
    """Order 1 to 4, damped and resonant, with zeros, some of them not minimum-phase."""
    n = int(rng.integers(1, 5))
    kind = rng.choice(["damped", "resonant", "mixed"])
    poles, left = [], n
    while left:
        pair = kind == "resonant" or (kind == "mixed" and rng.random() < 0.5)
        if left >= 2 and pair:
            zeta = rng.uniform(0.05, 0.3) if kind == "resonant" else rng.uniform(0.3, 0.8)
            rate = np.exp(rng.uniform(np.log(0.4), np.log(3.0)))
            z = rate * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
            poles += [z, z.conjugate()]
            left -= 2
        else:
            poles.append(-np.exp(rng.uniform(np.log(0.3), np.log(3.0))))
            left -= 1
    zeros = -np.exp(rng.uniform(np.log(0.3), np.log(3.0), int(rng.integers(0, n))))
    if zeros.size and rng.random() < 0.3:
        zeros[0] = -zeros[0]
    den, num = np.real(np.poly(poles)), np.atleast_1d(np.real(np.poly(zeros)))
    return Structure(n, zeros.size), TransferFunction(num * den[-1] / num[-1], den)


def recorded(rng, model, kind):
    n = int(rng.choice([100, 250, 500, 1000]))
    dt = max(float(rng.choice([0.05, 0.1])), 12.0 / n)
    u = np.zeros(n)
    if kind == "prbs":
        hold = max(round(0.8 / dt), 1)
        u = np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]
    elif kind == "step":
        u[n // 20 :] = 1.0
    else:
        width, first = max(int(2.0 / dt), 2), n // 20
        u[first : first + width], u[first + width : first + 2 * width] = 1.0, -1.0
    y = simulate(model, Record(u, u, dt=dt))[:, 0]
    e = rng.standard_normal(n + 200)
    if rng.random() < 0.35:
        a = rng.uniform(0.5, 0.9)
        for k in range(1, e.size):
            e[k] += a * e[k - 1]
        e *= np.sqrt(1.0 - a**2)
    snr = float(rng.choice([20.0, 10.0, 5.0]))
    return Record(u, y + np.std(y) * 10.0 ** (-snr / 20.0) * e[200:], dt=dt)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", ["prbs", "step", "doublet"])
def test_the_true_order_is_recommended_where_the_record_shows_it(kind):
    right, high, right_by_aicc, shown = 0, 0, 0, 0
    for seed in range(DRAWS):
        rng = np.random.default_rng([2026, seed])
        truth, model = plant(rng)
        found = select_structure(recorded(rng, model, kind), CANDIDATES)
        own = found.rows[CANDIDATES.index(truth)]
        order = found.recommended.structure.poles
        high += order > truth.poles
        if not own.ok or own.relative_std > KNOWN:
            continue
        shown += 1
        right += order == truth.poles
        usable = [row for row in found.rows if row.ok]
        right_by_aicc += min(usable, key=lambda row: row.aicc).structure.poles == truth.poles
    assert shown >= DRAWS // 3
    # with a rate of 90 % fewer than 60 % of 8 have a probability of 0.5 %
    assert right >= 0.6 * shown
    assert right >= right_by_aicc
    # too high an order in 2 % of the draws: 3 of 12 and more have a probability of 0.15 %
    assert high <= 2
