"""Monte Carlo studies: what the estimators do over many noise draws, next to what is possible."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tridentify.studies.aircraft import AircraftStudy
from tridentify.studies.base import Study, StudyResult

__all__ = ["STUDIES", "Study", "StudyResult"]

STUDIES: Mapping[str, Study] = MappingProxyType({"aircraft": AircraftStudy()})
"""Name -> study with its default options; the command line reads it."""
