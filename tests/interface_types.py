"""What the interface of the workbench answers: `docs/app_interface.md` in types.

Times are seconds from the start of the record, and a number that is none is null. Tests hold every
answer against its type, field by field.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, TypedDict

Numbers = list[float | None]
State = Literal["queued", "running", "done", "failed", "cancelled"]


class Problem(TypedDict):
    """Why something was refused."""

    code: str
    message: str
    remedy: str


class Refusal(TypedDict):
    """The body of every answer from status 400 on."""

    error: Problem


class Channel(TypedDict):
    """What is known of a column; ``guess`` is a role by name and movement."""

    name: str
    unit: str
    minimum: float | None
    maximum: float | None
    mean: float | None
    std: float | None
    missing: int
    guess: str


class Stretch(TypedDict):
    """From one time to another."""

    start: float
    end: float


class Range(Stretch):
    """A stretch with what it is for."""

    use: Literal["identify", "validate"]


class Record(TypedDict):
    """A record as the page shows it."""

    id: str
    name: str
    path: str | None
    given_dt: float | None
    n_samples: int
    t0: float
    duration: float
    dt: float | None
    uniform: bool
    channels: list[Channel]
    inputs: list[str]
    outputs: list[str]
    references: list[str]
    intersample: str
    ranges: list[Range]
    bad: list[Stretch]
    missing_file: bool
    changed_file: str
    content: str
    python: str
    command_line: str
    revision: int


class Model(TypedDict):
    """A model in the tray."""

    id: str
    name: str
    record: str
    options: dict[str, str | int | float | bool]
    structure: str
    fit: Numbers
    state: State
    colour_index: int
    shown: bool


class ListedModel(Model):
    """The same in a session, with whether its record's file was changed since."""

    older_file: bool


class Session(TypedDict):
    """All that the page shows before it asks for more."""

    version: str
    revision: int
    folder: str | None
    records: list[Record]
    models: list[ListedModel]
    can_undo: bool
    can_redo: bool


class Revision(TypedDict):
    """Of the session, after something was taken away."""

    revision: int


class File(TypedDict):
    """A file of the folder."""

    name: str
    bytes: int
    readable: bool


class Option(TypedDict):
    """Something that can be asked of an estimate."""

    name: str
    label: str
    type: Literal["choice", "text"]
    default: str
    help: str
    group: str
    switch: str
    choices: list[str]


class Failed(Problem):
    """A file that is no record."""

    name: str


class Opened(TypedDict):
    """Records that were opened, and files that could not be."""

    records: list[Record]
    failed: list[Failed]


class Columns(TypedDict):
    """Least and largest value in each column of pixels."""

    minimum: Numbers
    maximum: Numbers


class Series(TypedDict):
    """Channels over a stretch of time; samples themselves where ``thinned`` is false."""

    time: Numbers
    channels: dict[str, Columns]
    thinned: bool


class Manoeuvre(Stretch):
    """A piece worth identifying."""

    score: float | None
    why: str


class Finding(TypedDict):
    """A doubt; ``advice`` is the remedy in words of the page, ``times`` are of the file's clock.

    ``kind`` is which case of its code it is, mostly empty.
    """

    code: str
    severity: Literal["error", "warning", "note"]
    message: str
    remedy: str
    advice: str
    outputs: list[str]
    experiment: int | None
    times: Numbers
    effect: str | None
    kind: str


class Measured(TypedDict):
    """A measured response [rad/s, dB, degrees]."""

    frequency: Numbers
    magnitude_db: Numbers
    phase_deg: Numbers
    coherence: Numbers


class MeasuredPair(Measured):
    """The same of one output and one input."""

    output: str
    input: str


class Advice(TypedDict):
    """What a record tells before anything is estimated."""

    summary: str
    facts: list[list[str]]
    notes: list[str]
    findings: list[Finding]
    response: list[MeasuredPair]


class Value(TypedDict):
    """A coefficient or what follows from it, with its interval of 95 %."""

    name: str
    value: float | None
    std: float | None
    low: float | None
    high: float | None
    unit: str
    status: str


class Lines(TypedDict):
    """The same in Python and on the command line."""

    python: str
    command_line: str


