"""The reference of a closed loop: checked like an input, and kept by whatever makes a record."""

from __future__ import annotations

import inspect
import pickle
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tridentify import (
    Estimate,
    Structure,
    TransferFunction,
    errors,
    identify,
    online,
    simulate,
)
from tridentify.cli.validate_command import renamed
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.estimation.likelihood.setup.raster import on_raster
from tridentify.plots import plot_record
from tridentify.record.checks.references import settled_reference
from tridentify.record.formats.frames import frame_from_record, record_from_frame
from tridentify.record.record import Record
from tridentify.report.settings import code_again, settings_table

U, Y, R = [0.0, 1.0, 1.0, 0.0], [0.0, 0.5, 0.8, 0.6], [0.0, 2.0, 2.0, 2.0]


def loop(n: int = 400, dt: float = 0.01, **options: object) -> Record:
    """A record with two references, both held."""
    t = np.arange(n) * dt
    r = np.column_stack([np.sign(np.sin(2.0 * t)), np.where(t > 1.0, 1.0, 0.0)])
    given = {
        "reference": r,
        "reference_names": ["theta_cmd", "dither"],
        "units": {"theta_cmd": "deg", "u": "V"},
        "intersample": "foh",
        "reference_intersample": "zoh",
        **options,
    }
    sampling = {} if "t" in given else {"dt": dt}
    return Record(np.sin(t), np.cos(t), **sampling, **given)


def same_loop(record: Record) -> bool:
    """Whether a record still has the references of `loop`, each with its name, unit, behaviour."""
    assert record.reference is not None
    assert record.reference.shape == (record.n_samples, 2)
    return (
        record.reference_names == ("theta_cmd", "dither")
        and record.reference_behaviour == "zoh"
        and record.units["theta_cmd"] == "deg"
    )


# ------------------------------------------------------------------------------- what it is made of
def test_a_reference_is_a_read_only_table_with_names() -> None:
    record = Record(U, Y, dt=0.5, reference=R)
    assert record.reference is not None
    assert record.reference.shape == (4, 1)
    assert record.reference.dtype == np.float64
    assert (record.n_references, record.reference_names) == (1, ("r",))
    with pytest.raises(ValueError, match="read-only"):
        record.reference[0] = 1.0


def test_without_a_reference_there_is_none() -> None:
    record = Record(U, Y, dt=0.5)
    assert record.reference is None
    assert (record.n_references, record.reference_names) == (0, ())
    assert record.reference_intersample is None
    assert record.reference_behaviour is None
    assert "reference" not in repr(record) + record._repr_html_()


def test_several_references_get_numbered_names_and_units() -> None:
    record = Record(U, Y, dt=0.5, reference=np.zeros((4, 2)), units={"r2": "deg"})
    assert record.reference_names == ("r1", "r2")
    assert record.units == {"r2": "deg"}


def test_names_and_units_come_from_labelled_columns() -> None:
    frame = pl.DataFrame({"u": U, "q [deg/s]": Y, "q_cmd [deg/s]": R})
    record = Record(frame["u"], frame["q [deg/s]"], dt=0.5, reference=frame["q_cmd [deg/s]"])
    assert record.reference_names == ("q_cmd",)
    assert record.units == {"q": "deg/s", "q_cmd": "deg/s"}
    twice = Record(frame["u"], frame["q [deg/s]"], dt=0.5, reference=frame["u"])
    assert (twice.input_names, twice.reference_names) == (("u",), ("r",))


def test_a_constant_reference_is_taken() -> None:
    record = Record(U, Y, dt=0.5, reference=np.full(4, 21.0))
    assert record.reference is not None
    assert np.ptp(record.reference) == 0.0


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"reference": R[:3]}, errors.LengthMismatchError, "3 samples of reference and 4 of u"),
        (
            {"reference": [0, np.nan, 0, 0]},
            errors.NotFiniteError,
            "reference 'r' = nan at sample 1",
        ),
        ({"reference": [0, np.inf, 0, 0]}, errors.NotFiniteError, "the reference must be known"),
        ({"reference": [0, 1e301, 0, 0]}, errors.ScaleError, "a reference"),
        ({"reference": ["a"] * 4}, errors.SampleTypeError, "found reference of type"),
        ({"reference": np.zeros((4, 5))}, errors.ShapeError, "transpose it, as in reference.T"),
        ({"reference": np.zeros((4, 1, 1))}, errors.ShapeError, "found reference of shape"),
        ({"reference": R, "reference_names": ["y"]}, errors.ChannelNameError, "more than once"),
        ({"reference": R, "reference_names": ["a", "b"]}, errors.ChannelNameError, "2 names"),
        ({"reference_names": ["a"]}, errors.ChannelNameError, "without a reference"),
        ({"reference_intersample": "zoh"}, errors.OptionError, "without a reference"),
        (
            {"reference": R, "reference_intersample": "held"},
            errors.OptionError,
            "found reference_intersample='held'; expected 'zoh' (reference held",
        ),
        (
            {"reference": R, "reference_intersample": "band-limited"},
            errors.TooFewSamplesError,
            "reference_intersample='band-limited'",
        ),
        ({"reference": R, "units": {"s": "m"}}, errors.UnitError, "u, y, r"),
    ],
)
def test_what_cannot_be_a_reference_is_refused_in_one_line(
    options: dict[str, object], error: type[Exception], words: str
) -> None:
    with pytest.raises(error) as raised:
        Record(U, Y, dt=0.5, **options)
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


