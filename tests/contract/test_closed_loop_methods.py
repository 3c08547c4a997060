"""What every method with a reference keeps: the truth, and refusals in one line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    ClosedLoopRefinedInstrumentalVariable,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.errors import DataError, OptionError, UnsupportedError
from tridentify.estimation.closed_loop.driven import driven, shown_by_samples
from tridentify.estimation.closed_loop.simulated import Simulated, closed, simulated
from tridentify.judgement.choice import METHODS_IN_LOOP

pytestmark = pytest.mark.unjudged

TRUE = np.array([1.0, 2.0, 3.0])
PLANT = TransferFunction([3.0], [1.0, 1.0, 2.0])
LAW = TransferFunction([1.0, 1.0], [1.0, 0.0])
DT = 0.02

MAKERS: dict[str, Callable[[], Any]] = {
    "three-model": lambda: ThreeModel(controller="continuous", noise="white"),
    "three-model, controller given": lambda: ThreeModel(controller=LAW, noise="white"),
    "clsrivc": lambda: ClosedLoopRefinedInstrumentalVariable(LAW),
    **METHODS_IN_LOOP,
}
DIRECT: dict[str, ThreeModel] = {
    "direct output error": ThreeModel(route="open-loop", noise="white"),
    "direct, noise model": ThreeModel(route="direct"),
}
"""Of the input as it is: what to make of a reference they do not ask."""


def loop_record(
    entry: Any = "set point", size: float = 0.0, n: int = 600, seed: int = 0, dt: float = DT
) -> Record:
    """A continuous loop, exactly at the samples; noise at the output is held and fed back."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], n), 25)[:n]
    e = rng.standard_normal(n)
    v = size * np.asarray(lfilter([1.0], [1.0, -0.9], e))
    to_u = closed(PLANT, LAW, [entry, "set point"])
    # what the reference makes of the output is G times what it makes of the input; noise enters
    # like a set point of the other sign, and adds to what is measured
    rows, dens = [], []
    for column in range(2):
        rows.append(np.polymul(to_u.num[0][column], PLANT.num[0][0]))
        dens.append(np.polymul(to_u.den[0][column], PLANT.den[0][0]))
    both = TransferFunction(
        [[to_u.num[0][0], to_u.num[0][1]], rows], [[to_u.den[0][0], to_u.den[0][1]], dens]
    )
    inputs = np.column_stack([r, -v])
    found = simulate(both, Record(inputs, inputs, dt=dt, intersample="zoh"))
    return Record(found[:, 0], found[:, 1] + v, dt=dt, reference=r, reference_intersample="zoh")


@pytest.mark.parametrize("key", list(MAKERS))
@pytest.mark.parametrize("entry", ["input", "set point"])
@pytest.mark.fast("input-clsrivc", "set point-two-stage", "input-projection")
def test_truth_without_noise(key: str, entry: str) -> None:
    """Fine samples without noise: what is left is the error between the samples."""
    # the projection knows nothing of the loop's dynamics, and needs a record of many responses
    record = loop_record(entry, n=3000 if key == "projection" else 200)
    found = MAKERS[key]().estimate([record], Structure(2, 0))
    assert found.status.ok
    assert np.allclose(found.theta, TRUE, rtol=0.05)
    assert found.route == "reference"
    assert found.method == MAKERS[key]().name


@pytest.mark.parametrize("key", list(DIRECT))
@pytest.mark.parametrize("entry", ["input", "set point"])
@pytest.mark.slow
def test_truth_without_noise_or_a_reference(key: str, entry: str) -> None:
    """Without noise there is nothing in the input that should not be."""
    whole = loop_record(entry, n=200)
    for record in (whole, Record(whole.u, whole.y, dt=DT)):
        found = DIRECT[key].estimate([record], Structure(2, 0))
        assert found.status.ok
        assert np.allclose(found.theta, TRUE, rtol=0.05)
        assert found.route == DIRECT[key].route


@pytest.mark.parametrize("key", list(MAKERS))
def test_a_record_without_a_reference_is_refused_in_one_line(key: str) -> None:
    whole = loop_record()
    record = Record(whole.u, whole.y, dt=DT)
    method = MAKERS[key]()
    if isinstance(method, ThreeModel):
        method = ThreeModel(route="reference", controller=method.controller)
    with pytest.raises(OptionError, match=r"without a reference; expected .*; write ") as refused:
        identify(record, Structure(2, 0), method)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize("entry", ["input", "set point"])
def test_where_the_reference_enters_is_found_and_told(entry: str) -> None:
    record = loop_record(entry, 0.05, n=300)
    part = simulated(record, PLANT, LAW)
    assert isinstance(part, Simulated)
    assert part.entries == (entry,)
    found = ThreeModel(controller=LAW, noise="white").estimate([record], Structure(2, 0))
    words = "u = r - C y" if entry == "input" else "u = C (r - y)"
    assert any(words in one for one in found.trace.decisions)
    assert found.status.ok
    assert np.allclose(found.theta, TRUE, rtol=0.15)  # its noise is not the white one stated


@pytest.mark.parametrize("entry", ["input", "set point"])
def test_simulated_input_is_the_loops_own(entry: str) -> None:
    """At the samples without error, and as means over pieces to second order."""
    record = loop_record(entry)
    part = simulated(record, PLANT, LAW)
    assert part is not None
    assert np.allclose(part.inputs, record.u, atol=1e-9)
    pieces = part.inputs_between(4)
    fine = loop_record(entry, n=600)
    raster = Record(
        np.repeat(np.asarray(fine.reference), 400, axis=0),
        np.zeros((600 * 400, 1)),
        dt=DT / 400,
        intersample="zoh",
    )
    exact = simulate(part.transfer, raster)[:, 0].reshape(-1, 100)
    means = 0.5 * (exact + np.column_stack([exact[:, 1:], exact[:, -1]])).mean(axis=1)
    assert np.allclose(pieces[:, 0] - pieces[:, 0].mean(), means - means.mean(), atol=2e-3)


@pytest.mark.slow
def test_a_controller_of_the_wrong_sign_is_refused() -> None:
    wrong = TransferFunction([-10.0, -10.0], [1.0, 0.0])
    with pytest.raises(DataError, match="makes no stable loop"):
        ThreeModel(controller=wrong, noise="white").estimate([loop_record(n=200)], Structure(2, 0))


@pytest.mark.parametrize("key", ["three-model, controller given", "clsrivc"])
def test_loops_that_cannot_be_simulated_are_refused(key: str) -> None:
    record = loop_record()
    method = MAKERS[key]()
    if isinstance(method, ThreeModel):
        with pytest.raises(UnsupportedError, match="found a delay"):
            method.estimate([record], Structure(2, 0, delay=0.1))
    two = Record(np.hstack([record.u, record.y]), record.y, dt=DT, reference=record.reference)
    with pytest.raises(UnsupportedError, match="found 2 inputs and 1 outputs"):
        method.estimate([two], Structure(2, 0))


def test_no_transfer_function_is_refused() -> None:
    with pytest.raises(OptionError, match="expected a TransferFunction"):
        ClosedLoopRefinedInstrumentalVariable("PI")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="or a TransferFunction"):
        ThreeModel(controller="PI")  # type: ignore[arg-type]


def test_operators_do_not_swing_between_samples() -> None:
    """Fast operators fit the samples of a coarse record however they swing between these."""
    record = loop_record("input", 0.02, 400, 3, dt=0.1)
    part = driven(record, between=True)
    assert part.order <= shown_by_samples(part.rate * 0.1)
    assert np.abs(part.inputs_between(1)).max() < 2.0 * np.abs(part.inputs).max()
