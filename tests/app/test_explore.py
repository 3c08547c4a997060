"""The workbench from Python and from the command line."""

from __future__ import annotations

import html
import json
import shlex
import socket
import sqlite3
import subprocess
import sys
import time
import urllib.error
import urllib.request
from importlib.resources import files

import pytest

from tridentify import Record, identify
from tridentify.app.notebook import PATIENCE, _asked, _free_port
from tridentify.cli import main
from tridentify.data import short_period

pytest.importorskip("fastapi", reason="the extra app is not installed")


def test_a_record_in_memory_is_opened_with_its_roles(tmp_path):
    record = short_period()
    turned = Record(
        record.y[:, 1], record.u, dt=record.dt, input_names=["q"], output_names=["delta_e"],
        name="turned round",
    )  # fmt: skip
    opened = turned.explore(folder=tmp_path, open_page=False)
    try:
        token = opened.address.split("token=")[1]
        root = opened.address.split("/?")[0]
        request = urllib.request.Request(
            f"{root}/api/session", headers={"Authorization": f"Bearer {token}"}
        )
        (card,) = json.load(urllib.request.urlopen(request, timeout=30))["records"]
        assert (card["inputs"], card["outputs"]) == (["q"], ["delta_e"])
        assert (card["n_samples"], card["intersample"]) == (501, "zoh")
        assert opened.address in opened._repr_html_()
    finally:
        opened.stop()
    assert (tmp_path / ".tridentify-session.sqlite").exists()


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """What the command says that does not start, in a folder of the test."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        assert main(["app", *arguments, "--no-open"]) == 2
        return capsys.readouterr().err

    return call


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.csv"], "found no file"),
        (["--session", "/nowhere/at/all.sqlite"], "session"),
    ],
)
def test_mistakes_on_the_command_line_are_one_line(refused, arguments, words):
    said = refused(*arguments)
    assert words in said
    assert len(said.strip().splitlines()) <= 3


def test_a_port_in_use_is_told(refused):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        said = refused("--port", port)
    assert f"found the port {port} in use" in said


@pytest.mark.slow
def test_a_session_is_open_in_one_workbench_at_a_time(refused, tmp_path):
    from tridentify.app import start
    from tridentify.app.session import Session

    path = tmp_path / "s.sqlite"
    with start._alone(Session(path)):
        said = refused("--session", str(path))
        assert "open in another workbench; expected one at a time" in said
    with start._alone(Session(path)) as again:
        assert again.state["records"] == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("update facts set value = '0' where name = 'format'", "a session of another version"),
        ("update snapshots set document = '{half'", "a session that is damaged"),
    ],
)
def test_a_session_that_is_none_of_ours_is_told(tmp_path, change, words):
    from tridentify.app.session import Session
    from tridentify.errors import UnreadableFileError

    kept = Session(tmp_path / "s.sqlite")
    kept.write({"records": [], "models": []})
    kept.close()
    base = sqlite3.connect(tmp_path / "s.sqlite")
    base.execute(change)
    base.commit()
    base.close()
    with pytest.raises(UnreadableFileError, match=words):
        Session(tmp_path / "s.sqlite")


@pytest.mark.slow
def test_a_report_says_how_to_open_its_record_here(tmp_path):
    record = short_period().select(outputs=["q"])
    (tmp_path / "short_period.csv").write_bytes(
        files("tridentify.data").joinpath("short_period.csv").read_bytes()
    )
    page = identify(record, (2, 1)).report(tmp_path / "report.html", record).read_text()
    section = page.split("Open in the workbench</h2>")[1]
    command = html.unescape(section.split("<pre>")[1].split("</pre>")[0]).splitlines()[0]
    words = shlex.split(command)
    assert words == ["tridentify", "app", "short_period.csv"]
    port, token = _free_port(), "token-of-the-report-0123456789"
    process = subprocess.Popen(
        [sys.executable, "-m", *words, "--no-open", "--port", str(port), "--token", token],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        end = time.monotonic() + PATIENCE
        while True:
            try:
                session = _asked(f"http://127.0.0.1:{port}", token, "/session")
                break
            except (urllib.error.URLError, ConnectionError):
                assert process.poll() is None
                assert time.monotonic() < end
                time.sleep(0.05)
    finally:
        process.terminate()
        process.wait()
    assert [one["name"] for one in session["records"]] == ["short_period"]
