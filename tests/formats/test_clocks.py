"""Channels of different clocks on one time base: outputs are never altered, inputs follow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tridentify import errors
from tridentify.record.formats.assemble import Wanted, record_from
from tridentify.record.formats.channels import Channel

pytestmark = pytest.mark.unisolated


class Logged:
    """Channels with a clock each."""

    path = Path("log.ulg")

    def __init__(self, **signals: tuple[Sequence[float], Sequence[float]]) -> None:
        self.signals = {
            k: (np.array(t, float), np.array(v, float)) for k, (t, v) in signals.items()
        }
        self.channels = tuple(
            Channel(name, name, "", name, len(values)) for name, (_, values) in self.signals.items()
        )

    def read(self, indices):
        return [self.signals[self.channels[index].name][1] for index in indices]

    def instants(self, clock):
        return self.signals[clock][0]

    def place(self, row):
        return f"sample {row}"


def record(source: Logged, outputs: Sequence[str] = ("y",), **options):
    return record_from(source, Wanted(["u"], list(outputs), **options), "log")


FAST = np.arange(0, 1.0001, 0.1)


def test_slow_outputs_on_the_raster_of_the_input_leave_gaps() -> None:
    made = record(Logged(u=(FAST, FAST), y=(FAST[::2], FAST[::2])))
    assert made.dt == pytest.approx(0.1)
    np.testing.assert_array_equal(made.u[:, 0], FAST)
    np.testing.assert_array_equal(np.isnan(made.y[:, 0]), np.arange(11) % 2 == 1)
    np.testing.assert_array_equal(made.y[::2, 0], FAST[::2])


@pytest.mark.parametrize(("how", "value"), [("zoh", 0.2), ("foh", 0.25)])
def test_an_input_follows_from_what_it_does_between_samples(how: str, value: float) -> None:
    source = Logged(u=(FAST, FAST), y=([0.25, 0.55, 0.85], [1, 2, 3]))
    made = record(source, intersample=how, instants="outputs")
    np.testing.assert_allclose(made.t, [0.25, 0.55, 0.85])
    assert made.u[0, 0] == pytest.approx(value)
    np.testing.assert_array_equal(made.y[:, 0], [1, 2, 3])


def test_auto_takes_the_outputs_where_all_are_no_raster_and_all_loses_nothing() -> None:
    source = Logged(u=(FAST, FAST), y=([0.25, 0.55, 0.87], [1, 2, 3]))
    np.testing.assert_allclose(record(source).t, [0.25, 0.55, 0.87])
    made = record(source, instants="all")
    assert made.n_samples == 14
    np.testing.assert_allclose(made.u[np.isnan(made.y[:, 0]), 0], FAST)
    np.testing.assert_array_equal(made.y[~np.isnan(made.y[:, 0]), 0], [1, 2, 3])


def test_instants_apart_by_rounding_are_one() -> None:
    made = record(Logged(u=(FAST, FAST), y=(FAST + 1e-9, 2 * FAST)))
    assert made.n_samples == 11
    np.testing.assert_array_equal(made.y[:, 0], 2 * FAST)
    np.testing.assert_array_equal(made.u[:, 0], FAST)


def test_outputs_of_two_clocks_are_spread() -> None:
    source = Logged(u=(FAST, FAST), y=([0.2, 0.4], [1, 2]), z=([0.31, 0.42], [3, 4]))
    made = record(source, ["y", "z"], instants="outputs")
    np.testing.assert_allclose(made.t, [0.2, 0.31, 0.4, 0.42])
    np.testing.assert_array_equal(made.y, [[1, np.nan], [np.nan, 3], [2, np.nan], [np.nan, 4]])


def test_where_the_input_is_not_known_there_is_no_record() -> None:
    source = Logged(u=([0.3, 0.4, 0.5], [0, 1, 2]), y=(FAST, FAST))
    made = record(source)
    assert (made.t[0], made.t[-1]) == (pytest.approx(0.3), pytest.approx(0.5))
    apart = Logged(u=([5, 6], [0, 1]), y=(FAST, FAST))
    with pytest.raises(errors.EmptyRangeError, match="recorded at the same time"):
        record(apart)


def test_a_reference_of_its_own_clock_follows_like_an_input() -> None:
    source = Logged(u=(FAST, FAST), y=(FAST, 2 * FAST), r=([0.0, 0.35, 0.95], [0.0, 5.0, 7.0]))
    made = record(source, references=["r"], instants="outputs")
    np.testing.assert_allclose(made.t, FAST[:10])
    np.testing.assert_array_equal(made.u[:, 0], FAST[:10])
    np.testing.assert_array_equal(made.reference[:, 0], 5.0 * (FAST[:10] > 0.35))
    lines = record(
        source, references=["r"], instants="outputs", intersample="zoh", reference_intersample="foh"
    )
    np.testing.assert_allclose(lines.reference[:4, 0], 5.0 * FAST[:4] / 0.35)
    assert (lines.intersample, lines.reference_intersample) == ("zoh", "foh")
    blank = Logged(u=(FAST, FAST), y=(FAST, FAST), r=([0.0, 0.35, 0.95], [0.0, np.nan, 7.0]))
    with pytest.raises(errors.NotFiniteError, match=r"reference 'r' at 0\.4 s"):
        record(blank, references=["r"], instants="outputs")
    apart = Logged(u=(FAST, FAST), y=(FAST, FAST), r=([5.0, 6.0], [0.0, 1.0]))
    with pytest.raises(errors.EmptyRangeError, match="all inputs and references are known"):
        record(apart, references=["r"])


def test_refusals() -> None:
    source = Logged(u=(FAST, np.where(FAST > 0.5, np.nan, 1)), y=(FAST[::2], FAST[::2]))
    with pytest.raises(errors.NotFiniteError, match=r"input 'u' at 0\.6 s"):
        record(source)
    assert record(Logged(u=(FAST, FAST), y=(FAST[::2], FAST[::2])), dt=0.1).dt == 0.1
    with pytest.raises(errors.NonUniformTimeError, match=r"expected 0\.05 s"):
        record(Logged(u=(FAST, FAST), y=(FAST[::2], FAST[::2])), dt=0.05)
    with pytest.raises(errors.TimeNotIncreasingError):
        record(Logged(u=([0, 0, 1], [0, 1, 2]), y=(FAST, FAST)))
    with pytest.raises(errors.OptionError, match="'auto', 'outputs' or 'all'"):
        record(source, instants="inputs")
