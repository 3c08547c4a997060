"""Fleets: the same question to thousands of records, a row for each of them."""

from tridentify.fleet.frame import arrow_schema, ddl, fit_frame
from tridentify.fleet.rows import COLUMNS
from tridentify.fleet.run import Run
from tridentify.fleet.start import fit

__all__ = ["COLUMNS", "Run", "arrow_schema", "ddl", "fit", "fit_frame"]
