"""Delays that join the candidates, beside what else is recorded at another time."""

from dataclasses import replace

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, select_structure, simulate
from tridentify.judgement.selection.late import delayed
from tridentify.judgement.selection.result import SelectionRow


def exchanger(seed: int | list[int]) -> Record:
    """Two lags and six samples of dead time beside a slow disturbance as large as they answer."""
    rng = np.random.default_rng(seed)
    u = 40.0 + 10.0 * np.repeat(rng.choice([-1.0, 0.0, 1.0], 25), 20)
    slow, fast = rng.uniform(25.0, 40.0), rng.uniform(6.0, 12.0)
    plant = TransferFunction([0.5], np.polymul([slow, 1.0], [fast, 1.0]))
    late = np.concatenate([np.full(6, u[0]), u[:-6]]) - u[0]
    y = simulate(plant, Record(late, u, dt=1.0))[:, 0]
    size, turns, begun = rng.uniform(2.0, 4.0), rng.uniform(0.3, 0.8), rng.random()
    y = y + size * np.sin(2.0 * np.pi * (turns * np.arange(500) / 500 + begun))
    return Record(u, 60.0 + y + 0.05 * rng.standard_normal(500), dt=1.0)


@pytest.mark.slow
def test_outputs_recorded_early_are_no_delay_of_a_candidate():
    """Beside a slow disturbance they explain more than any delay does."""
    chosen = select_structure(exchanger(4)).recommended
    assert chosen is not None
    assert chosen.estimate is not None
    assert np.all(chosen.estimate.model.delay >= 0.0)


def rows_of(record: Record, *structures: Structure) -> list[SelectionRow]:
    """What the selection knows of candidates before one is judged."""
    return [
        SelectionRow(
            one,
            identify(record, one, throw=False),
            n_coefficients=one.common_poles + 1,
        )
        for one in structures
    ]


@pytest.mark.unjudged
def test_one_lag_alone_gets_a_delay_where_a_drift_hides_its_worth() -> None:
    record = exchanger([32, 0])
    assert delayed(rows_of(record, Structure(1, 0)), 0, [record]) == [Structure(1, 0, delay="free")]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.unjudged
@pytest.mark.slow
def test_one_lag_and_two_get_a_delay_where_a_drift_hides_its_worth(seed: int) -> None:
    """Also beside a pole at zero that the drift made: the row with that pole free stands for it."""
    record = exchanger([32, seed])
    rows = rows_of(record, Structure(1, 0), Structure(2, 0), Structure(3, 0))
    wanted = [Structure(1, 0, delay="free"), Structure(2, 0, delay="free")]
    assert delayed(rows, 2, [record]) == wanted
    integrator = replace(rows[2], structure=Structure(3, 0, fixed={"a0": 0.0}))
    assert delayed([*rows, integrator], 3, [record]) == wanted
    assert delayed([*rows[:2], integrator], 2, [record]) == []
