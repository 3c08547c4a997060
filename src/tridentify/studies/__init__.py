"""Monte Carlo studies: what the estimators do over many noise draws, next to what is possible.

`STUDIES` are programs of their own; `run_study` runs what a file declares.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tridentify.studies.aircraft import AircraftStudy
from tridentify.studies.base import Study, StudyResult
from tridentify.studies.declared.nouns import (
    DeclaredGrid,
    DeclaredInput,
    DeclaredMethod,
    DeclaredNoise,
    DeclaredStudy,
    DeclaredSystem,
)
from tridentify.studies.declared.reading import SHIPPED, read_study, shipped_study, study_from
from tridentify.studies.declared.result import CoefficientStatistics, DeclaredResult
from tridentify.studies.declared.run import run_study

__all__ = [
    "SHIPPED",
    "STUDIES",
    "CoefficientStatistics",
    "DeclaredGrid",
    "DeclaredInput",
    "DeclaredMethod",
    "DeclaredNoise",
    "DeclaredResult",
    "DeclaredStudy",
    "DeclaredSystem",
    "Study",
    "StudyResult",
    "read_study",
    "run_study",
    "shipped_study",
    "study_from",
]

STUDIES: Mapping[str, Study] = MappingProxyType({"aircraft": AircraftStudy()})
"""Name -> study with its default options; the command line reads it."""
