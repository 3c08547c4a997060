"""The JSON interface without a browser: every route, who may ask, what is refused and how."""

from __future__ import annotations

import copy
import json
import os
import re
import sqlite3
import time
import types
import typing
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from tridentify import Estimate, Record, TransferFunction, simulate

pytest.importorskip("fastapi", reason="the extra app is not installed")
pytest.importorskip("httpx2", reason="httpx2, which asks the server in tests, is not installed")

from fastapi.testclient import TestClient

from interface_types import ANSWERS, Refusal, Revision, Stretch
from tridentify.app.answers import _few, shared_time
from tridentify.app.bench import Bench
from tridentify.app.safety import Guard
from tridentify.app.server import create
from tridentify.app.session import Session
from tridentify.record.formats.roles import guess_roles
from tridentify.record.formats.series import read_series

TOKEN, PORT = "token-of-the-tests", 8123
HEADERS = {"Authorization": f"Bearer {TOKEN}"}
PLANT = TransferFunction([[[2.0, 6.0]]], [1.0, 1.6, 4.0])
PATIENCE = 60.0
"""Seconds an estimate may take on a busy machine."""
RAN: set[str] = set()
"""Tests of this file that this process has run: several processes may share them."""


@pytest.fixture(autouse=True)
def _noted(request):
    yield
    RAN.add(request.node.nodeid)


def flight(n=400, seed=1, still=False):
    rng = np.random.default_rng(seed)
    u = np.zeros(n) if still else np.repeat(rng.choice([-1.0, 1.0], n // 20), 20)
    y = simulate(PLANT, Record(u, u, dt=0.05))[:, 0] + 0.02 * rng.standard_normal(n)
    rows = np.column_stack([0.05 * np.arange(n), u, y])
    return "t,elevator [deg],q [deg/s]\n" + "\n".join(",".join(map(repr, r)) for r in rows.tolist())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("flights")
    (place / "first.csv").write_text(flight())
    (place / "second.csv").write_text(flight(seed=2))
    (place / "still.csv").write_text(flight(seed=3, still=True))
    (place / "notes.md").write_text("nothing to read")
    (place / "broken.csv").write_text("no,numbers\nat,all\n")
    secret = place.parent / "secret.csv"
    secret.write_text(flight(seed=4))
    (place / "link.csv").symlink_to(secret)
    return place


@pytest.fixture(scope="module")
def bench(folder, tmp_path_factory):
    # not started ahead: a process comes with the first task for it
    made = Bench(Session(tmp_path_factory.mktemp("session") / "s.sqlite"), folder)
    yield made
    made.stop()


class Typed(TestClient):
    """Every answer that passes here has the type that the interface states."""

    asked: ClassVar[set[str]] = set()

    def request(self, method, url, **settings):
        answer = super().request(method, url, **settings)
        path = str(url).partition("?")[0]
        kind = next((one for one in ANSWERS if re.fullmatch(
            re.sub(r"{\w+}", "[^/]+", one), f"{method} {path}")), None)  # fmt: skip
        if answer.status_code >= 400:
            if path.startswith("/api"):
                assert unlike(answer.json(), Refusal) == ""
        elif kind is not None:
            assert unlike(answer.json(), ANSWERS[kind]) == ""
            self.asked.add(kind)
        return answer


def unlike(value, kind, where="answer"):
    """Where a value of JSON is not of a type; empty where it is."""
    told = f"{where} is {str(value)[:60]!r}, no {kind}"
    if typing.is_typeddict(kind):
        hints = typing.get_type_hints(kind)
        if not isinstance(value, dict):
            return told
        if not kind.__required_keys__ <= set(value) <= set(hints):
            return f"{where} has not the keys of {kind.__name__}: {set(value) ^ set(hints)}"
        return next(filter(None, (unlike(one, hints[name], f"{where}.{name}")
                                  for name, one in value.items())), "")  # fmt: skip
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        found = [unlike(value, one, where) for one in inner]
        return "" if "" in found else max(found, key=len)
    if origin in (list, dict) and type(value) is not origin:
        return told
    if origin is typing.Literal:
        return "" if value in inner else told
    if origin is list:
        return next(filter(None, (unlike(one, inner[0], f"{where}[{k}]")
                                  for k, one in enumerate(value))), "")  # fmt: skip
    if origin is dict:
        return next(filter(None, (unlike(one, inner[1], f"{where}[{k}]")
                                  for k, one in value.items())), "")  # fmt: skip
    number = kind is float and isinstance(value, int) and not isinstance(value, bool)
    return "" if number or type(value) is kind else told


@pytest.fixture(scope="module")
def ask(bench):
    app = create(bench, Guard(TOKEN, PORT, most_uploaded=200_000))
    with Typed(app, base_url=f"http://127.0.0.1:{PORT}", headers=HEADERS) as client:
        yield client


def opened(ask, name="first.csv"):
    answer = ask.post("/api/records", json={"path": name})
    assert answer.status_code == 200, answer.text
    return answer.json()["records"][0]


def ended(ask, job):
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = ask.get(f"/api/jobs/{job}").json()
        if found["state"] not in ("queued", "running"):
            return found
        time.sleep(0.02)
    raise AssertionError("the estimate did not end")


def estimated(ask, record, **options):
    answer = ask.post("/api/models", json={"record": record, "options": options})
    assert answer.status_code == 202, answer.text
    job = ended(ask, answer.json()["job"])
    assert job["state"] == "done", job
    assert job["fraction"] == 1.0
    return answer.json()["model"]


@pytest.fixture(scope="module")
def made(ask):
    """A record and a model of it."""
    record = opened(ask)["id"]
    return record, estimated(ask, record)


def told(answer, status):
    assert answer.status_code == status, answer.text
    error = answer.json()["error"]
    assert error["message"]
    return f"{error['message']} {error['remedy']}"


# ------------------------------------------------------------------------------------------ safety
def test_only_who_has_the_token_may_ask(ask):
    for path in ("/", "/api/session", "/page/main.js", "/vendor/plotly.min.js"):
        for token in ("", "wrong", f"{TOKEN}x"):
            assert ask.get(path, headers={"Authorization": f"Bearer {token}"}).status_code == 403
    assert ask.get("/api/session").status_code == 200


def test_the_page_is_entered_with_the_token_and_goes_on_with_a_cookie(ask):
    bare = {"Authorization": ""}
    answer = ask.get(f"/?token={TOKEN}", headers=bare)
    assert answer.status_code == 200
    assert 'http-equiv="refresh" content="0; url=/"' in answer.text
    assert TOKEN not in answer.text
    cookie = answer.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "samesite=strict" in cookie.lower()
    assert cookie.startswith(f"tridentify-{PORT}=")  # browsers keep one for all ports of a host
    assert TOKEN not in str(ask.get("/").text)
    assert ask.get("/?token=wrong", headers=bare | {"Cookie": ""}).status_code == 403
    ask.cookies.clear()


@pytest.mark.parametrize("host", ["evil.example:8123", "127.0.0.1:9", "127.0.0.1", "localhost"])
def test_another_host_is_refused(ask, host):
    assert ask.get("/api/session", headers={"Host": host}).status_code == 403


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "http://127.0.0.1:9",
        "https://127.0.0.1.evil:8123",
        f"https://127.0.0.1:{PORT}",
    ],
)
def test_another_origin_is_refused(ask, origin):
    assert ask.post("/api/undo", headers={"Origin": origin}).status_code == 403


