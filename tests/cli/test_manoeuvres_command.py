"""``tridentify manoeuvres``, and the ranges that it offers as other commands take them."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from tridentify import find_manoeuvres, identify, read_record

DT = 0.05
CHANNELS = ("--input", "elevator", "--output", "q")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Two doublets in three minutes of quiet, on a clock that begins before zero."""
    from tridentify import Record, TransferFunction, simulate

    n = 4000
    u = np.zeros(n)
    for first in (1000, 2500):
        u[first : first + 40], u[first + 40 : first + 80] = 1.0, -1.0
    y = simulate(TransferFunction([1.0], [1.0, 2.0]), Record(u, u, dt=DT))[:, 0]
    y = y + 0.001 * np.random.default_rng(0).standard_normal(n)
    path = tmp_path_factory.mktemp("logs") / "a log.csv"
    rows = np.column_stack([np.round(DT * np.arange(n) - 3.0, 6), u, y]).tolist()
    path.write_text("t,elevator,q\n" + "\n".join(",".join(map(repr, row)) for row in rows))
    return path


def test_pieces_are_those_of_the_function(run, log):
    found = find_manoeuvres(read_record(log, inputs=["elevator"], outputs=["q"]))
    assert len(found) == 2
    (told,) = json.loads(run("manoeuvres", log, *CHANNELS, "--json").out)["records"]
    assert told["name"] == "a log"
    assert told["manoeuvres"] == [one._asdict() for one in found]


def test_what_is_printed_is_the_option_that_takes_it(run, log):
    outcome = run("manoeuvres", log, *CHANNELS)
    assert outcome.code == 0
    ranges = re.findall(r"--range \S+", outcome.out)
    assert len(ranges) == 2
    words = [word for one in ranges for word in one.split()]
    orders = ("--poles", 1, "--zeros", 0, "--noise", "white", "--json")
    told = json.loads(run("identify", log, *CHANNELS, *words, *orders).out)
    record = read_record(log, inputs=["elevator"], outputs=["q"])
    pieces = [record.slice(one.start, one.stop) for one in find_manoeuvres(record)]
    from tridentify import Structure, ThreeModel

    wanted = identify(pieces, Structure(1, 0), ThreeModel(noise="white"))
    values = [one["value"] for one in told["parameters"]]
    np.testing.assert_allclose(values, wanted.theta, rtol=1e-12)
    assert [one["start"] for one in told["experiments"]] == pytest.approx([44.95, 119.95])


def test_a_longer_gap_joins_them(run, log):
    outcome = run("manoeuvres", log, *CHANNELS, "--from", 40, "--to", 140, "--gap", 40, "--json")
    (told,) = json.loads(outcome.out)["records"]
    assert len(told["manoeuvres"]) <= 1


def test_nothing_is_offered_where_there_is_none(run, log):
    outcome = run("manoeuvres", log, *CHANNELS, "--to", 30)
    assert outcome.code == 0
    assert "no manoeuvre was found" in outcome.out
    (told,) = json.loads(run("manoeuvres", log, *CHANNELS, "--to", 30, "--json").out)["records"]
    assert told["manoeuvres"] == []


def test_every_range_is_looked_at_by_itself(run, log):
    outcome = run("manoeuvres", log, *CHANNELS, "--range", "0:100", "--range", "100:", "--json")
    counted = [len(one["manoeuvres"]) for one in json.loads(outcome.out)["records"]]
    assert counted == [1, 1]


def test_masked_samples_do_not_count(run, log):
    options = ("--mask", "40:42.0", "--mask", "-1:0", "--range", ":100")
    orders = ("--poles", 1, "--zeros", 0, "--json")
    told = json.loads(run("identify", log, *CHANNELS, *orders, *options).out)
    assert told["record"]["n_missing"] == 41 + 21


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--gap", "0"), "found --gap 0; expected seconds above zero"),
        (("--range", "60:40"), "found --range '60:40'; expected two times in seconds"),
        (("--range", ":"), "found --range ':'; expected two times"),
        (("--mask", "q>=2"), "found --mask 'q>=2'; expected two times"),
        (("--range", "500:600"), "found 0 samples from 500 s to 600 s"),
        (("--mask", ":600"), "found nothing but nan in output 'q'"),
    ],
)
def test_mistakes_are_one_line(run, log, options, words):
    outcome = run("manoeuvres", log, *CHANNELS, *options)
    assert outcome.code == 2
    (line,) = outcome.error_lines
    assert words in line


def test_columns_that_are_not_named_are_guessed(run, log):
    outcome = run("manoeuvres", log)
    assert outcome.code == 2
    assert "--input elevator --output q" in outcome.err
