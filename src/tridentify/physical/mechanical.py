"""Aircraft and oscillators as physical models.

*Short period*: ``alpha' = Z_alpha alpha + Z_q q + Z_delta delta``, ``q' = M_alpha alpha + M_q q +
M_delta delta`` with ``Z_q = 1`` (speed and attitude held; Etkin & Reid 1996, chapter 6). With the
state equation ``x' = A x + B u`` both outputs share the denominator ``s^2 - tr(A) s + det(A)`` and
the numerators are those of ``adj(s I - A) B``:

    a1 = -(Z_alpha + M_q),                    a0 = Z_alpha M_q - Z_q M_alpha,
    alpha: b1 = Z_delta,                      b0 = Z_q M_delta - M_q Z_delta,
    q:     b1 = M_delta,                      b0 = M_alpha Z_delta - Z_alpha M_delta.

Five derivatives and six coefficients: one restriction, which can be tested. Angles may be in
degrees or radians, as long as it is the same unit for all three channels.

*Mass, spring and damper*: ``m y'' + c y' + k y = u`` from force to position.
"""

from __future__ import annotations

from tridentify.physical.model import PhysicalModel, PhysicalParameter, Values
from tridentify.structure import Structure


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
    free = pitch_rate_effect is None

    def coefficients(p: Values) -> Values:
        z_alpha, z_delta, m_alpha, m_q, m_delta = (
            p[name] for name in ("Z_alpha", "Z_delta", "M_alpha", "M_q", "M_delta")
        )
        z_q = p["Z_q"] if pitch_rate_effect is None else pitch_rate_effect
        return {
            "a1": -(z_alpha + m_q),
            "a0": z_alpha * m_q - z_q * m_alpha,
            "b1[alpha,elevator]": z_delta,
            "b0[alpha,elevator]": z_q * m_delta - m_q * z_delta,
            "b1[q,elevator]": m_delta,
            "b0[q,elevator]": m_alpha * z_delta - z_alpha * m_delta,
        }

    def start(c: Values) -> Values:
        z_delta, m_delta = c["b1[alpha,elevator]"], c["b1[q,elevator]"]
        z_alpha = -c["b0[q,elevator]"] / m_delta if m_delta else -0.5 * c["a1"]
        m_q = -c["a1"] - z_alpha
        m_alpha = z_alpha * m_q - c["a0"]
        found = {"Z_alpha": z_alpha, "Z_delta": z_delta, "M_alpha": m_alpha, "M_q": m_q}
        return found | {"M_delta": m_delta}

    parameters = [
        PhysicalParameter("Z_alpha", "1/s", "lift due to angle of attack", guess=-1.0),
        PhysicalParameter("Z_delta", "1/s", "lift due to elevator", guess=-0.1),
        PhysicalParameter("M_alpha", "1/s^2", "static stability", guess=-5.0),
        PhysicalParameter("M_q", "1/s", "pitch damping", guess=-1.0),
        PhysicalParameter("M_delta", "1/s^2", "elevator effectiveness", guess=-5.0),
    ]
    if free:
        parameters.append(PhysicalParameter("Z_q", "-", "lift due to pitch rate", guess=1.0))
    return PhysicalModel(
        "short period",
        parameters,
        Structure(2, [[1], [1]]),
        coefficients,
        input_names=("elevator",),
        output_names=("alpha", "q"),
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
