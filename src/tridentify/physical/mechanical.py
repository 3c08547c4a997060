"""Aircraft and oscillators as physical models.

*Short period*: ``alpha' = Z_alpha alpha + Z_q q + Z_delta delta``, ``q' = M_alpha alpha + M_q q +
M_delta delta`` with ``Z_q = 1`` (speed and attitude held; Etkin & Reid 1996, chapter 6).

*Dutch roll*: with roll left out, the side force and yawing moment equations of small motion about
straight level flight, ``beta' = Y_beta beta + (Y_r - 1) r + Y_delta delta``, ``r' = N_beta beta +
N_r r + N_delta delta``, with ``Y_r = 0`` (McRuer, Ashkenas & Graham 1973, chapter 6: the
two-degree-of-freedom approximation). What it leaves out are the roll rate in the side force
equation, ``sin(alpha_0) p``, gravity, ``g/V phi``, and the yaw due to roll ``N_p p``. So it holds
where the aircraft hardly rolls, as after a rudder doublet at a small angle of attack with little
dihedral; the test of the restriction tells where it does not.

Both are ``x' = A x + B u`` with two states that are measured. With ``A = [[f_1, f_2], [m_1, m_2]]``
and ``B = [f, m]`` both outputs share the denominator ``s^2 - tr(A) s + det(A)``, and the numerators
are those of ``adj(s I - A) B``:

    a1 = -(f_1 + m_2),       a0 = f_1 m_2 - f_2 m_1,
    first:  b1 = f,          b0 = f_2 m - m_2 f,
    second: b1 = m,          b0 = m_1 f - f_1 m.

With ``f_2`` known that is five derivatives and six coefficients: one restriction, which can be
tested. Angles may be in degrees or radians, as long as it is the same unit for all three channels.

*Mass, spring and damper*: ``m y'' + c y' + k y = u`` from force to position.
"""

from __future__ import annotations

from typing import Literal

from tridentify.errors import OptionError
from tridentify.physical.model import PhysicalModel, PhysicalParameter, Values
from tridentify.structure import Structure

Control = Literal["rudder", "aileron"]


def short_period(*, pitch_rate_effect: float | None = 1.0) -> PhysicalModel:
    """Short period of an aircraft, from elevator to angle of attack and pitch rate.

    Parameters
    ----------
    pitch_rate_effect : float or None
        ``Z_q``, one where the lift due to pitch rate is negligible; None to estimate it, which
        leaves no restriction to test.

    Returns
    -------
    PhysicalModel
        Channels ``elevator``; ``alpha``, ``q``. Parameters Z_alpha, Z_delta [1/s], M_alpha, M_delta
        [1/s^2], M_q [1/s].

    Examples
    --------
    >>> derivatives = {"Z_alpha": -1.0, "Z_delta": -0.1, "M_alpha": -8.0, "M_q": -0.9,
    ...                "M_delta": -9.0}
    >>> model = short_period()
    >>> dict(zip(model.coefficient_names, model.theta(derivatives).round(3).tolist()))
    {'a1': 1.9, 'a0': 8.9, 'b1[alpha,elevator]': -0.1, 'b0[alpha,elevator]': -9.09,
     'b1[q,elevator]': -9.0, 'b0[q,elevator]': -8.2}
    """
    parameters = [
        PhysicalParameter("Z_alpha", "1/s", "lift due to angle of attack", guess=-1.0),
        PhysicalParameter("Z_delta", "1/s", "lift due to elevator", guess=-0.1),
        PhysicalParameter("M_alpha", "1/s^2", "static stability", guess=-5.0),
        PhysicalParameter("M_q", "1/s", "pitch damping", guess=-1.0),
        PhysicalParameter("M_delta", "1/s^2", "elevator effectiveness", guess=-5.0),
    ]
    rate = PhysicalParameter("Z_q", "-", "lift due to pitch rate", guess=1.0)
    return _two_states(
        "short period", parameters, rate, 0.0, pitch_rate_effect, ("elevator", "alpha", "q")
    )