def test_its_own_origin_is_not(ask):
    own = {"Origin": f"http://127.0.0.1:{PORT}"}
    assert ask.get("/api/session", headers=own).status_code == 200


def test_scripts_of_the_page_come_from_the_server_alone(ask):
    policy = ask.get("/").headers["content-security-policy"]
    assert "script-src 'self'" in policy
    scripts = policy.split("script-src")[1].split(";")[0]
    assert "unsafe" not in scripts
    assert ask.get("/page/main.js").headers["content-type"].startswith("text/javascript")


@pytest.mark.parametrize(
    "name",
    ["../secret.csv", "link.csv", "/etc/passwd", "a/../../secret.csv", "first.csv\0.png", "."],
)
def test_no_path_leads_out_of_the_folder(ask, name):
    assert "leads out" in told(ask.post("/api/records", json={"path": name}), 400)


@pytest.mark.parametrize("name", ["..%2Fsession.py", "nothing.js", "..%2f..%2f__init__.py"])
def test_no_part_of_the_page_leads_elsewhere(ask, name):
    assert ask.get(f"/page/{name}").status_code == 404


def test_an_upload_has_a_limit_and_other_bodies_a_smaller_one(ask):
    large = {"files": ("large.csv", b"x" * 300_000)}
    assert "at most 200,000" in told(ask.post("/api/records/upload", files=large), 413)
    assert ask.post("/api/compare", content=b"x" * 1_100_000).status_code == 413


def test_a_body_without_its_length_is_refused(ask):
    def parts():
        yield b"{}"

    assert "without its length" in told(ask.post("/api/compare", content=parts()), 411)


def test_whatever_is_refused_has_one_shape(ask):
    deep = b'{"record":' + b"[" * 50_000 + b"]" * 50_000 + b"}"
    headers = {"Content-Type": "application/json"}
    assert told(ask.post("/api/models", content=deep, headers=headers), 400)
    assert told(ask.get("/api/nothing"), 404)
    assert told(ask.put("/api/session"), 405)


@pytest.mark.slow
def test_the_ranges_of_a_record_have_a_limit(ask, made):
    many = [{"start": k, "end": k + 1} for k in range(1001)]
    for place in ("ranges", "bad"):
        assert told(ask.patch(f"/api/records/{made[0]}", json={place: many}), 422)


def test_channels_that_no_page_can_list_are_refused(ask):
    rows = [
        ",".join(["t", *(f"c{k}" for k in range(5001))]),
        *(f"{k}" + ",1" * 5001 for k in (1, 2)),
    ]
    sent = {"files": ("wide.csv", "\n".join(rows).encode())}
    (failed,) = ask.post("/api/records/upload", files=sent).json()["failed"]
    assert "expected at most 5,000" in failed["message"]


