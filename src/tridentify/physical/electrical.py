"""Circuits and motors as physical models.

*RC*: ``R C y' + y = u``.

*RCRC*: two such stages in a row. With the voltage after the first one ``v``: ``C_1 v' = (u - v) /
R_1 - (v - y) / R_2`` and ``C_2 y' = (v - y) / R_2``, so ``R_1 C_1 R_2 C_2 y'' + (R_1 C_1 + R_1 C_2
+ R_2 C_2) y' + y = u``. With a buffer between the stages the current into the second does not load
the first, and the term ``R_1 C_2`` is not there.

*DC motor*: ``L i' = u - R i - K w`` and ``J w' = K i - B w`` with one constant ``K`` for torque
and back electromotive force (equal in SI units). With ``D = J L s^2 + (J R + B L) s + B R + K^2``
speed is ``w / u = K / D``, current is ``i / u = (J s + B) / D``, and the angle of the shaft is the
integral of its speed, ``K / (s D)``: a pole at the origin that is known.
"""

from __future__ import annotations

import math
from typing import Literal

from tridentify.errors import OptionError
from tridentify.physical.model import PhysicalModel, PhysicalParameter, Values
from tridentify.structure import Structure

MotorOutputs = Literal["speed", "angle", "current", "both"]


def rc_circuit() -> PhysicalModel:
    """RC low pass, from the voltage in to the voltage across the capacitor.

    Returns
    -------
    PhysicalModel
        Parameters R [ohm] and C [F], of which the record determines the product.

    Examples
    --------
    >>> rc_circuit().theta({"R": 1e4, "C": 1e-7}).round(6).tolist()
    [1000.0, 1000.0]
    """

    def coefficients(p: Values) -> Values:
        rate = 1.0 / (p["R"] * p["C"])
        return {"a0": rate, "b0": rate}

    return PhysicalModel(
        "RC circuit",
        [_resistance("R"), _capacitance("C")],
        Structure(1, 0),
        coefficients,
        start=lambda c: {"R": math.sqrt(1e10 / abs(c["a0"])), "C": math.sqrt(1e-10 / abs(c["a0"]))},
    )


def rcrc_circuit(*, buffered: bool = False) -> PhysicalModel:
    """Two RC low passes in a row, from the voltage in to the voltage across the second capacitor.

    Parameters
    ----------
    buffered : bool
        Whether an amplifier between the stages keeps the second from loading the first.

    Returns
    -------
    PhysicalModel
        Parameters R1, R2 [ohm] and C1, C2 [F]. The record determines two functions of them, those
        of ``combinations``. In the buffered circuit the stages can be exchanged.

    Examples
    --------
    >>> nominal = {"R1": 1e4, "C1": 1e-7, "R2": 1e4, "C2": 2e-7}
    >>> rcrc_circuit().theta(nominal).round(3).tolist()
    [2500.0, 500000.0, 500000.0]
    """

    def product(p: Values) -> float:
        return p["R1"] * p["C1"] * p["R2"] * p["C2"]

    def total(p: Values) -> float:
        load = 0.0 if buffered else p["R1"] * p["C2"]
        return p["R1"] * p["C1"] + load + p["R2"] * p["C2"]

    def coefficients(p: Values) -> Values:
        square = product(p)
        return {"a1": total(p) / square, "a0": 1.0 / square, "b0": 1.0 / square}

    def start(c: Values) -> Values:
        slow = 1.0 / math.sqrt(abs(c["a0"]))
        return {"R1": 1e4, "R2": 1e4, "C1": slow / 2e4, "C2": slow / 5e3}

    name = "R1*C1 + R2*C2" if buffered else "R1*C1 + R1*C2 + R2*C2"
    return PhysicalModel(
        "buffered RCRC circuit" if buffered else "RCRC circuit",
        [_resistance("R1"), _capacitance("C1"), _resistance("R2"), _capacitance("C2")],
        Structure(2, 0),
        coefficients,
        start=start,
        combinations={"R1*C1*R2*C2": product, name: total},
    )


