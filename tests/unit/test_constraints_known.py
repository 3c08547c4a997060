"""What a structure says of its coefficients, as a point and directions; contradictions by class."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Structure
from tridentify import errors as err
from tridentify.estimation.knowledge.affine import known_of

ONE = (["u"], ["y"])


def resolved(structure, scale=None):
    return known_of(structure, *ONE, scale)


def test_nothing_known_leaves_all_directions():
    known = resolved(Structure(2, 1))
    assert known.n_free == 4
    assert not known.origin.any()
    assert not known.determined.any()


def test_what_is_fixed_has_no_direction_and_its_exact_value():
    known = resolved(Structure(2, 1, fixed={"a0": 0.1, "b1": -3.0}))
    assert known.origin.tolist() == [0.0, 0.1, -3.0, 0.0]
    assert known.determined.tolist() == [False, True, True, False]


def test_a_static_gain_with_a_fixed_coefficient_determines_the_other():
    known = resolved(Structure(2, 1, fixed={"a0": 3.0}, static_gain=2.0))
    assert known.origin[3] == 6.0
    assert known.n_free == 2


@pytest.mark.parametrize("rate", [1e-6, 1.0, 1e6])
def test_every_point_on_the_directions_meets_the_equalities(rate):
    scale = np.array([rate, rate**2, rate, rate**2])
    weights = {"b0": 1.0 / rate**2, "a0": -2.0 / rate**2}
    other = {"a1": 1.0 / rate, "b1": 3.0 / rate}
    known = resolved(Structure(2, 1, equalities=[(weights, 0.0), (other, 4.0)]), scale)
    rng = np.random.default_rng(0)
    a1, a0, b1, b0 = known.origin + known.directions @ rng.standard_normal(2)
    assert b0 == pytest.approx(2.0 * a0, rel=1e-12)
    assert (a1 + 3.0 * b1) / rate == pytest.approx(4.0, rel=1e-12)


def test_equalities_that_together_determine_a_coefficient_are_noticed():
    rows = [({"a1": 1.0, "a0": 1.0}, 5.0), ({"a1": 1.0, "a0": -1.0}, 1.0)]
    known = resolved(Structure(2, 0, equalities=rows))
    assert known.determined.tolist() == [True, True, False]
    assert np.allclose(known.origin[:2], [3.0, 2.0], rtol=1e-12)


@pytest.mark.parametrize(
    "equalities",
    [
        [({"a0": 1e9, "b0": 1e31}, 0.3)],
        [({"a0": 1e-14, "b0": 1.0}, 0.0)],
        [({"a0": 1e-8, "b0": 1.0}, 0.0), ({"a1": 1.0, "b1": 1.0}, 2.0)],
        [({"a0": 1e-22, "b0": 1.0}, 0.0)] * 2 + [({"a1": 1.0, "b0": 1e7}, 2.0)],
    ],
)
def test_a_light_coefficient_counts_in_an_equality(equalities):
    """Seen: 1e9 a0 + 1e31 b0 = 0.3 was taken for b0 = 3e-32, whatever a0 was."""
    known = resolved(Structure(2, 1, equalities=equalities))
    rng = np.random.default_rng(4)
    for _ in range(20):
        theta = known.origin + known.directions @ rng.standard_normal(known.n_free)
        assert not known.determined.any()
        for weights, value in equalities:
            terms = [w * theta[known.names.index(name)] for name, w in weights.items()]
            assert sum(terms) - value == pytest.approx(0.0, abs=1e-14 * sum(map(abs, terms)))


def test_the_same_said_twice_is_no_contradiction():
    structure = Structure(2, 0, fixed={"a0": 3.0}, static_gain=2.0, equalities=[({"b0": 0.5}, 3.0)])
    assert resolved(structure).origin.tolist() == [0.0, 3.0, 6.0]


@pytest.mark.parametrize(
    ("fixed", "count"),
    [({"a0": 0.0}, 1), ({"a0": 0.0, "a1": 0.0}, 2), ({"a1": 2.0}, 0)],
    ids=["one", "two", "none"],
)
def test_zeros_at_the_end_of_the_denominator_are_integrators(fixed, count):
    assert resolved(Structure(3, 0, fixed=fixed)).integrators == count


def test_static_gains_are_nested_for_several_channels():
    structure = Structure(2, 0, static_gain=[[1.5, None]])
    known = known_of(structure, ["e", "r"], ["q"])
    direction = known.directions[:, known.directions[1] != 0][:, 0]
    assert direction[2] / direction[1] == pytest.approx(1.5, rel=1e-14)
    assert known.n_free == 3


SUM = {"a0": 1.0, "a1": 1.0}
CONTRADICTIONS = {
    "two values for one sum": {"equalities": [(SUM, 4.0), (SUM, 5.0)]},
    "a fixed value and an equality": {"fixed": {"a0": 3.0}, "equalities": [({"a0": 2.0}, 7.0)]},
    "a gain and its coefficients": {"fixed": {"a0": 3.0, "b0": 1.0}, "static_gain": 2.0},
    "an equality beyond a bound": {"equalities": [({"a0": 1.0}, 3.0)], "bounds": {"a0": (4, None)}},
    "a sum that bounds cannot reach": {"equalities": [(SUM, 4.0)], "bounds": {"a0": (5, None)}},
    "an unstable value": {"fixed": {"a1": -1.0}},
    "an undamped pair": {"fixed": {"a1": 0.0}},
    "an unstable bound": {"bounds": {"a1": (None, -1.0)}},
    "a gain beside an integrator": {"fixed": {"a0": 0.0}, "static_gain": 1.0},
    "everything fixed": {"fixed": {"a1": 1.0, "a0": 3.0, "b1": 0.2, "b0": 0.5}},
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_contradictions_are_refused_in_one_line(case):
    structure = Structure(2, 1, **CONTRADICTIONS[case])
    with pytest.raises(err.ContradictoryConstraintsError) as caught:
        resolved(structure)
    message = str(caught.value)
    assert "found" in message
    assert "expected" in message
    assert "\n" not in message


def test_a_fixed_denominator_must_be_stable():
    with pytest.raises(err.ContradictoryConstraintsError, match="pole at"):
        resolved(Structure(3, 0, fixed={"a2": 1.0, "a1": 1.0, "a0": 2.0}))


@pytest.mark.parametrize(
    "structure",
    [Structure([[2, 1]], [[1, 0]], static_gain=1.0), Structure(2, 1, delay="free", static_gain=1)],
    ids=["separate denominators", "free delay"],
)
def test_what_cannot_be_constrained_is_named(structure):
    with pytest.raises(err.UnsupportedError, match="knowledge"):
        known_of(structure, ["u", "v"], ["y"])


def test_nested_orders_of_one_channel_are_no_separate_denominators():
    nested = resolved(Structure([[2]], [[1]], fixed={"a0": 3.0}))
    assert nested.origin.tolist() == resolved(Structure(2, 1, fixed={"a0": 3.0})).origin.tolist()


def test_contradicting_equalities_are_told_as_one_writes_them():
    rows = [({"b0": 1.0, "a0": -1.0}, 0.0), ({"b0": 1.0, "a0": -1.0}, 1.0)]
    with pytest.raises(err.ContradictoryConstraintsError, match=r"found b0 - a0 = [01] together"):
        resolved(Structure(2, 1, equalities=rows))