def dutch_roll(
    *, control: Control = "rudder", yaw_rate_effect: float | None = 0.0
) -> PhysicalModel:
    """Lateral short period (Dutch roll) of an aircraft, to sideslip and yaw rate, roll left out.

    Parameters
    ----------
    control : {"rudder", "aileron"}
        The surface that moves; the other one is held.
    yaw_rate_effect : float or None
        ``Y_r``, zero where the side force due to yaw rate is negligible; None to estimate it, which
        leaves no restriction to test.

    Returns
    -------
    PhysicalModel
        Channels ``rudder`` or ``aileron``; ``beta``, ``r``. Parameters Y_beta, Y_delta [1/s],
        N_beta, N_delta [1/s^2], N_r [1/s].

    Raises
    ------
    OptionError
        For another surface.

    Examples
    --------
    >>> derivatives = {"Y_beta": -0.2, "Y_delta": 0.05, "N_beta": 4.0, "N_r": -0.3, "N_delta": -2.0}
    >>> model = dutch_roll()
    >>> dict(zip(model.coefficient_names, model.theta(derivatives).round(3).tolist()))
    {'a1': 0.5, 'a0': 4.06, 'b1[beta,rudder]': 0.05, 'b0[beta,rudder]': 2.015,
     'b1[r,rudder]': -2.0, 'b0[r,rudder]': -0.2}
    """
    if control not in ("rudder", "aileron"):
        raise OptionError.found("control=", control, "'rudder' or 'aileron'", "choose one")
    parameters = [
        PhysicalParameter("Y_beta", "1/s", "side force due to sideslip", guess=-0.2),
        PhysicalParameter("Y_delta", "1/s", f"side force due to {control}", guess=0.05),
        PhysicalParameter("N_beta", "1/s^2", "directional stability", guess=3.0),
        PhysicalParameter("N_r", "1/s", "yaw damping", guess=-0.3),
        PhysicalParameter("N_delta", "1/s^2", f"yaw due to {control}", guess=-1.5),
    ]
    rate = PhysicalParameter("Y_r", "-", "side force due to yaw rate", guess=0.05)
    return _two_states(
        f"Dutch roll, {control}", parameters, rate, -1.0, yaw_rate_effect, (control, "beta", "r")
    )


def _two_states(
    name: str,
    parameters: list[PhysicalParameter],
    rate: PhysicalParameter,
    carried: float,
    known_rate: float | None,
    channels: tuple[str, str, str],
) -> PhysicalModel:
    """A force and a moment equation, as the head of this module has them.

    Parameters
    ----------
    name : str
    parameters : list of PhysicalParameter
        Those of ``f_1``, ``f``, ``m_1``, ``m_2`` and ``m``, in this order.
    rate : PhysicalParameter
        That of ``f_2``, less what the axes carry along.
    carried : float
        What the rotation of the axes adds to it.
    known_rate : float or None
        Its value; None to estimate it.
    channels : (str, str, str)
        Input, first output, second output.
    """
    source, one, two = channels
    order = [parameter.name for parameter in parameters]
    first, second = f"[{one},{source}]", f"[{two},{source}]"

    def coefficients(p: Values) -> Values:
        f_1, f, m_1, m_2, m = (p[each] for each in order)
        f_2 = carried + (p[rate.name] if known_rate is None else known_rate)
        return {
            "a1": -(f_1 + m_2),
            "a0": f_1 * m_2 - f_2 * m_1,
            "b1" + first: f,
            "b0" + first: f_2 * m - m_2 * f,
            "b1" + second: m,
            "b0" + second: m_1 * f - f_1 * m,
        }

    def start(c: Values) -> Values:
        """With ``f_2`` of size one, and no moment from the force that the control makes."""
        f, m = c["b1" + first], c["b1" + second]
        f_1 = -c["b0" + second] / m if m else -0.5 * c["a1"]
        m_2 = -c["a1"] - f_1
        m_1 = (f_1 * m_2 - c["a0"]) / (carried or 1.0)
        return dict(zip(order, (f_1, f, m_1, m_2, m), strict=True))

    return PhysicalModel(
        name,
        [*parameters, *([rate] if known_rate is None else [])],
        Structure(2, [[1], [1]]),
        coefficients,
        input_names=(source,),
        output_names=(one, two),
        start=start,
    )


def mass_spring_damper() -> PhysicalModel:
    """Mass on a spring with viscous damping, from force to position.

    Returns
    -------
    PhysicalModel
        Parameters m [kg], c [N s/m] and k [N/m], all of them determined.

    Examples
    --------
    >>> mass_spring_damper().theta({"m": 2.0, "c": 1.0, "k": 8.0}).tolist()
    [0.5, 4.0, 0.5]
    """

    def coefficients(p: Values) -> Values:
        return {"a1": p["c"] / p["m"], "a0": p["k"] / p["m"], "b0": 1.0 / p["m"]}

    def start(c: Values) -> Values:
        mass = 1.0 / abs(c["b0"])
        return {"m": mass, "c": abs(c["a1"]) * mass, "k": abs(c["a0"]) * mass}

    return PhysicalModel(
        "mass, spring and damper",
        [
            PhysicalParameter("m", "kg", "mass", guess=1.0, positive=True),
            PhysicalParameter("c", "N s/m", "damping", guess=1.0, positive=True),
            PhysicalParameter("k", "N/m", "stiffness", guess=10.0, positive=True),
        ],
        Structure(2, 0),
        coefficients,
        input_names=("force",),
        output_names=("position",),
        start=start,
    )
