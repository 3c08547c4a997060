"""The workbench from Python and from the command line."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import urllib.request

import pytest

from tridentify import Record
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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.csv"], "found no file"),
        (["--session", "/nowhere/at/all.sqlite"], "session"),
    ],
)
def test_mistakes_on_the_command_line_are_one_line(tmp_path, arguments, words):
    done = subprocess.run(
        [sys.executable, "-m", "tridentify", "app", *arguments, "--no-open"],
        cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) <= 3


def test_a_port_in_use_is_told(tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        done = subprocess.run(
            [sys.executable, "-m", "tridentify", "app", "--port", port, "--no-open"],
            cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
    assert done.returncode == 2
    assert f"found the port {port} in use" in done.stderr
