"""The ready-made maps by name, as a form or the command line asks for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

from tridentify.physical.electrical import dc_motor, rc_circuit, rcrc_circuit
from tridentify.physical.mechanical import dutch_roll, mass_spring_damper, short_period
from tridentify.physical.model import PhysicalModel
from tridentify.physical.process import first_order_dead_time

MODELS: Mapping[str, Callable[[], PhysicalModel]] = MappingProxyType(
    {
        "short-period": short_period,
        "short-period-free-z-q": partial(short_period, pitch_rate_effect=None),
        "dutch-roll": dutch_roll,
        "dutch-roll-aileron": partial(dutch_roll, control="aileron"),
        "mass-spring-damper": mass_spring_damper,
        "first-order-dead-time": first_order_dead_time,
        "rc-circuit": rc_circuit,
        "rcrc-circuit": rcrc_circuit,
        "rcrc-circuit-buffered": partial(rcrc_circuit, buffered=True),
        "dc-motor": dc_motor,
        "dc-motor-current": partial(dc_motor, "current"),
        "dc-motor-speed-current": partial(dc_motor, "both"),
    }
)
"""Name -> maker of a ready-made model."""
