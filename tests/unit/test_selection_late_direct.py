"""A direct part behind a delay: as many zeros as poles, and a delay that nothing else shows."""

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, select_structure, simulate
from tridentify.judgement.selection.late import direct_and_delayed
from tridentify.judgement.selection.result import SelectionRow

pytestmark = pytest.mark.unjudged
RATE = 2000.0


def record(seed: int, n: int, late: int, direct: bool) -> Record:
    """A loudspeaker, the microphone some samples away; or its cone's speed, which has no jumps."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 3 + 1), 3)[:n]
    w = 2 * np.pi * rng.uniform(40.0, 90.0)
    numerator = [2.0, 0.0, 0.0] if direct else [2.0 * w, 0.0]
    plant = TransferFunction(numerator, [1.0, 0.7 * w, w * w], delay=late / RATE)
    y = simulate(plant, Record(u, u, dt=1 / RATE))[:, 0]
    return Record(u, y + 0.1 * np.std(y) * rng.standard_normal(n), dt=1 / RATE)


def rows(seen: Record, orders: tuple[int, ...] = (1, 2)) -> list[SelectionRow]:
    """Candidates that know of no delay."""
    found = []
    for n in orders:
        asked = Structure(n, n - 1)
        one = identify(seen, asked, throw=False)
        found.append(SelectionRow(asked, one, fit=one.fit, n_coefficients=2 * n, ok=one.status.ok))
    return found


@pytest.mark.slow
@pytest.mark.judged
def test_it_is_tried_with_its_delay_where_nothing_explains_the_record() -> None:
    seen = record(1, 400, 14, direct=True)
    found = direct_and_delayed(rows(seen), 1, [seen])
    assert [(one.poles, one.zeros) for one in found] == [(1, 1), (2, 2)]
    # a held input tells a delay in whole samples there, and these are the ones
    assert [one.delay for one in found] == pytest.approx([14 / RATE] * 2)


@pytest.mark.judged
@pytest.mark.slow
def test_a_delay_alone_is_none() -> None:
    seen = record(2, 300, 9, direct=False)
    alone = rows(seen, (2,))
    assert alone[0].estimate is not None
    assert any(one.matters for one in alone[0].estimate.findings)
    assert direct_and_delayed(alone, 0, [seen]) == []


@pytest.mark.slow
@pytest.mark.judged
@pytest.mark.timeout(900)
def test_it_is_recommended() -> None:
    right = 0
    for seed in (11, 12, 13):
        chosen = select_structure(record(seed, 600, 10 + seed % 5, direct=True)).recommended
        assert chosen is not None
        orders = (chosen.structure.poles, chosen.structure.zeros)
        late = chosen.structure.delay
        right += orders == (2, 2) and late == pytest.approx((10 + seed % 5) / RATE)
    assert right >= 2
