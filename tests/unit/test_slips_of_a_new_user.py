"""What a new user writes at first, and the one line that says what to write instead."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import re

import numpy as np
import pandas as pd
import pytest

import tridentify
import tridentify.plots
from tridentify import (
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    read_record,
    record_from_frame,
    select_structure,
    simulate,
)
from tridentify.cli.tables import parameter_row
from tridentify.errors import (
    CandidateError,
    DataError,
    OptionError,
    OrderError,
    SampleTypeError,
    SamplingError,
    TridentifyError,
)
from tridentify.report import write_report
from tridentify.report.tables import quantity_row
from tridentify.writing.layout import format_polynomial, with_error
from tridentify.writing.notebook import fraction
from tridentify.writing.pointers import OF_A_RECORD, OF_AN_ESTIMATE


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(3)
    u = np.sign(np.sin(np.arange(300) ** 1.5))
    y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.05))
    return Record(u, y + 0.02 * rng.standard_normal((300, 1)), dt=0.05)


@pytest.fixture(scope="module")
def estimate(record):
    return identify(record, (1, 0))


def refused(kind, words, call):
    """The call is refused in one line that holds the words."""
    with pytest.raises(kind) as caught:
        call()
    assert isinstance(caught.value, TridentifyError)
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text


def test_a_report_without_its_path_says_how(estimate, record):
    refused(
        OptionError,
        ("found Record", 'estimate.report("page.html", record)'),
        lambda: estimate.report(record),
    )


def test_a_report_of_swapped_arguments_says_how(estimate, record, tmp_path):
    page = tmp_path / "x.html"
    how = 'write_report(estimate, record, "page.html")'
    refused(
        SampleTypeError, (how, "Record, Estimate"), lambda: write_report(record, estimate, page)
    )
    refused(SampleTypeError, (how,), lambda: write_report(estimate, page, record))
    assert not page.exists()


def test_a_third_argument_of_a_record_has_a_name():
    refused(SamplingError, ("0.02", "dt=0.02"), lambda: Record([0, 1, 1], [0, 1, 2], 0.02))


@pytest.mark.parametrize("pair", [(1, 0), [1, 0], (np.int64(1), 0)])
def test_pairs_stand_for_structures(record, pair):
    found = identify(record, pair).structure
    assert (found.poles, found.zeros) == (1, 0)


@pytest.mark.slow
def test_pairs_are_candidates(record):
    few, quick = record.slice(0.0, 3.0), ThreeModel(starts=1, finish="likelihood")
    pairs = select_structure(few, [(1, 0), [2, 0]], method=quick)
    structures = select_structure(few, [Structure(1, 0), Structure(2, 0)], method=quick)
    assert [row.structure for row in pairs.rows] == [row.structure for row in structures.rows]
    assert len(select_structure(few, [(1, 0), Structure(1, 0)]).rows) == 1


def test_messages_about_structures_mention_the_pair(record):
    refused(OrderError, ("Structure([2, 1])", "(2, 1)"), lambda: Structure([2, 1]))
    refused(OptionError, ("pair", "(2, 1)"), lambda: identify(record, 2, 1))
    refused(OptionError, ("pair", "select_structure"), lambda: identify(record, [(1, 0), (2, 1)]))
    refused(CandidateError, ("pair", "(2, 1)"), lambda: select_structure(record, [(1, 0), "2, 1"]))


def test_record_and_structure_swapped_are_told_apart(record):
    refused(SampleTypeError, ("swapped",), lambda: identify(Structure(2, 1), record))
    refused(SampleTypeError, ("swapped",), lambda: identify((2, 1), record))


def test_a_file_or_a_frame_is_to_be_read_first(tmp_path):
    frame = pd.DataFrame({"t": [0.0, 0.1], "u": [0, 1], "y": [0, 1]})
    refused(SampleTypeError, ("read_record", "file.csv"), lambda: identify("file.csv", (1, 0)))
    refused(SampleTypeError, ("read_record",), lambda: identify(tmp_path / "a.csv", (1, 0)))
    refused(SampleTypeError, ("record_from_frame",), lambda: identify(frame, (1, 0)))
    refused(DataError, ("record_from_frame",), lambda: select_structure(frame, [(1, 0)]))


def test_a_name_like_another_is_proposed(tmp_path):
    frame = pd.DataFrame({"t": [0.0, 0.1, 0.2], "u_elevator": [0, 1, 1], "Q [deg/s]": [0, 1, 2]})
    frame.to_csv(tmp_path / "flight.csv", index=False)

    def read(inputs, outputs, **options):
        return lambda: record_from_frame(frame, inputs=[inputs], outputs=[outputs], **options)

    refused(DataError, ("did you mean 'u_elevator'?",), read("u_elev", "Q"))
    refused(DataError, ("did you mean 'Q [deg/s]'?",), read("u_elevator", "q"))
    refused(DataError, ("did you mean 'Q [deg/s]'?",), read("u_elevator", "Q", units={"q": "x"}))
    refused(
        DataError,
        ("did you mean 'u_elevator'?",),
        lambda: read_record(tmp_path / "flight.csv", inputs=["elevator"], outputs=["Q"]),
    )
    record = read("u_elevator", "Q")()
    refused(DataError, ("did you mean 'u_elevator'?",), lambda: record.select(inputs=["elevator"]))
    refused(
        DataError,
        ("did you mean 'u'?",),
        lambda: Record([0, 1, 1], [0, 1, 2], dt=0.1, units={"U": "rad"}),
    )
    with pytest.raises(DataError) as caught:
        read("gamma", "Q")()
    assert "did you mean" not in str(caught.value)


DATES = ["2026-01-01 00:00:00.00", "2026-01-01 00:00:00.02", "2026-01-01 00:00:00.04"]


@pytest.mark.parametrize("name", ["Timestamp", "timestamp", "date", "datetime", "DateTime"])
def test_dates_of_a_usual_name_are_time(name, tmp_path):
    frame = pd.DataFrame({name: DATES, "u": [0, 1, 1], "y": [0, 1, 2]})
    frame.to_csv(tmp_path / "dated.csv", index=False)
    read = read_record(tmp_path / "dated.csv", inputs=["u"], outputs=["y"])
    text = record_from_frame(frame, inputs=["u"], outputs=["y"])
    frame[name] = pd.to_datetime(frame[name])
    stamps = record_from_frame(frame, inputs=["u"], outputs=["y"])
    for record in (read, text, stamps):
        assert record.dt == pytest.approx(0.02)


def test_numbers_of_such_a_name_are_not_time_and_t_comes_first():
    numbers = pd.DataFrame({"timestamp": [0.0, 0.1, 0.2], "u": [0, 1, 1], "y": [0, 1, 2]})
    refused(
        SamplingError, ("time",), lambda: record_from_frame(numbers, inputs=["u"], outputs=["y"])
    )
    both = pd.DataFrame({"date": DATES, "t": [0.0, 0.5, 1.0], "u": [0, 1, 1], "y": [0, 1, 2]})
    assert record_from_frame(both, inputs=["u"], outputs=["y"]).dt == 0.5


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e6, 1e9])
def test_stamps_that_count_from_1970_are_time(scale, tmp_path):
    stamps = np.round((1_764_000_000.0 + 0.5 * np.arange(40)) * scale)
    if scale == 1.0:
        stamps = 1_764_000_000.0 + np.arange(40)
    frame = pd.DataFrame({"timestamp": stamps, "u": np.arange(40) % 2, "y": np.arange(40)})
    frame.to_csv(tmp_path / "stamped.csv", index=False)
    dt = 1.0 if scale == 1.0 else 0.5
    record = read_record(tmp_path / "stamped.csv", inputs=["u"], outputs=["y"])
    assert record.dt == pytest.approx(dt, rel=1e-6)
    assert record_from_frame(frame, inputs=["u"], outputs=["y"]).n_samples == 40


def test_stamps_with_a_unit_are_time():
    frame = pd.DataFrame({"timestamp [ms]": [0, 20, 40], "u": [0, 1, 1], "y": [0, 1, 2]})
    assert record_from_frame(frame, inputs=["u"], outputs=["y"]).dt == pytest.approx(0.02)


@pytest.mark.parametrize("first", [0.0, 2.1e8, 1.8e9])
def test_microseconds_since_it_was_switched_on_are_not_guessed(first):
    frame = pd.DataFrame({"timestamp": first + 4e3 * np.arange(40), "u": np.arange(40) % 2})
    frame["y"] = np.arange(40)
    refused(SamplingError, ("time",), lambda: record_from_frame(frame, inputs=["u"], outputs=["y"]))


def test_an_even_index_without_a_name_is_mentioned():
    frame = pd.DataFrame({"u": [0, 1, 1], "y": [0, 1, 2]}, index=[0.0, 0.25, 0.5])
    refused(
        SamplingError,
        ("index", "0.25", 'time="index"', "reset_index"),
        lambda: record_from_frame(frame, inputs=["u"], outputs=["y"]),
    )
    assert record_from_frame(frame, time="index", inputs=["u"], outputs=["y"]).dt == 0.25
    assert record_from_frame(frame, dt=0.1, inputs=["u"], outputs=["y"]).dt == 0.1
    frame["t"] = [0.0, 1.0, 2.0]
    assert record_from_frame(frame, inputs=["u"], outputs=["y"]).dt == 1.0


@pytest.mark.parametrize(
    ("name", "use"),
    [
        ("params", "estimate.parameters"),
        ("bse", "estimate.std"),
        ("conf_int", "estimate.to_frame"),
        ("num", "estimate.model.num"),
        ("a0", 'estimate.parameters["a0"].value'),
    ],
)
def test_names_of_other_packages_point_to_those_here(estimate, name, use):
    with pytest.raises(
        AttributeError, match=re.escape(f"found no {name!r} in an Estimate; use {use}")
    ):
        getattr(estimate, name)
    assert not hasattr(estimate, name)


def test_what_is_pointed_to_is_there(record, estimate):
    known = {"estimate": estimate, "record": record, "tridentify": tridentify}
    for use in (*OF_AN_ESTIMATE.values(), *OF_A_RECORD.values()):
        for call in re.findall(r"(?:estimate|record|tridentify)[.][^ ,]+(?: record[)])?", use):
            assert eval(call, dict(known)) is not None


def test_pointers_leave_copies_pickles_and_other_names_as_they_are(record, estimate):
    with pytest.raises(AttributeError, match="plot_record"):
        record.plot()
    for one in (record, estimate):
        again = pickle.loads(pickle.dumps(one))
        assert type(copy.copy(one)) is type(copy.deepcopy(one)) is type(again) is type(one)
        assert repr(again) == repr(one)
        with pytest.raises(AttributeError, match="object has no attribute 'colour'"):
            _ = one.colour
        assert getattr(one, "colour", None) is None
        assert not hasattr(one, "__array__")
    empty = object.__new__(Record)
    assert not hasattr(empty, "u")


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (5.2e-4, 6.7e-5, "(5.20 +/- 0.67)e-04"),
        (-5.2e-4, 6.7e-5, "(-5.20 +/- 0.67)e-04"),
        (2.5e8, 2e6, "(2.500 +/- 0.020)e+08"),
        (-1e-9, 6e-5, "(0.0 +/- 6.0)e-05"),
        (0.0, 6e-5, "(0.0 +/- 6.0)e-05"),
        (3.14159, 0.023, "(3.142 +/- 0.023)"),
        (1e-310, 1e-311, "(1.00e-310 +/- 1.0e-311)"),
    ],
)
def test_a_value_and_its_error_share_one_exponent(value, std, text):
    assert with_error(value, std) == text
    assert text in format_polynomial([1.0, value], [0.0, std])


def test_the_mathml_has_one_exponent_too():
    text = fraction("y / u", [(5.2e-4, 6.7e-5)], [(1.0, 0.0)], "")
    assert text.count("<mn>-4</mn>") == 1
    assert "<mn>-5</mn>" not in text
    assert "<mn>5.20</mn><mo>&#177;</mo><mn>0.67</mn><mo>)</mo>" in text


def test_a_time_constant_of_a_pole_that_may_be_zero_is_not_determined(estimate):
    one = dataclasses.replace(estimate, cov=np.diag([4.0**2, 0.01]))
    (line,) = [line for line in one.summary().splitlines() if line.startswith("time constant")]
    assert line.split() == ["time", "constant", "not", "determined", "s"]
    (pole,) = [line for line in one.summary().splitlines() if line.startswith("real pole")]
    assert "not determined" not in pole
    rows = {item.name: item for item in one.derived()}
    assert quantity_row(rows["time constant"])[1] == parameter_row(rows["time constant"])[1]
    assert quantity_row(rows["time constant"])[1] == "not determined"
    (line,) = [r for r in estimate.summary().splitlines() if r.startswith("time constant")]
    assert "not determined" not in line


@pytest.mark.parametrize("structure", [None, (1, 0)])
@pytest.mark.fast("structure1")
def test_the_behaviour_that_was_taken_is_among_the_notes(record, structure):
    # too few samples for more than two poles: fewer candidates where no structure is given
    found = identify(record.slice(0.0, 34 * record.dt).between("auto"), structure)
    (note,) = [note for note in found.notes() if note.startswith("input taken as")]
    assert note == "input taken as held between its samples (zoh)"


def test_what_is_no_record_or_no_model_is_refused_in_one_line(tmp_path) -> None:
    u = np.repeat([1.0, -1.0], 30)
    record = Record(u, 0.1 * np.cumsum(u), dt=0.1)
    estimate = identify(record, Structure(1, 0), throw=False)
    with pytest.raises(OptionError, match=r"experiment=9.*0 to 0"):
        estimate.predict(record, experiment=9)
    with pytest.raises(SampleTypeError, match="NoneType in place of a record"):
        tridentify.validate(estimate, None)
    with pytest.raises(SampleTypeError, match=r"measured=frequency_response\(record\)"):
        tridentify.plots.plot_bode(estimate, measured=record)
    with pytest.raises(SampleTypeError, match="Record in place of a model"):
        tridentify.export.write_c_header(record, 0.1, tmp_path / "a.h")
    assert not list(tmp_path.iterdir())