def test_a_body_of_another_shape_is_refused_in_one_line(ask):
    for body in ({}, {"path": 3}, {"path": "first.csv", "more": 1}, []):
        assert "\n" not in told(ask.post("/api/records", json=body), 422)


# ----------------------------------------------------------------------------------------- records
def test_files_of_the_folder_are_listed(ask):
    found = {one["name"]: one["readable"] for one in ask.get("/api/files").json()}
    assert found["first.csv"]
    assert not found["notes.md"]


def test_a_card_says_what_the_file_holds(ask):
    card = opened(ask)
    assert (card["n_samples"], card["uniform"]) == (400, True)
    assert card["dt"] == pytest.approx(0.05)
    assert card["duration"] == pytest.approx(19.95)
    assert (card["inputs"], card["outputs"]) == (["elevator"], ["q"])
    elevator = card["channels"][0]
    assert (elevator["unit"], elevator["minimum"], elevator["maximum"]) == ("deg", -1.0, 1.0)
    assert "read_record" in card["python"]
    commands = [line.split()[:2] for line in card["command_line"].splitlines()]
    assert commands == [["tridentify", "advise"], ["tridentify", "manoeuvres"]]
    assert "source" not in card


def test_series_are_samples_or_ranges_of_columns(ask, made):
    path = f"/api/records/{made[0]}/series?channels=elevator,q"
    all_of_it = ask.get(f"{path}&start=0&end=100&pixels=1000").json()
    assert len(all_of_it["time"]) == 400
    assert not all_of_it["thinned"]
    assert all_of_it["channels"]["q"]["minimum"] == all_of_it["channels"]["q"]["maximum"]
    thin = ask.get(f"{path}&start=0&end=19.95&pixels=20").json()
    assert thin["thinned"]
    assert len(thin["time"]) == 20
    assert max(thin["channels"]["elevator"]["maximum"]) == 1.0
    highest = max(all_of_it["channels"]["q"]["maximum"])
    assert max(thin["channels"]["q"]["maximum"]) == highest
    part = ask.get(f"{path}&start=5&end=6&pixels=1000").json()
    assert part["time"][0] == pytest.approx(5.0)
    assert part["time"][-1] == pytest.approx(6.0)
    assert "no channel" in told(ask.get(f"/api/records/{made[0]}/series?channels=zz"), 400)


def test_uploads_are_read_and_kept_and_bad_ones_told_by_name(ask):
    answer = ask.post(
        "/api/records/upload",
        files=[
            ("files", ("../../third.csv", flight(seed=5).encode())),
            ("files", ("empty.csv", b"")),
        ],
    ).json()
    (card,) = answer["records"]
    assert (card["name"], card["path"], card["n_samples"]) == ("third", None, 400)
    (failed,) = answer["failed"]
    assert failed["name"] == "empty.csv"
    assert "'empty.csv'" in failed["message"]
    assert estimated(ask, card["id"], poles="2")


def test_a_file_without_time_is_read_with_a_stated_step(ask, folder):
    rows = flight().splitlines()
    (folder / "timeless.csv").write_text("\n".join(row.partition(",")[2] for row in rows))
    said = told(ask.post("/api/records", json={"path": "timeless.csv"}), 400)
    assert "dt" in said
    stated = ask.post("/api/records", json={"path": "timeless.csv", "dt": 0.02})
    card = stated.json()["records"][0]
    assert card["dt"] == pytest.approx(0.02)
    assert "dt=0.02" in card["python"]
    model = ask.get(f"/api/models/{estimated(ask, card['id'])}").json()
    assert model["fit"][0] > 50
    for dt in (0, -1, "no"):
        assert told(ask.post("/api/records", json={"path": "timeless.csv", "dt": dt}), 422)
    content = (folder / "timeless.csv").read_bytes()
    sent = ask.post(
        "/api/records/upload", files=[("files", ("up.csv", content))], data={"dt": "0.05"}
    )
    assert sent.json()["records"][0]["dt"] == pytest.approx(0.05)


def test_a_file_that_is_no_table_is_refused_in_one_line(ask):
    assert "\n" not in told(ask.post("/api/records", json={"path": "broken.csv"}), 400)
    assert "no file" in told(ask.post("/api/records", json={"path": "none.csv"}), 400)


def test_roles_are_checked(ask):
    card = opened(ask, "second.csv")
    path = f"/api/records/{card['id']}"
    assert "no channel" in told(ask.patch(path, json={"inputs": ["alpha"]}), 400)
    assert "two roles" in told(ask.patch(path, json={"outputs": ["elevator", "q"]}), 400)
    late = [{"start": 3.0, "end": 1.0, "use": "identify"}]
    assert "later end" in told(ask.patch(path, json={"ranges": late}), 400)
    changed = ask.patch(path, json={"inputs": ["q"], "outputs": ["elevator"]}).json()
    assert changed["inputs"] == ["q"]
    ask.delete(path)
    assert "no record" in told(ask.get(f"{path}/series?channels=q"), 404)


