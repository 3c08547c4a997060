"""Excitation design: inputs, the precision they will give, and the best spectrum.

- Signals: `prbs`, `multisine`, `three_two_one_one`, `doublet`, `chirp`, each an `Excitation`.
- `precision`: standard errors before anything is recorded, from the Fisher information.
- `optimal_spectrum`: where the power of an input belongs for the coefficients that matter.
"""

from __future__ import annotations

from tridentify.excitation.chirp import chirp
from tridentify.excitation.multisine import multisine
from tridentify.excitation.optimal import Spectrum, optimal_spectrum
from tridentify.excitation.prbs import prbs
from tridentify.excitation.precise import precision
from tridentify.excitation.precision_result import Precision
from tridentify.excitation.pulses import doublet, three_two_one_one
from tridentify.excitation.signal import Excitation

__all__ = [
    "Excitation",
    "Precision",
    "Spectrum",
    "chirp",
    "doublet",
    "multisine",
    "optimal_spectrum",
    "precision",
    "prbs",
    "three_two_one_one",
]
