"""The report of an estimation: one self-contained page, and the figures as files."""

from __future__ import annotations

from tridentify.report.figures import save_figures
from tridentify.report.html import write_report

__all__ = ["save_figures", "write_report"]
