"""The ready-made maps by name, as a form or the command line asks for them.

*First order with dead time*: ``T y'(t) + y(t) = K u(t - D)``, what a step response of a heater, a
tank or a flow is mostly described by: ``a0 = 1/T``, ``b0 = K/T``, and ``D`` as it is. The map goes
both ways, so that nothing is restricted: parameters and coefficients say the same (Seborg, Edgar &
Mellichamp, *Process Dynamics and Control*, Wiley 2004, chapter 7).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

from tridentify.physical.electrical import dc_motor, rc_circuit, rcrc_circuit
from tridentify.physical.mechanical import dutch_roll, mass_spring_damper, short_period
from tridentify.physical.model import PhysicalModel, PhysicalParameter, Values
from tridentify.structure import Structure


def first_order_dead_time() -> PhysicalModel:
    """First-order lag with dead time, from ``input`` to ``output``.

    Returns
    -------
    PhysicalModel
        Parameters K (gain, units of the output for one of the input), T [s] (time constant) and
        D [s] (dead time).

    Examples
    --------
    >>> model = first_order_dead_time()
    >>> dict(zip(model.coefficient_names, model.theta({"K": 3.0, "T": 20.0, "D": 4.0}).tolist()))
    {'a0': 0.05, 'b0': 0.15, 'delay': 4.0}
    """

    def coefficients(p: Values) -> Values:
        return {"a0": 1.0 / p["T"], "b0": p["K"] / p["T"], "delay": p["D"]}

    def start(c: Values) -> Values:
        return {"T": 1.0 / abs(c["a0"]), "K": c["b0"] / c["a0"], "D": c["delay"]}

    return PhysicalModel(
        "first order with dead time",
        [
            PhysicalParameter("K", "", "gain, output over input", guess=1.0),
            PhysicalParameter("T", "s", "time constant", guess=10.0, positive=True),
            PhysicalParameter("D", "s", "dead time", guess=1.0),
        ],
        Structure(1, 0, delay="free"),
        coefficients,
        input_names=("input",),
        output_names=("output",),
        start=start,
    )


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