# ----------------------------------------------------------------------- what it is between samples
@pytest.mark.parametrize("stated", ["zoh", "foh", "auto"])
def test_it_follows_what_is_stated_of_the_input(stated: str) -> None:
    record = Record(U, Y, dt=0.5, intersample=stated, reference=[0.0, 1.0, 3.0, 2.0])
    assert record.reference_intersample == stated
    assert record.reference_behaviour == ("zoh" if stated == "auto" else stated)


T = 0.05 * np.arange(400)
SWITCHED = np.repeat(np.random.default_rng(3).standard_normal(40), 10)


@pytest.mark.parametrize("stated", ["foh", "band-limited"])
@pytest.mark.parametrize(
    ("reference", "held"),
    [
        (np.where(T < 7.0, 20.0, 25.0), True),
        (SWITCHED, True),
        (np.random.default_rng(0).choice([-1.0, 1.0], 400), True),
        (np.column_stack([SWITCHED, np.zeros(400)]), True),
        (np.zeros(400), False),
        (T, False),
        (np.sin(T), False),
        (np.round(100.0 * np.sin(0.05 * T)), False),
        (np.clip(T, 7.0, 7.1), False),
        (np.clip(T, 7.0, 13.0), False),
        (SWITCHED + np.sin(T), False),
        (np.column_stack([SWITCHED, np.sin(T)]), False),
    ],
)
def test_one_that_rests_and_is_switched_is_held_beside_a_measured_input(
    stated: str, reference: np.ndarray, held: bool
) -> None:
    record = Record(np.cos(T), T, dt=0.05, intersample=stated, reference=reference)
    assert record.intersample == stated
    assert record.reference_behaviour == ("zoh" if held else stated)
    told = Record(
        np.cos(T), T, dt=0.05, intersample=stated, reference=reference, reference_intersample=stated
    )
    assert told.reference_behaviour == stated


def test_switched_references_of_a_slower_clock_are_held_on_the_faster() -> None:
    record = Record.from_rates(
        [0.0, 1.0, 2.0], [0.0, 0.1, 0.2, 0.3, 0.4], u_dt=0.2, y_dt=0.1, intersample="foh",
        reference=[0.0, 2.0, 2.0],
    )  # fmt: skip
    np.testing.assert_allclose(record.u[:, 0], [0, 0.5, 1, 1.5, 2])
    assert record.reference is not None
    np.testing.assert_allclose(record.reference[:, 0], [0, 0, 2, 2, 2])


def test_left_open_its_own_samples_decide() -> None:
    t = np.linspace(0.0, 3.0, 50)
    record = Record(np.sign(t - 1.0), t, t=t, intersample="auto", reference=np.sin(t))
    assert (record.behaviour, record.reference_behaviour) == ("zoh", "foh")
    settled = record.settled("zoh")
    assert (settled.intersample, settled.reference_behaviour) == ("zoh", "foh")


def test_another_behaviour_of_the_input_leaves_that_of_the_reference() -> None:
    record = Record(U, Y, dt=0.5, intersample="zoh", reference=R)
    assert record.between("foh").reference_behaviour == "zoh"
    assert settled_reference(None, None) is None


# ---------------------------------------------------------------- every method that gives a record
METHODS: dict[str, Callable[[Record], Record]] = {
    "between": lambda record: record.between("zoh"),
    "settled": lambda record: replace_auto(record).settled("foh"),
    "slice": lambda record: record.slice(0.5, 2.0),
    "split": lambda record: record.split(1.5)[1],
    "detrend": lambda record: record.detrend(1),
    "resample": lambda record: record.resample(0.02),
    "select": lambda record: record.select(outputs=["y"]),
    "mask": lambda record: record.mask(record.y > 0.9),
    "with_outputs": lambda record: record.with_outputs(2.0 * record.y),
}


def replace_auto(record: Record) -> Record:
    return record.between("auto")


def test_all_methods_that_give_records_are_looked_at() -> None:
    given = {
        name
        for name, one in inspect.getmembers(Record, inspect.isfunction)
        if not name.startswith("_")
        and re.search(r"Record|Self", str(inspect.signature(one).return_annotation))
    }
    assert given == set(METHODS) | {"decimate"}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.filterwarnings("ignore::tridentify.errors.DataWarning")
