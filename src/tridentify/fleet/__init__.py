"""Fleets: the same question to thousands of records, a row for each of them."""

from tridentify.fleet.frame import arrow_schema, ddl, fit_frame
from tridentify.fleet.pool import Pool
from tridentify.fleet.rows import COLUMNS
from tridentify.fleet.run import Run
from tridentify.fleet.start import fit
from tridentify.fleet.together import Together

__all__ = ["COLUMNS", "Pool", "Run", "Together", "arrow_schema", "ddl", "fit", "fit_frame"]