def test_advice_and_manoeuvres(ask, made):
    advice = ask.get(f"/api/records/{made[0]}/advice").json()
    assert "elevator" in advice["summary"]
    assert dict(advice["facts"])["record"].startswith("400 samples")
    assert isinstance(advice["notes"], list)
    assert advice["response"][0]["coherence"]
    found = ask.get(f"/api/records/{made[0]}/manoeuvres").json()
    assert found
    assert found[0]["why"]


# ------------------------------------------------------------------------------------------ models
def test_a_range_comes_with_the_estimate_and_the_answer_with_its_end(ask):
    card = opened(ask, "second.csv")
    ranges = [{"start": 2.0, "end": 12.0, "use": "identify"}]
    sent = {"record": card["id"], "changes": {"ranges": ranges}, "alone": True}
    answer = ask.post("/api/models", json=sent).json()
    assert answer["record"]["ranges"] == ranges
    end = time.monotonic() + PATIENCE
    while (job := ask.get(f"/api/jobs/{answer['job']}?wait=2").json())["state"] != "done":
        assert time.monotonic() < end
    models = job["session"]["models"]
    assert [one["id"] for one in models if one["shown"]] == [answer["model"]]
    assert job["detail"] == ask.get(f"/api/models/{answer['model']}").json()
    wrong = {**sent, "changes": {"ranges": [{"start": 3.0, "end": 1.0}]}}
    assert "expected its end after" in told(ask.post("/api/models", json=wrong), 400)


def test_stretches_beyond_a_limit(ask, made):
    path = f"/api/records/{made[0]}/stretches"
    found = ask.get(f"{path}?channel=elevator&high=1").json()
    rest = ask.get(f"{path}?channel=elevator&low=-1").json()
    assert sum(one["end"] - one["start"] for one in (*found, *rest)) == pytest.approx(
        0.05 * 399 - 0.025 * (len(found) + len(rest) - 1), abs=0.03
    )
    assert ask.get(f"{path}?channel=q&high=1e9").json() == []
    assert "no channel" in told(ask.get(f"{path}?channel=zz&high=1"), 400)


def test_ranges_that_overlap_are_noted():
    def card(*ranges):
        return {"ranges": [dict(zip(("start", "end", "use"), one, strict=True)) for one in ranges]}

    made, tested = (0.0, 6.0, "identify"), (6.0, 9.0, "validate")
    assert shared_time(card(made, tested)) == shared_time(card(made)) == shared_time(card()) == ""
    assert "share 5 to 6 s and 8 to 9 s" in shared_time(
        card(made, (8.0, 9.5, "identify"), (5.0, 9.0, "validate"))
    )
    assert "whole record" in shared_time(card(tested))


def test_a_model_is_the_one_identify_gives(ask, made, bench):
    detail = ask.get(f"/api/models/{made[1]}").json()
    assert detail["structure"] == "2 poles, 1 zero"
    values = {one["name"]: one for one in detail["parameters"]}
    assert set(values) == {"a1", "a0", "b1", "b0"}
    for name, truth in (("a1", 1.6), ("a0", 4.0), ("b1", 2.0), ("b0", 6.0)):
        assert abs(values[name]["value"] - truth) < 4 * values[name]["std"]
        assert values[name]["low"] < values[name]["value"] < values[name]["high"]
    assert 0 < len(detail["numbers"]) <= 4
    assert "2 poles and 1 zero" in detail["sentence"]
    lines = {}
    exec(detail["python"].replace("print(", "str("), lines)
    assert lines["estimate"].parameters["a0"].value == pytest.approx(
        values["a0"]["value"], rel=1e-9
    )


def test_every_picture_has_its_numbers(ask, made):
    path = f"/api/models/{made[1]}/panel"
    (fit,) = ask.get(f"{path}/fit").json()["outputs"]
    assert len(fit["time"]) == len(fit["measured"]) == len(fit["model"]) == 400
    assert np.std(np.subtract(fit["measured"], fit["model"])) < 0.03
    (residual,) = ask.get(f"{path}/residual").json()["outputs"]
    assert len(residual["lags"]) == len(residual["autocorrelation"])
    assert len(residual["crosscorrelation"]["elevator"]) == len(residual["lags"])
    assert residual["tests"]
    (bode,) = ask.get(f"{path}/bode").json()["pairs"]
    k = int(np.argmin(np.abs(np.array(bode["frequency"]) - 2.0)))
    w = bode["frequency"][k]
    truth = (2j * w + 6.0) / ((1j * w) ** 2 + 1.6j * w + 4.0)
    assert bode["magnitude_db"][k] == pytest.approx(20 * np.log10(abs(truth)), abs=0.3)
    assert bode["phase_deg"][k] == pytest.approx(np.degrees(np.angle(truth)), abs=3.0)
    assert bode["magnitude_low"][k] < bode["magnitude_db"][k] < bode["magnitude_high"][k]
    assert len(bode["measured"]["coherence"]) == len(bode["measured"]["frequency"])
    (step,) = ask.get(f"{path}/step").json()["pairs"]
    assert step["value"][0] == pytest.approx(0.0, abs=1e-9)
    assert step["value"][-1] == pytest.approx(1.5, abs=0.1)
    poles = ask.get(f"{path}/poles").json()
    assert sorted(one["frequency"] for one in poles["poles"]) == pytest.approx([2.0, 2.0], abs=0.1)
    assert poles["pairs"][0]["zeros"][0]["re"] == pytest.approx(-3.0, abs=0.5)
    assert "no picture" in told(ask.get(f"{path}/nyquist"), 404)