def dc_motor(outputs: MotorOutputs = "speed") -> PhysicalModel:
    """Armature-controlled DC motor with viscous friction, from voltage to its motion or current.

    Parameters
    ----------
    outputs : {"speed", "angle", "current", "both"}
        What is measured: speed [rad/s], angle [rad], current [A], or speed and current in that
        order.

    Returns
    -------
    PhysicalModel
        Parameters R [ohm], L [H], K [V s/rad or N m/A], J [kg m^2] and B [N m s/rad]. Speed and
        current together determine all of them, one of the outputs alone does not.

    Raises
    ------
    OptionError
        For other outputs.

    Examples
    --------
    >>> motor = dc_motor()
    >>> motor.theta({"R": 1.0, "L": 0.5, "K": 0.01, "J": 0.01, "B": 0.1}).round(4).tolist()
    [12.0, 20.02, 2.0]
    """
    if outputs not in ("speed", "angle", "current", "both"):
        raise OptionError.found(
            "outputs=", outputs, "'speed', 'angle', 'current' or 'both'", "choose one"
        )
    names = ("speed", "current") if outputs == "both" else (outputs,)
    where = {name: f"[{name},voltage]" if outputs == "both" else "" for name in names}

    def coefficients(p: Values) -> Values:
        r, inductance, k, j, b = (p[name] for name in ("R", "L", "K", "J", "B"))
        lead = j * inductance
        total, product = r / inductance + b / j, (b * r + k * k) / lead
        if outputs == "angle":
            return {"a2": total, "a1": product, "a0": 0.0, "b0": k / lead}
        found = {"a1": total, "a0": product}
        if "speed" in names:
            found["b0" + where["speed"]] = k / lead
        if "current" in names:
            found["b1" + where["current"]] = 1.0 / inductance
            found["b0" + where["current"]] = b / lead
        return found

    def start(c: Values) -> Values:
        if "current" not in names:
            return {}
        # the faster pole is electrical, the slower one mechanical, as in most motors
        root = math.sqrt(max(c["a1"] ** 2 - 4.0 * c["a0"], 0.01 * c["a1"] ** 2))
        fast, slow = (abs(c["a1"]) + root) / 2.0, max(abs(c["a1"]) - root, 1e-3 * root) / 2.0
        inductance = 1.0 / abs(c["b1" + where["current"]])
        return {"L": inductance, "R": fast * inductance, "B": 0.5 * slow * 1e-4, "J": 1e-4}

    zeros = {"speed": 0, "current": 1}
    plain = outputs != "angle"
    structure = (
        Structure(2, [[zeros[name]] for name in names])
        if plain
        else Structure(3, 0, fixed={"a0": 0.0})
    )
    return PhysicalModel(
        f"DC motor, {' and '.join(names)} measured",
        [
            _resistance("R", 1.0),
            PhysicalParameter("L", "H", "inductance", guess=1e-3, positive=True),
            PhysicalParameter("K", "V s/rad", "motor constant", guess=0.05, positive=True),
            PhysicalParameter("J", "kg m^2", "inertia", guess=1e-4, positive=True),
            PhysicalParameter("B", "N m s/rad", "viscous friction", guess=1e-4, positive=True),
        ],
        structure,
        coefficients,
        input_names=("voltage",),
        output_names=names,
        start=start,
        combinations={
            "R/L + B/J": lambda p: p["R"] / p["L"] + p["B"] / p["J"],
            "(B*R + K^2)/(J*L)": lambda p: (p["B"] * p["R"] + p["K"] ** 2) / (p["J"] * p["L"]),
        },
    )


def _resistance(name: str, guess: float = 1e4) -> PhysicalParameter:
    return PhysicalParameter(name, "ohm", "resistance", guess=guess, positive=True)


def _capacitance(name: str) -> PhysicalParameter:
    return PhysicalParameter(name, "F", "capacitance", guess=1e-7, positive=True)