def test_every_method_keeps_the_reference(method: str) -> None:
    whole = loop()
    record = METHODS[method](whole)
    assert same_loop(record)
    assert whole.reference is not None
    at = np.searchsorted(whole.t, record.t - 1e-9)
    np.testing.assert_array_equal(record.reference, whole.reference[at])
    assert repr(record).endswith("references: theta_cmd [deg], dither (zoh))") or (
        record.intersample == "zoh"
    )


def test_decimation_filters_the_reference_like_the_input() -> None:
    t = np.arange(4000) * 0.01
    slow = np.sin(t)
    record = Record(slow, np.cos(t), dt=0.01, intersample="foh", reference=slow).decimate(10)
    assert record.reference is not None
    assert record.reference_behaviour == "band-limited"
    np.testing.assert_allclose(record.reference, record.u, rtol=0, atol=1e-12)
    held = Record(
        slow, slow, dt=0.01, intersample="foh", reference=slow, reference_intersample="zoh"
    )
    late = held.decimate(10).reference
    assert late is not None
    # a held signal is half a step late
    np.testing.assert_allclose(late[20:-20, 0], np.sin(t[::10] - 0.005)[20:-20], atol=1e-4)


def test_resampling_uneven_time_takes_the_reference_by_its_own_behaviour() -> None:
    t = np.array([0.0, 1.0, 2.0, 3.5, 4.0])
    record = Record(t, t, t=t, intersample="foh", reference=t, reference_intersample="zoh")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", errors.DataWarning)
        even = record.resample(0.5)
    assert even.reference is not None
    np.testing.assert_allclose(even.u[:, 0], even.t)
    np.testing.assert_array_equal(even.reference[:, 0], [0, 0, 1, 1, 2, 2, 2, 3.5, 4])


def test_thinning_warns_of_a_reference_that_moves_between() -> None:
    r = np.arange(40) % 3
    record = Record(np.zeros(40), np.arange(40.0), dt=0.1, reference=r)
    with pytest.warns(errors.DataWarning, match="found a reference that changes between"):
        record.resample(0.2)


def test_two_rates_take_the_reference_with_the_inputs() -> None:
    record = Record.from_rates(
        [0, 1, 1], [0.0, 0.1, 0.2, 0.3, 0.4], u_dt=0.2, y_dt=0.1,
        reference=[0.0, 2.0, 4.0], reference_names=["set"], reference_intersample="foh",
    )  # fmt: skip
    assert record.reference_names == ("set",)
    assert record.reference is not None
    np.testing.assert_allclose(record.reference[:, 0], [0, 1, 2, 3, 4])
    with pytest.raises(errors.LengthMismatchError, match="samples of reference"):
        Record.from_rates([0, 1], [0.0, 0.1], u_dt=0.1, y_dt=0.1, reference=[0.0])


def test_references_are_chosen_by_name() -> None:
    record = loop()
    one = record.select(references=["dither"])
    assert one.reference is not None
    assert (one.reference_names, dict(one.units)) == (("dither",), {"u": "V"})
    np.testing.assert_array_equal(one.reference[:, 0], record.reference[:, 1])
    none = record.select(references=[])
    assert (none.reference, none.reference_names, none.n_references) == (None, (), 0)
    assert none.reference_behaviour is None
    with pytest.raises(
        errors.ChannelNameError, match="found no reference 'theta'; expected one of"
    ):
        record.select(references=["theta"])
    with pytest.raises(errors.ChannelNameError, match="none, as the record has no reference"):
        none.select(references=["theta"])


def test_band_limited_references_are_looked_at_when_cut() -> None:
    record = loop(reference_intersample="band-limited")
    with pytest.raises(errors.TooFewSamplesError, match="band-limited"):
        record.slice(0.0, 0.05)


def test_pickles_keep_it_and_older_pickles_have_none() -> None:
    record = loop()
    again = pickle.loads(pickle.dumps(record))
    assert same_loop(again)
    assert not again.reference.flags.writeable
    state = Record(U, Y, dt=0.5).__getstate__()
    old = Record.__new__(Record)
    old.__setstate__({k: v for k, v in state.items() if not k.startswith("reference")})
    assert (old.reference, old.reference_names, old.n_references) == (None, (), 0)
    assert old.slice(0.0, 1.0).reference is None


def test_text_and_page_show_it() -> None:
    record = loop()
    assert repr(record).endswith("references: theta_cmd [deg], dither (zoh))")
    assert repr(loop(reference_intersample="foh")).endswith("theta_cmd [deg], dither)")
    page = record._repr_html_()
    assert "<th>references</th><td>theta_cmd [deg], dither (zoh)</td>" in page
    assert page.count("<svg") == 4


