"""The routes of the workbench; `docs/app_interface.md` describes them for other programs.

What the routes of the workbench take, checked before anything is done with it.
"""

from __future__ import annotations

import asyncio
import json
import sqlite3
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Literal

import plotly
from fastapi import APIRouter, FastAPI, File, Form, Request, UploadFile
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, Response, StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from tridentify.app.bench import Bench
from tridentify.app.panels import PANELS
from tridentify.app.refusals import MissingError, known, refusal
from tridentify.app.safety import Guard, problem
from tridentify.errors import TridentifyError
from tridentify.options import OPTIONS

MOST_RANGES = 1_000
"""Of a record: every action keeps them all."""


class Strict(BaseModel):
    """A body that holds what it names, and nothing else."""

    model_config = ConfigDict(extra="forbid")


class Opening(Strict):
    """Which file of the folder is opened."""

    path: str = Field(min_length=1, max_length=1000)
    dt: float | None = Field(default=None, gt=0.0, allow_inf_nan=False)


class Range(Strict):
    """A stretch of a record [s from its start]."""

    start: float = Field(allow_inf_nan=False)
    end: float = Field(allow_inf_nan=False)
    use: Literal["identify", "validate"] = "identify"


class Stretch(Strict):
    """Samples that are left out [s from the record's start]."""

    start: float = Field(allow_inf_nan=False)
    end: float = Field(allow_inf_nan=False)
    use: str | None = None


class RecordChanges(Strict):
    """What is to be different of a record."""

    name: str | None = Field(None, min_length=1, max_length=200)
    inputs: list[str] | None = None
    outputs: list[str] | None = None
    references: list[str] | None = None
    intersample: Literal["auto", "zoh", "foh", "band-limited"] | None = None
    ranges: list[Range] | None = Field(None, max_length=MOST_RANGES)
    bad: list[Stretch] | None = Field(None, max_length=MOST_RANGES)
    changed_file: Literal[""] | None = None


class ModelWanted(Strict):
    """What is to be estimated from a record."""

    record: str
    options: dict[str, str | int | float | bool | None] = Field(default_factory=dict)
    name: str | None = Field(None, min_length=1, max_length=200)
    alone: bool = False
    changes: RecordChanges | None = None


class ModelChanges(Strict):
    """What is to be different of a model."""

    name: str | None = Field(None, min_length=1, max_length=200)
    shown: bool | None = None


class Comparing(Strict):
    """Models on one record."""

    models: list[str] = Field(min_length=1, max_length=50)
    record: str


TICK = 0.3
"""Seconds between two looks for what another tab changed."""
KINDS = {
    ".js": "text/javascript",
    ".css": "text/css",
    ".html": "text/html",
    ".svg": "image/svg+xml",
}
MOST_PIXELS = 5_000
"""Across: more than any screen has, and more points than a picture shows."""
NOT_TAKEN = (400, 404, 405)
"""Statuses of requests that reach no route, or whose body is not read."""
LONGEST_WAIT = 5.0
"""Seconds that a question about an estimate may wait for its end."""


def create(bench: Bench, guard: Guard) -> FastAPI:
    """The application: page, interface, and who may ask for them.

    Parameters
    ----------
    bench : Bench
    guard : Guard
        Of all that is asked.

    Returns
    -------
    FastAPI
    """
    app = FastAPI(title="tridentify workbench", docs_url=None, redoc_url=None, openapi_url=None)
    app.middleware("http")(_noted(bench))
    app.middleware("http")(guard)
    app.include_router(page())
    app.include_router(session(bench), prefix="/api")
    app.include_router(records(bench), prefix="/api")
    app.include_router(views(bench), prefix="/api")
    app.include_router(models(bench), prefix="/api")
    app.add_exception_handler(TridentifyError, _refused)
    app.add_exception_handler(RequestValidationError, _malformed)
    app.add_exception_handler(sqlite3.OperationalError, _unsaved)
    for status in NOT_TAKEN:
        app.add_exception_handler(status, _not_taken(status))
    app.add_exception_handler(Exception, _fault)
    return app


async def _refused(request: Request, error: Exception) -> Response:
    told = refusal(error)
    status = 404 if isinstance(error, MissingError) else 400
    return problem(status, told["code"], told["message"], told["remedy"])


