"""Lines to copy do what the page did: both are run, and give its estimate."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tridentify import (
    Record,
    TransferFunction,
    find_manoeuvres,
    identify,
    read_record,
    simulate,
)
from tridentify.app import lines
from tridentify.app.exports import exported
from tridentify.cli.entry import main
from tridentify.options import checked, from_options

T0, DT, N = 3.0, 0.05, 400
RANGE = {"start": 1.0, "end": 14.0, "use": "identify"}
FEW = {"start": 1.0, "end": 3.2, "use": "identify"}
"""45 samples: enough for four candidates."""


@pytest.fixture(autouse=True)
def _one_process(monkeypatch):
    """Figures are drawn in this process: to start another one takes longer than to draw them."""
    monkeypatch.setattr("tridentify.cli.artist.worth_it", lambda: False)


@pytest.fixture(scope="module")
def card(tmp_path_factory) -> dict[str, Any]:
    rng = np.random.default_rng(8)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 20), 20)
    plant = TransferFunction([8.0], [1.0, 1.5, 4.0])
    y = simulate(plant, Record(u, u, dt=DT))[:, 0] + 0.02 * rng.standard_normal(N)
    path = tmp_path_factory.mktemp("lines") / "a run.csv"
    columns = {"t": T0 + DT * np.arange(N), "force": u, "position [m]": y}
    pl.DataFrame(columns).write_csv(path)
    return {
        "path": str(path), "file": path.name, "t0": T0, "name": "run",
        "inputs": ["force"], "outputs": ["position"], "references": [],
        "intersample": "auto", "ranges": [], "bad": [], "given_dt": None,
    }  # fmt: skip


def in_python(card: dict[str, Any], options: dict[str, str], capsys) -> dict[str, Any]:
    found: dict[str, Any] = {}
    exec(lines.model_in_python(card, options), found)
    assert found["estimate"].summary() in capsys.readouterr().out
    return found


def in_shell(card: dict[str, Any], options: dict[str, str], capsys, which: int = 0) -> Any:
    told = lines.model_in_shell(card, options).splitlines()
    words = shlex.split(told[which])
    assert words[0] == "tridentify"
    assert main([*words[1:], "--json"]) == 0
    return json.loads(capsys.readouterr().out)


OPTIONS = {
    "as they come": {},
    "orders and terms": {
        "poles": "2", "zeros": "0", "delay": "0.05", "offset": "yes", "drift": "yes",
        "initial_state": "free", "noise": "white", "intersample": "zoh",
    },
    "a robust loss": {"zeros": "0", "loss": "huber", "route": "open-loop"},
    "what is known": {
        "zeros": "0", "fixed": "a0=4", "bounds": "a1=0:3; b0=0:", "priors": "b0=8 +- 2",
    },
    "another method": {"zeros": "0", "method": "output-error"},
    "orders chosen": {"poles": "auto", "noise": "white"},
}  # fmt: skip


@pytest.mark.parametrize("which", OPTIONS)
@pytest.mark.fast("as they come", "orders and terms", "what is known", "another method")
def test_both_give_the_estimate_of_the_page(card, which, capsys):
    options = OPTIONS[which]
    chosen = checked(options)
    part = FEW if which == "orders chosen" else RANGE
    ranged = {**card, "ranges": [part]}
    own = lines.between(ranged, chosen)
    record = read_record(
        card["path"], inputs=["force"], outputs=["position"], intersample=own["intersample"]
    )
    wanted = identify(record.slice(T0 + part["start"], T0 + part["end"]), *from_options(options))
    again = in_python(ranged, options, capsys)["estimate"]
    np.testing.assert_array_equal(again.theta, wanted.theta)
    told = in_shell(ranged, options, capsys)
    values = {one["name"]: one["value"] for one in told["parameters"]}
    np.testing.assert_allclose([values[name] for name in wanted.names], wanted.theta, rtol=1e-12)


def test_bad_samples_and_several_ranges_are_the_same_in_both(card, capsys):
    ranges = [{"start": 0.0, "end": 8.0, "use": "identify"},
              {"start": 9.0, "end": 19.0, "use": "identify"}]  # fmt: skip
    marked = {**card, "ranges": ranges, "bad": [{"start": 2.0, "end": 2.5}]}
    found = in_python(marked, {"zeros": "0"}, capsys)
    assert len(found["pieces"]) == 2
    assert int(np.sum(np.isnan(found["pieces"][0].y))) == 11
    told = in_shell(marked, {"zeros": "0"}, capsys)
    assert [one["n_missing"] for one in told["experiments"]] == [11, 0]
    values = [one["value"] for one in told["parameters"]]
    np.testing.assert_allclose(values, found["estimate"].theta, rtol=1e-12)


@pytest.mark.slow
def test_a_physical_map_has_lines_of_its_own(card, capsys):
    options = {"zeros": "0", "physical": "mass-spring-damper", "known": "m=0.125"}
    found = in_python(card, options, capsys)
    assert found["channels"] == {"force": "force", "position": "position"}
    told = in_shell(card, options, capsys, which=1)
    parameters = {one["name"]: one["value"] for one in told["parameters"]}
    assert parameters["k"] == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("name", ["zeros", "fixed", "bounds", "priors"])
def test_what_goes_with_known_orders_only_is_refused(name):
    from tridentify.errors import OptionError

    text = {"zeros": "1", "fixed": "a0=1", "bounds": "a0=0:", "priors": "a0=1+-1"}[name]
    with pytest.raises(OptionError, match=f"found {name} = .* with poles = auto"):
        from_options({"poles": "auto", name: text})


def test_a_record_is_checked_and_searched_by_commands_that_run(card, capsys):
    ranged = {**card, "ranges": [RANGE], "bad": [{"start": 5.0, "end": 5.2}]}
    checked_, searched = map(shlex.split, lines.record_in_shell(ranged).splitlines())
    assert main([*checked_[1:], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["findings"] is not None
    assert main([*searched[1:], "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["records"]
    record = read_record(card["path"], inputs=["force"], outputs=["position"])
    record = record.mask((record.t >= T0 + 5.0) & (record.t <= T0 + 5.2))
    assert told["manoeuvres"] == [one._asdict() for one in find_manoeuvres(record)]
    assert told["manoeuvres"]


@pytest.mark.slow
def test_a_record_is_checked_and_searched_by_lines_that_run(card, capsys):
    exec(lines.look_in_python({**card, "ranges": [RANGE]}), {})
    assert "position" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.undrawn
def test_what_validates_is_tested_by_lines_that_run(card, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ranges = [RANGE, *({"start": start, "end": start + 2.2, "use": "validate"}
                       for start in (14.5, 17.0))]  # fmt: skip
    ranged, options = {**card, "ranges": ranges}, {"zeros": "0", "noise": "white"}
    exec(lines.model_in_python(ranged, options), {})
    assert "residual" in capsys.readouterr().out
    first, second = lines.model_in_shell(ranged, options).splitlines()
    assert main(shlex.split(first)[1:]) == 0
    capsys.readouterr()
    assert main([*shlex.split(second)[1:], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fit"]


@pytest.mark.slow
@pytest.mark.undrawn
def test_a_model_is_exported_by_lines_that_run(card, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record = read_record(card["path"], inputs=["force"], outputs=["position"])
    estimate = identify(record, *from_options({"zeros": "0", "noise": "white"}))
    kinds = ("json", "matlab", "c", "control", "table")
    files = {file: content for file, _, content in
             (exported(estimate, [record], kind, "Model 1") for kind in kinds)}  # fmt: skip
    Path("Model_1.json").write_bytes(files["Model_1.json"])
    exec(lines.export_in_python("Model 1", card, record.dt), {})
    assert {path.suffix for path in tmp_path.iterdir()} >= {".html", ".svg"}
    for name, content in files.items():
        assert Path(name).read_bytes() == content, name
        if name != "Model_1.json":
            Path(name).unlink()
    for line in lines.export_in_shell("Model 1", record.dt).splitlines():
        assert main(shlex.split(line)[1:]) == 0
    for name in files:
        assert Path(name).stat().st_size > 100


def test_models_are_compared_by_lines_that_run(card, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record = read_record(card["path"], inputs=["force"], outputs=["position"])
    cards = []
    for name, zeros in (("Model 1", "0"), ("best of (all)", "1")):
        estimate = identify(record, *from_options({"zeros": zeros, "noise": "white"}))
        file, _, content = exported(estimate, None, "json", name)
        (tmp_path / file).write_bytes(content)
        cards.append({"name": name})
    found: dict[str, Any] = {}
    exec(lines.compare_in_python(cards, card), found)
    said = capsys.readouterr().out
    assert "position" in said
    words = shlex.split(lines.compare_in_shell(cards, card))
    assert main([*words[1:], "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["fits"]


def test_models_are_compared_under_their_own_channels_on_what_validates(card):
    ranges = [RANGE, {"start": 15.0, "end": 19.0, "use": "validate"}]
    other = {**card, "outputs": ["elsewhere"], "ranges": ranges}
    same = lines.compared_card(other, ["force"], ["position"])
    told = lines.compare_in_python([{"name": "one"}], same)
    assert "outputs=['position']" in told
    assert f"pieces = [record.slice({T0 + 15.0}, {T0 + 19.0})]" in told
    assert "], pieces)" in told
    words = shlex.split(lines.compare_in_shell([{"name": "one"}], same))
    assert words[words.index("--output") + 1] == "position"
    assert words[words.index("--from") + 1] == str(T0 + 15.0)


def test_bad_samples_that_were_marked_twice_are_left_out_once(card):
    bad = {"start": 2.0, "end": 3.0}
    assert lines.record_in_python({**card, "bad": [bad, bad]}).count("mask") == 1


def test_a_map_takes_columns_by_their_names(card):
    own = {**card, "inputs": ["u_elevator"], "outputs": ["y_q", "y_alpha"]}
    told = lines.model_in_python(own, {"poles": "2", "physical": "short-period"})
    assert "{'elevator': 'u_elevator', 'alpha': 'y_alpha', 'q': 'y_q'}" in told
