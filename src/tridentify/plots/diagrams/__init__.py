"""Diagrams of what an estimation did, with its numbers written in, as SVG text.

Each function gives a `Diagram`, a string that notebooks show as a picture and that needs neither a
plotting library nor anything from outside. Text is as wide as its box allows, in any font.
"""

from __future__ import annotations

from tridentify.plots.diagrams.closed_loop import draw_closed_loop
from tridentify.plots.diagrams.drawing import Diagram, write_diagram
from tridentify.plots.diagrams.flow_chart import draw_flow_chart
from tridentify.plots.diagrams.three_models import (
    draw_parallel,
    draw_series,
    draw_series_parallel,
    draw_three_models,
)

__all__ = [
    "Diagram",
    "draw_closed_loop",
    "draw_flow_chart",
    "draw_parallel",
    "draw_series",
    "draw_series_parallel",
    "draw_three_models",
    "write_diagram",
]
