"""Public records that are not part of this repository, and how a model is judged on one of them."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, TransferFunction, simulate
from tridentify.models.simulate import free_responses


@pytest.fixture(scope="session")
def folder(shared_data):
    """The folder of one set of records, by name."""

    def find(name):
        path = shared_data / name
        if not path.is_dir():
            pytest.skip(f"no {name} among the shared records")
        return path

    return find


@pytest.fixture(scope="session")
def judged():
    """NRMSE fit [percent] of a model that is held, on a record it has not seen.

    Only a free initial state and an offset are fitted, by plain linear regression.
    """

    def judge(model, record):
        seen = Record(
            record.u - record.u[0], record.y, dt=record.dt, intersample=record.intersample
        )
        plain = TransferFunction([list(row) for row in model.num], [list(row) for row in model.den])
        response, found = simulate(plain, seen), []
        for i in range(record.n_outputs):
            columns = [
                free_responses(den, seen) for den in {d.tobytes(): d for d in model.den[i]}.values()
            ]
            table = np.column_stack([*columns, np.ones(record.n_samples)])
            table = table / np.linalg.norm(table, axis=0)
            y = record.y[:, i]
            left = y - response[:, i]
            left = left - table @ np.linalg.lstsq(table, left, rcond=None)[0]
            found.append(100.0 * (1.0 - np.linalg.norm(left) / np.linalg.norm(y - y.mean())))
        return np.array(found)

    return judge
