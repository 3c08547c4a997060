"""A model of one flight on another: what `compare` says of it, whatever the trim."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, compare, identify, read_record, simulate, validate

pytestmark = pytest.mark.unjudged


@pytest.mark.slow
def test_a_model_of_one_flight_explains_another_at_any_trim(folder, judged):
    first, second = (
        read_record(
            folder("attas-short-period") / name, time="t", inputs=["u_elevator"], outputs=["y_q"],
            intersample="foh",
        )
        for name in ("data.csv", "data_2.csv")
    )  # fmt: skip
    model = identify(first, Structure(2, 1))
    moved = Record(
        second.u + 1.0, second.y + 2.0, t=second.t, intersample="foh",
        input_names=second.input_names, output_names=second.output_names, name="moved",
    )  # fmt: skip
    fits = compare(model, [first, second, moved]).fits[0, :, 0]
    assert fits[1] == pytest.approx(judged(model.model, second)[0], abs=1e-6)
    assert fits[2] == pytest.approx(fits[1], abs=1e-6)
    assert fits[0] > 94.0
    assert fits[1] > 92.0
    assert fits[1] == pytest.approx(validate(model, second).fit[0], abs=2.0)

    def plain(response, record):
        y = record.y[:, 0]
        return 100.0 * (1.0 - np.linalg.norm(y - response[:, 0]) / np.linalg.norm(y - y.mean()))

    # where the start and the offset of the first flight are held, or none are taken
    assert plain(model.predict(moved), moved) < 50.0
    assert plain(simulate(model, second), second) < 50.0