# -------------------------------------------------------- what else makes a record of another one
def test_missing_rows_of_a_raster_take_the_reference_along() -> None:
    t = np.array([0.0, 1.0, 2.0, 4.0])
    record = Record(t, t, t=t, intersample="foh", reference=t, reference_intersample="zoh")
    full = on_raster(record)
    assert full.reference is not None
    np.testing.assert_array_equal(full.u[:, 0], [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(full.reference[:, 0], [0, 1, 2, 2, 4])


def test_other_names_of_channels_leave_the_reference() -> None:
    record = renamed(loop(), ["elevator"], ["q"])
    assert same_loop(record)
    assert record.units["elevator"] == "V"


def test_frames_go_there_and_back() -> None:
    frame = frame_from_record(loop())
    assert "theta_cmd [deg]" in frame.columns
    record = record_from_frame(
        frame, inputs=["u"], outputs=["y"], references=["theta_cmd", "dither"], intersample="foh",
        reference_intersample="zoh",
    )  # fmt: skip
    assert same_loop(record)


def test_the_fingerprint_knows_it_and_is_the_old_one_without() -> None:
    with_it, without = loop(), loop().select(references=[])
    bare = Record(without.u, without.y, dt=without.dt)
    assert fingerprint([without]) == fingerprint([bare])
    assert fingerprint([with_it]) != fingerprint([without])


def test_a_simulation_does_not_care() -> None:
    model = TransferFunction([1.0], [1.0, 1.0])
    np.testing.assert_array_equal(
        simulate(model, loop()), simulate(model, loop().select(references=[]))
    )


@pytest.mark.slow
def test_models_have_no_units_of_references(tmp_path: Path) -> None:
    t = 0.05 * np.arange(200)
    r = np.sign(np.sin(3.0 * t))
    plain = Record(r, r, dt=0.05)
    y = simulate(TransferFunction([2.0], [1.0, 4.0]), plain)[:, 0]
    noisy = y + 0.01 * np.random.default_rng(3).standard_normal(200)
    units = {"y": "deg", "r": "deg"}
    record = Record(r, noisy, dt=0.05, reference=r, units=units)
    estimate = identify(record, Structure(1, 0))
    assert dict(estimate.units) == {"y": "deg"}
    estimate.save(tmp_path / "model.json")
    assert dict(Estimate.load(tmp_path / "model.json").units) == {"y": "deg"}
    found = online.run(online.ThreeModel(), record, Structure(1, 0))
    assert dict(found.estimate.units) == {"y": "deg"}
    rows = dict(settings_table(estimate, [record]))
    assert rows["reference"].startswith("r [deg]; ")
    lines = code_again(estimate, [record])
    assert "references=['r'], reference_intersample='zoh'" in lines
    again = Record(r, noisy, dt=0.05, units={"y": "deg"})
    assert fingerprint([again]) != estimate.record_fingerprint


# ---------------------------------------------------------------------------------------- pictures
def test_a_set_point_is_drawn_behind_the_output_it_belongs_to() -> None:
    t = 0.05 * np.arange(200)
    r = np.column_stack([np.sign(np.sin(t)), np.cos(t)])
    names = ["q_cmd", "dither"]
    units = {"y": "deg", "q_cmd": "deg", "u": "V"}
    record = Record(t, t, dt=0.05, reference=r, reference_names=names, units=units)
    axes = plot_record(record)
    assert [ax.get_ylabel() for ax in axes] == ["y [deg]", "u [V]", "dither"]
    assert [line.get_label() for line in axes[0].get_lines()] == ["y", "q_cmd"]
    assert axes[0].get_legend() is not None
    assert [ax.get_xlabel() for ax in axes] == ["", "", "time [s]"]
    drawn = axes[2].get_lines()[0]
    np.testing.assert_allclose(np.unique(drawn.get_ydata()), np.unique(r[:, 1]))
    assert len(plot_record(record.select(references=[]))) == 2


def test_an_input_that_no_controller_moves_is_a_reference_by_its_own_name():
    heat = np.sin(np.arange(len(U)))
    record = Record(
        np.column_stack([U, heat]), Y, dt=0.1, input_names=["u", "heat"], units={"heat": "W"},
        reference=np.column_stack([R, heat]), reference_names=["r", "heat"],
    )  # fmt: skip
    assert record.reference_names == ("r", "heat")
    assert record._units_of_a_model == {"heat": "W"}
    assert record.select(inputs=["u"]).reference_names == ("r", "heat")
    with pytest.raises(errors.ChannelNameError, match="'heat' more than once, as an input and as"):
        Record(
            np.column_stack([U, heat]), Y, dt=0.1, input_names=["u", "heat"],
            reference=heat + 1.0, reference_names=["heat"],
        )  # fmt: skip
