"""Pictures of records and models, one a file.

Every function draws on the ``axes`` that it is given, or makes a figure that pyplot knows of: a
notebook shows it, ``plt.show()`` too, and ``plt.savefig`` saves it. What comes back are `Panels`,
the list of its axes, with ``.figure`` and ``.savefig``. Wherever it makes sense several models are
taken, as a list or a mapping of names to them.
"""

from __future__ import annotations

from tridentify.plots.bode import plot_bode
from tridentify.plots.comparison import plot_comparison
from tridentify.plots.convergence import plot_convergence
from tridentify.plots.cost_surface import plot_cost_surface
from tridentify.plots.fit import plot_compared, plot_fit, plot_record, plot_residual
from tridentify.plots.fleet import plot_fleet
from tridentify.plots.measured import plot_frequency_response
from tridentify.plots.nyquist import plot_nyquist
from tridentify.plots.over_time import plot_impulse, plot_step
from tridentify.plots.pole_zero import plot_pole_zero
from tridentify.plots.residual_tests import plot_residual_tests
from tridentify.plots.selection import plot_hankel, plot_selection
from tridentify.plots.spectrum import plot_excitation, plot_spectrum
from tridentify.plots.study import plot_study_cells
from tridentify.plots.style import Panels
from tridentify.plots.trajectory import plot_trajectory

__all__ = [
    "Panels",
    "plot_bode",
    "plot_compared",
    "plot_comparison",
    "plot_convergence",
    "plot_excitation",
    "plot_cost_surface",
    "plot_fit",
    "plot_fleet",
    "plot_impulse",
    "plot_nyquist",
    "plot_pole_zero",
    "plot_record",
    "plot_residual",
    "plot_spectrum",
    "plot_step",
    "plot_study_cells",
    "plot_residual_tests",
    "plot_frequency_response",
    "plot_hankel",
    "plot_selection",
    "plot_trajectory",
]
