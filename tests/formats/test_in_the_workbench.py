"""Files of other programs, opened in the workbench as bytes that a browser sends."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip("fastapi", reason="the extra app is not installed")
from fastapi.testclient import TestClient

from tridentify import Record, TransferFunction, simulate
from tridentify.app.bench import Bench
from tridentify.app.safety import Guard
from tridentify.app.server import create
from tridentify.app.session import Session

PORT, TOKEN = 8765, "token-of-the-tests-of-formats-0123456789"
PATIENCE = 120.0
N, DT = 400, 0.02


@pytest.fixture(scope="module")
def signals():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 20), 20)
    y = simulate(TransferFunction([9.0], [1.0, 3.0, 9.0]), Record(u, u, dt=DT))[:, 0]
    return DT * np.arange(N), u, y + 0.01 * rng.standard_normal(N)


@pytest.fixture(scope="module")
def ask(tmp_path_factory):
    # not started ahead: a process comes with the first task for it, and the spare one never
    bench = Bench(Session(tmp_path_factory.mktemp("session") / "s.sqlite"), None)
    app = create(bench, Guard(TOKEN, PORT))
    headers = {"Authorization": f"Bearer {TOKEN}"}
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}", headers=headers) as client:
        yield client
    bench.stop()


def matlab5(write, path, t, u, y):
    return write.matlab5(path, {"t": t, "u": u, "y": y})


def matlab73(write, path, t, u, y):
    return write.matlab73(path, {"t": t, "u": u, "y": y})


def ulog(write, path, t, u, y):
    stamps = np.round(1e6 * t).astype(np.int64)
    return write.ulog(path, {"test": {"timestamp": stamps, "u": u, "y": y}})


def mdf(write, path, t, u, y):
    pytest.importorskip("asammdf", reason="the reader of MDF files is not installed")
    return write.mdf(path, [(t, {"u": (u, "V"), "y": (y, "m")})])


@pytest.mark.parametrize(
    ("ending", "made"), [("mat", matlab5), ("mat", matlab73), ("ulg", ulog), ("mf4", mdf)]
)
@pytest.mark.slow
def test_its_bytes_give_an_estimate(ask, write, signals, tmp_path, ending, made):
    path = made(write, tmp_path / f"log.{ending}", *signals)
    sent = ask.post("/api/records/upload", files=[("files", (path.name, path.read_bytes()))])
    assert sent.json()["failed"] == []
    card = sent.json()["records"][0]
    assert card["n_samples"] == N
    assert [name.rsplit(".", 1)[-1] for name in (*card["inputs"], *card["outputs"])] == ["u", "y"]
    options = {"poles": "2", "zeros": "0"}
    job = ask.post("/api/models", json={"record": card["id"], "options": options}).json()
    end = time.monotonic() + PATIENCE
    while ask.get(f"/api/jobs/{job['job']}").json()["state"] in ("queued", "running"):
        assert time.monotonic() < end
        time.sleep(0.02)
    model = ask.get(f"/api/models/{job['model']}").json()
    found = {row["name"]: row["value"] for row in model["parameters"]}
    assert found["a0"] == pytest.approx(9.0, rel=0.05)
