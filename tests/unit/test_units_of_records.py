"""Units from a file to the coefficients, and records that do not agree about them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tridentify import METHODS, Record, Structure, errors, identify, read_record
from tridentify.estimation.machine_code import load_kernels
from tridentify.excitation import doublet
from tridentify.physical import PhysicalParameter

pytestmark = pytest.mark.unjudged

N = 200


@pytest.fixture(scope="module")
def arrays() -> tuple[np.ndarray, np.ndarray]:
    """A held square wave, and the exact step responses of 2/(s + 1) to it."""
    load_kernels()
    u = np.where(np.arange(N) // 25 % 2, -1.0, 1.0)
    y, state = np.empty(N), 0.0
    decay = np.exp(-0.05)
    for k in range(N):
        y[k] = state
        state = decay * state + 2.0 * (1.0 - decay) * u[k]
    return u, y


def record(arrays, **units: str) -> Record:
    return Record(*arrays, dt=0.05, input_names=["elevator"], output_names=["q"], units=units)


@pytest.mark.parametrize("method", METHODS)
def test_records_in_different_units_are_refused_by_every_method(arrays, method: str) -> None:
    pair = [record(arrays, elevator="deg"), record(arrays, elevator="rad")]
    with pytest.raises(
        errors.UnitMismatchError, match=r"units 'deg' and 'rad' of 'elevator'.*convert one"
    ) as caught:
        identify(pair, Structure(1, 0), METHODS[method]())
    assert isinstance(caught.value, errors.DataError)


@pytest.mark.parametrize(
    "pair", [({"q": "1/s"}, {"q": "s^-1"}), ({"q": "rad/s"}, {}), ({"t": "s"}, {"t": "ms"})]
)
def test_records_that_do_not_contradict_each_other_are_accepted(arrays, pair) -> None:
    first, second = pair
    identify([record(arrays, **first), record(arrays, **second)], Structure(1, 0))


def test_units_of_a_file_reach_the_coefficients(arrays, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = np.column_stack([50.0 * np.arange(N), *arrays]).tolist()
    text = "\n".join(",".join(map(repr, row)) for row in rows)
    path.write_text("t [ms],elevator [deg],q [deg/s]\n" + text)
    made = read_record(path, time="t", inputs=["elevator"], outputs=["q"])
    estimate = identify(made, Structure(1, 0, offset=False, initial_state="rest"))
    assert {name: item.unit for name, item in estimate.parameters.items()} == {
        "a0": "1/s",
        "b0": "1/s^2",
    }
    assert estimate.parameters["a0"].value == pytest.approx(1.0, rel=1e-6)
    assert "1/s^2" in estimate.summary()


def test_a_unit_in_a_file_that_is_not_printable_is_refused_by_its_channel(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(
        't,"u [*\\\n/ static void evil(void){} /]",y [deg\u00a0C]\n0,1,2\n1,2,3\n2,1,4\n'
    )
    with pytest.raises(errors.UnitError, match="for 'u'; expected printable") as caught:
        read_record(path, time="t", inputs=["u"], outputs=["y"])
    assert str(caught.value).isprintable()
    stated = read_record(path, time="t", inputs=["u"], outputs=["y"], units={"u": "rad"})
    assert dict(stated.units) == {"u": "rad", "y": "deg C"}


def test_a_unit_of_an_excitation_or_a_physical_parameter_is_checked() -> None:
    with pytest.raises(errors.UnitError, match="printable"):
        doublet(1.0, 1.0, dt=0.5).named(["u"], {"u": "V\n"})
    with pytest.raises(errors.UnitError, match="printable"):
        PhysicalParameter("m", "kg\u2028")
    with pytest.raises(errors.PhysicalParameterError, match="printable"):
        PhysicalParameter("m\n", "kg")


@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("minutes", 60.0),
        ("TimeUS", 1e-6),
        ("timeMs", 1e-3),
        ("t_hours", 3600.0),
        ("Zeit in Minuten", 60.0),
        ("ms", 1e-3),
        ("uptime_s", 1.0),
        ("ticks", 1.0),
    ],
)
def test_a_column_of_time_that_is_called_by_its_unit_counts_in_it(name: str, step: float) -> None:
    table = f"{name},u,y\n" + "".join(f"{k},{k % 3},{k % 5}\n" for k in range(8))
    record = read_record(table.encode(), time=name, inputs=["u"], outputs=["y"])
    assert record.dt == pytest.approx(step)


def test_a_column_of_minima_is_not_taken_for_time_by_its_name() -> None:
    table = "min,u,y\n" + "".join(f"{k},{k % 3},{k % 5}\n" for k in range(8))
    with pytest.raises(errors.SamplingError, match="name the column of time"):
        read_record(table.encode(), inputs=["u"], outputs=["y"])
