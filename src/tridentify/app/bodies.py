"""What the routes of the workbench take, checked before anything is done with it."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

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