async def _malformed(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    return problem(422, "malformed", f"found {where} that is wrong: {first['msg']}")


async def _unsaved(request: Request, error: Exception) -> Response:
    words = f"found that the session cannot be written ({error}); nothing was changed"
    return problem(507, "unsaved", words, "make room where it is kept, and do it again")


def _not_taken(status: int) -> Callable[[Request, Exception], Awaitable[Response]]:
    async def told(request: Request, error: Exception) -> Response:
        return problem(status, "request", str(getattr(error, "detail", error)))

    return told


async def _fault(request: Request, error: Exception) -> Response:
    words = f"a fault of this program: {type(error).__name__}: {error}"
    return problem(500, "fault", words, "report it with what you did")


def _noted(bench: Bench) -> Any:
    async def note(request: Request, follow: Any) -> Response:
        """Remember which page changes something, so that it is not told of its own action."""
        if request.method != "GET":
            bench.client = request.headers.get("x-client", "")[:64]
        answer: Response = await follow(request)
        return answer

    return note


# ------------------------------------------------------------------------------------------- page
def page() -> APIRouter:
    """The page itself and the library that draws."""
    router = APIRouter()
    with as_file(files("tridentify.app") / "page") as place:
        folder = Path(place)
    library = Path(plotly.__file__).parent / "package_data" / "plotly.min.js"

    @router.get("/")
    def index() -> Response:
        return FileResponse(folder / "index.html", media_type="text/html")

    @router.get("/page/{name}")
    def part(name: str) -> Response:
        known = {path.name: path for path in folder.iterdir() if path.suffix in KINDS}
        if name not in known:
            return problem(404, "missing", "there is no such part of the page")
        return FileResponse(known[name], media_type=KINDS[known[name].suffix])

    @router.get("/vendor/plotly.min.js")
    def vendor() -> Response:
        return FileResponse(library, media_type="text/javascript")

    @router.get("/favicon.ico")
    def icon() -> Response:
        return Response(status_code=204)

    return router


# ---------------------------------------------------------------------------------------- session
def session(bench: Bench) -> APIRouter:
    """The session as a whole, what can be asked, what goes on."""
    router = APIRouter()

    router.get("/session")(bench.document)
    router.get("/files")(bench.files)

    @router.get("/options")
    def options() -> list[dict[str, Any]]:
        return [one.to_dict() for one in OPTIONS]

    @router.post("/undo")
    def undo() -> dict[str, Any]:
        return bench.move(-1)

    @router.post("/redo")
    def redo() -> dict[str, Any]:
        return bench.move(1)

    @router.get("/events")
    async def events(request: Request) -> StreamingResponse:
        return StreamingResponse(_events(bench, request), media_type="text/event-stream")

    @router.get("/jobs/{name}")
    def job(name: str, wait: float = 0.0) -> dict[str, Any]:
        return bench.job(name, min(wait, LONGEST_WAIT))

    @router.delete("/jobs/{name}")
    def cancel(name: str) -> dict[str, Any]:
        found = bench.jobs.get(name)
        if found is not None:
            bench.jobs.cancel(found)
        return {}

    return router


async def _events(bench: Bench, request: Request) -> AsyncIterator[str]:
    """What changed, for pages that did not change it; a comment while nothing does."""
    last = bench.session.revision
    files = before = bench.stamps()
    yield ": open\n\n"
    while not await request.is_disconnected():
        await asyncio.sleep(TICK)
        now, seen = bench.session.revision, await asyncio.to_thread(bench.stamps)
        if files != seen == before:  # nobody writes to it any more
            files = seen
            yield f"data: {json.dumps({'type': 'files', 'revision': now, 'client': ''})}\n\n"
        before = seen
        if now == last:
            yield ": still here\n\n"
            continue
        last = now
        event = {"type": "session", "revision": now, "client": bench.client}
        yield f"data: {json.dumps(event)}\n\n"


# ---------------------------------------------------------------------------------------- records
def records(bench: Bench) -> APIRouter:
    """Opening, changing, dropping."""
    router = APIRouter()

    @router.post("/records")
    def opened(body: Opening) -> dict[str, Any]:
        return {"records": [bench.open_file(body.path, body.dt)], "failed": []}

    @router.post("/records/upload")
    def uploaded(
        files: Annotated[list[UploadFile], File()],
        dt: Annotated[float | None, Form(gt=0.0, allow_inf_nan=False)] = None,
    ) -> dict[str, Any]:
        done, failed = [], []
        for one in files:
            name = one.filename or "upload"
            try:
                done.append(bench.open_upload(name, one.file.read(), dt))
            except TridentifyError as error:
                failed.append({"name": name, **refusal(error)})
        return {"records": done, "failed": failed}

    @router.patch("/records/{name}")
    def changed(name: str, body: RecordChanges) -> dict[str, Any]:
        return bench.change_record(name, body.model_dump(exclude_none=True))

    @router.delete("/records/{name}")
    def dropped(name: str) -> dict[str, Any]:
        bench.drop_record(name)
        return {"revision": bench.session.revision}

    return router


def views(bench: Bench) -> APIRouter:
    """Looking at a record: its samples, and what they tell by themselves."""
    router = APIRouter()

    @router.get("/records/{name}/series")
    def series(
        name: str, channels: str = "", start: float = 0.0, end: float | None = None,
        pixels: int = 1000,
    ) -> Any:  # fmt: skip
        record = bench.record(name)
        asked = _names(channels, [one["name"] for one in record["channels"]])
        arguments = {
            "channels": asked,
            "start": start,
            "end": record["duration"] if end is None else end,
            "pixels": min(max(pixels, 1), MOST_PIXELS),
            "t0": record["t0"],
        }
        return bench.read("series", name, **arguments)

    @router.get("/records/{name}/stretches")
    def stretches(
        name: str, channel: str, low: float | None = None, high: float | None = None
    ) -> Any:
        record = bench.record(name)
        known(record, [channel])
        return bench.read("stretches", name, channel=channel, low=low, high=high, t0=record["t0"])

    @router.get("/records/{name}/manoeuvres")
    def manoeuvres(name: str) -> Any:
        return bench.read("manoeuvres", name, card=bench.record(name))

    @router.get("/records/{name}/advice")
    def advice(name: str) -> Any:
        return bench.read("advice", name, card=bench.record(name))

    return router


def _names(text: str, known: list[str]) -> list[str]:
    """Channels of a list with commas, some of which may belong to a name."""
    found: list[str] = []
    parts = text.split(",") if text else []
    while parts:
        for length in range(len(parts), 0, -1):
            name = ",".join(parts[:length])
            if name in known or length == 1:
                found.append(name)
                parts = parts[length:]
                break
    return found


# ----------------------------------------------------------------------------------------- models
def models(bench: Bench) -> APIRouter:
    """Estimating, looking, comparing, taking away."""
    router = APIRouter()

    @router.post("/models", status_code=202)
    def wanted(body: ModelWanted) -> dict[str, Any]:
        options = {key: value for key, value in body.options.items() if value is not None}
        changes = body.changes
        if changes is not None:
            bench.change_record(body.record, changes.model_dump(exclude_none=True))
        job = bench.add_model(body.record, options, body.name, body.alone)
        card = bench.card(bench.record(body.record))
        return {"job": job.id, "model": job.model, "record": card}

    router.get("/models/{name}")(bench.describe)

    @router.get("/models/{name}/panel/{kind}")
    def panel(
        name: str, kind: str, record: str | None = None, pixels: int = 1000
    ) -> dict[str, Any]:
        if kind not in PANELS:
            raise MissingError(
                f"found no picture {kind!r}; expected one of {', '.join(PANELS)}; choose one"
            )
        return bench.panel(name, kind, record or None, min(max(pixels, 50), MOST_PIXELS))

    @router.post("/compare")
    def compared(body: Comparing) -> dict[str, Any]:
        return bench.compare(body.models, body.record)

    @router.patch("/models/{name}")
    def changed(name: str, body: ModelChanges) -> dict[str, Any]:
        return bench.change_model(name, body.model_dump(exclude_none=True))

    @router.delete("/models/{name}")
    def dropped(name: str) -> dict[str, Any]:
        bench.drop_model(name)
        return {"revision": bench.session.revision}

    @router.get("/models/{name}/export/{kind}")
    def export(name: str, kind: str) -> Response:
        file, media, content = bench.export(name, kind)
        told = {"Content-Disposition": f'attachment; filename="{file}"'}
        return Response(content, media_type=media, headers=told)

    return router