def test_models_are_compared_on_another_record(ask, made):
    other = opened(ask, "second.csv")["id"]
    simple = estimated(ask, made[0], poles="1", zeros="0")
    found = ask.post("/api/compare", json={"models": [made[1], simple], "record": other}).json()
    assert found["outputs"] == ["q"]
    assert found["fits"][0][0] > 95 > found["fits"][1][0]
    assert found["summary"].startswith("Model")
    assert "compare(" in found["python"]
    ranges = [{"start": 2.0, "end": 6.0, "use": "validate"}]
    ask.patch(f"/api/records/{other}", json={"ranges": ranges})
    again = ask.post("/api/compare", json={"models": [made[1], simple], "record": other}).json()
    assert again["summary"].startswith("On its range for validation, 2 to 6 s: Model")


def test_a_model_on_the_range_for_validation(ask):
    card = opened(ask)
    ranges = [
        {"start": 0.0, "end": 12.0, "use": "identify"},
        {"start": 12.0, "end": 19.0, "use": "validate"},
    ]
    ask.patch(f"/api/records/{card['id']}", json={"ranges": ranges})
    model = estimated(ask, card["id"])
    detail = ask.get(f"/api/models/{model}").json()
    assert detail["validation_fit"][0] > 95
    assert ".slice(0.0, 12.0)" in detail["python"]
    assert "--to 12.0" in detail["command_line"]
    (fit,) = ask.get(f"/api/models/{model}/panel/fit").json()["outputs"]
    assert fit["time"][-1] == pytest.approx(12.0)


def test_bad_samples_are_left_out(ask):
    card = opened(ask)
    bad = [{"start": 5.0, "end": 6.0}]
    ask.patch(f"/api/records/{card['id']}", json={"bad": bad})
    model = estimated(ask, card["id"])
    (fit,) = ask.get(f"/api/models/{model}/panel/fit").json()["outputs"]
    missing = [t for t, y in zip(fit["time"], fit["measured"], strict=True) if y is None]
    assert (missing[0], missing[-1]) == (pytest.approx(5.0), pytest.approx(6.0))


@pytest.mark.slow
def test_knowledge_and_physical_maps(ask, made):
    model = estimated(ask, made[0], fixed="a0=4", noise="white")
    rows = {one["name"]: one for one in ask.get(f"/api/models/{model}").json()["parameters"]}
    assert (rows["a0"]["value"], rows["a0"]["status"]) == (4.0, "fixed")
    mapped = estimated(ask, made[0], zeros="0", physical="mass-spring-damper")
    detail = ask.get(f"/api/models/{mapped}").json()
    assert detail["physical"]
    assert "Channels" not in detail["sentence"]
    (note,) = detail["physical_notes"]
    assert note == "Channels by their names: force is elevator, position is q."


def test_of_many_physical_parameters_that_do_as_well_one_set_is_told():
    others = [f"these explain the record as well: m={mass}" for mass in (2, 5, 9)]
    told, kept = _few([*others, "the delay is held"])
    assert told.startswith("these explain the record as well: m=2, and 2 other sets")
    assert "Known parameters" in told
    assert kept == "the delay is held"
    assert _few(["the delay is held"]) == ["the delay is held"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"poles": "99"}, "expected one of"),
        ({"colour": "red"}, "expected one of"),
        ({"delay": "soon"}, "expected seconds"),
        ({"fixed": "a0:4"}, "such as a0=12"),
        ({"noise": "ar", "method": "svf-least-squares"}, "three-model"),
        ({"poles": "1", "zeros": "3"}, "zeros"),
    ],
)
def test_options_that_make_no_estimate_are_refused(ask, made, options, words):
    body = {"record": made[0], "options": options}
    assert words in told(ask.post("/api/models", json=body), 400)


def test_an_input_that_does_not_move_is_told(ask):
    record = opened(ask, "still.csv")
    body = {"record": record["id"], "options": {}}
    ask.patch(f"/api/records/{record['id']}", json={"inputs": ["elevator"], "outputs": ["q"]})
    job = ended(ask, ask.post("/api/models", json=body).json()["job"])
    assert job["state"] == "failed"
    assert "elevator does not move" in job["error"]["message"]


