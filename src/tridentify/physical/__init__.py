"""Physical parameters behind the coefficients: declared maps, estimates, and what is determined."""

from __future__ import annotations

from tridentify.physical.electrical import dc_motor, rc_circuit, rcrc_circuit
from tridentify.physical.fit import estimate_physical
from tridentify.physical.identifiability import Identifiability, identifiability
from tridentify.physical.mechanical import dutch_roll, mass_spring_damper, short_period
from tridentify.physical.model import PhysicalModel, PhysicalParameter
from tridentify.physical.ready import MODELS, first_order_dead_time
from tridentify.physical.result import PhysicalEstimate

__all__ = [
    "MODELS",
    "Identifiability",
    "PhysicalEstimate",
    "PhysicalModel",
    "PhysicalParameter",
    "dc_motor",
    "dutch_roll",
    "estimate_physical",
    "first_order_dead_time",
    "identifiability",
    "mass_spring_damper",
    "rc_circuit",
    "rcrc_circuit",
    "short_period",
]
