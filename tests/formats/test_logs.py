"""ULog and MDF4: names, clocks, units, invalid samples, and what their files may not do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tridentify import errors, list_channels, read_record
from tridentify.record.formats.mdf import plain_formula

pytestmark = pytest.mark.unisolated

FAST, SLOW = 0.01 * np.arange(20), 0.02 * np.arange(10)


# ------------------------------------------------------------------------------------------- ULog
@pytest.fixture
def flight(write, tmp_path: Path) -> Path:
    pytest.importorskip("pyulog", reason="needs pyulog, of the extra tridentify[ulog]")
    start = 5_000_000
    return write.ulog(
        tmp_path / "flight.ulg",
        {
            "servo": {"timestamp": start + 1e6 * SLOW, "angle": SLOW},
            "gyro": {"timestamp": start + 1e6 * FAST, "q[0]": FAST, "q[1]": -FAST},
            "gyro#1": {"timestamp": start + 1e6 * SLOW, "q[0]": 7 + SLOW, "q[1]": -SLOW},
        },
        {"angle": "float"},
    )


def test_a_channel_is_a_field_of_a_topic(flight: Path) -> None:
    found = {c.header: (c.unit, c.clock, c.samples) for c in list_channels(flight)}
    assert found["servo.angle"] == ("", "servo", 10)
    assert found["gyro#1.q[0]"] == ("", "gyro#1", 10)
    assert found["gyro.timestamp"] == ("us", "gyro", 20)


def test_topics_come_onto_one_time_base(flight: Path) -> None:
    record = read_record(
        flight,
        inputs=["servo.angle"],
        outputs=["gyro.q[1]", "gyro#1.q[0]"],
        units={"servo.angle": "deg"},
    )
    assert record.dt == pytest.approx(0.01)
    np.testing.assert_allclose(record.t, 5.0 + FAST[:19])
    np.testing.assert_allclose(record.y[:, 0], -FAST[:19])
    np.testing.assert_allclose(record.y[::2, 1], 7 + SLOW)
    assert np.isnan(record.y[1::2, 1]).all()
    np.testing.assert_allclose(record.u[:, 0], np.repeat(SLOW, 2)[:19], rtol=1e-6)
    assert dict(record.units) == {"servo.angle": "deg"}


def test_a_time_of_another_topic_is_not_taken(flight: Path) -> None:
    record = read_record(
        flight, time="gyro.timestamp", inputs=["gyro.q[0]"], outputs=["gyro.q[1]"], start=5.1
    )
    assert (record.n_samples, record.units["t"]) == (10, "s")


def test_a_log_cut_off_in_a_message_is_read_up_to_there(flight: Path) -> None:
    content = flight.read_bytes()
    flight.write_bytes(content[:-5])
    assert {c.header: c.samples for c in list_channels(flight)}["gyro.q[0]"] == 19


# ------------------------------------------------------------------------------------------- MDF4
@pytest.fixture(scope="module")
def asammdf():
    return pytest.importorskip("asammdf", reason="needs asammdf, of the extra tridentify[mdf]")


@pytest.mark.slow
def test_groups_have_clocks_of_their_own_and_invalid_samples_are_missing(
    asammdf, tmp_path: Path
) -> None:
    path = tmp_path / "bench.mf4"
    invalid = np.arange(10) == 3
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(FAST, FAST, name="u", unit="V")])
        signal = asammdf.Signal(SLOW, SLOW, name="speed", unit="1/min", invalidation_bits=invalid)
        file.append([signal, asammdf.Signal(-SLOW, SLOW, name="u", unit="A")])
        file.save(path)
    listed = {c.header: (c.unit, c.clock, c.samples) for c in list_channels(path)}
    assert listed["group0.u"] == ("V", "group0", 20)
    assert listed["speed"] == ("1/min", "group1", 10)
    record = read_record(path, inputs=["group0.u"], outputs=["speed"])
    assert dict(record.units) == {"u": "V", "speed": "1/min"}
    np.testing.assert_array_equal(record.u[:, 0], FAST)
    expected = np.where(invalid, np.nan, SLOW)
    np.testing.assert_array_equal(record.y[::2, 0], expected)
    with pytest.raises(errors.DuplicateColumnError, match=r"group0\.u or group1\.u"):
        read_record(path, inputs=["u"], outputs=["speed"])


@pytest.mark.slow
def test_linear_conversions_are_applied_and_formulas_only_if_plain(asammdf, tmp_path: Path) -> None:
    path, mark = tmp_path / "bench.mf4", tmp_path / "executed"
    raw = np.arange(10, dtype=np.int16)
    hostile = f"__import__('os').mkdir('{mark}')"
    conversions = {"u": {"a": 0.5, "b": 1.0}, "y": {"formula": "X*X+1"}, "z": {"formula": hostile}}
    with asammdf.MDF(version="4.10") as file:
        file.append(
            [
                asammdf.Signal(raw, SLOW, name=name, conversion=conversion)
                for name, conversion in conversions.items()
            ]
        )
        file.save(path)
    record = read_record(path, inputs=["u"], outputs=["y"])
    np.testing.assert_allclose(record.u[:, 0], 0.5 * raw + 1.0)
    np.testing.assert_allclose(record.y[:, 0], raw**2 + 1.0)
    with pytest.raises(errors.ForeignObjectError, match="expected arithmetic in X"):
        read_record(path, inputs=["u"], outputs=["z"])
    assert not mark.exists()


@pytest.mark.parametrize(
    ("formula", "plain"),
    [
        ("X", True),
        ("2.5*X1 - 3e-2/(1+X^2)", True),
        ("sin(X) + .5", True),
        ("where(X > 3, X, 0)", True),
        ("X.real", False),
        ("X .real", False),
        ("1.real", False),
        ("__import__('os')", False),
        ("open('x')", False),
        ("X; X", False),
        ("X[0]", False),
        ("lambda: X", False),
        ("'a'*X", False),
        ("X+" * 600 + "X", False),
    ],
)
def test_formulas(formula: str, plain: bool) -> None:
    assert plain_formula(formula) is plain