def test_a_range_of_bad_samples_alone_is_told(ask):
    card = opened(ask)
    for bad in ((0.0, 20.0), (2.0, 12.0)):
        changes = {
            "ranges": [{"start": 3.0, "end": 10.0}],
            "bad": [dict(zip(("start", "end"), bad, strict=True))],
        }
        sent = {"record": card["id"], "changes": changes}
        job = ended(ask, ask.post("/api/models", json=sent).json()["job"])
        assert "no sample that counts" in job["error"]["message"]
        assert "Remove such a range" in job["error"]["remedy"]


def test_without_an_input_nothing_is_estimated(ask):
    record = opened(ask)
    ask.patch(f"/api/records/{record['id']}", json={"inputs": []})
    body = {"record": record["id"], "options": {}}
    assert "no input" in told(ask.post("/api/models", json=body), 400)


@pytest.mark.slow
def test_an_estimate_is_cancelled_and_the_next_one_is_made(ask, made):
    body = {"record": made[0], "options": {"poles": "auto"}}
    job = ask.post("/api/models", json=body).json()
    assert ask.delete(f"/api/jobs/{job['job']}").status_code == 200
    assert ended(ask, job["job"])["state"] == "cancelled"
    assert estimated(ask, made[0])
    assert job["model"] not in [one["id"] for one in ask.get("/api/session").json()["models"]]
    assert ask.get("/api/jobs/j999").status_code == 404


@pytest.mark.parametrize(
    ("kind", "ending"),
    [("json", ".json"), ("matlab", ".m"), ("c", ".h"), ("control", ".py"), ("figure", ".svg"),
     ("table", ".csv"), ("report", ".html")],
)  # fmt: skip
def test_a_model_leaves_as_a_file(ask, made, kind, ending, tmp_path):
    answer = ask.get(f"/api/models/{made[1]}/export/{kind}")
    assert answer.status_code == 200, answer.text
    name = answer.headers["content-disposition"].split('"')[1]
    assert name.endswith(ending)
    path = tmp_path / name
    path.write_bytes(answer.content)
    if kind == "json":
        assert Estimate.load(path).names == ("a1", "a0", "b1", "b0")
    elif kind == "control":
        control = pytest.importorskip("control")
        place = {}
        exec(path.read_text(), place)
        assert isinstance(place["model"], control.TransferFunction)
        assert np.abs(place["model"].poles()) == pytest.approx([2.0, 2.0], abs=0.1)
    elif kind == "c":
        model = tmp_path / "model.json"
        model.write_bytes(ask.get(f"/api/models/{made[1]}/export/json").content)
        assert f"Sampling interval: {Estimate.load(model).dt!r} s" in path.read_text()
    else:
        assert path.stat().st_size > 100


def test_an_unknown_file_is_refused(ask, made):
    assert "expected one of" in told(ask.get(f"/api/models/{made[1]}/export/exe"), 400)


def test_models_are_renamed_ticked_and_removed(ask, made):
    model = estimated(ask, made[0])
    assert ask.patch(f"/api/models/{model}", json={"shown": False}).json()["shown"] is False
    assert ask.patch(f"/api/models/{model}", json={"name": "best"}).json()["name"] == "best"
    ask.delete(f"/api/models/{model}")
    assert "no model" in told(ask.patch(f"/api/models/{model}", json={"shown": True}), 404)
    undone = ask.post("/api/undo").json()
    assert "best" in [one["name"] for one in undone["models"]]
    assert undone["can_redo"]
    again = ask.post("/api/redo").json()
    assert "best" not in [one["name"] for one in again["models"]]


def test_options_are_listed_with_their_words(ask):
    found = {one["name"]: one for one in ask.get("/api/options").json()}
    assert {"poles", "zeros", "delay", "noise", "method", "fixed", "physical"} <= set(found)
    for one in found.values():
        assert one["help"]
        assert one["type"] == "text" or one["default"] in one["choices"]


# ----------------------------------------------------------------------------------------- session
@pytest.mark.slow
def test_a_session_comes_back_after_its_process_was_killed(folder, tmp_path):
    """The file is opened a second time while the first process never said good-bye."""
    first = Bench(Session(tmp_path / "s.sqlite"), folder)
    token = first.session.token
    app = create(first, Guard(TOKEN, PORT))
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}", headers=HEADERS) as client:
        card = opened(client)
        ranges = [{"start": 1.0, "end": 15.0, "use": "identify"}]
        client.patch(f"/api/records/{card['id']}", json={"ranges": ranges})
        model = estimated(client, card["id"])
        before = client.get("/api/session").json()
        sentence = client.get(f"/api/models/{model}").json()["sentence"]
    copy = tmp_path / "copy.sqlite"
    for path in tmp_path.glob("s.sqlite*"):
        (tmp_path / path.name.replace("s.", "copy.", 1)).write_bytes(path.read_bytes())
    second = Bench(Session(copy), folder)
    app = create(second, Guard(TOKEN, PORT))
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}", headers=HEADERS) as client:
        after = client.get("/api/session").json()
        assert after == before
        assert client.get(f"/api/models/{model}").json()["sentence"] == sentence
        assert second.session.token == token
        assert estimated(client, card["id"]) != model
    for bench in (first, second):
        bench.stop()


