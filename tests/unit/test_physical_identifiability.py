"""What can be determined is said exactly, and does not depend on units or on the point."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tridentify import Structure
from tridentify.errors import CoefficientMapError
from tridentify.physical import (
    PhysicalModel,
    PhysicalParameter,
    dc_motor,
    identifiability,
    mass_spring_damper,
    rc_circuit,
    rcrc_circuit,
    short_period,
)

LADDER = "R1*C1 + R1*C2 + R2*C2"
SUMS = "R/L + B/J, (B*R + K^2)/(J*L)"
# Worked out by hand from the transfer functions, see the modules' docstrings.
NOTES = {
    "rc": (
        rc_circuit(),
        (),
        (
            "only 1 of the 2 unknown parameters R, C can be determined",
            "determined: R*C",
            "no effect: R times k with C divided by k",
        ),
    ),
    "ladder": (
        rcrc_circuit(),
        (),
        (
            "only 2 of the 4 unknown parameters R1, C1, R2, C2 can be determined",
            f"determined: R1*C1*R2*C2, {LADDER}",
            "no effect: R1, R2 times k with C1, C2 divided by k",
        ),
    ),
    "ladder, one known": (
        rcrc_circuit(),
        ("R1",),
        (
            "only 2 of the 3 unknown parameters C1, R2, C2 can be determined",
            f"determined: C1*R2*C2, R1*C1*R2*C2, {LADDER}",
        ),
    ),
    "ladder, both known": (rcrc_circuit(), ("R1", "R2"), ()),
    "buffered": (
        rcrc_circuit(buffered=True),
        (),
        (
            "only 2 of the 4 unknown parameters R1, C1, R2, C2 can be determined",
            "determined: R1*C1, R2*C2, R1*C1*R2*C2, R1*C1 + R2*C2",
            "no effect: R1 times k with C1 divided by k",
            "no effect: R2 times k with C2 divided by k",
        ),
    ),
    "motor, speed": (
        dc_motor(),
        (),
        (
            "only 3 of the 5 unknown parameters R, L, K, J, B can be determined",
            f"determined: L*J/K, {SUMS}",
            "no effect: R, L times k with J, B divided by k",
        ),
    ),
    "motor, speed, constant known": (
        dc_motor(),
        ("K",),
        (
            "only 3 of the 4 unknown parameters R, L, J, B can be determined",
            f"determined: R*B, L*B, J/B, {SUMS}",
            "no effect: R, L times k with J, B divided by k",
        ),
    ),
    "motor, speed, two known": (dc_motor(), ("R", "K"), ()),
    "motor, current": (
        dc_motor("current"),
        (),
        (
            "R, L can be determined, of the others only 2 combinations",
            f"determined: K^2/B, J/B, {SUMS}",
            "no effect: K times k with J, B times k^2",
        ),
    ),
    "motor, both": (dc_motor("both"), (), ()),
    "oscillator": (mass_spring_damper(), (), ()),
    "short period": (short_period(), (), ()),
}


@pytest.mark.parametrize("name", NOTES)
def test_notes_are_those_worked_out_by_hand(name):
    model, known, expected = NOTES[name]
    assert identifiability(model, known=known).lines() == expected


@pytest.mark.parametrize("name", NOTES)
@given(seed=st.integers(0, 10_000))
@pytest.mark.fast("rc", "oscillator")
def test_notes_hold_everywhere(name, seed):
    model, known, expected = NOTES[name]
    factors = np.exp(np.random.default_rng(seed).normal(size=len(model.names)))
    values = dict(zip(model.names, (model.guess * factors).tolist(), strict=True))
    assert identifiability(model, values, known).lines() == expected


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ladder", "motor, speed", "motor, current", "short period"])
@given(seed=st.integers(0, 10_000))
def test_notes_do_not_depend_on_units(name, seed):
    model, known, expected = NOTES[name]
    units = np.random.default_rng(seed).integers(-9, 10, len(model.names))
    assert identifiability(in_other_units(model, 10.0**units), known=known).lines() == expected


def in_other_units(model, factors):
    """The same model with parameters that are ``factors`` times as large."""
    scale = dict(zip(model.names, factors.tolist(), strict=True))

    def plain(p):
        return {name: value / scale[name] for name, value in p.items()}

    parameters = [
        PhysicalParameter(p.name, guess=p.guess * scale[p.name], positive=p.positive)
        for p in model.parameters
    ]
    return PhysicalModel(
        model.name,
        parameters,
        model.structure,
        lambda p: model.coefficients(plain(p)),
        input_names=model.input_names,
        output_names=model.output_names,
        combinations={
            name: (lambda p, function=function: function(plain(p)))
            for name, function in model.combinations.items()
        },
    )


def test_a_scaling_that_is_reported_changes_nothing():
    model = dc_motor("current")
    values = dict(zip(model.names, model.guess.tolist(), strict=True))
    (powers,) = identifiability(model).scalings
    moved = {**values, **{n: values[n] * 3.0 ** float(p) for n, p in powers}}
    assert moved != values
    assert np.allclose(model.theta(moved), model.theta(values), rtol=1e-12)


def test_a_parameter_without_effect_is_told():
    parameters = [PhysicalParameter("tau", positive=True), PhysicalParameter("colour")]
    model = PhysicalModel(
        "low pass",
        parameters,
        Structure(1, 0),
        lambda p: {"a0": 1 / p["tau"], "b0": 1 / p["tau"] + 0.0 * p["colour"]},
    )
    assert identifiability(model).lines() == (
        "tau can be determined, of the others only 0 combinations",
        "no effect: colour times k",
    )


def test_a_combination_that_is_not_determined_is_not_listed():
    circuit = rc_circuit()
    model = PhysicalModel(
        "RC",
        circuit.parameters,
        circuit.structure,
        circuit.coefficients,
        combinations={
            "R/C": lambda p: p["R"] / p["C"],
            "(R*C)^2": lambda p: (p["R"] * p["C"]) ** 2,
        },
    )
    assert identifiability(model).combinations == ("(R*C)^2",)


def test_sums_that_nobody_declared_are_counted():
    parameters = [PhysicalParameter(name, positive=True) for name in ("p", "q", "r")]
    model = PhysicalModel(
        "sum", parameters, Structure(1, 0), lambda v: {"a0": v["p"] + v["q"] * v["r"], "b0": v["p"]}
    )
    lines = identifiability(model).lines()
    assert lines == (
        "p can be determined, of the others only 1 combination",
        "determined: q*r",
        "no effect: q times k with r divided by k",
    )
    only = PhysicalModel(
        "sum", parameters[:2], Structure(1, 0), lambda v: {"a0": v["p"] + v["q"], "b0": 1.0}
    )
    assert "what is determined beyond that are no products of powers" in (
        identifiability(only).lines()
    )


def test_a_map_that_is_defined_nowhere_else_is_refused():
    parameter = PhysicalParameter("x", guess=1.0)
    model = PhysicalModel(
        "point",
        [parameter],
        Structure(1, 0),
        lambda p: {"a0": p["x"] if p["x"] == 1.0 else np.nan, "b0": 1.0},
    )
    with pytest.raises(CoefficientMapError, match="near its values"):
        identifiability(model)