class Detail(Model, Lines):
    """All of a model but its pictures.

    ``older_file`` is a sentence or empty, and ``pictures`` is false where the file has no such
    channels any more.
    """

    sentence: str
    numbers: list[Value]
    findings: list[Finding]
    parameters: list[Value]
    derived: list[Value]
    physical: list[Value] | None
    physical_notes: list[str]
    outputs: list[str]
    validation_fit: Numbers | None
    validation_findings: list[Finding] | None
    validation_note: str
    older_file: str
    pictures: bool
    export: Lines


class Started(TypedDict):
    """An estimate that was begun."""

    job: str
    model: str
    record: Record


class Progress(TypedDict):
    """How far an estimate is."""

    id: str
    model: str
    state: State
    message: str
    fraction: float
    error: Problem | None


class Job(Progress, total=False):
    """The same, and the session and the model of one that is done."""

    session: Session
    detail: Detail


class Nothing(TypedDict):
    """An empty answer."""


class Comparison(Lines):
    """Fits [percent] of several models (rows) on one record; a column for each output."""

    outputs: list[str]
    fits: list[Numbers]
    summary: str


class FitOfOutput(TypedDict):
    """Measured against model."""

    name: str
    unit: str
    time: Numbers
    measured: Numbers
    model: Numbers
    low: Numbers | None
    high: Numbers | None


class Fit(TypedDict):
    """The picture ``fit``."""

    outputs: list[FitOfOutput]


class Test(TypedDict):
    """A test of the residual."""

    name: str
    passed: bool
    text: str


class ResidualOfOutput(TypedDict):
    """What the model leaves, its correlations, and the tests of it."""

    name: str
    time: Numbers
    residual: Numbers
    lags: Numbers
    autocorrelation: Numbers
    correlation_limit: float | None
    crosscorrelation: dict[str, Numbers]
    stretch: str
    tests: list[Test]


class Residual(TypedDict):
    """The picture ``residual``."""

    outputs: list[ResidualOfOutput]


class BodeOfPair(TypedDict):
    """A frequency response with its band [rad/s, dB, degrees]."""

    output: str
    input: str
    frequency: Numbers
    magnitude_db: Numbers
    magnitude_low: Numbers
    magnitude_high: Numbers
    phase_deg: Numbers
    phase_low: Numbers
    phase_high: Numbers
    measured: Measured | None


class Bode(TypedDict):
    """The picture ``bode``."""

    pairs: list[BodeOfPair]


class StepOfPair(TypedDict):
    """A response to a unit step with its band."""

    output: str
    input: str
    time: Numbers
    value: Numbers
    low: Numbers
    high: Numbers


class Step(TypedDict):
    """The picture ``step``."""

    pairs: list[StepOfPair]


class Root(TypedDict):
    """A pole or a zero [rad/s]."""

    re: float | None
    im: float | None
    frequency: float | None
    damping: float | None


class ZerosOfPair(TypedDict):
    """Zeros from one input to one output."""

    output: str
    input: str
    zeros: list[Root]


class Poles(TypedDict):
    """The picture ``poles``."""

    poles: list[Root]
    zeros: list[Root]
    pairs: list[ZerosOfPair]


Picture = Fit | Residual | Bode | Step | Poles

ANSWERS: Mapping[str, Any] = MappingProxyType(
    {
        "GET /api/session": Session,
        "GET /api/files": list[File],
        "GET /api/options": list[Option],
        "POST /api/undo": Session,
        "POST /api/redo": Session,
        "GET /api/jobs/{name}": Job,
        "DELETE /api/jobs/{name}": Nothing,
        "POST /api/records": Opened,
        "POST /api/records/upload": Opened,
        "PATCH /api/records/{name}": Record,
        "DELETE /api/records/{name}": Revision,
        "GET /api/records/{name}/series": Series,
        "GET /api/records/{name}/stretches": list[Stretch],
        "GET /api/records/{name}/manoeuvres": list[Manoeuvre],
        "GET /api/records/{name}/advice": Advice,
        "POST /api/models": Started,
        "GET /api/models/{name}": Detail,
        "GET /api/models/{name}/panel/{kind}": Picture,
        "POST /api/compare": Comparison,
        "PATCH /api/models/{name}": Model,
        "DELETE /api/models/{name}": Revision,
    }
)
"""What each request is answered with; the events and the exported files are no documents."""