@pytest.mark.slow
def test_a_file_that_is_gone_is_told_and_its_models_stay(tmp_path):
    (tmp_path / "log.csv").write_text(flight())
    bench = Bench(Session(tmp_path / "s.sqlite"), tmp_path)
    app = create(bench, Guard(TOKEN, PORT))
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}", headers=HEADERS) as client:
        card = opened(client, "log.csv")
        model = estimated(client, card["id"])
        os.rename(tmp_path / "log.csv", tmp_path / "moved.csv")
        assert client.get("/api/session").json()["records"][0]["missing_file"]
        assert client.get(f"/api/models/{model}").status_code == 200
        body = {"record": card["id"], "options": {}}
        job = ended(client, client.post("/api/models", json=body).json()["job"])
        assert "put it back" in json.dumps(job["error"]).lower()
    bench.stop()


def test_another_file_is_no_session(tmp_path):
    from tridentify.errors import UnreadableFileError

    path = Path(tmp_path, "s.sqlite")
    path.write_bytes(b"this is a letter, not a data base" * 100)
    with pytest.raises(UnreadableFileError, match="no session"):
        Session(path)
    assert path.read_bytes().startswith(b"this is a letter")


@pytest.mark.parametrize(
    ("names", "roles"),
    [
        ("u_heater1,u_heater2,y_T1,y_T2", "input input output output"),
        ("u1,u2,r1,r2,y1,y2", "input input reference reference output output"),
        ("u_volt,y_pos,r_pos,u_pulse", "input output reference input"),
        ("rudder,p,r,phi", "input output unused unused"),
        ("elevator,u_m_s,w_m_s,q", "input output unused unused"),
        ("iq_ref,iq,theta_m", "reference input output"),
    ],
)
def test_roles_are_guessed_from_names_and_their_company(names, roles):
    rng = np.random.default_rng(6)
    rows = np.column_stack([0.1 * np.arange(80), rng.standard_normal((80, names.count(",") + 1))])
    text = f"t,{names}\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    found = read_series(text.encode())
    guessed = guess_roles([one.channel.name for one in found], [one.values for one in found])
    assert guessed == roles.split()


# ------------------------------------------------------------------- files that change under them
@pytest.fixture
def own(folder, tmp_path, ask):
    """A file of its own, which may be changed, and its record."""
    path = folder / f"{tmp_path.name}.csv"
    path.write_text(flight())
    return path, opened(ask, path.name)["id"]


def now(ask, record):
    """A record and the marks of its models, as a page that looks again is told."""
    session = ask.get("/api/session").json()
    (card,) = (one for one in session["records"] if one["id"] == record)
    marks = {one["id"]: one["older_file"] for one in session["models"] if one["record"] == record}
    return card, marks


def test_a_file_that_changes_is_told_and_read_anew(ask, own):
    path, record = own
    model = estimated(ask, record, poles="2")
    before = ask.get(f"/api/models/{model}").json()
    ask.patch(
        f"/api/records/{record}",
        json={"ranges": [{"start": 1.0, "end": 9.0}, {"start": 15.0, "end": 19.0}]},
    )
    path.write_text(flight(n=200, seed=7).replace("q [deg/s]", "r [deg/s]"))
    card, marks = now(ask, record)
    assert (card["n_samples"], card["outputs"]) == (200, [])
    said = card["changed_file"]
    assert "400 samples became 200, 19.95 s became 9.95 s, gone: q (in use), new: r." in said
    assert "Beyond its end lies 15 to 19 s" in said
    assert marks == {model: True}
    after = ask.get(f"/api/models/{model}").json()
    assert after["parameters"] == before["parameters"]
    assert "no pictures, since q is not in the file any more" in after["older_file"]
    assert (before["pictures"], after["pictures"]) == (True, False)
    for kind in ("report", "figure"):
        answer = ask.get(f"/api/models/{model}/export/{kind}")
        assert "estimate again" in told(answer, 400).lower()
    assert ask.get(f"/api/models/{model}/export/json").status_code == 200


def test_a_new_estimate_is_of_the_new_content_and_ends_the_word(ask, own):
    path, record = own
    first = estimated(ask, record, poles="2")
    path.write_text(flight(seed=7))
    assert "other values in the same samples and columns" in now(ask, record)[0]["changed_file"]
    second = estimated(ask, record, poles="2")
    card, marks = now(ask, record)
    assert card["changed_file"] == ""
    assert marks == {first: True, second: False}
    values = [[one["value"] for one in ask.get(f"/api/models/{model}").json()["parameters"]]
              for model in (first, second)]  # fmt: skip
    assert values[0] != values[1]
    path.write_text(flight())  # as it was
    assert now(ask, record)[1] == {first: False, second: True}


def test_an_estimate_alone_finds_the_change(ask, own):
    path, record = own
    path.write_text(flight(seed=7).replace("elevator", "rudder"))
    answer = ask.post("/api/models", json={"record": record, "options": {}})
    assert "found no input" in told(answer, 400).lower()


