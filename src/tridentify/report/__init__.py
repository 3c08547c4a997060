"""Self-contained pages about estimates, selections and validations, and the figures as files."""

from __future__ import annotations

from tridentify.report.figures import save_figures
from tridentify.report.fleet_page import write_fleet_report
from tridentify.report.html import write_report
from tridentify.report.physical_page import write_physical_report
from tridentify.report.selection_page import write_selection_report
from tridentify.report.validation_page import write_validation_report

__all__ = [
    "save_figures",
    "write_fleet_report",
    "write_physical_report",
    "write_report",
    "write_selection_report",
    "write_validation_report",
]
