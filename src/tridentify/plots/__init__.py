"""Pictures of records and estimates, one a file.

Every function takes the axes to draw on (or makes a figure of its own), returns the axes, and never
shows anything. Figures are made without pyplot, so that they need no display and leave no state.
"""

from __future__ import annotations

from tridentify.plots.bode import plot_bode
from tridentify.plots.convergence import plot_convergence
from tridentify.plots.fit import plot_fit
from tridentify.plots.hankel import plot_hankel
from tridentify.plots.pole_zero import plot_pole_zero
from tridentify.plots.record import plot_record
from tridentify.plots.residual import plot_residual
from tridentify.plots.selection import plot_selection
from tridentify.plots.trajectory import plot_trajectory

__all__ = [
    "plot_bode",
    "plot_convergence",
    "plot_fit",
    "plot_hankel",
    "plot_pole_zero",
    "plot_record",
    "plot_residual",
    "plot_selection",
    "plot_trajectory",
]