def test_a_file_that_is_touched_is_not_told(ask, own):
    path, record = own
    os.utime(path, (1.0, 1.0))
    assert now(ask, record)[0]["changed_file"] == ""


def test_a_file_that_becomes_none_is_told_and_read_when_it_is_put_right(ask, own):
    path, record = own
    model = estimated(ask, record, poles="2")
    content = path.read_text()
    path.write_text("half a li")
    card, _ = now(ask, record)
    assert "is no record any more" in card["changed_file"]
    assert card["n_samples"] == 400
    assert ask.get(f"/api/models/{model}").status_code == 200
    path.write_text(content)
    os.utime(path, (2.0, 2.0))
    card, marks = now(ask, record)
    assert (card["n_samples"], card["changed_file"], marks) == (400, "", {model: False})


def test_what_was_told_is_put_away_and_not_told_again_after_an_undo(ask, own):
    path, record = own
    ask.patch(f"/api/records/{record}", json={"name": "another"})
    path.write_text(flight(n=300))
    assert now(ask, record)[0]["changed_file"]
    assert ask.patch(f"/api/records/{record}", json={"changed_file": ""}).status_code == 200
    assert now(ask, record)[0]["changed_file"] == ""
    ask.post("/api/undo")
    card, _ = now(ask, record)
    assert (card["n_samples"], card["name"], card["changed_file"]) == (300, path.stem, "")
    answer = ask.patch(f"/api/records/{record}", json={"changed_file": "hello"})
    assert answer.status_code == 422


@pytest.mark.slow
def test_a_session_of_before_files_were_looked_at_again_goes_on(ask, own, bench):
    path, record = own
    model = estimated(ask, record, poles="2")
    state = copy.deepcopy(bench.session.state)
    for one in [*state["records"], *state["models"]]:
        for name in ("stamp", "digest", "changed_file", "unreadable"):
            one.pop(name, None)
    bench.session.overwrite(state)
    card, marks = now(ask, record)
    assert (card["changed_file"], marks) == ("", {model: False})
    assert ask.get(f"/api/models/{model}").json()["older_file"] == ""
    path.write_text(flight(n=300))
    assert "400 samples became 300" in now(ask, record)[0]["changed_file"]


def test_a_folder_that_vanishes_is_no_fault(tmp_path):
    folder = tmp_path / "flights"
    folder.mkdir()
    (folder / "one.csv").write_text(flight())
    bench = Bench(Session(tmp_path / "s.sqlite"), folder)
    app = create(bench, Guard(TOKEN, PORT))
    with Typed(app, base_url=f"http://127.0.0.1:{PORT}", headers=HEADERS) as client:
        record = opened(client, "one.csv")["id"]
        folder.rename(tmp_path / "elsewhere")
        assert client.get("/api/files").json() == []
        assert client.get("/api/session").json()["records"][0]["missing_file"]
        assert client.patch(f"/api/records/{record}", json={"name": "kept"}).status_code == 200
        answer = client.post("/api/records", json={"path": "one.csv"})
        assert "found no file 'one.csv'" in told(answer, 400).lower()
        assert "where it was opened" in told(client.get(f"/api/records/{record}/series"), 400)
        (tmp_path / "elsewhere").rename(folder)
        (card,) = client.get("/api/session").json()["records"]
        assert (card["missing_file"], card["changed_file"], card["name"]) == (False, "", "kept")
    bench.stop()


def test_a_session_that_cannot_be_written_is_told(ask, made, bench, monkeypatch):
    def full(state):
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(bench.session, "write", full)
    answer = ask.patch(f"/api/records/{made[0]}", json={"name": "lost"})
    assert "disk is full" in told(answer, 507)
    monkeypatch.undo()
    assert now(ask, made[0])[0]["name"] != "lost"


# ------------------------------------------------------------------------------------- the types
def test_every_request_has_a_type_and_every_type_was_asked_for(ask, request):
    """The last test: each answer of those before was held against its type."""
    paths = ask.app.openapi()["paths"]
    routes = {f"{method.upper()} {path}" for path, methods in paths.items()
              for method in methods if path.startswith("/api")}  # fmt: skip
    untyped = {"GET /api/events", "GET /api/models/{name}/export/{kind}"}
    assert routes - untyped == set(ANSWERS)
    items = request.session.items
    own = [one for one in items if getattr(one, "module", None) is request.module]
    names = {name for name in vars(request.module) if name.startswith("test_")}
    before = {one.nodeid for one in own[: own.index(request.node)]}
    # not where some of them ran in another process, or were not asked for
    if {one.originalname for one in own} == names and before <= RAN:
        assert set(ANSWERS) - ask.asked == set()


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        ({"revision": "1"}, Revision), ({"revision": True}, Revision), ({}, Revision),
        ({"revision": 1, "more": 1}, Revision), ([{"start": 1, "end": None}], list[Stretch]),
    ],
)  # fmt: skip
def test_what_has_not_its_type_is_found(value, kind):
    assert unlike(value, kind)
